"""Results of several methods on one simulated log, beside the truth, printed in the form of Table II.

Tested in ``tests/test_compare.py``.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.notebook import page, pandas
from .._tools.saved import plain, save_json
from .._tools.words import counted
from ..experiment.experiment import Experiment
from ..methods.table import title_of
from ..result.identification import Identification
from ..result.table import WELL_IDENTIFIED_PERCENT

SHORT_TITLES = {
    "didim-consistent": "consistent",
    "idim-ls-consistent": "consistent LS",
    "didim-plain": "plain DIDIM",
    "cloe-nelder-mead": "CLOE simplex",
    "cloe-levenberg-marquardt": "CLOE",
}
"""Titles of at most 12 characters, for the headings of the table of parameters."""
FEW = 10
"""Number of base parameters in the short table, spread evenly over the robot's list."""
COLUMNS = 100
"""Largest width of a line in characters, so that the table fits a terminal and a page."""
FAR = 3.0
"""Distance of an estimate from the truth, in standard deviations, that few correct estimates exceed; the table counts those
that do."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results of several methods on one simulated log, beside the truth.

    Tested in ``tests/test_compare.py``.

    Attributes
    ----------
    experiment : Experiment
        Experiment with the simulated log.
    truth : (b,) array
        Base parameters of the log.
    fits : dict of Identification
        Results by method.
    notes : tuple of str
        Sentences on shortened methods.
    norms : dict of float
        Norm (19) of the position errors (rad) of each method, at the "truth", and at the "start" of CLOE.
    torque_errors : dict of (n_dof,) array
        Norm of simulated less measured torque over that of the measured torque, joint by joint, at the same parameters;
        neither is filtered. A method's own errors may be of filtered torques.
    """

    experiment: Experiment
    truth: Array
    fits: dict[str, Identification]
    notes: tuple[str, ...] = ()
    norms: Mapping[str, float] = field(default_factory=dict)
    torque_errors: Mapping[str, Array] = field(default_factory=dict)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return the reasons of all verdicts, each with the name of its method."""
        return tuple(
            f"{title_of(name)}: {reason}" for name, fit in self.fits.items() for reason in fit.verdict.reasons
        )

    def deviations(self, method: str) -> Array:
        """Return estimate less truth in standard deviations, (b,)."""
        fit = self.fits[method]
        return np.asarray((fit.beta - self.truth) / np.where(fit.std > 0.0, fit.std, np.nan))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``compare --json``."""
        names = self.experiment.robot.base_parameters.names
        return {
            "robot": self.experiment.robot.name,
            "truth": dict(zip(names, self.truth.tolist(), strict=True)),
            "position_norms": plain(self.norms),
            "torque_errors": plain(self.torque_errors),
            "methods": {method: fit.to_dict() for method, fit in self.fits.items()},
        }

    def save(self, path: Path) -> None:
        """Write as JSON."""
        save_json(path, self.to_dict(), self.experiment.digests.values())

    def __str__(self) -> str:
        return text_of(self)

    def __repr__(self) -> str:
        return f"<Comparison {self.experiment.name!r}: {', '.join(self.fits)}>"

    def _repr_html_(self) -> str:
        title, _, rest = str(self).partition("\n")
        return page(title, rest)

    def to_dataframe(self) -> Any:
        """Return truth, estimates and standard deviations as a pandas ``DataFrame``.

        Returns
        -------
        DataFrame
            Base parameters by name; column ``truth``, then for each method ``(method, "value")`` and ``(method, "std")`` (SI units,
            joint side).

        Raises
        ------
        DidimError
            Without pandas (``tests/test_notebook.py``).
        """
        columns = {("truth", "value"): self.truth}
        for method, fit in self.fits.items():
            columns |= {(method, "value"): fit.beta, (method, "std"): fit.std}
        names = self.experiment.robot.base_parameters.names
        return pandas().DataFrame(columns, index=pandas().Index(names, name="parameter"))


