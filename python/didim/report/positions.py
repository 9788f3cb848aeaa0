"""The report of CLOE with known links: verdict, parameters by limb and joint, errors, and the simulated log."""

from __future__ import annotations

import didim.plot as plot

from .._tools.words import counted
from ..experiment.experiment import Experiment
from ..result.identification import Identification
from ..result.positions.record import PositionRecord
from ..result.positions.table import limb_tables, milli, shared_rows
from .fit import LEVELS, provenance_section
from .page import Html, page, paragraph, picture, section, table, verdict


def positions_page(fit: Identification, experiment: Experiment, record: PositionRecord) -> str:
    """Return the report as HTML."""
    judgement = fit.verdict
    status = fit.status.value.partition(":")[0]
    after = max(value for value in record.errors["after"] or [0.0] if value is not None)
    tiles = [
        (f"{1e3 * after:.2g} mrad", "largest error of a joint, rms"),
        (f"{fit.n_iterations}", "iterations"),
        (f"{fit.n_simulations}", "simulations of a limb"),
    ]
    badge = f"{judgement.state.value.capitalize()}. {status}"
    known = {key: values for key in ("before", "after", "held_out") if (values := record.errors.get(key))}
    errors = [
        (experiment.robot.joint_label(joint), *(milli(values[joint]) for values in known.values()))
        for joint in range(experiment.robot.n_dof)
    ]
    shared = shared_rows(record)
    sections = [
        verdict(
            LEVELS[judgement.state],
            badge,
            judgement.sentence,
            tiles,
            [str(reason) for reason in judgement.reasons],
        ),
        section(
            "Parameters",
            paragraph(
                f"Values with their 95 % intervals, by leaving out {record.blocks} {record.kind}. A star marks a value at a bound; "
                "a value in parentheses was held, because this log does not identify it."
            ),
            *(_shown(rows) for rows in limb_tables(record)),
            *([_shown(shared)] if shared else []),
        ),
        section(
            "Errors of positions",
            _shown([("rms error (mrad, mm)", *(key.replace("_", " ") for key in known)), *errors]),
            picture(
                plot.positions(fit, experiment),
                "Positions commanded, measured and simulated of each joint, and their errors",
            ),
        ),
        provenance_section(fit),
    ]
    count = counted(len(record.rows), "parameter")
    return page(
        f"{fit.name}: robot {fit.robot}",
        f"Drives and friction from positions: {count}, links known",
        sections,
    )


def _shown(rows: list[tuple[str, ...]]) -> Html:
    return table(list(rows[0]), [list(row) for row in rows[1:]], numbers=tuple(range(1, len(rows[0]))))
