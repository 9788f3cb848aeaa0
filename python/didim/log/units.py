"""Units of a log: factors to SI, and the reduction to the joint side.

Results are in rad or m, N.m or N. Tested in ``tests/test_recording.py``.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import listing
from ..robot.robot import Robot

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
"""Seconds per unit of time."""

TEMPERATURE = {"degC": 0.0, "K": -273.15}
"""Zero of each unit of temperature (degC)."""

POSITION = {"rad": 1.0, "deg": math.pi / 180.0, "m": 1.0, "mm": 1e-3}
"""Radians or metres per unit of position; counts also need the encoder's resolution."""

SHARES = {"percent": 50.0, "signed-percent": 0.0}
"""Value at the middle of a joint's range, by unit: LeRobot logs grippers from 0 to 100 and other motors from -100 to 100."""

VELOCITY = {f"{unit}/s": factor for unit, factor in POSITION.items()}
"""Radians or metres per second per unit of velocity."""

EFFORT = ("N.m", "N", "A", "V")
"""Units of torque and force; amperes and volts need a drive gain."""

ESTIMATE = "estimate"
"""Value of `gain` for currents whose drive gains are to be estimated from the log."""

_LINEAR = ("m", "mm", "N", "m/s", "mm/s")
_ANGULAR = ("rad", "deg", "count", "N.m", "rad/s", "deg/s")


def motor_ratios() -> list[float]:
    """Return the gear ratios that are tried, from the smallest."""
    # Gear ratios that are tried for positions too large for joints: those of arms are between 30 and 250.
    low, high = np.log((10.0, 400.0))
    # Step of the logarithm of the ratio: an error of 5 % moves a joint of two radians by 6 degrees, and its torques by as much.
    count = math.ceil((high - low) / 0.1) + 1
    return [float(ratio) for ratio in np.exp(np.linspace(low, high, count))]


def kind_of(unit: str) -> str:
    """Return the kind of the joints that have a unit."""
    return "prismatic" if unit in _LINEAR else "revolute"


def has_joint_values(table: Table, key: str, per: str = "") -> bool:
    """Whether a table has a key for `joint_values`, in any unit."""
    return any(table.has(f"{key}_{unit}{per}") for unit in POSITION)


def joint_values(
    table: Table, key: str, robot: Robot, per: str = "", default: float | None = None
) -> list[float]:
    """Return one number per joint of a key such as ``max_velocity_rad_s``, given once per kind or per joint."""
    values: list[float | None] = [default] * len(robot.joint_kinds)
    for unit, factor in POSITION.items():
        numbers = table.spread(f"{key}_{unit}{per}", len(values), None)
        if numbers is None:
            continue
        kind = kind_of(unit)
        if kind not in robot.joint_kinds:
            table.fail(f"{key}_{unit}{per} is for {kind} joints, and robot {robot.name!r} has none")
        other = {"deg": "rad", "mm": "m"}.get(unit)
        if other and table.has(f"{key}_{other}{per}"):
            table.fail(f"give {key}_{other}{per} or {key}_{unit}{per}, not both")
        for joint, number in enumerate(numbers):
            if robot.joint_kinds[joint] == kind:
                values[joint] = number * factor
    given = [value for value in values if value is not None]
    if len(given) < len(values):
        joint = values.index(None)
        unit = "rad" if robot.joint_kinds[joint] == "revolute" else "m"
        table.fail(f"key '{key}_{unit}{per}' is missing, for joint {joint + 1}")
    return given


def optional_joint_values(
    table: Table, key: str, robot: Robot, per: str = "", default: float | None = None
) -> list[float] | None:
    """Return `joint_values`, or None without the key in any unit."""
    return joint_values(table, key, robot, per, default) if has_joint_values(table, key, per) else None


def _units(table: Table, allowed: Collection[str], side: str, joint_kinds: Sequence[str]) -> list[str]:
    """Return one unit for each column, given once or as a list; on the joint side it must suit the joint."""
    n = len(joint_kinds)
    units = table.texts("unit") if isinstance(table.raw("unit"), list) else [table.text("unit")] * n
    if len(units) != n:
        table.fail(f"unit must be one text or a list of {n}, got {len(units)}")
    for unit in units:
        if unit not in allowed:
            table.fail(f"unit {unit!r} is unknown here; known are {listing(allowed)}")
    for i, (unit, kind) in enumerate(zip(units, joint_kinds, strict=True)):
        if side == "joint" and unit in (_LINEAR if kind == "revolute" else _ANGULAR):
            table.fail(f"unit {unit!r} does not suit joint {i + 1}, which is {kind}")
    return units


