"""The report of a validation: a result on another log, predicted and simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import didim.plot as plot

from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..methods.table import title_of
from ..plot.style import percent
from ..studies.prediction import predict, simulate_window
from ..studies.validation import RecordingValidation, Validation
from .fit import provenance_section, robot_section
from .page import Html, Level, Text, page, paragraph, picture, section, table, verdict


def validation_page(validation: Validation, experiment: Experiment) -> str:
    """Return the report of a validation as HTML."""
    level: Level = "good" if validation.completed else "bad"
    badge = "Validated" if validation.completed else "A simulation ended early"
    tiles = []
    for item in validation.recordings:
        if np.isfinite(item.direct_overall):
            tiles.append((percent(item.direct_overall), f"torque error, predicted, {item.name}"))
        for name in ("torque", "position"):
            values = item.simulated.get(name)
            if values is not None and np.isfinite(values).any():
                tiles.append(
                    (percent(float(np.nanmax(values))), f"{name} error, simulated, worst joint, {item.name}")
                )
    sections = [verdict(level, badge, " ".join(_sentence(item) for item in validation.recordings), tiles, [])]
    by_name = {recording.name: recording for recording in experiment.recordings}
    for item in validation.recordings:
        sections += _recording_sections(validation, item, experiment, by_name[item.name])
    sections += [robot_section(experiment), provenance_section(validation.fit)]
    fit = validation.fit
    title = f"{validation.experiment}: validation of {fit.name}"
    return page(title, f"Robot {fit.robot}, identified by {title_of(fit.method)} from {fit.name}", sections)


def _sentence(item: RecordingValidation) -> str:
    """Return the sentence on a recording."""
    parts = []
    if np.isfinite(item.direct_overall):
        parts.append(
            f"the torques predicted along the measured motion are off by {percent(item.direct_overall)}"
        )
    if item.outcome is None:
        parts.append("the closed loop is not simulated, because there is no [controller] or no [reference]")
    elif not item.outcome.completed:
        parts.append(f"the simulated closed loop {item.outcome}")
    for name, values in item.simulated.items():
        if name in ("position", "torque") and np.isfinite(values).any():
            parts.append(f"the simulated {name}s are off by {percent(float(np.nanmax(values)))} at most")
    return f"On recording '{item.name}' {', and '.join(parts)}."


def _recording_sections(
    validation: Validation, item: RecordingValidation, experiment: Experiment, recording: Recording
) -> list[Html]:
    n = experiment.robot.n_dof
    rows: list[list[Text]] = []
    if item.direct is not None:
        rows.append(["torque, predicted", *_percents(item.direct)])
    rows += [[f"{name}, simulated", *_percents(values)] for name, values in item.simulated.items()]
    head = ["relative error %", *(f"joint {j + 1}" for j in range(n))]
    content = [table(head, rows, numbers=range(1, n + 1))] if rows else []
    if item.direct is not None:
        measured = tuple(one for one in experiment.recordings if one.has_positions)
        with_positions = replace(experiment, recordings=measured)
        found = [
            part
            for part in predict(
                validation.fit, with_positions, role="all", motion="measured", as_fitted=False
            )
            if part.recording == item.name
        ]
        content += [
            paragraph("Torques predicted along the filtered measured motion:"),
            picture(
                plot.torques(validation.fit, experiment, predictions=found),
                f"Torques of recording {item.name}, predicted",
            ),
        ]
    if item.simulated:
        window = recording.windows[0]
        simulation = simulate_window(validation.fit.parameters, experiment, recording, window)
        what = {"q": "Positions"} | ({"tau": "Torques"} if recording.tau is not None else {})
        for key, name in what.items():
            content += [
                paragraph(f"{name} of the simulated closed loop and the log, unfiltered:"),
                picture(
                    plot.overlay(
                        simulation,
                        recording,
                        experiment=experiment,
                        quantity="q" if key == "q" else "tau",
                        start=window[0],
                    ),
                    f"{name} of recording {item.name}, simulated",
                ),
            ]
    return [section(f"Recording {item.name}", *content)]


def _percents(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> list[str]:
    return [f"{100.0 * value:.4g}" if np.isfinite(value) else "-" for value in values]
