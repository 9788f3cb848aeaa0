"""The problem of DIDIM and IDIM-IV: the closed loops of a log, and the linear system (7) along the motion that they simulate.

    DIDIM      W, y of (7) along the motion of the iterate
    IDIM-IV    W, y along the measured motion, instruments along that of the iterate

solved by the solver of the run, for the parameters that the motion identifies. Tested in ``tests/test_didim.py`` and
``tests/test_contrast.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim._core as _core

from ..._tools.arrays import Array, quotient, ratio
from ..._tools.threads import core_threads
from ..._tools.words import brief, listing
from ...errors import DidimError, FitError, RankError
from ...evidence.naming import torque_findings
from ...evidence.torques import following_findings
from ...experiment.experiment import Experiment
from ...experiment.loop import windows
from ...loop.outcome import Outcome
from ...loop.tuning import mean_diagonal
from ...model.limbs import limbs_of
from ...model.safe_step import thinned
from ...regression.fit import Fit
from ...regression.gains.currents import Currents
from ...regression.least_squares import solve, solve_partly
from ...result.finding import Finding
from ...result.identification import Identification
from ...result.iteration import Reporter
from ...signal.window import Window
from ...terms.model import torques
from ...terms.rows import LinearSystem
from ..idim_ls import direct_estimate
from ..job import Job
from ..start import extended_start
from .settings import DIDIMSettings

RECORDED = ("tolerance", "sigma_fraction", "max_iterations", "gain_updating", "margin")
"""Settings that a result records, in addition to the start."""
ABREAST = 8
"""Number of candidates that are simulated at once: a few lanes of the core per thread, in bounded memory."""
CHECKED_POSITIONS = 500
"""Number of positions along a simulated motion at which M(q) must stay positive definite."""
CAREFUL = 2
"""Divisor of the smallest step when a simulation fails; the run is repeated with that uniform step."""
SAME = 1e-9
"""Largest logarithm of a gain's factor that counts as a factor of 1."""

Motion = tuple[Array, Array, Array, Array]
"""Simulated ``q dq ddq tau`` of a window, (n_kept, n_dof) each."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated motion of every window with some parameters.

    Attributes
    ----------
    motions : list of Motion
        Those of all windows.
    scale : (n_dof,) array or None
        Factors of the gains.
    errors, sizes : (n_dof,) arrays
        Sums of squares of measured less simulated torque, and of measured torque.
    finer : (n_kept, n_dof) array or None
        Torques of the first window with half the steps, where they were asked for.
    """

    motions: list[Motion]
    scale: Array | None
    errors: Array
    sizes: Array
    finer: Array | None = None

    @property
    def error(self) -> float:
        """Norm of measured less simulated torque over that of measured torque, (12)."""
        return self.error_of(slice(None))

    def error_of(self, joints: slice | list[int]) -> float:
        """Return the same of some joints."""
        return ratio(np.sqrt(self.errors[joints].sum()), np.sqrt(self.sizes[joints].sum()))


@dataclass(frozen=True, eq=False)
class Iterate:
    """An iterate: standard parameters, their simulated motion, and the number of the iteration (0: the start)."""

    x: Array
    simulated: Simulated
    iteration: int


@dataclass(frozen=True, eq=False)
class Solved:
    """The linear system (7) along the motion of an iterate, with its solution.

    Attributes
    ----------
    along, system, fit
        The iterate, its system, and the solution.
    target : (n_parameters,) array
        Standard parameters of the solution; of a part that rests those of the iterate.
    std : (b,) array
        Standard deviations of the base parameters.
    held : tuple of int
        Columns that the motion does not identify, which keep their values.
    """

    along: Iterate
    system: LinearSystem
    fit: Fit
    target: Array
    std: Array
    held: tuple[int, ...] = ()

    def at(self, share: float | Array) -> Array:
        """Return the standard parameters at a share of the way from the iterate to the solution, of all or of each."""
        x = self.along.x
        return x + share * (self.target - x) if np.any(share < 1.0) else self.target


@dataclass(frozen=True, eq=False)
class Part:
    """Joints and parameters that iterate until they rest by themselves: those of a limb, or all.

    Attributes
    ----------
    joints : slice or list of int
        Its driven joints, from 0.
    columns : slice or (n,) array
        Its parameters among the estimated ones.
    indices : slice or (m,) array
        Its parameters among the standard ones.
    """

    joints: slice | list[int]
    columns: slice | NDArray[np.intp]
    indices: slice | NDArray[np.intp]


