"""Robots from URDF files: chain or tree, right angles, frames, inertias, limits, and the proof that the dynamics are the same.

A chain gets modified rows along common normals. The placements of a tree, and of nearly parallel axes, are copied.
Tested in ``tests/test_urdf.py`` against Pinocchio, on real descriptions and on random chains.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import didim._core as _core

from ..._tools.arrays import Array
from ..._tools.inputs import read_small_file
from ..._tools.words import series
from ...errors import RobotError
from ..correspondence import Correspondence, LinkPlace, rows_of
from ..friction import Friction, FrictionTerm
from ..placement import in_line
from ..right_angles import NEARLY_PARALLEL, SNAP, SUSPICIOUS
from ..rigid_body import INERTIAL, body_pseudo_inertia, ten_parameters, why_no_body
from ..robot import Geometry, Robot
from ..transmission import SOFTNESS, Follower
from .chain import WHOLE, Chain, Member, choose_chain
from .common_normals import MdhTable, as_they_are, common_normals
from .description import read_description
from .mechanism import MOVING, Description
from .mjcf import read_mjcf
from .snap import NearlyRight, Snapped, snap_chain
from .summation import made_up_bodies, random_states, torques_by_summation
from .tendons import Shares, drive_parameters, shares_of
from .xml_spans import parse_xml

URDF_SET = "urdf"
"""Name of the parameter set with the inertias of a URDF."""

MJCF_SET = "mjcf"
"""Name of the parameter set with the inertias of an MJCF."""

FILE_SETS = (URDF_SET, MJCF_SET)
"""Names of the parameter sets of robot descriptions, of which a robot has one at most."""


LARGEST_DIFFERENCE = 1e-6
"""Largest difference of the self-test, as a share of the largest torque, beyond which a description is refused."""


def file_set(robot: Robot) -> str | None:
    """Return the name of a robot's parameter set with the inertias of its description, if it has one."""
    return next((name for name in FILE_SETS if name in robot.sets), None)


@dataclass(frozen=True, eq=False)
class UrdfReading:
    """A robot read from a URDF, with the results of its self-test.

    Attributes
    ----------
    robot : Robot
        The robot, with the correspondence to the URDF.
    table : MdhTable
        Its frames.
    exact : float
        Self-test: largest difference to direct summation over the links with the same angles, over the largest torque of the joint.
    as_written : float
        The same with the angles as the file has them: the effect of snapping.
    made_up : bool
        Whether the self-test used made-up inertias, because the file has none.
    suspicion : str or None
        Sentence on nearly right angles that were not snapped.
    """

    robot: Robot
    table: MdhTable
    exact: float
    as_written: float
    made_up: bool
    suspicion: str | None


def read_urdf(
    path: Path,
    *,
    tip: str | None = None,
    base: str | None = None,
    lock: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    snap: float = SNAP,
    open: bool = False,
) -> UrdfReading:
    """Make a robot from a URDF or an MJCF.

    Parameters
    ----------
    path : Path
        The file.
    tip, base : str, optional
        Last and first link of the chain, see `load_robot`.
    lock : mapping of str to float, optional
        Joints to be locked, with their position (rad or m).
    gravity : sequence of 3 float, optional
        Acceleration of gravity in the base link (m/s^2); by default that of an MJCF, and for a URDF the z axis of the root link
        points up.
    snap : float
        Largest angle (rad) by which rounded right angles are snapped.
    open : bool
        Whether closed loops of an MJCF are cut on purpose, see `load_robot`.

    Raises
    ------
    RobotError
        When the file cannot be read, or does not describe a robot.
    """
    where = path.name
    if not 0.0 <= snap <= NEARLY_PARALLEL:
        raise RobotError(f"{where}: snap must be an angle between 0 and {NEARLY_PARALLEL} rad, got {snap!r}")
    data = read_small_file(path, RobotError)
    outermost = parse_xml(data, where)
    mjcf = outermost.tag == "mujoco"
    description = read_mjcf(outermost, path) if mjcf else read_description(data, where)
    set_name = MJCF_SET if mjcf else URDF_SET
    chain = choose_chain(description, base=base, tip=tip, lock=lock)
    down = _gravity(gravity, description, chain)
    size = float(np.linalg.norm(down))
    snapped = snap_chain(chain.origins, chain.axes, down / size if size else down, snap, chain.parents)
    suspicion = _nearly_right(chain, snapped.left, where)
    notes = [*description.notes, *_locked(chain, description, lock or {})]
    made_up = not any(member.pseudo.any() for group in chain.groups for member in group)
    links = made_up_bodies(len(chain.joints)) if made_up else chain.groups
    table, exact, as_written = _table(chain, snapped, links, down, where)
    geometry = _geometry(chain, table, down)
    notes += _changed(chain, snapped, as_written)
    if chain.mimics:
        table, chain = _numbered(table, chain), chain.numbered()
        geometry = _geometry(chain, table, down, _followers(chain))
    shares = shares_of(chain, description.tendons)
    geometry = replace(geometry, coupling=tuple(map(tuple, shares.coupling.tolist())))
    softness = tuple(joint.softness for joint in chain.driven)
    terms = (FrictionTerm(law="spring", joint=joint) for joint in sorted(shares.springs))
    cut = () if open else tuple(_cut(description, chain, lock or {}))
    notes += _left_out(description, chain, shares, lock or {})
    notes += _weights(description, chain, gravity is None)
    named, missing = _parameters(chain, table, set_name, shares, description.incomplete)
    robot = Robot(
        name=description.name or path.stem,
        description=f"from {where}",
        path=path,
        digest=hashlib.sha256(data).hexdigest(),
        geometry=geometry,
        friction=Friction.plain(len(chain.driven), terms),
        limits=tuple(shares.limits),
        reduction=None,
        gains=None,
        joint_names=tuple(joint.name for joint in chain.driven),
        correspondence=_correspondence(where, data, chain, snapped, table),
        notes=(*notes, *missing),
        actuators=tuple(shares.actuators) if any(shares.actuators) else (),
        softness=softness if set(softness) != {SOFTNESS} else (),
        cut=cut,
        _named={set_name: named} if named else {},
    )
    robot.core  # noqa: B018 - a wrong description must fail on loading
    return UrdfReading(robot, table, exact, as_written, made_up, suspicion)


