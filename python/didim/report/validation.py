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
    for validated in validation.recordings:
        if np.isfinite(validated.direct_overall):
            tiles.append((percent(validated.direct_overall), f"torque error, predicted, {validated.name}"))
        for name in ("torque", "position"):
            values = validated.simulated.get(name)
            if values is not None and np.isfinite(values).any():
                tiles.append(
                    (
                        percent(float(np.nanmax(values))),
                        f"{name} error, simulated, worst joint, {validated.name}",
                    )
                )
    sections = [
        verdict(
            level, badge, " ".join(_sentence(validated) for validated in validation.recordings), tiles, []
        )
    ]
    by_name = {recording.name: recording for recording in experiment.recordings}
    for validated in validation.recordings:
        sections += _recording_sections(validation, validated, experiment, by_name[validated.name])
    sections += [robot_section(experiment), provenance_section(validation.fit)]
    fit = validation.fit
    title = f"{validation.experiment}: validation of {fit.name}"
    return page(title, f"Robot {fit.robot}, identified by {title_of(fit.method)} from {fit.name}", sections)


def _sentence(recording: RecordingValidation) -> str:
    """Return the sentence on a recording."""
    parts = []
    if np.isfinite(recording.direct_overall):
        parts.append(
            f"the torques predicted along the measured motion are off by {percent(recording.direct_overall)}"
        )
    if recording.outcome is None:
        parts.append("the closed loop is not simulated, because there is no [controller] or no [reference]")
    elif not recording.outcome.completed:
        parts.append(f"the simulated closed loop {recording.outcome}")
    for name, values in recording.simulated.items():
        if name in ("position", "torque") and np.isfinite(values).any():
            parts.append(f"the simulated {name}s are off by {percent(float(np.nanmax(values)))} at most")
    return f"On recording '{recording.name}' {', and '.join(parts)}."


def _recording_sections(
    validation: Validation, validated: RecordingValidation, experiment: Experiment, recording: Recording
) -> list[Html]:
    n = experiment.robot.n_dof
    rows: list[list[Text]] = []
    if validated.direct is not None:
        rows.append(["torque, predicted", *_percents(validated.direct)])
    rows += [[f"{name}, simulated", *_percents(values)] for name, values in validated.simulated.items()]
    head = ["relative error %", *(f"joint {j + 1}" for j in range(n))]
    content = [table(head, rows, numbers=range(1, n + 1))] if rows else []
    if validated.direct is not None:
        measured = tuple(one for one in experiment.recordings if one.has_positions)
        with_positions = replace(experiment, recordings=measured)
        figures = [
            part
            for part in predict(
                validation.fit, with_positions, role="all", motion="measured", as_fitted=False
            )
            if part.recording == validated.name
        ]
        content += [
            paragraph("Torques predicted along the filtered measured motion:"),
            picture(
                plot.torques(validation.fit, experiment, predictions=figures),
                f"Torques of recording {validated.name}, predicted",
            ),
        ]
    if validated.simulated:
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
                    f"{name} of recording {validated.name}, simulated",
                ),
            ]
    return [section(f"Recording {validated.name}", *content)]


def _percents(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> list[str]:
    return [f"{100.0 * value:.4g}" if np.isfinite(value) else "-" for value in values]
