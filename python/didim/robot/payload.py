"""Payloads: rigid bodies fixed to the flange or to another link, partly or fully known.

A payload adds to the ten inertial parameters of its link. They split into a known part and columns for the unknown parameters:

    chi = chi_0 + V theta                    in the frame of the flange, or of the link
    x = x_robot + E T(chi)                   T: from there to the frame of the joint, E: places of the link's parameters

Tested in ``tests/test_payload_parameters.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import did_you_mean, series
from ..errors import ExperimentError
from .correspondence import Pose, homogeneous, rows_of
from .rigid_body import INERTIAL, body_pseudo_inertia, moved, pose, rotation_of, ten_parameters, why_no_body
from .robot import Robot

LARGEST = 1e9
"""Upper bound of the numbers of a description, payload or flange (m, rad, kg, kg.m^2, N.m): powers of larger ones overflow."""
NOTHING = "none"
"""Name of the empty payload."""
UNITS = dict(zip(INERTIAL, ["kg.m^2"] * 6 + ["kg.m"] * 3 + ["kg"], strict=True))
"""Unit of each of the ten inertial parameters."""


@dataclass(frozen=True, kw_only=True)
class Payload:
    """A payload with its known properties; those that are None are estimated.

    Tested in ``tests/test_payload_parameters.py``.

    Parameters
    ----------
    name : str
        Name of the payload in recordings.
    mass_kg : float, optional
        Mass (kg).
    com_m : (float, float, float), optional
        Centre of mass in the frame of the flange (m).
    inertia_kg_m2 : tuple of 6 float, optional
        ``XX XY XZ YY YZ ZZ`` about the centre of mass, axes of the flange (kg.m^2); it needs `com_m`.
    link : str, optional
        Link that carries it, whose own frame is then the flange: its name in the URDF, or the name or the number of its joint.
        By default the last link of joints in a line.

    Raises
    ------
    ExperimentError
        For values that no rigid body has.
    """

    name: str
    mass_kg: float | None = None
    com_m: tuple[float, ...] | None = None
    inertia_kg_m2: tuple[float, ...] | None = None
    link: str | None = None

    def __post_init__(self) -> None:
        where = f"payload '{self.name}':"
        if self.name == NOTHING and (self.mass_kg, self.com_m, self.inertia_kg_m2) != (None, None, None):
            raise ExperimentError(f"{where} the name is that of an empty flange, which has no mass")
        for key, length in (("com_m", 3), ("inertia_kg_m2", 6)):
            values = getattr(self, key)
            if values is None:
                continue
            values = tuple(float(value) for value in values)
            if len(values) != length or not all(map(math.isfinite, values)):
                raise ExperimentError(f"{where} {key} needs {length} finite numbers, got {list(values)}")
            if max(map(abs, values)) > LARGEST:
                raise ExperimentError(f"{where} {key} must be at most {LARGEST:g}, got {list(values)}")
            object.__setattr__(self, key, values)
        mass = self.mass_kg
        if mass is not None and not (math.isfinite(mass) and mass > 0.0):
            raise ExperimentError(f"{where} mass_kg must be a positive number, got {mass!r}")
        if mass is not None and mass > LARGEST:
            raise ExperimentError(f"{where} mass_kg must be at most {LARGEST:g}, got {mass!r}")
        if self.inertia_kg_m2 is not None:
            if self.com_m is None:
                raise ExperimentError(
                    f"{where} an inertia about the centre of mass needs the centre: com_m = [x, y, z]"
                )
            reason = why_no_body(self._body(1.0 if mass is None else mass))
            if reason is not None:
                raise ExperimentError(f"{where} inertia_kg_m2 is not that of a body: {reason}")

    def _body(self, mass: float) -> Array:
        assert self.com_m is not None
        xx, xy, xz, yy, yz, zz = self.inertia_kg_m2 or (0.0,) * 6
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return body_pseudo_inertia(mass, inertia, pose(np.eye(3), self.com_m))

    @property
    def split(self) -> tuple[Array, Array, tuple[str, ...]]:
        """Return the known part of the ten parameters, (10,), the columns of the unknown ones, (10, k), and their names.

        With a known centre and an unknown mass one column is the mass with its first moments.
        """
        known, columns = np.zeros(10), {name: np.eye(10)[k] for k, name in enumerate(INERTIAL)}
        if self.name == NOTHING:
            return known, np.zeros((10, 0)), ()
        if self.com_m is not None:
            for name in ("MX", "MY", "MZ"):
                del columns[name]
            # With a known centre the mass determines the first moments; all second moments about the flange are unknown.
            columns["M"] = np.array([0.0] * 6 + [*self.com_m, 1.0])
            if self.inertia_kg_m2 is not None:
                known = ten_parameters(self._body(0.0))
                columns = {"M": ten_parameters(self._body(1.0)) - known}
        if self.mass_kg is not None:
            known = known + self.mass_kg * columns.pop("M")
        names = tuple(columns)
        matrix = np.stack([columns[name] for name in names], axis=1) if names else np.zeros((10, 0))
        return known, matrix, names

    @property
    def known(self) -> bool:
        """Whether all parameters are known."""
        return not self.split[2]


def read_payload(table: Table, name: str) -> Payload:
    """Read a table ``[payload.NAME]``."""
    mass = table.number("mass_kg", None)
    com = table.numbers("com_m", 3, None)
    inertia = table.numbers("inertia_kg_m2", 6, None)
    link = table.text("link", None)
    table.done()
    return Payload(
        name=name,
        mass_kg=mass,
        com_m=None if com is None else tuple(com),
        inertia_kg_m2=None if inertia is None else tuple(inertia),
        link=link,
    )


def read_flange(table: Table) -> Pose:
    """Read the table ``[flange]``: its pose in the last link's frame; rows of a homogeneous matrix (3 x 4)."""
    origin = table.numbers("xyz_m", 3)
    if max(map(abs, origin)) > LARGEST:
        table.fail(f"xyz_m must be at most {LARGEST:g}, got {list(origin)}")
    degrees = table.numbers("rpy_deg", 3, None)
    angles = tuple(table.numbers("rpy_rad", 3) if degrees is None else map(math.radians, degrees))
    table.done()
    return rows_of(pose(rotation_of(angles), origin))


