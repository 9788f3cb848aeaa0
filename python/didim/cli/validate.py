"""``didim validate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import (
    CONVERGED,
    NOT_CONVERGED,
    Commands,
    add_command,
    add_experiment,
    add_option,
    add_report,
    check_report,
    refuse,
)
from .outputs import Saved, check_outputs


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "validate",
        run,
        "compare a result with another log: predicted and simulated torques",
        "didim validate fit.json other.toml --report other.html",
        "didim validate fit.json go2.toml --mujoco go2_fit.xml",
    )
    add_option(parser, "fit FIT.json", "result of an identification", Path)
    add_experiment(parser)
    add_option(
        parser,
        "--mujoco ROBOT.xml",
        "replay the log in MuJoCo with this file, and with the robot file: position errors by joint",
        Path,
    )
    add_option(parser, "--step H", "with --mujoco: its step (default: that of the file), s", float)
    add_option(parser, "--json FILE", "also write the errors as JSON", Path)
    add_report(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from .._tools.saved import plain
    from .._tools.words import series
    from ..experiment.experiment_file import load_experiment
    from ..methods.positions.replay import error_lines, horizon_errors, other_gains, position_errors, replayed
    from ..result.identification import Identification
    from ..result.positions.record import PositionRecord
    from ..studies.validation import validate

    fit = Identification.load(options.fit)
    check_report(options)
    check_outputs(options.json, options.report)
    if options.step is not None and (options.mujoco is None or not options.step > 0.0):
        return refuse("--step takes a positive number of seconds, and is for --mujoco")
    if options.mujoco is not None and options.report is not None:
        return refuse("--report is for a validation without --mujoco")
    experiment = load_experiment(options.experiment, data=options.data)
    saved = Saved()
    if options.mujoco is not None:
        from ..studies.in_mujoco import validate_in_mujoco

        replay = validate_in_mujoco(fit, experiment, options.mujoco, step_s=options.step)
        saved.save_json(options.json, replay.to_dict())
        return saved.end(str(replay), CONVERGED if replay.completed else NOT_CONVERGED)
    if PositionRecord.of(fit.settings) is not None:
        # The closed loop of other results has neither held references nor delays.
        if options.report is not None:
            return refuse(
                "--report is not for a result on positions: didim identify --report has its pictures"
            )
        errors, ahead = position_errors(replayed(fit, experiment)), horizon_errors(fit, experiment)
        saved.save_json(options.json, plain({"position_errors": errors, "horizon_errors": ahead}))
        lines = error_lines(errors, ahead)
        if others := other_gains(fit, experiment):
            lines.append(
                f"simulated with {series(others)} of this experiment; the result was fitted with others"
            )
        return saved.end("\n".join(lines))
    validation = validate(fit, experiment)
    saved.save_json(options.json, validation.to_dict())
    saved.save_report(options.report, validation, experiment)
    return saved.end(str(validation), verdict=validation.verdict)
