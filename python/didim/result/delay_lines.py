"""Printed lines on the torque delay of a result. Tested in ``tests/test_identification.py``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .._tools.words import series


def delay_lines(delay: Mapping[str, Any], *, measured: bool) -> list[str]:
    """Return the lines on the delay; `measured` for a fit along measured motion, for which a hold is compensated."""
    lines = []
    compensated = delay.get("compensated_samples", 0.0)
    shown = (
        series((f"{value:g}" for value in compensated), 60)
        if isinstance(compensated, list)
        else f"{compensated:g}"
    )
    if "estimated_samples" in delay:
        value, std = delay["estimated_samples"], delay.get("estimated_std_samples")
        error = "" if std is None else f" +- {std:.2g}"
        if isinstance(compensated, list):
            lines.append(f"torque recorded {shown} samples after the motion, joint by joint, by estimate")
        elif value == 0.0:
            lines.append(f"no delay of the torque is significant: 0{error} samples, by estimate")
        else:
            milliseconds = 1e3 * delay["estimated_seconds"]
            lines.append(
                f"torque recorded {value:+.2f}{error} samples ({milliseconds:+.3f} ms) after the motion, by estimate"
            )
    if compensated:
        lines.append(f"torque moved back by {shown} samples")
    if measured and delay.get("hold_s"):
        lines.append(
            f"hold of the digital controller, {1e3 * delay['hold_s']:g} ms: the torque is compared half of it later"
        )
    return lines
