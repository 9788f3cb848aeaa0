"""Content of an exported robot file: a body per link, the drive of each joint, and all poses.

Parameters that no robot can have are refused, with the name of the link or joint. Tested in ``tests/test_export.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from .._tools.words import series
from ..errors import FitError
from ..model.consistency import pseudo_inertias
from ..model.dynamics import standard_vector
from ..robot.friction import FrictionTerm
from ..robot.rigid_body import inverse, why_no_body
from ..robot.robot import JointLimits, Robot
from ..robot.transmission import Follower


@dataclass(frozen=True, eq=False)
class LinkBody:
    """One moving link with its joint, in the frames of the exported file.

    Attributes
    ----------
    link, joint, kind : str
        Names, and ``revolute`` or ``prismatic``.
    pose : (4, 4) array
        Frame of the link at position zero in that of its parent, m.
    parent : int or None
        Antecedent, from 0; None for the base.
    axis : (3,) array
        Unit axis of the joint in the frame of the link.
    pseudo : (4, 4) array
        Pseudo-inertia in the frame of the link.
    limits : JointLimits
        Limits of the joint.
    viscous, coulomb : float
        Friction of the joint: ``Fv`` (N.m.s/rad or N.s/m) and ``Fc`` (N.m or N), the mean of both directions where they differ.
    rotor : float
        ``Ia`` (kg.m^2 or kg), joint side.
    stiffness, rest : float
        Spring of the joint, ``Ks`` (N.m/rad or N/m), and the position (rad or m) at which it has no torque: the offset gives it.
    follower : Follower or None
        Coupling of the joint to others, if any.
    """

    link: str
    joint: str
    kind: str
    pose: Array
    parent: int | None
    axis: Array
    pseudo: Array
    limits: JointLimits
    viscous: float
    coulomb: float
    rotor: float
    stiffness: float = 0.0
    rest: float = 0.0
    follower: Follower | None = None

    def leader(self, what: str) -> tuple[int, float]:
        """Return the only leader of a coupled joint, from 0, with its factor; a format's way to say so has no more."""
        assert self.follower is not None
        if len(self.follower.leaders) > 1:
            raise FitError(f"joint {self.joint!r} follows several others, and {what} has one")
        return self.follower.leaders[0]


@dataclass(frozen=True, eq=False)
class CoupledMotor:
    """A motor that turns with several joints, (22): its speed is ``coefficients @ dq``.

    Attributes
    ----------
    number : int
        Number of the motor and of its own joint, from 0.
    coefficients : (n_dof,) array
        Row of the coupling matrix, 1 for its own joint.
    rotor, viscous, coulomb : float
        ``Ia``, ``Fvm`` and ``Fcm``.
    """

    number: int
    coefficients: Array
    rotor: float
    viscous: float
    coulomb: float


@dataclass(frozen=True, eq=False)
class ExportModel:
    """A robot with physical parameters, ready to be written.

    Attributes
    ----------
    name, base : str
        Names of the robot and of its fixed link.
    gravity : (3,) array
        Acceleration of gravity in the base (m/s^2).
    links : tuple of LinkBody
        From the base outwards; those of coupled joints last.
    outwards : tuple of int
        Links branch by branch, each after its antecedent.
    lock : mapping of str to float
        Positions of locked joints of the description (rad or m).
    motors : tuple of CoupledMotor
        Motors that turn with several joints.
    left_out : tuple of str
        Sentences on parameters that neither URDF, MJCF nor SDF can represent.
    """

    name: str
    base: str
    gravity: Array
    links: tuple[LinkBody, ...]
    motors: tuple[CoupledMotor, ...]
    left_out: tuple[str, ...]
    outwards: tuple[int, ...]
    lock: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def frames(self) -> dict[int | None, Array]:
        """Frames (4, 4) of the links in the base at position zero, by number."""
        frames: dict[int | None, Array] = {None: np.eye(4)}
        for j in self.outwards:
            frames[j] = frames[self.links[j].parent] @ self.links[j].pose
        return frames

    def between(self) -> dict[int, int]:
        """Return the links between the joints of one body, which have no mass, each with the only one that it carries.

        Raises
        ------
        FitError
            When a link without mass carries several others.
        """
        found = {}
        for j, link in enumerate(self.links):
            if not link.pseudo.any():
                carried = [k for k, other in enumerate(self.links) if other.parent == j]
                if len(carried) != 1:
                    raise FitError(
                        f"link {link.link!r} has no mass and carries {len(carried)} links: no joints of one body"
                    )
                found[j] = carried[0]
        return found

    def own_share(self, key: str) -> Array:
        """Return the ``rotor``, ``viscous`` or ``coulomb`` of each joint without the shares of coupled motors.

        ``Ia_j`` and ``Fv_j`` contain ``c^2`` times those of every motor that turns with joint j (24), ``Fc_j`` contains only
        that of its own motor.

        Raises
        ------
        FitError
            When a share is negative, as for no real drive.
        """
        share = np.array([getattr(link, key) for link in self.links])
        scale = np.abs(share)
        for motor in self.motors:
            value = getattr(motor, key)
            if key == "coulomb":
                share[motor.number] -= value
            else:
                share -= motor.coefficients**2 * value
        # If a joint only has the share of a coupled motor, rounding may give a small negative number.
        share[np.abs(share) <= 1e-14 * scale] = 0.0
        for link, value in zip(self.links, share, strict=True):
            if value < 0.0:
                raise FitError(
                    f"{WORDS[key]} of joint {link.joint!r} without its coupled motors is {value:.4g}: no drive has that; "
                    "export physically consistent parameters"
                )
        return share


