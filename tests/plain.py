"""DIDIM without physical conditions, the one of the paper, for tests that pin what it does; and stubs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from didim import DIDIM


def plain_didim(**settings: Any) -> DIDIM:
    """Return the settings of plain DIDIM."""
    return DIDIM(physical=False, **settings)


def stub(**facts: object) -> Any:
    """Facts in the place of a record that has more of them."""
    return SimpleNamespace(**facts)
