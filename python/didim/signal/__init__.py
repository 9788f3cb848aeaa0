"""From positions to the rows of (6)."""
