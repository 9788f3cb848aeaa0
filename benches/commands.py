"""Processor seconds of whole commands from the start of the process, beside what Python, NumPy and SciPy take to load.

    python benches/commands.py FOLDER [--rounds N]

FOLDER holds the CSV files of the measured TX40 (examples/tx40_log.toml). Each command runs once a round; the smallest of the rounds
counts, user and system time of all threads, with one thread for NumPy's linear algebra. The last column is the time in units of
``import numpy``, which other programs on the machine disturb less than seconds.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "tx40_log.toml"
UNIT = "import numpy"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Processor seconds of whole commands.")
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="CSV files of the measured TX40")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each command (default: %(default)s)")
    arguments = parser.parse_args()
    with TemporaryDirectory() as scratch:
        log = [str(EXAMPLE), "--data", str(arguments.folder.resolve())]
        fit = str(Path(scratch) / "fit.json")
        commands = {
            UNIT: ["-c", "import numpy"],
            "import scipy.signal": ["-c", "import scipy.signal"],
            "identify, idim-ls": ["-m", "didim", "identify", *log, "--method", "idim-ls", "--json", fit],
            "check": ["-m", "didim", "check", *log],
            "validate": ["-m", "didim", "validate", fit, *log],
            "compare, DIDIM alone": ["-m", "didim", "compare", "--method", "didim"],
            "compare, CLOE without simplex": [
                "-m",
                "didim",
                "compare",
                "--method",
                "cloe",
                "--nelder-mead",
                "none",
            ],
        }
        smallest = {
            name: min(seconds(command, scratch) for _ in range(max(1, arguments.rounds)))
            for name, command in commands.items()
        }
    for name, value in smallest.items():
        print(f"{name:30} {value:8.3f} s {value / smallest[UNIT]:8.1f}")
    return 0


def seconds(command: list[str], folder: str) -> float:
    """Processor seconds of a run of Python in a folder; `check` ends with 1 where it finds something."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode > 1:
        raise SystemExit(
            f"commands.py: {' '.join(command)} ended with {done.returncode}: {done.stderr.strip()}"
        )
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    sys.exit(main())
