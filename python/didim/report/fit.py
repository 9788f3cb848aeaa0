"""The report of an identification: verdict, parameters, errors and pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import didim.plot as plot

from .._tools.words import counted
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..methods.table import title_of
from ..plot.estimates import estimate_correlation
from ..plot.motion import FEWEST_SPECTRUM_ROWS
from ..plot.style import percent
from ..result.identification import Identification
from ..result.table import WELL_IDENTIFIED_PERCENT, aligned, delay_lines
from ..result.verdict import State
from ..studies.comparison import duration
from ..studies.prediction import Prediction, predict, relative_errors
from .page import Html, Level, Text, beside, code, details, page, paragraph, picture, section, table, verdict

STRONG_CORRELATION = 0.8
"""Absolute correlation of two estimates from which the report lists the pair."""
MOST_PAIRS = 10
"""Largest number of correlated pairs in a report."""
MOST_HISTORY_ROWS = 40
"""Largest number of rows in the table of iterations."""
LEVELS: dict[State, Level] = {State.SOUND: "good", State.DOUBTFUL: "caution", State.WRONG: "bad"}
"""Colour of each verdict."""


def fit_page(fit: Identification, experiment: Experiment) -> str:
    """Return the report of an identification as HTML."""
    predictions, doubt = _predictions(fit, experiment)
    level, badge, sentence = judged(fit)
    findings = [*(str(reason) for reason in fit.verdict.reasons), *doubt]
    sections = [
        verdict(level, badge, sentence, [*tiles(fit), *log_tiles(fit, experiment)], findings),
        torque_section(fit, experiment, predictions),
        motion_section(experiment),
        parameter_section(fit, experiment, predictions),
        further_section(fit),
        _residual_section(fit, experiment, predictions),
        _friction_section(fit, experiment),
        _correlation_section(fit),
        _convergence_section(fit),
        robot_section(experiment),
        provenance_section(fit),
    ]
    title = f"{fit.name}: robot {fit.robot} by {title_of(fit.method)}"
    rows = f"{counted(fit.n_rows, 'row')} of torque, {counted(len(fit.names), 'base parameter')}"
    return page(
        title, f"Identification of dynamic parameters: {rows}", [part for part in sections if part.text]
    )


def judged(fit: Identification) -> tuple[Level, str, str]:
    """Return the judgement of a result: a level, a word, and a sentence."""
    text = f"{title_of(fit.method)} found {counted(len(fit.names), 'base parameter')}"
    if fit.std.any():
        well = int(well_identified(fit).sum())
        estimated = sum(role == "estimated" for role in fit.roles)
        count = "all" if well == estimated else "none" if well == 0 else f"{well} of {estimated}"
        text += f", {count} well (sigma below {WELL_IDENTIFIED_PERCENT:.0f} %)"
    else:
        text += "; the method gives no standard deviations"
    errors = fit.relative_error
    if np.isfinite(errors).any():
        low, high = int(np.nanargmin(errors)), int(np.nanargmax(errors))
        text += ". The torques of the model are off by "
        text += percent(errors[low])
        if percent(errors[low]) != percent(errors[high]):
            text += f" (joint {low + 1}) to {percent(errors[high])} (joint {high + 1})"
        if len(errors) > 1:
            text += f", {percent(fit.overall_relative_error)} overall"
    for recording in fit.held_out:
        text += f"; on '{recording.name}', which was held out of the fit, {percent(recording.overall_relative_error)}"
    text += "."
    verdict = fit.verdict
    badge = f"{verdict.state.value.capitalize()}. {fit.status.value.partition(':')[0]}"
    if not fit.converged:
        text = f"{fit.conclusion} {text}"
    return LEVELS[verdict.state], badge, f"{text} {verdict.sentence}"


def well_identified(fit: Identification) -> NDArray[np.bool_]:
    """Return a mask of the well identified parameters, by their relative sigma, (b,)."""
    return np.asarray((fit.std > 0.0) & (fit.relative_std_percent <= WELL_IDENTIFIED_PERCENT))


def tiles(fit: Identification) -> list[tuple[str, str]]:
    """Return the key numbers of a result: value and label."""
    shown = [(percent(fit.overall_relative_error), "torque error, all joints")]
    for use in fit.verdict.uses:
        if use.error is None:
            shown.append(("no", f"good for {use.name}"))
        else:
            value = f"{use.error:.2g} kg" if use.name == "payload" else percent(use.error)
            shown.append((value, f"{use.name}: error to expect"))
    if fit.std.any():
        estimated = sum(role == "estimated" for role in fit.roles)
        shown.append((f"{int(well_identified(fit).sum())} of {estimated}", "parameters well identified"))
    if fit.elapsed > 0.0:
        shown.append((duration(fit.elapsed), "computing time"))
    return shown


def log_tiles(fit: Identification, experiment: Experiment) -> list[tuple[str, str]]:
    """Return rate and filters of the log: value and label."""
    rates = sorted({recording.rate_hz for recording in experiment.recordings})
    shown = [(" and ".join(f"{rate:g} Hz" for rate in rates), "rate of the log")] if len(rates) < 3 else []
    signal = fit.settings.get("signal")
    if signal:
        cutoff = signal.get("cutoff_hz")
        factor = math.prod(signal.get("decimation") or ())
        label = "cut-off" if factor == 1 else f"cut-off, 1 row of {factor} samples"
        shown.append((f"{cutoff:g} Hz" if cutoff else "none", label))
    return shown


def _predictions(fit: Identification, experiment: Experiment) -> tuple[list[Prediction], list[str]]:
    """Return the torques of the fit, or those along the measured motion, with a sentence, if a simulation ends early."""
    silent = [
        recording.name
        for recording in experiment.recordings
        if recording.role == "fit" and recording.tau is None
    ]
    if silent:
        return [], [f"Recording '{silent[0]}' has no torques: there is nothing to compare the model's with."]
    try:
        return predict(fit, experiment), []
    except FitError as reason:
        if fit.method == "idim-ls" or "the simulation" not in str(reason):
            raise
        predictions = predict(fit, experiment, motion="measured")
        return predictions, [f"The torques below are predicted along the measured motion: {reason}."]


def torque_section(fit: Identification, experiment: Experiment, predictions: Sequence[Prediction]) -> Html:
    """Show torques measured and predicted, and their errors per joint."""
    if not predictions:
        return Html("")
    rows = fit.error_rows()
    motion = {
        "measured": "predicted along the filtered measured motion",
        "simulated": "of the closed loop that is simulated with the estimate",
    }[predictions[0].motion]
    decimated = "" if predictions[0].noise_correlation is None else ", filtered and decimated as for the fit"
    content = [
        paragraph(
            f"Measured torques beside those {motion}{decimated}. The relative error is the norm of the difference over the norm "
            "of the measured torque."
        ),
        table(rows[0], aligned_rows(rows[1:], 1), numbers=range(1, len(rows[0]))),
        picture(
            plot.torques(fit, experiment, predictions=predictions),
            "Measured and modelled torque of each joint over time: "
            + ", ".join(
                f"joint {j + 1} {percent(e)} off" for j, e in enumerate(relative_errors(predictions))
            ),
        ),
    ]
    if any(recording.role == "held-out" for recording in experiment.recordings) and fit.held_out:
        held_out = predict(fit, experiment, role="held-out")
        content += [
            paragraph("The recordings that were held out, predicted along their measured motion:"),
            picture(
                plot.torques(fit, experiment, predictions=held_out), "Torques of the recordings held out"
            ),
        ]
    return section("Torques", *content)


def motion_section(experiment: Experiment) -> Html:
    """Show the motion of the log against the limits of the robot."""
    if not any(recording.has_positions for recording in experiment.recordings):
        return Html("")
    return section(
        "Motion",
        paragraph(
            "Filtered position and speed of each joint. Dotted lines are the limits of the robot file; the titles have the shares "
            "of range and speed that the motion uses. Parameters of joints that hardly move are hardly identified."
        ),
        picture(plot.motion(experiment), "Position and speed of each joint over time, with limits"),
    )


def aligned_rows(rows: Sequence[Sequence[str]], first: int) -> list[list[Text]]:
    """Return rows whose columns from `first` on are aligned on the decimal point."""
    cells = [list(column) for column in zip(*rows, strict=True)]
    for number in range(first, len(cells)):
        # The first cell for `aligned` is a heading.
        cells[number] = aligned(["", *cells[number]])[1:]
    return [list(row) for row in zip(*cells, strict=True)]


def _marked(rows: Sequence[Sequence[str]]) -> list[list[Text]]:
    """Return rows of parameters, aligned, with the mark of weak ones as a word."""
    aligned_cells = aligned_rows([row[:-1] for row in rows], 2)
    return [[*cells, row[-1].replace("*", "weak")] for cells, row in zip(aligned_cells, rows, strict=True)]


def parameter_section(
    fit: Identification, experiment: Experiment, predictions: Sequence[Prediction] = ()
) -> Html:
    """Show the parameters, their intervals and their groupings."""
    head, *rows = fit.parameter_rows()
    last = len(head) - 1
    full = _marked(rows)
    origin = "" if fit.uncertainty is None else f" {fit.uncertainty.origin}"
    classes = {
        (number, column): "uncertain"
        for number, row in enumerate(rows)
        if row[last].startswith("*")
        for column in (4, last)
    }
    # A long list is split into two halves side by side.
    # Number of parameters beyond which their table is split into two, side by side.
    half = -(-len(full) // 2) if len(full) > 24 else len(full)
    listing = beside(
        *(
            table(
                list(head),
                full[start : start + half],
                numbers=range(2, last),
                classes={(row - start, column): name for (row, column), name in classes.items()},
            )
            for start in range(0, len(full), half)
        )
    )
    content = [
        paragraph(
            "Base parameters: the combinations that the log identifies, in SI units on the joint side. Sigma is the standard "
            f"deviation of the estimate{origin}; the 95 % interval is the estimate ± {fit.interval_factor():.3g} sigma. "
            "The column / white compares sigma with that of (10), for independent errors: the larger, the more the errors of the "
            f"model count. Weak: not well identified, sigma above {WELL_IDENTIFIED_PERCENT:.0f} %."
        )
    ]
    if fit.std.any():
        standardised = len(predictions) > 0 and predictions[0].measured.any()
        if standardised:
            content.append(
                paragraph(
                    "The picture shows each parameter and its interval in percent of the torque that it explains, of the joint "
                    "where that is most. Parameters that the torques depend on lie far from zero; intervals of those that the log "
                    "leaves open cover zero."
                )
            )
            drawn = plot.parameters(fit, experiment=experiment, predictions=predictions)
        else:
            drawn = plot.parameters(fit)
        content.append(picture(drawn, "Parameters with their 95 % intervals"))
    content.append(listing)
    base = experiment.robot.base_parameters
    if base.names == fit.names:
        lines = [[name, text] for name, text in zip(base.names, base.groupings, strict=True)]
        wide = {(row, 1): "wide" for row in range(len(lines))}
        content.append(
            details("Groupings of the base parameters", table(["parameter", "sum"], lines, classes=wide))
        )
    return section("Parameters", *content)


def further_section(fit: Identification) -> Html:
    """Show the parameters of single logs: payloads, own offsets and friction, drive gains."""
    if fit.further is None or not fit.further.blocks:
        return Html("")
    content = []
    for (title, *notes), (head, *rows) in fit.further.tables(fit.interval_factor()):
        content += [
            paragraph(
                ". ".join([title[0].upper() + title[1:], *(note[0].upper() + note[1:] for note in notes)])
                + "."
            ),
            table(list(head), _marked(rows), numbers=range(2, len(head) - 1)),
        ]
    return section("Parameters of single logs", *content)


def _residual_section(fit: Identification, experiment: Experiment, predictions: Sequence[Prediction]) -> Html:
    if not predictions:
        return Html("")
    spectra = []
    if all(len(prediction.t) >= FEWEST_SPECTRUM_ROWS for prediction in predictions):
        spectra = [
            paragraph(
                "Spectra of the measured torque and of the residual. Noise that is white lies on the grey line; a peak has a cause "
                "that the model lacks, such as the ripple of a gear, and a slope that rises to low frequencies is a model error "
                "that moves with the arm."
            ),
            picture(
                plot.spectra(fit, experiment, predictions=predictions),
                "Spectrum of the residual of each joint",
            ),
        ]
    return section(
        "Residuals",
        paragraph(
            "Measured less modelled torque. Bars inside the grey band, or on the line that decimation gives to white noise, are "
            "those of pure noise, for which sigma holds; bars that stay above it say that the model lacks something."
        ),
        picture(
            plot.residuals(fit, experiment, predictions=predictions),
            "Autocorrelation and distribution of the residual of each joint",
        ),
        *spectra,
    )


def _friction_section(fit: Identification, experiment: Experiment) -> Html:
    """Show friction over speed, if the log has positions and torques."""
    if not any(
        recording.role == "fit" and recording.tau is not None and recording.has_positions
        for recording in experiment.recordings
    ):
        return Html("")
    return section(
        "Friction",
        paragraph(
            "Torque of friction over speed, joint by joint. The points are rows of the log: measured torque less all else that "
            "the model explains along the filtered measured motion. A band shows load friction from light to heavy loads."
        ),
        picture(
            plot.friction(fit, experiment), "Friction of each joint over its speed, with the rows of the log"
        ),
        _at_speeds(fit),
    )


def _at_speeds(fit: Identification) -> Html:
    """Show friction at speeds, where parameters of friction do not say it."""
    cells = [] if fit.uncertainty is None else fit.uncertainty.speed_rows()
    if not cells:
        return Html("")
    head, *rows = cells
    return table(head, rows, numbers=range(2, len(head)))


def _correlation_section(fit: Identification) -> Html:
    names, matrix = estimate_correlation(fit)
    if len(names) < 2:
        return Html("")
    row, column = np.triu_indices(len(names), 1)
    values = matrix[row, column]
    order = np.argsort(-np.abs(values), kind="stable")
    strong = [k for k in order if abs(values[k]) > STRONG_CORRELATION]
    pairs = [
        [names[row[k]], names[column[k]], f"{values[k]:+.3f}"]
        for k in (strong or list(order[:3]))[:MOST_PAIRS]
    ]
    more = f" The {MOST_PAIRS} strongest of {len(strong)} are listed." if len(strong) > MOST_PAIRS else ""
    verb = "is" if len(strong) == 1 else "are"
    return section(
        "Correlation of the estimates",
        paragraph(
            f"{counted(len(strong), 'pair')} of parameters {verb} correlated by more than {STRONG_CORRELATION:g}: only "
            f"their sum or difference is well determined.{more}"
        ),
        table(["parameter", "and", "correlation"], pairs, numbers=(2,)),
        details(
            "Map of all pairs",
            picture(plot.correlation(fit), "Map of the correlation of each pair of estimates"),
        ),
    )


def _convergence_section(fit: Identification) -> Html:
    if not fit.history:
        return Html("")
    content = [paragraph(fit.conclusion)]
    if fit.output_error is not None:
        before, after = fit.output_error
        content.append(
            paragraph(
                f"The simulated torques were off by {percent(before)} with the initial parameters, and are by {percent(after)} "
                f"with the estimate, after {counted(fit.n_simulations, 'simulation')}."
            )
        )
    if len(fit.history) > 2:
        content.append(picture(plot.convergence(fit), "Relative error and step over the iterations"))
    shown = [*fit.history[: MOST_HISTORY_ROWS // 2], *fit.history[-MOST_HISTORY_ROWS // 2 :]]
    shown = list(fit.history) if len(fit.history) <= MOST_HISTORY_ROWS else shown
    keys = list(shown[0].more)
    head = ["iteration", "relative error %", "step %", *(key.replace("_", " ") for key in keys)]
    rows = [
        [
            str(iteration.iteration),
            f"{100.0 * iteration.relative_error:.4f}",
            f"{100.0 * iteration.step:.3g}",
            *(
                f"{iteration.more[key]:.4g}" if np.isfinite(iteration.more.get(key, np.nan)) else "-"
                for key in keys
            ),
        ]
        for iteration in shown
    ]
    content.append(table(head, rows, numbers=range(len(head))))
    return section("Convergence", *content)


def robot_section(experiment: Experiment) -> Html:
    """Show the skeleton of the robot along the first recording."""
    motion = next((recording.q for recording in experiment.recordings if recording.has_positions), None)
    robot = experiment.robot
    geometry = robot.geometry
    rows = [
        [
            robot.joint_label(j).removeprefix("joint "),
            kind,
            *(f"{getattr(geometry, key)[j]:.6g}" for key in ("alpha", "d", "theta", "r")),
        ]
        for j, kind in enumerate(geometry.kinds)
    ]
    head = ["joint", "kind", "alpha (rad)", "d (m)", "theta (rad)", "r (m)"]
    described = f" {robot.description.rstrip('.')}." if robot.description else ""
    return section(
        f"Robot {robot.name}",
        paragraph(
            f"Its skeleton, by the rows of the robot file, in the pose with the longest reach.{described}"
        ),
        beside(
            picture(
                plot.robot(robot, motion=motion),
                f"Skeleton of robot {robot.name} with the axes of its joints",
            ),
            table(head, rows, numbers=range(2, 6)),
        ),
    )


def provenance_section(fit: Identification) -> Html:
    """Show versions, files and settings."""
    versions = [[package, str(version)] for package, version in fit.settings.get("versions", {}).items()]
    files = [[name, digest] for name, digest in fit.digests.items()]
    content = []
    if versions:
        content.append(table(["software", "version"], versions))
    if files:
        classes = {(row, 1): "digest" for row in range(len(files))}
        content.append(table(["file", "SHA-256"], files, classes=classes))
    if fit.delay:
        lines = delay_lines(fit.delay, measured=fit.recorded_motion == "measured") or ["none applied"]
        content.append(paragraph("Delay: " + "; ".join(lines) + "."))
    content.append(
        details(
            "All settings", code(json.dumps(dict(fit.settings), indent=1, ensure_ascii=False, sort_keys=True))
        )
    )
    return section("Where it comes from", *content)
