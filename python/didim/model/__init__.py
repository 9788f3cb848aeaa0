"""Equations (1) to (4): the dynamic models of a robot."""