PLACED = re.compile(r"(XX|XY|XZ|YY|YZ|ZZ|MX|MY|MZ|M|Ia|Fv|Fc|Off|Fvm|Fcm|Ks)\d+[+-]?")
"""Pattern of the standard parameters that an export can place; all others are further terms."""

WORDS = {
    "rotor": "rotor inertia",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "stiffness": "stiffness of the spring",
}


def export_model(robot: Robot, x: ArrayLike) -> ExportModel:
    """Check that standard parameters belong to a robot, and arrange them for a file.

    Parameters
    ----------
    robot : Robot
        The robot; a ``[urdf]`` table preserves the names and frames of its URDF.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``, SI units, joint side.

    Raises
    ------
    FitError
        When a link is not a body, or a friction or rotor inertia is negative; the message names the link or joint.
    ShapeError
        When `x` has another length, or a NaN.
    """
    vector = standard_vector(robot, x)
    values = dict(zip(robot.parameter_names, vector.tolist(), strict=True))
    pseudos = pseudo_inertias(robot, vector)
    places = robot.correspondence
    n = robot.n_joints
    carrying = set(robot.geometry.parents)
    links = [link.link for link in places.links] if places else [f"link{j + 1}" for j in range(n)]
    joints = robot.all_joint_names or tuple(f"joint{j + 1}" for j in range(n))
    offsets = [link.matrix for link in places.links] if places else [np.eye(4)] * n
    geometry = robot.geometry
    bodies, missed = [], []
    base = inverse(places.base_matrix) if places else np.eye(4)
    for j, parent in enumerate(geometry.parents):
        before, step = base if parent is None else offsets[parent], geometry.placement(j)
        inside = inverse(offsets[j])
        pseudo = inside @ pseudos[j] @ inside.T
        if pseudo.any() or j not in carrying:  # the links between the joints of one body have no mass
            reason = why_no_body(pseudo)
            if reason is not None:
                reason = reason if pseudo[3, 3] else "its mass is 0 kg (base parameters alone give no masses)"
                raise FitError(
                    f"link {links[j]!r} is not a body: {reason}; export physically consistent parameters"
                )
        viscous, coulomb, left = joint_friction(values, j, robot.friction.terms, geometry.kinds[j])
        missed.append(left)
        stiffness = values.get(f"Ks{j + 1}", 0.0)
        body = LinkBody(
            link=links[j],
            joint=joints[j],
            kind=geometry.kinds[j],
            pose=_clean(inverse(before) @ step @ offsets[j]),
            parent=parent,
            axis=_clean(inside[:3, 2]),
            pseudo=0.5 * (pseudo + pseudo.T),
            limits=robot.limits[j] if j < robot.n_dof else JointLimits(),
            viscous=viscous,
            coulomb=coulomb,
            rotor=values[f"Ia{j + 1}"],
            stiffness=stiffness,
            rest=-values.get(f"Off{j + 1}", 0.0) / stiffness if stiffness else 0.0,
            follower=geometry.followers[j - robot.n_dof] if j >= robot.n_dof else None,
        )
        _check_drive(body)
        bodies.append(body)
    gravity = np.array(geometry.gravity)
    return ExportModel(
        name=robot.name,
        base=places.base if places else "base",
        gravity=_clean(places.base_matrix[:3, :3] @ gravity) if places else gravity,
        links=tuple(bodies),
        motors=tuple(_motors(robot, values)),
        left_out=tuple(_left_out(robot, values, joints, missed)),
        outwards=geometry.outwards,
        lock=dict(places.lock) if places else {},
    )


def _check_drive(body: LinkBody) -> None:
    for key, word in WORDS.items():
        value = getattr(body, key)
        if value < 0.0:
            raise FitError(
                f"{word} of joint {body.joint!r} is negative ({value:.4g}); export physically consistent parameters"
            )


