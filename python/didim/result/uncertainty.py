"""Source of a result's standard deviations, and confidence intervals. Tested in ``tests/test_uncertainty.py``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from .._tools.arrays import Array, quotient
from .._tools.pickling import Pickled, make_read_only
from .._tools.saved import UNBOUNDED, plain, restored
from .._tools.words import joints_text, series
from ..errors import FitError
from ..regression.friction.alarm import FrictionAlarm, FrictionAtSpeeds
from .sentences import MISSING
from .table import table_lines

Kind = Literal["jackknife", "decimated", "white", "correlated", "draws"]
"""Source of the standard deviations: the delete-block jackknife, (10) with the correlation of decimated noise, (10) itself, the
correlation of a closed-loop output-error method's errors, or draws of the estimate with its standard deviations, each projected
to the nearest robot."""


LAWS = {
    "stribeck": "Stribeck friction",
    "atan": "friction that bends with the speed (arctangent)",
    "load": "friction that grows with the load",
    "dahl": "friction with memory (Dahl)",
}
"""Names of the friction laws that a residual is tested for."""
CLEAR_POSITIONS = 1.0
"""Shift by noise and steps of the positions, in standard deviations without it, from which a printed result mentions it: these
are no longer the larger error."""


@dataclass(frozen=True)
class TimeBlock:
    """An interval of a recording whose rows, of all joints, form one block of the jackknife.

    Attributes
    ----------
    recording, window : int
        Number of the recording among those of the experiment, and of the window in it, from 0.
    start_s, stop_s : float
        Times in the rows of the window (s), from its first row.
    """

    recording: int
    window: int
    start_s: float
    stop_s: float

    def __str__(self) -> str:
        return f"{self.start_s:.3g} to {self.stop_s:.3g} s" + (
            f" of window {self.window + 1} of recording {self.recording + 1}"
            if self.recording or self.window
            else ""
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty(Pickled):
    """Source of the standard deviations of a result.

    Attributes
    ----------
    kind : {"jackknife", "decimated", "white", "correlated", "draws"}
        Source of the standard deviations.
    degrees_of_freedom : float
        Degrees of freedom of Student's distribution for the intervals: independent blocks less one, or rows less parameters; for
        draws those of the estimate.
    std_white : ndarray, shape (b,)
        Standard deviations (10), as if the errors of all rows were independent; zero for fixed and dropped parameters.
    joint_std : ndarray, shape (n_dof,)
        Standard deviation of the residual of each joint on the rows of the fit (N.m or N).
    blocks : tuple of TimeBlock
        Intervals that were left out, one at a time, for the deletions; empty for other kinds. Where their errors are correlated the
        standard deviations are from longer ones.
    deletions : ndarray, shape (m, b)
        Estimate without each block less the estimate.
    single_block : mapping of str to int
        Parameters determined by a single block, with its number from 0; their standard deviation is not from the jackknife.
    friction : FrictionAlarm or None
        Whether the residual contains friction that the model lacks; the intervals then hold with the bias that it makes.
        None if not tested.
    positions : ndarray, shape (b,)
        Change of each parameter, in its unit, by noise and steps of the measured positions, which the standard deviations of the
        jackknife include; empty if not tested, zero along simulated motion.
    noise : ndarray, shape (b,)
        Standard deviations by noise alone, without bias and errors of positions; empty if these were not tested.
    at_speeds : tuple of FrictionAtSpeeds
        Friction at speeds inside the log, at joints where the parameters of a law exchange, its velocity is unknown, or a law is
        missing.
    load : ndarray, shape (n_dof,)
        Median size of the torque of links and rotors in the log (N.m or N), for friction at other speeds; empty if not known.
    velocities : tuple of str
        Parameters of the friction laws with an estimated velocity.
    crossed : ndarray, shape (v, b + v)
        Covariance by noise of these velocities with the parameters and with each other.
    unseen : ndarray, shape (n_dof,)
        Of an estimate that a prior and constraints hold: error of ten blocks left out over that of the fit, by joint; else empty.
    """

    kind: Kind
    degrees_of_freedom: float = field(metadata=UNBOUNDED)
    std_white: Array
    joint_std: Array = field(default_factory=lambda: np.zeros(0))
    blocks: tuple[TimeBlock, ...] = ()
    deletions: Array = field(default_factory=lambda: np.zeros((0, 0)))
    single_block: Mapping[str, int] = field(default_factory=dict)
    friction: FrictionAlarm | None = None
    positions: Array = field(default_factory=lambda: np.zeros(0))
    noise: Array = field(default_factory=lambda: np.zeros(0))
    at_speeds: tuple[FrictionAtSpeeds, ...] = ()
    load: Array = field(default_factory=lambda: np.zeros(0))
    velocities: tuple[str, ...] = ()
    crossed: Array = field(default_factory=lambda: np.zeros((0, 0)))
    unseen: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        make_read_only(
            self,
            ("std_white", "joint_std", "deletions", "positions", "noise", "load", "crossed", "unseen"),
            ("single_block",),
        )

    def factor(self, level: float) -> float:
        """Half the width of an interval in standard deviations: Student's quantile.

        Raises
        ------
        FitError
            For a level that is not between 0 and 1.
        """
        return student_factor(level, self.degrees_of_freedom)

    def without_shift(self, std: Array) -> Array:
        """Return standard deviations, shape (b,), without the shifts by missing friction and errors of positions.

        ``test_uncertainty.py`` compares parts of a real log with them.
        """
        if self.kind != "jackknife":
            return std
        if len(self.noise) == len(std):
            return self.noise
        squares = np.square(std)  # of version 0.3.0, whose squares were added
        for shift in (self.positions, np.zeros(0) if self.friction is None else self.friction.shift):
            squares[: len(shift)] -= np.square(shift[: len(squares)])
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    def noise_covariance(self, covariance: Array, std: Array) -> Array:
        """Return the covariance by noise of the parameters and the estimated velocities of laws, (b + v, b + v).

        It is that of predictions, where biases of parameters nearly cancel. `covariance`, (b, b), and `std`, (b,), are those of
        the result.
        """
        share = quotient(self.without_shift(std), std, 1.0)
        own = covariance * np.outer(share, share)
        if not self.velocities:
            return np.asarray(own)
        b = len(std)
        return np.block([[own, self.crossed[:, :b].T], [self.crossed]])

    def lines(self, std: Array) -> list[str]:
        """Return the lines of a printed result on standard deviations, (b,)."""
        if not std.any():
            return []
        known = self.std_white > 0.0
        ratio = float(np.median(std[known] / self.std_white[known])) if known.any() else float("nan")
        compared = f"; median {ratio:.2f} times that of white noise" if self.kind != "white" else ""
        lines = [f"sigma {self.origin}{compared}"]
        for block in sorted(set(self.single_block.values())):
            names = series(name for name, number in self.single_block.items() if number == block)
            lines.append(
                f"only the rows of {self.blocks[block]} determine {names}: sigma is a guess from noise"
            )
        return [*lines, *self._position_lines(std), *self._friction_lines(), *self.speed_lines()]

    def _position_lines(self, std: Array) -> list[str]:
        noise = self.without_shift(std)[: len(self.positions)]
        moved = quotient(np.abs(self.positions[: len(noise)]), noise)
        if moved.max(initial=0.0) < CLEAR_POSITIONS:
            return []
        included = "sigma includes this" if self.kind == "jackknife" else "sigma does not include this"
        return [
            f"noise and steps of the positions move parameters by up to {moved.max():.2g} sigma of the noise, less "
            f"with a lower cut-off; {included}"
        ]

    def _friction_lines(self) -> list[str]:
        alarm = self.friction
        if alarm is None or not alarm.tested:
            return []
        if alarm.raised:
            effect = "the intervals include" if self.kind == "jackknife" else "sigma does not include"
            laws = alarm.laws or {alarm.law: alarm.joints}  # version 0.3.0 names one law for all
            first, *others = ((LAWS[law], joints_text(joints)) for law, joints in laws.items())
            explained = [f"{first[0]} explains the residual of {first[1]}"]
            explained += [f"{law} that of {joints}" for law, joints in others]
            return [
                f"{', '.join(explained)} (p = {alarm.p_value.min():.2g}); {effect} how far the parameters move with it"
            ]
        if self.kind == "jackknife" and alarm.shift.any():
            return [
                "held-out blocks do not decide whether some of the chosen friction laws are needed or another law fits better; "
                "the intervals include how far the parameters move without them"
            ]
        return ["no friction law that the model lacks was seen in the residual; sigma holds if there is none"]

    def speed_rows(self) -> list[tuple[str, ...]]:
        """Return heading and cells of the table of `at_speeds`: joint and why, then speeds and friction with its interval."""
        if not self.at_speeds:
            return []
        most = max(len(each.speeds) for each in self.at_speeds)
        cells = [("friction at speeds", "unit", *(("speed", "friction") * most))]
        for each in self.at_speeds:
            unit, speed_unit = ("N.m", "rad/s") if each.kind == "revolute" else ("N", "m/s")
            reason = (
                f" {'lacks' if each.seen else 'may lack'} {MISSING[each.law]}"
                if each.law
                else f": velocity of {each.parameters[0]} unknown"
                if each.refused
                else f": {each.parameters[0]} and {each.parameters[1]} exchange"
            )
            values = [
                (f"{speed:.2g} {speed_unit}", f"{torque:.4g} +- {0.5 * (high - low):.2g}")
                for speed, torque, low, high in zip(
                    each.speeds, each.torques, each.low, each.high, strict=True
                )
            ]
            cells.append(
                (f"joint {each.joint + 1}{reason}", unit, *(cell for pair in values for cell in pair))
            )
        return cells

    def speed_lines(self) -> list[str]:
        """Return the lines of `speed_rows`, with 95 % intervals."""
        cells = self.speed_rows()
        return ["", *table_lines(cells, 2), ""] if cells else []

    def of_draws(self) -> Uncertainty:
        """Return the record for the nearest robot: the distribution of its draws has the degrees of freedom of the estimate."""
        return replace(
            self, kind="draws", blocks=(), deletions=np.zeros((0, 0)), single_block={}, at_speeds=()
        )

    @property
    def origin(self) -> str:
        """Origin of sigma in words."""
        return {
            "jackknife": f"by the jackknife, {self.degrees_of_freedom + 1:.0f} blocks of time left out one at a time",
            "decimated": "for white noise that the decimation has correlated",
            "white": "for white noise, (10)",
            "correlated": "for the correlation that the output errors show",
            "draws": "of draws of the estimate, each moved to the nearest robot",
        }[self.kind]

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON data, without `std_white`, which the parameters have beside their `std`."""
        data: dict[str, Any] = plain(self)
        del data["std_white"]
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], std_white: Array) -> Uncertainty:
        """Restore the record from `to_dict`."""
        deletions = data["deletions"] if data["blocks"] else np.zeros((0, 0))
        known = {key: value for key, value in data.items() if key != "exchanges"}
        made: Uncertainty = restored(cls, {**known, "std_white": std_white, "deletions": deletions})
        if "exchanges" in data:  # of version 0.3.0
            made = replace(
                made, at_speeds=tuple(_of_exchange(one, made.factor(0.95)) for one in data["exchanges"])
            )
        return made


def _of_exchange(data: Mapping[str, Any], factor: float) -> FrictionAtSpeeds:
    """Return friction at speeds from the JSON of version 0.3.0, which had standard deviations in place of intervals."""
    pairs = list(zip(data["torques"], data["stds"], strict=True))
    ends = {"low": [t - factor * s for t, s in pairs], "high": [t + factor * s for t, s in pairs]}
    made: FrictionAtSpeeds = restored(
        FrictionAtSpeeds, {**{key: value for key, value in data.items() if key != "stds"}, **ends}
    )
    return made


def student_factor(level: float, degrees_of_freedom: float) -> float:
    """Return the two-sided quantile of Student's distribution; of the normal one for infinite degrees of freedom.

    Raises
    ------
    FitError
        For a level that is not between 0 and 1.
    """
    from scipy.special import ndtri, stdtrit  # not scipy.stats, which takes half a second to load

    if isinstance(level, bool) or not isinstance(level, (int, float)) or not 0.0 < level < 1.0:
        raise FitError(f"the level of an interval must be between 0 and 1, got {level!r}")
    tail = 0.5 + 0.5 * level
    if not np.isfinite(degrees_of_freedom):
        return float(ndtri(tail))
    return float(stdtrit(degrees_of_freedom, tail))
