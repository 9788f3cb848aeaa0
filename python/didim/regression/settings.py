"""Settings of the least squares (7) to (10)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from .._tools.settings import one_of, whole
from ..errors import FitError

Weights = Literal["none", "per-joint"]
Variance = Literal["r-b", "r-1"]


# The weights settle within a few solutions.
MOST_REWEIGHTINGS = 1000


@dataclass(frozen=True, kw_only=True)
class LeastSquaresSettings:
    """How (7) is solved and its covariance is scaled.

    Parameters
    ----------
    weights : {"per-joint", "none"}
        Divide the rows of each joint by the size of its residuals, or solve once as they are.
    reweightings : int
        How often the weights are estimated and the system is solved again (used with "per-joint").
    variance : {"r-b", "r-1"}
        Divisor of (9): unbiased, or that of the published EMPS results.
    decimation_corrected : bool
        Covariance for noise that decimation has correlated, with a variance per joint where the weights are; `variance` is
        then only that of the printed standard deviation of the error.

    Raises
    ------
    FitError
        For a value that is none of these.
    """

    weights: Weights = "per-joint"
    reweightings: int = 1
    variance: Variance = "r-b"
    decimation_corrected: bool = True

    def __post_init__(self) -> None:
        one_of("weights", self.weights, get_args(Weights), FitError)
        one_of("variance", self.variance, get_args(Variance), FitError)
        whole("reweightings", self.reweightings, FitError, least=0, most=MOST_REWEIGHTINGS)
        one_of("decimation_corrected", self.decimation_corrected, (True, False), FitError)

    def divisor(self, rows: int, columns: int) -> int:
        """Divisor of (9) for a system of so many rows and columns."""
        return rows - columns if self.variance == "r-b" else rows - 1

    @property
    def solutions(self) -> int:
        """Number of systems to solve."""
        return 1 + self.reweightings if self.weights == "per-joint" else 1
