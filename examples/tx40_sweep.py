"""Vary the recipe of the TX40 log one choice at a time, and judge each by parts of the log left out.

    python examples/tx40_sweep.py --data FOLDER_OF_THE_CSV_FILES

prints the table of docs/published.md in half a minute. The log is cut into six parts of 1.5 s. Each is left out
once: the other five are fitted, and the torques of the part left out are predicted. The arm moves in parts 1
to 5 and rests in part 6.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import didim

EXAMPLES = Path(__file__).parent
PARTS = 6
MOVING = 5
# At a cut the filters have only the extension to go by, where the arm moves: these samples are left out.
TRIM_AT_CUTS = 500
DEAD_ZONES_RAD_S = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)


def recipes(best: didim.Experiment) -> Iterator[tuple[str, didim.Experiment]]:
    """Variants of the experiment of tx40_log_best.toml, each in one choice only, by name."""
    for speed in DEAD_ZONES_RAD_S:
        robot = best.robot.with_friction(dead_zone_rad_s=speed)
        yield f"dead zone of {speed:g} rad/s" if speed else "no dead zone", replace(best, robot=robot)
    once = replace(best.least_squares, reweightings=1)
    yield "0.01 rad/s, weights estimated once", replace(best, least_squares=once)
    choices: dict[str, dict[str, Any]] = {
        "MATLAB's padding": {"padding": "matlab"},
        "transfer function": {"form": "transfer-function"},
        "filter at 30 Hz": {"cutoff_hz": 30.0},
        "filter at 80 Hz": {"cutoff_hz": 80.0},
    }
    for name, change in choices.items():
        yield f"0.01 rad/s, {name}", replace(best, signal=replace(best.signal, **change))


def held_out(experiment: didim.Experiment) -> list[float]:
    """Relative torque error of each part when it is predicted from the others, all joints, in percent."""
    (log,) = experiment.recordings
    signal = replace(experiment.signal, trim_start=TRIM_AT_CUTS, trim_end=TRIM_AT_CUTS)
    edges = [len(log.q) * part // PARTS for part in range(PARTS + 1)]
    found = []
    for start, stop in pairwise(edges):
        others = tuple(window for window in ((0, start), (stop, len(log.q))) if window[0] < window[1])
        fitted = replace(log, name="fitted", windows=others)
        kept_out = replace(log, name="kept out", role="held-out", windows=((start, stop),))
        fit = didim.identify(replace(experiment, recordings=(fitted, kept_out), signal=signal))
        found.append(100.0 * fit.held_out[0].overall_relative_error)
    return found


def row(name: str, experiment: didim.Experiment) -> str:
    """One line of the table, in Markdown."""
    errors = held_out(experiment)
    fit = 100.0 * didim.identify(experiment).overall_relative_error
    mean = sum(errors[:MOVING]) / MOVING
    return line([name, f"{fit:.2f}", f"{mean:.2f}", *(f"{error:.1f}" for error in errors)])


def line(cells: list[str]) -> str:
    """Cells as a line of Markdown."""
    return f"| {' | '.join(cells)} |"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Vary the recipe of the TX40 log.")
    parser.add_argument("--data", type=Path, required=True, help="folder of the two CSV files")
    data = parser.parse_args().data
    parts = [f"part {part}" for part in range(1, PARTS + 1)]
    header = ["recipe", "all fitted", "mean of parts 1 to 5", *parts[:MOVING], f"{parts[MOVING]}, at rest"]
    try:
        best = didim.load_experiment(EXAMPLES / "tx40_log_best.toml", data=data)
        print(line(header), "|" + "---|" * len(header), sep="\n", flush=True)
        for name, experiment in recipes(best):
            print(row(name, experiment), flush=True)
    except didim.DidimError as error:
        print(f"tx40_sweep: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
