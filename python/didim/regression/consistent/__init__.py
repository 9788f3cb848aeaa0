"""Least squares under the conditions that a robot meets."""
