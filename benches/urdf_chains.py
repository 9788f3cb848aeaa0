"""Robots from URDFs against Pinocchio: random chains and badly written trees by the hundred, and real descriptions.

    python benches/urdf_chains.py [--chains 300] [--trees 300] [--base] [FILE.urdf or FOLDER ...]

makes a robot of each description as it is written, without snapping, and compares its torques at random states with Pinocchio's,
over the largest torque of the joint. Folders are searched for URDFs, such as that of the package ``example-robot-data``; of those
that are refused the reason is printed. With ``--base`` it also counts base parameters as written and snapped, which takes seconds
for large robots. The figures are those of docs/robots.md.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

import didim
from didim.errors import RobotError, RobotWarning
from didim.robot.transmission import driven_part, joint_motion

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from robots import random_motion
from urdfs import nasty_tree, pinocchio_model, pinocchio_torques, random_urdf


def main() -> None:
    parser = argparse.ArgumentParser(description="Robots from URDFs against Pinocchio.")
    parser.add_argument("--chains", type=int, default=300, help="random chains (default: %(default)s)")
    parser.add_argument("--trees", type=int, default=300, help="badly written trees (default: %(default)s)")
    parser.add_argument("--base", action="store_true", help="count base parameters of the files")
    parser.add_argument(
        "files",
        metavar="PATH",
        nargs="*",
        type=Path,
        help="descriptions, or folders of them, to compare as well",
    )
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", RobotWarning)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "random.urdf"
        worst: list[float] = []
        for seed in range(arguments.chains):
            rng = np.random.default_rng(seed)
            text, _ = random_urdf(rng, int(rng.integers(1, 9)))
            path.write_text(text)
            worst.append(difference(didim.load_robot(path, snap=0.0), text))
        _summary("random chains", worst)
        worst = []
        for seed in range(arguments.trees):
            written, clean = nasty_tree(np.random.default_rng(seed), 2 + seed % 59)
            path.write_text(written)
            worst.append(difference(didim.load_robot(path, snap=0.0, tip=""), clean))
        _summary("badly written trees", worst)
    files = [
        file
        for path in arguments.files
        for file in (sorted(path.rglob("*.urdf")) if path.is_dir() else [path])
    ]
    refused = 0
    for file in files:
        try:
            exact = didim.load_robot(file, snap=0.0)
            text = file.read_text(errors="replace")
            line = f"{file.name}: {exact.n_dof} joints, difference {difference(exact, text):.1e}"
            if arguments.base:
                counts = [len(robot.base_parameters.names) for robot in (exact, didim.load_robot(file))]
                line += f", base parameters {counts[0]} as written, {counts[1]} snapped"
        except RobotError as error:
            refused += 1
            line = f"refused: {error}"
        except ValueError as error:
            line = f"{file.name}: {exact.n_dof} joints, and Pinocchio refuses it: {error}"
        print(line, flush=True)
    if files:
        print(f"{len(files) - refused} of {len(files)} descriptions are robots")


def _summary(what: str, worst: list[float]) -> None:
    if worst:
        print(
            f"{len(worst)} {what}: median difference {np.nanmedian(worst):.1e}, largest {np.nanmax(worst):.1e}",
            flush=True,
        )


def difference(robot: didim.Robot, text: str) -> float:
    """Largest difference to Pinocchio, over the largest torque of the joint; NaN for a robot without inertias."""
    motion = random_motion(np.random.default_rng(1), 20, robot.n_dof)
    text = re.sub(r"^\s+", "", text)
    for prefix in ("drive", "drake", "controller", "sensor"):  # which Pinocchio wants declared
        text = text.replace(f"{prefix}:", f"{prefix}_")
    names, followers = robot.all_joint_names, robot.geometry.followers
    held = {} if robot.correspondence is None else dict(robot.correspondence.lock)
    model = pinocchio_model(text, names, held)
    try:
        x = robot.parameter_set("urdf").copy()
    except RobotError:
        return float("nan")
    q = joint_motion(followers, motion.q, position=True)
    dq, ddq = joint_motion(followers, motion.dq), joint_motion(followers, motion.ddq)
    expected = driven_part(followers, pinocchio_torques(model, names, q, dq, ddq))
    x[[name.startswith("F") for name in robot.parameter_names]] = 0.0  # rnea has no friction
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    largest = np.maximum(np.abs(expected).max(axis=0), 1e-6 * np.abs(expected).max())
    return float((np.abs(tau - expected).max(axis=0) / np.where(largest > 0.0, largest, 1.0)).max())


if __name__ == "__main__":
    main()
