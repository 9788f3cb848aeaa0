"""Solution of the linear problem: equations (7) to (11)."""
