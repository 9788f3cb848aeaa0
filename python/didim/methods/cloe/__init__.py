"""CLOE: closed-loop output error (19)."""
