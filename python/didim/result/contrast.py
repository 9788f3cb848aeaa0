r"""The contrast of two estimates from one log: their difference and its own standard deviation.

    d = beta_2 - beta_1,    s^2 = (m - 1)/m sum_i (d_(i) - mean)^2,    |d| / s against Student's t with m - 1 degrees of freedom

d_(i) is the difference of the two estimates without block i, from both jackknives, so no system is solved again. Two estimates
of one log share most of their errors, so their difference is known much better than either of them. With b parameters
Bonferroni's bound holds for all of them at once. Sources: Hausman (1978); Janot, Vandanjon and Gautier (2014).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._tools.arrays import Array, quotient
from .._tools.notebook import Printed
from .._tools.saved import plain, rows
from .._tools.words import counted, series
from ..errors import FitError
from .identification import Identification
from .uncertainty import student_factor

SAME_TIME = 0.25
"""Largest difference of the blocks' edges of two results, as a share of a block: methods drop different rows at the ends."""
SAVED = ("first", "second", "rms", "rms_in_sigma", "bound", "level", "degrees_of_freedom", "beyond")
"""Attributes that JSON has under their own name."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Contrast(Printed):
    """Difference of two estimates of the same parameters from the same log.

    Tested in ``tests/test_contrast.py``.

    Attributes
    ----------
    first, second : str
        Methods.
    names, units : tuple of str
        Names of the common parameters.
    difference : ndarray, shape (b,)
        Second less first estimate.
    std : ndarray, shape (b,)
        Standard deviation of the difference, by the jackknife.
    std_first : ndarray, shape (b,)
        Standard deviations of the first estimate.
    degrees_of_freedom : float
        Number of blocks less one.
    level : float
        Confidence that holds for all parameters together.
    """

    first: str
    second: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    difference: Array
    std: Array
    std_first: Array
    degrees_of_freedom: float
    level: float = 0.95

    @property
    def ratios(self) -> Array:
        """Difference in its own standard deviations, shape (b,)."""
        return quotient(self.difference, self.std)

    @property
    def rms(self) -> float:
        """Root mean square of `ratios`: near 1 if the two estimates only differ by chance."""
        return float(np.sqrt(np.mean(self.ratios**2))) if self.names else 0.0

    @property
    def rms_in_sigma(self) -> float:
        """Root mean square of the difference in standard deviations of the first estimate."""
        known = self.in_sigma[self.std_first > 0.0]
        return float(np.sqrt(np.mean(known**2))) if known.size else 0.0

    @property
    def bound(self) -> float:
        """Ratio beyond which a difference is not chance, for all parameters at once (Bonferroni)."""
        return student_factor(1.0 - (1.0 - self.level) / max(1, len(self.names)), self.degrees_of_freedom)

    @property
    def beyond(self) -> tuple[str, ...]:
        """Parameters whose estimates differ by more than chance, the clearest first."""
        size = np.abs(self.ratios)
        return tuple(self.names[k] for k in np.argsort(-size) if size[k] > self.bound)

    @property
    def in_sigma(self) -> Array:
        """Difference in standard deviations of the first estimate, shape (b,); NaN if it has none."""
        return quotient(self.difference, self.std_first, np.nan)

    @property
    def large(self) -> tuple[str, ...]:
        """Parameters of `beyond` that differ by more than one standard deviation of the first estimate."""
        small = {name for name, sigma in zip(self.names, self.in_sigma, strict=True) if abs(sigma) <= 1.0}
        return tuple(name for name in self.beyond if name not in small)

    @property
    def agree(self) -> bool:
        """Whether no parameter differs by more than chance."""
        return not self.beyond

    def __str__(self) -> str:
        head = (
            f"{self.second} less {self.first}: rms {self.rms:.2f} deviations, {self.rms_in_sigma:.2g} sigma of "
            f"{self.first}; bound for {counted(len(self.names), 'parameter')} {self.bound:.2f}"
        )
        if self.agree:
            return f"{head}: no difference beyond chance."
        sizes = dict(zip(self.names, np.abs([self.ratios, self.in_sigma]).T, strict=True))
        shown = series(
            (f"{name} ({sizes[name][0]:.1f}, {sizes[name][1]:.2g} sigma)" for name in self.beyond), 44
        )
        return f"{head}: beyond it {shown}."

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists, numbers and strings."""
        return {
            **{key: plain(getattr(self, key)) for key in SAVED},
            "parameters": rows(
                name=self.names,
                unit=self.units,
                difference=self.difference,
                std=self.std,
                ratio=self.ratios,
                in_sigma=self.in_sigma,
            ),
        }