def _table(
    chain: Chain, snapped: Snapped, links: Sequence[Sequence[Member]], down: Array, where: str
) -> tuple[MdhTable, float, float]:
    """Return the frames of a chain, and the differences of its torques exactly and as written in the file."""
    as_given = as_they_are(snapped.origins, snapped.axes, chain.parents)
    straight = (
        chain.parents == in_line(len(chain.joints))
        and not chain.mimics
        and not any(nearly.parallel and nearly.joint for nearly in snapped.left)
    )
    # Common normals lose digits where axes are far apart; the placements are then copied.
    for table in (common_normals(snapped.origins, snapped.axes), as_given) if straight else (as_given,):
        exact, as_written = _self_test(_geometry(chain, table, down), chain, snapped, table, links, down)
        if exact <= LARGEST_DIFFERENCE:
            return table, exact, as_written
    raise RobotError(
        f"{where}: the frames of this chain lose too many digits (torques differ by {exact:.1e} of the largest)"
    )


def _gravity(gravity: Sequence[float] | None, description: Description, chain: Chain) -> Array:
    """Gravity in the base link."""
    where = description.where
    if gravity is None:
        return own_gravity(description, chain)
    down = np.array(gravity, dtype=np.float64)
    if down.shape != (3,) or not np.isfinite(down).all():
        raise RobotError(
            f"{where}: gravity must be three finite numbers (m/s^2, base link), got {list(gravity)!r}"
        )
    return down


def own_gravity(description: Description, chain: Chain) -> Array:
    """Gravity of a file (3,) in the base link (m/s^2): weights that are compensated alike are those of a smaller one."""
    own = _compensated(description, chain)
    share = 1.0 - own[0] if len(own) == 1 else 1.0
    return np.asarray(chain.base_pose[:3, :3].T @ (share * np.array(description.gravity)))


def _compensated(description: Description, chain: Chain) -> list[float]:
    """Return the different shares of their weights that a file takes off the links of a chain."""
    moving = [member for group in chain.groups for member in group if member.pseudo[3, 3]]
    return sorted({description.gravcomp.get(member.link, 0.0) for member in moving})


def _weights(description: Description, chain: Chain, by_file: bool) -> Iterator[str]:
    """Return a sentence on weights that the file compensates."""
    if any(own := _compensated(description, chain)):
        weights = "the file compensates weights (gravcomp)"
        if by_file and len(own) == 1:
            yield f"{weights}, so gravity is {1.0 - own[0]:g} of its own (--gravity X Y Z has another)"
        else:
            yield f"{weights}, and the robot has them: {series(description.gravcomp, 60)}"


