"""What CLOE with known links says beside its parameters, as the JSON of a result has it. Tested in ``tests/test_positions.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

KEY = "positions"
"""Key of this record in a result's settings."""


@dataclass(frozen=True)
class PositionRecord:
    """What a result on positions says beside its parameters.

    Attributes
    ----------
    rows : sequence of mapping
        One per unknown: "name", "kind", "joints" (from 1), "recording", "unit", "value", "std", "low", "high", "before", "by"
        ("log", "bound", "prior" or "held", for what this log does not tell) and "text", what is known in place of a held one.
    drive : mapping
        Numbers of the servos that were simulated, one per joint: "kp", "kv", "saturation" (None without), "delay_s", "lag_s",
        "bias_rad".
    errors : mapping
        Root mean square position errors (rad or m), one per joint: "before", "after", and "held_out" or None.
    limbs : sequence of mapping
        "name", "joints" (from 1), and "roles", names of the joints within the limb.
    weak : sequence of str
        Unknowns that are known better together than each.
    siblings : sequence of str
        Joints that differ from those of the same place in other limbs.
    smoothing : sequence of float
        Velocity of the tanh of the friction of each joint (rad/s or m/s).
    blocks, kind : int, str
        Rollouts or stretches that the intervals were made of.
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

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> PositionRecord | None:
        """Return the record of a result's settings, or None for a result of another kind."""
        found = settings.get(KEY)
        return None if found is None else cls(**found)
