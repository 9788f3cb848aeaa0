"""Friction that is not linear in its parameters, and which of its terms a log supports."""
