"""Settings of the least squares (7) to (10)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .._tools.keys import declared
from .._tools.settings import check_declared
from ..errors import FitError

Weights = Literal["none", "per-joint"]
Variance = Literal["r-b", "r-1"]
UncertaintyKind = Literal["jackknife", "decimated", "white"]

BLOCKS = 20
"""Default number of blocks of the jackknife: on real logs 10 to 20 serve equally; 30 blocks of a log of 9 s are not
independent."""


@dataclass(frozen=True, kw_only=True)
class LeastSquaresSettings:
    """Settings of the solution of (7), of its weights and of its covariance.

    Tested in ``tests/test_least_squares.py`` and ``tests/test_jackknife.py``.

    Parameters
    ----------
    weights : {"per-joint", "none"}
        Divide the rows of each joint by the size of its residuals, or solve once without weights.
    reweightings : int
        Number of times that the weights are estimated and the system is solved again (with "per-joint").
    variance : {"r-b", "r-1"}
        Divisor of (9): unbiased, or that of the published EMPS results.
    uncertainty : {"jackknife", "decimated", "white"}
        Standard deviations from leaving out blocks of time, which include correlated model errors; for white noise after
        decimation, with a variance per joint if the weights are; or (10) with the `variance` of (9), as in published figures.
    blocks : int
        Number of time blocks of the jackknife, at least 2; fewer if there are few rows, or where errors outlast blocks.
    physical : bool, optional
        Solve (7) under the conditions of a robot, by any method but CLOE, which does not solve it; by default the method decides
        (``test_identify.py``).

    Raises
    ------
    FitError
        For a value that is none of these.
    """

    weights: Weights = "per-joint"
    reweightings: int = 1
    variance: Variance = "r-b"
    uncertainty: UncertaintyKind = "jackknife"
    blocks: int = BLOCKS
    physical: bool | None = None

    def __post_init__(self) -> None:
        check_declared(self, declared("experiment", "least_squares"), FitError)

    def divisor(self, rows: int, columns: int) -> int:
        """Return the divisor of (9) for a number of rows and columns."""
        return rows - columns if self.variance == "r-b" else rows - 1

    @property
    def solutions(self) -> int:
        """Number of systems to solve."""
        return 1 + self.reweightings if self.weights == "per-joint" else 1
