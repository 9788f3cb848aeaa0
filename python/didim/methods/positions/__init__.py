"""CLOE with known links: drives and friction from commanded and measured positions alone."""
