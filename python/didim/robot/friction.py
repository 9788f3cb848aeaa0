"""Friction of a robot: the model and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .._tools.toml import Table


@dataclass(frozen=True, kw_only=True)
class Friction:
    """Shape of the friction of a robot, and how its sign is taken near standstill.

    Attributes
    ----------
    model : {"symmetric", "asymmetric"}
        ``Fv Fc Off`` per joint, or ``Fv+ Fc+ Fv- Fc-``, one pair per direction.
    coulomb : {"sign", "tanh"}
        ``sign(dq)``, or ``tanh(dq / smoothing)``.
    coupling : {"shaft", "printed"}
        Coulomb friction of coupled motors: on the motor shaft, or equation (23) as printed.
    smoothing : tuple of float
        Velocity of the tanh per joint (rad/s or m/s).
    dead_zone : tuple of float
        Speed per joint (rad/s or m/s) up to which the sign is zero.
    """

    model: str
    coulomb: str
    coupling: str
    smoothing: tuple[float, ...]
    dead_zone: tuple[float, ...]


def read_friction(table: Table, kinds: Sequence[str], default: Friction | None) -> Friction:
    """Read ``[friction]``; what it does not name is that of `default`, or symmetric Coulomb friction without smoothing."""
    nothing = (0.0,) * len(kinds)
    default = default or Friction(
        model="symmetric", coulomb="sign", coupling="shaft", smoothing=nothing, dead_zone=nothing
    )
    friction = Friction(
        model=table.text("model", default.model, choices=("symmetric", "asymmetric")),
        coulomb=table.text("coulomb", default.coulomb, choices=("sign", "tanh")),
        coupling=table.text("coupling", default.coupling, choices=("shaft", "printed")),
        smoothing=_per_joint(table, "smoothing", kinds, default.smoothing),
        dead_zone=_per_joint(table, "dead_zone", kinds, default.dead_zone),
    )
    table.done()
    if friction.coulomb == "tanh" and not all(friction.smoothing):
        joint = friction.smoothing.index(0.0)
        unit = "rad_s" if kinds[joint] == "revolute" else "m_s"
        table.fail(f"coulomb = 'tanh' needs smoothing_{unit} above 0 for joint {joint + 1}")
    return friction


def _per_joint(table: Table, key: str, kinds: Sequence[str], default: Sequence[float]) -> tuple[float, ...]:
    """Velocities per joint: a number for all joints of a kind, or a list with one entry per joint."""
    values = list(default)
    for unit, kind in (("rad_s", "revolute"), ("m_s", "prismatic")):
        name = f"{key}_{unit}"
        numbers = table.spread(name, len(kinds), None)
        if numbers is None:
            continue
        for joint, number in enumerate(numbers):
            if kinds[joint] == kind:
                if number < 0.0:
                    table.fail(f"{name} of joint {joint + 1} must not be negative, got {number}")
                values[joint] = number
    return tuple(values)
