"""Simulate a UR10e that is not quite its URDF, and write two logs of it as a driver writes them: log.csv and other.csv.

    python make_logs.py

The robot is heavier than its URDF; it has rotors, friction, and a tool that the URDF does not have. The driver sorts its
columns by the names of the joints, elbow first. Tested in ``tests/test_ur10e_page.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
HEAVIER = (1.0, 1.12, 0.9, 1.1, 1.0, 1.0)
"""Masses and inertias of the links as multiples of those of the URDF."""
TOOL_KG, TOOL_AT_M, TOOL_INERTIA = 1.5, np.array([0.0, 0.02, 0.12]), 0.003
"""A ball on the last link, in frame 6: mass, centre, inertia about the centre (kg.m^2)."""
FURTHER = {
    "Ia": (2.5, 2.5, 1.6, 0.5, 0.5, 0.45),
    "Fv": (14.0, 14.0, 10.0, 3.0, 3.0, 3.0),
    "Fc": (9.0, 10.0, 7.0, 2.5, 2.4, 2.2),
    "Off": (0.3, -0.2, 0.1, 0.05, 0.0, 0.05),
}
"""Rotor inertias and friction by joint: kg.m^2, N.m.s/rad, N.m."""


def true_parameters(robot: didim.Robot) -> Array:
    """Return the standard parameters of the robot that is simulated."""
    x = robot.parameter_set("urdf").copy()
    at = {name: index for index, name in enumerate(robot.parameter_names)}
    for j in range(6):
        x[at[f"XX{j + 1}"] : at[f"M{j + 1}"] + 1] *= HEAVIER[j]
        for name, values in FURTHER.items():
            x[at[f"{name}{j + 1}"]] = values[j]
    # XX, XY, XZ, YY, YZ, ZZ about the origin of the frame, first moments, mass.
    about = TOOL_KG * (TOOL_AT_M @ TOOL_AT_M * np.eye(3) - np.outer(TOOL_AT_M, TOOL_AT_M))
    inertia = (TOOL_INERTIA * np.eye(3) + about)[np.triu_indices(3)]
    x[at["XX6"] : at["M6"] + 1] += [*inertia, *(TOOL_KG * TOOL_AT_M), TOOL_KG]
    return x


def write_logs(folder: Path) -> None:
    """Write both logs into a folder."""
    for motion, name in (("motion.toml", "log.csv"), ("other_motion.toml", "other.csv")):
        experiment = didim.load_experiment(FOLDER / motion)
        robot = experiment.robot
        (log,) = didim.simulated_log(experiment, true_parameters(robot)).recordings
        assert log.tau is not None
        assert log.t is not None
        columns = {"time": log.t}
        for joint in sorted(robot.joint_names):
            k = robot.joint_names.index(joint)
            columns |= {f"{joint}_position": log.q[:, k], f"{joint}_effort": log.tau[:, k]}
        table, head = np.column_stack(list(columns.values())), ",".join(columns)
        np.savetxt(folder / name, table, fmt="%.9g", delimiter=",", header=head, comments="")


if __name__ == "__main__":
    write_logs(Path.cwd())
