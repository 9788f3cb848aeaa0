"""Friction of a robot: the model, its further terms joint by joint, springs among them, and their options."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from .._tools.plugins import loaded
from .._tools.saved import restored
from .._tools.toml import Table
from .._tools.words import series
from ..errors import RobotError

Law = Literal[
    "rest", "atan", "stribeck", "root", "forward", "load", "hold", "dahl", "table",
    "warm_viscous", "warm_coulomb", "spring", "sine", "cosine", "cylinder", "cylinder_rate",
]  # fmt: skip

NAMES: dict[str, str] = {
    "rest": "Rest",
    "atan": "Fa",
    "stribeck": "Fs",
    "root": "Fr",
    "forward": "Fvp",
    "load": "Fl",
    "hold": "Hold",
    "dahl": "Fz",
    "warm_viscous": "Fvt",
    "warm_coulomb": "Fct",
    "spring": "Ks",
    "sine": "Gs",
    "cosine": "Gc",
    "cylinder": "Cf",
    "cylinder_rate": "Ck",
}
"""Parameter name of each law, without the joint's number."""
STANDARD_NAMES = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "Ia", "Fv", "Fc", "Off")
"""Names of the other parameters of a joint."""
KEYS: dict[str, str] = {
    "rest": "standstill",
    "atan": "atan",
    "stribeck": "stribeck",
    "root": "root",
    "forward": "forward_viscous",
    "load": "load",
    "hold": "hold",
    "dahl": "dahl",
    "warm_viscous": "temperature_viscous",
    "warm_coulomb": "temperature_coulomb",
}
"""Key of each law in ``[friction]``."""
SPRINGS: dict[str, tuple[Law, ...]] = {"linear": ("spring",), "gravity": ("sine", "cosine")}
"""Laws of the keys of ``[springs]`` that name joints."""
CYLINDER: tuple[Law, Law] = ("cylinder", "cylinder_rate")
"""Laws of a cylinder: constant force and stiffness."""
OF_POSITION: frozenset[str] = frozenset((*SPRINGS["linear"], *SPRINGS["gravity"], *CYLINDER))
"""Laws whose column depends on the position alone."""
OF_PATH: frozenset[str] = frozenset(("hold", "dahl"))
"""Laws whose column depends on the path so far: those that remember."""
OF_TEMPERATURE: frozenset[str] = frozenset(("warm_viscous", "warm_coulomb"))
"""Laws whose column depends on the recorded temperature, and is zero at the reference temperature."""
REFERENCE_DEGC = 25.0
"""Temperature (degC) at which ``Fv`` and ``Fc`` are stated, where a file gives none."""
STIFF: frozenset[str] = frozenset(("spring", "cylinder_rate"))
"""Springs whose parameter is a stiffness, which cannot be negative."""
START_VELOCITY = {"revolute": 0.1, "prismatic": 0.01}
"""Velocity (rad/s, m/s) of a law before its own is estimated."""
START_WIDTH = {"revolute": 1e-3, "prismatic": 1e-4}
"""Displacement (rad, m) of Dahl's memory before its own is estimated."""
HOLD_WIDTH = {"revolute": 1e-5, "prismatic": 1e-6}
"""Displacement (rad, m) over which a sign held at rest turns: above the rounding of filtered positions."""
SCALED: dict[str, tuple[str, Mapping[str, float]]] = {
    "atan": ("velocity", START_VELOCITY),
    "stribeck": ("velocity", START_VELOCITY),
    "dahl": ("width", START_WIDTH),
}
"""Laws with a nonlinear parameter: its name in files and the start of its search."""
FEWEST_SPEEDS = 4
"""Smallest number of speeds of a law given by a table of values."""


