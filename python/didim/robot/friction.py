"""Friction of a robot: the model, its further terms joint by joint, and their options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from .._tools.toml import Table
from ..errors import RobotError

Law = Literal["rest", "atan", "stribeck", "root", "forward", "load", "table"]

NAMES: dict[str, str] = {
    "rest": "Rest",
    "atan": "Fa",
    "stribeck": "Fs",
    "root": "Fr",
    "forward": "Fvp",
    "load": "Fl",
}
"""Name of the parameter of each law, before the joint's number."""
KEYS: dict[str, str] = {
    "rest": "standstill",
    "atan": "atan",
    "stribeck": "stribeck",
    "root": "root",
    "forward": "forward_viscous",
    "load": "load",
}
"""Key of each law in ``[friction]``."""
START_VELOCITY = {"revolute": 0.1, "prismatic": 0.01}
"""Velocity (rad/s, m/s) that a law has until its own is estimated."""
FEWEST_SPEEDS = 4
"""Fewest speeds of a law that is given by its values."""


@dataclass(frozen=True, kw_only=True)
class FrictionTerm:
    """One friction term beyond viscous, Coulomb and offset, at one joint.

    Attributes
    ----------
    law : {"rest", "atan", "stribeck", "root", "forward", "load", "table"}
        ``rest``: a constant torque at standstill; ``atan``: ``atan(dq / velocity)``; ``stribeck``:
        ``s(dq) exp(-(dq / velocity)^2)``; ``root``: ``sqrt(|dq|) s(dq)``; ``forward``: ``max(dq, 0)``; ``load``:
        ``|tau_r| s(dq)`` with the torque ``tau_r`` of links and rotors; ``table``: values over speed.
    joint : int
        Joint, from 0.
    velocity : float
        Of ``atan`` and ``stribeck`` (rad/s or m/s).
    estimated : bool
        The velocity is estimated from the log, and `velocity` is where the search starts.
    fitted : bool
        The velocity is the estimate from a log: its uncertainty counts in the standard deviations of the parameters.
    name : str
        Name of the parameter before the joint's number; by default that of the law.
    first, step : float
        First speed of a table and the step between its speeds (rad/s or m/s).
    values : tuple of float
        Values of a table, torque per unit of the parameter.

    Raises
    ------
    RobotError
        For an unknown law, or a table without a name.

    Notes
    -----
    The core has the columns: ``rust/src/model/friction_terms.rs`` tests them against the inverse and the direct model.
    """

    law: Law
    joint: int
    velocity: float = 0.0
    estimated: bool = False
    fitted: bool = False
    name: str = ""
    first: float = 0.0
    step: float = 0.0
    values: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.law not in get_args(Law):
            raise RobotError(f"a friction law is one of {', '.join(get_args(Law))}, got {self.law!r}")
        if not self.name:
            if self.law == "table":
                raise RobotError("a friction term of law 'table' needs a name")
            object.__setattr__(self, "name", NAMES[self.law])
        if self.law == "table" and not self.name.isidentifier():
            raise RobotError(f"the name of a friction term must be letters and digits, got {self.name!r}")

    @property
    def parameter(self) -> str:
        """Name of its parameter, such as ``Fa3``."""
        return f"{self.name}{self.joint + 1}"

    @classmethod
    def from_function(
        cls,
        name: str,
        joint: int,
        torque: Callable[[np.ndarray], np.ndarray],
        *,
        fastest: float,
        speeds: int = 401,
    ) -> FrictionTerm:
        """Make a term of a law of your own.

        Parameters
        ----------
        name : str
            Name of the parameter before the joint's number.
        joint : int
            Joint, from 0.
        torque : callable
            Torque per unit of the parameter at speeds (rad/s or m/s), an array in and an array out; smooth, where the robot is
            to be simulated.
        fastest : float
            The law is tabulated between this speed and its negative; beyond them the straight line goes on.
        speeds : int
            Speeds of the table; cubics connect them.

        Returns
        -------
        FrictionTerm

        Raises
        ------
        RobotError
            For values that are not finite, or too few speeds (``test_friction_terms.py``).
        """
        if not (np.isfinite(fastest) and fastest > 0.0):
            raise RobotError(f"friction term {name}: fastest must be a finite speed above 0, got {fastest!r}")
        if speeds < FEWEST_SPEEDS:
            raise RobotError(
                f"friction term {name}: at least {FEWEST_SPEEDS} speeds are needed, got {speeds}"
            )
        at = np.linspace(-fastest, fastest, speeds)
        with np.errstate(all="ignore"):  # refused below
            values = np.asarray(torque(at), dtype=np.float64)
        if values.shape != at.shape or not np.isfinite(values).all():
            raise RobotError(
                f"friction term {name}: torque must return one finite number per speed, got an array of shape {values.shape}"
            )
        step = 2.0 * fastest / (speeds - 1)
        return cls(
            law="table", joint=joint, name=name, first=-fastest, step=step, values=tuple(values.tolist())
        )


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
    terms : tuple of FrictionTerm
        Further terms; their parameters are the last standard parameters, in this order.
    auto : bool
        An identification chooses further terms by itself (``terms = "auto"``).
    """

    model: str
    coulomb: str
    coupling: str
    smoothing: tuple[float, ...]
    dead_zone: tuple[float, ...]
    terms: tuple[FrictionTerm, ...] = ()
    auto: bool = False

    @property
    def has_load(self) -> bool:
        """Whether a torque of friction depends on the load."""
        return any(term.law == "load" for term in self.terms)

    @property
    def estimated(self) -> tuple[FrictionTerm, ...]:
        """Terms whose velocity is estimated from the log."""
        return tuple(term for term in self.terms if term.estimated)

    @property
    def open(self) -> bool:
        """Whether an identification has to choose terms, or velocities of terms, before the rest."""
        return self.auto or bool(self.estimated)

    @staticmethod
    def terms_of(saved: Sequence[Mapping[str, object]]) -> tuple[FrictionTerm, ...]:
        """Return terms as a result's JSON has them."""
        return tuple(
            FrictionTerm(**{**term, "values": tuple(term.get("values", ()))})  # type: ignore[arg-type]
            for term in saved
        )


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
        terms=_terms(table, kinds, default.terms),
        auto=default.auto if table.text("terms", None, choices=("auto",)) is None else True,
    )
    table.done()
    if friction.coulomb == "tanh" and not all(friction.smoothing):
        joint = friction.smoothing.index(0.0)
        unit = "rad_s" if kinds[joint] == "revolute" else "m_s"
        table.fail(f"coulomb = 'tanh' needs smoothing_{unit} above 0 for joint {joint + 1}")
    return friction


