"""The chain of a tree that a log belongs to: the one whose joints it names. Tested in ``tests/test_init_files.py``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from .description import read_description
from .mechanism import MOVING


def chain_of_names(path: Path, names: Sequence[str]) -> tuple[str, list[str]] | None:
    """Return last link and locked joints of the chain whose joints are named.

    Parameters
    ----------
    path : Path
        URDF.
    names : sequence of str
        Names in a log; they may contain the name of a joint: ``arm_1_joint_position``.

    Returns
    -------
    (str, list of str) or None
        Link behind the last named joint, and moving joints before it that are not named; None if no joint is named, or if the
        named joints do not lie on one chain.

    Raises
    ------
    RobotError
        When the file cannot be read.
    """
    description = read_description(path.read_bytes(), path.name)
    joints = {joint.name: joint for joint in description.joints.values() if joint.kind in MOVING}
    named = {joint_name for name in names if (joint_name := _longest(name, list(joints)))}
    best: list[tuple[str, list[str]]] = []
    for name in named:
        path_there = description.path(description.root, joints[name].child) or []
        moving = [joint.name for joint in path_there if joint.moves]
        if named <= set(moving):
            best.append((joints[name].child, [other for other in moving if other not in named]))
    return best[0] if len(best) == 1 else None


def _longest(name: str, joints: Sequence[str]) -> str | None:
    """Return the longest joint name in a text that is delimited by characters other than letters and digits."""
    there = [
        joint
        for joint in joints
        if re.search(rf"(?<![A-Za-z0-9]){re.escape(joint)}(?![A-Za-z0-9])", name, flags=re.IGNORECASE)
    ]
    return max(there, key=len, default=None)
