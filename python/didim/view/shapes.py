"""Shapes of a robot: skeleton, joint axes, bodies, capsules, gravity. They are only data; `page` shows them.

A body is drawn as the solid ellipsoid with its mass and central second moments. Its semi-axes are ``sqrt(5 l)`` for the eigenvalues
l of ``S / m - c c'``. Tested in ``tests/test_view.py``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from .._tools.arrays import Array
from ..model.consistency import pseudo_inertias
from ..model.kinematics import frames
from ..robot.collision import Capsule
from ..robot.rigid_body import pose
from ..robot.robot import Robot

Colour = tuple[int, int, int]
Kind = Literal["cylinder", "sphere", "ellipsoid", "box", "mesh"]

LINK: Colour = (96, 106, 120)
AXIS: Colour = (0, 114, 178)
ESTIMATE: Colour = (0, 158, 115)
PRIOR: Colour = (150, 155, 163)
CAPSULE: Colour = (230, 159, 0)
GRAVITY: Colour = (213, 94, 0)
FLOOR: Colour = (128, 134, 142)
SKELETON_SHARE = 0.022
"""Radius of the skeleton, as a share of the robot's reach: thick enough to see, thin enough to show a wrong row."""
AXIS_SHARE = 0.09
"""Half the length of a drawn joint axis, as a share of the robot's reach."""
SMALLEST_M = 1e-9
"""Length (m) below which a segment has no direction and is not drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """A shape that moves with one link.

    Attributes
    ----------
    layer : str
        Group of shapes that are shown or hidden together.
    link : int
        Link that carries it; 0 is the base.
    kind : str
        "cylinder" (along z), "sphere", "ellipsoid", "box" or "mesh".
    pose : (4, 4) array
        Frame of the shape in that of the link (m).
    size : tuple of float
        Radius and height of a cylinder, radius of a sphere, semi-axes of an ellipsoid, edges of a box (m); factors of a mesh.
    colour : tuple of int
        Red, green and blue, 0 to 255.
    opacity : float
        Opacity, from 0 to 1.
    file : Path, optional
        File of a mesh.
    """

    layer: str
    link: int
    kind: Kind
    pose: Array
    size: tuple[float, ...]
    colour: Colour
    opacity: float = 1.0
    file: Path | None = None


def reach(robot: Robot) -> float:
    """Return the largest extent of the robot at position zero (m), at least 0.1 m."""
    origins = frames(robot, np.zeros((1, robot.n_dof)))[0, :, :3, 3]
    return max(float(np.ptp(origins, axis=0).max()), 0.1)


def skeleton(robot: Robot) -> list[Shape]:
    """Return links as segments between the origins of the frames, and the joints' axes."""
    size = reach(robot)
    at_zero = frames(robot, np.zeros((1, robot.n_dof)))[0]
    shapes: list[Shape] = []
    parents = robot.geometry.parents
    for joint, parent in enumerate(parents):
        before = 0 if parent is None else parent + 1
        # The position of a revolute joint in its parent's frame does not depend on the pose.
        seen = np.linalg.solve(at_zero[before], at_zero[joint + 1])
        corners = [np.zeros(3), seen[:3, 3]]
        if robot.geometry.in_line:  # along x by d, then along z by r, as in the rows of the robot file
            corners.insert(1, np.array([robot.geometry.d[joint], 0.0, 0.0]))
        if parents.count(parent) > 1:  # a trunk: limbs meet in its middle
            limbs = [other + 1 for other, below in enumerate(parents) if below == parent]
            origins = np.linalg.solve(at_zero[before], at_zero[limbs])[:, :3, 3]
            corners.insert(1, origins.mean(axis=0))
        if robot.geometry.kinds[joint] == "prismatic":
            shapes.append(box("skeleton", joint + 1, 4.0 * SKELETON_SHARE * size))
        else:
            shapes.append(ball("skeleton", joint + 1, 1.4 * SKELETON_SHARE * size))
        for start, end in itertools.pairwise(corners):
            shapes += segment("skeleton", before, start, end, SKELETON_SHARE * size, LINK)
        half = AXIS_SHARE * size
        along = np.array([0.0, 0.0, half])
        shapes += segment("joint axes", joint + 1, -along, along, 0.35 * SKELETON_SHARE * size, AXIS)
    return shapes