EVERYTHING = Part(slice(None), slice(None), slice(None))
"""The part of a robot of one limb, and of limbs that share something."""


class Problem:
    """Closed loops of a log, and the linear system of an iterate.

    Attributes
    ----------
    delay : Delay
        Delay of the torque.
    experiment : Experiment
        Robot, log and closed loop.
    windows : list of Window
        Windows with the current time steps.
    n_simulations : int
        Simulations so far.
    remarks : list of str
        Sentences on the steps, and on contradictions of the torques.
    stuck : dict of int to str
        Parameters that a simulated motion did not identify, by iteration, 0 for the start.
    resting : (n_parameters,) array of bool
        Standard parameters of the parts that rest.
    steady_within : float
        Largest change in standard deviations at which a steady residual ends the iteration.
    most_lost : float
        Number of successive iterations, further from the log than zero torque and than the best one, after which the run gives up.
    steps_follow_rates : bool
        Whether the time steps follow from the parameters, and need no check.
    """

    steady_within = np.inf
    most_lost = np.inf
    steps_follow_rates = False
    contradictions: Sequence[Finding] = ()
    windows: list[Window]

    def __init__(self, method: DIDIMSettings, job: Job, reporter: Reporter) -> None:
        self.method, self.job, self.reporter = method, job, reporter
        self.robot, self.base = job.robot, job.model
        self.delay, self.experiment = job.delay(), job.experiment
        self.n_simulations = 0
        self.remarks: list[str] = []
        self.stuck: dict[int, str] = {}
        self.resting = np.zeros(len(self.robot.parameter_names) + self.base.n_further, dtype=bool)
        self._still = np.zeros(self.robot.n_dof, dtype=bool)
        self._latest: dict[Window, Sequence[Array]] = {}
        self._usual: list[Window] | None = None
        self._refined = False
        self.windows = [] if self.steps_follow_rates else self.windows_of(self.experiment)

    # The closed loops.

    def windows_of(self, experiment: Experiment) -> list[Window]:
        """Return the windows of the fitted recordings in the closed loop of an experiment, with their torque delay compensated.

        Torques along measured motion also compensate the hold of a digital controller, as in IDIM-LS.

        Raises
        ------
        FitError
            Without a recording to fit, without torques, or when trimming leaves nothing of a window.
        """
        held = self.delay.hold_s if self.instrumental else 0.0
        return windows(experiment, self.job.signal, along="simulated", delay=self.delay.samples, hold_s=held)

    @cached_property
    def parts(self) -> list[Part]:
        """Parts that rest by themselves: limbs that share neither motion, parameters nor conditions."""
        limbs, unknowns, job = limbs_of(self.robot), self.base.unknowns, self.job
        apart = all(len(window.loop.limbs) == len(limbs) > 1 for window in self.windows)
        if not apart or job.solver is not solve or not self.base.simple or self.instrumental:
            return [EVERYTHING]
        index = np.array(self.robot.base_parameters.indices)[unknowns.estimated]
        parts = [
            Part(list(limb.joints), np.flatnonzero(np.isin(index, limb.indices)), limb.indices)
            for limb in limbs
        ]
        return parts if all(len(index[part.columns]) for part in parts) else [EVERYTHING]

    def simulate(self, x: Array, scale: Array | None = None, checked: bool = False) -> Simulated | Outcome:
        """Simulate every window with parameters `x`, (n_parameters,), and scaled gains, (n_dof,).

        `checked` also simulates the first window with half the steps, on another core.
        """
        self.choose_steps(x)
        if checked and not self.steps_follow_rates:
            from concurrent.futures import ThreadPoolExecutor

            with ThreadPoolExecutor(1) as other:
                half = other.submit(self._with_half_steps, x, scale) if core_threads() != 1 else None
                run = self.simulate(x, scale)
                finer = self._with_half_steps(x, scale) if half is None else half.result()
            self.n_simulations += 1
            return run if isinstance(run, Outcome) else replace(run, finer=finer)
        motions = []
        for window in self.windows:
            arrays, (outcome,) = self._run(window, [x], scale)
            self.n_simulations += 1
            if not outcome.completed:
                return outcome
            motions.append(_kept(window, arrays, 0))
            if len(self.parts) > 1:
                self._latest[window] = arrays
        return self._compared(x, motions, scale)

    def shares(self, lengths: Array) -> float | Array:
        """Return the share of the way of each standard parameter, (n_parameters,), or one for all, from that of each part."""
        if len(self.parts) == 1:
            return float(lengths[0])
        shares = np.ones(len(self.resting))
        for part, length in zip(self.parts, lengths, strict=True):
            shares[part.indices] = length
        return shares

    def shortened(self, lengths: Array, ended: Outcome) -> Array:
        """Return the lengths of the parts after a simulation that ended early: half of that of the limb where it did, or of all."""
        numbers = np.arange(self.robot.n_dof)
        there = [ended.joint is not None and ended.joint - 1 in numbers[part.joints] for part in self.parts]
        return np.where(there if any(there) else True, 0.5 * lengths, lengths)

    def rest(self, part: Part) -> None:
        """Keep the parameters of a part, and the motion that was simulated last with them."""
        self.resting[part.indices] = self._still[part.joints] = True

    def rouse(self) -> None:
        """Let all parts move again."""
        self.resting[:] = self._still[:] = False
        self._latest.clear()

    def simulate_all(self, candidates: Sequence[Array]) -> list[Simulated | Outcome]:
        """Simulate every window with many candidates, (n_parameters,) each, in parallel."""
        results: list[Simulated | Outcome] = []
        for first in range(0, len(candidates), ABREAST):
            some = candidates[first : first + ABREAST]
            runs = [self._run(window, some) for window in self.windows]
            for k, x in enumerate(some):
                ended = [outcomes[k] for _, outcomes in runs if not outcomes[k].completed]
                motions = [
                    _kept(window, arrays, k) for window, (arrays, _) in zip(self.windows, runs, strict=True)
                ]
                results.append(ended[0] if ended else self._compared(x, motions, None))
        self.n_simulations += len(candidates) * len(self.windows)
        return results

    def _run(
        self, window: Window, candidates: Sequence[Array], scale: Array | None = None
    ) -> tuple[Sequence[Array], tuple[Outcome, ...]]:
        own = np.stack([self.base.standard(x, window.recording) for x in candidates])
        known = (self._latest[window], self._still) if self._still.any() and window in self._latest else None
        return window.loop.run(own, gain_scale=None if scale is None else scale[None], known=known)

    def _compared(self, x: Array, motions: list[Motion], scale: Array | None) -> Simulated:
        """Return simulated motions with the errors of their torques; currents become torques by the gains in `x`."""
        errors, sizes = np.zeros((2, self.robot.n_dof))
        for window, (_, _, _, tau) in zip(self.windows, motions, strict=True):
            measured = window.tau
            if window.drives is not None:
                gains = x[len(x) - self.base.n_gains :]
                measured = np.asarray((measured @ np.linalg.inv(window.drives) * gains) @ window.drives)
            errors += np.sum((measured - tau) ** 2, axis=0)
            sizes += np.sum(measured**2, axis=0)
        return Simulated(motions, scale, errors, sizes)

    def finer(self, iterate: Iterate) -> Array:
        """Return the torques along the first window with half the steps, (n_kept, n_dof); NaN after an early end."""
        if iterate.simulated.finer is not None:
            return iterate.simulated.finer
        self.n_simulations += 1
        return self._with_half_steps(iterate.x, iterate.simulated.scale)

    def _with_half_steps(self, x: Array, scale: Array | None) -> Array:
        window = self.windows[0]
        arrays, _ = self._run(replace(window, closed_loop=window.loop.divided(2)), [x], scale)
        return _kept(window, arrays, 0)[3]

    def choose_steps(self, x: Array) -> None:
        """Switch to the time steps of a robot; those of the experiment are the same for all."""

    def take_small_steps(self) -> bool:
        """Switch to uniform small steps, at most once, unless the log looks wrong; return whether they changed.

        The experiment's steps suit the robot and motion of the log; a robot with less inertia is stiff elsewhere too.
        """
        if self.steps_follow_rates or self._refined or self.suspicions():
            return False
        self._refined, self._usual = True, self.windows
        smallest = min(min(window.loop.steps[0], *window.loop.steps[1]) for window in self.windows) / CAREFUL
        self.windows = [replace(window, closed_loop=window.loop.even(smallest)) for window in self.windows]
        self.remarks.append(
            "from this start the simulation fails with the steps of the experiment: until the end is near they are "
            f"{1e3 * smallest:.3g} ms throughout"
        )
        self.reporter.say(self.remarks[-1])
        return True

    def take_usual_steps(self, x: Array) -> Simulated | None:
        """Return a simulation with the experiment's steps after small ones; None if unchanged or still too large."""
        if self._usual is None:
            return None
        small, self.windows, self._usual = self.windows, self._usual, None
        again = self.simulate(x)
        if isinstance(again, Simulated):
            return again
        self.windows = small
        return None

    # The gains of the simulated controller.

    def reference_positions(self) -> Array:
        """Return positions along the references at which M(q) is evaluated, (n, n_dof)."""
        positions = [window.loop.reference.at(window.loop.t)[0] for window in self.windows]
        return thinned(np.concatenate(positions), CHECKED_POSITIONS)

    def gain_scale(self, x: Array) -> Array | None:
        """Return the factor of each joint's gains: J(x) over the J of the real robot, (n_dof,); None for 1 or no scaling."""
        if self.method.gain_updating == "never":
            return None
        q, p = self.reference_positions(), len(self.robot.parameter_names)
        here, real = (mean_diagonal(self.robot, each[:p], q) for each in (x, self.real_parameters()))
        scale = np.where(here > 0.0, quotient(here, real, 1.0), 1.0)
        return None if np.abs(np.log(scale)).max() < SAME else scale

    @cached_property
    def direct(self) -> Identification:
        """The IDIM-LS estimate with the settings of the method, for starts and gains.

        Where positions were not measured, the reference replaces them, which suffices for the gains.
        """
        experiment = with_positions(self.job.experiment)
        return direct_estimate(self.method, experiment, self.reporter, compensate_samples=self.delay)

    def real_parameters(self) -> Array:
        """Return the standard parameters with the inertias for the controller, (p,): those of the IDIM-LS estimate."""
        return self.direct.parameters

    # The linear system of an iterate.

    @cached_property
    def measured(self) -> LinearSystem:
        """(7) along the measured motion."""
        return self.job.system(self.job.parts("fit", self.delay))

    @property
    def instrumental(self) -> bool:
        """Whether the simulated motion provides instruments for the measured one."""
        return self.method.motion == "measured"

    def start(self) -> Array:
        """Return the standard parameters of the start, with fixed and dropped ones at their values."""
        x = extended_start(self.job, self.method.chosen_start, lambda: self.direct, lambda: self.delay)
        beta, unknowns = self.base.project(x), self.base.unknowns
        beta[[role != "estimated" for role in unknowns.roles]] = 0.0
        x = self.base.lift(beta + unknowns.values)
        unloaded = x[: len(self.robot.parameter_names)]
        smallest = _core.smallest_eigenvalue(self.robot.core, self.reference_positions(), unloaded)
        if smallest is not None and not smallest[1] > 0.0:
            raise self.no_start(
                f"M(q) is not positive definite on the reference (smallest eigenvalue {smallest[1]:.3g})"
            )
        return x

    def no_start(self, reason: str) -> FitError:
        """Return the error for a start that cannot be simulated."""
        # A wrong log makes IDIM-LS wrong, which may be the start and scales the gains.
        findings = self.contradictions or self.suspicions()
        why = f"; {brief(findings[0].sentence, 90)}" if findings else ""
        which = "consistent DIDIM" if self.steps_follow_rates else "DIDIM"
        return FitError(f"{which} cannot start from these parameters: {reason}{why}")

    def along(self, simulated: Simulated) -> list[Window]:
        """Return every window along its simulated motion."""
        return [
            window.along(motion[:3]) for window, motion in zip(self.windows, simulated.motions, strict=True)
        ]

    def observe(self, iterate: Iterate) -> LinearSystem:
        """Return (7): measured torques, and the regressor along the simulated motion or with instruments from it."""
        parts = self.along(iterate.simulated)
        along = self._about(iterate, self.job.system(parts, self.base.project(iterate.x)))
        if not self.instrumental:
            return along
        return replace(self._about(iterate, self.measured), instruments=along.w)

    def _about(self, iterate: Iterate, system: LinearSystem) -> LinearSystem:
        """Return a system, linearised about an iterate if drive gains are unknown.

        The start contains no information on the torques, so the first system is about the estimate with its gains.
        """
        n = self.base.n_gains
        if not n:
            return system
        currents = Currents.of(system, self.job.reduction)
        values = self.job.estimated(iterate.x)
        gains = values[-n:]
        return currents.linearised(values[:-n] if iterate.iteration else currents.parameters(gains), gains)

    def solution(self, system: LinearSystem) -> Fit:
        """Solve a system with the solver of the run."""
        return self.job.solve(system)

    def solve(self, iterate: Iterate) -> Solved:
        """Solve the system of an iterate.

        Parameters that this motion does not identify, because simulated joints stick in friction, keep the values of the
        iterate. The log is at fault only if the measured motion does not identify them either.
        """
        system = self.observe(iterate)
        try:
            return self.solved(iterate, system, self.solution(system))
        except RankError as reason:
            self._blame_log()
            values = self.job.estimated(iterate.x)
            fit, unidentified = solve_partly(system, self.solution, values, reason.columns)
            self.stuck[iterate.iteration] = listing([system.names[column] for column in unidentified])
            return self.solved(iterate, system, fit, unidentified)

    def solved(self, iterate: Iterate, system: LinearSystem, fit: Fit, held: tuple[int, ...] = ()) -> Solved:
        """Return the system of an iterate with a solution that holds some columns."""
        target = self.job.lift(fit.solution) if fit.standard is None else fit.standard
        std = np.sqrt(np.diag(self.base.unknowns.expand_covariance(fit.covariance)))
        return Solved(iterate, system, fit, np.where(self.resting, iterate.x, target), std, held)

    def changes_in_sigma(self, solved: Solved) -> Array:
        """Return the changes of the estimated parameters towards the solution, (n,), in standard deviations."""
        change = np.abs(self.base.project(solved.target - solved.along.x))
        return quotient(change, solved.std)[self.base.unknowns.estimated]

    def _blame_log(self) -> None:
        """Raise the error on the log, if its measured motion does not identify all parameters either."""
        try:
            self.direct  # noqa: B018 - its error is asked for
        except RankError:
            raise
        except DidimError:
            return  # the measured motion is not available

    # The response of the simulated torques.

    def simulated_rows(self, simulated: Simulated) -> Array:
        """Return the simulated torques in the rows of (7), (r,)."""
        made = [
            torques(replace(part, tau=motion[3]), self.job.signal)
            for part, motion in zip(self.along(simulated), simulated.motions, strict=True)
        ]
        return np.concatenate(made, axis=1).reshape(-1)

    def torques_after(self, x: Array, changes: Sequence[Array]) -> list[Array] | None:
        """Return `simulated_rows` after changes of the estimated base parameters, (n,) each; None if a run ends early."""
        moved = [x + self.base.lift(self.base.unknowns.among_all(change)) for change in changes]
        runs = self.simulate_all(moved)
        made = [self.simulated_rows(run) for run in runs if isinstance(run, Simulated)]
        return made if len(made) == len(runs) else None

    # What a result says.

    def suspicions(self) -> list[Finding]:
        """Return suspected faults along the measured motion, which is independent of parameters."""
        if self.base.n_gains:
            return []
        try:
            return torque_findings(self.measured)
        except DidimError:  # such as a log without positions
            return []

    def suspected(self, system: LinearSystem, *, converged: bool) -> list[Finding]:
        """Return the suspected faults of a result's torques, unless already known."""
        if self.contradictions:
            return []
        if not converged:
            return self.suspicions()
        # With unknown gains the rows are on the motor side, and the sign of a gain is estimated.
        return torque_findings(system) if not self.base.n_gains else []

    def evidence(self, suspected: Sequence[Finding], output_error: float) -> list[Finding]:
        """Return the findings against a result."""
        updating = self.steps_follow_rates or self.method.gain_updating != "never"
        return [
            *suspected,
            *self.contradictions,
            *following_findings(output_error, updating=updating),
        ]

    def record(self) -> dict[str, Any]:
        """Return the settings of the method and of the closed loop, for the record of a result."""
        method, experiment = self.method, self.experiment
        start = method.chosen_start if isinstance(method.chosen_start, str) else "given"
        loop = self.windows[0].loop
        return {
            method.name.replace("-", "_"): {
                "start": start,
                **{key: getattr(method, key) for key in RECORDED},
            },
            "closed_loop": {
                "reference": getattr(experiment.reference, "settings", None),
                "controller": getattr(experiment.controller, "settings", None),
                "laws": loop.controller.laws.tolist(),
                "steps": loop.n_steps,
            },
        }


def _kept(window: Window, arrays: Sequence[Array], candidate: int) -> Motion:
    """Return the motion of a candidate beside the torques of a window."""
    q, dq, ddq, tau = (values[candidate][window.kept] for values in arrays)
    return q, dq, ddq, tau


def with_positions(experiment: Experiment) -> Experiment:
    """Return an experiment in which the reference replaces positions that were not measured."""
    recordings = [
        recording
        if recording.has_positions
        else replace(recording, q=np.asarray(recording.q_ref), has_positions=True)
        for recording in experiment.recordings
    ]
    return replace(experiment, recordings=tuple(recordings))
