"""Record of CLOE with known links in the JSON of a result. Tested in ``tests/test_positions.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

KEY = "positions"
"""Key of this record in a result's settings."""


@dataclass(frozen=True)
class PositionRecord:
    """Further content of a result on positions.

    Attributes
    ----------
    rows : sequence of mapping
        One per unknown: "name", "kind", "joints" (from 1), "recording", "unit", "value", "std", "low", "high", "before", "bounds",
        "runs" (standard deviation from log to log, zero for one log), "by"
        ("log", "bound", "prior" or, for parameters that the log does not identify, "held") and "text", the knowledge about a
        held one.
    drive : mapping
        Parameters of the simulated servos, one per joint: "kp", "kv", "saturation" (None without), "delay_s", "lag_s",
        "bias_rad", and "acceleration" if it was unknown.
    errors : mapping
        Root mean square position errors (rad or m), one per joint: "before", "after", and "held_out" or None.
    limbs : sequence of mapping
        "name", "joints" (from 1), and "roles", names of the joints within the limb.
    weak : sequence of str
        Unknowns that are better known in combination than separately.
    siblings : sequence of str
        Joints that differ from the corresponding joints of other limbs.
    smoothing : sequence of float
        Velocity of the tanh of the friction of each joint (rad/s or m/s).
    soft : bool
        Whether friction is MuJoCo's soft constraint in the place of the tanh.
    sticks : bool
        Whether that tanh is so steep that joints at rest stay where they are.
    pushed : sequence of sequence of int
        Joint, recording, first and last sample (from 0) of stretches without which the last search ran.
    blocks, kind : int, str
        Number and kind (rollouts or stretches) of the blocks for the intervals.
    """

    rows: Sequence[Mapping[str, Any]]
    drive: Mapping[str, Sequence[float | None]]
    errors: Mapping[str, Sequence[float] | None]
    limbs: Sequence[Mapping[str, Any]]
    weak: Sequence[str]
    siblings: Sequence[str]
    smoothing: Sequence[float]
    blocks: int
    kind: str
    soft: bool = False
    sticks: bool = False
    pushed: Sequence[Sequence[int]] = ()

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> PositionRecord | None:
        """Return the record of a result's settings, or None for a result of another kind."""
        record = settings.get(KEY)
        return None if record is None else cls(**record)
