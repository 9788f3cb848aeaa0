"""What the rows of `since_0_2_0.py` share: a command of this version, and a log of a planar arm."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim
from didim.loop.controller import Controller
from didim.loop.reference import Reference

Array = NDArray[np.float64]

RATE_HZ = 500.0
TREE = Path(didim.__file__).resolve().parents[2]
"""Checkout that the package belongs to."""
PATIENCE_S = 900.0
"""Longest time of a command; one that waits for ever waits until then."""
ADDRESSES = 3 << 30
"""Address space of a command (bytes), so that one without a bound ends."""

EXPERIMENT = """\
schema = 1
robot = "planar2"
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.02
[[recording]]
name = "log"
rate_hz = 500
position = { file = "log.csv", columns = ["q1", "q2"], unit = "rad", side = "joint" }
torque = { file = "log.csv", columns = ["tau1", "tau2"], unit = "N.m", side = "joint" }
[signal]
cutoff_hz = 40
decimation = [5]
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def traceback(self) -> bool:
        return "Traceback" in self.err

    @property
    def word(self) -> str:
        """How it ended, in a word."""
        if self.code == -1:
            return "waits for ever"
        if self.traceback:
            return f"traceback, {self.err.strip().splitlines()[-1].partition(':')[0]}"
        return {0: "a result", 1: "a result", 2: "refused"}.get(self.code, f"ended by signal {-self.code}")


def run(*words: object, patience_s: float = PATIENCE_S, environment: dict[str, str] | None = None) -> Ended:
    """Run `didim` of this version."""
    line = [sys.executable, "-m", "didim", *map(str, words)]
    limit = partial(resource.setrlimit, resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    with subprocess.Popen(
        line,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        errors="replace",
        preexec_fn=limit,
        env=None if environment is None else os.environ | environment,
    ) as child:
        try:
            out, err = child.communicate(timeout=patience_s)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()
            return Ended(-1, "", "")
        return Ended(child.returncode, out, err)


def module(*names: str) -> Any:
    """Return a module of the package, by the first of its names that there is."""
    for name in names[:-1]:
        try:
            return import_module(f"didim.{name}")
        except ModuleNotFoundError:
            continue
    return import_module(f"didim.{names[-1]}")


@cache
def motion(rate_hz: float = RATE_HZ, duration_s: float = 8.0) -> tuple[Array, Array, Array]:
    """Time, positions and torques of a planar arm in closed loop."""
    robot = smooth()
    rng = np.random.default_rng(2)
    sine, cosine = rng.uniform(-0.25, 0.25, (2, 4, 2))
    reference = Reference.fourier(sine, cosine, period_s=10.0, duration_s=duration_s)
    law = Controller.pd(kp=[900.0, 300.0], kv=[60.0, 20.0])
    found = didim.simulate(robot, robot.parameter_set("reference"), reference, law, rate_hz=rate_hz)
    return found.t, found.q, found.tau


def smooth() -> didim.Robot:
    return didim.load_robot("planar2").with_friction(coulomb="tanh", smoothing_rad_s=0.02)


def table(path: str, names: Sequence[str], *columns: Array, delimiter: str = ",", fmt: str = "%.9g") -> None:
    np.savetxt(
        path,
        np.column_stack(columns),
        fmt=fmt,
        delimiter=delimiter,
        header=delimiter.join(names),
        comments="",
    )


def log(noise: float = 0.1) -> None:
    """Write log.csv and log.toml."""
    t, q, tau = motion()
    tau = tau + noise * np.random.default_rng(0).standard_normal(tau.shape)
    table("log.csv", ("t", "q1", "q2", "tau1", "tau2"), t, q, tau)
    Path("log.toml").write_text(EXPERIMENT, encoding="utf-8")


def arrays(robot: didim.Robot | None = None, tau: Array | None = None) -> didim.Experiment:
    """The log as an experiment in memory."""
    _, q, torque = motion()
    signal = didim.SignalProcessing(cutoff_hz=40.0, trim_start=25, trim_end=25, decimation=(5,))
    noise = 0.05 * np.random.default_rng(0).standard_normal(torque.shape)
    recording = didim.Recording.from_arrays(
        q, torque + noise if tau is None else tau, rate_hz=RATE_HZ, name="log"
    )
    return didim.Experiment(name="log", robot=robot or smooth(), recordings=(recording,), signal=signal)
