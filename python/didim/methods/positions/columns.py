"""Columns of CLOE from positions: what is estimated, where it starts and between which bounds.

Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array, quotient
from ..._tools.words import did_you_mean
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...experiment.loop import recordings_of
from ...experiment.unknown import ACCELERATION, DRIVE, SOFT, UNITS, Shared, Unknown, joint_kinds
from ...loop.controller import Controller
from ...model.consistency import places_of
from ...model.limbs import Limb
from ...robot.payload import NOTHING, payload_columns
from ...robot.transmission import SOFTNESS

Asked = tuple[str, tuple[int, ...], int | None, str]
"""Kind, joints, recording and name of an unknown, as in `Column`."""
STICKS = 1e4
"""Largest friction in steps for differences, which are a thousandth of the servo's rms torque: a joint that moves has less than ten
times that torque, and one that sticks does not tell how much more it has."""
NEVER_NEGATIVE = frozenset({"Ia", "Fv", "Fc"})
"""Parameters of joints with a lower bound of zero."""


@dataclass(frozen=True)
class Column:
    """One unknown.

    Attributes
    ----------
    kind : str
        "Ia", "Fv", "Fc", "Off", a friction term, or one of `didim.experiment.unknown.DRIVE`.
    joints : tuple of int
        Joints that have it, from 0.
    recording : int or None
        Recording that it belongs to; None for all.
    name, unit : str
        ``Ia3``, or ``kp3``, or ``delay_s`` of all joints.
    start, low, high : float
        Where the search starts, and bounds.
    sigma : float
        Standard deviation of the start as a prior; infinite without one.
    step : float
        Change for a difference.
    """

    kind: str
    joints: tuple[int, ...]
    recording: int | None
    name: str
    unit: str
    start: float
    low: float
    high: float
    sigma: float
    step: float

    @property
    def of_drive(self) -> bool:
        """Whether the unknown belongs to a servo; otherwise it is a standard parameter."""
        return self.kind in DRIVE

    @property
    def scales(self) -> bool:
        """Whether it is a factor of torques, which a gain kp takes too."""
        return self.kind not in DRIVE or self.kind in ("kv", "saturation")


@dataclass(frozen=True)
class Values:
    """Values before the fit.

    Attributes
    ----------
    x : (n_parameters,) array
        Standard parameters of the robot without a payload.
    drive : dict of str to (n_dof,) array
        Numbers of the servos by kind.
    loads : (n_recordings, n_parameters) array
        What the payload of each recording adds to the standard parameters.
    shares : (n_recordings, n_dof) array
        Gains kp of each recording over those of the controller.
    """

    x: Array
    drive: dict[str, Array]
    loads: Array
    shares: Array

    def along(self, recording: int) -> Values:
        """Return the values in a recording, with its payload and its gains."""
        drive = {**self.drive, "kp": self.drive["kp"] * self.shares[recording]}
        return replace(self, x=self.x + self.loads[recording], drive=drive)


def file_values(experiment: Experiment, given: Mapping[str, float] | None = None) -> Values:
    """Return links, rotors and friction of the robot file, with other values `given`, and the law of ``[controller]``.

    Raises
    ------
    FitError
        Where the file has no parameters, or the law is not that of position servos.
    """
    robot = experiment.robot
    name = next((name for name in ("urdf", "mjcf", "apriori", *robot.sets) if name in robot.sets), None)
    if name is None:
        raise FitError(
            f'{experiment.name}: links = "fixed" needs masses and inertias, and {robot.path.name} has none'
        )
    x, places = np.array(robot.sets[name]), places_of(robot)
    for key in given or ():
        if key not in places:
            raise FitError(f"start: there is no {key!r}{did_you_mean(key, places)}")
    for key, value in {**(given or {}), **experiment.fixed}.items():
        if key in places:
            x[places[key]] = value
    controller = experiment.controller
    plain = getattr(getattr(controller, "build", None), "plain", None)
    law = controller if isinstance(controller, Controller) else None if plain is None else plain()
    if law is None or law.kind != "pd" or law.digital is not None or law.feedforward is not None:
        raise FitError(
            f'{experiment.name}: links = "fixed" needs [controller] kind = "pd", without sample_time_s'
        )
    kp = law.laws[:, 0] * law.gain
    drive = {
        "kp": kp,
        "kv": law.laws[:, 1] * law.gain,
        "saturation": law.saturation * law.gain,
        **dict.fromkeys(("delay_s", "bias_rad"), np.zeros(robot.n_dof)),
        "lag_s": np.array(
            [0.0 if servo is None else servo.lag_s for servo in robot.actuators or [None] * robot.n_dof]
        ),
    }
    if ACCELERATION in experiment.unknown:
        drive[ACCELERATION] = np.full(robot.n_dof, np.inf)
        if "lag_s" in experiment.unknown or drive["lag_s"].any():
            raise FitError(f"{experiment.name}: [unknown.acceleration] is for servos without lag_s")
    drive |= dict(zip(SOFT, np.transpose(robot.softness or [SOFTNESS] * robot.n_dof), strict=True))
    for kind, unknown in experiment.unknown.items():
        if unknown.start is not None and kind in drive:
            drive[kind] = np.full(robot.n_dof, unknown.start)
        elif unknown.start is not None:
            for joint in range(robot.n_dof):
                if (name := f"{kind}{joint + 1}") in places:
                    x[places[name]] = unknown.start
    return Values(x, drive, _loads(experiment), _shares(experiment, kp))


def _loads(experiment: Experiment) -> Array:
    """Return what the payload of each recording adds to the standard parameters, (n_recordings, n_parameters)."""
    robot, columns = experiment.robot, []
    for recording in experiment.recordings:
        load = np.zeros(len(robot.parameter_names))
        if recording.payload != NOTHING:
            payload = experiment.payloads.get(recording.payload)
            if payload is None or not payload.known:
                raise FitError(
                    f"recording '{recording.name}': links = \"fixed\" needs mass_kg, com_m and inertia_kg_m2 of "
                    f"[payload.{recording.payload}]"
                )
            load = payload_columns(robot, payload, experiment.flange) @ payload.split[0]
        columns.append(load)
    return np.reshape(columns, (len(columns), len(robot.parameter_names)))


def _shares(experiment: Experiment, kp: Array) -> Array:
    """Return the gains kp of each recording over those of the controller, (n_recordings, n_dof)."""
    shares = np.ones((len(experiment.recordings), len(kp)))
    for share, recording in zip(shares, experiment.recordings, strict=True):
        if recording.own:
            raise FitError(
                f"recording '{recording.name}': links = \"fixed\" has no own {recording.own[0]}; [unknown] has "
                'shared = "log" for drives'
            )
        if recording.kp is not None:
            share[:] = quotient(np.asarray(recording.kp), kp, 1.0)
    return shares


def columns_of(
    experiment: Experiment, limbs: Sequence[Limb], values: Values, steps: Mapping[str, Array]
) -> list[Column]:
    """Return the unknowns: those of each joint first, by joint, then those that joints share.

    `steps` are the changes for differences by kind, (n_dof,) each; joints that share an unknown take the smallest.
    """
    robot, places, columns = experiment.robot, places_of(experiment.robot), []
    for kind, joints, recording, name in _asked(experiment, limbs):
        unknown, at = experiment.unknown.get(kind, Unknown()), list(joints)
        if kind in DRIVE:
            start, unit = float(np.mean(values.drive[kind][at])), UNITS[kind]
            if not math.isfinite(start):
                raise FitError(f"[unknown.{kind}] needs a start, for [controller] has no {kind} ({name})")
            start = min(max(start, unknown.low), unknown.high)
            if any(robot.joint_kinds[joint] == "prismatic" for joint in joints):
                unit = unit.replace("N.m", "N").replace("rad", "m")
        else:
            start, unit = float(values.x[places[name]]), robot.parameter_units[places[name]]
        low = max(unknown.low, 0.0 if kind in NEVER_NEGATIVE else -math.inf)
        step = float(np.min(steps[kind][at]))
        high = unknown.high
        if kind == "Fc" and "kp" not in experiment.unknown:
            high = min(high, max(STICKS * step, start))
        columns.append(Column(kind, joints, recording, name, unit, start, low, high, unknown.sigma, step))
    return columns


def _asked(experiment: Experiment, limbs: Sequence[Limb]) -> list[Asked]:
    """Return all unknowns, those of each joint first, then those of drives in the order of the experiment."""
    robot, known = experiment.robot, {*experiment.dropped, *experiment.fixed}
    every = tuple(range(robot.n_dof))
    asked: list[Asked] = []
    for joint, kind in itertools.product(every, joint_kinds(robot)):
        name = f"{kind}{joint + 1}"
        if name in robot.parameter_names and name not in known and kind not in experiment.dropped:
            asked.append((kind, (joint,), None, name))
    for kind in (kind for kind in experiment.unknown if kind in DRIVE):
        groups: dict[Shared, list[Asked]] = {
            "joint": [(kind, (joint,), None, f"{kind}{joint + 1}") for joint in every],
            "limb": [(kind, limb.joints, None, f"{kind} {limb.name}".strip()) for limb in limbs],
            "robot": [(kind, every, None, kind)],
            "log": [
                (kind, every, k, f"{kind} {recording.name}") for k, recording in recordings_of(experiment)
            ],
        }
        asked += groups[experiment.unknown[kind].shared]
    return asked
