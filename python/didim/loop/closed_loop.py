"""A robot with its controller and reference, ready to run one candidate or thousands at once.

Runge-Kutta in the core, candidates side by side in the lanes of vector registers and on all cores. Limbs are simulated apart,
each with its own steps, because neither torque nor motion of one depends on the others. Tested in ``tests/test_simulation.py``,
``tests/test_integrator.py`` and ``tests/test_limbs.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

import didim._core as _core

from .._tools.arrays import Array, real_array, rms
from .._tools.settings import one_of, whole
from .._tools.threads import MOST_THREADS, core_threads
from ..errors import CoreErrorsAs, SimulationError
from ..model.limbs import Limb, limbs_of
from ..robot.robot import Robot
from .controller import Controller
from .memory import BALANCE, ControllerMemory
from .outcome import IntegrationError, Outcome, SimulationStatus, first_to_end, outcomes_of
from .reference import Reference

STEP = 5e-4
"""Default of the largest step (s) where friction is smooth."""
FINE_STEP = 1e-4
"""Default of the largest step (s) where a velocity is near zero: a TX40 is stiff there."""
SIGN_STEP = 2e-4
"""Default of the largest step (s) with ``sign`` friction."""
NEAR_ZERO = 10.0
"""Bound of a velocity near zero, as a multiple of the smoothing velocity of friction, where the reference gives the speed."""
NEAR_ZERO_MEASURED = 5.0
"""The same where the measured motion gives the speed."""
MOST_RECORDS = 20_000_000
"""Largest number of recorded values per quantity, and of events of a run: more indicate a wrong rate or step."""
FINEST = 1e-4
"""Smallest fine step as a share of the step: a run only reacts (to Ctrl-C, for example) between two steps."""
INTEGRATORS = ("rk4", "imex")
"""Integration methods: classical Runge-Kutta, and one that treats the steep part of friction implicitly."""
SIGNALS = ("q", "dq", "ddq", "tau")
"""Signals of a run: positions, velocities, accelerations and torques."""
DIVERGENCE = 100.0
"""Tracking error (rad or m) from which a simulation counts as diverged."""

Known = tuple[Sequence[Array], NDArray[np.bool_]]
"""Trajectories of an earlier run, (n_candidates, n_records, n_dof) each, and the joints that still move so, (n_dof,)."""


@dataclass(frozen=True, eq=False)
class CoreLoop:
    """A closed loop in objects of the core."""

    robot: _core.Robot
    reference: _core.Reference
    controller: _core.Controller
    schedule: _core.Schedule
    start: tuple[Sequence[float], Sequence[float]] | None
    memory: tuple[str, list[float], list[float] | None, list[float] | None]
    external: tuple[float, Array] | None
    divergence: float
    implicit_friction: bool


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A robot with its controller and reference, ready to run any number of candidates.

    Attributes
    ----------
    robot : Robot
        The robot.
    reference : Reference
        Reference motion.
    controller : Controller
        Controller.
    rate_hz : float
        Records per second.
    n_records : int
        Number of records.
    steps : (float, list of float)
        Largest step, and largest step of each joint where its velocity is near zero (s).
    motion : Reference or None
        Motion whose velocities near zero have fine steps; that of the reference by default.
    parts : int
        Number of parts that each step is divided into.
    start : (q, dq) or None
        Positions and velocities at time 0; the reference's by default.
    external : (rate_hz, (n_samples, n_dof) array) or None
        External torque on the joints (N.m, N).
    divergence : float
        Tracking error (rad or m) that ends a run.
    memory : ControllerMemory
        State of the controller at time 0.
    integrator : {"rk4", "imex"}
        Method of the integration.
    """

    robot: Robot
    reference: Reference
    controller: Controller
    rate_hz: float
    n_records: int
    steps: tuple[float, Sequence[float]]
    motion: Reference | None = None
    parts: int = 1
    start: tuple[Sequence[float], Sequence[float]] | None = None
    external: tuple[float, Array] | None = None
    divergence: float = DIVERGENCE
    memory: ControllerMemory = BALANCE
    integrator: str = "rk4"

    @property
    def core(self) -> CoreLoop:
        """The closed loop in the format of the core."""
        return CoreLoop(
            self.robot.core,
            self.reference.core,
            self.controller.core,
            self.schedule,
            self.start,
            self.memory.core,
            self.external,
            self.divergence,
            self.integrator == "imex",
        )

    @cached_property
    def schedule(self) -> _core.Schedule:
        """Time steps of the whole robot."""
        robot, controller = self.robot, self.controller
        _check_steps(self.steps, controller.core.period, (self.n_records - 1) / self.rate_hz)
        near = NEAR_ZERO if self.motion is None else NEAR_ZERO_MEASURED
        if robot.friction.coulomb != "tanh":
            near = 0.0
        with CoreErrorsAs(SimulationError):
            schedule = _core.Schedule(
                robot.core,
                self.reference.core,
                rate=self.rate_hz,
                records=self.n_records,
                period=controller.core.period,
                coarse=self.steps[0],
                fine=self.steps[1],
                slow=[near * value for value in robot.friction.smoothing],
                motion=None if self.motion is None else self.motion.core,
            )
        return schedule if self.parts == 1 else schedule.divided(self.parts)

    @cached_property
    def limbs(self) -> tuple[tuple[Limb, ClosedLoop], ...]:
        """Limbs of the robot with their loops; empty for a single limb, and if the motions cannot be divided."""
        limbs, motions = limbs_of(self.robot), [self.reference, self.motion or self.reference]
        if len(limbs) == 1 or not all(motion.divisible for motion in motions):
            return ()
        return tuple((limb, self._of_limb(limb)) for limb in limbs)

    def _of_limb(self, limb: Limb) -> ClosedLoop:
        joints, start, external = list(limb.joints), self.start, self.external
        return replace(
            self,
            robot=limb.robot,
            reference=self.reference.of_joints(joints),
            controller=self.controller.of_joints(joints),
            steps=(self.steps[0], [self.steps[1][joint] for joint in joints]),
            motion=None if self.motion is None else self.motion.of_joints(joints),
            start=None if start is None else ([start[0][j] for j in joints], [start[1][j] for j in joints]),
            external=None if external is None else (external[0], external[1][:, joints]),
            memory=self.memory.of_joints(joints),
        )

    @property
    def n_steps(self) -> int:
        """Steps of a run; of the limb that takes most."""
        return max((loop.n_steps for _, loop in self.limbs), default=0) or self.schedule.steps

    @property
    def t(self) -> Array:
        """Instants of the records (s)."""
        return np.arange(self.n_records) / self.rate_hz

    @classmethod
    def of(  # many parameters: those of `simulate`
        cls,
        robot: Robot,
        reference: Reference,
        controller: Controller,
        *,
        rate_hz: float | None = None,
        duration_s: float | None = None,
        step: float | None = None,
        fine_step: float | Sequence[float] | None = None,
        start: tuple[ArrayLike, ArrayLike] | None = None,
        external: tuple[float, ArrayLike] | None = None,
        divergence: float = DIVERGENCE,
        memory: ControllerMemory = BALANCE,
        integrator: str = "rk4",
    ) -> ClosedLoop:
        """Choose the steps, and check that all parts fit together. Parameters as for `simulate`."""
        n = robot.n_dof
        for what, got in (("reference", reference.n_dof), ("controller", controller.n_dof)):
            if got != n:
                raise SimulationError(f"the {what} has {got} joints and robot {robot.name!r} has {n}")
        rate = 1000.0 if rate_hz is None else float(rate_hz)
        duration = reference.duration if duration_s is None else float(duration_s)
        if not (np.isfinite(rate) and rate > 0.0):
            raise SimulationError(f"rate_hz must be positive, got {rate_hz}")
        if not (np.isfinite(duration) and duration > 0.0 and duration * rate * n <= MOST_RECORDS):
            raise SimulationError(
                f"duration_s must be positive and make at most {MOST_RECORDS} records of all joints, "
                f"got {duration} s at {rate:g} Hz"
            )
        if not divergence > 0.0:
            raise SimulationError(f"divergence must be positive, got {divergence}")
        one_of("integrator", integrator, INTEGRATORS, SimulationError)
        if integrator == "imex":
            _check_friction(robot)
        records = int(np.floor(duration * rate * (1.0 + 1e-12) + 1e-9)) + 1
        coarse = step if step is not None else (STEP if robot.friction.coulomb == "tanh" else SIGN_STEP)
        if fine_step is None:  # implicit friction needs no finer step near zero velocities
            fine_step = coarse if integrator == "imex" else min(coarse, FINE_STEP)
        fine = np.atleast_1d(fine_step)
        if fine.shape not in ((1,), (n,)):
            raise SimulationError(f"fine_step must be one number or {n}, one per joint, got {fine_step!r}")
        steps = (float(coarse), np.broadcast_to(fine, n).astype(np.float64).tolist())
        return cls(
            robot,
            reference,
            controller,
            rate,
            records,
            steps,
            start=None if start is None else _state(start, n),
            external=None if external is None else _push(external, n),
            divergence=float(divergence),
            memory=memory.checked(controller),
            integrator=integrator,
        )._checked()

    def along(self, motion: Reference) -> ClosedLoop:
        """Return the same loop with fine steps where a motion has velocities near zero.

        By default the reference determines these intervals, but the robot lags behind it. The measured motion, or that of an
        earlier run, shows the reversals better.
        """
        return replace(self, motion=motion, parts=1)._checked()

    def even(self, step: float) -> ClosedLoop:
        """Return the same loop with steps of at most `step` (s) throughout."""
        return replace(self, steps=(step, [step] * self.robot.n_dof), motion=None, parts=1)._checked()

    def divided(self, parts: int) -> ClosedLoop:
        """Return the same loop with every step divided into `parts`."""
        return replace(self, parts=parts * self.parts)

    def _checked(self) -> ClosedLoop:
        """Return itself, if its steps are possible."""
        self.schedule  # noqa: B018 - a wrong one must fail here
        return self

    def run(
        self,
        x: Array,
        *,
        gain_scale: Array | None = None,
        threads: int | None = None,
        signals: Collection[str] = SIGNALS,
        known: Known | None = None,
    ) -> tuple[list[Array], tuple[Outcome, ...]]:
        """Trajectories of candidates, each (n_candidates, n_records, n_dof) and NaN from an early end on, and their outcomes.

        Parameters
        ----------
        x : (n_candidates, n_parameters) array
            Standard parameters.
        gain_scale : (n_candidates, n_dof) array, optional
            Factor of the controller's gains (gain updating).
        threads : int, optional
            All cores by default; the bits do not depend on it.
        signals : collection of str
            Those of `SIGNALS` that are returned, in their order.
        known : (list of arrays, (n_dof,) array of bool), optional
            Trajectories of an earlier run, and joints of whole limbs that move as in it, which are not run again.
        """
        scale = self._scale_of(x, gain_scale, threads)
        if self.limbs:
            arrays, outcomes = self._run_limbs(x, scale, threads, signals, known)
        else:
            wanted = [name in signals for name in SIGNALS]
            with CoreErrorsAs(SimulationError):
                arrays, endings = _core.simulate(self.core, x, scale, core_threads(threads), wanted)
            outcomes = outcomes_of(endings)
        for candidate, outcome in enumerate(outcomes):
            if outcome.time_s is not None:
                # After its end a run continues with its neighbours in the lanes; its later values are invalid.
                ended = self.t >= outcome.time_s - 1e-6 / self.rate_hz
                for values in arrays:
                    values[candidate, ended] = np.nan
        return arrays, outcomes

    def _run_limbs(
        self, x: Array, scale: Array, threads: int | None, signals: Collection[str], known: Known | None
    ) -> tuple[list[Array], tuple[Outcome, ...]]:
        arrays = [np.empty((len(x), self.n_records, self.robot.n_dof)) for _ in signals]
        endings = [(Outcome(SimulationStatus.COMPLETED),) * len(x)]
        for joints, own, loop in self._limbs(x):
            if known is not None and known[1][joints].all():
                for values, part in zip(arrays, known[0], strict=True):
                    values[..., joints] = part[..., joints]
                continue
            gains = scale[:, joints].copy()
            parts, outcomes = loop.run(own, gain_scale=gains, threads=threads, signals=signals)
            for values, part in zip(arrays, parts, strict=True):
                values[..., joints] = part
            endings.append(tuple(outcome.of_limb(joints) for outcome in outcomes))
        return arrays, tuple(map(first_to_end, zip(*endings, strict=True)))

    def _limbs(self, x: Array) -> Iterator[tuple[list[int], Array, ClosedLoop]]:
        """Give joints, parameters of the candidates, and closed loop of each limb."""
        count = len(self.robot.parameter_names)
        if x.shape[1] != count:
            raise SimulationError(f"x needs {count} parameters per candidate, got {x.shape[1]}")
        for limb, loop in self.limbs:
            yield list(limb.joints), np.ascontiguousarray(x[:, limb.indices]), loop

    def costs(
        self,
        x: Array,
        q: Array,
        tau: Array,
        *,
        weight_q: Array,
        weight_tau: Array,
        gain_scale: Array | None = None,
        threads: int | None = None,
    ) -> tuple[Array, tuple[Outcome, ...]]:
        """Weighted sums of squared errors of candidates, (n_candidates,), infinite where a run ended early.

        Parameters
        ----------
        x, gain_scale, threads
            As for `run`.
        q, tau : (n_records, n_dof) arrays
            Measurements for the comparison.
        weight_q, weight_tau : (n_dof,) arrays
            Weights of squared position and torque errors.
        """
        scale = self._scale_of(x, gain_scale, threads)
        if self.limbs:
            total, ended = np.zeros(len(x)), []
            for joints, own, loop in self._limbs(x):
                part, outcomes = loop.costs(
                    own,
                    np.ascontiguousarray(q[:, joints]),
                    np.ascontiguousarray(tau[:, joints]),
                    weight_q=weight_q[joints],
                    weight_tau=weight_tau[joints],
                    gain_scale=scale[:, joints].copy(),
                    threads=threads,
                )
                total += part
                ended.append([outcome.of_limb(joints) for outcome in outcomes])
            return total, tuple(map(first_to_end, zip(*ended, strict=True)))
        with CoreErrorsAs(SimulationError):
            costs, endings = _core.simulate_cost(
                self.core, x, scale, q, tau, weight_q.tolist(), weight_tau.tolist(), core_threads(threads)
            )
        return costs, outcomes_of(endings)

    def _scale_of(self, x: Array, gain_scale: Array | None, threads: int | None) -> Array:
        """Return the scale of the gains, 1 by default, once the candidates are rows."""
        if x.ndim != 2:
            raise SimulationError(f"x must have shape (n_candidates, n_parameters), got {x.shape}")
        if threads is not None:
            whole("threads", threads, SimulationError, least=1, most=MOST_THREADS)
        return np.ones((len(x), self.robot.n_dof)) if gain_scale is None else gain_scale

    def integration_error(
        self, x: Array, q: Array, tau: Array, *, gain_scale: Array | None = None, threads: int | None = None
    ) -> IntegrationError:
        """Estimate the error of a run with `q` and `tau`, (n_records, n_dof), by a run with half the steps.

        The method is of fourth order: the difference to half the step is 15/16 of the error; 7/8 with "imex", which is of third.
        """
        (fine_q, _, _, fine_tau), _ = self.divided(2).run(x[None], gain_scale=gain_scale, threads=threads)
        factor = 16.0 / 15.0 if self.integrator == "rk4" else 8.0 / 7.0
        error_q = factor * np.abs(fine_q[0] - q).max(axis=0)
        error = factor * rms(fine_tau[0] - tau)
        size = rms(fine_tau[0])
        share = np.divide(error, size, out=np.zeros_like(error), where=error > 0.0)
        # If the run with half the steps ends early, the error is unknown (NaN).
        return IntegrationError(error_q, error, float(share.max()) if np.isfinite(share).all() else np.inf)


