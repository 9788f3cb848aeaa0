"""Replay of a log in MuJoCo: the robot of an MJCF follows the commands on a fixed base, and its positions are compared.

MuJoCo holds a command over each step h and evaluates damping at its end, so commands act h / 2 early. They are delayed by h / 2
in addition to the delay of the result, but not with its Runge-Kutta steps, which also evaluate servos in between. Tested in
``tests/test_in_mujoco.py``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._tools.arrays import Array
from .._tools.saved import plain
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..export.drives import Drives, JointDrive, drives_of, for_step
from ..log.recording import Recording
from ..loop.servos import Held
from ..methods.positions.columns import file_values
from ..methods.positions.intervals import HALF
from ..methods.positions.problem import left_out, start_state
from ..methods.positions.replay import pushed_of
from ..methods.positions.stops import Stop, free_stretches, stops_of
from ..model.limbs import limbs_of
from ..result.identification import Identification
from ..robot.payload import carrying_joint
from ..robot.rigid_body import body_pseudo_inertia, central, moved, pose, pseudo_inertia, quaternion
from .mujoco_model import integrator_of, load_model, places_of

Stretches = dict[tuple[int, int], list[int]]
"""Joints that are compared, by begin and end of a stretch."""

SHORT_STEP_S = 1e-4
"""Step (s) at which what MuJoCo's own steps change is below the noise of most encoders."""
STAGES = 4
"""Evaluations of a Runge-Kutta step, which is longer by this factor."""
SAME = 1e-12
"""Difference of commands (rad or m) that is rounding."""
NEAR = 1.05
"""Error in MuJoCo over that of the result, below which its steps are short enough."""
MOST_STEP_S = 0.02
"""Longest time step (s) of a replay: servos oscillate within some hundredths of a second."""


