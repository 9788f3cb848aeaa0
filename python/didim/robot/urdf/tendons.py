"""Springs of joints, and tendons of an MJCF, in a robot's terms: shares of single joints, or motors of several joints, (22).

A tendon of length ``L = r q`` adds ``a r^T r`` to M(q), ``r^T d r dq`` to the friction, and its spring ``r^T k (L - L0)`` to the
torques. With one entry in r these are shares of that joint. Otherwise it is a motor with the row r in the coupling matrix, which
has the name of a joint without a rotor inertia of its own. Tested in ``tests/test_mjcf.py`` against MuJoCo.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..._tools.arrays import Array
from .chain import Chain
from .description import Tendon

SINGULAR = 1e-9
"""Smallest singular value of a coupling matrix whose motors determine the speeds of all joints."""


@dataclass(eq=False)
class Shares:
    """What springs and tendons add to the parameters of driven joints.

    Attributes
    ----------
    coupling : (n, n) array
        Coupling matrix, with the rows of tendons over several joints.
    springs : mapping of int to (float, float)
        Stiffness and torque at position zero by joint.
    drives : mapping of str to (n,) array
        ``Ia``, ``Fv`` and ``Fc`` that joints get of tendons.
    motors : mapping of int to Tendon
        Tendons over several joints, per unit of the speed of their motor.
    left : list of str
        Names of tendons that a robot cannot represent.
    """

    coupling: Array
    springs: dict[int, tuple[float, float]] = field(default_factory=dict)
    drives: dict[str, Array] = field(default_factory=dict)
    motors: dict[int, Tendon] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)

    def add_spring(self, joint: int, stiffness: float, torque: float) -> None:
        """Add a spring to those of a driven joint."""
        before = self.springs.get(joint, (0.0, 0.0))
        self.springs[joint] = (before[0] + stiffness, before[1] + torque)


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
    shares = Shares(np.eye(n), drives={key: np.zeros(n) for key in ("Ia", "Fv", "Fc")})
    for joint in chain.joints:
        leader, factor, offset = chain.mimics.get(joint.name, (joint.name, 1.0, 0.0))
        if joint.stiffness:  # the spring of a coupled joint acts on its leader
            torque = factor * joint.stiffness * (offset - joint.rest)
            shares.add_spring(numbers[leader], factor**2 * joint.stiffness, torque)
    for tendon in tendons:
        row, length = np.zeros(n), 0.0
        for name, coefficient in tendon.coefficients.items():
            leader, factor, offset = chain.mimics.get(name, (name, 1.0, 0.0))
            if leader in numbers:
                row[numbers[leader]] += coefficient * factor
                length += coefficient * offset
            else:
                length += coefficient * chain.locked.get(name, 0.0)
        turning = np.flatnonzero(row)
        if len(turning) == 1:
            joint = int(turning[0])
            arm = abs(row[joint])
            for key, value, power in zip(shares.drives, _drive(tendon), (2, 2, 1), strict=True):
                shares.drives[key][joint] += arm**power * value
            if tendon.stiffness:
                torque = row[joint] * tendon.stiffness * (length - tendon.rest)
                shares.add_spring(joint, arm**2 * tendon.stiffness, torque)
        elif len(turning) and not _place_motor(shares, chain, tendon, row):
            shares.left.append(tendon.name)
    return shares


def _drive(tendon: Tendon) -> tuple[float, float, float]:
    return tendon.armature, tendon.damping, tendon.friction


def _place_motor(shares: Shares, chain: Chain, tendon: Tendon, row: Array) -> bool:
    """Make a tendon the motor of its last joint without a rotor inertia; return whether there is one."""
    if tendon.stiffness or chain.mimics:
        return False
    for motor in reversed(np.flatnonzero(row).tolist()):
        coupling = shares.coupling.copy()
        coupling[motor] = row / row[motor]
        if chain.driven[motor].armature or shares.drives["Ia"][motor] or motor in shares.motors:
            continue
        if np.linalg.svd(coupling, compute_uv=False).min() > SINGULAR:
            arm = abs(row[motor])
            shares.coupling = coupling
            shares.motors[motor] = Tendon(
                tendon.name,
                tendon.coefficients,
                arm**2 * tendon.armature,
                arm**2 * tendon.damping,
                arm * tendon.friction,
            )
            return True
    return False


def with_motors(shares: Shares, drives: dict[str, Array]) -> dict[str, float]:
    """Return the drive parameters of a robot by name: those of joints contain the shares of motors, (24)."""
    n = len(shares.coupling)
    totals = {key: np.array(values) for key, values in drives.items()}
    named: dict[str, float] = {}
    for key, share in shares.drives.items():
        totals[key][:n] += share
    for motor, tendon in shares.motors.items():
        squares = shares.coupling[motor] ** 2
        totals["Ia"][:n] += squares * tendon.armature
        totals["Fv"][:n] += squares * tendon.damping
        totals["Fc"][motor] += tendon.friction
        named |= {f"Fvm{motor + 1}": tendon.damping, f"Fcm{motor + 1}": tendon.friction}
    for key, values in totals.items():
        if values.any():
            named |= {f"{key}{j + 1}": float(value) for j, value in enumerate(values)}
    return named
