"""Show that what was wrong in version 0.1.0 is right now, row by row, and that what was right is as it was.

    python benches/since_0_1_0.py --old FOLDER [--data FOLDER] [--rows 1 9 17]

`--old` is the folder that holds the Python package of 0.1.0, built from its commit:

    git worktree add --detach OLD dc2e129
    cd OLD && cargo build --release --lib --features python,pyo3/extension-module
    cp target/release/libdidim.so python/didim/_core.abi3.so

and then `--old OLD/python`. The logs are made once, by the present version. A child process under each version reads
them, with names that both versions have, and measures one number or one word a row (`since_rows.py`). The exit
status is 0 when every row holds now and none held in 0.1.0, and what must not change is equal.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from since_edges import Value
from since_logs import write_logs
from since_rows import ROWS, Row

import didim

HERE = Path(__file__).resolve().parent
DATA = HERE.parent.parent / "shared" / "data"
SAME = {
    "names": "the 60 names of the base parameters of the TX40",
    "emps": "the EMPS by IDIM-LS: estimates, standard deviations, condition, errors, to 4 decimals",
    "tx40": "the measured TX40 by IDIM-LS: the same, where the documented defaults are given",
}


def measure(package: Path, folder: Path, data: Path, rows: list[int]) -> dict[str, Value]:
    """Run the rows under a package."""
    output = folder / "measured.json"
    environment = {"OPENBLAS_NUM_THREADS": "1"} | os.environ | {"PYTHONPATH": str(package)}
    line = [sys.executable, str(HERE / "since_rows.py"), str(folder), str(data), str(output)]
    subprocess.run([*line, *map(str, rows)], env=environment, check=True, stdout=subprocess.DEVNULL)
    found: dict[str, Value] = json.loads(output.read_text(encoding="utf-8"))
    if Path(str(found["package"])).parent != package.resolve():
        raise SystemExit(f"the package was taken from {found['package']}, not from {package}")
    return found


def text_of(row: Row, value: Value) -> str:
    """Return a measurement as it stands in the table."""
    if isinstance(value, str):
        return value.split(":")[0] if len(value) > 60 else value
    number = f"{value:.3g}" if value else "0"
    return f"{number} {row.unit}".rstrip()


def limit_of(row: Row) -> str:
    return row.limit if isinstance(row.limit, str) else f"{row.limit:g} {row.unit}".rstrip()


def table(rows: list[int], old: dict[str, Value], now: dict[str, Value]) -> tuple[list[str], list[str]]:
    """Return the table, and what is not as it should be."""
    lines = ["| row | what is measured | 0.1.0 | now | limit |", "|---|---|---|---|---|"]
    wrong = []
    for index in rows:
        row = ROWS[index]
        before, after = (found[str(index)] for found in (old, now))
        cells = (row.row, row.what, text_of(row, before), text_of(row, after), limit_of(row))
        lines.append(f"| {' | '.join(cells)} |")
        if not row.holds(after):
            wrong.append(f"row {row.row}, {row.what}: does not hold: {after}")
        if row.holds(before):
            wrong.append(f"row {row.row}, {row.what}: held in 0.1.0 already: {before}")
    for key, what in SAME.items():
        if key in now:
            equal = now[key] == old[key]
            lines.append(f"| same | {what} | | {'equal' if equal else 'different'} | equal |")
            if not equal:
                wrong.append(f"{what}:\n  0.1.0: {old[key]}\n  now:   {now[key]}")
    return lines, wrong


def main() -> int:
    parser = argparse.ArgumentParser(description="What was wrong in 0.1.0, and what has to be as it was.")
    parser.add_argument("--old", type=Path, required=True, help="folder that holds the package of 0.1.0")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the measured logs, emps and tx40")
    parser.add_argument("--rows", nargs="+", help="rows of the table; all by default")
    options = parser.parse_args()
    rows = [index for index, row in enumerate(ROWS) if options.rows is None or row.row in options.rows]
    present = Path(didim.__file__).resolve().parent.parent
    found = []
    with tempfile.TemporaryDirectory() as place:
        logs = Path(place).resolve() / "logs"
        logs.mkdir()
        write_logs(logs)
        for name, package in (("old", options.old.resolve()), ("now", present)):
            folder = logs.with_name(name)
            shutil.copytree(logs, folder)
            found.append(measure(package, folder, options.data.resolve(), rows))
    old, now = found
    if old["version"] != "0.1.0":
        raise SystemExit(f"{options.old} holds version {old['version']}, not 0.1.0")
    lines, wrong = table(rows, old, now)
    print("\n".join(lines))
    if wrong:
        print("\n" + "\n".join(wrong))
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
