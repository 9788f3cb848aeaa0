"""Wrong calls of the commands that estimate, check and begin, and right ones: exit code and last sentence of each.

    python benches/wrong_calls.py [--only WORD ...] [--right N] [--markdown]

Every case is written into an empty folder and run there as a command, as a user types it: a wrong unit, joints in another order, a
load that nobody declared. The logs are simulated from seeds: a Staubli TX40 with the packaged parameters, noise on its torques, and
what the case is about. ``--right N`` adds N right calls from further seeds, none of which may be called wrong. ``--markdown``
prints a Markdown table of all sentences. The package is the one that Python finds, so PYTHONPATH compares versions.
Tested in ``tests/test_wrong_calls.py``, which runs the same cases.

A case of another command is one more entry of `CASES`: a name, a function that writes the files into a folder, and the command.
"""

from __future__ import annotations

import argparse
import functools
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import didim
from didim.robot.payload import flange_in_last_frame, last_link
from didim.robot.rigid_body import body_pseudo_inertia, pose, ten_parameters

Array = NDArray[np.float64]
Write = Callable[[Path], object]
"""Function that writes the files of a case into a folder."""

RATE_HZ = 200.0
"""Sampling rate of the logs (Hz)."""
SECONDS = 8.0
"""Duration of a log (s)."""
NOISE = 0.3
"""Standard deviation of the noise of the torques (N.m), joint side."""
TOOL = ten_parameters(
    body_pseudo_inertia(2.0, np.diag([0.012, 0.010, 0.006]), pose(np.eye(3), np.array([0.03, -0.02, 0.11])))
)
"""Ten parameters about the flange of a tool of 2 kg."""
FREE_SEED, LATER_SEED = 1, 2
"""Seeds of the log of the fit, and of the log that is asked about."""

FILE = """\
schema = 1
name = "{name}"
robot = "tx40"
[friction]
coulomb = "tanh"
smoothing_rad_s = {smoothing}
{friction}
[[recording]]
name = "{name}"
rate_hz = {rate}
{recording}
position = {{ file = "{name}.npz", variable = "q", unit = "{unit}", side = "joint" }}
torque = {{ file = "{name}.npz", variable = "tau", unit = "N.m", side = "joint" }}
[signal]
cutoff_hz = 40
trim_start = 20
trim_end = 20
decimation = [5]
[least_squares]
weights = "per-joint"
{more}"""
"""Experiment file of a log."""
SMOOTHING = 0.05
"""Velocity of the smooth Coulomb friction of the simulated arm (rad/s)."""


class Case(NamedTuple):
    """A call, and the files that it is made with.

    Attributes
    ----------
    name : str
        What is wrong, or right, in a few words.
    write : callable
        Writes the files into an empty folder.
    command : str
        Arguments of `didim` as they are typed in that folder.
    right : bool
        Whether the call is right.
    """

    name: str
    write: Write
    command: str
    right: bool = False


# Logs.


