"""Errors of simulated positions and their derivatives, limb by limb and rollout by rollout.

Limbs of a fixed base share only what their servos have in common, such as a delay: the normal matrix is an arrow, and a change of a
parameter simulates its limb alone. All candidates of a limb are lanes of one batch. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, quotient
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...experiment.loop import recordings_of
from ...experiment.specs import SimulationSettings
from ...experiment.unknown import ACCELERATION, SOFT, joint_kinds
from ...loop.servos import Held, ServoLoop, Servos
from ...model.dynamics import inertia_matrix
from ...model.limbs import Limb, limbs_of
from ...robot.transmission import SOFTNESS
from ...signal.processing import SignalProcessing
from ...signal.window import Window, windows_of
from .columns import columns_of, file_values
from .stops import Stop, free_stretches, refuse_little, stops_of

SMOOTHING = 0.01
"""Velocity (rad/s or m/s) of Coulomb friction's tanh if neither robot nor [simulation] declares one."""
STICKING = 1e-4
"""Velocity (rad/s or m/s) of the tanh of friction that sticks: a joint at rest creeps by less than half a count of an encoder in
10 s, where one with `SMOOTHING` drifts by 50 mrad under half of its friction."""
STEP_S, FINE_STEP_S = 2e-3, 5e-4
"""Steps (s) of the simulation, and near velocity zero, by default."""
STRIDE = 100.0
"""Steps of a difference with friction that sticks, whose errors have kinks within fewer. On an SO-101, which chose it, searches
with 30 to one side ended at 2.0 to 2.8 rad^2 by rounding alone. With 100 to both sides they end at 1.82 to 1.86; at 2.0 to 2.3 with
other rules beside bounds than the one of `derivatives`, so minima are still near to each other."""
LEFT_OUT_S, LEFT_OUT_SHARE = 0.5, 0.25
"""Time (s) at the start of a rollout that is not compared, for its initial velocity is a guess; at most this share of it."""
START_S = 0.02
"""Duration (s) of the line fitted for a rollout's initial position and velocity."""
FINE_SHARE = 0.21
"""Steps near velocity zero, as a share of the time in which joints come to rest with MuJoCo's friction: 2 ms by its defaults."""
FEWEST_START_SAMPLES = 5
"""Smallest number of samples of that line."""
UNTRIMMED = SignalProcessing()
"""Positions are compared as they were measured."""
LEAST_SIZE = 1e-9
"""Lower bound of torques, speeds, inertias and gains that differences are a share of."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """One limb along one stretch of a log.

    Attributes
    ----------
    limb : Limb
        The limb.
    window : Window
        The stretch; its number is that of the window of the log which it lies in.
    loop : ServoLoop
        Simulates it.
    q : (n_samples, n_limb_joints) array
        Measured positions.
    weight : (n_limb_joints,) array
        Factors of the errors of the joints.
    inertia : (n_limb_joints, n_limb_joints) array
        M (kg.m^2, kg) at position zero, with the values: the armatures of MuJoCo's soft friction are beside it.
    """

    limb: Limb
    window: Window
    loop: ServoLoop
    q: Array
    weight: Array
    inertia: Array

    @property
    def joints(self) -> list[int]:
        """Joints of the limb in the robot, from 0."""
        return list(self.limb.joints)

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.window.rate_hz

    @property
    def recording(self) -> int:
        """Number of the recording."""
        return self.window.recording

    @property
    def first(self) -> int:
        """First sample that is compared."""
        return left_out(len(self.q), self.rate_hz)

    @cached_property
    def start(self) -> tuple[Array, Array]:
        """Initial position and velocity, (n_limb_joints,) each."""
        return start_state(self.q, self.rate_hz)

    def compared(self, q: Array) -> Array:
        """Return the weighted errors of simulated positions, (n_rows,)."""
        return np.asarray((q - self.q)[self.first :] * self.weight).ravel()

    def by_joint(self, errors: Array) -> Array:
        """Return errors of positions (rad or m), (n_compared, n_limb_joints), of weighted ones, (n_rows,)."""
        return errors.reshape(-1, len(self.weight)) / self.weight


@dataclass(eq=False)
class Problem:
    """Unknowns of an experiment whose links are known, and the errors that they leave.

    Stretches in which something holds a joint are left out, and those of a fit in which something pushes one. `dataclasses.replace`
    gives the problem of another law of friction, of other stretches or of other unknowns.

    Parameters
    ----------
    experiment : Experiment
        Logs and unknowns.
    noise : sequence of float, optional
        Standard deviation of the measured positions per joint (rad or m), whose inverse weighs the errors.
    threads : int, optional
        All cores by default.
    given : mapping of str to float, optional
        Values of standard parameters in the place of those of the robot file.
    soft : bool
        Friction as MuJoCo has it in the place of a smooth sign.
    sticks : bool
        A smooth sign so steep that joints at rest stay where they are.
    pushed : sequence of Stop
        Stretches in which a fit found a joint pushed.
    simulated : list of int
        Numbers of simulations of a limb so far, batch by batch; common to all problems of one fit.

    Attributes
    ----------
    robot : Robot
        The robot with smooth friction.
    limbs : list of Limb
        Its limbs.
    rollouts, held_out : list of Rollout
        Limbs along stretches of the log: of the recordings to fit, and of the others.
    values : Values
        What holds where nothing is estimated.
    columns : list of Column
        The unknowns.
    stops : list of Stop
        Stretches of the log that no rollout has, for something holds a joint.
    every_jump : bool
        As for `ServoLoop.run`; false at first, for a screening does without.

    Raises
    ------
    FitError
        Without a recorded reference, measured positions, a PD law or links.
    """

    experiment: Experiment
    noise: Sequence[float] | None = None
    threads: int | None = None
    given: Mapping[str, float] | None = None
    soft: bool = False
    sticks: bool = False
    pushed: Sequence[Stop] = ()
    simulated: list[int] = field(default_factory=list)
    every_jump: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        experiment, settings = self.experiment, self.experiment.simulation
        if getattr(experiment.reference, "kind", None) != "recorded":
            raise FitError(f'{experiment.name}: links = "fixed" needs [reference] kind = "recorded"')
        robot = settings.robot(experiment.robot)
        if robot.friction.coulomb != "tanh" or min(robot.friction.smoothing) <= 0.0:
            robot = robot.with_smoothing([SMOOTHING] * robot.n_dof)
        if self.sticks:
            robot = robot.with_smoothing([STICKING] * robot.n_dof)
            fine = STEP_S / 2.0 if settings.fine_step_s is None else settings.fine_step_s
            settings = replace(settings, integrator="imex", fine_step_s=fine)
        self.values = file_values(experiment, self.given)
        if self.soft:  # it needs finer steps at velocity zero only if it is harder than by MuJoCo's defaults
            rest = self.values.drive[SOFT[1]].min()
            step = settings.step_s or STEP_S
            fine = FINE_STEP_S if {*SOFT} & {*experiment.unknown} else FINE_SHARE * rest
            settings = replace(settings, step_s=step, fine_step_s=min(step, fine), integrator="rk4")
        self.robot, self.limbs = robot, list(limbs_of(robot))
        self.stops = [*stops_of(experiment, self.limbs, self.values), *self.pushed]
        self.rollouts, self.held_out = self._rollouts("fit", settings), self._rollouts("held-out", settings)
        whole = sum(
            end - begin for _, recording in recordings_of(experiment) for begin, end in recording.windows
        )
        for limb in self.limbs:
            used = sum(len(rollout.q) for rollout in self.rollouts if rollout.limb is limb)
            refuse_little(experiment, self.stops, limb, used, whole)
        self.columns = columns_of(experiment, self.limbs, self.values, self._steps())

    def _rollouts(self, role: str, settings: SimulationSettings) -> list[Rollout]:
        rollouts, fine = [], settings.fine_step_s
        for number, recording in recordings_of(self.experiment, role):
            if recording.q_ref is None:
                raise FitError(
                    f"recording '{recording.name}' has no commanded positions: [recording.reference]"
                )
            rate = recording.rate_hz
            x = self.values.along(number).x
            for (count, window), limb in itertools.product(enumerate(recording.windows), self.limbs):
                joints, origin = list(limb.joints), np.zeros((1, len(limb.joints)))
                weight = np.ones(len(joints)) if self.noise is None else 1.0 / np.array(self.noise)[joints]
                inertia = inertia_matrix(limb.robot, origin, x[limb.indices])[0]
                spans = free_stretches(self.stops, limb, number, window, rate)
                for cut in windows_of(recording, UNTRIMMED, number=number, along="outputs", spans=spans):
                    q = np.ascontiguousarray(cut.measured[:, joints])
                    begin, end = cut.begin, cut.begin + len(q)
                    loop = ServoLoop(
                        limb.robot,
                        Held(np.ascontiguousarray(recording.q_ref[begin:end][:, joints]), rate),
                        q,
                        step_s=settings.step_s or STEP_S,
                        fine_step_s=FINE_STEP_S if fine is None else float(np.min(fine)),
                        integrator=settings.integrator,
                    )
                    cut = replace(cut, number=count)
                    rollouts.append(Rollout(limb, cut, loop, q, weight, inertia))
        return rollouts

    def _steps(self) -> dict[str, Array]:
        """Return changes for differences by kind, (n_dof,) each.

        Each moves the torque by a thousandth of what the servo gives, delays and biases by what is small.
        """
        n = self.robot.n_dof
        error, speed, inertia, count = (np.zeros(n) for _ in range(4))
        for rollout in (*self.rollouts, *self.held_out):
            at, limb = rollout.joints, rollout.limb
            error[at] += np.sum((rollout.loop.held.values - rollout.q) ** 2, axis=0)
            speed[at] += np.sum((np.diff(rollout.q, axis=0) * rollout.rate_hz) ** 2, axis=0)
            count[at] += len(rollout.q)
            x = self.values.along(rollout.recording).x[limb.indices]
            inertia[at] = np.maximum(inertia[at], np.diag(inertia_matrix(limb.robot, rollout.q[:1], x)[0]))
        kp = self.values.drive["kp"]
        torque = np.maximum(kp * np.sqrt(error / count), LEAST_SIZE)
        damping = torque / np.maximum(np.sqrt(speed / count), LEAST_SIZE)
        sizes: dict[str, Array | float] = {
            **dict.fromkeys(joint_kinds(self.robot), torque),
            "Ia": np.maximum(inertia, LEAST_SIZE),
            "Fv": damping,
            "kv": damping,
            "kp": np.maximum(kp, LEAST_SIZE),
            "saturation": 10.0 * torque,
            "delay_s": 0.2,
            "lag_s": 0.2,
            "bias_rad": 0.1,
            **dict(zip(SOFT, SOFTNESS, strict=True)),
        }
        # A set-point that commands leave behind turns at their samples, and where it turns jumps with its acceleration.
        sizes[ACCELERATION] = 30.0 * self.values.drive.get(ACCELERATION, np.ones(n))
        return {kind: np.broadcast_to(1e-3 * size, n) for kind, size in sizes.items()}

    @property
    def n_simulations(self) -> int:
        """Simulations of a limb so far."""
        return sum(self.simulated)

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
        joints = set(rollout.joints)
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
        state = [np.tile(part, (len(thetas), 1)) for part in rollout.start]
        return self._run(rollout, rollout.loop, thetas, (state[0], state[1], 0.0), lead_s)

    def ahead(
        self, rollout: Rollout, theta: Array, seconds: tuple[float, float], noise: Array
    ) -> tuple[Array, NDArray[np.intp]]:
        """Return the encoders' positions from measured states on, (n_states, n_samples, n_limb_joints), and the samples of these.

        `seconds` are the time simulated and that between states. Their positions and velocities are those of parabolas through the
        samples around; left out are those at which a parabola leaves more than `noise` (rad or m, rms), (n_limb_joints,), such as
        at a blow. All states are lanes of one batch.
        """
        rate, count = rollout.rate_hz, len(rollout.q)
        half = max(FEWEST_START_SAMPLES, round(START_S * rate)) // 2
        at = np.arange(max(rollout.first, half), count - half, max(1, round(seconds[1] * rate)))
        around = np.arange(-half, half + 1)
        q = np.moveaxis(rollout.q[at[:, None] + around], 1, 0).reshape(len(around), -1)
        parabola = np.polynomial.polynomial.polyfit(around / rate, q, 2)
        left = q - np.polynomial.polynomial.polyval(around / rate, parabola).T
        smooth = (np.sqrt(np.mean(left**2, axis=0)).reshape(len(at), -1) <= noise).all(axis=1)
        position, velocity = parabola[:2].reshape(2, len(at), -1)[:, smooth]
        at = at[smooth]
        if not at.size:
            return np.empty((0, 1, len(rollout.joints))), at
        loop = rollout.loop.ahead(min(round(seconds[0] * rate), count - 1))
        return self._run(rollout, loop, np.tile(theta, (len(at), 1)), (position, velocity, at / rate))[0], at

    def _run(
        self,
        rollout: Rollout,
        loop: ServoLoop,
        thetas: Array,
        state: tuple[Array, Array, Array | float],
        lead_s: float = 0.0,
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Simulate candidates from states: encoder readings and velocities, and the times of the log at which they begin."""
        x, drive = self._of_limb(rollout, thetas)
        q, dq, begin_s = state
        self.simulated.append(len(thetas))
        creep, rest = (drive.pop(kind) for kind in SOFT)
        slope = self._slope(rollout, x) * rest / creep if self.soft else 0.0
        servos = Servos(**drive, q=q, dq=dq, softness=slope, rate=1.0 / rest, lead_s=lead_s, begin_s=begin_s)
        return loop.run(x, servos, self.threads, every_jump=self.every_jump)

    def parameters(self, thetas: Array, recording: int | None = None) -> tuple[Array, dict[str, Array]]:
        """Return the standard parameters of the robot and the numbers of its servos, (n_candidates, n) each.

        They are those in a recording, with its payload and gains, or without any.
        """
        values = self.values if recording is None else self.values.along(recording)
        shares = np.ones(self.robot.n_dof) if recording is None else self.values.shares[recording]
        x = np.tile(values.x, (len(thetas), 1))
        drive = {kind: np.tile(value, (len(thetas), 1)) for kind, value in values.drive.items()}
        for column, theta in zip(self.columns, thetas.T, strict=True):
            if None not in (recording, column.recording) and column.recording != recording:
                continue
            if column.of_drive:
                at = list(column.joints)
                share = shares[at] if column.kind == "kp" else 1.0
                drive[column.kind][:, at] = theta[:, None] * share
            else:
                x[:, self.robot.parameter_names.index(column.name)] = theta
        return x, drive

    def _of_limb(self, rollout: Rollout, thetas: Array) -> tuple[Array, dict[str, Array]]:
        x, drive = self.parameters(thetas, rollout.recording)
        return x[:, rollout.limb.indices], {kind: value[:, rollout.joints] for kind, value in drive.items()}

    def creeping(self, theta: Array) -> Array:
        """Return the velocities (rad/s or m/s) below which MuJoCo's friction is viscous, ``Fc creep (M^-1)_jj``, (n_dof,)."""
        creeping = np.zeros(self.robot.n_dof)
        for rollout in self.rollouts:
            x, drive = self._of_limb(rollout, theta[None])
            coulomb = _places(rollout.limb, "Fc")
            creeping[rollout.joints] = (x[:, coulomb] * drive[SOFT[0]] / self._slope(rollout, x))[0]
        return creeping

    def _slope(self, rollout: Rollout, x: Array) -> Array:
        """Return ``1 / (M^-1)_jj`` at position zero, (n_candidates, n_limb_joints): slopes of friction times creep over rest."""
        rotors = _places(rollout.limb, "Ia")
        m = np.tile(rollout.inertia, (len(x), 1, 1))
        at = np.arange(len(rotors))
        m[:, at, at] += x[:, rotors] - self.values.x[rollout.limb.indices][rotors]
        return np.asarray(1.0 / np.diagonal(np.linalg.inv(m), axis1=1, axis2=2))

    def errors(
        self, theta: Array, rollouts: Sequence[Rollout] | None = None, lead_s: float = 0.0
    ) -> list[Array]:
        """Return weighted errors of each rollout, those of the fit by default, (n_rows,); NaN throughout after an early end."""
        return self.errors_of(theta[None], rollouts, lead_s)[0]

    def errors_of(
        self, thetas: Array, rollouts: Sequence[Rollout] | None = None, lead_s: float = 0.0
    ) -> list[list[Array]]:
        """Return the errors of several candidates, (n_candidates, n_columns), which are lanes of one batch."""
        batches = [
            [rollout.compared(q) for q in self.positions(rollout, thetas, lead_s)[0]]
            for rollout in (self.rollouts if rollouts is None else rollouts)
        ]
        return [list(errors) for errors in zip(*batches, strict=True)] or [[] for _ in thetas]

    def derivatives(self, theta: Array, first: int = 0, side: float = 1.0) -> tuple[list[Array], list[Array]]:
        """Return errors and their derivatives of each rollout of the fit, by differences in lanes.

        They are (n_rows,) and (n_rows, n_own_columns), the own columns being those from number `first` on. Differences are to
        larger values, or to smaller ones with a `side` of -1, but shorter beside a bound, and away from it where it leaves too
        little room.
        """
        low, high = self.bounds
        many = [STRIDE if self.sticks and column.kind != ACCELERATION else 1.0 for column in self.columns]
        wanted = np.array([column.step for column in self.columns]) * many
        up, down = np.minimum(high - theta, wanted), np.minimum(theta - low, wanted)
        ahead, behind = (up, down) if side > 0.0 else (down, up)
        # Differences are shorter beside a bound, and away from it where it leaves less than a fourth.
        turned = (ahead < 0.25 * wanted) & (behind > ahead)
        differences = side * np.where(turned, -behind, ahead)
        differences = np.where(differences == 0.0, side * wanted, differences)
        errors, blocks = [], []
        for rollout in self.rollouts:
            own = self.own(rollout)
            own = own[own >= first]
            steps = differences[own]
            thetas = np.tile(theta, (1 + len(own), 1))
            thetas[1 + np.arange(len(own)), own] += steps
            q, completed = self.positions(rollout, thetas)
            if not completed[1:].all():  # at the edge of what can be simulated the other side is inside
                back = np.flatnonzero(~completed[1:])
                steps[back] *= -1.0
                thetas[1 + back] = theta
                thetas[1 + back, own[back]] += steps[back]
                q[1 + back], _ = self.positions(rollout, thetas[1 + back])
            rows = np.stack([rollout.compared(one) for one in q])
            errors.append(rows[0])
            blocks.append(np.nan_to_num(((rows[1:] - rows[0]) / steps[:, None]).T))
        return errors, blocks

    def joint_errors(self, errors: Sequence[Array], rollouts: Sequence[Rollout] | None = None) -> Array:
        """Return the rms error of each joint (rad or m), (n_dof,), from the errors of rollouts; NaN without any."""
        squares, counts = np.zeros(self.robot.n_dof), np.zeros(self.robot.n_dof)
        for rollout, rows in zip(self.rollouts if rollouts is None else rollouts, errors, strict=True):
            e = rollout.by_joint(rows)
            squares[rollout.joints] += np.sum(e**2, axis=0)
            counts[rollout.joints] += len(e)
        return np.sqrt(quotient(squares, counts, np.nan))


def _places(limb: Limb, kind: str) -> list[int]:
    """Return where the parameters of a kind are among those of a limb, joint by joint."""
    return [limb.robot.parameter_names.index(f"{kind}{j + 1}") for j in range(len(limb.joints))]


def may_be_soft(experiment: Experiment) -> bool:
    """Return whether friction may be MuJoCo's: one coefficient a joint, and no smooth sign that was asked for."""
    robot = experiment.simulation.robot(experiment.robot)
    friction = robot.friction
    plain = friction.coulomb != "tanh" and friction.model == "symmetric" and not friction.terms
    return plain and not robot.geometry.followers


def left_out(count: int, rate: float) -> int:
    """Return the number of samples at the start of a rollout that are not compared."""
    return min(int(LEFT_OUT_S * rate), int(LEFT_OUT_SHARE * count))


def start_state(q: Array, rate: float) -> tuple[Array, Array]:
    """Return position and velocity at the first sample, (n_dof,) each, from a line through the first samples."""
    count = min(len(q), max(FEWEST_START_SAMPLES, round(START_S * rate)))
    t = np.arange(count) / rate
    line = np.polynomial.polynomial.polyfit(t, q[:count], 1)
    return np.array(line[0]), np.array(line[1])
