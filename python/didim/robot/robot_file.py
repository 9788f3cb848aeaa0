"""Robots read from TOML files, each key checked. Tested in ``tests/test_robot.py``."""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.inputs import read_small_file
from .._tools.keys import declared
from .._tools.plugins import search_beside
from .._tools.toml import Table, read_toml
from .._tools.words import did_you_mean, series
from ..errors import RobotError, RobotWarning
from .collision import read_capsules
from .correspondence import read_correspondence, read_origins
from .friction import Friction, read_friction, read_springs
from .payload import LARGEST
from .placement import Mount, chain
from .right_angles import SNAP, RightAngles
from .robot import LIMIT_KEYS, MOST_JOINTS, Geometry, JointLimits, Robot
from .standard_dh import StandardTable, read_lengths
from .transmission import SOFTNESS, Actuator, read_followers, reduction_matrix

PACKAGED = Path(__file__).parents[1] / "packaged" / "robots"
"""Folder of the included robots."""


def load_robot(
    name: str | Path,
    *,
    tip: str | None = None,
    base: str | None = None,
    lock: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    snap: float | None = None,
    open: bool = False,
) -> Robot:
    """Load a robot.

    Parameters
    ----------
    name : str or Path
        Name of a packaged robot (``tx40``, ``ur10e``; `packaged_robots` lists all), path of a robot file, of a URDF
        or of an MJCF (``.xml``).
    tip, base : str, optional
        Last and first link of the chain of a URDF. By default the whole tree, but without the gripper of an arm: a chain of
        three joints or more whose branches all have fewer ends before them, and `notes` names what is locked. ``tip=""``
        always takes the whole tree.
    lock : mapping of str to float, optional
        Joints of a URDF to be locked, with their position (rad or m).
    gravity : sequence of 3 float, optional
        Acceleration of gravity in the base link of a URDF (m/s^2); by default the z axis of the root link points up.
    snap : float, optional
        Largest angle (rad) by which rounded right angles are snapped, 0 for none; by default ``snap_rad`` of the file, or
        1e-4. An explicit value suppresses the warning.
    open : bool
        Whether closed loops of an MJCF are cut on purpose. Without it they are cut too, and a fit refuses the robot.

    Returns
    -------
    Robot
        Robot whose ``notes`` list the changes made while reading the file.

    Raises
    ------
    RobotError
        When there is no such robot, or its file is wrong (``tests/test_robot.py``, ``tests/test_urdf.py``).

    Warns
    -----
    RobotWarning
        When angles are nearly right ones but outside the tolerance (``tests/test_urdf_snap.py``).
    """
    path = Path(name)
    if path.suffix.lower() in (".urdf", ".xml", ".mjcf"):
        from .urdf.reading import read_urdf

        limit = SNAP if snap is None else snap
        reading = read_urdf(path, tip=tip, base=base, lock=lock, gravity=gravity, snap=limit, open=open)
        if reading.suspicion is not None and snap is None:
            warnings.warn(reading.suspicion, RobotWarning, stacklevel=2)
        return reading.robot
    options = {"tip": tip, "base": base, "lock": lock, "gravity": gravity, "open": open or None}
    for option in (key for key, value in options.items() if value is not None):
        raise RobotError(f"{name}: {option} is for a URDF, and this is not one")
    packaged = {file.stem: file for file in sorted(PACKAGED.glob("*.toml"))}
    if path.suffix != ".toml":
        if str(name) not in packaged:
            raise RobotError(_no_robot(path, packaged))
        path = packaged[str(name)]
    content = read_toml(path, RobotError)
    search_beside(content.get("friction"), path)
    digest = hashlib.sha256(read_small_file(path, RobotError)).hexdigest()
    angles = RightAngles(snap)
    robot = read_robot(content, path, digest=digest, angles=angles)
    if angles.suspicious and not angles.chosen:
        warnings.warn(angles.suspicion(path.name), RobotWarning, stacklevel=2)
    return robot


