"""A robot: geometry, friction, limits and named parameter sets; immutable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import didim._core as _core

from .._tools.arrays import Array, real_array
from .._tools.keys import declared
from .._tools.notebook import page
from .._tools.pickling import Pickled
from .._tools.toml import Table
from .._tools.words import counted, did_you_mean, series
from ..errors import RobotError
from .collision import Capsule
from .correspondence import Correspondence, Origin
from .friction import HOLD_WIDTH, OF_TEMPERATURE, Friction, FrictionTerm, read_friction, read_springs
from .parameters import BaseParameters, Parameter, base_parameters
from .placement import Mount, carriers, in_line, placed
from .rigid_body import inverse
from .standard_dh import StandardTable, in_other_frames
from .transmission import Actuator, Follower

MOST_JOINTS = 128
"""Largest number of joints, as in the core."""


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


LIMIT_KEYS = {
    "revolute": ("position_rad", "velocity_rad_s", "torque_n_m"),
    "prismatic": ("position_m", "velocity_m_s", "force_n"),
}
"""Keys of `JointLimits` in files, by the kind of the joint: position, velocity and effort."""


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Modified Denavit-Hartenberg rows, gravity and transmission: the input of the core.

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
    mounts : tuple of Mount
        Antecedent of each joint of a tree; empty for a chain.
    followers : tuple of Follower
        Joints coupled to driven ones; they have the last numbers.
    """

    kinds: tuple[str, ...]
    alpha: tuple[float, ...]
    d: tuple[float, ...]
    theta: tuple[float, ...]
    r: tuple[float, ...]
    gravity: tuple[float, ...]
    coupling: tuple[tuple[float, ...], ...]
    mounts: tuple[Mount, ...] = ()
    followers: tuple[Follower, ...] = ()

    @property
    def n_driven(self) -> int:
        """Number of driven joints."""
        return len(self.kinds) - len(self.followers)

    @property
    def outwards(self) -> tuple[int, ...]:
        """All joints, each after its antecedent."""
        return tuple(sorted(range(len(self.kinds)), key=partial(carriers, self.parents)))

    @property
    def parents(self) -> tuple[int | None, ...]:
        """Antecedent of each joint, from 0; None for the base."""
        return tuple(mount.parent for mount in self.mounts) or in_line(len(self.kinds))

    def core(self, friction: Friction) -> _core.Robot:
        """Return the robot of the numerical core."""
        driven = self.kinds[: self.n_driven]
        return _core.Robot(
            kind=[0 if kind == "revolute" else 1 for kind in self.kinds],
            alpha=self.alpha,
            d=self.d,
            theta=self.theta,
            r=self.r,
            gravity=self.gravity,
            transmission=self.coupling,
            asymmetric=friction.model == "asymmetric",
            printed_coupling=friction.coupling == "printed",
            smoothing=friction.smoothing if friction.coulomb == "tanh" else (0.0,) * len(driven),
            dead_zone=friction.dead_zone,
            held=[
                HOLD_WIDTH[kind] if joint in friction.held and not self.followers else 0.0
                for joint, kind in enumerate(driven)
            ],
            terms=[_core_term(term) for term in friction.terms if term.law != "hold"],
            mounts=[(mount.parent, mount.gamma, mount.b, mount.shift) for mount in self.mounts] or None,
            followers=[(list(follower.leaders), follower.offset) for follower in self.followers],
        )

    @property
    def in_line(self) -> bool:
        """Whether the robot is a chain without coupled joints."""
        return self.parents == in_line(len(self.kinds)) and not self.followers

    def placement(self, joint: int) -> Array:
        """Return the pose (4, 4) of a frame in that of its antecedent at position zero (m)."""
        mount = self.mounts[joint] if self.mounts else Mount(parent=None)
        return placed(mount, (self.alpha[joint], self.d[joint], self.theta[joint], self.r[joint]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot(Pickled):
    """A robot with a fixed base: a chain or a tree (``tests/test_robot.py``).

    Attributes
    ----------
    name, description : str
        Name and description in the file.
    path, digest : Path, str
        The file, and its SHA-256.
    geometry : Geometry
        Frames, gravity and coupling.
    friction : Friction
        Friction model.
    limits : tuple of JointLimits
        One per joint.
    reduction : (n_dof, n_dof) array or None
        Rows are motors: ``q_motor = R q`` and ``tau = R^T tau_motor``.
    gains : tuple of float or None
        Drive gains (N.m/A or N/V), motor side.
    joint_names : tuple of str
        Names of the joints in recordings and other files; empty where the file has none.
    correspondence : Correspondence or None
        Correspondence with the URDF that the robot was read from.
    standard : StandardTable or None
        Standard Denavit-Hartenberg table of a robot that was defined by one.
    collision : tuple of Capsule
        Collision capsules of the links, if the file has any.
    notes : tuple of str
        Sentences on changes made while reading the file, such as snapped right angles.
    actuators : tuple of Actuator or None
        Gains and limits of the joints' actuators, which an MJCF declares; empty where the file declares none.
    cut : tuple of str
        Closed loops of an MJCF that the tree does not have, which a fit refuses; empty with ``open``.
    origins : mapping of str to Origin
        Logs that parameter sets were identified from, by the name of the set.
    softness : tuple of (float, float)
        Creep and rest (s) of the joints' friction losses, `didim.robot.transmission.softness`; empty for MuJoCo's defaults.
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
    joint_names: tuple[str, ...] = ()
    correspondence: Correspondence | None = None
    collision: tuple[Capsule, ...] = ()
    standard: StandardTable | None = None
    notes: tuple[str, ...] = ()
    actuators: tuple[Actuator | None, ...] = ()
    softness: tuple[tuple[float, float], ...] = ()
    cut: tuple[str, ...] = ()
    origins: Mapping[str, Origin] = field(default_factory=dict, repr=False)
    _named: Mapping[str, Mapping[str, float]] = field(default_factory=dict, repr=False)
    _own: frozenset[str] = field(default_factory=frozenset, repr=False)

    def __repr__(self) -> str:
        still = len(self.correspondence.lock) if self.correspondence is not None else 0
        joints = counted(self.n_dof, "joint") + (f" and {still} locked" if still else "")
        return f"<Robot {self.name!r}: {joints}, {len(self.parameter_names)} standard parameters>"

    def _repr_html_(self) -> str:
        geometry = self.geometry
        columns = (np.degrees(geometry.alpha), geometry.d, np.degrees(geometry.theta), geometry.r)
        rows = zip(
            (self.joint_label(j).removeprefix("joint ") for j in range(self.n_joints)),
            geometry.kinds,
            *([f"{value:.6g}" for value in column] for column in columns),
            strict=True,
        )
        head = ("joint", "kind", "alpha (deg)", "d (m)", "theta (deg)", "r (m)")
        gravity = f"gravity in frame 0: {' '.join(f'{g:g}' for g in geometry.gravity)} m/s^2"
        sets = f"parameter sets: {series(self.sets)}" if self.sets else ""
        return page(
            f"{self.name}: {self.description}", [head, *rows], "\n".join(filter(None, (gravity, sets)))
        )

    @cached_property
    def core(self) -> _core.Robot:
        """The robot of the numerical core."""
        try:
            return self.geometry.core(self.friction)
        except ValueError as reason:
            raise RobotError(f"{self.path.name}: {reason}") from None

    @property
    def n_dof(self) -> int:
        """Number of driven joints: columns of motions and torques."""
        return self.geometry.n_driven

    @property
    def n_joints(self) -> int:
        """Number of joints and links, coupled joints included; these have the last numbers."""
        return len(self.geometry.kinds)

    @property
    def joint_kinds(self) -> tuple[str, ...]:
        """``revolute`` or ``prismatic`` per driven joint."""
        return self.geometry.kinds[: self.n_dof]

    @property
    def all_joint_names(self) -> tuple[str, ...]:
        """Names of all joints, coupled ones last; empty where the file has none."""
        return self.joint_names and (*self.joint_names, *(each.name for each in self.geometry.followers))

    def joint_label(self, joint: int) -> str:
        """Return the label of a joint, from 0: ``joint 3``, ``joint 3 (elbow_joint)``."""
        name = f" ({self.all_joint_names[joint]})" if self.joint_names else ""
        return f"joint {joint + 1}{name}"

    @property
    def own_frames(self) -> tuple[Array, ...]:
        """Frames of the robot's original description, each (4, 4) in frame j of the model.

        They come from the maker's standard table or the links of a URDF; without either they are the frames of the model.
        """
        if self.correspondence is not None:
            return tuple(link.matrix for link in self.correspondence.links)
        return (np.eye(4),) * self.n_joints if self.standard is None else self.standard.poses

    def to_own_frames(self, x: ArrayLike) -> Array:
        """Return standard parameters in the links' own frames, ``(n_parameters,)``.

        The model stores parameters in its own modified frames; a change of frame preserves masses and changes moments and
        inertias. It needs complete bodies, so convert ``fit.consistent().parameters``: base parameters lifted with zeros
        (`fit.parameters`) give the same torques, but are not bodies. ``test_standard_dh.py`` checks both directions.

        Raises
        ------
        RobotError
            For another number of parameters.
        """
        back = [inverse(frame) for frame in self.own_frames]
        return in_other_frames(self.parameter_names, self._checked(x), back)

    def from_own_frames(self, x: ArrayLike) -> Array:
        """Return standard parameters from those in the links' own frames."""
        return in_other_frames(self.parameter_names, self._checked(x), self.own_frames)

    def _checked(self, x: ArrayLike) -> Array:
        values = real_array("parameters", x, RobotError)
        if values.shape != (len(self.parameter_names),):
            raise RobotError(
                f"parameters must have shape ({len(self.parameter_names)},) for robot {self.name!r}, got {values.shape}"
            )
        return values

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the standard parameters in order (3), friction of coupled motors last."""
        return tuple(self.core.parameter_names)

    @cached_property
    def standard_parameters(self) -> tuple[Parameter, ...]:
        """The standard parameters in order (3), by kind, joint and side."""
        terms = {term.parameter: Parameter(term.name, term.joint) for term in self.friction.terms}
        return tuple(terms.get(name) or Parameter.of_core(name) for name in self.parameter_names)

    @cached_property
    def parameter_units(self) -> tuple[str, ...]:
        """Their units, joint side."""
        units = list(self.core.parameter_units)
        for term in self.friction.warmed:
            viscous = ".s/rad" if self.joint_kinds[term.joint] == "revolute" else ".s/m"
            per_speed = viscous if term.law == "warm_viscous" else ""
            units[self.parameter_names.index(term.parameter)] += f"{per_speed}/K"
        return tuple(units)

    @cached_property
    def base_parameters(self) -> BaseParameters:
        """Parameters that motion identifies, (7)."""
        try:
            return base_parameters(self.core)
        except ValueError as reason:
            raise RobotError(
                f"{self.path.name}: lengths or gravity allow no base parameters in floating point ({reason})"
            ) from None

    @cached_property
    def sets(self) -> Mapping[str, Array]:
        """Named parameter sets of the file as full vectors of standard parameters, ``(n_parameters,)``.

        Sets with friction parameters that are not in the robot's friction model are left out.
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
            known = f"{did_you_mean(name, self._named)} (there are: {series(self._named, 40) or 'none'})"
            raise RobotError(f"{self.path.name}: no parameter set {name!r}{known}")
        return self._vector(name)

    def _vector(self, name: str) -> Array:
        where = f"{self.path.name}: [parameters.{name}]"
        x = self.parameters_by_name(self._named[name], where)
        if name not in self._own:
            return x
        for parameter in self._named[name]:
            if parameter not in self.parameter_names:
                raise RobotError(
                    f"{where} {parameter!r} is a base parameter, which frames = 'own' cannot have"
                )
        x = self.from_own_frames(x)
        x.setflags(write=False)
        return x

    def parameters_by_name(self, values: Mapping[str, float], where: str = "the parameters:") -> Array:
        """Return values by name as a vector of standard parameters, ``(n_parameters,)``.

        Parameters
        ----------
        values : mapping of str to float
            Standard or base parameters, SI units, joint side; all others are zero.
        where : str
            Prefix of error messages.

        Raises
        ------
        RobotError
            For an unknown name, and for a base parameter together with the standard parameter of the same name.
        """
        places = {parameter: index for index, parameter in enumerate(self.parameter_names)}
        if not places.keys() >= values.keys():  # the base parameters of large robots take seconds
            base = self.base_parameters
            places = {**dict(zip(base.names, base.indices, strict=True)), **places}
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
        return self.with_friction_table(
            Table(options, f"friction of robot {self.name!r}", RobotError, keys=declared("robot", "friction"))
        )

    def with_terms(self, terms: Sequence[FrictionTerm]) -> Robot:
        """Return the robot with these further friction terms (``test_friction_terms.py``)."""
        return self._with(replace(self.friction, terms=tuple(terms), auto=False))

    def without(self, *laws: str) -> Robot:
        """Return the robot without the friction terms of these laws."""
        return self.with_terms([term for term in self.friction.terms if term.law not in laws])

    def with_smoothing(self, smoothing: Sequence[float]) -> Robot:
        """Return the robot with ``tanh(dq / smoothing)`` friction, (n_dof,) (rad/s, m/s)."""
        zones = (0.0,) * self.n_dof
        return self._with(replace(self.friction, coulomb="tanh", smoothing=tuple(smoothing), dead_zone=zones))

    def with_friction_table(self, table: Table) -> Robot:
        """Return the same robot with the friction of a table; errors name its file."""
        return self._with(read_friction(table, self.joint_kinds, self.friction))

    def with_spring_table(self, table: Table) -> Robot:
        """Return the same robot with the springs of a table; errors name its file."""
        return self._with(read_springs(table, self.joint_kinds, self.friction))

    def _with(self, friction: Friction) -> Robot:
        # Cached properties of this robot, such as its base parameters, stay valid if nothing changes.
        return self if friction == self.friction else replace(self, friction=friction)


def _core_term(term: FrictionTerm) -> tuple[int, str, str, float, float, list[float]]:
    """Return a friction term of the core, whose robot is at the reference temperature, where a law of temperature is zero."""
    if term.law in OF_TEMPERATURE:
        return term.joint, term.name, "table", -1.0, 1.0, [0.0] * 4
    speed = term.first if term.law == "table" else term.velocity
    return term.joint, term.name, term.law, speed, term.step, list(term.values)
