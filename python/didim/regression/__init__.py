"""Equations (7) to (11): how the linear problem is solved."""