def read_robot(
    content: Mapping[str, Any], path: Path, *, digest: str, angles: RightAngles | None = None
) -> Robot:
    """Make a robot from the content of a robot file; the file itself need not exist.

    Parameters
    ----------
    content : mapping
        Tables of the file, as parsed by `tomllib`.
    path : Path
        File name for messages.
    digest : str
        SHA-256 of the content, for the record of results.
    angles : RightAngles, optional
        Snaps rounded right angles, and records which.

    Raises
    ------
    RobotError
        As for `load_robot`.
    """
    table = Table(content, path.name, RobotError, keys=declared("robot"))
    robot = _robot(table, path, angles or RightAngles(), digest)
    for parameter_set in robot._named:  # evaluated now, because a wrong description must fail on loading
        robot.parameter_set(parameter_set)
    robot.core  # noqa: B018 - likewise, for a robot without sets
    return robot


def check_closed(robot: Robot) -> None:
    """Refuse a robot whose closed loops were cut without consent (``tests/test_mjcf.py``)."""
    if robot.cut:
        raise RobotError(
            f"{robot.path.name}: it has closed loops, and a tree has none: {series(robot.cut, 60)}; --open (open=True) cuts them"
        )


def packaged_robots() -> dict[str, Robot]:
    """Return the included robots by name (``tests/test_packaged_robots.py``)."""
    return {file.stem: load_robot(file.stem) for file in sorted(PACKAGED.glob("*.toml"))}


def _no_robot(path: Path, packaged: Mapping[str, Path]) -> str:
    """Sentence on a name that is neither an included robot nor a path that ends in .toml."""
    if path.is_file():
        return f"{path}: the name of a robot file must end in .toml, or .urdf for a URDF; rename it"
    if Path(f"{path}.toml").is_file():
        return f"no packaged robot {path.name!r}; did you mean the file '{path.name}.toml'?"
    near = did_you_mean(path.name, packaged)
    return f"no packaged robot {path.name!r}{near} (there are: {series(packaged, 40)}); a path ends in .toml or .urdf"


def _robot(table: Table, path: Path, angles: RightAngles, digest: str) -> Robot:
    if table.integer("schema") != 1:
        raise RobotError(f"{path.name}: schema must be 1")
    convention = table.text("convention")
    angles.follow_file(table.number("snap_rad", None))
    joints = _joints(table)
    kinds = tuple(joint.text("kind") for joint in joints)
    rows = [_row(joint, kind, angles, convention) for joint, kind in zip(joints, kinds, strict=True)]
    couplings = table.tables("coupling", [])
    mounts = _mounts(joints, angles, convention, bool(couplings))
    joint_names = _joint_names(table, joints)
    limits = tuple(_limits(joint, kind) for joint, kind in zip(joints, kinds, strict=True))
    actuators, softness = _drives(joints[: len(joints) - len(couplings)], kinds)
    followers = read_followers(couplings, kinds, joint_names)
    if followers and convention == "dh":
        couplings[0].fail("joints that follow others are for modified rows, and this table is a standard one")
    for joint in joints:
        joint.done()
    alpha, d, theta, r = (tuple(column) for column in zip(*rows, strict=True))
    if (standard := StandardTable(a=d, alpha=alpha) if convention == "dh" else None) is not None:
        alpha, d = standard.rows
    n = len(kinds) - len(followers)
    coupling, reduction, gains = _transmission(table.part("transmission"), n)
    friction = _friction(table, kinds[:n])
    named, own = _parameter_sets(table.part("parameters"), standard)
    robot = Robot(
        name=table.text("name", path.stem),
        description=table.text("description"),
        path=path,
        digest=digest,
        geometry=Geometry(
            kinds=kinds,
            alpha=alpha,
            d=d,
            theta=theta,
            r=r,
            gravity=tuple(table.numbers("gravity_m_s2", 3)),
            coupling=coupling,
            mounts=mounts,
            followers=followers,
        ),
        friction=friction,
        limits=limits[:n],
        reduction=reduction,
        gains=gains,
        joint_names=joint_names[:n],
        correspondence=read_correspondence(table.table("urdf"), len(kinds)) if table.has("urdf") else None,
        collision=read_capsules(table.tables("collision", []), len(kinds)),
        standard=standard,
        notes=tuple(angles.notes(path.name)),
        actuators=actuators,
        softness=softness,
        cut=tuple(table.texts("cut")),
        origins=read_origins(table.part("identified")),
        _named=named,
        _own=own,
    )
    table.done()
    return robot


