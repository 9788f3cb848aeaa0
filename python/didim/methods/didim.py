"""DIDIM: closed-loop output error on the torques, by linear least squares per iteration (section IV of the paper).

The closed loop is simulated with the current parameters; the regressor along the simulated motion, filtered and decimated
in parallel with the measured torques, gives the next ones by least squares. Only torques are needed: no positions, no
velocities, no band-pass filter. Tested in ``tests/test_didim.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, ClassVar, Literal

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import DidimError, FitError
from ..experiment.experiment import Experiment
from ..loop.closed_loop import LARGE_ERROR, Outcome
from ..model.dynamics import inertia_matrix
from ..model.safe_step import safe_step, thinned
from ..regression.fit import Fit
from ..regression.linear_system import LinearSystem
from ..regression.suspicions import suspicions
from ..result.identification import Identification
from ..result.iteration import Iteration
from ..result.status import Status
from ..robot.robot import Robot
from ..signal.segments import Segment
from .builder import fitted
from .didim_windows import Simulated, Window, checked_positions, windows_of
from .idim_ls import IDIMLS
from .job import Job, ratio
from .method import FitSettings, Motion
from .start import Start, standard_start

GainUpdating = Literal["first", "always", "never"]


ROUNDING = 1e-10
"""Share of the torques below which a residual is rounding."""
CAREFUL = 2
"""Where a robot cannot be simulated, all is tried again with equal steps, so many times smaller than the smallest one before."""
MOST_HALVINGS = 20
"""How often a step is halved when the simulation after it does not reach its end."""


@dataclass(frozen=True, kw_only=True)
class DIDIM(FitSettings):
    """Settings of DIDIM, beside those of `FitSettings`.

    Parameters
    ----------
    start : str, mapping, array or Identification
        Initial parameters (`didim.methods.start.standard_start`): "unit" for (17), "idim-ls", a parameter set of the robot
        file, ...
    tolerance : float
        Stop when the norm of the residual changes by less than this share (absolute value of the change; the paper takes
        2.5 %).
    sigma_fraction : float
        Or when no parameter changes by more than this fraction of its standard deviation.
    max_iterations : int
        Least-squares solutions at most.
    gain_updating : {"first", "always", "never"}
        Scale the gains of the simulated controller by ``J(x) / J``, joint by joint, in the first simulation, also after every
        step that had to be shortened, or never; ``J`` is the mean of ``diag M(q)`` along the reference, once for the parameters
        simulated and once for the IDIM-LS estimate. A robot far from the real one then tracks like it. After a full step
        the gains are those of the controller, so that the result does not depend on it.
    margin : float
        A step that must be shortened keeps at least this share of M(q), at every position of the motion (between 0 and 1).
    stop : bool
        False to make all iterations, whatever the rule says.

    Raises
    ------
    FitError
        For a value out of its range.
    """

    name: ClassVar[str] = "didim"
    motion: ClassVar[Motion] = "simulated"

    start: Start = "unit"
    tolerance: float = 1e-3
    sigma_fraction: float = 0.3
    max_iterations: int = 20
    gain_updating: GainUpdating = "first"
    margin: float = 0.1
    stop: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, low, high in (("tolerance", 0.0, 0.025), ("sigma_fraction", 0.0, 1.0), ("margin", 0.0, 1.0)):
            value = getattr(self, key)
            number = isinstance(value, Real) and not isinstance(value, bool)
            if not number or not low <= value <= high or (key == "margin" and not 0.0 < value < 1.0):
                raise FitError(f"{key} must be between {low:g} and {high:g}, got {value!r}")
        if (
            isinstance(self.max_iterations, bool)
            or not isinstance(self.max_iterations, int)
            or self.max_iterations < 1
        ):
            raise FitError(
                f"max_iterations must be a whole number of at least 1, got {self.max_iterations!r}"
            )
        if self.gain_updating not in ("first", "always", "never"):
            raise FitError(f"gain_updating must be 'first', 'always' or 'never', got {self.gain_updating!r}")
        if not isinstance(self.stop, bool):
            raise FitError(f"stop must be True or False, got {self.stop!r}")

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
        self.direct: Identification | None = None
        """IDIM-LS estimate, where a start or the gains need it."""

    def result(self) -> Identification:
        method, job = self.method, self.job
        x = self._start()
        updating = method.gain_updating != "never"
        simulated = self._simulate(x, self._scale(x) if updating else None)
        if isinstance(simulated, Outcome):
            if self._refine():
                return self.result()
            raise self._no_start(f"the simulation {simulated}")
        first_error = simulated.error
        history: list[Iteration] = []
        status = Status.NOT_CONVERGED
        system: LinearSystem
        last_norm = np.nan
        for number in range(1, method.max_iterations + 1):
            system = self._system(simulated)
            fit = job.solve(system)
            target = job.robot.base_parameters.lift(job.selection.expand(fit.solution))
            largest = self._safe_step(simulated, x, target)
            norm = float(np.linalg.norm(fit.residual))
            std = np.sqrt(np.diag(job.selection.expand_covariance(fit.covariance)))
            with np.errstate(divide="ignore", invalid="ignore"):
                change = np.abs(job.robot.base_parameters.project(target - x)) / std
            moved = float(np.nanmax(np.where(std > 0.0, change, 0.0)))
            # What may be the last simulation has its check of the steps beside it, on another core.
            step, x_next, next_simulated = self._advance(x, target, largest, moved <= method.sigma_fraction)
            if step < largest and self._refine():
                # A step that keeps M(q) > 0 leads to a robot; that it cannot be simulated is a matter of the steps in time.
                return self.result()
            relative_change = ratio(abs(norm - last_norm), last_norm)
            error = ratio(np.linalg.norm(fit.residual), np.linalg.norm(system.measured))
            more = {
                "step_length": step,
                "largest_safe_step": largest,
                "largest_change_in_sigma": moved,
                "residual_change": relative_change,
                "output_error_before": simulated.error,
                "output_error_after": np.nan if isinstance(next_simulated, Outcome) else next_simulated.error,
                "condition_number": fit.condition_number,
            }
            history.append(
                Iteration(
                    iteration=number,
                    relative_error=error,
                    step=ratio(np.linalg.norm(x_next - x), np.linalg.norm(x_next)),
                    more=more,
                )
            )
            stopped = self.progress(history[-1])
            if isinstance(next_simulated, Outcome):
                status = Status.NO_STEP
                self.remarks.append(f"after the shortest step tried the simulation {next_simulated}")
                break
            x, simulated, last_norm = x_next, next_simulated, norm
            if stopped:
                status = Status.STOPPED
                break
            # A robot that flounders may have steady residuals; it is further from the log than no torque at all.
            sound = step == 1.0 and simulated.error < 1.0
            # Without noise the residual, and the sigmas made of it, end as rounding.
            exact = error <= ROUNDING
            if sound and (exact or moved <= method.sigma_fraction or relative_change <= method.tolerance):
                status = Status.CONVERGED
                if self.usual is not None:
                    # On with the steps of the experiment: the result must not tell from where it was come to.
                    small, self.windows, self.usual = self.windows, self.usual, None
                    again = self._simulate(x, None)
                    if not isinstance(again, Outcome):
                        simulated, status = again, Status.NOT_CONVERGED
                        continue
                    self.windows = small
                if method.stop:
                    break
            else:
                status = Status.NOT_CONVERGED
        self.say(counted(self.n_simulations, "simulation"))
        beta = job.robot.base_parameters.project(x)
        # Of a shortened step the parameters are not those of the solution: neither are their errors.
        fit = replace(fit, residual=system.y - system.w @ beta[job.selection.estimated])
        findings = self._findings(system, fit, simulated, x, status)
        q = np.concatenate([motion[0] for motion in simulated.motions])
        return replace(
            fitted(
                job,
                method,
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
            ),
            output_error=(first_error, simulated.error),
        )

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
                return found if isinstance(found, Outcome) else replace(found, finer=finer.result())
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

    def _safe_step(self, simulated: Simulated, x: Array, target: Array) -> float:
        """Return the largest step towards the least-squares solution that keeps M(q) positive definite along the motion."""
        q = checked_positions(np.concatenate([motion[0] for motion in simulated.motions]))
        return safe_step(self.robot, q, x, target, self.method.margin)

    def _advance(
        self, x: Array, target: Array, largest: float, checked: bool
    ) -> tuple[float, Array, Simulated | Outcome]:
        """Go towards the target as far as it is safe and the simulation reaches its end; stay where no step does."""
        step = largest
        for _ in range(MOST_HALVINGS):
            x_next = x + step * (target - x) if step < 1.0 else target
            # With "first" the scale has served its turn; after a full step it would only spoil known gains.
            updating = self.method.gain_updating == "always" and step < 1.0
            found = self._simulate(x_next, self._scale(x_next) if updating else None, checked)
            if not isinstance(found, Outcome):
                return step, x_next, found
            self.say(f"with a step of {step:.3g} the simulation {found}; half of it")
            step *= 0.5
        return 0.0, x, found

    def _suspicions(self) -> list[str]:
        """Return what looks wrong along the measured motion, which no wrong parameter spoils."""
        try:
            return list(self._idim_ls().remarks)
        except DidimError:
            return []

    def _findings(
        self, system: LinearSystem, fit: Fit, simulated: Simulated, x: Array, status: Status
    ) -> list[str]:
        """Sentences on what a reader must know: suspicions, the step of the integration, the reference."""
        found = suspicions(system, fit) if status.converged else self._suspicions()
        suspected = bool(found)
        found += self.remarks
        if simulated.error >= 1.0:
            hint = ", or let gain_updating be 'first'" if self.method.gain_updating == "never" else ""
            found.append(
                f"with these parameters the robot does not follow: its torques are off by {100.0 * simulated.error:.3g} %; check "
                f"the controller, start elsewhere{hint}"
            )
        motion = simulated.motions[0]
        fine = self._finer(x, simulated.scale) if simulated.finer is None else simulated.finer
        error = np.sqrt(np.mean((fine - motion[3]) ** 2, axis=0))
        size = np.sqrt(np.mean(fine**2, axis=0))
        # A wrong log leads to robots that no step is small enough for.
        if not suspected and not np.all(error <= LARGE_ERROR * size):
            found.append(_step_sentence(error, size))
        if getattr(self.job.experiment.reference, "kind", "") == "measured":
            found.append(
                "the reference is the measured position: what the controller did to follow the real one is not in it, and "
                "the simulated robot follows the measured motion with an error of its own"
            )
        return found

    def _settings(self) -> dict[str, Any]:
        method = self.method
        experiment = self.job.experiment
        start = method.start if isinstance(method.start, str) else "given"
        return {
            "didim": {
                "start": start,
                "tolerance": method.tolerance,
                "sigma_fraction": method.sigma_fraction,
                "max_iterations": method.max_iterations,
                "gain_updating": method.gain_updating,
                "margin": method.margin,
            },
            "closed_loop": {
                "reference": getattr(experiment.reference, "settings", None),
                "controller": getattr(experiment.controller, "settings", None),
                "laws": self.windows[0].loop.law.laws.tolist(),
                "steps": self.windows[0].loop.schedule.steps,
            },
        }


def _step_sentence(error: Array, size: Array) -> str:
    if not np.isfinite(error).all():
        return "the integration step is too large: with half of it the simulation ends early; reduce step_s and fine_step_s"
    joint = int(np.argmax(np.divide(error, size, out=np.full_like(error, np.inf), where=size > 0.0)))
    return (
        f"the integration step is too large: halving it changes the torque of joint {joint + 1} by {error[joint]:.2g} rms of "
        f"{size[joint]:.2g}; reduce step_s and fine_step_s in [simulation]"
    )
