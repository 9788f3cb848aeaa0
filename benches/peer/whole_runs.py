"""Our whole runs, each in a process of its own: IDIM-LS on the measured TX40, DIDIM on the simulated one, memory, import."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from .timing import Contestant, one_core

SCRIPT = Path(__file__).with_name("run_alone.py")
EXPERIMENT = SCRIPT.parent.parent.parent / "examples" / "tx40_log.toml"

NO_DATA = (
    "no folder with motor_position.csv and motor_torque.csv of the measured TX40 is given (--data FOLDER)."
)


def contestants(data: Path | None, rounds: int, *, quick: bool) -> list[Contestant]:
    """Seconds and megabytes of whole runs."""
    imports = _Run("import")
    found = [
        _seconds("import didim, beyond NumPy", imports.value("s"), rounds),
        _seconds("import of what IDIM-LS needs, beyond NumPy", imports.last("idim-ls"), rounds),
    ]
    runs: list[tuple[str, list[str]]] = []
    if not quick:
        runs.append(("DIDIM, simulated TX40", ["didim"]))
    if data is not None:
        runs.append(("IDIM-LS, TX40 log", ["idim-ls", str(EXPERIMENT), str(data)]))
    for name, arguments in runs:
        for cores in ("both cores", "one core"):
            run = _Run(*arguments, alone=cores == "one core")
            found.append(_seconds(f"{name}, {cores}", run.value("first"), rounds))
            found.append(_seconds(f"{name}, {cores}, once more", run.last("again"), rounds))
            if arguments[0] == "idim-ls":
                found.append(_seconds(f"{name}, {cores}, numerics", run.last("numerics"), rounds))
                found.append(
                    _seconds(f"{name}, {cores}, numerics once more", run.last("numerics again"), rounds)
                )
    if data is not None:
        memory = _Run("memory", str(EXPERIMENT), str(data)).value("MB")
        found.append(
            Contestant(
                name="IDIM-LS, TX40 log, peak memory", measure=memory, unit="MB", rounds=min(rounds, 3)
            )
        )
    return found


class _Run:
    """A process, and the last output of one."""

    def __init__(self, *arguments: str, alone: bool = False) -> None:
        self.arguments, self.alone = arguments, alone
        self.result: dict[str, float] = {}

    def value(self, key: str) -> Any:
        """Run it, and return one of its numbers."""

        def measure() -> float:
            with one_core() if self.alone else nullcontext():
                done = subprocess.run(
                    [sys.executable, str(SCRIPT), *self.arguments],
                    capture_output=True,
                    text=True,
                    check=False,
                )
            if done.returncode:
                raise SystemExit(f"{SCRIPT.name} {self.arguments[0]} failed: {done.stderr.strip()}")
            self.result = json.loads(done.stdout)
            return self.result[key]

        return measure

    def last(self, key: str) -> Any:
        """Return another number of the run before."""
        return lambda: self.result[key]


def _seconds(name: str, measure: Any, rounds: int) -> Contestant:
    return Contestant(name=name, measure=measure, unit="s", rounds=rounds)
