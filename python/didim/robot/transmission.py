"""Transmissions between commands and joints: actuators of a description, motor reductions, coupled joints.

Coupled joints ``q = G q_a + q_0`` with constant G occur in fingers, telescopes and parallelograms. Only the driven joints have
a torque, a controller and a column in a log; they have the first numbers. The torques are ``G^T tau(q, dq, ddq)``, the
regressor is ``G^T W``
and the inertia matrix ``G^T M G``, by the core. Tested in ``tests/test_mjcf.py``, ``tests/test_recording.py`` and
``tests/test_couplings.py``, there against Pinocchio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array
from .._tools.toml import Table


@dataclass(frozen=True, kw_only=True)
class Actuator:
    """Position servo or torque source of a joint: ``tau = kp (command - q) - kv dq``, limited; joint side, after the gear.

    Attributes
    ----------
    kp : float or None
        Gain on the position error (N.m/rad or N/m); None where the actuator takes torques or velocities.
    kv : float or None
        Gain on the velocity (N.m.s/rad or N.s/m); None where the actuator takes torques.
    effort : float or None
        Largest torque or force (N.m or N); None without a limit.
    lag_s : float
        Time constant of the filter of the command (s); 0 without a filter.
    """

    kp: float | None = None
    kv: float | None = None
    effort: float | None = None
    lag_s: float = 0.0


IMPEDANCE, LARGEST_IMPEDANCE, TIME_CONSTANT_S = 0.9, 0.95, 0.02
"""First two numbers of MuJoCo's default ``solimpfriction``, and the first one (s) of its default ``solreffriction``."""


def softness(least: float, largest: float, time_constant_s: float) -> tuple[float, float]:
    """Return the softness of MuJoCo's friction loss, ``-(A^-1 / creep) (rest ddq + dq)`` between -Fc and Fc, A that of ``M^-1``.

    Parameters
    ----------
    least, largest : float
        Impedances ``d0`` and ``dmax`` of ``solimpfriction``.
    time_constant_s : float
        First number of ``solreffriction`` (s).

    Returns
    -------
    creep, rest : float
        ``rest (1 - d0) / d0`` and ``dmax timeconst / 2`` (s).
    """
    rest = largest * time_constant_s / 2.0
    return rest * (1.0 - least) / least, rest


SOFTNESS = softness(IMPEDANCE, LARGEST_IMPEDANCE, TIME_CONSTANT_S)
"""Creep and rest (s) of MuJoCo's friction loss by its defaults."""


def reduction_matrix(table: Table, n_dof: int) -> NDArray[np.float64]:
    """Read the reduction matrix R, (n_dof, n_dof), rows motors, columns joints: ``q_motor = R q``.

    Parameters
    ----------
    table
        ``[transmission]`` of a robot or an experiment file.
    n_dof
        Number of joints.

    Raises
    ------
    DidimError
        Of the table's class, when the matrix is singular.
    """
    reduction = np.array(table.matrix("reduction", n_dof, n_dof))
    for row in range(n_dof):
        if np.linalg.matrix_rank(reduction[: row + 1]) <= row:
            what = "zero" if not reduction[row].any() else "a combination of the rows before it"
            table.fail(f"reduction is singular: the row of motor {row + 1} is {what}")
    return reduction


@dataclass(frozen=True, kw_only=True)
class Follower:
    """A joint coupled to driven ones: ``q = sum of factor times q_leader, + offset``.

    Attributes
    ----------
    leaders : tuple of (int, float)
        Driven joints, from 0, with their factors (rad/rad, m/rad, ...).
    offset : float
        Position where all leaders are at zero (rad or m).
    name : str
        Name of the joint; empty where the file has none.
    """

    leaders: tuple[tuple[int, float], ...]
    offset: float = 0.0
    name: str = ""


def joint_motion(followers: Sequence[Follower], driven: Array, position: bool = False) -> Array:
    """Return the motion of all joints, ``(n_samples, n_joints)``, from that of the driven ones; positions include the offsets."""
    if not followers:
        return driven
    columns = [
        sum((factor * driven[:, leader] for leader, factor in follower.leaders), np.zeros(len(driven)))
        + (follower.offset if position else 0.0)
        for follower in followers
    ]
    return np.column_stack([driven, *columns])


def driven_part(followers: Sequence[Follower], joints: Array) -> Array:
    """Return a torque or derivative of all joints reduced to the driven ones, ``G^T v``, along the last axis."""
    n = joints.shape[-1] - len(followers)
    driven = joints[..., :n].copy()
    for k, follower in enumerate(followers):
        for leader, factor in follower.leaders:
            driven[..., leader] += factor * joints[..., n + k]
    return driven


def read_followers(
    tables: Sequence[Table], kinds: Sequence[str], names: Sequence[str]
) -> tuple[Follower, ...]:
    """Read the tables ``[[coupling]]`` of a robot file.

    Parameters
    ----------
    tables : sequence of Table
        One table per coupled joint.
    kinds, names : sequence of str
        Of all joints; `names` may be empty.

    Raises
    ------
    RobotError
        When the coupled joints are not the last of the file, or a leader does not precede its follower.
    """
    n = len(kinds)
    driven = n - len(tables)
    followers: dict[int, Follower] = {}
    for table in tables:
        joint = table.integer("joint")
        if not driven < joint <= n or joint in followers:
            which = f"joint {driven + 1}" if driven + 1 == n else f"joints {driven + 1} to {n}"
            table.fail(
                f"joints that follow others are the last ones of the file, each once: {which}, got {joint}"
            )
        turns = kinds[joint - 1] == "revolute"
        leaders = table.numbers("follows", length=None)
        factors = table.numbers("factors", length=len(leaders))
        offset = table.number("offset_rad" if turns else "offset_m")
        table.done()
        for leader in leaders:
            if leader not in range(1, driven + 1):
                table.fail(f"follows has driven joints, 1 to {driven}, got {leader:g}")
        if not leaders or 0.0 in factors or len(set(leaders)) < len(leaders):
            table.fail(
                "follows needs one or more different joints, and factors one number other than 0 for each"
            )
        rows = tuple((int(leader) - 1, factor) for leader, factor in zip(leaders, factors, strict=True))
        followers[joint] = Follower(leaders=rows, offset=offset, name=names[joint - 1] if names else "")
    return tuple(followers[joint] for joint in sorted(followers))
