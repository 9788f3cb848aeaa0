"""Tools independent of robotics."""