class Log(NamedTuple):
    """A simulated log of a TX40, as it is written into a folder.

    Attributes
    ----------
    seed : int
        Seed of motion and noise.
    tool : (10,) array or None
        Parameters of a load about the flange.
    plant : callable or None
        Changes positions and torques, (n_samples, 6) each, after the log: what was exported wrongly.
    changed : callable or None
        Changes the standard parameters by name: another arm, a cold one.
    unit : str
        Unit of the positions that the file declares.
    recording, friction, more : str
        Further lines of the file: of the recording, of its friction and at the end.
    smoothing : float
        Velocity of the Coulomb friction that the file declares (rad/s).
    """

    seed: int
    tool: Array | None = None
    plant: Callable[[Array, Array], tuple[Array, Array]] | None = None
    changed: Callable[[dict[str, float]], dict[str, float]] | None = None
    unit: str = "rad"
    recording: str = ""
    friction: str = ""
    more: str = ""
    smoothing: float = SMOOTHING
    robot: str = "tx40"

    def write(self, folder: Path, name: str = "log") -> Path:
        """Write data and experiment file, and return the path of the latter."""
        q, tau = self.signals()
        np.savez(folder / f"{name}.npz", q=q, tau=tau)
        text = FILE.format(
            name=name,
            rate=RATE_HZ,
            unit=self.unit,
            recording=self.recording,
            friction=self.friction,
            smoothing=self.smoothing,
            more=self.more,
        )
        path = folder / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return path

    def signals(self) -> tuple[Array, Array]:
        """Return positions and torques as they are written, (n_samples, 6) each."""
        robot = didim.load_robot(self.robot).with_smoothing([SMOOTHING] * 6)
        x = robot.parameter_set("didim" if self.robot == "tx40" else next(iter(robot.sets)))
        if self.changed is not None:
            values = self.changed(dict(zip(robot.parameter_names, x.tolist(), strict=True)))
            x = np.array([values[name] for name in robot.parameter_names])
        if self.tool is not None:
            x = x + last_link(robot, flange_in_last_frame(robot)) @ self.tool
        reference = didim.Reference.random_fourier(
            harmonics=8,
            period_s=SECONDS,
            max_position=[1.5] * 6,
            max_velocity=[3.0] * 6,
            max_acceleration=[12.0] * 6,
            seed=self.seed,
        )
        q, dq, ddq = reference.at(np.arange(0.0, SECONDS, 1.0 / RATE_HZ))
        tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
        tau = tau + np.random.default_rng(self.seed).standard_normal(tau.shape) * NOISE
        return (q, tau) if self.plant is None else self.plant(q, tau)


@functools.cache
def fit_text(tool: bool = False, friction: str = "", smoothing: float = SMOOTHING) -> str:
    """Return the result of the log without a load, or with the tool inside, as JSON; made once in a process."""
    with tempfile.TemporaryDirectory() as folder:
        log = Log(FREE_SEED, tool=TOOL if tool else None, friction=friction, smoothing=smoothing)
        fit = didim.identify(log.write(Path(folder), "free"))
        fit.save(Path(folder) / "fit.json")
        return (Path(folder) / "fit.json").read_text(encoding="utf-8")


def case_of(log: Log, *, tool_inside: bool = False) -> Write:
    """Return the function that writes ``fit.json`` and the log ``log.toml``."""

    def write(folder: Path) -> None:
        (folder / "fit.json").write_text(fit_text(tool_inside), encoding="utf-8")
        log.write(folder)

    return write


def text_of(log: Log) -> Write:
    """Return the function that writes a text with names and time stamps, ``log.csv``."""

    def write(folder: Path) -> None:
        q, tau = log.signals()
        names = ",".join(["t", *(f"{key}{k}" for key in ("q", "tau") for k in range(1, 7))])
        t = np.arange(len(q)) / RATE_HZ
        table = np.column_stack([t, q, tau])
        np.savetxt(folder / "log.csv", table, "%.9g", ",", header=names, comments="")

    return write


def two_files_of(log: Log) -> Write:
    """Return the function that writes positions and torques into two files without names."""

    def write(folder: Path) -> None:
        for name, values in zip(("ang", "torque"), log.signals(), strict=True):
            np.savetxt(folder / f"{name}.txt", values, "%.9g")

    return write


def lines_of(log: Log) -> Write:
    """Return the function that writes each signal of all joints value by value, and the time stamps in a file of their own."""

    def write(folder: Path) -> None:
        q, tau = log.signals()
        for name, values in (("pos", q), ("tau", tau), ("time", np.arange(len(q)) / RATE_HZ)):
            np.savetxt(folder / f"run_{name}.txt", values.reshape(-1, 1), "%.9g")

    return write


def other_robot_of(log: Log) -> Write:
    """Return the function that writes the log with an experiment file that names another robot."""

    def write(folder: Path) -> None:
        path = log.write(folder)
        path.write_text(
            path.read_text(encoding="utf-8").replace('robot = "tx40"', 'robot = "kr16"'), encoding="utf-8"
        )

    return write


