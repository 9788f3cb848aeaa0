"""Springs of joints, tendons and actuators of an MJCF in a robot's terms: shares of single joints, or motors of several, (22).

A tendon of length ``L = r q`` adds ``a r^T r`` to M(q), ``r^T d r dq`` to the friction, and its spring ``r^T k (L - L0)`` to the
torques. With one entry in r these are shares of that joint. Otherwise it is a motor with the row r in the coupling matrix, which
has the name of a joint without a rotor inertia of its own. An actuator on a joint that follows another, or on a tendon over
joints that are tied together, is one of their leader: there a servo has the stiffness ``r^2 kp`` and the damping ``r^2 kv``.
Tested in ``tests/test_mjcf_features.py`` against MuJoCo.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..._tools.arrays import Array
from ..payload import LARGEST
from ..robot import JointLimits
from ..transmission import Actuator
from .chain import Chain
from .mechanism import Servo, Tendon

SINGULAR = 1e-9
"""Smallest singular value of a coupling matrix whose motors determine the speeds of all joints; no difference of commands."""

POWERS = (2, 2, 1)
"""Powers of a moment arm by which rotor inertia, viscous and Coulomb friction of a tendon act on a joint."""


@dataclass(eq=False)
class Shares:
    """What springs and tendons add to the parameters of driven joints.

    Attributes
    ----------
    coupling : (n, n) array
        Coupling matrix, with the rows of tendons over several joints.
    drives : (3, n) array
        ``Ia``, ``Fv`` and ``Fc`` that joints get of tendons.
    springs : mapping of int to (float, float)
        Stiffness and torque at position zero by joint.
    motors : mapping of int to (3,) array
        ``Ia``, ``Fvm`` and ``Fcm`` of tendons over several joints, by motor.
    sources : mapping of int to (str, float)
        Name of the tendon of each motor, and its moment arm on the motor's own joint.
    left : list of str
        Names of tendons that a robot cannot represent.
    actuators : list of Actuator or None
        Gains and limit of each driven joint's actuators.
    limits : list of JointLimits
        Limits of each driven joint, with that of its actuators.
    pulled : mapping of int to list of (str, float)
        Names of the servos that these are made of, and their moment arms.
    commands : list of str
        Positions of joints as functions of commands that are something else.
    unread : list of str
        Names of actuators that a robot cannot represent.
    """

    coupling: Array
    drives: Array
    springs: dict[int, tuple[float, float]] = field(default_factory=dict)
    motors: dict[int, Array] = field(default_factory=dict)
    sources: dict[int, tuple[str, float]] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    actuators: list[Actuator | None] = field(default_factory=list)
    limits: list[JointLimits] = field(default_factory=list)
    pulled: dict[int, list[tuple[str, float]]] = field(default_factory=dict)
    commands: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)


def shares_of(chain: Chain, tendons: tuple[Tendon, ...]) -> Shares:
    """Return what the springs of a chain's joints, and tendons, add to its driven joints.

    Parameters
    ----------
    chain : Chain
        The chain, driven joints first.
    tendons : tuple of Tendon
        Those of the whole file; a locked joint only changes the rest of a spring.
    """
    numbers = {joint.name: number for number, joint in enumerate(chain.driven)}
    n = len(numbers)
    shares = Shares(np.eye(n), np.zeros((3, n)))
    springs = (Tendon(j.name, {j.name: 1.0}, stiffness=j.stiffness, rest=j.rest) for j in chain.joints)
    for tendon in (*springs, *tendons):
        row, length = _row(chain, numbers, tendon)
        joints = [int(joint) for joint in np.flatnonzero(row)]
        drive = np.array([tendon.armature, tendon.damping, tendon.friction])
        if len(joints) == 1:
            arm = float(row[joints[0]])
            shares.drives[:, joints[0]] += drive * np.power(abs(arm), POWERS)
            if tendon.stiffness:
                before = shares.springs.get(joints[0], (0.0, 0.0))
                torque = arm * tendon.stiffness * (length - tendon.rest)
                shares.springs[joints[0]] = (before[0] + arm**2 * tendon.stiffness, before[1] + torque)
        elif joints and (tendon.stiffness or drive.any()):
            free = [
                m
                for m in joints
                if not (chain.driven[m].armature or shares.drives[0, m] or m in shares.motors)
            ]
            motor = None if tendon.stiffness or chain.mimics else _motor(shares.coupling, row, free)
            if motor is None:
                shares.left.append(tendon.name)
            else:
                shares.coupling[motor] = row / row[motor]
                shares.sources[motor] = tendon.name, abs(float(row[motor]))
                shares.motors[motor] = drive * np.power(abs(row[motor]), POWERS)
    _pull(shares, chain, [tendon for tendon in tendons if tendon.servo is not None])
    return shares


def _row(chain: Chain, numbers: Mapping[str, int], tendon: Tendon) -> tuple[Array, float]:
    """Return the moment arms of a tendon on the driven joints, and its length where these are at zero."""
    row, length = np.zeros(len(numbers)), 0.0
    for name, coefficient in tendon.coefficients.items():
        leader, factor, offset = chain.mimics.get(name, (name, 1.0, chain.locked.get(name, 0.0)))
        length += coefficient * offset
        if leader in numbers:
            row[numbers[leader]] += coefficient * factor
    return row, length


def _pull(shares: Shares, chain: Chain, tendons: Sequence[Tendon]) -> None:
    """Give driven joints the gains and limits of actuators."""
    numbers = {joint.name: number for number, joint in enumerate(chain.driven)}
    gains, lags = np.zeros((2, len(numbers))), np.zeros(len(numbers))
    forces: dict[str, Array] = {}  # of each joint, to move its leader down and up
    for tendon in tendons:
        servo, (row, length) = tendon.servo or Servo(), _row(chain, numbers, tendon)
        joints = np.flatnonzero(row).tolist()
        if not (servo.linear and tendon.coefficients) or len(joints) > 1:
            shares.unread.append(tendon.name)
        if not (joints and servo.linear) or (len(joints) > 1 and (servo.kp or servo.kv)):
            continue
        number, arm = joints[0], float(row[joints[0]])
        for name, own in tendon.coefficients.items():
            leader = chain.mimics.get(name, (name,))[0]
            if own and leader in numbers:
                towards = servo.forces if row[numbers[leader]] > 0.0 else servo.forces[::-1]
                forces[name] = forces.get(name, 0.0) + own * np.array(towards)
        if len(joints) > 1:
            continue
        kv = np.nan if servo.kv is None else servo.kv
        gains[:, number] += arm**2 * servo.kp, arm**2 * kv
        lags[number] = max(lags[number], servo.lag_s)
        shares.pulled.setdefault(number, []).append((tendon.name, arm))
        slope, zero = servo.slope / arm, (servo.offset - length * (servo.kp > 0.0)) / arm
        if (servo.kp or kv) and max(abs(slope - 1.0), abs(zero)) > SINGULAR:
            means = f"{chain.driven[number].name} = {slope:.6g} {tendon.name}"
            shares.commands.append(means + (f" {zero:+.6g}" if zero else ""))
    totals: dict[str, Array] = {}
    for joint in chain.joints:
        if joint.name in forces:
            leader, factor = chain.mimics.get(joint.name, (joint.name, 1.0))[:2]
            totals[leader] = totals.get(leader, 0.0) + factor * np.clip(forces[joint.name], *joint.forces)
    for joint, kp, kv, lag in zip(chain.driven, *gains.tolist(), lags.tolist(), strict=True):
        # Without an actuator a joint has the limit that the file gives it.
        largest = float(np.abs(totals.get(joint.name, joint.forces)).max())
        limit = largest if 0.0 < largest <= LARGEST else None
        actuator = Actuator(effort=limit) if joint.name in totals or limit is not None else None
        if kp or kv:
            actuator = Actuator(kp=kp or None, kv=None if np.isnan(kv) else kv, effort=limit, lag_s=lag)
        shares.actuators.append(actuator)
        shares.limits.append(replace(joint.limits, effort=limit) if actuator else joint.limits)


def _motor(coupling: Array, row: Array, free: list[int]) -> int | None:
    """Return the last of these joints that can be replaced by a motor with a row of the coupling matrix."""
    for motor in reversed(free):
        trial = coupling.copy()
        trial[motor] = row / row[motor]
        if np.linalg.svd(trial, compute_uv=False).min() > SINGULAR:
            return motor
    return None


def drive_parameters(shares: Shares, own: Array) -> dict[str, float]:
    """Return the drive parameters of a robot by name: those of joints contain the shares of motors, (24).

    `own` are ``Ia``, ``Fv`` and ``Fc`` of all joints, (3, n_joints).
    """
    n = len(shares.coupling)
    totals = own.copy()
    named: dict[str, float] = {}
    totals[:, :n] += shares.drives
    for motor, drive in shares.motors.items():
        totals[:2, :n] += np.outer(drive[:2], shares.coupling[motor] ** 2)
        totals[2, motor] += drive[2]
        named |= {f"Fvm{motor + 1}": float(drive[1]), f"Fcm{motor + 1}": float(drive[2])}
    for key, values in zip(("Ia", "Fv", "Fc"), totals, strict=True):
        named |= {f"{key}{j + 1}": float(value) for j, value in enumerate(values) if values.any()}
    return named