@dataclass(frozen=True, eq=False)
class MujocoValidation:
    """Errors of positions in MuJoCo beside those of the result.

    Attributes
    ----------
    file : str
        The MJCF.
    joints : tuple of str
        Names of the joints.
    after, before : (n_joints,) array
        Root mean square errors (rad or m) with that file, and with the robot file of the experiment; `before` is None unless
        that is an MJCF.
    own : (n_joints,) array or None
        Errors of the result on its own log; None if it was fitted to another one.
    step_s : float
        Step of MuJoCo (s).
    at_file_step : (float, float) or None
        The file's own step (s), and the rms error of all joints with it (rad or m), where a shorter one leaves smaller errors.
    """

    file: str
    joints: tuple[str, ...]
    after: Array
    before: Array | None
    own: Array | None
    step_s: float
    at_file_step: tuple[float, float] | None = None

    @property
    def ratio(self) -> float | None:
        """Error in MuJoCo over that of the result, rms over all joints; None on another log."""
        return None if self.own is None else _rms(self.after) / _rms(self.own)

    @property
    def completed(self) -> bool:
        """Whether MuJoCo reached the end of each rollout."""
        return bool(np.isfinite(self.after).all())

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain lists and numbers."""
        return {**plain(self), "ratio": self.ratio}

    def __str__(self) -> str:
        columns = [("before", self.before), (self.file, self.after), ("the fit's own", self.own)]
        shown = [(title, values) for title, values in columns if values is not None]
        width = max(len("rms error, mrad or mm"), *(len(name) for name in self.joints))
        lines = [f"{'rms error, mrad or mm':{width}}" + "".join(f"  {title:>13}" for title, _ in shown)]
        for j, name in enumerate((*self.joints, "all")):
            cells = [values[j] if j < len(self.joints) else _rms(values) for _, values in shown]
            lines.append(
                f"{name:{width}}"
                + "".join(
                    f"  {1e3 * cell:{max(13, len(title))}.2f}"
                    for cell, (title, _) in zip(cells, shown, strict=True)
                )
            )
        lines += [
            "",
            f"MuJoCo's steps are {1e3 * self.step_s:.4g} ms, the base is held, contacts and joint limits are off.",
        ]
        if self.ratio is not None:
            lines.append(f"The error in MuJoCo is {self.ratio:.3f} times that of the fit.")
        if self.at_file_step is not None:
            step, error = self.at_file_step
            lines.append(
                f"At the file's own step of {1e3 * step:.4g} ms it is {1e3 * error:.2f} mrad or mm: "
                f"didim export --for-step {step:.4g} corrects for that step."
            )
        return "\n".join(lines)


def validate_in_mujoco(
    fit: Identification, experiment: Experiment, path: Path, *, step_s: float | None = None
) -> MujocoValidation:
    """Replay the recordings of an experiment in MuJoCo, with an exported file and with the robot file.

    Parameters
    ----------
    fit : Identification
        A result on positions: its delay, lag and offsets act on the commands; its gains are used if the file has no position
        actuator.
    experiment : Experiment
        Recordings with commands.
    path : Path
        The MJCF to be tested.
    step_s : float, optional
        Step of MuJoCo; that of the file by default. A sample is a whole number of steps.

    Raises
    ------
    FitError
        Without the package mujoco, for a file that it cannot load, and for a joint or commands that are missing.
    """
    drives = drives_of(fit, fit.name)
    pushed = pushed_of(fit, experiment)
    used = [
        log
        for log in _logged(experiment, pushed)
        if log.recording.q_ref is not None and log.recording.has_positions
    ]
    if not used:
        raise FitError(f"{experiment.name}: no recording has commanded and measured positions")
    record = fit.settings.get("positions", {}).get("errors", {})
    same = {name: digest for log in used for name, digest in log.recording.digests.items()}
    known = all(fit.digests.get(f"data {name}") == digest for name, digest in same.items())
    own = np.array(record["after"]) if known and record.get("after") else None
    after, step = _errors(path, used, drives, step_s)
    at_file_step = None
    far = own is not None and not _rms(after) < NEAR * _rms(own)
    if step_s is None and step > SHORT_STEP_S and far:
        short, short_step = _errors(path, used, drives, None, corrected=True)
        if _rms(short) < _rms(after) or not np.isfinite(after).all():
            at_file_step, after, step = (step, _rms(after)), short, short_step
    own_step = step if at_file_step is None else at_file_step[0]
    robot = experiment.robot.path
    before = None
    if robot.suffix.lower() == ".xml" and robot.is_file():
        plain = tuple(_plain(drive) for drive in drives.joints)
        before, _ = _errors(robot, used, Drives(plain), own_step)
    return MujocoValidation(
        path.name, tuple(drive.joint for drive in drives.joints), after, before, own, step, at_file_step
    )


class Logged(NamedTuple):
    """A recording to be replayed.

    `stretches` are compared, `shares` (n_joints,) are its gains over those of the controller, and `load` (10,) the inertial
    parameters of its payload in the frame of the link of joint `carrier`, from 0.
    """

    recording: Recording
    stretches: Stretches
    shares: Array
    load: Array
    carrier: int


def _logged(experiment: Experiment, pushed: Sequence[Stop]) -> list[Logged]:
    """Return the recordings of an experiment; stretches in which something holds or pushes a joint are not compared."""
    n = experiment.robot.n_dof
    if experiment.links != "fixed":
        every = list(range(n))
        return [
            Logged(log, dict.fromkeys(log.windows, every), np.ones(n), np.zeros(10), n - 1)
            for log in experiment.recordings
        ]
    values, limbs, logs = file_values(experiment), limbs_of(experiment.robot), []
    stops = [*stops_of(experiment, limbs, values), *pushed]
    flange = np.eye(4) if experiment.flange is None else np.vstack([experiment.flange, [0.0, 0.0, 0.0, 1.0]])
    for number, recording in enumerate(experiment.recordings):
        stretches: Stretches = {}
        for window, limb in itertools.product(recording.windows, limbs):
            for stretch in free_stretches(stops, limb, number, window, recording.rate_hz):
                stretches.setdefault(stretch, []).extend(limb.joints)
        payload = experiment.payloads.get(recording.payload)
        load, carrier = np.zeros(10), n - 1
        if payload is not None:
            load = moved(payload.split[0], flange if payload.link is None else np.eye(4))
            carrier = carrying_joint(experiment.robot, payload)
        logs.append(Logged(recording, stretches, values.shares[number], load, carrier))
    return logs


def _loaded(model: Any, name: str, drives: Drives, logged: Logged) -> tuple[Any, Drives]:
    """Return a copy of a model, and the drives, with the gains and the payload of a recording."""
    import mujoco

    _, _, servo = places_of(model, drives, name)
    model = copy(model)
    for actuator, share in zip(servo, logged.shares, strict=True):
        if actuator is not None:
            model.actuator_gainprm[actuator, 0] *= share
            model.actuator_biasprm[actuator, 1] *= share
    joints = tuple(
        replace(drive, kp=drive.kp * float(share) if drive.kp else drive.kp)
        for drive, share in zip(drives.joints, logged.shares, strict=True)
    )
    if logged.load[-1] > 0.0:
        carrier = (*drives.joints, *drives.followers)[logged.carrier]
        body = int(model.joint(carrier.joint).bodyid[0])
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, model.body_iquat[body])
        link = body_pseudo_inertia(
            float(model.body_mass[body]),
            np.diag(model.body_inertia[body]),
            pose(turned.reshape(3, 3), model.body_ipos[body]),
        )
        mass, centre, inertia = central(link + pseudo_inertia(logged.load))
        moments, axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        model.body_mass[body], model.body_ipos[body] = mass, centre
        model.body_inertia[body], model.body_iquat[body] = moments, quaternion(axes)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model, Drives(joints)


def _plain(drive: JointDrive) -> JointDrive:
    """Return a drive with its gains, but without delay and offset, as assumed before the fit."""
    same = {key: getattr(drive, key) for key in ("joint", "kind", "kp", "kv", "effort")}
    return JointDrive(**same, rotor=0.0, viscous=0.0, coulomb=0.0)


def _errors(
    path: Path, recordings: Sequence[Logged], drives: Drives, step_s: float | None, *, corrected: bool = False
) -> tuple[Array, float]:
    """Root mean square error of each joint over all rollouts, and the step; `corrected` without the effects of the file's steps."""
    model = load_model(path)
    if corrected:
        step_s = SHORT_STEP_S
        if None not in places_of(model, drives, path.name)[2]:  # all torques are those of actuators
            import mujoco

            model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
            step_s = STAGES * SHORT_STEP_S
    wanted = float(model.opt.timestep) if step_s is None else step_s
    squares, count = np.zeros(len(drives.joints)), np.zeros(len(drives.joints))
    for logged in recordings:
        recording = logged.recording
        steps = max(1, math.ceil(1.0 / (recording.rate_hz * min(wanted, MOST_STEP_S)) - 1e-6))
        model.opt.timestep = 1.0 / (recording.rate_hz * steps)
        own, drawn = _loaded(model, path.name, drives, logged)
        delayed = (_corrected if corrected else _stepped)(own, path.name, drawn)
        measured, commands = recording.measured_positions(), recording.q_ref
        assert commands is not None
        for (begin, end), at in logged.stretches.items():
            q = measured[begin:end]
            replay = replayed(own, path.name, delayed, commands[begin:end], q, recording.rate_hz, steps)
            first = left_out(len(q), recording.rate_hz)
            squares[at] += np.sum((replay - q)[first:, at] ** 2, axis=0)
            count[at] += len(q) - first
    return np.sqrt(squares / count), float(model.opt.timestep)


