"""Errors of simulated positions and their derivatives, limb by limb and rollout by rollout.

Limbs of a fixed base share only what their servos have in common, such as a delay: the normal matrix is an arrow, and a change of a
parameter simulates its limb alone. All candidates of a limb are lanes of one batch. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, quotient
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...experiment.specs import SimulationSettings
from ...experiment.unknown import SOFT
from ...loop.servos import Held, ServoLoop, Servos
from ...model.dynamics import inertia_matrix
from ...model.limbs import Limb, limbs_of
from ...robot.robot import Robot
from .columns import Column, Steps, Values, columns_of, file_values
from .stops import Stop, free_stretches, refuse_little, stops_of

SMOOTHING = 0.01
"""Velocity (rad/s or m/s) of Coulomb friction's tanh if neither robot nor [simulation] declares one."""
STEP_S, FINE_STEP_S = 2e-3, 5e-4
"""Steps (s) of the simulation, and near velocity zero, by default."""
LEFT_OUT_S, LEFT_OUT_SHARE = 0.5, 0.25
"""Time (s) at the start of a rollout that is not compared, for its initial velocity is a guess; at most this share of it."""
START_S = 0.02
"""Duration (s) of the line fitted for a rollout's initial position and velocity."""
FINE_SHARE = 0.21
"""Steps near velocity zero, as a share of the time in which joints come to rest with MuJoCo's friction: 2 ms by its defaults."""
FEWEST_START_SAMPLES = 5
"""Smallest number of samples of that line."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """One limb along one stretch of a log.

    Attributes
    ----------
    limb : int
        Which limb.
    recording, window : int
        Which recording, and which window of it.
    role : str
        "fit" or "held-out".
    loop : ServoLoop
        Simulates it.
    q : (n_samples, n_limb_joints) array
        Measured positions.
    first : int
        First sample that is compared.
    start : (q, dq)
        Initial position and velocity, (n_limb_joints,) each.
    begin : int
        Its first sample in the recording.
    """

    limb: int
    recording: int
    window: int
    role: str
    loop: ServoLoop
    q: Array
    first: int
    start: tuple[Array, Array]
    rate_hz: float
    begin: int


@dataclass(eq=False)
class Problem:
    """Unknowns of an experiment and the errors that they leave.

    Attributes
    ----------
    experiment : Experiment
        Logs and unknowns.
    robot : Robot
        The robot with smooth friction.
    limbs : list of Limb
        Its limbs.
    rollouts : list of Rollout
        Limbs along stretches of the log.
    values : Values
        What holds where nothing is estimated.
    columns : list of Column
        The unknowns.
    weights : (n_rollouts, ) list of array
        Factors of the errors of the joints of each rollout.
    n_simulations : int
        Simulations of a limb so far.
    inertia : dict of (int, int) to array
        M (kg.m^2, kg) by limb and recording at position zero, with the values, where friction is MuJoCo's soft constraint; empty
        otherwise.
    stops : list of Stop
        Stretches of the log that no rollout has, for something holds a joint.
    """

    experiment: Experiment
    robot: Robot
    limbs: list[Limb]
    rollouts: list[Rollout]
    values: Values
    columns: list[Column]
    threads: int | None = None
    weights: list[Array] = field(default_factory=list)
    n_simulations: int = 0
    every_jump: bool = False
    inertia: dict[tuple[int, int], Array] = field(default_factory=dict)
    stops: list[Stop] = field(default_factory=list)

    @property
    def start(self) -> Array:
        """Start of the search, (n_columns,)."""
        return np.array([column.start for column in self.columns])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, (n_columns,) each."""
        return np.array([c.low for c in self.columns]), np.array([c.high for c in self.columns])

    def own(self, rollout: Rollout) -> NDArray[np.intp]:
        """Return the columns that a rollout depends on."""
        joints = set(self.limbs[rollout.limb].joints)
        return np.array(
            [
                k
                for k, column in enumerate(self.columns)
                if joints & {*column.joints} and column.recording in (None, rollout.recording)
            ],
            dtype=np.intp,
        )

    def positions(
        self, rollout: Rollout, thetas: Array, lead_s: float = 0.0
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the encoders' positions, (n_candidates, n_samples, n_limb_joints), and which runs were completed."""
        x, drive = self._parameters(rollout, thetas)
        q, dq = (np.tile(part, (len(thetas), 1)) for part in rollout.start)
        self.n_simulations += len(thetas)
        creep, rest = (drive.pop(kind) for kind in SOFT)
        slope = self._slope(rollout, x) * rest / creep if self.inertia else None
        return rollout.loop.run(
            x,
            Servos(**drive, q=q, dq=dq, softness=slope, rate=1.0 / rest, lead_s=lead_s),
            self.threads,
            every_jump=self.every_jump,
        )

    def _parameters(self, rollout: Rollout, thetas: Array) -> tuple[Array, dict[str, Array]]:
        """Return the standard parameters of a limb and the numbers of its servos, (n_candidates, n) each."""
        limb = self.limbs[rollout.limb]
        count, joints = len(thetas), list(limb.joints)
        values = self.values.along(rollout.recording)
        x = np.tile(values.x[limb.indices], (count, 1))
        drive = {kind: np.tile(value[joints], (count, 1)) for kind, value in values.drive.items()}
        names = limb.robot.parameter_names
        for k in self.own(rollout):
            column = self.columns[k]
            for joint in column.joints:
                if joint not in limb.joints:
                    continue
                local = joints.index(joint)
                if column.of_drive:
                    share = self.values.shares[rollout.recording, joint] if column.kind == "kp" else 1.0
                    drive[column.kind][:, local] = share * thetas[:, k]
                else:
                    x[:, names.index(f"{column.kind}{local + 1}")] = thetas[:, k]
        return x, drive

    def creeping(self, theta: Array) -> Array:
        """Return the velocities (rad/s or m/s) below which MuJoCo's friction is viscous, ``Fc creep (M^-1)_jj``, (n_dof,)."""
        creeping = np.zeros(self.robot.n_dof)
        for rollout in self.rollouts:
            x, drive = self._parameters(rollout, theta[None])
            limb = self.limbs[rollout.limb]
            coulomb = [limb.robot.parameter_names.index(f"Fc{j + 1}") for j in range(len(limb.joints))]
            creeping[list(limb.joints)] = (x[:, coulomb] * drive[SOFT[0]] / self._slope(rollout, x))[0]
        return creeping

    def _slope(self, rollout: Rollout, x: Array) -> Array:
        """Return ``1 / (M^-1)_jj`` at position zero, (n_candidates, n_limb_joints): slopes of friction times creep over rest."""
        limb, inertia = self.limbs[rollout.limb], self.inertia[rollout.limb, rollout.recording]
        rotors = [limb.robot.parameter_names.index(f"Ia{j + 1}") for j in range(len(inertia))]
        m = np.tile(inertia, (len(x), 1, 1))
        at = np.arange(len(rotors))
        m[:, at, at] += x[:, rotors] - self.values.x[limb.indices][rotors]
        return np.asarray(1.0 / np.diagonal(np.linalg.inv(m), axis1=1, axis2=2))

    def errors(self, theta: Array, role: str = "fit", lead_s: float = 0.0) -> list[Array]:
        """Return weighted errors of each rollout of a role, (n_rows,); NaN throughout where a run has ended early."""
        return [
            self._compared(number, self.positions(rollout, theta[None], lead_s)[0][0]).ravel()
            if rollout.role == role
            else np.zeros(0)
            for number, rollout in enumerate(self.rollouts)
        ]

    def derivatives(self, theta: Array, first: int = 0) -> tuple[list[Array], list[Array]]:
        """Return errors and their derivatives of each rollout, by differences in lanes.

        They are (n_rows,) and (n_rows, n_own_columns), the own columns being those from number `first` on.
        """
        _, high = self.bounds
        errors, blocks = [], []
        for number, rollout in enumerate(self.rollouts):
            own = self.own(rollout)
            own = own[own >= first]
            if rollout.role != "fit":
                errors.append(np.zeros(0))
                blocks.append(np.zeros((0, len(own))))
                continue
            steps = np.array([self.columns[k].step for k in own])
            steps = np.where(theta[own] + steps > high[own], -steps, steps)
            thetas = np.tile(theta, (1 + len(own), 1))
            thetas[1 + np.arange(len(own)), own] += steps
            q, completed = self.positions(rollout, thetas)
            if not completed[1:].all():  # at the edge of what can be simulated the other side is inside
                back = np.flatnonzero(~completed[1:])
                steps[back] *= -1.0
                thetas[1 + back] = theta
                thetas[1 + back, own[back]] += steps[back]
                q[1 + back], _ = self.positions(rollout, thetas[1 + back])
            rows = np.stack([self._compared(number, one).ravel() for one in q])
            errors.append(rows[0])
            blocks.append(np.nan_to_num(((rows[1:] - rows[0]) / steps[:, None]).T))
        return errors, blocks

    def joint_errors(self, errors: Sequence[Array], role: str = "fit") -> Array:
        """Return the rms error of each joint (rad or m), (n_dof,), from the errors of the rollouts; NaN without any of a role."""
        squares, counts = np.zeros(self.robot.n_dof), np.zeros(self.robot.n_dof)
        for rollout, weight, rows in zip(self.rollouts, self.weights, errors, strict=True):
            if rollout.role == role:
                e = rows.reshape(-1, len(weight)) / weight
                at = list(self.limbs[rollout.limb].joints)
                squares[at] += np.sum(e**2, axis=0)
                counts[at] += len(e)
        return np.sqrt(quotient(squares, counts, np.nan))

    def _compared(self, number: int, q: Array) -> Array:
        rollout = self.rollouts[number]
        return np.asarray((q - rollout.q)[rollout.first :] * self.weights[number])


def build(
    experiment: Experiment,
    *,
    noise: Sequence[float] | None = None,
    threads: int | None = None,
    start: object = None,
    soft: bool = False,
    pushed: Sequence[Stop] = (),
) -> Problem:
    """Return the problem of an experiment whose links are known, with friction as a smooth sign or, `soft`, as MuJoCo has it.

    Stretches in which something holds a joint are left out, and those of a fit in which something pushes one.

    Raises
    ------
    FitError
        Without a recorded reference, measured positions, a PD law or links.
    """
    spec = experiment.reference
    if getattr(spec, "kind", None) != "recorded":
        raise FitError(f'{experiment.name}: links = "fixed" needs [reference] kind = "recorded"')
    settings = experiment.simulation
    robot = settings.robot(experiment.robot)
    if robot.friction.coulomb != "tanh" or min(robot.friction.smoothing) <= 0.0:
        robot = robot.with_smoothing([SMOOTHING] * robot.n_dof)
    values = file_values(experiment, start)
    if soft:  # it needs finer steps at velocity zero only if it is harder than by MuJoCo's defaults
        step = settings.step_s or STEP_S
        fine = FINE_STEP_S if {*SOFT} & {*experiment.unknown} else FINE_SHARE * values.drive[SOFT[1]].min()
        settings = replace(settings, step_s=step, fine_step_s=min(step, fine), integrator="rk4")
    limbs = limbs_of(robot)
    stops = [*stops_of(experiment, limbs, values), *pushed]
    rollouts = _rollouts(experiment, limbs, settings, stops)
    steps = _steps(robot, limbs, rollouts, values)
    columns = columns_of(experiment, limbs, values, steps)
    weights = [
        np.ones(len(limbs[rollout.limb].joints))
        if noise is None
        else 1.0 / np.array(noise)[list(limbs[rollout.limb].joints)]
        for rollout in rollouts
    ]
    problem = Problem(experiment, robot, limbs, rollouts, values, columns, threads, weights, stops=stops)
    if soft:
        problem.inertia = {
            (k, number): inertia_matrix(
                limb.robot, np.zeros((1, len(limb.joints))), values.along(number).x[limb.indices]
            )[0]
            for (k, limb), number in itertools.product(enumerate(limbs), range(len(experiment.recordings)))
        }
    return problem


def may_be_soft(experiment: Experiment) -> bool:
    """Return whether friction may be MuJoCo's: one coefficient a joint, and no smooth sign that was asked for."""
    robot = experiment.simulation.robot(experiment.robot)
    friction = robot.friction
    plain = friction.coulomb != "tanh" and friction.model == "symmetric" and not friction.terms
    return plain and not robot.geometry.followers


def _rollouts(
    experiment: Experiment, limbs: Sequence[Limb], settings: SimulationSettings, stops: Sequence[Stop]
) -> list[Rollout]:
    rollouts = []
    for number, recording in enumerate(experiment.recordings):
        if recording.q_ref is None:
            raise FitError(f"recording '{recording.name}' has no commanded positions: [recording.reference]")
        measured, rate = recording.measured_positions(), recording.rate_hz
        for (count, window), (k, limb) in itertools.product(enumerate(recording.windows), enumerate(limbs)):
            joints = list(limb.joints)
            for begin, end in free_stretches(stops, limb, number, window, rate):
                q = np.ascontiguousarray(measured[begin:end][:, joints])
                held = Held(np.ascontiguousarray(recording.q_ref[begin:end][:, joints]), rate)
                loop = ServoLoop(
                    limb.robot,
                    held,
                    q,
                    step_s=settings.step_s or STEP_S,
                    fine_step_s=_fine(settings.fine_step_s),
                    integrator=settings.integrator,
                )
                start = start_state(q, rate)
                first = left_out(len(q), rate)
                rollouts.append(Rollout(k, number, count, recording.role, loop, q, first, start, rate, begin))
    if not any(item.role == "fit" for item in experiment.recordings):
        raise FitError(f"experiment '{experiment.name}' has no recording with role 'fit'")
    whole = sum(b - a for item in experiment.recordings if item.role == "fit" for a, b in item.windows)
    for k, limb in enumerate(limbs):
        used = sum(len(item.q) for item in rollouts if item.limb == k and item.role == "fit")
        refuse_little(experiment, stops, limb, used, whole)
    return rollouts


def left_out(count: int, rate: float) -> int:
    """Return the number of samples at the start of a rollout that are not compared."""
    return min(int(LEFT_OUT_S * rate), int(LEFT_OUT_SHARE * count))


def _fine(given: object) -> float:
    if given is None:
        return FINE_STEP_S
    return float(np.min(np.asarray(given, dtype=np.float64)))


def start_state(q: Array, rate: float) -> tuple[Array, Array]:
    """Return position and velocity at the first sample, (n_dof,) each, from a line through the first samples."""
    count = min(len(q), max(FEWEST_START_SAMPLES, round(START_S * rate)))
    t = np.arange(count) / rate
    line = np.polynomial.polynomial.polyfit(t, q[:count], 1)
    return np.array(line[0]), np.array(line[1])


def _steps(robot: Robot, limbs: Sequence[Limb], rollouts: Sequence[Rollout], values: Values) -> Steps:
    n = robot.n_dof
    error, speed, inertia, count = (np.zeros(n) for _ in range(4))
    for rollout in rollouts:
        at = list(limbs[rollout.limb].joints)
        held = rollout.loop.held
        error[at] += np.sum((held.values - rollout.q) ** 2, axis=0)
        speed[at] += np.sum((np.diff(rollout.q, axis=0) * held.rate_hz) ** 2, axis=0)
        count[at] += len(rollout.q)
        limb = limbs[rollout.limb]
        m = inertia_matrix(limb.robot, rollout.q[:1], values.along(rollout.recording).x[limb.indices])[0]
        inertia[at] = np.maximum(inertia[at], np.diag(m))
    kp = values.drive["kp"]
    tiny = 1e-9
    return Steps(
        torque=np.maximum(kp * np.sqrt(error / count), tiny),
        speed=np.maximum(np.sqrt(speed / count), tiny),
        inertia=np.maximum(inertia, tiny),
        kp=np.maximum(kp, tiny),
    )
