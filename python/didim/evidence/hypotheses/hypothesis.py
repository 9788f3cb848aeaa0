"""A hypothesis on why a log contradicts its model: another robot, other positions, or torques read otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..._tools.arrays import Array
from ...robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """What may be wrong; the fields that are left out are as declared.

    Attributes
    ----------
    code : str
        That of the finding which names it.
    joints : tuple of int
        Joints concerned, from 1.
    robot : Robot, optional
        Another robot.
    position : (n, n) array, optional
        A of the positions ``A q``.
    order : tuple of int, optional
        Joint, from 0, whose rows predict each torque channel.
    factors : (n,) array, optional
        Factor of the logged torques over those of the joints.
    value : float, optional
        The number of the remedy: a gain, a length (m).
    at_end : bool
        Whether the number is an end of its search, and so no estimate.
    facts : mapping
        What the sentence says beside these.
    """

    code: str
    joints: tuple[int, ...] = ()
    robot: Robot | None = None
    position: Array | None = None
    order: tuple[int, ...] | None = None
    factors: Array | None = None
    value: float | None = None
    at_end: bool = False
    facts: Mapping[str, object] = field(default_factory=dict)

    @property
    def needs_columns(self) -> bool:
        """Whether it changes the columns, and not only how torques are read."""
        return self.robot is not None or self.position is not None

    @property
    def turns(self) -> bool:
        """Whether it turns the sign of one joint's torque or position, which friction knows."""
        return self.code in ("torque-sign", "position-sign", "joint-sign")
