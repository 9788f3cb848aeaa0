"""Faults of a log, found before the fit: one finding a module."""