def replayed(
    model: Any, name: str, drives: Drives, commands: Array, measured: Array, rate_hz: float, steps: int
) -> Array:
    """Return the encoder readings in MuJoCo, (n_samples, n_joints), at the samples of the log.

    Parameters
    ----------
    model : mujoco.MjModel
        The robot.
    name : str
        Its file in messages.
    drives : Drives
        Delay at this step, offset and, where the model has no position actuator, gains of each joint.
    commands, measured : (n_samples, n_joints) array
        Commanded positions (rad or m), held between samples, and measured ones, the first of which are the start.
    rate_hz : float
        Samples per second.
    steps : int
        Steps a sample.
    """
    import mujoco

    h = float(model.opt.timestep)
    places, speeds, servo = places_of(model, drives, name)
    edges = np.arange((len(measured) - 1) * steps + 1, dtype=np.float64) * h
    delay = np.array([drive.delay_s for drive in drives.joints])
    filters = [
        None if actuator is None or model.actuator_actadr[actuator] < 0 else actuator for actuator in servo
    ]
    lags = [drive.lag_s if own is None else 0.0 for drive, own in zip(drives.joints, filters, strict=True)]
    most = np.array([drive.acceleration for drive in drives.joints])
    target = Held(commands, rate_hz).means(edges, delay, np.array(lags), most)
    target = target - np.array([drive.shift for drive in drives.joints])
    bias = np.array([drive.bias_rad for drive in drives.joints])
    kp, kv = (np.array([getattr(drive, key) or 0.0 for drive in drives.joints]) for key in ("kp", "kv"))
    limit = np.array([np.inf if drive.effort is None else drive.effort for drive in drives.joints])
    own = np.array([actuator is None for actuator in servo])
    data = mujoco.MjData(model)
    q0, dq0 = start_state(measured, rate_hz)
    data.qpos[places], data.qvel[speeds] = q0 - bias, dq0
    for j, actuator in enumerate(filters):
        if actuator is not None:
            data.act[model.actuator_actadr[actuator]] = target[0, j]
    replay = np.empty_like(measured)
    replay[0] = q0
    controls = [(actuator, j) for j, actuator in enumerate(servo) if actuator is not None]
    columns, joints = ([pair[k] for pair in controls] for k in (0, 1))
    # A held command changes once a sample; only torques that are computed here change with each step.
    changes = np.ones(len(target), dtype=bool) if own.any() else np.zeros(len(target), dtype=bool)
    changes[1:] |= np.abs(np.diff(target, axis=0)).max(axis=1) > SAME
    changes[::steps] = True
    begins = np.flatnonzero(changes)
    for k, end in itertools.pairwise([*begins.tolist(), len(target)]):
        if controls:
            data.ctrl[columns] = target[k, joints]
        if own.any():
            tau = kp * (target[k] - data.qpos[places]) - kv * data.qvel[speeds]
            # `numpy.clip` takes longer than a step.
            data.qfrc_applied[speeds] = np.where(own, np.minimum(np.maximum(tau, -limit), limit), 0.0)
        mujoco.mj_step(model, data, end - k)
        if end % steps == 0:
            replay[end // steps] = data.qpos[places] + bias
    return replay


def _early(model: Any, drives: Drives) -> Drives:
    h = float(model.opt.timestep)
    return Drives(tuple(replace(drive, delay_s=drive.delay_s + HALF * h) for drive in drives.joints))


def _stepped(model: Any, name: str, drives: Drives) -> Drives:
    """Return the drives with the delay of commands at the step of a model: that of its file, if its armatures are for this step."""
    _, speeds, servo = places_of(model, drives, name)
    early, explicit = _early(model, drives), any(actuator is None for actuator in servo)
    if integrator_of(model) == "RK4" and not explicit:
        return drives
    try:
        corrected = for_step(drives, float(model.opt.timestep), integrator_of(model), explicit_kv=explicit)
    except FitError:
        return early
    armature = np.array(model.dof_armature)[speeds]
    far = [np.abs(armature - [drive.rotor for drive in one.joints]).sum() for one in (corrected, early)]
    return corrected if far[0] < far[1] else early


def _corrected(model: Any, name: str, drives: Drives) -> Drives:
    """Take off the armatures of a model what its steps add, and return the drives with the delay of commands."""
    _, speeds, servo = places_of(model, drives, name)
    explicit = any(actuator is None for actuator in servo)
    if integrator_of(model) == "RK4" and not explicit:
        return drives
    plain = Drives(tuple(replace(drive, per_step={}) for drive in drives.joints))
    corrected = for_step(plain, float(model.opt.timestep), integrator_of(model), explicit_kv=explicit)
    for dof, new, old in zip(speeds, corrected.joints, drives.joints, strict=True):
        model.dof_armature[dof] = max(0.0, model.dof_armature[dof] + new.rotor - old.rotor)
    return _early(model, drives)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