def _state(start: tuple[ArrayLike, ArrayLike], n: int) -> tuple[list[float], list[float]]:
    """Return positions and velocities at time 0 as lists, once they have the right shape."""
    parts = [real_array("start", part, SimulationError) for part in start]
    if [part.shape for part in parts] != [(n,), (n,)] or not np.isfinite(parts).all():
        raise SimulationError(f"start needs {n} finite positions and {n} velocities, got {start!r}")
    return parts[0].tolist(), parts[1].tolist()


def _push(external: tuple[float, ArrayLike], n: int) -> tuple[float, Array]:
    """Return rate (Hz) and external torques, once they have the right shape."""
    if len(external) != 2:
        raise SimulationError("external must be a rate (Hz) and torques")
    rate_hz, torques = external
    values = real_array("external", torques, SimulationError)
    if values.ndim != 2 or values.shape[1] != n or not len(values) or not np.isfinite(values).all():
        raise SimulationError(f"external needs finite torques of shape (n_samples, {n})")
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise SimulationError(f"the rate of external must be positive, got {rate_hz}")
    return float(rate_hz), values


def _check_friction(robot: Robot) -> None:
    """Refuse friction that "imex" does not support, with a better message than the core's."""
    friction = robot.friction
    what = f"integrator 'imex' is not for robot {robot.name!r}: it takes"
    if friction.coulomb != "tanh" or min(friction.smoothing) <= 0.0:
        raise SimulationError(f"{what} friction as tanh at every joint (coulomb = 'tanh')")
    if any(zone > 0.0 for zone in friction.dead_zone):
        raise SimulationError(f"{what} no dead zone of friction")
    if friction.held:
        raise SimulationError(f"{what} no sign of friction that is kept through rest (hold)")
    if friction.has_load:
        raise SimulationError(f"{what} no friction that depends on the load")
    if friction.coupling == "printed" and any(
        parameter.kind == "Fcm" for parameter in robot.standard_parameters
    ):
        raise SimulationError(
            f"{what} coupled motors that rub with the speed of their shafts alone (coupling = 'shaft')"
        )


def _check_steps(steps: tuple[float, Sequence[float]], period: float | None, duration_s: float) -> None:
    """Refuse absurd steps, sample times and fine steps; the core refuses values that are not positive."""
    coarse, fine = steps
    for what, interval in (("step", coarse), ("sample_time_s", period)):
        if interval is not None and 0.0 < interval * MOST_RECORDS < duration_s:
            raise SimulationError(
                f"{what} of {interval:g} s is too small for a run of {duration_s:g} s: at most {MOST_RECORDS} are possible"
            )
    for joint, value in enumerate(fine, start=1):
        if 0.0 < value < FINEST * coarse:
            raise SimulationError(
                f"fine_step of joint {joint} is {value:g} s, less than {FINEST:g} of the step of {coarse:g} s"
            )
