"""Commands that use an identified robot: payloads, torques from outside."""
