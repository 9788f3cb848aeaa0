"""A simulated UR10e that is not quite its URDF: heavier, with rotors, friction and a tool; and logs as a driver writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim
from didim.cli.main import main
from didim.robot.rigid_body import body_pseudo_inertia, pose, ten_parameters
from didim.robot.robot import Robot

Array = NDArray[np.float64]

ROTORS = (2.5, 2.5, 1.6, 0.5, 0.5, 0.45)
VISCOUS = (14.0, 14.0, 10.0, 3.0, 3.0, 3.0)
COULOMB = (9.0, 10.0, 7.0, 2.5, 2.4, 2.2)
OFFSETS = (0.3, -0.2, 0.1, 0.05, 0.0, 0.05)
HEAVIER = (1.0, 1.12, 0.9, 1.1, 1.0, 1.0)
"""Links of the robot, over those of its URDF."""
TOOL_KG, TOOL_AT_M = 1.5, (0.0, 0.02, 0.12)
"""A tool on the last link, in frame 6: the URDF has none."""

MOTION = """schema = 1
name = "ur10e, simulated"
robot = "ur10e.urdf"

[reference]
kind = "fourier"
period_s = 20
harmonics = 10
seed = {seed}
max_position_rad = [2.5, 1.5, 2.2, 2.5, 2.5, 2.5]
max_velocity_rad_s = [1.8, 1.8, 2.5, 2.8, 2.8, 2.8]
max_acceleration_rad_s2 = [8, 8, 12, 15, 15, 15]

[controller]
kind = "pd"
natural_frequency_hz = [14, 12, 15, 60, 120, 300]
damping = 0.7
inertia_of = "urdf"

[simulation]
rate_hz = 500
smoothing_rad_s = 0.01

[measurement]
torque_noise_n_m = [1, 1, 0.6, 0.2, 0.2, 0.2]
position_noise_rad = 2e-6
seed = {seed}
"""


def true_parameters(robot: Robot) -> Array:
    """Standard parameters of the robot that is simulated."""
    x = robot.parameter_set("urdf").copy()
    at = robot.parameter_names.index
    for j in range(6):
        first = at(f"XX{j + 1}")
        x[first : first + 10] *= HEAVIER[j]
        for key, values in (("Ia", ROTORS), ("Fv", VISCOUS), ("Fc", COULOMB), ("Off", OFFSETS)):
            x[at(f"{key}{j + 1}")] = values[j]
    tool = body_pseudo_inertia(TOOL_KG, 0.003 * np.eye(3), pose(np.eye(3), TOOL_AT_M))
    x[first : first + 10] += ten_parameters(tool)
    return x


def write_logs(urdf: Path, folder: Path) -> None:
    """Write ``ur10e.urdf``, ``log.csv`` and ``other.csv``; the columns are those of a driver that sorts joints by name."""
    (folder / "ur10e.urdf").write_bytes(urdf.read_bytes())
    robot = didim.load_robot(folder / "ur10e.urdf")
    x = true_parameters(robot)
    values = "".join(
        f"{name} = {value!r}\n" for name, value in zip(robot.parameter_names, x.tolist(), strict=True)
    )
    (folder / "truth.toml").write_text(f"[parameters.truth]\n{values}")
    for seed, name in ((1, "log"), (2, "other")):
        (folder / "motion.toml").write_text(MOTION.format(seed=seed))
        parameters = ["--parameters", str(folder / "truth.toml"), "-o", str(folder / "run.csv")]
        assert main(["simulate", str(folder / "motion.toml"), *parameters]) == 0
        with (folder / "run.csv").open() as file:
            names = file.readline().strip().split(",")
            columns = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
        head, table = ["time"], [columns["t"]]
        for joint in sorted(robot.joint_names):
            k = robot.joint_names.index(joint) + 1
            head += [f"{joint}_position", f"{joint}_effort"]
            table += [columns[f"q{k}"], columns[f"tau{k}"]]
        np.savetxt(
            folder / f"{name}.csv",
            np.column_stack(table),
            fmt="%.9g",
            delimiter=",",
            header=",".join(head),
            comments="",
        )
    for name in ("truth.toml", "motion.toml", "run.csv"):
        (folder / name).unlink()
