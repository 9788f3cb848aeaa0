"""CLOE: closed-loop output error, criterion (19), by the simplex of the paper and by Levenberg and Marquardt.

The closed loop is simulated with candidate parameters, many at once in the lanes of vector registers; the cost is the
sum of squared differences between simulated and measured positions (CLOE), torques (CLIE, closed-loop input error), or
both. Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from . import damped_least_squares
from .arrays import real_array
from .errors import DidimError, FitError
from .fitting import FitSettings
from .identification import Identification, Iteration
from .output_error import OutputError
from .schema import counted
from .simplex_search import SimplexSearch
from .starts import Start
from .status import Status

if TYPE_CHECKING:
    from .experiment import Experiment

Array = NDArray[np.float64]
Optimizer = Literal["levenberg-marquardt", "nelder-mead"]
Output = Literal["position", "torque", "both"]
Variant = Literal["scaled", "adaptive", "literal"]

SPREAD = 0.3
"""Further starts are off by normal numbers times what changes the torques by this share of their size."""
SAME_OPTIMUM = 1e-3
"""Costs that differ by less belong to the same optimum."""


@dataclass(frozen=True, kw_only=True)
class CLOE:
    """Settings of CLOE.

    Parameters
    ----------
    optimizer : {"levenberg-marquardt", "nelder-mead"}
        Gauss-Newton steps with damping, a covariance included; or the paper's simplex.
    output : {"position", "torque", "both"}
        What is compared: positions (19), torques, or both.
    start : str, mapping, array or Identification
        Initial parameters (`didim.starts.standard_start`); "apriori" is (21), "idim-ls" the estimate of IDIM-LS.
    max_iterations : int, optional
        100 for Levenberg-Marquardt, 200 per parameter for the simplex.
    max_evaluations : int, optional
        Of the simplex; 200 per parameter.
    variant : {"adaptive", "scaled", "literal"}
        Of the simplex. Literal: ``fminsearch`` as it is, first edges of 5 % or 0.00025, coefficients 1, 2, 1/2, 1/2. Scaled:
        first edges that each change the outputs by 0.3 of the initial norm, shorter where M(q) would not stay positive
        definite. Adaptive: those, and the coefficients of Gao and Han (2012). The last two start again from the best
        point when the simplex has collapsed.
    starts : int
        Searches from so many points: `start`, and random ones around it that can be simulated. The best result is
        returned, with a remark on how many reached the same optimum.
    seed : int
        Of these points.
    checkpoint : path, optional
        File (``.npz``) that the search is saved to as it goes on, and continued from where it is there; with one start.
    tolerance : float
        Levenberg-Marquardt stops when the cost falls by less than this share (20).
    noise : sequence of float, optional
        Standard deviation of the measured positions per joint (rad or m): weights of Levenberg-Marquardt. Estimated from
        fifth differences of the measured positions by default, that of torques likewise.
    fixed, dropped : mapping, sequence, optional
        As in `FitSettings`.
    threads : int, optional
        All cores by default.

    Raises
    ------
    FitError
        For a value out of its range.
    """

    optimizer: Optimizer = "levenberg-marquardt"
    output: Output = "position"
    start: Start = "apriori"
    max_iterations: int | None = None
    max_evaluations: int | None = None
    variant: Variant = "adaptive"
    tolerance: float = 1e-6
    noise: Sequence[float] | None = None
    fixed: dict[str, float] | None = None
    dropped: Sequence[str] | None = None
    threads: int | None = None
    starts: int = 1
    seed: int = 0
    checkpoint: str | Path | None = None

    kind: ClassVar[str] = "cloe"

    @property
    def name(self) -> str:
        """Name in results: "cloe-nelder-mead" or "cloe-levenberg-marquardt", "clie-..." on torques."""
        return f"{'clie' if self.output == 'torque' else 'cloe'}-{self.optimizer}"

    def __post_init__(self) -> None:
        for key, known in (
            ("optimizer", ("levenberg-marquardt", "nelder-mead")),
            ("output", ("position", "torque", "both")),
            ("variant", ("adaptive", "scaled", "literal")),
        ):
            if getattr(self, key) not in known:
                raise FitError(f"{key} must be one of {', '.join(known)}, got {getattr(self, key)!r}")
        for key, least in (("max_iterations", 1), ("max_evaluations", 1), ("starts", 1), ("seed", 0)):
            value = getattr(self, key)
            if value is None and key in ("max_iterations", "max_evaluations"):
                continue
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise FitError(f"{key} must be a whole number of at least {least}, got {value!r}")
        if self.noise is not None:
            noise = real_array("noise", self.noise, FitError)
            if noise.ndim != 1 or not (np.isfinite(noise) & (noise > 0.0)).all():
                raise FitError(f"noise needs positive numbers, one per joint, got {self.noise!r}")
            object.__setattr__(self, "noise", tuple(noise.tolist()))
        if isinstance(self.tolerance, bool) or not isinstance(self.tolerance, Real):
            raise FitError(f"tolerance must be a number, got {self.tolerance!r}")
        if self.checkpoint is not None and not Path(self.checkpoint).absolute().parent.is_dir():
            raise FitError(
                f"checkpoint '{self.checkpoint}': there is no folder '{Path(self.checkpoint).parent}'"
            )
        if self.checkpoint is not None and self.starts > 1:
            raise FitError("a checkpoint belongs to one search: starts must be 1 with it")
        if not 0.0 <= self.tolerance < 1.0:
            raise FitError(f"tolerance must be at least 0 and below 1, got {self.tolerance!r}")

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify the parameters of an experiment's robot; parameters as for `IDIMLS.run`.

        Ctrl-C ends the search with the best point so far.

        Raises
        ------
        DidimError
            One of its kinds: without a reference or a controller, or for a start with which the robot cannot be simulated.
        """
        settings = FitSettings(fixed=self.fixed, dropped=self.dropped)
        job = settings.job(experiment, experiment.simulation.robot(experiment.robot))
        problem = OutputError(self, job, say)
        first = self._search(problem, progress)
        if self.starts == 1 or first.status in (Status.STOPPED, Status.INTERRUPTED):
            return first
        fits, interrupted = [first], False
        try:
            for number, point in enumerate(_further_starts(problem, self.starts - 1, self.seed), start=2):
                say(f"start {number} of {self.starts}")
                try:
                    fits.append(self._search(problem.begun_at(point), progress))
                except DidimError as reason:
                    say(f"start {number}: {reason}")
                    continue
                if fits[-1].status in (Status.STOPPED, Status.INTERRUPTED):
                    break
        except KeyboardInterrupt:
            interrupted = True
        best = _best(fits, self.starts)
        return replace(best, status=Status.INTERRUPTED) if interrupted else best

    def _search(self, problem: OutputError, progress: Callable[[Iteration], bool]) -> Identification:
        if self.optimizer == "nelder-mead":
            return SimplexSearch(problem, progress).run()
        return damped_least_squares.search(problem, progress)


