"""Robots: read from TOML, checked once, immutable."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from .base import BaseParameters, base_parameters
from .errors import RobotError
from .schema import Table, did_you_mean, read_toml
from .units import reduction_matrix

Array = NDArray[np.float64]

PACKAGED = Path(__file__).parent / "robots"
"""Folder of the robots that come with the package."""


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """Limits of one joint, joint side; None where the robot file has none.

    Attributes
    ----------
    position : (float, float) or None
        Lowest and highest position (rad or m).
    velocity : float or None
        Largest speed (rad/s or m/s).
    effort : float or None
        Largest torque or force (N.m or N).
    """

    position: tuple[float, float] | None = None
    velocity: float | None = None
    effort: float | None = None


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


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Modified Denavit-Hartenberg table, gravity and transmission: what the core builds a robot from.

    Attributes
    ----------
    kinds : tuple of str
        ``revolute`` or ``prismatic`` per joint.
    alpha, d, theta, r : tuple of float
        MDH rows (rad, m); the offset is theta of a revolute joint, r of a prismatic one.
    gravity : tuple of float
        Acceleration of gravity in frame 0 (m/s^2).
    coupling : tuple of tuple of float
        ``C``: rotor speeds in joint-side units are ``C dq`` (rows are motors), (22).
    """

    kinds: tuple[str, ...]
    alpha: tuple[float, ...]
    d: tuple[float, ...]
    theta: tuple[float, ...]
    r: tuple[float, ...]
    gravity: tuple[float, ...]
    coupling: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A serial robot. Made by `load_robot`.

    Attributes
    ----------
    name, description : str
        What the file says.
    path : Path
        The file.
    digest : str
        SHA-256 of the file.
    geometry : Geometry
        Frames, gravity and coupling.
    friction : Friction
        Shape of the friction.
    limits : tuple of JointLimits
        One per joint.
    reduction : (n_dof, n_dof) array or None
        Rows are motors: ``q_motor = R q`` and ``tau = R^T tau_motor``.
    gains : tuple of float or None
        Drive gains (N.m/A or N/V), motor side.
    """

    name: str
    description: str
    path: Path
    digest: str
    geometry: Geometry
    friction: Friction
    limits: tuple[JointLimits, ...]
    reduction: Array | None
    gains: tuple[float, ...] | None
    _named: Mapping[str, Mapping[str, float]] = field(default_factory=dict, repr=False)

    @cached_property
    def core(self) -> _core.Robot:
        """The robot of the numerical core."""
        geometry, friction = self.geometry, self.friction
        smoothing = friction.smoothing if friction.coulomb == "tanh" else (0.0,) * self.n_dof
        try:
            return _core.Robot(
                kind=[0 if kind == "revolute" else 1 for kind in geometry.kinds],
                alpha=list(geometry.alpha),
                d=list(geometry.d),
                theta=list(geometry.theta),
                r=list(geometry.r),
                gravity=list(geometry.gravity),
                transmission=[list(row) for row in geometry.coupling],
                asymmetric=friction.model == "asymmetric",
                printed_coupling=friction.coupling == "printed",
                smoothing=list(smoothing),
                dead_zone=list(friction.dead_zone),
            )
        except ValueError as reason:
            raise RobotError(f"{self.path.name}: {reason}") from None

    @property
    def n_dof(self) -> int:
        """Number of joints."""
        return len(self.geometry.kinds)

    @property
    def joint_kinds(self) -> tuple[str, ...]:
        """``revolute`` or ``prismatic`` per joint."""
        return self.geometry.kinds

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the standard parameters in order (3), friction of coupled motors last."""
        return tuple(self.core.parameter_names)

    @cached_property
    def parameter_units(self) -> tuple[str, ...]:
        """Their units, joint side."""
        return tuple(self.core.parameter_units)

    @cached_property
    def base_parameters(self) -> BaseParameters:
        """What motion can tell apart (7)."""
        core = self.core
        try:
            return base_parameters(core)
        except ValueError as reason:
            raise RobotError(
                f"{self.path.name}: lengths or gravity allow no base parameters in floating point ({reason})"
            ) from None

    @cached_property
    def sets(self) -> Mapping[str, Array]:
        """Named parameter sets of the file as full vectors of standard parameters, ``(n_parameters,)``.

        Sets that name friction parameters which the robot's friction model does not have are left out.
        """
        known = {*self.parameter_names, *self.base_parameters.names}
        fitting = [name for name, values in self._named.items() if known.issuperset(values)]
        return MappingProxyType({name: self._vector(name) for name in fitting})

    def set_base(self, name: str) -> Array:
        """Return the base parameters of a named set, ``(n_base,)``.

        Raises
        ------
        RobotError
            When the robot has no such set.
        """
        return self.base_parameters.project(self.parameter_set(name))

    def parameter_set(self, name: str) -> Array:
        """Return a named set as a full vector of standard parameters, ``(n_parameters,)``.

        Raises
        ------
        RobotError
            When the robot has no such set, or it does not fit the robot's friction.
        """
        if name not in self._named:
            known = ", ".join(self._named) or "none"
            raise RobotError(
                f"{self.path.name}: no parameter set {name!r}{did_you_mean(name, self._named)} "
                f"(there are: {known})"
            )
        return self._vector(name)

    def _vector(self, name: str) -> Array:
        return self.parameters_by_name(self._named[name], f"{self.path.name}: [parameters.{name}]")

    def parameters_by_name(self, values: Mapping[str, float], where: str = "the parameters:") -> Array:
        """Return values by name as a full vector of standard parameters, ``(n_parameters,)``.

        Parameters
        ----------
        values : mapping of str to float
            Standard or base parameters, SI units, joint side; what is not named is zero.
        where : str
            How the message of an error opens.

        Raises
        ------
        RobotError
            For a name that the robot has not, and for a base parameter beside the standard one it is named after.
        """
        base = self.base_parameters
        places = dict(zip(base.names, base.indices, strict=True))
        places.update((parameter, index) for index, parameter in enumerate(self.parameter_names))
        x = np.zeros(len(self.parameter_names))
        taken: dict[int, str] = {}
        for parameter, value in values.items():
            if parameter not in places:
                raise RobotError(f"{where} unknown parameter {parameter!r}{did_you_mean(parameter, places)}")
            index = places[parameter]
            if index in taken:
                raise RobotError(f"{where} has both {taken[index]!r} and {parameter!r}")
            taken[index] = parameter
            x[index] = value
        x.setflags(write=False)
        return x

    def with_friction(self, **options: Any) -> Robot:
        """Return the same robot with other friction options.

        Parameters
        ----------
        **options
            Keys of the table ``[friction]`` of a robot file.

        Raises
        ------
        RobotError
            For an unknown key or a wrong value.
        """
        return self.with_friction_table(Table(options, f"friction of robot {self.name!r}", RobotError))

    def with_smoothing(self, smoothing: Sequence[float]) -> Robot:
        """Return the same robot with ``tanh(dq / smoothing)`` friction without dead zone; one velocity per joint (rad/s, m/s)."""
        friction = replace(
            self.friction, coulomb="tanh", smoothing=tuple(smoothing), dead_zone=(0.0,) * self.n_dof
        )
        return replace(self, friction=friction)

    def with_friction_table(self, table: Table) -> Robot:
        """Return the same robot with the friction options of a table, whose errors name its file."""
        friction = _friction(table, self.geometry.kinds, self.friction)
        # What is known of this robot by now, such as its base parameters, need not be found again.
        return self if friction == self.friction else replace(self, friction=friction)


