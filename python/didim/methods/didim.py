"""DIDIM: closed-loop output error on the torques, by linear least squares per iteration (section IV of the paper).

The closed loop is simulated with the current parameters; the regressor along the simulated motion, filtered and decimated
in parallel with the measured torques, gives the next ones by least squares. Only torques are needed: no positions, no
velocities, no band-pass filter. Tested in ``tests/test_didim.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from .._tools.words import counted, listing
from ..errors import DidimError, FitError, RankError
from ..experiment.experiment import Experiment
from ..loop.closed_loop import LARGE_ERROR, Outcome, SimulationStatus
from ..model.dynamics import inertia_matrix
from ..model.safe_step import safe_step, thinned
from ..regression.fit import Fit
from ..regression.least_squares import solve_partly
from ..regression.linear_system import LinearSystem
from ..regression.suspicions import suspicions
from ..result.identification import Identification
from ..result.iteration import Iteration
from ..result.status import Status
from ..robot.robot import Robot
from ..signal.segments import Segment
from .builder import fitted
from .didim_convergence import (
    Path,
    best_sentence,
    rule_sentence,
    slow_sentence,
    step_sentence,
    stuck_sentence,
)
from .didim_settings import DIDIMSettings
from .didim_windows import Point, Simulated, Solved, Window, checked_positions, windows_of
from .idim_ls import IDIMLS
from .job import Job, ratio
from .start import standard_start

RECORDED = ("tolerance", "sigma_fraction", "max_iterations", "gain_updating", "margin")
"""Settings in the record of a result, beside the start."""
ROUNDING = 1e-10
"""Share of the torques below which a residual is rounding."""
CAREFUL = 2
"""Where a robot cannot be simulated, all is tried again with equal steps, so many times smaller than the smallest one before."""
SLOW = 0.3
"""Remaining distance, in standard deviations, beyond which a result says that the iteration contracts slowly."""
MOST_HALVINGS = 20
"""How often a step is halved when the simulation after it does not reach its end."""


class DIDIM(DIDIMSettings):
    """DIDIM with its settings, those of `DIDIMSettings` and `FitSettings`."""

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify the parameters of an experiment's robot; parameters as for `IDIMLS.run`.

        Raises
        ------
        DidimError
            One of its kinds: without a reference or a controller, for a start with which the robot cannot be simulated,
            for a log that allows no estimate.
        """
        job = self.job(experiment, experiment.simulation.robot(experiment.robot))
        return _Run(self, job, progress, say).result()


