"""DIDIM whose every iterate is a robot: (7) is solved under physical conditions in each iteration.

    x <- the consistent solution along the measured motion, or the prior
    repeat: simulate with x; W, y of (7) along that motion; x+ <- consistent least squares; x <- x + t (x+ - x)

The conditions make a convex set, so every iterate on the way is a robot and no step needs M(q) to be looked at. They also bound
the rates of the closed loop (B), so the steps of the integration follow from the iterate (C). From the third iteration
on, t is a secant step of at most 1, which ends two-cycles. Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import counted
from ...errors import DidimError, FitError
from ...experiment.experiment import Experiment
from ...loop.outcome import Outcome
from ...model.dynamics import inertia_matrix
from ...model.safe_step import thinned
from ...regression.consistent.diagnosis import diagnosis
from ...regression.consistent.solver import ConsistentSolver
from ...regression.covariance import inverse
from ...regression.fit import Fit
from ...regression.linear_system import LinearSystem
from ...regression.suspicions import suspicions
from ...result.identification import Identification
from ...result.iteration import Iteration
from ...result.status import Status
from ...signal.segments import Segment
from ..builder import fitted
from ..job import Job, ratio
from ..start import further_of, standard_start
from ..verdict.torques import contradiction_reasons, following_reasons, torque_reasons
from .convergence import SLOW, Path, best_sentence, lost_sentence, rule_sentence, slow_sentence
from .gains import with_gains
from .settings import DIDIMSettings
from .simulability import chosen_steps, damping_of, largest_rates, simulable
from .slack import Attempts, Loop, Settled, settled
from .windows import Point, Simulated, Window, motion_record, segments_of, simulated, windows_of

POSITIONS = 60
"""Positions of the log at which rates and inertias are looked at."""
SHORTEST = 0.3
"""Shortest secant step."""
RISE = 1.02
"""Factor by which the cost of the simulated torques may rise in a step."""
MOST_HALVINGS = 4
"""How often a step is halved whose run ends early or whose cost rises."""
NEAR = 3.0
"""Largest change in standard deviations at which the residual rule may end the iteration."""
LOST = 3
"""Iterations in a row, farther from the log than no torque at all and than the best one, after which the run gives up."""
ROUNDING = 1e-10
"""Share of the torques below which a residual is rounding."""
SAME = 1e-9
"""Logarithm of a factor of the gains below which it is 1."""
STARTS = ("consistent", "idim-ls")
"""Names of the consistent solution along the measured motion: the robot nearest to the estimate of IDIM-LS."""


@dataclass(frozen=True)
class Direction:
    """Solution of one iteration, as a step of the base parameters."""

    system: LinearSystem
    fit: Fit
    target: Array
    step: Array
    """Change of the estimated base parameters."""
    metric: Array
    """Inverse covariance of the estimated base parameters."""
    moved: float
    """Largest change in standard deviations."""

    @property
    def std(self) -> Array:
        """Standard deviations of the estimated base parameters."""
        return np.asarray(np.sqrt(np.diag(self.fit.covariance)))


class ConsistentRun:
    """One identification by consistent DIDIM."""

    def __init__(
        self,
        method: DIDIMSettings,
        job: Job,
        solver: ConsistentSolver,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> None:
        self.method, self.job, self.progress, self.say = method, job, progress, say
        self.robot, self.base = job.robot, job.parameters
        self.n_robot = len(job.robot.parameter_names)
        self.delay = job.delay()
        self.n_simulations = 0
        self.remarks: list[str] = []
        self.slow: tuple[str, ...] = ()
        self.prepared: dict[tuple[object, object], list[Window]] = {}
        """Windows by the steps of their loops."""
        self.experiment = job.experiment
        self._prepare(solver)

    def _prepare(self, solver: ConsistentSolver) -> None:
        """Size the prior, make up gains where they are asked for, and choose the conditions (B)."""
        job = self.job
        try:
            parts = job.parts("fit", self.delay)
        except DidimError:
            # Without positions the motion is that of the reference, as long as nothing is simulated.
            parts = self._references()
        self.measured = job.system(parts)
        q = np.concatenate([part.q for part in parts])
        self.q = np.ascontiguousarray(q[:: max(1, len(q) // POSITIONS)])
        first = solver.on(self.measured)
        direct = first(self.measured, job.settings)
        assert direct.standard is not None
        assert first.problem is not None
        self.experiment = with_gains(self.experiment, direct.standard[: self.n_robot], self.q)
        self.damping = damping_of(self._prepared(self.experiment)[0].loop.controller)
        self.solver, self.direct, self.step_s = simulable(solver, self.measured, job.settings, self.damping)
        self.remarks = diagnosis(self.measured, direct, first.problem)
        self.contradictions = tuple(self.remarks)

    def _references(self) -> list[Segment]:
        windows = self._prepared(self.experiment)
        motions = []
        for window in windows:
            q, dq, ddq = (values[window.kept] for values in window.loop.reference.at(window.loop.t))
            motions.append((q, dq, ddq, window.tau))
        return segments_of(windows, Simulated(motions, None, 0.0))

    def _prepared(self, experiment: Experiment) -> list[Window]:
        job = replace(self.job, experiment=experiment)
        return windows_of(job, self.delay, held=self.method.motion == "measured")

    def result(self) -> Identification:
        """Iterate to the end and put the result together."""
        method = self.method
        point = best = self._begin()
        first_error = point.simulated.error
        history: list[Iteration] = []
        status, ending, last_norm = Status.NOT_CONVERGED, "", np.nan
        length, before, direction, path = 1.0, None, None, Path()
        end, attempts, lost = None, Attempts(method.max_iterations), 0
        while len(history) < method.max_iterations:
            direction = self._direction(point)
            first = self._secant(direction, before, length) if len(history) >= 2 else 1.0
            length, after = self._advance(point, direction, first)
            norm = float(np.linalg.norm(direction.fit.residual))
            change, last_norm = ratio(abs(norm - last_norm), last_norm), norm
            error = ratio(norm, np.linalg.norm(direction.system.measured))
            path.add(direction.step, full=length >= 1.0)
            history.append(_entry(len(history) + 1, direction, point, after, length, change, error, path))
            stopped = self.progress(history[-1])
            if isinstance(after, Outcome):
                status = Status.NO_STEP
                self.remarks.append(f"after the shortest step tried the simulation {after}")
                break
            point, before = after, direction
            lost = lost + 1 if point.simulated.error >= max(1.0, best.simulated.error) else 0
            if point.simulated.error < best.simulated.error:
                best = point
            if stopped:
                status = Status.STOPPED
                break
            if lost == LOST:
                self.remarks.append(lost_sentence(LOST, point.simulated.error))
                break
            rested = direction.moved <= method.sigma_fraction
            steady = change <= method.tolerance and direction.moved <= NEAR
            exact = error <= ROUNDING
            if (
                len(history) >= attempts.patience
                and length >= first
                and point.simulated.error < 1.0
                and (exact or rested or steady)
            ):
                status = Status.CONVERGED
                ending = rule_sentence(
                    direction.moved, method.sigma_fraction, change, method.tolerance, exact=exact
                )
                if method.stop or len(history) >= method.max_iterations:
                    # With instruments the iteration is another one.
                    settles = method.motion == "simulated" and not exact
                    end = self._settled(point, direction, history, path) if settles else None
                    if end is None or end.reached:
                        break
                    attempts.failed(len(history))
                    if rested or attempts.exhausted or len(history) >= method.max_iterations:
                        break
                    status = Status.NOT_CONVERGED
            else:
                status = Status.NOT_CONVERGED
        assert direction is not None  # max_iterations is at least 1
        if status is Status.CONVERGED and end is not None:
            history, last = end.continued(history), end.place
            point = Point(last.x, last.simulated, len(history))
            direction = replace(direction, system=last.system, fit=last.fit)
        elif status is not Status.CONVERGED:
            point = best
            ending = best_sentence(best.iteration, len(history), best.simulated.error)
        self.say(counted(self.n_simulations, "simulation"))
        return self._finish(point, direction, status, ending, history, first_error)

    def _settled(
        self, point: Point, direction: Direction, history: list[Iteration], path: Path
    ) -> Settled | None:
        """Go on to the fixed point in a slack loop."""
        slow = path.contraction(direction.std)
        end, count = settled(
            Loop(
                self.job,
                self.windows,
                self.base,
                lambda system: self.solver(system, self.job.settings),
                self.solver.problem,
            ),
            point.x,
            point.simulated,
            slow,
            history,
            self.method.max_iterations,
            self.progress,
        )
        self.n_simulations += count
        if end is not None:
            self.slow = end.remarks
        elif slow is not None and slow.remaining_largest > SLOW:
            self.slow = (slow_sentence(slow, len(history)),)
        return end

    def _begin(self) -> Point:
        x = self._start()
        scale = self._gain_scale(x)
        found = self._simulate(x, scale)
        if isinstance(found, Outcome):
            why = "".join(f"; {sentence}" for sentence in self.remarks)
            raise FitError(
                f"consistent DIDIM cannot start from these parameters: the simulation {found}{why}"
            )
        return Point(x, found, 0)

    def _start(self) -> Array:
        """Return standard parameters to start from, those of a robot."""
        start, problem = self.method.chosen_start, self.solver.problem
        assert problem is not None
        assert self.direct.standard is not None
        if isinstance(start, str) and start in STARTS:
            return self.direct.standard
        if isinstance(start, str) and start == "prior":
            return problem.start
        x = self.base.extended(standard_start(self.robot, start), further_of(start))
        # The robot nearest to the start, in the units of the log.
        root = np.asarray(np.linalg.cholesky(inverse(self.direct.covariance)).T, dtype=np.float64)
        target = self.base.project(x)[self.job.selection.estimated]
        return problem.solve(root, root @ target).x

    def _gain_scale(self, x: Array) -> Array | None:
        """Factor of the gains in the first simulation: J(x) over that of the consistent solution; None for 1."""
        if self.method.gain_updating == "never":
            return None
        assert self.direct.standard is not None
        here, real = (
            np.diagonal(inertia_matrix(self.robot, self.q, some[: self.n_robot]), axis1=1, axis2=2).mean(
                axis=0
            )
            for some in (x, self.direct.standard)
        )
        scale = here / real
        return None if np.abs(np.log(scale)).max() < SAME else scale

    def experiment_at(self, x: Array) -> Experiment:
        """Return the experiment with made-up gains, and the steps in time that the rates of an iterate allow."""
        settings = self.experiment.simulation
        recordings = [k for k, item in enumerate(self.experiment.recordings) if item.role == "fit"]
        robots = np.unique([self.base.standard(x, number) for number in recordings], axis=0)
        coarse, fine = chosen_steps(*largest_rates(self.robot, robots, self.q, self.damping), settings)
        return replace(self.experiment, simulation=replace(settings, step_s=coarse, fine_step_s=fine))

    def _windows(self, x: Array) -> list[Window]:
        experiment = self.experiment_at(x)
        steps = experiment.simulation.step_s, experiment.simulation.fine_step_s
        if steps not in self.prepared:
            self.prepared[steps] = self._prepared(experiment)
        return self.prepared[steps]

    def _simulate(self, x: Array, scale: Array | None = None) -> Simulated | Outcome:
        self.windows = self._windows(x)
        found, count = simulated(self.windows, x, scale)
        self.n_simulations += count
        return found

    def _direction(self, point: Point) -> Direction:
        """Solve (7) along the motion of an iterate, under the conditions."""
        system, fit = self.solved(point)
        assert fit.standard is not None
        step = self.base.project(fit.standard - point.x)[self.job.selection.estimated]
        std = np.sqrt(np.diag(fit.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = np.where(std > 0.0, np.abs(step) / std, 0.0)
        return Direction(
            system, fit, fit.standard, step, inverse(fit.covariance), float(moved.max(initial=0.0))
        )

    def observed(self, point: Point) -> LinearSystem:
        """Return (7) along the motion of an iterate."""
        return self.job.system(segments_of(self.windows, point.simulated), self.base.project(point.x))

    def solved(self, point: Point) -> tuple[LinearSystem, Fit]:
        """Return the rows of an iterate, and their solution under the conditions."""
        system = self.observed(point)
        return system, self.solver(system, self.job.settings)

    def _secant(self, direction: Direction, before: Direction | None, length: float) -> float:
        """Length that would have ended the last step where its gradient vanishes; at most 1."""
        old = 0.0 if before is None else float(before.step @ direction.metric @ before.step)
        if before is None or not old > 0.0:
            return 1.0
        share = float(direction.step @ direction.metric @ before.step) / old
        return float(np.clip(length / max(1.0 - share, 1e-3), SHORTEST, 1.0))

    def _advance(self, point: Point, direction: Direction, length: float) -> tuple[float, Point | Outcome]:
        """Step towards the solution; shorter where a run ends early or the torques fit clearly worse."""
        joints = direction.system.joints
        weights = np.array([direction.fit.weights[joint.start] for joint in joints])
        cost = self._cost(point.simulated, weights)
        tried: list[tuple[float, float, Point]] = []
        ended: Outcome | None = None
        for _ in range(MOST_HALVINGS + 1):
            x = point.x + length * (direction.target - point.x) if length < 1.0 else direction.target
            found = self._simulate(x)
            if isinstance(found, Outcome):
                ended = found
                self.say(f"with a step of {length:.3g} the simulation {found}; half of it")
            else:
                after = self._cost(found, weights)
                tried.append((after, length, Point(x, found, point.iteration + 1)))
                # The first motion may be that of other gains: its cost says nothing.
                free = point.simulated.scale is not None or direction.moved <= self.method.sigma_fraction
                if free or after <= RISE * cost:
                    break
            length *= 0.5
        if not tried:
            assert ended is not None
            return 0.0, ended
        _, length, chosen = min(tried, key=lambda item: item[0])
        self.windows = self._windows(chosen.x)
        return length, chosen

    def _cost(self, found: Simulated, weights: Array) -> float:
        squares, count = 0.0, 0
        for window, motion in zip(self.windows, found.motions, strict=True):
            squares += float(np.sum(((window.tau - motion[3]) * weights) ** 2))
            count += window.tau.size
        return squares / count

    def _finish(
        self,
        point: Point,
        direction: Direction,
        status: Status,
        ending: str,
        history: list[Iteration],
        first_error: float,
    ) -> Identification:
        job, system = self.job, direction.system
        beta = self.base.project(point.x)
        estimate = beta[job.selection.estimated]
        residual = system.y - system.w @ estimate
        fit = replace(direction.fit, solution=estimate, residual=residual, standard=point.x)
        q = np.concatenate([motion[0] for motion in point.simulated.motions])
        suspected = suspicions(system, fit) if not self.remarks and status.converged else []
        result = fitted(
            job,
            self.method,
            system,
            fit,
            status=status,
            history=history,
            delay=self.delay,
            q=thinned(q, 2000),
            beta=beta,
            settings={
                **self._settings(),
                "simulated": motion_record(job, self.windows, point.simulated),
            },
            remarks=self._findings(suspected),
            evidence=[
                *torque_reasons(suspected),
                *contradiction_reasons(self.contradictions),
                *following_reasons(point.simulated.error),
            ],
            n_simulations=self.n_simulations,
            parts=segments_of(self.windows, point.simulated) if not job.parameters.n_gains else (),
        )
        if not status.converged:
            result = replace(result, covariance=np.zeros_like(result.covariance))
        return replace(result, ending=ending, output_error=(first_error, point.simulated.error))

    def _findings(self, suspected: Sequence[str]) -> list[str]:
        found = [*self.remarks, *self.slow, *suspected]
        if getattr(self.experiment.reference, "kind", "") == "measured":
            found.append(
                "the reference is the measured position: what the controller did to follow the real one is not in it, and "
                "the simulated robot follows the measured motion with an error of its own"
            )
        return found

    def _settings(self) -> dict[str, Any]:
        method, window = self.method, self.windows[0]
        start = method.chosen_start if isinstance(method.chosen_start, str) else "given"
        return {
            method.name.replace("-", "_"): {
                "physical": True,
                "start": "consistent" if start in STARTS else start,
                "tolerance": method.tolerance,
                "sigma_fraction": method.sigma_fraction,
                "max_iterations": method.max_iterations,
                "gain_updating": method.gain_updating,
                "simulable_step_s": self.step_s,
            },
            "closed_loop": {
                "reference": getattr(self.experiment.reference, "settings", None),
                "controller": getattr(self.experiment.controller, "settings", None),
                "laws": window.loop.controller.laws.tolist(),
                "steps": window.loop.schedule.steps,
            },
        }


def _entry(
    number: int,
    direction: Direction,
    point: Point,
    after: Point | Outcome,
    length: float,
    change: float,
    error: float,
    path: Path,
) -> Iteration:
    contraction = path.contraction(direction.std)
    x = after.x if isinstance(after, Point) else point.x
    return Iteration(
        iteration=number,
        relative_error=error,
        step=ratio(np.linalg.norm(x - point.x), np.linalg.norm(x)),
        more={
            "step_length": length,
            "largest_safe_step": 1.0,
            "largest_change_in_sigma": direction.moved,
            "residual_change": change,
            "output_error_before": point.simulated.error,
            "output_error_after": after.simulated.error if isinstance(after, Point) else np.nan,
            "condition_number": direction.fit.condition_number,
            "contraction": np.nan if contraction is None else contraction.rate,
            "remaining_sigma": np.nan if contraction is None else contraction.remaining_largest,
        },
    )
