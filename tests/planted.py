"""Simulated logs written as files, with defects planted, for tests of `didim check` and `didim init`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from didim.experiment.experiment import Experiment
from didim.studies.simulated_log import measured, packaged_experiment, simulated_log

Array = NDArray[np.float64]

SIGNAL = """
[signal]
cutoff_hz = 60
trim_start = 50
trim_end = 50
decimation = [5, 10]
"""


@dataclass(frozen=True, eq=False)
class Log:
    """What is written: time stamps, positions and torques, and what the experiment file says of them."""

    t: Array
    q: Array
    tau: Array
    robot: str = "tx40"
    rate_hz: float | None = 1000.0
    unit: str = "rad"
    side: str = "joint"
    timed: bool = True
    more: str = ""
    signal: str = SIGNAL

    def write(self, folder: Path, name: str = "log") -> Path:
        n = self.q.shape[1]
        names = ["t", *(f"q{k + 1}" for k in range(n)), *(f"tau{k + 1}" for k in range(n))]
        np.savetxt(
            folder / f"{name}.csv",
            np.column_stack([self.t, self.q, self.tau]),
            fmt="%.12g",
            delimiter=",",
            header=",".join(names),
            comments="",
        )
        lines = ["schema = 1", f'name = "{name}"', f'robot = "{self.robot}"', self.more]
        lines += ["[friction]", 'coulomb = "tanh"', "smoothing_rad_s = 0.01"]
        lines += ["[[recording]]", f'name = "{name}"']
        if self.rate_hz is not None:
            lines.append(f"rate_hz = {self.rate_hz!r}")
        source = f'file = "{name}.csv"'
        if self.timed:
            lines += ["[recording.time]", source, 'columns = ["t"]', 'unit = "s"']
        for table, key, unit in (("position", "q", self.unit), ("torque", "tau", "N.m")):
            columns = ", ".join(f'"{key}{k + 1}"' for k in range(n))
            lines += [f"[recording.{table}]", source, f"columns = [{columns}]"]
            lines += [f'unit = "{unit}"', f'side = "{self.side}"']
        path = folder / f"{name}.toml"
        path.write_text("\n".join(lines) + self.signal, encoding="utf-8")
        return path

    def change(self, plant: Callable[[Array, Array], object]) -> Log:
        """Return the log with positions and torques that a function has changed in place."""
        q, tau = self.q.copy(), self.tau.copy()
        plant(q, tau)
        return replace(self, q=q, tau=tau)


def tx40_exact() -> Experiment:
    """The paper's experiment, without noise."""
    experiment = packaged_experiment("tx40")
    return simulated_log(experiment, experiment.robot.parameter_set("didim"), noise=False)


def log_of(experiment: Experiment, seed: int | None = None, robot: str = "tx40") -> Log:
    """The log of a simulation, with noise of a seed."""
    (recording,) = measured(experiment, seed).recordings
    assert recording.tau is not None
    return Log(t=recording.t, q=recording.q, tau=recording.tau, robot=robot, rate_hz=recording.rate_hz)


def with_torques(log: Experiment, tau: Array) -> Experiment:
    """The log with other torques."""
    (recording,) = log.recordings
    return replace(log, recordings=(replace(recording, tau=tau),))
