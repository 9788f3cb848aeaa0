"""The estimate of a payload, as a table and in the units of teach pendants. Tested in ``tests/test_payload.py``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..._tools.arrays import Array
from ..._tools.notebook import Printed
from ..._tools.pickling import Pickled
from ..._tools.saved import plain
from ...result.finding import Finding
from ...result.table import table_lines
from ...result.uncertainty import student_factor
from ...result.verdict import Verdict
from ...robot.payload import UNITS
from ...robot.rigid_body import INERTIAL

BODY = ("mass", "centre x", "centre y", "centre z", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""Names of a body's ten numbers; the inertia is about the centre of mass."""
BODY_UNITS = ("kg", "mm", "mm", "mm", *("kg.m^2",) * 6)
"""Units of `BODY` in tables."""
BODY_FACTORS = np.array([1.0, *(1e3,) * 3, *(1.0,) * 6])
"""Factors from SI to the units of teach pendants."""


SAVED = ("covariance", "degrees_of_freedom", "offsets", "relative_error", "fit_error", "remarks")
"""Fields that JSON has under their own name."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PayloadEstimate(Pickled, Printed):
    """A payload, in the frame of the flange.

    Attributes
    ----------
    name, robot, log : str
        Payload, robot and experiment.
    frame : str
        Frame of all coordinates, in words: ``link wrist_3_link``.
    names : tuple of str
        Names of the estimated parameters.
    ten : (10,) array
        Inertial parameters ``XX XY XZ YY YZ ZZ MX MY MZ M`` about the flange (SI); zero for unidentifiable ones.
    covariance : (10, 10) array
        Their covariance, from the noise of the log and from the robot.
    degrees_of_freedom : float
        Degrees of freedom of Student's distribution for the intervals.
    n_blocks : int
        Blocks of time that the jackknife left out; 0 for standard deviations by noise alone.
    relative_error : (n_dof,) array
        Error of the torques of each joint over the torques, 0.07 = 7 %.
    offsets : mapping of str to (float, float)
        Own offsets and friction of the log, less those of the robot, with standard deviations.
    fit_error : (n_dof,) array
        The same of the fit, on its log.
    body : (10,) array or None
        Mass (kg), centre (m) and inertia ``XX XY XZ YY YZ ZZ`` about the centre (kg.m^2) of the nearest body; None if the arm
        cannot identify all of it, if no load is seen, or if the verdict is wrong.
    body_std, body_low, body_high : (10,) arrays or None
        Standard deviations and 95 % intervals, from draws projected to bodies.
    half_distance : float
        Half the squared distance of the estimate from the nearest body (nats).
    remarks : tuple of str
        Sentences on the result.
    evidence : tuple of Finding
        Findings against the estimate, and notes: see `verdict`.
    """

    name: str
    robot: str
    log: str
    frame: str
    names: tuple[str, ...]
    ten: Array
    covariance: Array
    degrees_of_freedom: float
    n_blocks: int
    relative_error: Array
    fit_error: Array = field(default_factory=lambda: np.zeros(0))
    offsets: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    body: Array | None = None
    body_std: Array | None = None
    body_low: Array | None = None
    body_high: Array | None = None
    half_distance: float = float("nan")
    remarks: tuple[str, ...] = ()
    evidence: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Whether the log is one of the robot of the result, and its load a load: sound, doubtful or wrong, with the reasons."""
        notes = [Finding(code="remark", grade="note", facts={"text": text}) for text in self.remarks]
        return Verdict.of([*self.evidence, *notes])

    @property
    def std(self) -> Array:
        """Standard deviations of the ten parameters, (10,); zero for known ones."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def mass_kg(self) -> float:
        """Mass of the nearest body, or the estimate without one."""
        return float(self.ten[9] if self.body is None else self.body[0])

    def __str__(self) -> str:
        lines = [
            f"payload '{self.name}' of {self.log}, on robot {self.robot}, in coordinates of {self.frame}",
            "",
        ]
        if self.body is not None:
            lines += self._body_lines()
        lines += ["inertial parameters in these coordinates, as estimated", *self._ten_lines()]
        for name, (value, std) in self.offsets.items():
            lines.append(f"{name} less that of the robot: {value:.4g} +- {std:.2g}")
        rows = [("relative error, %", *(f"joint {joint + 1}" for joint in range(len(self.relative_error))))]
        for title, values in (("on this log", self.relative_error), ("of the fit", self.fit_error)):
            if len(values):
                rows.append((title, *(f"{100.0 * value:.3g}" for value in values)))
        lines += ["", *table_lines(rows)]
        lines.append(
            "sigma has the noise of the log"
            + (f" (jackknife, {self.n_blocks} blocks of time)" if self.n_blocks else "")
            + " and the covariance of the robot in it"
        )
        return "\n".join([*lines, "", str(self.verdict)])

    def _body_lines(self) -> list[str]:
        assert self.body is not None
        assert self.body_std is not None
        assert self.body_low is not None
        assert self.body_high is not None
        values = [BODY_FACTORS * part for part in (self.body, self.body_std, self.body_low, self.body_high)]
        table = _estimates("body", BODY, BODY_UNITS, values)
        mass, x, y, z = values[0][:4]
        return [
            *table,
            "",
            f"For a pendant with these coordinates: {mass:.3f} kg, centre {x:.0f}, {y:.0f}, {z:.0f} mm, inertia about it "
            + ", ".join(f"{value:.4f}" for value in self.body[[4, 7, 9, 5, 6, 8]])
            + " kg.m^2 (xx, yy, zz, xy, xz, yz)",
            "",
        ]

    def _ten_lines(self) -> list[str]:
        factor = student_factor(0.95, self.degrees_of_freedom)
        rows = [INERTIAL.index(name) for name in self.names]
        if "MX" not in self.names and self.std[6:9].any():
            rows = sorted({*rows, 6, 7, 8})
        value, std = self.ten[rows], self.std[rows]
        names = [INERTIAL[k] for k in rows]
        values = (value, std, value - factor * std, value + factor * std)
        return _estimates("name", names, [UNITS[name] for name in names], values)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers; NaN and infinity become None."""
        body = None
        if self.body is not None:
            parts = {
                "estimate": self.body,
                "std": self.body_std,
                "low": self.body_low,
                "high": self.body_high,
            }
            body = {
                key: {"mass_kg": values[0], "com_m": values[1:4], "inertia_kg_m2": values[4:]}
                for key, values in ((key, plain(part) or []) for key, part in parts.items())
            }
        return {
            "payload": self.name,
            "robot": self.robot,
            "log": self.log,
            "frame": self.frame,
            "estimated": list(self.names),
            "flange": dict(zip(INERTIAL, plain(self.ten), strict=True)),
            "flange_std": dict(zip(INERTIAL, plain(self.std), strict=True)),
            "body": body,
            **{key: plain(getattr(self, key)) for key in SAVED},
            "verdict": self.verdict.to_dict(),
        }


def _estimates(title: str, names: Sequence[str], units: Sequence[str], values: Sequence[Array]) -> list[str]:
    """Return the lines of a table of estimates, their sigmas and both ends of their intervals, (n,) each."""
    rows = [
        (name, unit, *(_text(value, row[1]) for value in row))
        for name, unit, row in zip(names, units, np.transpose(values), strict=True)
    ]
    return table_lines([(title, "unit", "estimate", "sigma", "95 % low", "95 % high"), *rows], 2)


def _text(value: float, std: float) -> str:
    """Return a number with two digits of its standard deviation; four decimals without one."""
    if not (math.isfinite(std) and std > 0.0):
        return f"{value:.4f}"
    return f"{value:.{min(6, max(0, 1 - math.floor(math.log10(std))))}f}"