def _scales(table: Table, n: int) -> Array:
    """Factors of `scale` and `sign`, in any unit: one number, or one for each column."""
    scale, sign = np.array(table.spread("scale", n)), np.array(table.spread("sign", n))
    if not scale.all():
        table.fail("scale must not be zero")
    if (np.abs(sign) != 1.0).any():
        table.fail(f"sign must be 1 or -1, for all columns or one for each, got {table.raw('sign')!r}")
    return np.asarray(scale * sign)


def velocity_factors(table: Table, side: str, joint_kinds: Sequence[str]) -> Array:
    """Factor of each velocity column to rad/s or m/s, with `scale` and `sign`; keys as of `position_factors`."""
    units = _units(table, VELOCITY, side, joint_kinds)
    return np.array([VELOCITY[unit] for unit in units]) * _scales(table, len(units))


def position_factors(
    table: Table, side: str, joint_kinds: Sequence[str], ranges: Sequence[tuple[float, float] | None]
) -> tuple[Array, Array]:
    """Factor of each position column to rad or m, and the position (rad or m) at which each column is zero.

    Parameters
    ----------
    table
        ``[recording.position]``: `unit` is rad, deg, m, mm or count, the last with `counts_per_rev` (a number
        or one for each column), or percent (0 to 100) and signed-percent (-100 to 100) of the joint's range; `scale` and
        `sign`, a number or one for each column, multiply any unit.
    side
        "motor" or "joint"; on the joint side the units must suit the joints.
    joint_kinds
        "revolute" or "prismatic" for each joint.
    ranges
        Lowest and highest position of each joint (rad or m), None without limits.
    """
    n = len(joint_kinds)
    units = _units(table, [*POSITION, *SHARES, "count"], side, joint_kinds)
    factors, zeros = _scales(table, n), np.zeros(n)
    counts = table.spread("counts_per_rev", n) if "count" in units else [1.0] * n
    if not all(counts):
        table.fail("counts_per_rev must not be zero")
    for j, (unit, count, limits) in enumerate(zip(units, counts, ranges, strict=True)):
        if unit not in SHARES:
            factors[j] *= 2.0 * math.pi / count if unit == "count" else POSITION[unit]
            continue
        if limits is None or side != "joint":
            table.fail(f"unit {unit!r} needs the limits of joint {j + 1} in the robot file, and side 'joint'")
        low, high = limits
        factors[j] = factors[j] * (high - low) / (100.0 if unit == "percent" else 200.0)
        zeros[j] = 0.5 * (low + high) - factors[j] * SHARES[unit]
    return factors, zeros


def effort_factors(
    table: Table, side: str, joint_kinds: Sequence[str], robot_gains: Sequence[float] | None
) -> Array:
    """Factor of each torque column to N.m or N, on the side it was logged on; to A for ``gain = "estimate"``.

    Parameters
    ----------
    table
        ``[recording.torque]``: `unit` is N.m, N, A or V, the last two with `gain` in N.m (or N) per A or V.
    side
        "motor" or "joint"; on the joint side the units must suit the joints.
    joint_kinds
        "revolute" or "prismatic" for each joint.
    robot_gains
        Drive gains of the robot file, used if the table has no `gain`.
    """
    n = len(joint_kinds)
    units = _units(table, EFFORT, side, joint_kinds)
    scales = _scales(table, n)
    if table.raw("gain", None) == ESTIMATE:
        for unit in units:
            if unit != "A":
                table.fail(f"gain 'estimate' is for currents in A, and the unit is {unit!r}")
        return scales
    electrical = [unit for unit in units if unit in ("A", "V")]
    if not electrical:
        if table.has("gain"):
            table.fail(
                f"gain is for torques logged in A or V, and the unit is {units[0]!r}; scale and sign are for any unit"
            )
        return scales
    gains = table.spread("gain", n, None) or robot_gains
    if gains is None:
        table.fail(f"unit {electrical[0]!r} needs the drive gain: gain = number or list of {n}")
    if not all(gains):
        table.fail("gain must not be zero")
    return np.where([unit in ("A", "V") for unit in units], gains, 1.0) * scales
