"""Speed beside other programs in one run, on the same TX40.

    python benches/peers.py [--json FILE] [--data FOLDER]
    python benches/peers.py --arm FOLDER

needs ``pip install --group peers`` and gcc; what is absent is left out, and said. FOLDER holds the CSV files of the measured TX40
(examples/tx40_log.toml). Before anything is timed, each peer must compute what ours computes. Then every round measures each
contestant once, so that a machine that slows down slows all of them. The ratios are what to look at, of the smallest times and
of the medians: on a busy machine the first say more, and they are held against what is wanted. Peers have links and rotors;
ours has the friction and the coupled wrist as well. What else differs stands in the peer's file in ``benches/peer/``.

The second prints how well motions of a real hobby arm are met that neither program was fitted on, and what the fits took; each is
a subfolder with state_motor.csv and control.csv, beside so101_new_calib.xml.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from peer.threads import THREADS  # before NumPy is imported

# isort: split
import numpy as np
from peer import (
    against_casadi,
    against_figaroh,
    against_mujoco,
    against_pinocchio,
    against_scipy,
    hobby_arm,
    ours,
    whole_runs,
)
from peer.goals import GOALS, Goal
from peer.task import tx40
from peer.timing import Contestant, DisagreementError, Figures, MissingError, alternate

import didim

ROUNDS, LONG_ROUNDS, LONGEST_ROUNDS = 41, 5, 3
"""Rounds of measurements that take microseconds, of whole runs, and of figaroh."""


def main() -> int:
    """Print times and ratios."""
    parser = argparse.ArgumentParser(description="Time didim beside other programs.")
    parser.add_argument(
        "--json", metavar="FILE", type=Path, help="also write everything, every round too, as JSON"
    )
    parser.add_argument(
        "--data", metavar="FOLDER", type=Path, help="where the CSV files of the measured TX40 are"
    )
    parser.add_argument(
        "--arm", metavar="FOLDER", type=Path, help="motions of an SO-101; nothing else is measured"
    )
    parser.add_argument(
        "--rounds", type=int, default=ROUNDS, help="rounds of short calls (default: %(default)s)"
    )
    parser.add_argument("--quick", action="store_true", help="one round, and no run that takes seconds")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error(f"--rounds must be at least 1, got {arguments.rounds}")
    for name in ("motor_position.csv", "motor_torque.csv"):
        if arguments.data is not None and not (arguments.data / name).is_file():
            parser.error(f"--data: there is no {name} in {arguments.data}")
    if arguments.arm is not None:
        if not (arguments.arm / hobby_arm.FILE).is_file():
            parser.error(f"--arm: there is no {hobby_arm.FILE} in {arguments.arm}")
        try:
            hobby_arm.tell(arguments.arm)
        except MissingError as reason:
            print(f"peers.py: {reason}", file=sys.stderr)
            return 1
        return 0
    try:
        found, versions, skipped = contestants(arguments.data, arguments.rounds, quick=arguments.quick)
    except DisagreementError as reason:
        print(f"peers.py: {reason}", file=sys.stderr)
        return 1
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    figures = alternate(found)
    tell(figures, versions, skipped)
    if arguments.json is not None:
        arguments.json.write_text(
            json.dumps(record(figures, versions, skipped, load), indent=2) + "\n", encoding="utf-8"
        )
    return 0


def contestants(
    data: Path | None, rounds: int, *, quick: bool
) -> tuple[list[Contestant], dict[str, str], list[str]]:
    """Return what is measured, versions, and a sentence for each peer that is not there."""
    task = tx40()
    if quick:
        rounds = 1
    long, longest = min(rounds, LONG_ROUNDS), min(rounds, LONGEST_ROUNDS)
    found = ours.contestants(task, rounds)
    versions = {"didim": didim.__version__, "python": platform.python_version(), "numpy": np.__version__}
    skipped = []
    peers: list[tuple[str, Any, Callable[[], list[Contestant]]]] = [
        ("Pinocchio", against_pinocchio, lambda: against_pinocchio.contestants(task, rounds)),
        ("CasADi", against_casadi, lambda: against_casadi.contestants(task, rounds)),
        ("MuJoCo", against_mujoco, lambda: against_mujoco.contestants(task, rounds)),
        ("SciPy", against_scipy, lambda: against_scipy.contestants(task, rounds, quick=quick)),
    ]
    if not quick:
        peers.append(("figaroh", against_figaroh, lambda: against_figaroh.contestants(task, data, longest)))
    for name, module, make in peers:
        try:
            found += make()
            versions |= module.versions()
        except MissingError as reason:
            skipped.append(f"{name} is left out: {reason}")
    if data is None:
        skipped.append(f"IDIM-LS on the measured TX40 is left out: {whole_runs.NO_DATA}")
    return found + whole_runs.contestants(data, long, quick=quick), versions, skipped


def tell(figures: Mapping[str, Figures], versions: Mapping[str, str], skipped: list[str]) -> None:
    """Print the tables."""
    print(
        f"{cpu()}, {os.cpu_count()} cores; {', '.join(f'{name} {value}' for name, value in versions.items())}"
    )
    print(f"{', '.join(f'{name}={value}' for name, value in THREADS.items())}\n")
    for sentence in skipped:
        print(sentence)
    width = max(len(name) for name in [*figures, *(goal.text for goal in GOALS)])
    print(f"\n{'':{width}}  {'smallest':>9} {'median':>9}   quartiles")
    for name, figure in figures.items():
        low, high = figure.spread
        print(
            f"{name:{width}}  {figure.smallest:9.4g} {figure.median:9.4g}   {low:.4g} to {high:.4g} {figure.unit}"
            f" ({len(figure.rounds)} rounds)"
        )
    print(f"\n{'':{width}}  {'smallest':>9} {'median':>9}   wanted (of the smallest)")
    for goal in GOALS:
        if goal.known(figures):
            median, smallest = goal.values(figures)
            print(f"{goal.text:{width}}  {smallest:9.3g} {median:9.3g}   {_wanted(goal, smallest)}".rstrip())


def _wanted(goal: Goal, smallest: float) -> str:
    if goal.wanted is None:
        return ""
    limit = "at most" if goal.over is None else "at least"
    return f"{limit} {goal.wanted:g}: {'yes' if goal.met(smallest) else 'no'}"


def record(
    figures: Mapping[str, Figures], versions: Mapping[str, str], skipped: list[str], load: float | None
) -> dict[str, Any]:
    """Return everything as JSON has it."""
    ratios = {}
    for goal in GOALS:
        if goal.known(figures):
            median, smallest = goal.values(figures)
            ratios[goal.text] = {
                "median": median,
                "smallest": smallest,
                "wanted": goal.wanted,
                "at_least": goal.over is not None,
                "met_by_median": goal.met(median),
                "met_by_smallest": goal.met(smallest),
            }
    return {
        "machine": {
            "cpu": cpu(),
            "cores": os.cpu_count(),
            "system": platform.platform(),
            "load_at_start": load,
        },
        "versions": dict(versions),
        "threads": THREADS,
        "skipped": skipped,
        "contestants": {
            name: {
                "unit": figure.unit,
                "smallest": figure.smallest,
                "median": figure.median,
                "quartiles": figure.spread,
                "rounds": figure.rounds,
            }
            for name, figure in figures.items()
        },
        "ratios": ratios,
    }


def cpu() -> str:
    """Name of the processor."""
    information = Path("/proc/cpuinfo")
    if information.is_file():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    sys.exit(main())
