"""Hypotheses on why a log contradicts its model, and the one that explains it."""