class _Run:
    """One identification."""

    def __init__(
        self, method: DIDIM, job: Job, progress: Callable[[Iteration], bool], say: Callable[[str], None]
    ) -> None:
        self.method, self.job, self.progress, self.say = method, job, progress, say
        self.robot: Robot = job.robot
        self.delay = job.delay()
        self.windows = windows_of(job, self.delay.samples)
        self.n_simulations = 0
        self.remarks: list[str] = []
        self.refined = False
        self.usual: list[Window] | None = None
        """The windows with the steps of the experiment, while smaller ones are taken."""
        self.stuck: dict[int, str] = {}
        """Parameters that the simulated motion did not identify, by iteration."""
        self.direct: Identification | None = None
        """IDIM-LS estimate, where a start or the gains need it."""

    def result(self) -> Identification:
        method = self.method
        point = best = self._begin()
        first_error = point.simulated.error
        history: list[Iteration] = []
        path = Path()
        status, ending = Status.NOT_CONVERGED, ""
        last_norm = np.nan
        while len(history) < method.max_iterations:
            solved = self._solve(point)
            largest = self._safe_step(point, solved.target)
            moved = self._in_sigma(solved, solved.target - point.x)
            # What may be the last simulation has its check of the steps beside it, on another core.
            step, after = self._advance(point, solved.target, largest, moved <= method.sigma_fraction)
            if step < largest and self._refine():
                # A step that keeps M(q) > 0 leads to a robot; that it cannot be simulated is a matter of the steps in time.
                again = self._simulate(point.x, point.simulated.scale)
                if isinstance(again, Simulated):
                    point = replace(point, simulated=again)
                    continue
            norm = float(np.linalg.norm(solved.fit.residual))
            relative_change = ratio(abs(norm - last_norm), last_norm)
            error = ratio(norm, np.linalg.norm(solved.system.measured))
            x_next = after.x if isinstance(after, Point) else point.x
            path.add(self.robot.base_parameters.project(x_next - point.x), full=step == 1.0)
            contraction = path.contraction(solved.std)
            history.append(
                Iteration(
                    iteration=len(history) + 1,
                    relative_error=error,
                    step=ratio(np.linalg.norm(x_next - point.x), np.linalg.norm(x_next)),
                    more={
                        "step_length": step,
                        "largest_safe_step": largest,
                        "largest_change_in_sigma": moved,
                        "residual_change": relative_change,
                        "output_error_before": point.simulated.error,
                        "output_error_after": after.simulated.error if isinstance(after, Point) else np.nan,
                        "condition_number": solved.fit.condition_number,
                        "contraction": np.nan if contraction is None else contraction.rate,
                        "remaining_sigma": np.nan if contraction is None else contraction.remaining_largest,
                    },
                )
            )
            stopped = self.progress(history[-1])
            if isinstance(after, Outcome):
                status = Status.NO_STEP
                self.remarks.append(f"after the shortest step tried the simulation {after}")
                break
            point, last_norm = after, norm
            if point.simulated.error < best.simulated.error:
                best = point
            if stopped:
                status = Status.STOPPED
                break
            # A diverging robot may have steady residuals; it is further from the log than no torque at all.
            sound = step == 1.0 and point.simulated.error < 1.0 and not solved.kept
            # Without noise the residual, and the sigmas made of it, end as rounding.
            exact = error <= ROUNDING
            if sound and (exact or moved <= method.sigma_fraction or relative_change <= method.tolerance):
                status = Status.CONVERGED
                ending = rule_sentence(
                    moved, method.sigma_fraction, relative_change, method.tolerance, exact=exact
                )
                if self.usual is not None:
                    # Repeat the last iterations with the experiment's own steps, so the result does not depend on the start.
                    small, self.windows, self.usual = self.windows, self.usual, None
                    again = self._simulate(point.x, None)
                    if isinstance(again, Simulated):
                        point, status = replace(point, simulated=again), Status.NOT_CONVERGED
                        continue
                    self.windows = small
                if method.stop:
                    break
            else:
                status = Status.NOT_CONVERGED
        self.say(counted(self.n_simulations, "simulation"))
        if status is Status.CONVERGED:
            # Of the last solution; a shortened step cannot be the last.
            slow = path.contraction(solved.std)
            if slow is not None and slow.remaining_largest > SLOW and not exact:
                self.remarks.append(slow_sentence(slow, len(history)))
            return self._finish(point, solved, status, ending, history, first_error)
        ending = best_sentence(best.iteration, len(history), best.simulated.error)
        return self._finish(best, self._solve(best), status, ending, history, first_error)

    def _finish(
        self,
        point: Point,
        solved: Solved,
        status: Status,
        ending: str,
        history: Sequence[Iteration],
        first_error: float,
    ) -> Identification:
        """Put together the result at a point, with the errors of its parameters; without standard deviations unless converged."""
        job, system = self.job, solved.system
        beta = job.robot.base_parameters.project(point.x)
        fit = replace(solved.fit, residual=system.y - system.w @ beta[job.selection.estimated])
        findings = self._findings(system, fit, point, status)
        q = np.concatenate([motion[0] for motion in point.simulated.motions])
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
            settings=self._settings(),
            remarks=findings,
            n_simulations=self.n_simulations,
        )
        if not status.converged:
            # (10) holds at the minimum: of any other point it says nothing.
            result = replace(result, covariance=np.zeros_like(result.covariance))
        return replace(result, ending=ending, output_error=(first_error, point.simulated.error))

    def _begin(self) -> Point:
        """Return the start with its simulation, with smaller steps in time where those of the experiment do not do."""
        x = self._start()
        scale = self._scale(x) if self.method.gain_updating != "never" else None
        simulated = self._simulate(x, scale)
        if isinstance(simulated, Outcome) and self._refine():
            simulated = self._simulate(x, scale)
        if isinstance(simulated, Outcome):
            raise self._no_start(f"the simulation {simulated}")
        return Point(x, simulated, 0)

    def _solve(self, point: Point) -> Solved:
        """Solve (7) along the motion of a point.

        Parameters that this motion does not identify, because simulated joints stick in friction, keep the values of the point;
        it is the log that lacks them only if the measured motion does not identify them either.
        """
        job = self.job
        system = self._system(point.simulated)
        try:
            fit = job.solve(system)
            kept: tuple[int, ...] = ()
        except RankError as reason:
            self._blame_log()
            values = job.robot.base_parameters.project(point.x)[job.selection.estimated]
            fit, kept = solve_partly(system, job.solve, values, reason.columns)
            self.stuck[point.iteration] = listing([system.names[column] for column in kept])
        target = job.robot.base_parameters.lift(job.selection.expand(fit.solution))
        std = np.sqrt(np.diag(job.selection.expand_covariance(fit.covariance)))
        return Solved(system, fit, target, std, kept)

    def _blame_log(self) -> None:
        """Raise the error of a log whose measured motion does not identify all parameters either."""
        try:
            self._idim_ls()
        except RankError:
            raise
        except DidimError:
            return  # the measured motion says nothing

    def _in_sigma(self, solved: Solved, step: Array) -> float:
        """Largest change of a base parameter, in standard deviations."""
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.abs(self.robot.base_parameters.project(step)) / solved.std
        return float(np.nanmax(np.where(solved.std > 0.0, change, 0.0)))

    def _refine(self) -> bool:
        """Take small steps everywhere, once, unless it is the log that looks wrong.

        Those of the experiment suit the robot of the log and its motion; one that feels less inertia is stiff elsewhere too.
        """
        if self.refined or self._suspicions():
            return False
        self.refined, self.usual = True, self.windows
        smallest = min(min(window.loop.steps[0], *window.loop.steps[1]) for window in self.windows) / CAREFUL
        self.windows = [replace(window, loop=window.loop.even(smallest)) for window in self.windows]
        self.remarks.append(
            "from this start the simulation fails with the steps of the experiment: until the end is near they are "
            f"{1e3 * smallest:.3g} ms throughout"
        )
        self.say(self.remarks[-1])
        return True

    def _start(self) -> Array:
        base = self.robot.base_parameters
        if isinstance(self.method.start, str) and self.method.start == "idim-ls":
            x = self._idim_ls().parameters
        else:
            x = standard_start(self.robot, self.method.start)
        beta = base.project(x)
        beta[[role != "estimated" for role in self.job.selection.roles]] = 0.0
        x = base.lift(beta + self.job.selection.values)
        q = np.concatenate([window.loop.motion.at(window.loop.t)[0] for window in self.windows])
        smallest = _core.smallest_eigenvalue(self.robot.core, checked_positions(q), x)
        if smallest is not None and not smallest[1] > 0.0:
            raise self._no_start(
                f"M(q) is not positive definite on the reference (smallest eigenvalue {smallest[1]:.3g})"
            )
        return x

    def _no_start(self, reason: str) -> FitError:
        # A log that is wrong makes IDIM-LS wrong, which may be the start and scales the gains.
        why = "".join(f"; {sentence}" for sentence in self._suspicions())
        return FitError(f"DIDIM cannot start from these parameters: {reason}{why}")

    def _idim_ls(self) -> Identification:
        if self.direct is None:
            method = self.method
            idim = IDIMLS(
                weights=method.weights,
                reweightings=method.reweightings,
                variance=method.variance,
                decimation_corrected=method.decimation_corrected,
                signal=method.signal,
                compensate_samples=self.delay.samples,
                fixed=method.fixed,
                dropped=method.dropped,
            )
            self.direct = idim.run(self.job.experiment, lambda iteration: False, self.say)
        return self.direct

    def _scale(self, x: Array) -> Array:
        """Factor of the gains of each joint: J(x) over the J of the IDIM-LS estimate."""
        q = checked_positions(
            np.concatenate([window.loop.motion.at(window.loop.t)[0] for window in self.windows])
        )
        here, real = (
            np.diagonal(inertia_matrix(self.robot, q, parameters), axis1=1, axis2=2).mean(axis=0)
            for parameters in (x, self._idim_ls().parameters)
        )
        return np.where((real > 0.0) & (here > 0.0), here / np.where(real > 0.0, real, 1.0), 1.0)

    def _simulate(self, x: Array, scale: Array | None, checked: bool = False) -> Simulated | Outcome:
        if checked:
            from concurrent.futures import ThreadPoolExecutor

            with ThreadPoolExecutor(1) as other:
                finer = other.submit(self._finer, x, scale)
                found = self._simulate(x, scale)
                fine = finer.result()
            self.n_simulations += 1
            return found if isinstance(found, Outcome) else replace(found, finer=fine)
        motions, squares, size = [], 0.0, 0.0
        for window in self.windows:
            arrays, outcomes = window.loop.run(x[None], gain_scale=None if scale is None else scale[None])
            self.n_simulations += 1
            if not outcomes[0].completed:
                return outcomes[0]
            q, dq, ddq, tau = (values[0][window.kept] for values in arrays)
            motions.append((q, dq, ddq, tau))
            squares += float(np.sum((window.tau - tau) ** 2))
            size += float(np.sum(window.tau**2))
        return Simulated(motions, scale, ratio(np.sqrt(squares), np.sqrt(size)))

    def _finer(self, x: Array, scale: Array | None) -> Array:
        """Torques along the first window, simulated with half the steps; NaN after an early end."""
        window = self.windows[0]
        arrays, _ = window.loop.divided(2).run(x[None], gain_scale=None if scale is None else scale[None])
        return np.asarray(arrays[3][0][window.kept])

    def _system(self, simulated: Simulated) -> LinearSystem:
        parts = [
            Segment(
                name=window.name,
                place=window.place,
                recording=window.recording,
                window=window.window,
                rate_hz=window.loop.rate_hz,
                q=np.ascontiguousarray(q),
                dq=np.ascontiguousarray(dq),
                ddq=np.ascontiguousarray(ddq),
                tau=window.tau,
            )
            for window, (q, dq, ddq, _) in zip(self.windows, simulated.motions, strict=True)
        ]
        return self.job.system(parts)

    def _safe_step(self, point: Point, target: Array) -> float:
        """Return the largest step towards the least-squares solution that keeps M(q) positive definite along the motion."""
        q = checked_positions(np.concatenate([motion[0] for motion in point.simulated.motions]))
        return safe_step(self.robot, q, point.x, target, self.method.margin)

    def _advance(
        self, point: Point, target: Array, largest: float, checked: bool
    ) -> tuple[float, Point | Outcome]:
        """Go towards the target as far as it is safe and the simulation reaches its end; stay where no step does."""
        step, ended = largest, Outcome(SimulationStatus.DIVERGED)
        for _ in range(MOST_HALVINGS):
            x_next = point.x + step * (target - point.x) if step < 1.0 else target
            # With "first" the scale has served its turn; after a full step it would only spoil known gains.
            updating = self.method.gain_updating == "always" and step < 1.0
            found = self._simulate(x_next, self._scale(x_next) if updating else None, checked)
            if isinstance(found, Simulated):
                return step, Point(x_next, found, point.iteration + 1)
            ended = found
            self.say(f"with a step of {step:.3g} the simulation {found}; half of it")
            step *= 0.5
        return 0.0, ended

    def _suspicions(self) -> list[str]:
        """Return what looks wrong along the measured motion, which no wrong parameter spoils."""
        try:
            return list(self._idim_ls().remarks)
        except DidimError:
            return []

    def _findings(self, system: LinearSystem, fit: Fit, point: Point, status: Status) -> list[str]:
        """Sentences on what a reader must know: suspicions, the step of the integration, the reference."""
        found = suspicions(system, fit) if status.converged else self._suspicions()
        suspected = bool(found)
        found += self.remarks
        if self.stuck:
            found.append(stuck_sentence(self.stuck))
        simulated = point.simulated
        if simulated.error >= 1.0:
            hint = ", or let gain_updating be 'first'" if self.method.gain_updating == "never" else ""
            found.append(
                f"with these parameters the robot does not follow: its torques are off by {100.0 * simulated.error:.3g} %; check "
                f"the controller, start elsewhere{hint}"
            )
        motion = simulated.motions[0]
        fine = simulated.finer
        if fine is None:
            fine = self._finer(point.x, simulated.scale)
            self.n_simulations += 1
        error = np.sqrt(np.mean((fine - motion[3]) ** 2, axis=0))
        size = np.sqrt(np.mean(fine**2, axis=0))
        # With a wrong log no step is small enough.
        if not suspected and not np.all(error <= LARGE_ERROR * size):
            found.append(step_sentence(error, size))
        if getattr(self.job.experiment.reference, "kind", "") == "measured":
            found.append(
                "the reference is the measured position: what the controller did to follow the real one is not in it, and "
                "the simulated robot follows the measured motion with an error of its own"
            )
        return found

    def _settings(self) -> dict[str, Any]:
        method, experiment = self.method, self.job.experiment
        start = method.start if isinstance(method.start, str) else "given"
        return {
            "didim": {"start": start, **{key: getattr(method, key) for key in RECORDED}},
            "closed_loop": {
                "reference": getattr(experiment.reference, "settings", None),
                "controller": getattr(experiment.controller, "settings", None),
                "laws": self.windows[0].loop.law.laws.tolist(),
                "steps": self.windows[0].loop.schedule.steps,
            },
        }