def _terms(table: Table, kinds: Sequence[str], default: tuple[FrictionTerm, ...]) -> tuple[FrictionTerm, ...]:
    """Further terms, law by law: a key that is there replaces the terms of its law."""
    terms = list(default)
    for law, key in KEYS.items():
        velocities = _velocities(table, key, kinds) if law in ("atan", "stribeck") else None
        joints = _joints(table, key, len(kinds))
        if joints is None:
            if velocities is not None:
                table.fail(f"{key}_velocity needs the key {key}, true or a list of joints")
            continue
        terms = [term for term in terms if term.law != law]
        for joint in joints:
            velocity, estimated = 0.0, False
            if law in ("atan", "stribeck"):
                velocity = START_VELOCITY[kinds[joint]] if velocities is None else velocities[joint]
                estimated = velocities is None
            terms.append(FrictionTerm(law=law, joint=joint, velocity=velocity, estimated=estimated))  # type: ignore[arg-type]
    return tuple(terms)


def _joints(table: Table, key: str, n: int) -> list[int] | None:
    """Joints of a law, from 0: ``true`` for all, ``false`` for none, or a list of numbers from 1."""
    value = table.raw(key, None, "true, false, or list of joints")
    if value is None:
        return None
    if isinstance(value, bool):
        return list(range(n)) if value else []
    if not isinstance(value, list) or not all(type(joint) is int and 1 <= joint <= n for joint in value):
        table.fail(f"{key} must be true, false or a list of joints from 1 to {n}, got {value!r}")
    if len(set(value)) < len(value):
        table.fail(f"{key} names a joint twice: {value!r}")
    return [joint - 1 for joint in value]


def _velocities(table: Table, key: str, kinds: Sequence[str]) -> tuple[float, ...] | None:
    """Velocities of a law per joint, or None where they are estimated from the log."""
    given = any(table.has(f"{key}_velocity_{unit}") for unit in ("rad_s", "m_s"))
    start = [START_VELOCITY[kind] for kind in kinds]
    velocities = _per_joint(table, f"{key}_velocity", kinds, start)
    if given and not all(velocities):
        table.fail(f"{key}_velocity of joint {velocities.index(0.0) + 1} must be above 0")
    return velocities if given else None


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
