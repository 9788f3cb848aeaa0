"""Robots from URDFs against Pinocchio: random chains by the hundred, and real descriptions.

    python benches/urdf_chains.py [--chains 300] [FILE.urdf ...]

makes a robot of each description as it is written, without snapping, and compares its torques at 100 random states with
Pinocchio's, over the largest torque of the joint. For files it also counts base parameters as written and snapped. The figures are
those of docs/urdf.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

import didim
from didim.errors import RobotError

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from robots import random_motion
from urdfs import pinocchio_model, pinocchio_torques, random_urdf


def main() -> None:
    parser = argparse.ArgumentParser(description="Robots from URDFs against Pinocchio.")
    parser.add_argument("--chains", type=int, default=300, help="random chains (default: %(default)s)")
    parser.add_argument(
        "files", metavar="FILE.urdf", nargs="*", type=Path, help="descriptions to compare as well"
    )
    arguments = parser.parse_args()
    worst: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.urdf"
        for seed in range(arguments.chains):
            rng = np.random.default_rng(seed)
            text, _ = random_urdf(rng, int(rng.integers(1, 9)))
            path.write_text(text)
            worst.append(difference(didim.load_robot(path, snap=0.0), text))
    if worst:
        print(
            f"{len(worst)} random chains: median difference {np.median(worst):.1e}, largest {max(worst):.1e}"
        )
    for file in arguments.files:
        try:
            exact, snapped = didim.load_robot(file, snap=0.0), didim.load_robot(file)
        except RobotError as error:
            print(error)
            continue
        apart = f"{difference(exact, file.read_text()):.1e}" if "urdf" in exact.sets else "no inertias"
        counts = [len(robot.base_parameters.names) for robot in (exact, snapped)]
        print(
            f"{file.name}: {exact.n_dof} joints, difference {apart}, base parameters {counts[0]} as written, {counts[1]} snapped"
        )


def difference(robot: didim.Robot, text: str) -> float:
    """Largest difference to Pinocchio, over the largest torque of the joint."""
    motion = random_motion(np.random.default_rng(1), 100, robot.n_dof)
    for prefix in ("drive", "drake", "controller", "sensor"):  # which Pinocchio wants declared
        text = text.replace(f"{prefix}:", f"{prefix}_")
    model = pinocchio_model(text, robot.joint_names)
    expected = pinocchio_torques(model, robot.joint_names, motion.q, motion.dq, motion.ddq)
    x = robot.parameter_set("urdf").copy()
    x[[name.startswith("F") for name in robot.parameter_names]] = 0.0  # rnea has no friction
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    largest = np.maximum(np.abs(expected).max(axis=0), 1e-6 * np.abs(expected).max())
    return float((np.abs(tau - expected).max(axis=0) / largest).max())


if __name__ == "__main__":
    main()
