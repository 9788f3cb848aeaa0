"""The result of a design: the motion, the expected standard deviations, and its use of each limit.

Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array, relative_percent
from .._tools.notebook import Printed
from .._tools.pickling import Pickled
from .._tools.words import series
from ..loop.reference import Reference
from ..robot.robot import Robot
from .criterion import scaled_inverse
from .limits import MotionLimits
from .ramps import Ramp, whole_motion
from .settings import ExcitationSettings

INFLATED = 3.0
"""Ratio of a parameter's standard deviation to its value with all other parameters known, from which correlation is named as
the reason why it is weak."""
WEAK_PERCENT = 10.0
"""Relative standard deviation (%) from which a parameter is listed as weak."""
CORRELATED_ESTIMATES = 0.9
"""Absolute correlation of two estimates from which one is named as the reason why the other is weak."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Excitation(Pickled, Printed):
    """A designed motion. Made by `excite`.

    Tested in ``tests/test_excitation.py``.

    Attributes
    ----------
    robot : Robot
        Robot with the friction model of the design.
    settings : ExcitationSettings
        Settings of the design.
    reference : Reference
        The motion without its ramps, for `simulate` and experiments.
    tables : mapping
        Entries of its table ``[reference]``.
    ramps : (Ramp or None, Ramp or None)
        Ramps from home and back.
    limits : MotionLimits
        Limits, margins taken off.
    x : (n_parameters,) array or None
        Parameters for torques and relative deviations.
    names, units : tuple of str
        Names and units of the base parameters.
    information : (n_base, n_base) array
        Information of the motion and of earlier logs.
    random_information : (n_base, n_base) array
        The same for the random motion that the design is compared with, scaled to the same limits.
    condition_number, random_condition_number : float
        Condition number of W along the motion, and along the random one.
    log_det : float
        Log determinant of the information of the motion.
    starts : tuple of float
        Value of the criterion reached by each start.
    use : mapping of str to (n_dof,) arrays
        Largest share of each of the user's limits, by kind, on a grid 20 times finer than the optimiser's: at most `margin` of
        the settings.
    nearest : (str, float) or None
        Nearest pair, and its distance beyond the clearance (m).
    remarks : tuple of str
        Sentences on assumptions.
    interrupted : bool
        Whether the user stopped the search.
    elapsed : float
        Seconds.
    """

    robot: Robot
    settings: ExcitationSettings
    reference: Reference
    tables: Mapping[str, object]
    ramps: tuple[Ramp | None, Ramp | None]
    limits: MotionLimits
    x: Array | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    information: Array
    random_information: Array
    condition_number: float
    random_condition_number: float
    log_det: float
    random_log_det: float
    starts: tuple[float, ...]
    use: Mapping[str, Array]
    nearest: tuple[str, float] | None
    remarks: tuple[str, ...]
    interrupted: bool
    elapsed: float

    @property
    def std(self) -> Array:
        """Expected standard deviations of the base parameters, ``(n_base,)``."""
        return standard_deviations(self.information)

    @property
    def random_std(self) -> Array:
        """Expected standard deviations with the random motion, ``(n_base,)``."""
        return standard_deviations(self.random_information)

    @property
    def ratio(self) -> float:
        """Geometric mean of the standard deviations over those of the random motion."""
        return float(np.exp(np.mean(np.log(self.std / self.random_std))))

    @property
    def relative_std_percent(self) -> Array | None:
        """Standard deviations relative to the parameters (%); None without parameters."""
        if self.x is None:
            return None
        return relative_percent(self.std, self.robot.base_parameters.project(self.x))

    def sampled(self, rate_hz: float | None = None) -> tuple[Array, Array, Array, Array]:
        """Return times (s), positions, velocities and accelerations, with ramps.

        The rate is that of the controller by default.
        """
        rate = self.settings.rate_hz if rate_hz is None else rate_hz
        return whole_motion(self.reference, *self.ramps, rate)

    def weak(self) -> tuple[str, ...]:
        """Return sentences on weak parameters and the reasons."""
        percent = self.relative_std_percent
        std = self.std
        correlation = _inverse(self.information) / np.outer(std, std)
        with np.errstate(divide="ignore"):  # infinite for a parameter without any effect along the motion
            alone = 1.0 / np.sqrt(np.diag(self.information))
        sentences: list[str] = []
        faint: list[str] = []
        tangled: list[str] = []
        for k, name in enumerate(self.names):
            inflated = std[k] > INFLATED * alone[k]
            if percent is None or np.isnan(percent[k]):
                # Without a nonzero value only an inseparable parameter is certainly weak.
                weak, words = std[k] > INFLATED**2 * alone[k] or np.isinf(alone[k]), name
            else:
                weak, words = not percent[k] <= WEAK_PERCENT, f"{name} ({percent[k]:.3g} %)"
            row = np.abs(correlation[k])
            row[k] = 0.0
            other = int(row.argmax())
            if weak and inflated and row[other] > CORRELATED_ESTIMATES:
                sentences.append(
                    f"weak: {words}; the motion hardly separates it from {self.names[other]} (correlation "
                    f"{correlation[k, other]:.2f})"
                )
            elif weak:
                (tangled if inflated else faint).append(words)
        if tangled:
            sentences.append(
                f"weak: {series(tangled)}; other parameters together have nearly the same effect"
            )
        if faint:
            sentences.append(f"weak: {series(faint)}; small beside the noise even if all others were known")
        return tuple(sentences)

    @property
    def gain(self) -> str:
        """Return the sentence on the gain by the design."""
        text = f"standard deviations are {self.ratio:.2f} of those of the random motion (geometric mean)"
        # Earlier logs add the same information to both motions, whose length does not replace it.
        return text if self.settings.prior else f"{text}, as after {1.0 / self.ratio**2:.1f} times its length"

    def __str__(self) -> str:
        lines = [
            f"{self.robot.name}: {self.reference.duration:g} s, {len(self.names)} base parameters, "
            f"log det of the information {self.log_det:.1f} (random motion {self.random_log_det:.1f})",
            self.gain,
            "",
            self._parameter_table(),
            "",
            self._use_table(),
        ]
        if self.nearest is not None:
            lines += ["", f"nearest: {self.nearest[0]}, with {1e3 * self.nearest[1]:.1f} mm to spare"]
        weak = self.weak()
        if weak:
            lines += ["", *weak]
        if self.remarks:
            lines += ["", *self.remarks]
        if self.interrupted:
            lines += ["", "interrupted: the best motion so far"]
        return "\n".join(lines)

    def _parameter_table(self) -> str:
        percent = self.relative_std_percent
        width = max(map(len, self.names))
        unit = max(map(len, self.units))
        head = f"{'':{width}}  {'unit':{unit}}  {'sigma':>10}  {'random':>10}  {'ratio':>6}"
        lines = [head + ("" if percent is None else f"  {'sigma %':>8}")]
        rows = zip(self.names, self.units, self.std, self.random_std, strict=True)
        for k, (name, name_unit, std, random) in enumerate(rows):
            line = f"{name:{width}}  {name_unit:{unit}}  {std:10.3g}  {random:10.3g}  {std / random:6.2f}"
            if percent is not None:
                line += f"  {percent[k]:8.3g}" if np.isfinite(percent[k]) else f"  {'-':>8}"
            lines.append(line)
        return "\n".join(lines)

    def _use_table(self) -> str:
        n = self.robot.n_dof
        lines = [f"{'use of limits %':17}" + "".join(f"{f'joint {j + 1}':>9}" for j in range(n))]
        for kind, values in self.use.items():
            lines.append(f"{kind:17}" + "".join(f"{100.0 * value:9.1f}" for value in values))
        if self.limits.margin < 1.0:
            lines.append(f"(the margin leaves {100.0 * self.limits.margin:g} % of each limit)")
        return "\n".join(lines)


def _inverse(matrix: Array) -> Array:
    scale = np.sqrt(np.diag(matrix))
    # A parameter without any effect has a row of zeros and an eigenvalue of zero in any unit. Eigenvalues that rounding made zero
    # or negative mean an infinite standard deviation.
    return scaled_inverse(matrix, np.where(scale > 0.0, scale, 1.0), float(np.finfo(float).eps))[0]


def standard_deviations(information: Array) -> Array:
    """Return the standard deviations of the base parameters for their information, ``(n_base,)``."""
    return np.asarray(np.sqrt(np.diag(_inverse(information))))
