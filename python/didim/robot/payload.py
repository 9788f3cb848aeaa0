"""Payloads: rigid bodies fixed to the flange, partly or fully known. Tested in ``tests/test_payload_parameters.py``.

A payload adds to the ten inertial parameters of the last link. They split into a known part and columns for the unknown
parameters:

    chi = chi_0 + V theta                    in the frame of the flange
    x = x_robot + E T(chi)                   T: flange to frame n, E: places of the last link
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from ..errors import ExperimentError
from .rigid_body import (
    INERTIAL,
    body_pseudo_inertia,
    pose,
    pseudo_inertia,
    rotation_of,
    ten_parameters,
    why_no_body,
)
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

    Raises
    ------
    ExperimentError
        For values that no rigid body has.
    """

    name: str
    mass_kg: float | None = None
    com_m: tuple[float, ...] | None = None
    inertia_kg_m2: tuple[float, ...] | None = None

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
    table.done()
    return Payload(
        name=name,
        mass_kg=mass,
        com_m=None if com is None else tuple(com),
        inertia_kg_m2=None if inertia is None else tuple(inertia),
    )


Pose = tuple[tuple[float, ...], ...]


def read_flange(table: Table) -> Pose:
    """Read the table ``[flange]``: its pose in the last link's frame; rows of a homogeneous matrix (3 x 4)."""
    origin = table.numbers("xyz_m", 3)
    if max(map(abs, origin)) > LARGEST:
        table.fail(f"xyz_m must be at most {LARGEST:g}, got {list(origin)}")
    degrees = table.numbers("rpy_deg", 3, None)
    angles = tuple(table.numbers("rpy_rad", 3) if degrees is None else map(math.radians, degrees))
    table.done()
    return tuple(tuple(row) for row in pose(rotation_of(angles), origin)[:3].tolist())


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
    return link if flange is None else np.asarray(link @ np.vstack([np.array(flange), [0.0, 0.0, 0.0, 1.0]]))


def frame_of_payloads(robot: Robot, flange: Pose | None = None) -> str:
    """Return the frame of payloads in words, as for `flange_in_last_frame`: ``link wrist_3_link``."""
    if flange is not None:
        return "[flange]"
    if robot.correspondence is not None:
        return f"link {robot.correspondence.links[-1].link}"
    return f"frame {robot.n_dof}" + ("" if robot.standard is None else " of the maker's table")


def moved(ten: Array, frame: Array) -> Array:
    """Return ten inertial parameters in another frame, where `frame`, (4, 4), is the pose of their present frame."""
    return ten_parameters(frame @ pseudo_inertia(ten) @ frame.T)


def last_link(robot: Robot, frame: Array) -> Array:
    """Return the matrix (p, 10) from a payload's ten parameters, in a frame with this pose in frame n, to the standard parameters.

    Raises
    ------
    ExperimentError
        For a tree, which has several last links.
    """
    if not robot.geometry.in_line:
        raise ExperimentError(
            f"robot {robot.name!r} is a tree: payloads need joints in a line, whose last link is the flange"
        )
    first = robot.parameter_names.index(f"{INERTIAL[0]}{robot.n_dof}")
    columns = np.zeros((len(robot.parameter_names), 10))
    columns[first : first + 10] = np.stack([moved(unit, frame) for unit in np.eye(10)], axis=1)
    return columns