def segment(
    layer: str, link: int, start: Array, end: Array, radius: float, colour: Colour, opacity: float = 1.0
) -> list[Shape]:
    """Return the cylinder between two points of a link (m); none if they coincide."""
    between = end - start
    length = float(np.linalg.norm(between))
    if length < SMALLEST_M:
        return []
    z = between / length
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    placed = pose(np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (start + end))
    return [
        Shape(
            layer=layer,
            link=link,
            kind="cylinder",
            pose=placed,
            size=(radius, length),
            colour=colour,
            opacity=opacity,
        )
    ]


def ball(
    layer: str, link: int, radius: float, colour: Colour = LINK, at: Array | None = None, opacity: float = 1.0
) -> Shape:
    """Return a sphere around a point of a link (m)."""
    placed = pose(np.eye(3), np.zeros(3) if at is None else at)
    return Shape(
        layer=layer, link=link, kind="sphere", pose=placed, size=(radius,), colour=colour, opacity=opacity
    )


def box(layer: str, link: int, edge: float) -> Shape:
    """Return a cube around the origin of a link (m)."""
    return Shape(layer=layer, link=link, kind="box", pose=np.eye(4), size=(edge,) * 3, colour=LINK)


def bodies(robot: Robot, x: Array, layer: str, colour: Colour) -> tuple[list[Shape], list[str]]:
    """Return the ellipsoid of inertia and the centre of mass of each link.

    Parameters
    ----------
    robot : Robot
        Robot with its links.
    x : (c,) array
        Standard parameters (SI units, joint side).
    layer : str
        Name of the shapes.
    colour : tuple of int
        Colour of the shapes.

    Returns
    -------
    shapes : list of Shape
        An ellipsoid and a small sphere for each link that is a body.
    refused : list of str
        A sentence for each link that is not a body.
    """
    shapes: list[Shape] = []
    refused: list[str] = []
    small = 0.6 * SKELETON_SHARE * reach(robot)
    for joint, matrix in enumerate(pseudo_inertias(robot, x)):
        mass = float(matrix[3, 3])
        if not np.any(matrix):
            continue
        if mass <= 0.0:
            refused.append(f"{layer}: link {joint + 1} has a mass of {mass:.3g} kg and is not drawn")
            continue
        centre = matrix[:3, 3] / mass
        moments, turned = np.linalg.eigh(matrix[:3, :3] / mass - np.outer(centre, centre))
        if moments[0] < -1e-9 * moments[2]:
            refused.append(f"{layer}: link {joint + 1} has an inertia that no body has and is not drawn")
            continue
        if np.linalg.det(turned) < 0.0:
            turned[:, 0] *= -1.0
        axes = np.sqrt(5.0 * np.maximum(moments, 0.0))
        size = (float(axes[0]), float(axes[1]), float(axes[2]))
        shapes += [
            Shape(
                layer=layer,
                link=joint + 1,
                kind="ellipsoid",
                pose=pose(turned, centre),
                size=size,
                colour=colour,
                opacity=0.35,
            ),
            ball(f"{layer}: centres of mass", joint + 1, small, colour, centre),
        ]
    return shapes, refused


def capsules(given: Sequence[Capsule]) -> list[Shape]:
    """Return the capsules used for the clearance of designed motions."""
    shapes: list[Shape] = []
    for capsule in given:
        start, end = np.array(capsule.start), np.array(capsule.end)
        shapes += segment("capsules", capsule.link, start, end, capsule.radius, CAPSULE, 0.3)
        shapes += [ball("capsules", capsule.link, capsule.radius, CAPSULE, at, 0.3) for at in (start, end)]
    return shapes