def _locked(chain: Chain, description: Description, asked: Mapping[str, float]) -> list[str]:
    """Return sentences on joints that were locked without a request."""
    free = [name for name in chain.locked if name not in asked]
    joints = {joint.name: joint for joint in description.joints.values()}
    held = [f"{name} ({joints[name].kind})" for name in free if joints[name].kind not in MOVING]
    free = [name for name in free if joints[name].kind in MOVING]
    notes = []
    if held:
        notes.append(
            f"held at the pose of the file, because joints of this type are not supported: {series(held)}"
        )
    stand = [
        name
        for name in free
        if (leader := joints[name].mimic) is not None and (chain.tip == WHOLE or leader not in joints)
    ]
    if stand:
        names = [f"{name} (of {joints[name].mimic})" for name in stand]
        notes.append(f"fixed, because they follow joints that are locked or do not exist: {series(names)}")
    free = [name for name in free if name not in stand]
    if free:
        notes.append(
            f"the chain ends at link {chain.tip}; locked at 0: {series(free, 60)} (--tip LINK takes more of the tree, "
            "--lock JOINT=VALUE locks elsewhere)"
        )
    return notes


def _nearly_right(chain: Chain, left: Sequence[NearlyRight], where: str) -> str | None:
    """Sentence on angles that are nearly right."""
    if not left:
        return None
    names = [joint.name for joint in chain.joints]
    largest = max(nearly.angle for nearly in left)
    which = series((names[nearly.joint] for nearly in left), 36)
    what = f"{which} are up to {largest:.1e} rad from right angles"
    for nearly in reversed(left):
        parent = chain.parents[nearly.joint]
        if nearly.parallel and parent is not None:
            what = f"{names[parent]} and {names[nearly.joint]} are {nearly.angle:.1e} rad from parallel"
    cure = SUSPICIOUS if largest <= SUSPICIOUS else NEARLY_PARALLEL
    return f"{where}: the axes of {what}, adding weak base parameters; write --snap {cure:g}"


def _geometry(chain: Chain, table: MdhTable, down: Array, followers: tuple[Follower, ...] = ()) -> Geometry:
    alpha, d, theta, r = zip(*table.rows, strict=True)
    gravity = table.frame_0[:3, :3].T @ down
    # Gravity nearly along an axis is meant to be along it.
    gravity[np.abs(gravity) < 1e-12 * np.linalg.norm(gravity)] = 0.0
    return Geometry(
        kinds=tuple("prismatic" if joint.kind == "prismatic" else "revolute" for joint in chain.joints),
        alpha=alpha,
        d=d,
        theta=theta,
        r=r,
        gravity=tuple(float(value) for value in gravity),
        coupling=tuple(tuple(row) for row in np.eye(len(alpha) - len(followers)).tolist()),
        mounts=table.mounts,
        followers=followers,
    )


def _numbered(table: MdhTable, chain: Chain) -> MdhTable:
    """Return the rows of a chain in the order of the numbers of its joints."""
    order, parents = chain.order, chain.numbered().parents
    mounts = tuple(replace(table.mounts[k], parent=parent) for k, parent in zip(order, parents, strict=True))
    return replace(
        table,
        rows=tuple(table.rows[k] for k in order),
        link_poses=tuple(table.link_poses[k] for k in order),
        mounts=mounts,
    )


def _followers(chain: Chain) -> tuple[Follower, ...]:
    numbers = {joint.name: number for number, joint in enumerate(chain.driven)}
    return tuple(
        Follower(leaders=((numbers[leader], factor),), offset=offset, name=name)
        for name in (joint.name for joint in chain.joints if joint.name in chain.mimics)
        for leader, factor, offset in (chain.mimics[name],)
    )


def _cut(description: Description, chain: Chain, lock: Mapping[str, float]) -> Iterator[str]:
    """Return the closed loops that the robot does not have: those between parts that move against each other."""
    carrier = {member.link: number for number, group in enumerate(chain.groups) for member in group}
    moving = {joint.name for joint in chain.joints} - set(lock)
    for loop in description.loops:
        ends = {carrier.get(link) for link in loop.links}
        if len(ends) > 1 or moving & set(loop.joints):
            yield loop.name


def _changed(chain: Chain, snapped: Snapped, as_written: float) -> Iterator[str]:
    """Return sentences on snapped angles and coupled joints."""
    if snapped.joints:
        rounded = series((chain.joints[joint].name for joint in snapped.joints), 60)
        yield (
            f"right angles of {rounded} were rounded and are snapped, by {snapped.largest:.1e} rad at most; "
            f"torques change by {as_written:.1e} of the largest"
        )
    if chain.mimics:
        names = series(f"{name} ({leader})" for name, (leader, _, _) in chain.mimics.items())
        yield f"joints that follow others, with their leaders: {names}"


def _left_out(
    description: Description, chain: Chain, shares: Shares, lock: Mapping[str, float]
) -> Iterator[str]:
    """Return sentences on what of an MJCF has no place in the robot."""
    if loops := list(_cut(description, chain, lock)):
        yield f"closed loops are cut, and what they hold moves freely: {series(loops, 60)}"
    if shares.left:
        yield f"forces and armatures of tendons are left out: {series(shares.left, 60)}"
    if shares.unread:
        yield (
            "actuators other than torques, position and velocity servos of one joint are left out: "
            f"{series(shares.unread, 70)}"
        )
    if shares.commands:
        yield f"commands that are not the position of a joint, or its speed: {series(shares.commands, 120)}"


