"""Positions read otherwise: the sign of one turned, alone or with its torque. Tested in ``tests/test_evidence_causes.py``."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..rows import LogRows
from .hypothesis import Hypothesis


def positions(rows: LogRows) -> Iterator[Hypothesis]:
    """Return each position turned, with and without its torque."""
    n = rows.n
    for joint in range(n if n > 1 else 0):
        turn = np.ones(n)
        turn[joint] = -1.0
        yield Hypothesis(code="position-sign", joints=(joint + 1,), position=np.diag(turn))
        yield Hypothesis(code="joint-sign", joints=(joint + 1,), position=np.diag(turn), factors=turn)
