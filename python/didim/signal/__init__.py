"""Rows of (6) from positions."""
