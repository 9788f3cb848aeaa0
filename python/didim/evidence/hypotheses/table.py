"""The families of hypotheses: a row each, in the order in which equals are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ..rows import LogRows
from .geometry import conventions, gravities, lengths, twists
from .hypothesis import Hypothesis
from .positions import exchanged, positions, scales, sides, units
from .torques import exchanges, gains, signs

Family = Callable[[LogRows], Iterator[Hypothesis]]
"""Makes the hypotheses of a family for the rows of a log."""
OF_TORQUES: tuple[Family, ...] = (signs, gains, exchanges)
"""Families that keep the columns: two milliseconds a hypothesis."""
OF_SIGNS: tuple[Family, ...] = (positions,)
"""Families on the way a joint turns, which friction knows too."""
OF_READINGS: tuple[Family, ...] = (units, sides, exchanged, scales)
"""Families on how the columns of the log are read, for `check` and for logs that are explained badly."""
OF_ROBOT: tuple[Family, ...] = (gravities, conventions, twists, lengths)
"""Families on the robot file; known parameters say nothing of these. A rougher look rules out most."""
