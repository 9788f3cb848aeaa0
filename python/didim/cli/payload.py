"""``didim payload``. Tested in ``tests/test_payload.py``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import Commands, add_command, add_data, add_option
from .outputs import Saved, check_outputs


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "payload",
        run,
        "find mass, centre and inertia of an unknown payload, with a known robot",
        "didim payload fit.json loaded.toml",
    )
    add_option(parser, "fit FIT.json", "result of an identification", Path)
    add_option(parser, "log LOG.toml", "experiment file of the log with the payload", Path)
    add_data(parser)
    add_option(parser, "--link LINK", "link or joint that carries it; needed for a tree")
    add_option(parser, "--json FILE", "also write the payload as JSON", Path)


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..experiment.experiment_file import load_experiment
    from ..result.identification import Identification
    from ..studies.loads.payload import identify_payload

    fit = Identification.load(options.fit)
    check_outputs(options.json)
    payload = identify_payload(fit, load_experiment(options.log, data=options.data), link=options.link)
    saved = Saved()
    saved.save_json(options.json, payload.to_dict())
    return saved.end(str(payload), verdict=payload.verdict)
