"""DIDIM without physical conditions, the one of the paper, for tests that pin what it does; and stubs."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from didim import DIDIM
from didim.robot.robot import JointLimits


def plain_didim(**settings: Any) -> DIDIM:
    """Return the settings of plain DIDIM."""
    return DIDIM(physical=False, **settings)


def stub(**facts: object) -> Any:
    """Facts in the place of a record that has more of them."""
    return SimpleNamespace(**facts)


def fake_robot(
    name: str = "arm",
    joint_kinds: Sequence[str] = ("revolute", "revolute"),
    limits: Sequence[JointLimits] | None = None,
    **facts: object,
) -> Any:
    """What a recording needs of a robot: kinds, names and limits of its joints, and drive gains."""
    facts = {"joint_names": (), "gains": None, **facts}
    return stub(
        name=name, joint_kinds=joint_kinds, limits=limits or [JointLimits()] * len(joint_kinds), **facts
    )