def _friction(table: Table, kinds: tuple[str, ...]) -> Friction:
    friction = read_friction(table.part("friction"), kinds, None)
    return read_springs(table.table("springs"), kinds, friction) if table.has("springs") else friction


def _transmission(
    table: Table, n: int
) -> tuple[tuple[tuple[float, ...], ...], Array | None, tuple[float, ...] | None]:
    """Return the coupling of the motors, the reduction matrix and the drive gains."""
    coupling = table.matrix("coupling", n, n) if table.has("coupling") else np.eye(n).tolist()
    reduction = reduction_matrix(table, n) if table.has("reduction") else None
    gains = tuple(table.numbers("drive_gains", length=n)) if table.has("drive_gains") else None
    table.done()
    if reduction is not None:
        reduction.setflags(write=False)
    return tuple(tuple(row) for row in coupling), reduction, gains


def _joints(table: Table) -> list[Table]:
    """Return the tables of the joints."""
    joints = table.tables("joint", [])
    if not joints:
        table.fail("a robot needs at least one [[joint]]")
    if len(joints) > MOST_JOINTS:
        table.fail(f"a robot has at most {MOST_JOINTS} joints, got {len(joints)}")
    return joints


def _row(joint: Table, kind: str, angles: RightAngles, convention: str) -> tuple[float, float, float, float]:
    """Return alpha, the length along x, theta and the length along z of one row (rad, m)."""
    if convention == "dh":
        along_x, along_z = read_lengths(joint)
        _check_lengths(joint, a_m=along_x, d_m=along_z)
    else:
        along_x, along_z = joint.number("d_m", 0.0), joint.number("r_m")
        _check_lengths(joint, d_m=along_x, r_m=along_z)
    alpha, theta = _angle(joint, "alpha"), _angle(joint, "theta")
    if not joint.has("shift_m"):  # the angles of a copied placement are snapped already
        alpha = angles.snapped(alpha)
        # The offset of a revolute joint only defines its zero and may be any angle.
        theta = theta if kind == "revolute" else angles.snapped(theta)
    return alpha, along_x, theta, along_z


def _mounts(
    joints: Sequence[Table], angles: RightAngles, convention: str, coupled: bool
) -> tuple[Mount, ...]:
    """Return the mount of each joint; nothing for a chain.

    A coupled joint, one of the last, may be an antecedent too.
    """
    mounts_read = []
    for number, joint in enumerate(joints, start=1):
        keys = ("antecedent", "gamma_deg", "gamma_rad", "b_m", "shift_m")
        given = [key for key in keys if joint.has(key)] if convention == "dh" else []
        if given:
            joint.fail(
                f"{given[0]} is for modified rows, and this table is a standard one (convention = 'dh')"
            )
        antecedent = joint.integer("antecedent", number - 1)
        if antecedent > len(joints) or antecedent == number or (antecedent > number and not coupled):
            joint.fail(f"antecedent must be a joint before this one, 0 for the base, got {antecedent}")
        b = joint.number("b_m")
        x, y, z = joint.numbers("shift_m", 3)
        _check_lengths(joint, b_m=b, shift_m=max(x, y, z, key=abs))
        gamma = _angle(joint, "gamma")
        if not joint.has("shift_m"):
            gamma = angles.snapped(gamma)
        mounts_read.append(
            Mount(parent=antecedent - 1 if antecedent else None, gamma=gamma, b=b, shift=(x, y, z))
        )
    mounts = tuple(mounts_read)
    return () if mounts == chain(len(joints)) else mounts


