"""Right angles, and the tolerance within which a rounded angle is taken for one.

A twist of 1.5708 rad instead of pi/2 creates base parameters that no log identifies: an arm like a UR has 59 instead of 58, and
the standard deviation of the additional one is huge. Tested in ``tests/test_urdf_snap.py``.
"""

from __future__ import annotations

import math

SNAP = 1e-4
"""Default of the largest deviation (rad) that is snapped to a right angle: files with four decimals deviate by up to 5e-5."""

SUSPICIOUS = 2e-3
"""Largest deviation (rad) at which a right angle was probably meant: 1.57 deviates by 8e-4, calibrated axes by up to 2e-3."""

NEARLY_PARALLEL = 0.02
"""Smallest angle (rad) between two axes by design; smaller ones come from calibration."""

PARALLEL = 1e-9
"""Angle (rad) below which axes count as parallel: its effect is below rounding."""


RIGHT_ANGLE_ROUNDING = 1e-12
"""Largest deviation (rad) from a right angle that the core treats as exact."""


def nearest_right_angle(angle: float) -> float:
    """Return the multiple of a right angle that is nearest to an angle (rad)."""
    return round(angle / (0.5 * math.pi)) * 0.5 * math.pi


def without_rounding(angle: float) -> float:
    """Return an angle (rad), or the right angle that it is but for rounding."""
    right = nearest_right_angle(angle)
    return right + 0.0 if abs(angle - right) <= RIGHT_ANGLE_ROUNDING else angle


class RightAngles:
    """Snaps the angles of a robot file, and records which.

    Parameters
    ----------
    tolerance : float, optional
        Largest angle (rad) that is snapped; by default that of the file, or `SNAP`.
    """

    def __init__(self, tolerance: float | None = None) -> None:
        self.tolerance = SNAP if tolerance is None else tolerance
        self.chosen = tolerance is not None
        self.largest = 0.0
        self.suspicious = 0.0

    def follow_file(self, tolerance: float | None) -> None:
        """Snap within the angle (rad) of a robot file, unless the caller has set another."""
        if tolerance is not None and not self.chosen:
            self.tolerance, self.chosen = tolerance, True

    def snapped(self, angle: float) -> float:
        """Return an angle (rad), or the right angle within the tolerance of it."""
        right = nearest_right_angle(angle)
        away = abs(angle - right)
        if away <= self.tolerance:
            # The core already treats such an angle as a right one.
            self.largest = max(self.largest, away if away > RIGHT_ANGLE_ROUNDING else 0.0)
            return right
        if away <= SUSPICIOUS:
            self.suspicious = max(self.suspicious, away)
        return angle

    def notes(self, where: str) -> list[str]:
        """Return a sentence on the snapped angles."""
        if not self.largest:
            return []
        return [f"{where}: rounded right angles were snapped, by {self.largest:.1e} rad at most"]

    def suspicion(self, where: str) -> str:
        """Return the sentence on nearly right angles that were not snapped."""
        return (
            f"{where}: angles are up to {self.suspicious:.1e} rad from right angles, which may add base parameters that no log "
            f"identifies; write all digits or degrees, or take snap={SUSPICIOUS:g}"
        )
