"""Simulate a TX40 with an empty flange and with a gripper, and write a log of each: free.csv and loaded.csv.

    python make_logs.py

Tested in ``tests/test_tutorials.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import didim
from didim.robot.payload import flange_in_last_frame, last_link
from didim.robot.rigid_body import body_pseudo_inertia, pose, ten_parameters

FOLDER = Path(__file__).parent
MASS_KG, CENTRE_M = 0.8, (0.02, -0.01, 0.07)
"""Mass of the gripper, and its centre in the frame of the flange."""
MOMENTS_KG_M2 = (0.0015, 0.0012, 0.0008)
"""Its principal moments about the centre, along the axes of the flange."""


def write_logs(folder: Path) -> None:
    """Write both logs into a folder."""
    experiment = didim.load_experiment(FOLDER / "motion.toml")
    robot = experiment.robot
    body = body_pseudo_inertia(MASS_KG, np.diag(MOMENTS_KG_M2), pose(np.eye(3), np.array(CENTRE_M)))
    gripper = last_link(robot, flange_in_last_frame(robot)) @ ten_parameters(body)
    free = robot.parameter_set("didim_physical")
    for seed, name, parameters in ((1, "free.csv", free), (2, "loaded.csv", free + gripper)):
        (log,) = didim.simulated_log(experiment, parameters, seed=seed).recordings
        assert log.tau is not None
        assert log.t is not None
        columns = ["t", *(f"q{j}" for j in range(1, 7)), *(f"tau{j}" for j in range(1, 7))]
        table = np.column_stack([log.t, log.q, log.tau])
        np.savetxt(folder / name, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")


if __name__ == "__main__":
    write_logs(Path.cwd())
