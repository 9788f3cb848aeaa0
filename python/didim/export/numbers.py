"""Numbers in exported files: the shortest text that reads back as the same bits."""

from __future__ import annotations

from collections.abc import Iterable


def number(value: float) -> str:
    """Return one number; zero has no sign."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float]) -> str:
    """Return several numbers with spaces between."""
    return " ".join(map(number, values))