def text_of(comparison: Comparison, *, every: bool = False, width: int = COLUMNS) -> str:
    """Return the summary, then rows of parameters.

    Parameters
    ----------
    comparison : Comparison
        Results of methods on one simulated log.
    every : bool
        All base parameters, the torque errors of each joint and the reasons of each verdict; otherwise `FEW` parameters.
    width : int
        Largest width of a sentence or a row of parameters; a table with more methods continues below.
    """
    base = comparison.experiment.robot.base_parameters
    recording = comparison.experiment.recordings[0]
    lines = [
        f"{comparison.experiment.name}: {recording.t[-1]:g} s at {recording.rate_hz:g} Hz, "
        f"{counted(len(base.names), 'base parameter')}",
        "",
        *_answer(comparison, width),
        "",
    ]
    if every and comparison.torque_errors:
        lines += [*_joint_errors(comparison), ""]
    few = not every and len(base.names) > FEW
    rows = (
        sorted(set(np.linspace(0, len(base.names) - 1, FEW).round().astype(int).tolist()))
        if few
        else range(len(base.names))
    )
    lines += _parameter_rows(comparison, rows, width)
    if few:
        lines += [f"{FEW} of {counted(len(base.names), 'base parameter')}; --all prints all of them.", ""]
    if every and comparison.remarks:
        lines += ["Notes:", *(f"  {text}" for text in comparison.remarks), ""]
    lines += [
        line for text in (*sentences(comparison), *comparison.notes) for line in textwrap.wrap(text, width)
    ]
    return "\n".join(lines)


def _answer(comparison: Comparison, width: int) -> list[str]:
    """Return the summary: time, error in sigma, error of torques and positions, status and verdict of each method."""
    titles = {name: title_of(name) for name in comparison.fits}
    first = max(len("(truth)"), *map(len, titles.values()))
    lines = [
        f"{'':{first}}{'seconds':>9}{'simulations':>13}{'off':>6}{'torque %':>10}{'norm (19)':>11}  status, verdict"
    ]
    for name in ("truth", *comparison.fits):
        shares = comparison.torque_errors.get(name, np.array([np.nan]))
        norm = comparison.norms.get(name, float("nan"))
        cost = f"{'':22}{'':6}"
        outcome = ""
        if name in comparison.fits:
            fit = comparison.fits[name]
            cost = f"{fit.elapsed:>9.2f}{fit.n_simulations:>13}{_off(off_rms(comparison, name)):>6}"
            outcome = f"  {ending(fit)}, {fit.verdict.state}"
        error = float(np.sqrt(np.mean(shares**2)))
        lines.append(
            f"{titles.get(name, '(truth)'):{first}}{cost}{f'{100.0 * error:.3g}' if np.isfinite(error) else '-':>10}"
            f"{f'{norm:.3g}' if np.isfinite(norm) else '-':>11}{outcome}"
        )
    start = comparison.norms.get("start")
    lines += [
        "",
        *textwrap.wrap(off_explained(comparison), width),
        "torque %: error of the simulated torque, as a share of the measured one; rms of the joints",
        "norm (19): of the errors of the simulated positions (rad)"
        + (f"; {start:.3g} at the start of CLOE" if start is not None else ""),
    ]
    return lines