def _check_lengths(joint: Table, **lengths: float) -> None:
    """Refuse lengths whose powers would overflow; no robot is so large."""
    for key, length in lengths.items():
        if abs(length) > LARGEST:
            joint.fail(f"{key} must be at most {LARGEST:g} in size, got {length:g}")


def _joint_names(table: Table, joints: Sequence[Table]) -> tuple[str, ...]:
    """Names of the joints; either all joints have one, or none."""
    names = [joint.text("name", None) for joint in joints]
    given = [name for name in names if name is not None]
    if not given:
        return ()
    if len(given) < len(names):
        joints[names.index(None)].fail("a joint has no name although others have; name all joints or none")
    twice = next((name for name in given if given.count(name) > 1), None)
    if twice is not None or "" in given:
        table.fail(
            f"two joints have the name {twice!r}" if twice else "the name of a joint must not be empty"
        )
    return tuple(given)


def _angle(joint: Table, name: str) -> float:
    degrees, radians = f"{name}_deg", f"{name}_rad"
    if joint.has(degrees) and joint.has(radians):
        joint.fail(f"give {radians} or {degrees}, not both")
    if joint.has(degrees):
        return math.radians(joint.number(degrees))
    return joint.number(radians)


def _limits(joint: Table, kind: str) -> JointLimits:
    table = joint.part("limits")
    position_key, velocity_key, effort_key = LIMIT_KEYS[kind]
    position = table.numbers(position_key, length=2, default=None)
    velocity, effort = table.number(velocity_key, None), table.number(effort_key, None)
    table.done()
    if position is not None and position[0] >= position[1]:
        table.fail(f"the lowest position must be below the highest, got {series(map(str, position))}")
    return JointLimits(
        position=None if position is None else (position[0], position[1]), velocity=velocity, effort=effort
    )


def _drives(
    joints: Sequence[Table], kinds: Sequence[str]
) -> tuple[tuple[Actuator | None, ...], tuple[tuple[float, float], ...]]:
    """Return actuators of driven joints and the softness of their friction; nothing where no joint has any."""
    actuators: list[Actuator | None] = []
    softness = []
    for joint, kind in zip(joints, kinds, strict=False):
        table = joint.part("actuator")
        kp, kv, effort = (table.number(key, None) for key in ("kp", "kv", LIMIT_KEYS[kind][2]))
        actuator = Actuator(kp=kp, kv=kv, effort=effort, lag_s=table.number("lag_s"))
        table.done()
        actuators.append(actuator if joint.has("actuator") else None)
        creep, rest = joint.numbers("softness_s", length=2, default=SOFTNESS)
        if not (creep > 0.0 and rest > 0.0):
            joint.fail(f"softness_s must be two positive times, got {[creep, rest]}")
        softness.append((creep, rest))
    soft = any(joint.has("softness_s") for joint in joints)
    return tuple(actuators) if any(actuators) else (), tuple(softness) if soft else ()


def _parameter_sets(
    table: Table, standard: StandardTable | None
) -> tuple[dict[str, dict[str, float]], frozenset[str]]:
    """Return the parameter sets by name, and the names of those in the frames of the robot's own table."""
    values: dict[str, dict[str, float]] = {}
    own = set()
    for key in table.content:
        part = table.table(key)
        if part.text("frames") == "own":
            if standard is None:
                part.fail(
                    "frames = 'own' is for a robot with convention = 'dh', whose table has frames of its own"
                )
            own.add(key)
        values[key] = {name: part.number(name) for name in part.content if name != "frames"}
    return values, frozenset(own)
