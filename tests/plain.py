"""DIDIM without physical conditions, the one of the paper, for tests that pin what it does."""

from __future__ import annotations

from typing import Any

from didim import DIDIM


def plain_didim(**settings: Any) -> DIDIM:
    """Return the settings of plain DIDIM."""
    return DIDIM(physical=False, **settings)
