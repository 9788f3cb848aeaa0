"""Logs of Rhoban's program BAM: a servo swings a pendulum, a JSON file a log, raw or processed to even time stamps.

Rows begin where the servo is switched on and end where it is switched off, as in BAM's ``lift_and_drop``. Tested in
``tests/test_bam.py``.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .array_file import ArrayFile

SIGNALS = ("timestamp", "position", "goal_position")
"""Values of an entry that are read (s, rad, rad)."""


@dataclass(frozen=True)
class Pendulum:
    """Gain and load of a log.

    Attributes
    ----------
    kp : float
        Gain of the servo in its own unit.
    mass_kg, length_m, arm_mass_kg : float
        Point mass at the end of an arm, length of the arm, and its mass, that of a thin rod.
    """

    kp: float
    mass_kg: float
    length_m: float
    arm_mass_kg: float

    @property
    def body(self) -> tuple[float, float, float]:
        """Mass of arm and load (kg), distance of their centre from the axis (m), and moment of inertia about it (kg.m^2)."""
        mass = self.mass_kg + self.arm_mass_kg
        first = (self.mass_kg + self.arm_mass_kg / 2.0) * self.length_m
        second = (self.mass_kg + self.arm_mass_kg / 3.0) * self.length_m**2
        return mass, first / mass, second - first**2 / mass


class BamFile(ArrayFile):
    """Time stamps, positions and commands of a log by BAM, and its `pendulum`."""

    kind = "BAM"

    def variables(self) -> list[str]:
        """Return the names of the signals.

        Raises
        ------
        RecordingError
            For a log whose servo is never on, or whose gain and load are not positive numbers.
        """
        content = json.loads(self.raw)
        numbers = [float(content.get(key, 0.0)) for key in ("kp", "mass", "length", "arm_mass")]
        self.pendulum = Pendulum(*numbers)
        if not all(math.isfinite(value) and value >= 0.0 for value in numbers) or 0.0 in numbers[:3]:
            self.fail("kp, mass and length of a log by BAM must be above 0, and its arm_mass not below")
        on = [bool(entry.get("torque_enable", True)) for entry in content["entries"]]
        if True not in on:
            self.fail("the servo is off in the whole log; leave it out")
        begin = on.index(True)
        end = on.index(False, begin) if False in on[begin:] else len(on)
        rows = content["entries"][begin:end]
        self._signals = {name: np.array([float(entry[name]) for entry in rows]) for name in SIGNALS}
        return list(SIGNALS)

    def array(self, name: str) -> Any:
        """Signal of a name, (n_samples,)."""
        return self._signals[name]
