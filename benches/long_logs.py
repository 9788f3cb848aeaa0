"""How much memory and time does IDIM-LS of a long log take, loaded whole and in pieces?

    python benches/long_logs.py [--rows 100000 1000000] [--whole] [--folder FOLDER]

writes CSV logs of an iiwa14 (7 joints, 1 kHz, 14 columns, 140 bytes a row) into a scratch folder, identifies each in a process
of its own, and prints the largest resident memory of that process, modules included, and its processor seconds. Rows are multiples
of 100 000, the period of the motion. `--whole` loads each log whole besides.
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import didim

PERIOD = 100_000
RATE_HZ = 1000
NOISE = 0.3
"""Standard deviation of the torques (N.m)."""
EXPERIMENT = f"""\
schema = 1
name = "long"
robot = "iiwa14"
[[recording]]
rate_hz = {RATE_HZ}
position = {{ file = "log.csv", columns = [1, 2, 3, 4, 5, 6, 7], unit = "rad", side = "joint" }}
torque = {{ file = "log.csv", columns = [8, 9, 10, 11, 12, 13, 14], unit = "N.m", side = "joint" }}
[signal]
cutoff_hz = 20
decimation = [5, 5]
"""
PIECES = """
import resource, sys
from didim.methods.pieces import fold_log
fold_log(sys.argv[1]).estimate()
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_maxrss / 1024, used.ru_utime + used.ru_stime)
"""
WHOLE = """
import resource, sys
import didim
from didim.methods.idim_ls import IDIMLS
from didim.result.iteration import Reporter
IDIMLS(uncertainty="white").run(didim.load_experiment(sys.argv[1]), Reporter())
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_maxrss / 1024, used.ru_utime + used.ru_stime)
"""


def main() -> None:
    parser = argparse.ArgumentParser(description="Memory and time of IDIM-LS by the rows of a log.")
    parser.add_argument("--rows", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--whole", action="store_true", help="load each log whole besides")
    parser.add_argument("--folder", type=Path, help="where the scratch folder is made (140 bytes a row)")
    arguments = parser.parse_args()
    period = one_period()
    print("| rows | log | | resident, MB | processor, s |\n|---|---|---|---|---|")
    for rows in arguments.rows:
        with TemporaryDirectory(dir=arguments.folder) as scratch:
            size = write(Path(scratch), period, rows)
            for name, program in (("in pieces", PIECES), ("whole", WHOLE)):
                if name == "in pieces" or arguments.whole:
                    memory, seconds = measured(program, Path(scratch, "long.toml"))
                    print(
                        f"| {rows:.0e} | {1e-6 * size:.0f} MB | {name} | {memory:.0f} | {seconds:.1f} |",
                        flush=True,
                    )


def one_period() -> bytes:
    """Return the rows of one period: sums of sines, the torques of a reference robot with noise, as text."""
    robot = didim.load_robot("iiwa14")
    rng = np.random.default_rng(0)
    t = np.arange(PERIOD)[:, None] / RATE_HZ
    omega = 2.0 * np.pi * rng.integers(5, 80, (5, 1, 7)) * RATE_HZ / PERIOD
    phase = omega * t + rng.uniform(0.0, 2.0 * np.pi, (5, 1, 7))
    q = np.sum(0.25 * np.sin(phase), axis=0)
    dq = np.sum(0.25 * omega * np.cos(phase), axis=0)
    ddq = np.sum(-0.25 * omega**2 * np.sin(phase), axis=0)
    x = robot.base_parameters.lift(rng.uniform(0.5, 1.5, len(robot.base_parameters.names)))
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x) + NOISE * rng.standard_normal(q.shape)
    text = io.BytesIO()
    np.savetxt(text, np.column_stack([q, tau]), fmt="%.6f", delimiter=",")
    return text.getvalue()


def write(folder: Path, period: bytes, rows: int) -> int:
    """Write the log and its experiment; return the bytes of the log."""
    (folder / "long.toml").write_text(EXPERIMENT, encoding="utf-8")
    names = [f"{signal}{joint}" for signal in ("q", "tau") for joint in range(1, 8)]
    with (folder / "log.csv").open("wb") as file:
        file.write(f"{','.join(names)}\n".encode())
        for _ in range(rows // PERIOD):
            file.write(period)
        return file.tell()


def measured(program: str, experiment: Path) -> tuple[float, float]:
    """Return the largest resident memory (MB) and the processor seconds of a program on an experiment."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program, str(experiment)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    memory, seconds = map(float, done.stdout.split())
    return memory, seconds


if __name__ == "__main__":
    main()
