"""Are errors of trees and coupled joints as large as sigma says? Simulated logs of five robots over many seeds, by three methods.

    python benches/calibration_of_trees.py [--seeds 30] [--methods idim-ls didim cloe] [--robots dual-arm gripper ...]

The palletiser and the dual arm are those of docs/mechanisms.md. The quadruped with its base held, the hand of
four fingers whose tips follow, and the gripper with mimic joints are those of the tests. All logs are two periods of 10 s. One log
has a single realisation of its noise for all of its parameters, so the uncertainty of each figure is that of its mean over seeds.
The deviation of the jackknife has 19 degrees of freedom: of an exact one the rms is sqrt(19 / 17) = 1.06.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim
from didim.experiment.experiment import Experiment
from didim.experiment.specs import Measurement
from didim.methods.method import Method
from didim.studies.simulated_log import measured, simulated_log

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from simulated import closed_loop_log
from test_couplings import gripper
from urdfs import inertial_text, joint_text, legs

Array = NDArray[np.float64]
DOCS = Path(__file__).resolve().parents[1] / "docs"
METHODS: dict[str, Method] = {
    "idim-ls": didim.IDIMLS(),
    "didim": didim.DIDIM(physical=False),
    "cloe": didim.CLOE(start="idim-ls"),
    "didim-physical": didim.DIDIM(physical=True),
    "cloe-physical": didim.CLOE(start="idim-ls", physical=True),
}
NOISE = 0.05
"""Torque noise (N.m) of the robots of the tests."""


def code(page: str, language: str) -> list[str]:
    """Return the blocks of a page in a language."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


def palletiser() -> tuple[Experiment, Array]:
    page: dict[str, Any] = {"__name__": "palletiser"}
    exec(compile(code("mechanisms.md", "python")[-1], "mechanisms.md", "exec", dont_inherit=True), page)
    log = page["simulated"](None)
    return log, page["truth"](log.robot)


def dual_arm() -> tuple[Experiment, Array]:
    robot, planned, *_ = code("mechanisms.md", "toml")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "dual.toml").write_text(robot)
        path = Path(folder) / "dual_log.toml"
        path.write_text(planned.replace("period_s = 10\n", "period_s = 10\nduration_s = 20\n"))
        experiment = didim.load_experiment(path)
    x = experiment.robot.parameter_set("truth")
    return simulated_log(experiment, x, noise=False), x


def hand() -> str:
    """A palm with four fingers that spread and bend; each tip follows its finger."""
    rng = np.random.default_rng(0)
    parts = [f'<link name="palm">{inertial_text(rng)}</link>']
    for k in range(4):
        names = [f"{part}{k}" for part in ("knuckle", "finger", "tip")]
        parts += [f'<link name="{name}">{inertial_text(rng)}</link>' for name in names]
        follow = f'<mimic joint="bend{k}" multiplier="0.7"/>'
        for name, parent, child, xyz, axis, inside in (
            (f"spread{k}", "palm", names[0], (0.0, 0.03 * k, 0.1), (1.0, 0.0, 0.0), ""),
            (f"bend{k}", names[0], names[1], (0.0, 0.0, 0.05), (0.0, 1.0, 0.0), ""),
            (f"curl{k}", names[1], names[2], (0.0, 0.0, 0.1), (0.0, 1.0, 0.0), follow),
        ):
            parts.append(joint_text(name, "revolute", parent, child, xyz=xyz, axis=axis, inside=inside))
    return f'<robot name="hand">{"".join(parts)}</robot>'


def of_urdf(text: str) -> tuple[Experiment, Array]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(text)
        robot = didim.load_robot(path, tip="").with_friction(smoothing_rad_s=0.02, coulomb="tanh")
    x = robot.parameter_set("urdf").copy()
    for j in range(robot.n_dof):
        x[[robot.parameter_names.index(f"{key}{j + 1}") for key in ("Ia", "Fv", "Fc")]] = 0.3, 0.5, 0.2
    log = closed_loop_log(robot, x, duration_s=20.0, period_s=10.0)
    noise = Measurement(torque_noise=(NOISE,) * robot.n_dof, position_noise=(1e-6,) * robot.n_dof, seed=0)
    return replace(log, measurement=noise), x


ROBOTS: dict[str, Callable[[], tuple[Experiment, Array]]] = {
    "dual-arm": dual_arm,
    "quadruped": lambda: of_urdf(legs(4, 3)),
    "hand": lambda: of_urdf(hand()),
    "gripper": lambda: of_urdf(gripper()),
    "palletiser": palletiser,
}


def rms(z: list[Array]) -> str:
    """Root mean square of errors in sigmas, with its standard deviation over seeds."""
    squares = np.mean(np.square(z), axis=1)
    value = float(np.sqrt(squares.mean()))
    return f"{value:.3f} +- {squares.std(ddof=1) / (2.0 * value * np.sqrt(len(squares))):.3f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS)[:3])
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    asked = parser.parse_args()
    print("robot       method          rms z, jackknife  in 95 % interval  rms z, white noise  converged")
    for robot in asked.robots:
        clean, x = ROBOTS[robot]()
        truth = dict(
            zip(clean.robot.base_parameters.names, clean.robot.base_parameters.project(x), strict=True)
        )
        for name in asked.methods:
            by_jackknife, white, inside, converged = [], [], [], 0
            for seed in range(asked.seeds):
                fit = didim.identify(measured(clean, seed), METHODS[name])
                errors = fit.beta - np.array([truth[key] for key in fit.names])
                by_jackknife.append(errors / fit.std)
                white.append(errors / fit.std_white)
                inside.append(np.abs(errors) < fit.interval_factor() * fit.std)
                converged += fit.converged
            share = f"{100.0 * np.mean(inside):13.1f} %"
            print(
                f"{robot:10}  {name:14}  {rms(by_jackknife):16}  {share}  {rms(white):18}  {converged} of {asked.seeds}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