def load_robot(name: str | Path) -> Robot:
    """Load a robot.

    Parameters
    ----------
    name : str or Path
        Name of a packaged robot (``tx40``, ``emps``, ``planar2``), or path of a robot file.

    Returns
    -------
    Robot

    Raises
    ------
    RobotError
        When there is no such robot, or its file is wrong (``tests/test_robot.py``).
    """
    path = Path(name)
    packaged = {file.stem: file for file in sorted(PACKAGED.glob("*.toml"))}
    if path.suffix != ".toml":
        if str(name) not in packaged:
            raise RobotError(_no_robot(path, packaged))
        path = packaged[str(name)]
    content = read_toml(path, RobotError)
    robot = _robot(Table(content, path.name, RobotError), path)
    for parameter_set in robot._named:  # now, so that a wrong description is an error of loading
        robot.parameter_set(parameter_set)
    robot.core  # noqa: B018 - likewise, for a robot without sets
    return robot


def _no_robot(path: Path, packaged: Mapping[str, Path]) -> str:
    """Sentence on what is neither a packaged robot nor a path that ends in .toml."""
    if path.is_file():
        return f"{path}: the name of a robot file must end in .toml; rename it"
    if Path(f"{path}.toml").is_file():
        return f"no packaged robot {path.name!r}; did you mean the file '{path.name}.toml'?"
    near = did_you_mean(path.name, packaged)
    return f"no packaged robot {path.name!r}{near} (there are: {', '.join(packaged)}); a path ends in .toml"


