"""Results of several methods on one simulated log, beside the truth, and their text in the form of Table II.

Tested in ``tests/test_compare.py``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.files import write_atomically
from .._tools.notebook import page, pandas
from .._tools.words import counted
from ..experiment.experiment import Experiment
from ..result.identification import Identification
from ..result.table import WELL_IDENTIFIED_PERCENT

TITLES = {
    "idim-ls": "IDIM-LS",
    "didim": "DIDIM",
    "idim-ls-consistent": "IDIM-LS, consistent",
    "didim-consistent": "DIDIM, consistent",
    "didim-plain": "DIDIM, plain",
    "cloe-nelder-mead": "CLOE, Nelder-Mead",
    "cloe-nelder-mead-literal": "CLOE, literal",
    "cloe-nelder-mead-scaled": "CLOE, scaled",
    "cloe-nelder-mead-adaptive": "CLOE, adaptive",
    "cloe-levenberg-marquardt": "CLOE, Levenberg-Marquardt",
}
FAR = 3.0
"""Distance of an estimate from the truth, in standard deviations, that few right estimates exceed: the table says how many."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results of several methods on one simulated log, beside the truth.

    Attributes
    ----------
    experiment : Experiment
        With the simulated log.
    truth : (b,) array
        Base parameters of the log.
    fits : dict of Identification
        By method.
    notes : tuple of str
        What was shortened.
    norms : dict of float
        Norm (19) of the position errors (rad) of each method, at the "truth", and at the "start" of CLOE.
    torque_errors : dict of (n_dof,) array
        Norm of simulated less measured torque over that of the measured torque, joint by joint, at the same parameters;
        neither is filtered. The errors of the fits themselves are of filtered torques where a method filters.
    """

    experiment: Experiment
    truth: Array
    fits: dict[str, Identification]
    notes: tuple[str, ...] = ()
    norms: Mapping[str, float] = field(default_factory=dict)
    torque_errors: Mapping[str, Array] = field(default_factory=dict)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reasons of the verdicts of all methods, each with the name of its method."""
        return tuple(
            f"{TITLES.get(name, name)}: {reason}"
            for name, fit in self.fits.items()
            for reason in fit.verdict.reasons
        )

    def deviations(self, method: str) -> Array:
        """Estimate less truth in standard deviations, (b,)."""
        fit = self.fits[method]
        return np.asarray((fit.beta - self.truth) / np.where(fit.std > 0.0, fit.std, np.nan))

    def to_dict(self) -> dict[str, Any]:
        """As ``compare --json`` writes it."""
        names = self.experiment.robot.base_parameters.names
        return {
            "robot": self.experiment.robot.name,
            "truth": dict(zip(names, self.truth.tolist(), strict=True)),
            "position_norms": {
                name: value if np.isfinite(value) else None for name, value in self.norms.items()
            },
            "torque_errors": {
                name: [float(value) if np.isfinite(value) else None for value in values]
                for name, values in self.torque_errors.items()
            },
            "methods": {method: fit.to_dict() for method, fit in self.fits.items()},
        }

    def save(self, path: Path) -> None:
        """Write as JSON."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False)
        write_atomically(path, text + "\n", self.experiment.digests.values())

    def __str__(self) -> str:
        return _render(self)

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


def _render(comparison: Comparison) -> str:
    """Table of parameters, errors per joint, effort, and a sentence to quote."""
    base = comparison.experiment.robot.base_parameters
    recording = comparison.experiment.recordings[0]
    lines = [
        f"{comparison.experiment.name}: {recording.t[-1]:g} s at {recording.rate_hz:g} Hz, "
        f"{counted(len(base.names), 'base parameter')}",
        off_explained(comparison),
        "",
    ]
    methods = list(comparison.fits)
    groups = [TITLES.get(method, method) for method in methods]
    width_name, width_unit = max(map(len, base.names)), max(map(len, base.units))
    head = f"{'':{width_name}}  {'':{width_unit}}  {'truth':>9}"
    sub = " " * len(head)
    for group in groups:
        head += f"   {group:^24}"
        sub += f"   {'estimate':>9} {'sigma %':>8} {'off':>5}"
    lines += [head.rstrip(), sub.rstrip(), "-" * len(sub)]
    for index, (name, unit) in enumerate(zip(base.names, base.units, strict=True)):
        line = f"{name:{width_name}}  {unit:{width_unit}}  {comparison.truth[index]:9.4g}"
        for method in methods:
            fit = comparison.fits[method]
            percent, off = fit.relative_std_percent[index], comparison.deviations(method)[index]
            shown = (
                "-"
                if not (np.isfinite(percent) and fit.std.any())
                else (">999" if percent > 999 else f"{percent:.3g}")
            )
            line += f"   {fit.beta[index]:9.4g} {shown:>8} {_off(off):>5}"
        lines.append(line)
    lines += ["", *_effort(comparison, methods, groups), ""]
    if comparison.remarks:
        lines += ["To know:", *(f"  {text}" for text in comparison.remarks), ""]
    lines += [sentence(comparison), *comparison.notes]
    return "\n".join(lines)


def off_explained(comparison: Comparison) -> str:
    """Return what the column ``off`` is, and how many of its numbers lie beyond `FAR` where nothing is wrong.

    The methods of a table have the same blocks of the jackknife, so the fewest degrees of freedom stand for all.
    """
    known = [
        fit.uncertainty.degrees_of_freedom for fit in comparison.fits.values() if fit.uncertainty is not None
    ]
    text = "off: estimate less truth, in standard deviations"
    if not known or not math.isfinite(min(known)):
        return text
    from scipy.special import stdtr  # not scipy.stats, which takes half a second to load

    share = 2.0 * float(stdtr(min(known), -FAR))
    return (
        f"{text}; {100.0 * share:.2g} % of right estimates are off by more than {FAR:g} (Student's distribution, "
        f"{min(known):.0f} degrees of freedom)"
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:9.3f}" if np.isfinite(share) else f"{'-':>9}"


def _off(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{value:.1f}"


def _effort(comparison: Comparison, methods: list[str], groups: list[str]) -> list[str]:
    n = comparison.experiment.robot.n_dof
    named = {"truth": "(truth)", **dict(zip(methods, groups, strict=True))}
    title = "torque error %"
    width = max(len(title), *map(len, named.values()))
    lines = [f"{title:{width}}" + "".join(f"{f'joint {joint + 1}':>9}" for joint in range(n))]
    for method, group in named.items():
        # Of all methods alike: simulated less measured torque, neither filtered nor decimated.
        errors = comparison.torque_errors.get(method, np.full(n, np.nan))
        lines.append(f"{group:{width}}" + "".join(_percent(error) for error in errors))
    reference = comparison.fits.get("didim")
    ratios = reference is not None and reference.elapsed > 0.0
    head = f"{'':{width}}{'iterations':>11}{'simulations':>12}{'seconds':>9}"
    lines += ["", head + f"{'x DIDIM':>9}" * ratios + f"{'off, rms':>9}{'norm (19)':>11}  status"]
    for method, group in zip(methods, groups, strict=True):
        fit = comparison.fits[method]
        off = comparison.deviations(method)
        rms = float(np.sqrt(np.nanmean(off**2))) if np.isfinite(off).any() else float("nan")
        longer = f"{fit.elapsed / reference.elapsed:>9.3g}" if reference is not None and ratios else ""
        norm = comparison.norms.get(method, float("nan"))
        lines.append(
            f"{group:{width}}{fit.n_iterations:>11}{fit.n_simulations:>12}{fit.elapsed:>9.2f}{longer}{_off(rms):>9}"
            f"{f'{norm:.3g}' if np.isfinite(norm) else '-':>11}  {fit.status.value.partition(':')[0].rstrip('.')}"
        )
    at = {name: comparison.norms[name] for name in ("start", "truth") if name in comparison.norms}
    if len(at) == 2:
        lines.append(
            f"norm (19): of the position errors (rad); {at['start']:.3g} at the start of CLOE, {at['truth']:.3g} at the truth"
        )
    return lines


def sentence(comparison: Comparison) -> str:
    """Return one sentence on what was found, to quote."""
    if "didim" not in comparison.fits:
        return "DIDIM was not run."
    fit = comparison.fits["didim"]
    if not fit.converged:
        return f"DIDIM did not converge: {fit.status.value}"
    well = fit.relative_std_percent < WELL_IDENTIFIED_PERCENT
    worst = float(np.nanmax(np.abs(comparison.deviations("didim")[well]))) if well.any() else float("nan")
    text = (
        f"DIDIM found {counted(len(fit.names), 'base parameter')} in {counted(fit.n_iterations, 'iteration')}, "
        f"{counted(fit.n_simulations, 'simulation')} and {duration(fit.elapsed)}; the {int(well.sum())} with a sigma below "
        f"{WELL_IDENTIFIED_PERCENT:.0f} % are within {worst:.1f} sigma of the truth"
    )
    for method, other in comparison.fits.items():
        if not method.startswith("cloe"):
            continue
        times = other.elapsed / max(fit.elapsed, 1e-9)
        text += (
            f"; {TITLES.get(method, method)} {_where(comparison, method)} after {counted(other.n_simulations, 'simulation')} and "
            f"{duration(other.elapsed)}, {times:.0f} times as long"
        )
    return text + "."


def _where(comparison: Comparison, method: str) -> str:
    """Say how far a CLOE has come."""
    norm, start, truth = (comparison.norms.get(name, float("nan")) for name in (method, "start", "truth"))
    if norm <= truth * 1.001:
        return "is at the optimum"
    if np.isfinite(norm) and start > 0.0:
        return f"has {100.0 * norm / start:.2g} % of its starting norm left"
    return "ends"


def duration(seconds: float) -> str:
    """Return seconds as people say them: 0.48 s, 51 s, 16 min."""
    if seconds < 10.0:
        return f"{seconds:.2g} s"
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