FASTEST = {"revolute": 2.0, "prismatic": 0.2}
"""Speed (rad/s, m/s) up to which viscous and Coulomb friction stand for the laws of `SLIDING`: the largest velocity of a law."""
SLIDING: dict[str, Callable[[Array, float], Array]] = {
    "atan": lambda speed, v: np.arctan(speed / v),
    "stribeck": lambda speed, v: np.exp(-np.square(speed / v)),
    "root": lambda speed, _: np.sqrt(speed),
    "forward": lambda speed, _: 0.5 * speed,
    "dahl": lambda speed, _: np.ones_like(speed),
}
"""Torque per unit of the parameter over speed, of joints that slide on for long; ``forward`` as the mean of both directions."""


def joint_friction(
    values: Mapping[str, float], j: int, terms: Sequence[FrictionTerm] = (), kind: str = "revolute"
) -> tuple[float, float, float]:
    """Compute viscous and Coulomb friction of a joint, the mean of both directions if they differ, and what they miss.

    Parameters
    ----------
    values : mapping
        Standard parameters.
    j : int
        Joint, from 0.
    terms : sequence of FrictionTerm
        Further terms; those of `SLIDING` become the line that is nearest to the friction up to `FASTEST`.
    kind : {"revolute", "prismatic"}
        Kind of the joint.

    Returns
    -------
    viscous, coulomb : float
        Coefficients.
    missed : float
        Largest difference of the line (N.m or N) up to `FASTEST`; memory alone leaves none (``test_export.py``).
    """
    if f"Fv{j + 1}" in values:
        viscous, coulomb = values[f"Fv{j + 1}"], values[f"Fc{j + 1}"]
    else:
        viscous, coulomb = (
            0.5 * (values[f"{key}{j + 1}+"] + values[f"{key}{j + 1}-"]) for key in ("Fv", "Fc")
        )
    own = [term for term in terms if term.joint == j and term.law in SLIDING and values.get(term.parameter)]
    if not own:
        return viscous, coulomb, 0.0
    from scipy.optimize import nnls

    speed = np.linspace(0.0, FASTEST[kind], 201)[1:]
    line = np.column_stack([speed, np.ones_like(speed)])
    torque = line @ [viscous, coulomb] + sum(
        values[term.parameter] * SLIDING[term.law](speed, term.velocity) for term in own
    )
    nearest = nnls(line, torque)[0]
    return float(nearest[0]), float(nearest[1]), float(np.abs(line @ nearest - torque).max())


def lost_friction(
    values: Mapping[str, float], terms: Sequence[FrictionTerm], joints: Mapping[str, float]
) -> list[str]:
    """Return sentences on further terms: those in a line, with what it misses at each joint by name (N.m or N), and those left out.

    Parameters
    ----------
    values : mapping
        Standard parameters.
    terms : sequence of FrictionTerm
        Further terms.
    joints : mapping
        What the line of each joint misses, see `joint_friction`.
    """
    lined = [term.parameter for term in terms if term.law in SLIDING and values.get(term.parameter)]
    lost = []
    if lined:
        missed = series((f"{joint} {value:.2g}" for joint, value in joints.items() if value > 0.0), 40)
        fastest, slide = FASTEST.values()
        lost.append(
            f"{series(lined, 28)} are viscous and Coulomb friction in the file"
            + (f", off by (N.m, N) {missed} below {fastest:g} rad/s ({slide:g} m/s)" if missed else "")
        )
    others = [
        name for name, value in values.items() if value and not PLACED.fullmatch(name) and name not in lined
    ]
    if others:
        lost.append(f"{series(others)} are left out: no format has a place for such friction and springs")
    return lost


def _motors(robot: Robot, values: dict[str, float]) -> list[CoupledMotor]:
    return [
        CoupledMotor(
            number=m,
            coefficients=row / row[m],
            rotor=values[f"Ia{m + 1}"],
            viscous=values[f"Fvm{m + 1}"],
            coulomb=values[f"Fcm{m + 1}"],
        )
        for m, row in enumerate(np.array(robot.geometry.coupling))
        if f"Fvm{m + 1}" in values
    ]


def _left_out(
    robot: Robot, values: dict[str, float], joints: tuple[str, ...], missed: Sequence[float]
) -> list[str]:
    sentences = []
    offsets = [
        joint for j, joint in enumerate(joints) if values.get(f"Off{j + 1}") and not values.get(f"Ks{j + 1}")
    ]
    if offsets:
        sentences.append(
            f"the torque offsets of {series(offsets)} are left out: no format can represent them"
        )
    sentences += lost_friction(values, robot.friction.terms, dict(zip(joints, missed, strict=True)))
    if robot.friction.model == "asymmetric":
        sentences.append("friction is the mean of both directions: no format has one per direction")
    return sentences


def _clean(matrix: Array) -> Array:
    """Return an array with entries below 1e-15, which are rounding (of 1, or of 1 m), set to zero."""
    return np.where(np.abs(matrix) < 1e-15, 0.0, matrix)