@dataclass(frozen=True, kw_only=True)
class FrictionTerm:
    """One friction term beyond viscous, Coulomb and offset, at one joint.

    Tested in ``tests/test_friction_terms.py``.

    Attributes
    ----------
    law : Law
        ``rest``: a constant torque at standstill; ``atan``: ``atan(dq / velocity)``; ``stribeck``:
        ``s(dq) exp(-(dq / velocity)^2)``; ``root``: ``sqrt(|dq|) s(dq)``; ``forward``: ``max(dq, 0)``; ``load``:
        ``|tau_r| s(dq)`` with the torque ``tau_r`` of links and rotors; ``hold``: no torque of its own, the sign ``s`` of all
        other laws at the joint is that of the last motion; ``dahl``: Dahl's memory; ``table``: values over speed;
        ``warm_viscous``, ``warm_coulomb``: ``(T - T0) dq`` and ``(T - T0) s(dq)`` with the recorded temperature T. Springs:
        ``spring``: ``q``, its rest position is in the offset; ``sine``, ``cosine``: ``sin(q)`` and ``cos(q)``;
        ``cylinder``: ``dl/dq``, a force (N) along a cylinder of length ``l(q)^2 = a^2 + b^2 - 2 a b cos(q + phi)``;
        ``cylinder_rate``: ``(l - rest) dl/dq``.
    joint : int
        Joint, from 0.
    velocity : float
        Velocity of ``atan`` and ``stribeck`` (rad/s or m/s); displacement over which ``dahl`` forgets (rad or m).
    estimated : bool
        The velocity is estimated from the log, and `velocity` is where the search starts.
    fitted : bool
        The velocity is the estimate from a log: its uncertainty counts in the standard deviations of the parameters.
    refused : bool
        The log does not identify the velocity: the law keeps the one that it had, or is the square root in place of ``atan``.
    doubtful : bool
        The gain of the term on the log that it was chosen on is not clear, or it is not chosen without a part of this log: the
        standard deviations include how far the parameters move without it.
    rival : float
        Velocity of the other of ``atan`` and ``stribeck`` where both fit the log, zero elsewhere: the standard deviations include
        how far the parameters move with it.
    name : str
        Name of the parameter before the joint's number; by default that of the law.
    first, step : float
        First speed of a table and the step between its speeds (rad/s or m/s).
    values : tuple of float
        Values of a table (torque per unit); ``T0`` of a temperature (degC); of a cylinder ``a b rest`` (m) and ``phi`` (rad).

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
    refused: bool = False
    doubtful: bool = False
    rival: float = 0.0
    name: str = ""
    first: float = 0.0
    step: float = 0.0
    values: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.law not in get_args(Law):
            raise RobotError(f"a friction law is one of {series(get_args(Law))}, got {self.law!r}")
        if not self.name:
            if self.law == "table":
                raise RobotError("a friction term of law 'table' needs a name")
            object.__setattr__(self, "name", NAMES[self.law])
        if self.law == "table" and not self.name.isidentifier():
            raise RobotError(f"the name of a friction term must be letters and digits, got {self.name!r}")
        if self.law == "table" and self.name in (*NAMES.values(), *STANDARD_NAMES):
            raise RobotError(
                f"a law of your own needs a name of its own: {self.name!r} is the name of another parameter"
            )

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
        """Make a term of a user-defined law.

        Parameters
        ----------
        name : str
            Name of the parameter before the joint's number.
        joint : int
            Joint, from 0.
        torque : callable
            Torque per unit of the parameter at speeds (rad/s or m/s), array in, array out; it must be smooth if the robot is to
            be simulated.
        fastest : float
            The law is tabulated between this speed and its negative, and extrapolated linearly beyond them.
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
        try:
            with np.errstate(all="ignore"):  # refused below
                values = np.asarray(torque(at), dtype=np.float64)
        except Exception as reason:
            raise RobotError(
                f"friction term {name}: torque ended with {type(reason).__name__}: {reason}"
            ) from reason
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
    """Friction model of a robot, and its sign near standstill.

    Tested in ``tests/test_friction_terms.py``.

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
        An identification chooses the further terms (``terms = "auto"``).
    """

    model: str = "symmetric"
    coulomb: str = "sign"
    coupling: str = "shaft"
    smoothing: tuple[float, ...]
    dead_zone: tuple[float, ...]
    terms: tuple[FrictionTerm, ...] = ()
    auto: bool = False

    @classmethod
    def plain(cls, n_dof: int, terms: Iterable[FrictionTerm] = ()) -> Friction:
        """Return symmetric Coulomb friction without smoothing, with further terms."""
        nothing = (0.0,) * n_dof
        return cls(smoothing=nothing, dead_zone=nothing, terms=tuple(terms))

    def of(self, *laws: str) -> tuple[FrictionTerm, ...]:
        """Return the terms of some laws."""
        return tuple(term for term in self.terms if term.law in laws)

    @property
    def has_memory(self) -> bool:
        """Whether friction depends on the path or on the temperature, not on the state alone."""
        return bool(self.of(*OF_PATH, *OF_TEMPERATURE))

    @property
    def warmed(self) -> tuple[FrictionTerm, ...]:
        """Terms that depend on the temperature."""
        return self.of(*OF_TEMPERATURE)

    @property
    def held(self) -> frozenset[int]:
        """Joints, from 0, whose sign is kept through rest."""
        return frozenset(term.joint for term in self.of("hold"))

    @property
    def has_load(self) -> bool:
        """Whether a torque of friction depends on the load."""
        return bool(self.of("load"))

    @property
    def estimated(self) -> tuple[FrictionTerm, ...]:
        """Terms whose velocity is estimated from the log."""
        return tuple(term for term in self.terms if term.estimated)

    @property
    def springs(self) -> tuple[FrictionTerm, ...]:
        """Terms whose torque is a function of the position alone."""
        return self.of(*OF_POSITION)

    @property
    def open(self) -> bool:
        """Whether an identification must choose terms, or velocities of terms, before it solves for the parameters."""
        return self.auto or bool(self.estimated)

    @staticmethod
    def terms_of(saved: Sequence[Mapping[str, object]]) -> tuple[FrictionTerm, ...]:
        """Return the terms as read from a result's JSON."""
        return tuple(restored(FrictionTerm, term) for term in saved)


