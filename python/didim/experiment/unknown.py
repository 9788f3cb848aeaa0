"""Unknowns of the drives, the table ``[unknown]``: gains, limit, delay, lag and bias. Tested in ``tests/test_positions.py``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, cast, get_args

from .._tools.toml import Table
from .._tools.words import series
from ..robot.rigid_body import INERTIAL
from ..robot.robot import Robot

Shared = Literal["joint", "limb", "robot", "log"]
"""Joints that share one unknown: none (each has its own), those of a limb, all, or all within one recording."""

SOFT = ("creep_s", "rest_s")
"""Unknowns of MuJoCo's friction loss (s): a joint that sticks under a torque tau creeps with ``creep_s tau (M^-1)_jj``, which it
approaches with the time constant ``rest_s``."""
ACCELERATION = "acceleration"
"""Largest acceleration (rad/s^2) with which the set-point of a servo follows its commands."""
_OF_DRIVES = {
    "kp": ("N.m/rad", 0.0, math.inf),
    "kv": ("N.m.s/rad", 0.0, math.inf),
    "saturation": ("N.m", 0.0, math.inf),
    "delay_s": ("s", 0.0, 0.1),
    "lag_s": ("s", 0.0, 0.1),
    "bias_rad": ("rad", -0.1, 0.1),
    ACCELERATION: ("rad/s^2", 1.0, 1e4),
    SOFT[0]: ("s", 1e-6, 1.0),
    SOFT[1]: ("s", 1e-3, 0.1),
}
DRIVE = tuple(_OF_DRIVES)
"""Unknowns of position servos ``tau = sat(kp (r(t - delay) - q - bias) - kv dq)``, with the reference behind a first-order
lag or a set-point whose acceleration is limited, and of their friction."""
UNITS = {kind: unit for kind, (unit, _, _) in _OF_DRIVES.items()}
"""Units of the unknowns of revolute joints."""
RANGES = {kind: (low, high) for kind, (_, low, high) in _OF_DRIVES.items()}
"""Default bounds of the unknowns: delays and lags beyond 0.1 s and biases beyond 6 degrees are faults of a robot, and a simulation
whose sticking joints come to rest within less than 1 ms needs shorter steps than its users take."""


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """Prior knowledge of one kind of parameter.

    Attributes
    ----------
    start : float or None
        Start of the search; by default the value of the robot, of the controller, or zero.
    low, high : float
        Bounds.
    sigma : float
        Standard deviation of the start as a prior; infinite without one.
    shared : {"joint", "limb", "robot", "log"}
        Joints that share it.
    """

    start: float | None = None
    low: float = -math.inf
    high: float = math.inf
    sigma: float = math.inf
    shared: Shared = "joint"


def joint_kinds(robot: Robot) -> tuple[str, ...]:
    """Return the kinds of joint parameters: rotor inertia, friction and its terms."""
    kinds = (parameter.kind for parameter in robot.standard_parameters)
    return tuple(dict.fromkeys(kind for kind in kinds if kind not in INERTIAL))


def read_unknown(table: Table, robot: Robot) -> dict[str, Unknown]:
    """Read ``[unknown]``: one table per kind of drive unknown, or of joint parameter."""
    unknown, known = {}, DRIVE + joint_kinds(robot)
    for kind in table.content:
        if kind not in known:
            table.fail(f"there is no unknown {kind!r}; there are {series(known)}")
    for kind in (kind for kind in known if kind in table.content):
        part = table.table(kind)
        low, high = RANGES.get(kind, (-math.inf, math.inf))
        low, high = part.number("min", low), part.number("max", high)
        if kind == ACCELERATION and low <= 0.0:
            part.fail(f"min must be above 0, got {low:g}")
        start, sigma = part.number("start", None), part.number("sigma", math.inf)
        if not low < high or (start is not None and not low <= start <= high):
            part.fail(f"min, start and max must be in order, got {low:g}, {start}, {high:g}")
        # True means the whole robot. Those of commands are shared by default: drives on one bus have the same.
        given = part.raw("shared", kind in ("delay_s", "lag_s", ACCELERATION))
        if isinstance(given, bool):
            given = "robot" if given else "joint"
        if given not in get_args(Shared):
            part.fail(f'shared must be true, false, "joint", "limb", "robot" or "log", got {given!r}')
        unknown[kind] = Unknown(start=start, low=low, high=high, sigma=sigma, shared=cast("Shared", given))
        part.done()
    table.done()
    return unknown
