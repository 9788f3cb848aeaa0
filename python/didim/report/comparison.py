"""The report of a comparison: every method beside the truth, with its errors and computing time."""

from __future__ import annotations

import numpy as np

import didim.plot as plot

from .._tools.words import counted
from ..methods.table import title_of
from ..plot.style import percent
from ..result.identification import Identification
from ..result.table import WELL_IDENTIFIED_PERCENT
from ..studies.comparison import Comparison, duration, ending, off_rms, sentences
from ..studies.prediction import predict
from .fit import aligned_rows, provenance_section, robot_section, well_identified
from .page import Html, Level, Text, page, paragraph, picture, section, table, verdict

FAR_OFF = 3.0
"""Distance in standard deviations from which an estimate is marked: of 60 correct ones, one in six lists has such an
estimate."""


def comparison_page(comparison: Comparison) -> str:
    """Return the report of a comparison as HTML."""
    fits = comparison.fits
    log = comparison.experiment
    recording = log.recordings[0]
    subject = fits.get("didim") or next(iter(fits.values()))
    level: Level = "good" if subject.converged else "bad"
    badge = subject.status.value.partition(":")[0]
    sections = [
        verdict(
            level,
            f"{title_of(subject.method)}: {badge}",
            " ".join(sentences(comparison)),
            [
                (duration(fit.elapsed), f"{title_of(method)}: {counted(fit.n_simulations, 'simulation')}")
                for method, fit in comparison.fits.items()
            ],
            (*comparison.notes, *comparison.remarks),
        ),
        _cost_section(comparison),
        _deviation_section(comparison),
        _table_section(comparison),
        _convergence_section(fits),
        _torque_section(comparison, subject),
        robot_section(log),
        provenance_section(subject),
    ]
    subtitle = (
        f"A log of {recording.t[-1]:g} s at {recording.rate_hz:g} Hz, simulated with known parameters and identified by "
        f"{counted(len(fits), 'method')}; {counted(len(subject.names), 'base parameter')}"
    )
    return page(f"{log.name}: methods beside the truth", subtitle, [part for part in sections if part.text])


def _cost_section(comparison: Comparison) -> Html:
    fits = comparison.fits
    n = comparison.experiment.robot.n_dof
    rows: list[list[Text]] = []
    for method, fit in fits.items():
        off = off_rms(comparison, method)
        known = fit.std.any()
        norm = comparison.norms.get(method, float("nan"))
        rows.append(
            [
                title_of(method),
                str(fit.n_iterations),
                str(fit.n_simulations),
                f"{fit.elapsed:.2f}",
                f"{off:.2f}" if np.isfinite(off) else "-",
                f"{norm:.3g}" if np.isfinite(norm) else "-",
                f"{int(well_identified(fit).sum())} of {len(fit.names)}" if known else "-",
                ending(fit),
            ]
        )
    head = ["", "iterations", "simulations", "seconds", "off, rms", "norm (19)", "well identified", "status"]
    errors: list[list[Text]] = [
        [
            title_of(method),
            *(f"{100.0 * error:.3f}" for error in (*fit.relative_error, fit.overall_relative_error)),
        ]
        for method, fit in fits.items()
    ]
    start, truth = (comparison.norms.get(name) for name in ("start", "truth"))
    norms = (
        ""
        if start is None or truth is None
        else f"; {start:.3g} at the start of CLOE, {truth:.3g} at the truth"
    )
    return section(
        "Cost and errors",
        paragraph(
            "Off: estimate less truth in standard deviations of the method itself; its rms over all parameters is near 1 where "
            f"sigma is honest. Well identified: sigma below {WELL_IDENTIFIED_PERCENT:.0f} %. Norm (19): of the position errors "
            f"of the simulated closed loop{norms}."
        ),
        table(head, rows, numbers=range(1, 6)),
        table(
            ["relative torque error %", *(f"joint {j + 1}" for j in range(n)), "all"],
            errors,
            numbers=range(1, n + 2),
        ),
    )


def _deviation_section(comparison: Comparison) -> Html:
    known = {title_of(name): fit for name, fit in comparison.fits.items() if fit.std.any()}
    if not known:
        return Html("")
    lines = [
        "Each point is an estimate less the truth, in standard deviations: of a method whose sigma is honest, 95 % lie in the "
        "grey band."
    ]
    lines += [
        f"{title_of(name)} gives no standard deviations and is not drawn."
        for name, fit in comparison.fits.items()
        if not fit.std.any()
    ]
    return section(
        "How far from the truth",
        *(paragraph(line) for line in lines),
        picture(
            plot.parameters(known, truth=comparison.truth),
            "Deviation of each parameter from the truth, by method, in standard deviations",
        ),
    )


def _table_section(comparison: Comparison) -> Html:
    fits = comparison.fits
    base = comparison.experiment.robot.base_parameters
    head = ["parameter", "unit", "truth"]
    for _ in fits:
        head += ["estimate", "sigma %", "off"]
    rows: list[list[str]] = []
    classes: dict[tuple[int, int], str] = {}
    for index, (name, unit) in enumerate(zip(base.names, base.units, strict=True)):
        row: list[str] = [name, unit, f"{comparison.truth[index]:.4g}"]
        for method, fit in fits.items():
            share, off = fit.relative_std_percent[index], comparison.deviations(method)[index]
            if np.isfinite(off) and abs(off) > FAR_OFF:
                classes[index, len(row) + 2] = "off"
            if fit.std[index] > 0.0 and not share <= WELL_IDENTIFIED_PERCENT:
                classes[index, len(row) + 1] = "uncertain"
            row += [
                f"{fit.beta[index]:.4g}",
                _share(float(share)) if fit.std[index] > 0.0 else "-",
                f"{round(off, 1) + 0.0:+.1f}" if np.isfinite(off) else "-",
            ]
        rows.append(row)
    return section(
        "Parameters",
        paragraph(
            f"SI units, joint side. Marked are deviations beyond {FAR_OFF:g} standard deviations, and sigmas above "
            f"{WELL_IDENTIFIED_PERCENT:.0f} %."
        ),
        table(
            head,
            aligned_rows(rows, 2),
            numbers=range(2, len(head)),
            groups=[("", 3), *((title_of(method), 3) for method in fits)],
            classes=classes,
        ),
    )


def _share(value: float) -> str:
    return "-" if np.isnan(value) else ">999" if value > 999.0 else f"{value:.3g}"


def _convergence_section(fits: dict[str, Identification]) -> Html:
    known = {title_of(name): fit for name, fit in fits.items() if fit.history}
    if not known:
        return Html("")
    return section(
        "Convergence",
        paragraph(
            "Relative error: of the torques, or, for CLOE, of what it minimises over that of its start. IDIM-LS iterates on its "
            "weights only. The JSON has further numbers of each iteration."
        ),
        picture(plot.convergence(known), "Relative error and step over the iterations, by method"),
    )


def _torque_section(comparison: Comparison, subject: Identification) -> Html:
    if not subject.converged:
        return Html("")
    predictions = predict(subject, comparison.experiment)
    worst = percent(float(np.nanmax(subject.relative_error)))
    return section(
        f"Torques by {title_of(subject.method)}",
        paragraph(f"On the rows that the fit is made of; noise included the worst joint is off by {worst}."),
        picture(
            plot.torques(subject, comparison.experiment, predictions=predictions),
            "Measured and modelled torque of each joint",
        ),
    )
