"""Hypotheses on why a log contradicts its model: a family a module, a row each in ``table.py``."""
