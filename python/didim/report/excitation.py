"""The report of a designed motion: expected standard deviations, use of each limit, and pictures."""

from __future__ import annotations

import numpy as np

from ..excitation.design import Excitation
from ..excitation.problem import FINE
from ..plot.excitation import motion, swept
from .page import Html, Level, Text, page, paragraph, picture, section, table, verdict


def excitation_page(design: Excitation) -> str:
    """Return the report of a design as HTML."""
    level: Level = "caution" if design.interrupted else "good"
    badge = "Interrupted" if design.interrupted else "Designed"
    largest = max(float(values.max()) for values in design.use.values())
    within = largest <= design.limits.margin * (1.0 + 1e-9)
    limits = (
        f"No limit is exceeded on a grid {FINE} times finer than that of the optimiser, with the margin of "
        f"{100.0 * (1.0 - design.limits.margin):.3g} %."
        if within
        else f"The largest use of a limit is {100.0 * largest:.1f} %."
    )
    unchecked = "" if "torque" in design.use else " Torques were not checked."
    sentence = f"{design.gain[0].upper()}{design.gain[1:]}. {limits}{unchecked}"
    percent = design.relative_std_percent
    tiles = [
        (f"{design.ratio:.2f}", "of the random motion's standard deviations"),
        (f"{design.log_det:.1f}", f"log det of the information, random motion {design.random_log_det:.1f}"),
        (
            f"{design.condition_number:.0f}",
            f"condition number of W, random motion {design.random_condition_number:.0f}",
        ),
    ]
    if percent is not None:
        tiles.append((f"{int((percent < 2.0).sum())} of {len(percent)}", "parameters expected below 2 %"))
    head = ["parameter", "unit", "expected sigma", "random motion", "ratio"] + (
        [] if percent is None else ["sigma %"]
    )
    rows: list[list[Text]] = []
    for k, (name, std, random) in enumerate(zip(design.names, design.std, design.random_std, strict=True)):
        row: list[Text] = [name, design.units[k], f"{std:.3g}", f"{random:.3g}", f"{std / random:.2f}"]
        if percent is not None:
            row.append(f"{percent[k]:.3g}" if np.isfinite(percent[k]) else "-")
        rows.append(row)
    sections = [
        verdict(level, badge, sentence, tiles, [*design.weak(), *design.remarks]),
        _motion_section(design),
        section("Expected standard deviations", table(head, rows, numbers=range(2, len(head)))),
    ]
    subtitle = f"{design.reference.duration:g} s, to be played at {design.settings.rate_hz:g} Hz"
    return page(f"A motion for robot {design.robot.name}", subtitle, sections)


def _motion_section(design: Excitation) -> Html:
    n = design.robot.n_dof
    rows: list[list[Text]] = [
        [kind, *(f"{100.0 * value:.1f}" for value in values)] for kind, values in design.use.items()
    ]
    content = [
        picture(motion(design), "Positions, velocities and torques as shares of their limits"),
        paragraph(
            f"Largest use of each limit, in per cent; the margin leaves {100.0 * design.limits.margin:g} %:"
        ),
        table(["", *(f"joint {j + 1}" for j in range(n))], rows, numbers=range(1, n + 1)),
        picture(swept(design), "Poses that the motion goes through"),
    ]
    if design.nearest is not None:
        name, distance = design.nearest
        content.append(paragraph(f"Nearest: {name}, with {1e3 * distance:.1f} mm to spare."))
    return section("The motion", *content)