def _parameter_rows(comparison: Comparison, rows: Sequence[int], width: int) -> list[str]:
    """Return tables of estimates beside the truth, each with its error in standard deviations."""
    base = comparison.experiment.robot.base_parameters
    width_name, width_unit = max(map(len, base.names)), max(map(len, base.units))
    margin = f"{'':{width_name}} {'':{width_unit}}"
    off = {name: comparison.deviations(name) for name in comparison.fits}
    at_once = max(1, (width - len(margin) - 10) // 15)
    lines: list[str] = []
    for first in range(0, len(off), at_once):
        methods = list(off)[first : first + at_once]
        upper = "".join(f"{SHORT_TITLES.get(name, title_of(name))[:12]:>15}" for name in methods)
        lower = f"{margin} {'truth':>9}" + "  estimate  off" * len(methods)
        lines += [f"{margin} {'':>9}{upper}", lower, "-" * len(lower)]
        for index in rows:
            line = f"{base.names[index]:{width_name}} {base.units[index]:{width_unit}} {comparison.truth[index]:9.3g}"
            for name in methods:
                line += f" {comparison.fits[name].beta[index]:9.3g}{_off(off[name][index]):>5}"
            lines.append(line)
        lines.append("")
    return lines


def off_rms(comparison: Comparison, method: str) -> float:
    """Return the root mean square of the deviations from the truth, in standard deviations; NaN without a covariance."""
    off = comparison.deviations(method)
    return float(np.sqrt(np.nanmean(off**2))) if np.isfinite(off).any() else float("nan")


def off_explained(comparison: Comparison) -> str:
    """Explain the column ``off``, with the number of entries beyond `FAR` that chance explains.

    Where the methods differ in their degrees of freedom the fewest are used.
    """
    known = [
        fit.uncertainty.degrees_of_freedom for fit in comparison.fits.values() if fit.uncertainty is not None
    ]
    text = "off: estimate less truth in standard deviations, above their rms"
    if not known or not math.isfinite(min(known)):
        return text
    from scipy.special import stdtr  # not scipy.stats, which takes half a second to load

    share = 2.0 * float(stdtr(min(known), -FAR))
    return (
        f"{text}; {100.0 * share:.2g} % of correct estimates exceed {FAR:g} (Student's distribution, {min(known):.0f} "
        "degrees of freedom)"
    )


def _off(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{value:.1f}"


def _joint_errors(comparison: Comparison) -> list[str]:
    """Return the torque errors of each joint, neither filtered nor decimated for any method."""
    named = {"truth": "(truth)", **{name: title_of(name) for name in comparison.fits}}
    title = "torque %"
    width = max(len(title), *map(len, named.values()))
    n = comparison.experiment.robot.n_dof
    lines = [f"{title:{width}}" + "".join(f"{f'joint {joint + 1}':>9}" for joint in range(n))]
    for name, label in named.items():
        errors = comparison.torque_errors.get(name, np.full(n, np.nan))
        lines.append(
            f"{label:{width}}"
            + "".join((f"{100.0 * error:9.3f}" if np.isfinite(error) else f"{'-':>9}") for error in errors)
        )
    return lines


def sentences(comparison: Comparison) -> list[str]:
    """Return the sentences on a result, for quotation."""
    if "didim" not in comparison.fits:
        return ["DIDIM was not run."]
    fit = comparison.fits["didim"]
    if not fit.converged:
        return [f"DIDIM did not converge: {fit.status.value}"]
    well = fit.relative_std_percent < WELL_IDENTIFIED_PERCENT
    worst = float(np.nanmax(np.abs(comparison.deviations("didim")[well]))) if well.any() else float("nan")
    texts = [
        f"DIDIM found {counted(len(fit.names), 'base parameter')} in {counted(fit.n_iterations, 'iteration')}, "
        f"{counted(fit.n_simulations, 'simulation')} and {duration(fit.elapsed)}; the {int(well.sum())} with a sigma below "
        f"{WELL_IDENTIFIED_PERCENT:.0f} % are within {worst:.1f} sigma of the truth."
    ]
    for method, other in comparison.fits.items():
        if not method.startswith("cloe"):
            continue
        times = other.elapsed / max(fit.elapsed, 1e-9)
        texts.append(
            f"{title_of(method)} {_where(comparison, method)} after {counted(other.n_simulations, 'simulation')} and "
            f"{duration(other.elapsed)}, {times:.0f} times as long."
        )
    return texts


def _where(comparison: Comparison, method: str) -> str:
    """Return the progress of a CLOE as text."""
    norm, start, truth = (comparison.norms.get(name, float("nan")) for name in (method, "start", "truth"))
    if norm <= truth * 1.001:
        return "is at the optimum"
    if np.isfinite(norm) and start > 0.0:
        return f"has {100.0 * norm / start:.2g} % of its starting norm left"
    return "ends"


def ending(fit: Identification) -> str:
    """Return the ending of a fit in a word or two, such as "Converged"."""
    return fit.status.value.partition(":")[0]


def duration(seconds: float) -> str:
    """Return a duration in a readable unit: 0.48 s, 51 s, 16 min."""
    if seconds < 10.0:
        return f"{seconds:.2g} s"
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
