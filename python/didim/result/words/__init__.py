"""Sentences of families of findings."""
