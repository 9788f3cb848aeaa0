"""The families of hypotheses: a row each, in the order in which equals are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ..rows import LogRows
from .geometry import conventions, gravities, lengths, other_robots, twists
from .hypothesis import Hypothesis
from .positions import exchanged, positions, reversals, scales, sides, units
from .torques import exchanges, gains, of_motors, scaled

Family = Callable[[LogRows], Iterator[Hypothesis]]
"""Generator of a family's hypotheses for the rows of a log."""
OF_TORQUES: tuple[Family, ...] = (gains, exchanges)
"""Families that do not change the columns, two milliseconds per hypothesis; signs come before all others."""
OF_SIGNS: tuple[Family, ...] = (positions,)
"""Families about a joint's direction of rotation, which friction also determines."""
OF_READINGS: tuple[Family, ...] = (units, sides, reversals, other_robots, exchanged, scales)
"""Families about how the log's columns are read, for `check` and for logs with large residuals."""
OF_KNOWN: tuple[Family, ...] = (scaled, of_motors)
"""Families about all torques at once, which only known parameters tell: without them a log fits in any unit."""
OF_ROBOT: tuple[Family, ...] = (gravities, conventions, twists, lengths)
"""Families about the robot file, independent of known parameters; a cheap screening excludes most hypotheses."""
