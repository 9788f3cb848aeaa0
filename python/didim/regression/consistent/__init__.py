"""Least squares with physical constraints."""