# What goes wrong.


def times(factor: float) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Torques in another unit."""
    return lambda q, tau: (q, factor * tau)


def in_degrees(q: Array, tau: Array) -> tuple[Array, Array]:
    """Positions in degrees."""
    return np.degrees(q), tau


def reversed_joints(q: Array, tau: Array) -> tuple[Array, Array]:
    """Columns from the last joint to the first."""
    return q[:, ::-1], tau[:, ::-1]


def exchanged(one: int, other: int) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Torques of two joints exchanged, from 1."""
    order = list(range(6))
    order[one - 1], order[other - 1] = order[other - 1], order[one - 1]
    return lambda q, tau: (q, tau[:, order])


def of_motors(q: Array, tau: Array) -> tuple[Array, Array]:
    """Torques of the motors."""
    return q, tau @ np.linalg.inv(np.array(didim.load_robot("tx40").reduction))


def of_all_motors(q: Array, tau: Array) -> tuple[Array, Array]:
    """Positions and torques of the motors."""
    reduction = np.array(didim.load_robot("tx40").reduction)
    return q @ reduction.T, tau @ np.linalg.inv(reduction)


def geared(ratio: float) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Positions and torques of motors behind gears that no file has."""
    return lambda q, tau: (ratio * q, tau / ratio)


def in_mrad(q: Array, tau: Array) -> tuple[Array, Array]:
    """Positions in milliradians."""
    return 1e3 * q, tau


def noise(q: Array, tau: Array) -> tuple[Array, Array]:
    """Torques of something else."""
    return q, np.random.default_rng(0).standard_normal(tau.shape)


def pushed(q: Array, tau: Array) -> tuple[Array, Array]:
    """A push of 8 N.m against joint 3 for 0.4 s."""
    tau = tau.copy()
    tau[600:680, 2] -= 8.0
    return q, tau


def cold(values: dict[str, float]) -> dict[str, float]:
    """Friction 60 % higher."""
    return {name: 1.6 * value if name.startswith(("Fv", "Fc")) else value for name, value in values.items()}


def heavier(values: dict[str, float]) -> dict[str, float]:
    """Another arm of the same geometry, with masses 40 % larger, and other friction."""
    return {
        name: (0.7 if name.startswith(("Fv", "Fc", "Off")) else 1.4) * value for name, value in values.items()
    }


PAYLOAD, VALIDATE, RESIDUAL = (
    f"{command} fit.json log.toml" for command in ("payload", "validate", "residual")
)
"""The commands of most cases."""

INIT, CHECK = "init tx40 log.csv -o x.toml", "check log.toml"
"""The commands of a first hour."""

GRIPPER = 'payload = "gripper"'
KNOWN = """
[payload.gripper]
mass_kg = 2.0
com_m = [0.03, -0.02, 0.11]
inertia_kg_m2 = [0.012, 0, 0, 0.010, 0, 0.006]
"""

CASES: list[Case] = [
    # The eleven wrong calls.
    Case("torques in mN.m", case_of(Log(LATER_SEED, TOOL, times(1e3))), PAYLOAD),
    Case("degrees read as rad", case_of(Log(LATER_SEED, TOOL, in_degrees)), PAYLOAD),
    Case("rad declared as deg", case_of(Log(LATER_SEED, TOOL, unit="deg")), PAYLOAD),
    Case("joints in reversed order", case_of(Log(LATER_SEED, TOOL, reversed_joints)), PAYLOAD),
    Case("torques of joints 2 and 3 exchanged", case_of(Log(LATER_SEED, TOOL, exchanged(2, 3))), PAYLOAD),
    Case("torques of the motors", case_of(Log(LATER_SEED, TOOL, of_motors)), PAYLOAD),
    Case("the tool is in the model already", case_of(Log(LATER_SEED, TOOL), tool_inside=True), PAYLOAD),
    Case("no load on the flange", case_of(Log(LATER_SEED)), PAYLOAD),
    Case("a log of another robot", case_of(Log(LATER_SEED, TOOL, changed=heavier)), PAYLOAD),
    Case("friction 60 % above that of the fit", case_of(Log(LATER_SEED, TOOL, changed=cold)), PAYLOAD),
    Case("a tool that is not declared", case_of(Log(LATER_SEED, TOOL)), VALIDATE),
    # The same mistakes with the other commands.
    Case("the tool of the model was taken off", case_of(Log(LATER_SEED), tool_inside=True), PAYLOAD),
    Case("torques in mN.m", case_of(Log(LATER_SEED, plant=times(1e3))), VALIDATE),
    Case("degrees read as rad", case_of(Log(LATER_SEED, plant=in_degrees)), VALIDATE),
    Case("joints in reversed order", case_of(Log(LATER_SEED, plant=reversed_joints)), VALIDATE),
    Case("torques of joints 2 and 3 exchanged", case_of(Log(LATER_SEED, plant=exchanged(2, 3))), VALIDATE),
    Case("torques of the motors", case_of(Log(LATER_SEED, plant=of_motors)), VALIDATE),
    Case("a log of another robot", case_of(Log(LATER_SEED, changed=heavier)), VALIDATE),
    Case("torques in mN.m", case_of(Log(LATER_SEED, plant=times(1e3))), RESIDUAL),
    Case("torques of joints 2 and 3 exchanged", case_of(Log(LATER_SEED, plant=exchanged(2, 3))), RESIDUAL),
    Case("a tool that is not declared", case_of(Log(LATER_SEED, TOOL)), RESIDUAL),
    # Ten mistakes that `init` and `check` answer.
    Case("motors behind gears of 100", text_of(Log(LATER_SEED, plant=geared(100.0))), INIT),
    Case("motors by the gears of the robot file", text_of(Log(LATER_SEED, plant=of_all_motors)), INIT),
    Case("torques that are noise", text_of(Log(LATER_SEED, plant=noise)), INIT),
    Case(
        "positions and torques in two files",
        two_files_of(Log(LATER_SEED)),
        "init tx40 ang.txt torque.txt --rate 200 -o x.toml",
    ),
    Case(
        "one value a line in three files",
        lines_of(Log(LATER_SEED)),
        "init tx40 run_pos.txt run_tau.txt run_time.txt -o x.toml",
    ),
    Case("torques in mN.m", case_of(Log(LATER_SEED, plant=times(1e3))), CHECK),
    Case("motors behind gears of 100", case_of(Log(LATER_SEED, plant=geared(100.0))), CHECK),
    Case("positions in mrad", case_of(Log(LATER_SEED, plant=in_mrad)), CHECK),
    Case("joints in reversed order", case_of(Log(LATER_SEED, plant=reversed_joints)), CHECK),
    Case("the file of another included robot", other_robot_of(Log(LATER_SEED)), CHECK),
    # Right calls.
    Case("a log of radians", text_of(Log(LATER_SEED)), INIT, right=True),
    Case("a log of radians", case_of(Log(LATER_SEED)), CHECK, right=True),
    Case("a tool of 2 kg", case_of(Log(LATER_SEED, TOOL)), PAYLOAD, right=True),
    Case("a log without a load", case_of(Log(LATER_SEED)), VALIDATE, right=True),
    Case(
        "a tool that is declared",
        case_of(Log(LATER_SEED, TOOL, recording=GRIPPER, more=KNOWN)),
        VALIDATE,
        right=True,
    ),
    Case("a log without a load", case_of(Log(LATER_SEED)), RESIDUAL, right=True),
    Case("a push of 8 N.m", case_of(Log(LATER_SEED, plant=pushed)), RESIDUAL, right=True),
]
"""All calls."""


def right_calls(count: int) -> Iterator[Case]:
    """Yield further right calls, a payload and a validation of each seed in turn."""
    for seed in range(10, 10 + count):
        if seed % 2:
            yield Case(f"a log without a load, seed {seed}", case_of(Log(seed)), VALIDATE, right=True)
        else:
            tool = TOOL * (0.2 + 0.1 * (seed - 10))
            yield Case(f"a tool, seed {seed}", case_of(Log(seed, tool)), PAYLOAD, right=True)


# Running them.


class Said(NamedTuple):
    """What a command said: exit code, and its last sentence."""

    case: Case
    code: int
    sentence: str

    @property
    def state(self) -> str:
        """Word of the verdict; "refused" for an error, "none" without a verdict."""
        if self.sentence.startswith("Verdict: "):
            return self.sentence.split(": ")[1].split(",")[0]
        if self.case.command.startswith(("init", "check")) and self.code != 2:
            return "found" if self.sentence.startswith("- ") else "sound"
        return "refused" if self.code == 2 else "none"


def sentence_of(out: str, err: str, code: int) -> str:
    """Return the verdict of an output, else the error, else the line of its errors."""
    lines = [line for line in out.splitlines() if line.strip()]
    for line in reversed(lines):
        if line.startswith("Verdict: "):
            return line
    if code == 2:
        return err.strip().splitlines()[-1]
    answers = ("positions are those", "which is not usual", "signals of one recording", "open:")
    of_init = [line for line in [*lines, *err.splitlines()] if any(answer in line for answer in answers)]
    of_check = [line for line in lines if line.startswith("- ")] if "finding" in lines[0] else []
    if of_check or of_init or "nothing found" in lines[0] or "written" in lines[0]:
        first = (of_check or of_init or lines)[0]
        return f"{first}{f' ({len(of_check)} lines)' if len(of_check) > 1 else ''}"
    starts = ("relative error", "torque, predicted", "mass", "no external", "the payload", "external")
    told = [" ".join(line.split()) for line in lines if line.startswith(starts)]
    return f"no verdict; {'; '.join(told)}"


def run(case: Case) -> Said:
    """Run a case in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        case.write(Path(folder))
        done = subprocess.run(
            [sys.executable, "-m", "didim", *shlex.split(case.command)],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONPATH": str(Path(didim.__file__).resolve().parents[1])},
        )
    return Said(case, done.returncode, sentence_of(done.stdout, done.stderr, done.returncode))


