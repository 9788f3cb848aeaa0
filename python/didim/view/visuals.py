"""Visual meshes and solids of a URDF, with their poses on the links of a robot.

Tested in ``tests/test_view.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.inputs import read_small_file
from ..errors import RobotError
from ..model.kinematics import frames
from ..robot.rigid_body import inverse
from ..robot.robot import Robot
from ..robot.urdf.description import frame_of, read_description
from ..robot.urdf.mechanism import Description
from ..robot.urdf.xml_spans import Element, parse_xml
from .shapes import Colour, Shape

BODY: Colour = (188, 194, 203)
SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("scale",)}
"""Attributes of the size of each solid."""
ENDINGS = (".stl", ".obj", ".ply", ".glb", ".gltf", ".dae")
"""Suffixes of mesh files that trimesh reads; COLLADA also needs pycollada."""


def visuals(robot: Robot, path: Path, folders: tuple[Path, ...] = ()) -> tuple[list[Shape], list[str]]:
    """Return the URDF's visual shapes of each link of the robot.

    Parameters
    ----------
    robot : Robot
        Robot with the correspondence to its URDF.
    path : Path
        The URDF.
    folders : tuple of Path
        Folders of packages and meshes, in addition to the URDF's folder and its parents.

    Returns
    -------
    shapes : list of Shape
        Meshes, boxes, cylinders and spheres of the layer "visuals".
    missing : list of str
        A sentence for each mesh that was not found.
    """
    places = robot.correspondence
    if places is None:
        raise RobotError(f"{path.name}: {robot.name} was not read from a URDF, so its links have no meshes")
    data = read_small_file(path, RobotError)
    description = read_description(data, path.name)
    at_zero = _at_zero(description, dict(places.lock))
    frame_0 = at_zero[places.base] @ places.base_matrix
    own = frames(robot, np.zeros((1, robot.n_dof)))[0]
    carrier = {
        name: joint + 1
        for joint, placed in enumerate(places.links)
        for name in (placed.link, *placed.lumped, *placed.locked)
    }
    shapes: list[Shape] = []
    missing: list[str] = []
    for link in parse_xml(data, path.name).all("link"):
        name = link.attributes["name"]
        if name not in at_zero:  # of a tree that the robot is not on
            continue
        number = carrier.get(name, 0)
        seen = inverse(frame_0 @ own[number]) @ at_zero[name]
        for visual in link.all("visual"):
            shape = _shape(visual, number, seen, path, folders, missing)
            if shape is not None:
                shapes.append(shape)
    return shapes, missing


def _at_zero(description: Description, lock: dict[str, float]) -> dict[str, Array]:
    """Return the frame of each link in the root with all joints at zero, locked ones at their positions."""
    transforms = {description.root: np.eye(4)}
    for name in description.carried(description.root):
        for joint in description.outgoing.get(name, ()):
            step = joint.origin @ joint.motion(lock.get(joint.name, 0.0))
            transforms[joint.child] = transforms[name] @ step
    return transforms


def _shape(
    visual: Element, link: int, seen: Array, path: Path, folders: tuple[Path, ...], missing: list[str]
) -> Shape | None:
    """Return one visual in the frame of the robot's link; None for a missing mesh."""
    geometry = visual.find("geometry")
    solid = geometry.children[0] if geometry is not None and geometry.children else None
    if solid is None or solid.tag not in SIZES:
        return None
    given, file = solid.attributes, None
    if solid.tag == "mesh":
        name = given.get("filename", "")
        file = find_mesh(name, path, folders)
        if file is None:
            missing.append(
                f"{path.name}: the mesh {name} was not found; --meshes names the folder of its package"
            )
            return None
        given = {"scale": "1 1 1", **given}
    return Shape(
        layer="visuals",
        link=link,
        kind=solid.tag,  # type: ignore[arg-type]
        pose=seen @ frame_of(visual, f"{path.name}: line {visual.line}:"),
        size=tuple(float(word) for key in SIZES[solid.tag] for word in given[key].split()),
        colour=BODY,
        file=file,
    )


def find_mesh(name: str, path: Path, folders: tuple[Path, ...] = ()) -> Path | None:
    """Return the file of a mesh: `package://NAME/...` in a folder NAME above the URDF or in `folders`, other names beside it."""
    if not name.lower().endswith(ENDINGS):
        return None
    tail = name.split("://", 1)[-1]
    above = [*folders, path.resolve().parent, *path.resolve().parents]
    if name.startswith("package://"):
        # With or without the name of the package, which may be unpacked in a folder of another name.
        candidates = [folder / part for folder in above for part in (tail, tail.partition("/")[2])]
    else:
        candidates = [Path(tail), *(folder / tail for folder in above[: len(folders) + 1])]
    return next((file for file in candidates if file.is_file()), None)
