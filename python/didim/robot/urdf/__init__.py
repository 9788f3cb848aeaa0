"""Robots read from a URDF."""