def _parameters(
    chain: Chain, table: MdhTable, set_name: str, shares: Shares, incomplete: Collection[str]
) -> tuple[dict[str, float], list[str]]:
    """Return the standard parameters of the file by name, and sentences on missing ones."""
    if lost := [member.link for group in chain.groups for member in group if member.link in incomplete]:
        return {}, [
            f"mesh files are missing, so these bodies lack mass: {series(lost, 60)}; there is no parameter set {set_name!r}"
        ]
    pseudos = chain.pseudo_inertias
    names = [group[0].link for group in chain.groups]
    # The links between the joints of one body of an MJCF have no inertia, and need none.
    between = set_name == MJCF_SET and any(pseudo.any() for pseudo in pseudos)
    empty = [
        name
        for name, pseudo in zip(names, pseudos, strict=True)
        if not pseudo[3, 3] > 0.0 and (pseudo.any() or not between)
    ]
    if len(empty) == len(names):
        return {}, [f"no moving link has an inertia, so there is no parameter set {set_name!r}"]
    named: dict[str, float] = {}
    notes = [f"moving links without a positive mass: {series(empty)}"] if empty else []
    for j, (name, pseudo, pose) in enumerate(zip(names, pseudos, table.link_poses, strict=True)):
        ten = ten_parameters(pose @ pseudo @ pose.T)
        named.update({f"{key}{j + 1}": float(value) for key, value in zip(INERTIAL, ten, strict=True)})
        reason = why_no_body(pseudo) if pseudo.any() else None
        if reason is not None:
            notes.append(f"link {name} of the file is not a body: {reason}")
    own = [[joint.armature, joint.damping, joint.friction] for joint in chain.joints]
    named |= drive_parameters(shares, np.array(own).T)
    for j, (stiffness, torque) in shares.springs.items():
        named |= {f"Ks{j + 1}": stiffness, f"Off{j + 1}": torque}
    return named, notes


def _correspondence(
    where: str, data: bytes, chain: Chain, snapped: Snapped, table: MdhTable
) -> Correspondence:
    return Correspondence(
        file=where,
        sha256=hashlib.sha256(data).hexdigest(),
        base=chain.base,
        tip=chain.tip,
        frame_0=rows_of(table.frame_0),
        links=tuple(
            LinkPlace(
                joint=joint.name,
                link=group[0].link,
                pose=rows_of(pose),
                lumped=tuple(member.link for member in group[1:] if not member.locked),
                locked=tuple(member.link for member in group[1:] if member.locked),
                lumped_poses=tuple(rows_of(member.pose) for member in group[1:] if not member.locked),
            )
            for joint, group, pose in zip(chain.joints, chain.groups, table.link_poses, strict=True)
        ),
        lock=tuple(chain.locked.items()),
        snapped_rad=snapped.largest,
    )


def _self_test(
    geometry: Geometry,
    chain: Chain,
    snapped: Snapped,
    table: MdhTable,
    links: Sequence[Sequence[Member]],
    down: Array,
) -> tuple[float, float]:
    """Largest difference to direct summation, with the angles snapped and as written, over each joint's largest torque."""
    n = len(geometry.kinds)
    states = random_states(n)
    x = np.zeros(14 * n)
    for j, (group, pose) in enumerate(zip(links, table.link_poses, strict=True)):
        for member in group:
            if (inertial := member.inertial) is None:
                continue
            frame = pose @ member.pose @ inertial.frame
            pseudo = body_pseudo_inertia(inertial.mass, inertial.inertia, frame)
            x[14 * j : 14 * j + len(INERTIAL)] += ten_parameters(pseudo)
    tau = _core.inverse_dynamics(geometry.core(Friction.plain(n)), states.q, states.dq, states.ddq, x)
    differences = []
    for origins, axes in ((snapped.origins, snapped.axes), (chain.origins, chain.axes)):
        expected = torques_by_summation(geometry.kinds, origins, axes, links, down, states, chain.parents)
        # The torque of a joint without load is pure rounding.
        # Lower bound of a joint's largest torque in the self-test, as a share of that of all joints.
        largest = np.maximum(np.abs(expected).max(axis=0), 1e-6 * np.abs(expected).max())
        # A robot without any torque, such as a point mass on a vertical axis, has none to compare with.
        differences.append(
            float((np.abs(tau - expected).max(axis=0) / np.where(largest > 0.0, largest, 1.0)).max())
        )
    return differences[0], differences[1] if snapped.joints else differences[0]