def read_friction(table: Table, kinds: Sequence[str], default: Friction | None) -> Friction:
    """Read ``[friction]``; missing keys take the value of `default`, or symmetric Coulomb friction without smoothing."""
    default = default or Friction.plain(len(kinds))
    friction = Friction(
        model=table.text("model", default.model),
        coulomb=table.text("coulomb", default.coulomb),
        coupling=table.text("coupling", default.coupling),
        smoothing=_per_joint(table, "smoothing", kinds, default.smoothing),
        dead_zone=_per_joint(table, "dead_zone", kinds, default.dead_zone),
        terms=_own_laws(table, kinds, _terms(table, kinds, default.terms)),
        auto=default.auto if table.text("terms", None) is None else True,
    )
    table.done()
    if friction.coulomb == "tanh" and not all(friction.smoothing):
        joint = friction.smoothing.index(0.0)
        unit = "rad_s" if kinds[joint] == "revolute" else "m_s"
        table.fail(f"coulomb = 'tanh' needs smoothing_{unit} above 0 for joint {joint + 1}")
    return friction


def read_springs(table: Table, kinds: Sequence[str], friction: Friction) -> Friction:
    """Read ``[springs]`` into the terms of a robot's friction: a given key replaces the springs of its kind."""
    terms = list(friction.terms)
    for key, laws in SPRINGS.items():
        joints = _joints(table, key, len(kinds))
        if joints is not None:
            terms = [term for term in terms if term.law not in laws]
            terms += [FrictionTerm(law=law, joint=joint) for joint in joints for law in laws]
    if table.has("cylinder"):
        terms = [term for term in terms if term.law not in CYLINDER]
        for part in table.tables("cylinder"):
            joint = part.integer("joint", maximum=len(kinds)) - 1
            a, b = (part.number(key) for key in ("a_m", "b_m"))
            if a == b:
                part.fail("a_m and b_m must differ: at length zero a cylinder has no direction")
            geometry = (a, b, math.radians(part.number("phi_deg")), part.number("rest_m"))
            terms += [FrictionTerm(law=law, joint=joint, values=geometry) for law in CYLINDER]
            part.done()
    table.done()
    for term in terms:
        if term.law in OF_POSITION - STIFF and kinds[term.joint] != "revolute":
            table.fail(f"joint {term.joint + 1} slides: it can have a linear spring only")
    return replace(friction, terms=tuple(terms))