def _further_starts(problem: OutputError, count: int, seed: int) -> list[Array]:
    """Return random points around the start, each moved back towards it until M(q) is positive definite there."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        target = problem.start + SPREAD * problem.scale * rng.standard_normal(problem.start.size)
        share = problem.safe_share(problem.start, target)
        found.append(problem.start + share * (target - problem.start))
    return found


def _cost(fit: Identification) -> float:
    record = fit.settings["cloe"]
    return float(record["final_norm"] ** 2 if "final_norm" in record else record["cost"])


def _best(fits: Sequence[Identification], asked: int) -> Identification:
    """Return the result of lowest cost, with what became of the others."""
    costs = np.array([_cost(fit) for fit in fits])
    best = fits[int(np.argmin(costs))]
    reached = int(np.sum(costs <= costs.min() * (1.0 + SAME_OPTIMUM)))
    sentence = f"{reached} of {counted(asked, 'start')} reached the best optimum"
    if len(fits) < asked:
        sentence += f"; {asked - len(fits)} could not be searched from, or were not come to"
    record = [
        {
            "cost": _cost(fit),
            "status": fit.status.name,
            "iterations": fit.n_iterations,
            "beta": fit.beta.tolist(),
        }
        for fit in fits
    ]
    return replace(
        best,
        # The whole search, not its best part.
        status=fits[-1].status if fits[-1].status in (Status.STOPPED, Status.INTERRUPTED) else best.status,
        n_simulations=sum(fit.n_simulations for fit in fits),
        remarks=(*best.remarks, sentence),
        settings={**best.settings, "starts": record},
    )