def table(all_said: Sequence[Said]) -> str:
    """Return what was said as a table in Markdown."""
    rows = ["| call | command | exit | said |", "|---|---|---|---|"]
    for said in all_said:
        name = f"{said.case.name}{' (right)' if said.case.right else ''}"
        rows.append(f"| {name} | `didim {said.case.command}` | {said.code} | {said.sentence} |")
    return "\n".join(rows)


def main() -> int:
    """Run the cases, and return 1 if a right call is not called sound, or nothing is said against a wrong one."""
    parser = argparse.ArgumentParser(description="Wrong calls of the commands that estimate, and right ones.")
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="cases with one of these words")
    parser.add_argument("--right", type=int, default=0, metavar="N", help="further right calls")
    parser.add_argument("--markdown", action="store_true", help="print a Markdown table of all sentences")
    asked = parser.parse_args()
    all_said = []
    for case in [*CASES, *right_calls(asked.right)]:
        if asked.only and not any(word in f"{case.name}; {case.command}" for word in asked.only):
            continue
        all_said.append(run(case))
        if not asked.markdown:
            said = all_said[-1]
            kind = "right" if case.right else "wrong"
            print(
                f"{kind}, {case.name}: didim {case.command}\n  exit {said.code}: {said.sentence}", flush=True
            )
    if asked.markdown:
        print(table(all_said))
    failed = [
        each
        for each in all_said
        if (each.state != "sound" if each.case.right else each.state in ("sound", "none"))
    ]
    print(f"{len(all_said)} calls, {len(failed)} called the other way", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
