"""What is done with a known robot and a log: an unknown payload, torques from outside."""
