"""Sources of a robot: a URDF, into which it goes back, and the logs of its identified parameter sets.

Of the URDF: names of joints and links, and the constant poses of their frames. Tested in ``tests/test_urdf.py`` and
``tests/test_origin.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import counted

Pose = tuple[tuple[float, ...], ...]
"""First three rows of a homogeneous matrix."""
ROTATION_TOLERANCE = 1e-9
"""Largest entry of ``R R' - 1`` of a pose in a file: poses are written with all digits."""


@dataclass(frozen=True, kw_only=True)
class LinkPlace:
    """Links of the URDF that move with one joint of the robot.

    Attributes
    ----------
    joint, link : str
        Moving joint and its child link.
    pose : 3 x 4 tuple of float
        Frame of the link in frame j of the robot, the same for every position of the joints (m).
    lumped : tuple of str
        Other links that are fixed to it.
    locked : tuple of str
        Other links attached to it by locked joints.
    lumped_poses : tuple of 3 x 4 tuples of float
        Frames of the lumped links in that of the link (m); empty if the robot is not read from its URDF.
    """

    joint: str
    link: str
    pose: Pose
    lumped: tuple[str, ...] = ()
    locked: tuple[str, ...] = ()
    lumped_poses: tuple[Pose, ...] = field(default=(), compare=False)

    @property
    def matrix(self) -> Array:
        """The pose as a homogeneous matrix (4, 4)."""
        return homogeneous(self.pose)


@dataclass(frozen=True, kw_only=True)
class Correspondence:
    """The table ``[urdf]`` of a robot file.

    Attributes
    ----------
    file, sha256 : str
        Name and digest of the URDF.
    base, tip : str
        First and last link of the chain.
    frame_0 : 3 x 4 tuple of float
        Frame 0 of the robot in the base link (m).
    links : tuple of LinkPlace
        One per joint.
    lock : tuple of (str, float)
        Locked joints and their positions (rad or m).
    snapped_rad : float
        Largest angle that was snapped to a right one (rad); zero for none.
    """

    file: str
    sha256: str
    base: str
    tip: str
    frame_0: Pose
    links: tuple[LinkPlace, ...]
    lock: tuple[tuple[str, float], ...] = ()
    snapped_rad: float = 0.0

    @property
    def base_matrix(self) -> Array:
        """Frame 0 in the base link as a homogeneous matrix (4, 4)."""
        return homogeneous(self.frame_0)


def rows_of(matrix: Array) -> Pose:
    """Return the first three rows of a homogeneous matrix as numbers."""
    return tuple(tuple(float(value) for value in row) for row in matrix[:3])


def homogeneous(rows: Pose) -> Array:
    """Return the homogeneous matrix (4, 4) of three rows."""
    return np.vstack([np.array(rows), [0.0, 0.0, 0.0, 1.0]])


def read_correspondence(table: Table, n_dof: int) -> Correspondence:
    """Read the table ``[urdf]`` of a robot file.

    Raises
    ------
    DidimError
        Of the table's class, for a missing or wrong key.
    """
    entries = table.tables("link")
    if len(entries) != n_dof:
        table.fail(f"a robot of {counted(n_dof, 'joint')} needs as many [[urdf.link]], got {len(entries)}")
    lock = table.table("lock", None)
    links = []
    for entry in entries:
        links.append(
            LinkPlace(
                joint=entry.text("joint"),
                link=entry.text("link"),
                pose=_read_pose(entry, "pose"),
                lumped=tuple(entry.texts("lumped")),
                locked=tuple(entry.texts("locked")),
            )
        )
        entry.done()
    correspondence = Correspondence(
        **{key: table.text(key) for key in ("file", "sha256", "base", "tip")},
        frame_0=_read_pose(table, "frame_0"),
        links=tuple(links),
        lock=() if lock is None else tuple((name, lock.number(name)) for name in lock.content),
        snapped_rad=table.number("snapped_rad"),
    )
    table.done()
    return correspondence


def _read_pose(table: Table, key: str) -> Pose:
    rows = table.matrix(key, 3, 4)
    rotation = np.array(rows)[:, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        table.fail(f"{key} must be the pose of a frame: its first three columns are not a rotation")
    return tuple(tuple(row) for row in rows)


@dataclass(frozen=True)
class Origin:
    """Log, fit and verdict of a parameter set that was identified from a public log.

    Attributes
    ----------
    data : str
        Publication of the log.
    licence : str
        Its licence.
    file, sha256 : str
        File of the log, and its digest.
    commands : tuple of str
        Commands that repeat the fit, in a folder with the log.
    verdict : str
        "sound" or "doubtful": how the fit ended.
    missed_percent : float
        Torques that the model misses, rms, on blocks of the log left out, as a share of the measured ones (%); of a fit on
        positions, those of its servos on all of the log.
    """

    data: str
    licence: str
    file: str
    sha256: str
    commands: tuple[str, ...]
    verdict: str
    missed_percent: float

    def __str__(self) -> str:
        commands = "\n".join(f"  {command}" for command in self.commands)
        return (
            f"identified from {self.data} ({self.licence}): {self.verdict}, {self.missed_percent:.3g} % of the torques missed\n"
            f"{commands}"
        )


def read_origins(table: Table) -> dict[str, Origin]:
    """Return the origins of parameter sets by name, from the table ``[identified]`` of a robot file.

    Raises
    ------
    DidimError
        Of the table's class, for a key that is missing, unknown or wrong.
    """
    origins = {}
    for name in table.content:
        part = table.table(name)
        origins[name] = Origin(
            **{key: part.text(key) for key in ("data", "licence", "file", "sha256", "verdict")},
            commands=tuple(part.texts("commands")),
            missed_percent=part.number("missed_percent"),
        )
        part.done()
    table.done()
    return origins