def contrast(first: Identification, second: Identification, *, level: float = 0.95) -> Contrast:
    """Compare two estimates of the same parameters from the same log.

    Parameters
    ----------
    first, second : Identification
        Results of two methods on one log, both with ``uncertainty = "jackknife"`` and the same number of blocks.
    level : float
        Confidence that holds for all parameters together.

    Returns
    -------
    Contrast
        Second less first.

    Raises
    ------
    FitError
        For results of different robots or logs, or without the deletions of a jackknife.

    Notes
    -----
    ``test_contrast.py`` compares the standard deviation with the spread over many logs, and tests logs with a wrong filter and
    with a wrong controller.
    """
    one, two = first.uncertainty, second.uncertainty
    for fit, uncertainty in ((first, one), (second, two)):
        if uncertainty is None or not uncertainty.blocks:
            raise FitError(
                f"the contrast needs the deletions of a jackknife, which the result of {fit.method} does not have: identify "
                'with uncertainty = "jackknife"'
            )
    assert one is not None
    assert two is not None
    if first.names != second.names:
        raise FitError(
            f"results of robot {first.robot!r} and robot {second.robot!r} have different parameters"
        )
    data = [
        {key: digest for key, digest in fit.digests.items() if key.startswith("data ")}
        for fit in (first, second)
    ]
    same = len(one.blocks) == len(two.blocks) and all(
        (a.recording, a.window) == (b.recording, b.window)
        and abs(a.start_s - b.start_s) + abs(a.stop_s - b.stop_s) <= SAME_TIME * (a.stop_s - a.start_s)
        for a, b in zip(one.blocks, two.blocks, strict=True)
    )
    if data[0] != data[1] or not same:
        raise FitError(
            f"the results of {first.method} and {second.method} are not from the same log: their files or blocks of time differ"
        )
    both = [k for k in range(len(first.names)) if first.roles[k] == second.roles[k] == "estimated"]
    deletions = two.deletions[:, both] - one.deletions[:, both]
    centred = deletions - deletions.mean(axis=0)
    m = len(deletions)
    return Contrast(
        first=first.method,
        second=second.method,
        names=tuple(first.names[k] for k in both),
        units=tuple(first.units[k] for k in both),
        difference=second.beta[both] - first.beta[both],
        std=np.sqrt((m - 1) / m * np.sum(centred**2, axis=0)),
        std_first=_of_noise(first)[both],
        degrees_of_freedom=m - 1.0,
        level=level,
    )


def reading(contrasts: Sequence[Contrast]) -> str:
    """Return the joint conclusion from the contrasts of IDIM-LS, IDIM-IV and DIDIM, in one sentence.

    Parameters
    ----------
    contrasts : sequence of Contrast
        "idim-iv" less "idim-ls" and "didim" less "idim-iv"; either may be missing.
    """
    by_pair: Mapping[tuple[str, str], Contrast] = {(each.first, each.second): each for each in contrasts}
    filters, controller = by_pair.get(("idim-ls", "idim-iv")), by_pair.get(("idim-iv", "didim"))
    wrong_filter = filters is not None and not filters.agree
    # A difference far below the standard deviations does not discredit the controller, even if it is significant.
    wrong_controller = controller is not None and bool(controller.large)
    if wrong_filter and filters is not None:
        names = series(filters.beyond, 40)
        return (
            f"IDIM-LS and IDIM-IV differ in {names}: the observation matrix is wrong; raise the cut-off or check friction near "
            "standstill" + (", before judging the controller" if wrong_controller else "")
        )
    if wrong_controller and controller is not None:
        names = series(controller.large, 30)
        return (
            f"DIDIM differs from IDIM-IV in {names}, IDIM-IV agrees with IDIM-LS: the simulated loop is wrong; check "
            "controller and reference, and use IDIM-IV or IDIM-LS"
        )
    return "the estimates agree: the contrasts show no bias by the filter or by the controller"


def _of_noise(fit: Identification) -> Array:
    """Return standard deviations without the part for missing friction, an error that both estimates of a contrast share."""
    return fit.std if fit.uncertainty is None else fit.uncertainty.without_shift(fit.std)
