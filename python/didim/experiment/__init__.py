"""Experiments: robot, log, closed loop and settings, read from a file."""
