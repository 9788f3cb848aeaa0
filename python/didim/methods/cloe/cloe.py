"""CLOE: closed-loop output error, criterion (19), by the simplex of the paper and by Levenberg and Marquardt.

The closed loop is simulated with candidate parameters, many at once in the lanes of vector registers; the cost is the
sum of squared differences between simulated and measured positions (CLOE), torques (CLIE, closed-loop input error), or
both. Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import counted
from ...errors import DidimError, FitError
from ...experiment.experiment import Experiment
from ...experiment.loop import recordings_of
from ...result.further import Further
from ...result.identification import Identification
from ...result.iteration import Reporter, Status
from ..idim_ls import direct_estimate
from ..positions.estimate import identify_positions
from .consistent import consistent_steps
from .levenberg_marquardt import SafeSteps, search
from .output_error import OutputError
from .settings import CLOESettings
from .simplex import SimplexSearch

START_SPREAD = 0.3
"""Standard deviation of a further start, in changes of the parameters, given as the share of the torques that each change
makes."""
ASKED_TO_END = (Status.STOPPED, Status.INTERRUPTED)
"""Endings of a search after which no other begins."""
SAME_OPTIMUM = 1e-3
"""Relative difference of two costs below which they belong to the same optimum."""


@dataclass(frozen=True, kw_only=True)
class CLOE(CLOESettings):
    """Settings of CLOE.

    Tested in ``tests/test_cloe.py``.

    Parameters
    ----------
    optimizer : {"levenberg-marquardt", "nelder-mead"}
        Gauss-Newton steps with damping, with a covariance; or the paper's simplex.
    output : {"position", "torque", "both"}
        Compared outputs: positions (19), torques, or both.
    start : str, mapping, array or Identification, optional
        Initial parameters (`didim.methods.start.standard_start`); "apriori" is (21), the default; "idim-ls" the estimate of
        IDIM-LS, "consistent" and "prior" robots computed from the log. With ``physical=True`` it is the start of consistent
        DIDIM, whose estimate starts the search; further starts are the robots nearest to random points.
    physical : bool, optional
        True for steps with physical constraints, by Levenberg-Marquardt (`didim.methods.cloe.consistent`).
    max_iterations : int, optional
        100 for Levenberg-Marquardt, 200 per parameter for the simplex.
    max_evaluations : int, optional
        Upper bound for the simplex; 200 per parameter by default.
    variant : {"adaptive", "scaled", "literal"}
        Variant of the simplex. Literal: unmodified ``fminsearch``, first edges of 5 % or 0.00025, coefficients 1, 2, 1/2, 1/2.
        Scaled: first edges that each change the outputs by 0.3 of the initial norm, shorter where M(q) would not stay positive
        definite. Adaptive: scaled, with the coefficients of Gao and Han (2012). The last two restart from the best point after
        a collapse of the simplex.
    starts : int
        Number of starting points: `start`, and random ones around it that can be simulated. The best result is returned, with a
        remark on how many reached the same optimum.
    seed : int
        Seed of these points.
    checkpoint : path, optional
        File (``.npz``) for the state of the search, which is resumed if the file exists; only with one start.
    tolerance : float
        Relative decrease of the cost at which Levenberg-Marquardt stops (20).
    noise : sequence of float, optional
        Standard deviation of the measured positions per joint (rad or m): weights of Levenberg-Marquardt. By default both
        position and torque noise are estimated from fifth differences.
    variance, signal, compensate_samples, fixed, dropped : optional
        As in `didim.methods.method.MethodSettings`; trimming and delay only affect the torque errors of the result.
    threads : int, optional
        All cores by default.
    executor : Executor, optional
        Executor of `concurrent.futures` for the searches from further starts, which do not report iterations.

    Raises
    ------
    FitError
        For a value out of its range.
    """

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        """Identify the parameters of an experiment's robot, as `Method.run`.

        Ctrl-C ends the search with the best point so far.
        """
        if experiment.links == "fixed":
            return identify_positions(self, experiment, reporter)
        if any(recording.drives is not None for _, recording in recordings_of(experiment)):
            return _run_with_held_gains(self, experiment, reporter)
        begun = self._begun(experiment, reporter)
        problem = begun.problem
        first = self._search(begun)
        if self.starts == 1 or first.status in ASKED_TO_END:
            return first
        fits, interrupted = [first], False
        sent: list[Future[Identification]] = []
        try:
            points = _further_starts(problem, self.starts - 1, self.seed)
            if self.executor is not None:
                alone = replace(self, executor=None)
                sent = [self.executor.submit(_search_apart, alone, experiment, point) for point in points]
            for number, point in enumerate(points, start=2):
                reporter.say(f"start {number} of {self.starts}")
                try:
                    fits.append(sent[number - 2].result() if sent else self._search(begun.begun_near(point)))
                except DidimError as reason:
                    reporter.say(f"start {number}: {reason}")
                    continue
                if fits[-1].status in ASKED_TO_END:
                    break
        except KeyboardInterrupt:
            interrupted = True
        finally:
            for future in sent:
                future.cancel()
        best = _best(fits, self.starts)
        return replace(best, status=Status.INTERRUPTED) if interrupted else best

    def _begun(self, experiment: Experiment, reporter: Reporter) -> SafeSteps:
        """Return the search from the start, which for a physical search is that of consistent DIDIM."""
        if self.physical:
            return consistent_steps(self, experiment, reporter)
        job = self.job(experiment, experiment.simulated_robot)
        return SafeSteps(OutputError(self, job, reporter))

    def _search(self, begun: SafeSteps) -> Identification:
        if self.optimizer == "nelder-mead":
            return SimplexSearch(begun.problem).run()
        return search(begun)


def _search_apart(method: CLOE, experiment: Experiment, point: Array) -> Identification:
    """Search from a point in another process."""
    return method._search(method._begun(experiment, Reporter()).begun_near(point))


def _further_starts(problem: OutputError, count: int, seed: int) -> list[Array]:
    """Return random points around the start, each moved towards it until M(q) is positive definite."""
    rng = np.random.default_rng(seed)
    starts = []
    for _ in range(count):
        target = problem.start + START_SPREAD * problem.scale * rng.standard_normal(problem.start.size)
        share = problem.safe_share(problem.start, target)
        starts.append(problem.start + share * (target - problem.start))
    return starts


def _cost(fit: Identification) -> float:
    record = fit.settings["cloe"]
    return float(record["final_norm"] ** 2 if "final_norm" in record else record["cost"])


def _best(fits: Sequence[Identification], asked: int) -> Identification:
    """Return the result of lowest cost, with a remark on the others."""
    costs = np.array([_cost(fit) for fit in fits])
    best = fits[int(np.argmin(costs))]
    reached = int(np.sum(costs <= costs.min() * (1.0 + SAME_OPTIMUM)))
    sentence = f"{reached} of {counted(asked, 'start')} reached the best optimum"
    if len(fits) < asked:
        sentence += f"; {asked - len(fits)} could not be searched from, or were not reached"
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
        # Time and simulations of all searches, not only of the best.
        status=fits[-1].status if fits[-1].status in ASKED_TO_END else best.status,
        n_simulations=sum(fit.n_simulations for fit in fits),
        remarks=(*best.remarks, sentence),
        settings={**best.settings, "starts": record},
    )


def _run_with_held_gains(method: CLOE, experiment: Experiment, reporter: Reporter) -> Identification:
    """Identify the drive gains of currents by IDIM-LS, and the other parameters by CLOE with the resulting torques.

    Positions say nothing of drive gains, and CLOE compares no currents. What it estimates does not depend on the gains: its
    covariance and theirs stand side by side. Tested in ``tests/test_drive_gains.py``.

    Raises
    ------
    FitError
        For an output with torques, whose errors would depend on the gains.
    """
    if method.output != "position":
        raise FitError(
            f"output {method.output!r} compares torques, but experiment '{experiment.name}' has currents: use output "
            "'position', or identify the drive gains by didim and give them as gain = [...]"
        )
    direct = direct_estimate(method, experiment, reporter)
    known = direct.further
    assert known is not None
    assert known.gains is not None
    fit = method.run(experiment.with_gains(known.gains), reporter)
    return replace(
        fit,
        further=_with_gains(fit, known),
        remarks=(
            *fit.remarks,
            "positions do not identify drive gains: these are the gains of IDIM-LS, with its standard deviations",
        ),
    )


def _with_gains(fit: Identification, direct: Further) -> Further:
    """Return the further parameters of a result followed by the drive gains of another one."""
    own, part = fit.further, direct.part("gain")
    if own is None:
        own = Further(blocks=(), values=np.zeros(0), covariance=fit.covariance, std_white=np.zeros(0))
    n = part.stop - part.start
    whole = np.zeros((len(own.covariance) + n,) * 2)
    whole[:-n, :-n], whole[-n:, -n:] = own.covariance, direct.covariance_of(part)
    return replace(
        own,
        blocks=(*own.blocks, *(block for block in direct.blocks if block.kind == "gain")),
        values=np.concatenate([own.values, direct.values[part]]),
        covariance=whole,
        std_white=np.concatenate([own.std_white, direct.std_white[part]]),
    )