def flange_in_last_frame(robot: Robot, flange: Pose | None = None) -> Array:
    """Return the pose of the flange in frame n of the robot, (4, 4).

    Parameters
    ----------
    robot : Robot
        Robot whose flange is its last own frame: that of the last link of a URDF or of the maker's table, otherwise frame n.
    flange : 3 x 4 tuple of float, optional
        Pose of the flange in that frame, from `read_flange`.
    """
    link = robot.own_frames[-1]
    return link if flange is None else np.asarray(link @ homogeneous(flange))


def carrying_joint(robot: Robot, payload: Payload) -> int:
    """Return the joint, from 0, whose link carries a payload.

    Raises
    ------
    ExperimentError
        For a link that the robot does not have, and for a tree, which has several last links, without one.
    """
    numbers = tuple(str(joint + 1) for joint in range(robot.n_joints))
    joints = robot.all_joint_names or numbers
    places = robot.correspondence
    links = joints if places is None else tuple(place.link for place in places.links)
    names = {name: joint for column in (numbers, joints, links) for joint, name in enumerate(column)}
    if payload.link in names:
        return names[payload.link]
    known = [links[joint] for joint in ends(robot)]
    where = f"payload '{payload.name}':"
    if payload.link is not None:
        text = f"robot {robot.name!r} has no link {payload.link!r}{did_you_mean(payload.link, names)}"
        raise ExperimentError(f"{where} {text}")
    if not robot.geometry.in_line:
        raise ExperimentError(
            f"{where} robot {robot.name!r} is a tree: give link, such as {series(map(repr, known), 60)}"
        )
    return robot.n_dof - 1


def ends(robot: Robot) -> list[int]:
    """Return the driven joints, from 0, whose link carries no further driven joint: the last one of joints in a line."""
    parents = robot.geometry.parents
    return [joint for joint in range(robot.n_dof) if joint not in parents[: robot.n_dof]]


def frame_of_payloads(robot: Robot, flange: Pose | None = None, payload: Payload | None = None) -> str:
    """Return the frame of a payload in words, as for `payload_columns`: ``link wrist_3_link``."""
    if flange is not None and (payload is None or payload.link is None):
        return "[flange]"
    joint = robot.n_dof - 1 if payload is None else carrying_joint(robot, payload)
    if robot.correspondence is not None:
        return f"link {robot.correspondence.links[joint].link}"
    return f"frame {joint + 1}" + ("" if robot.standard is None else " of the maker's table")


def payload_columns(robot: Robot, payload: Payload, flange: Pose | None = None) -> Array:
    """Return the matrix (p, 10) from a payload's ten parameters, in its frame, to the standard parameters of the robot.

    The frame is that of `Payload.link`, else `flange_in_last_frame`. Tested in ``tests/test_payload_parameters.py``.

    Raises
    ------
    ExperimentError
        As for `carrying_joint`.
    """
    joint = carrying_joint(robot, payload)
    frame = flange_in_last_frame(robot, flange) if payload.link is None else robot.own_frames[joint]
    return link_columns(robot, joint, frame)


def last_link(robot: Robot, frame: Array) -> Array:
    """Return the matrix of `link_columns` for the last link of joints in a line."""
    return link_columns(robot, robot.n_dof - 1, frame)


def link_columns(robot: Robot, joint: int, frame: Array | None = None) -> Array:
    """Return the matrix (p, 10) from ten parameters, in a frame with this pose in that of a joint, to the standard parameters."""
    first = robot.parameter_names.index(f"{INERTIAL[0]}{joint + 1}")
    columns = np.zeros((len(robot.parameter_names), 10))
    units = np.eye(10)
    columns[first : first + 10] = (
        units if frame is None else np.stack([moved(unit, frame) for unit in units], axis=1)
    )
    return columns
