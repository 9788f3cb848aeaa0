"""The families of hypotheses: a row each, in the order in which equals are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ..rows import LogRows
from .geometry import conventions, gravities, lengths, twists
from .hypothesis import Hypothesis
from .positions import positions
from .torques import exchanges, gains, signs

Family = Callable[[LogRows], Iterator[Hypothesis]]
"""Makes the hypotheses of a family for the rows of a log."""
OF_TORQUES: tuple[Family, ...] = (signs, gains, exchanges)
"""Families that keep the columns: two milliseconds a hypothesis."""
OF_COLUMNS: tuple[Family, ...] = (gravities, positions, conventions, twists, lengths)
"""Families with columns of their own, most of which a rougher look rules out."""
