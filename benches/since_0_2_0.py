"""Show what was wrong in version 0.2.0 and what became of it, row by row, as docs/since_0_2_0.md has it.

    python benches/since_0_2_0.py --old OLD/python [--rows TEXT ...] [--page]

`--old` is the folder that holds the Python package of 0.2.0, with its compiled core:

    git worktree add --detach OLD 56b3385
    cd OLD && cargo build --release --manifest-path rust/python/Cargo.toml --features extension-module
    cp target/release/lib_core.so python/didim/_core.abi3.so

A child process under each version observes each row in an empty folder (`since_rows.py`), and says in a few words what a user
sees. A row is settled where the present version shows the wanted words. `--page` writes the table into the page. The exit status
is 0 when every row is settled now and none was in 0.2.0.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import since_checkout as checkout
import since_commands as commands
import since_python as python

import didim

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "since_0_2_0.md"
UNSEEN = "not observed yet"
HEAD = "| what is looked at | 0.2.0 | now | |"


@dataclass(frozen=True)
class Row:
    """A row of the table: what is looked at, and the words (a regular expression) that settle it."""

    what: str
    observe: Callable[[], str]
    wanted: str

    def settled(self, value: str) -> bool:
        """Whether these words settle the row."""
        return re.fullmatch(self.wanted, value) is not None


ROWS = (
    Row("outputs of `identify` and `study` that are their own inputs", commands.outputs_on_inputs, "0 of .*"),
    Row(
        "rows of a study, edited and damaged",
        commands.rows_of_a_study,
        "edited row dropped and named, damaged one named",
    ),
    Row("`--json` to a name that is not UTF-8, and to a link to itself", commands.odd_names, "0 of .*"),
    Row(
        "`didim robot arm.urdf --snap 0`",
        commands.unsnapped_angles,
        r"(\d+) base parameters, \1 by the robot file",
    ),
    Row("`make wheel` in a shell without the environment", checkout.wheel, "PATH is that of the environment"),
    Row("load friction, torques of the wrong sign", python.load_friction, "a result, with a flag.*"),
    Row("friction picture of two logs, one with a load", python.friction_picture, r"dots 0\.[0-9]+ N.*"),
    Row("`check` on torques that never change", python.dead_torques, "zero: named, constant: named"),
    Row("`check` on a log of 1 kHz with 24 gaps, decimation by 10 and 8", commands.check_of_gaps, "checked"),
    Row(
        "`init` on a log of 1 kHz with jitter, whose motion ends at 0.4 Hz",
        commands.band_of_jitter,
        r"band of 0\.\d+ Hz, decimated",
    ),
    Row(
        "the commands of `didim example tx40` (the tutorial says 0.2589 %)", commands.example, r"0\.2589 %.*"
    ),
    Row("a changed payload by `residual`", python.changed_payload, "its deviation is that of `payload`"),
    Row("position limits of the packaged TX40", python.limits_of_the_tx40, "6 of 6 joints"),
    Row(
        "packaged comparison, seed 0, CLOE by Levenberg and Marquardt",
        python.packaged_comparison,
        r"largest error [0-3]\.\d sigma",
    ),
    Row(
        "a recipe for the digits of others that leaves `ends` to the default says so",
        commands.first_order_ends,
        "said",
    ),
    Row("a test against another solver, kernels of AVX2", checkout.another_solver, r"1 passed.*"),
    Row(
        "a test of a diverging run, `DIDIM_ISA=portable`", checkout.portable_lanes, r"(1 passed|1 skipped).*"
    ),
    Row("random tests with a deadline", checkout.deadlines, "0 files"),
    Row("tests of Ctrl-C in a shell that ignores it", checkout.ignored_interrupt, r"\d+ passed.*"),
    Row(
        "FIFO, /dev/zero, archive of 3 GB, a million columns, 50 000 dots",
        commands.bounds_of_inputs,
        r"(\d) of \1 refused",
    ),
    Row(
        "logs in several files, with decimal commas, columns by numbers",
        commands.signals_in_files,
        r"(\d) of \1 get in",
    ),
    Row("`didim init --gain estimate`", commands.open_gains, "a result"),
    Row("mistakes of a first hour", commands.mistakes, r"(\d) of \1 answered"),
    Row(
        "other friction, a result for its parameters, standard names",
        python.other_friction,
        r"(\d) of \1 answered",
    ),
    Row("gravity compensation", python.gravity, r"didim\.gravity.*"),
    Row("licences and components of what is compiled in", checkout.licences, "(?!none).*"),
    Row("tests that name pages that readers do not have", checkout.pages_elsewhere, "0 test files"),
)


def measure(package: Path, folder: Path, chosen: Sequence[int]) -> dict[str, str]:
    """Observe rows under a package."""
    output = folder / "observed.json"
    environment = os.environ | {
        "PYTHONPATH": str(package),
        "OPENBLAS_NUM_THREADS": "1",
    }
    line = [sys.executable, str(HERE / "since_rows.py"), str(folder), str(output), *map(str, chosen)]
    subprocess.run(line, env=environment, check=True, stdout=subprocess.DEVNULL)
    found: dict[str, str] = json.loads(output.read_text(encoding="utf-8"))
    if Path(found["package"]).parent != package.resolve():
        raise SystemExit(f"the package was taken from {found['package']}, not from {package}")
    return found


def table(chosen: Sequence[int], old: dict[str, str], now: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the table, and sentences on rows that are not settled, or were in 0.2.0."""
    lines, wrong = [HEAD, "|---|---|---|---|"], []
    for index in chosen:
        row, before, after = ROWS[index], old[str(index)], now[str(index)]
        settled = row.settled(after)
        cells = (row.what, before, after, "settled" if settled else "open")
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
        if not settled:
            wrong.append(f"{row.what}: open: {after}")
        if row.settled(before):
            wrong.append(f"{row.what}: settled in 0.2.0 already: {before}")
    return lines, wrong


def page(text: str, lines: Sequence[str]) -> str:
    """Return the page with the lines of a table in their places; rows that were not observed keep theirs."""
    known = {line.split(" | ")[0]: line for line in [*text[text.index(HEAD) :].splitlines(), *lines]}
    kept = [known.get(f"| {row.what}", f"| {row.what} | {UNSEEN} | {UNSEEN} | open |") for row in ROWS]
    return text[: text.index(HEAD)] + "\n".join([*lines[:2], *kept]) + "\n"


def main() -> int:
    """Observe, print the table, and write it into the page if asked to."""
    parser = argparse.ArgumentParser(description="What was wrong in 0.2.0, and what became of it.")
    parser.add_argument("--old", type=Path, required=True, help="folder that holds the package of 0.2.0")
    parser.add_argument("--rows", nargs="+", help="words of the rows; all by default")
    parser.add_argument("--page", action="store_true", help="write the table into docs/since_0_2_0.md")
    options = parser.parse_args()
    chosen = [
        index
        for index, row in enumerate(ROWS)
        if options.rows is None or any(word in row.what for word in options.rows)
    ]
    found = []
    present = Path(didim.__file__).resolve().parent.parent
    for package in (options.old.resolve(), present):
        with tempfile.TemporaryDirectory() as place:
            found.append(measure(package, Path(place), chosen))
    old, now = found
    if old["version"] != "0.2.0":
        raise SystemExit(f"{options.old} holds version {old['version']}, not 0.2.0")
    lines, wrong = table(chosen, old, now)
    print("\n".join([*lines, "", *wrong]))
    if options.page:
        PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), lines), encoding="utf-8")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