def _terms(table: Table, kinds: Sequence[str], default: tuple[FrictionTerm, ...]) -> tuple[FrictionTerm, ...]:
    """Further terms, law by law: a given key replaces the terms of its law."""
    terms = list(default)
    reference = table.spread("reference_degc", len(kinds), [REFERENCE_DEGC] * len(kinds))
    for law, key in KEYS.items():
        name, starts = SCALED.get(law, ("", {}))
        given = _scales(table, f"{key}_{name}", kinds, starts) if starts else None
        joints = _joints(table, key, len(kinds))
        if joints is None:
            if given is not None:
                table.fail(f"{key}_{name} needs the key {key}, true or a list of joints")
            continue
        terms = [term for term in terms if term.law != law]
        for joint in joints:
            velocity, estimated = 0.0, bool(starts) and given is None
            if starts:
                velocity = starts[kinds[joint]] if given is None else given[joint]
            values = (reference[joint],) if law in OF_TEMPERATURE else ()
            terms.append(
                FrictionTerm(law=law, joint=joint, velocity=velocity, estimated=estimated, values=values)  # type: ignore[arg-type]
            )
    return tuple(terms)


def _own_laws(
    table: Table, kinds: Sequence[str], terms: tuple[FrictionTerm, ...]
) -> tuple[FrictionTerm, ...]:
    """User-defined laws, ``[[friction.law]]``, given by a function or by values: a law replaces the terms of its name."""
    parts = table.tables("law")
    given_names = {part.text("name") for part in parts}
    own_terms = [term for term in terms if term.name not in given_names]
    for part in parts:
        name, function = part.text("name"), part.text("function", None)
        values = part.numbers("values", default=None)
        if (function is None) == (values is None):
            part.fail('a law needs either function = "module:name" or values')
        law = None if function is None else loaded(function, "friction law", RobotError)
        joints = _joints(part, "joints", len(kinds))
        keys = ("first", "step") if law is None else ("fastest",)
        numbers = {
            (key, kind): part.number(f"{key}_{unit}", None)
            for key in ("fastest", "first", "step")
            for unit, kind in scale_units(key)
        }
        for joint in range(len(kinds)) if joints is None else joints:
            speeds = [numbers[key, kinds[joint]] for key in keys]
            given = [speed for speed in speeds if speed is not None]
            if len(given) < len(keys):
                part.fail(f"joint {joint + 1} needs {series(keys)}, in rad_s if it turns, else in m_s")
            if law is not None:
                own_terms.append(FrictionTerm.from_function(name, joint, law, fastest=given[0]))
            else:
                first, step = given
                own = tuple(values or ())
                own_terms.append(
                    FrictionTerm(law="table", joint=joint, name=name, first=first, step=step, values=own)
                )
        part.done()
    return tuple(own_terms)


def _joints(table: Table, key: str, n: int) -> list[int] | None:
    """Joints of a law, from 0: ``true`` for all, ``false`` for none, or a list of numbers from 1."""
    value = table.raw(key, None)
    if value is None:
        return None
    if isinstance(value, bool):
        return list(range(n)) if value else []
    if not isinstance(value, list) or not all(type(joint) is int and 1 <= joint <= n for joint in value):
        table.fail(f"{key} must be true, false or a list of joints from 1 to {n}, got {value!r}")
    if len(set(value)) < len(value):
        table.fail(f"{key} names a joint twice: {value!r}")
    return [joint - 1 for joint in value]


def scale_units(key: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return the endings of a key for each kind of joint: those of a displacement or of a velocity."""
    per = "" if key.endswith("width") else "_s"
    return (f"rad{per}", "revolute"), (f"m{per}", "prismatic")


def _scales(
    table: Table, key: str, kinds: Sequence[str], starts: Mapping[str, float]
) -> tuple[float, ...] | None:
    """Velocities or widths of a law per joint, or None if they are to be estimated from the log."""
    given = any(table.has(f"{key}_{unit}") for unit, _ in scale_units(key))
    values = _per_joint(table, key, kinds, [starts[kind] for kind in kinds])
    if given and not all(values):
        table.fail(f"{key} of joint {values.index(0.0) + 1} must be above 0")
    return values if given else None


def _per_joint(table: Table, key: str, kinds: Sequence[str], default: Sequence[float]) -> tuple[float, ...]:
    """Velocities or widths per joint: a number for all joints of a kind, or a list with one entry per joint."""
    values = list(default)
    for unit, kind in scale_units(key):
        for joint, number in enumerate(table.spread(f"{key}_{unit}", len(kinds), [])):
            if kinds[joint] == kind:
                values[joint] = number
    return tuple(values)