def _robot(table: Table, path: Path) -> Robot:
    if table.integer("schema") != 1:
        raise RobotError(f"{path.name}: schema must be 1")
    name = table.text("name", path.stem)
    description = table.text("description", "")
    convention = table.text("convention", "mdh", choices=("mdh", "dh"))
    gravity = table.numbers("gravity_m_s2", length=3, default=[0.0, 0.0, -9.81])
    joints = table.tables("joint") if table.has("joint") else []
    if not joints:
        raise RobotError(f"{path.name}: a robot needs at least one [[joint]]")
    if len(joints) > 12:
        raise RobotError(f"{path.name}: a robot has at most 12 joints, got {len(joints)}")
    kinds = tuple(joint.text("kind", choices=("revolute", "prismatic")) for joint in joints)
    rows = [_row(joint) for joint in joints]
    limits = tuple(_limits(joint, kind) for joint, kind in zip(joints, kinds, strict=True))
    for joint in joints:
        joint.done()
    alpha, d, theta, r = (tuple(column) for column in zip(*rows, strict=True))
    if convention == "dh":
        alpha, d = (0.0, *alpha[:-1]), (0.0, *d[:-1])
    n = len(kinds)
    transmission = _sub_table(table, "transmission")
    coupling = transmission.matrix("coupling", n, n) if transmission.has("coupling") else np.eye(n).tolist()
    reduction = reduction_matrix(transmission, n) if transmission.has("reduction") else None
    gains = tuple(transmission.numbers("drive_gains", length=n)) if transmission.has("drive_gains") else None
    transmission.done()
    friction = _friction(_sub_table(table, "friction"), kinds, None)
    sets = _sub_table(table, "parameters")
    named = {key: _parameter_set(sets.table(key)) for key in sets.content}
    table.done()
    if reduction is not None:
        reduction.setflags(write=False)
    return Robot(
        name=name,
        description=description,
        path=path,
        digest=hashlib.sha256(path.read_bytes()).hexdigest(),
        geometry=Geometry(
            kinds=kinds,
            alpha=alpha,
            d=d,
            theta=theta,
            r=r,
            gravity=tuple(gravity),
            coupling=tuple(tuple(row) for row in coupling),
        ),
        friction=friction,
        limits=limits,
        reduction=reduction,
        gains=gains,
        _named=named,
    )


def _sub_table(table: Table, key: str) -> Table:
    """Sub-table `key`, empty when the file has none."""
    return table.table(key) if table.has(key) else Table({}, table.prefix.removesuffix(":"), RobotError, key)


def _row(joint: Table) -> tuple[float, float, float, float]:
    """Alpha, d, theta, r of one row (rad, m); in a standard table alpha and d belong to the next row."""
    return (
        _angle(joint, "alpha"),
        joint.number("d_m", 0.0),
        _angle(joint, "theta"),
        joint.number("r_m", 0.0),
    )


def _angle(joint: Table, name: str) -> float:
    degrees, radians = f"{name}_deg", f"{name}_rad"
    if joint.has(degrees) and joint.has(radians):
        joint.fail(f"give {radians} or {degrees}, not both")
    if joint.has(degrees):
        return math.radians(joint.number(degrees))
    return joint.number(radians, 0.0)


def _limits(joint: Table, kind: str) -> JointLimits:
    table = _sub_table(joint, "limits")
    turn = kind == "revolute"
    position = table.numbers("position_rad" if turn else "position_m", length=2, default=None)
    velocity = table.number("velocity_rad_s" if turn else "velocity_m_s", None, minimum=0.0)
    effort = table.number("torque_n_m" if turn else "force_n", None, minimum=0.0)
    table.done()
    if position is not None and position[0] >= position[1]:
        table.fail(f"the lowest position must be below the highest, got {position}")
    return JointLimits(
        position=None if position is None else (position[0], position[1]), velocity=velocity, effort=effort
    )


def _parameter_set(table: Table) -> dict[str, float]:
    return {name: table.number(name) for name in table.content}


def _friction(table: Table, kinds: Sequence[str], default: Friction | None) -> Friction:
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
