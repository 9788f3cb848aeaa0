"""Simulate a quadruped whose drives are not those of its MJCF, and write two logs of it: log.csv and other.csv.

    python make_logs.py

The trunk is on a rack; the motors hold each commanded position with a PD law until the next one comes. Needs MuJoCo: pip install
'didim[mujoco]'. Tested in ``tests/test_in_mujoco.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from didim.studies.mujoco_model import load_model

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
RATE_HZ, STEP_S = 200, 5e-4
"""Samples per second of the logs, and the time step of the simulation (s)."""
KP, KV, DELAY_S = 20.0, 0.5, 0.006
"""Gains of the motors (N.m/rad, N.m.s/rad), and the time after which they follow a command."""
TRUTH = {
    "abduction": {"armature": 0.008, "damping": 0.05, "frictionloss": 0.15},
    "hip": {"armature": 0.008, "damping": 0.06, "frictionloss": 0.2},
    "knee": {"armature": 0.02, "damping": 0.12, "frictionloss": 0.4},
}
"""Drives of the joints of a leg (kg.m^2, N.m.s/rad, N.m)."""
WORN = "RL_knee"
"""Joint with twice the friction loss."""
POSE = (0.0, 0.7, -1.5)
"""Middle of the motion of a leg (rad)."""
NOISE_RAD = 1e-4
"""Standard deviation of the noise of the encoders."""


def true_model() -> Any:
    """Return the robot that is simulated: the MJCF on a rack, with the drives of `TRUTH`."""
    model = load_model(FOLDER / "quadruped.xml")
    for dof in range(model.njnt):
        name = model.joint(dof).name
        drive = TRUTH[name.split("_")[1]]
        model.dof_armature[dof], model.dof_damping[dof] = drive["armature"], drive["damping"]
        model.dof_frictionloss[dof] = drive["frictionloss"] * (2.0 if name == WORN else 1.0)
    # Motors become servos, which hold a position up to the largest torque.
    model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1:3] = KP, (-KP, -KV)
    model.actuator_forcelimited[:], model.actuator_forcerange[:] = True, model.actuator_ctrlrange
    model.actuator_ctrllimited[:] = False
    model.opt.timestep, model.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_RK4
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def commands(rng: np.random.Generator, seconds: float) -> Array:
    """Return commanded positions, (n_samples, 12): half waves that become faster, half jumps of random size."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    fastest = rng.uniform(2.0, 4.0, 12)
    phase = 2.0 * np.pi * np.outer(0.3 * t + 0.5 * t**2 / seconds, 0.5 * fastest) + rng.uniform(0.0, 6.0, 12)
    jumps = np.repeat(rng.uniform(-0.3, 0.3, (round(2.5 * seconds), 12)), round(RATE_HZ / 2.5), axis=0)
    begin = np.minimum(t, 1.0)[:, None]  # from rest
    return np.asarray(
        np.tile(POSE, 4) + begin * np.where((t % 4.0 < 2.0)[:, None], 0.35 * np.sin(phase), jumps)
    )


def followed(model: Any, r: Array) -> Array:
    """Return the positions of servos that follow commands late, at the samples of the log, (n_samples, 12)."""
    data = mujoco.MjData(model)
    data.qpos[:] = r[0]
    steps, late = round(1.0 / (RATE_HZ * STEP_S)), round(DELAY_S / STEP_S)
    q = np.empty_like(r)
    for k in range(len(r) * steps):
        if k % steps == 0:
            q[k // steps] = data.qpos
        data.ctrl[:] = r[max(k - late, 0) // steps]
        mujoco.mj_step(model, data)
    return q


def write_logs(folder: Path) -> None:
    """Write both logs into a folder: commanded and measured positions in rad."""
    model = true_model()
    joints = [model.joint(dof).name for dof in range(model.njnt)]
    for seed, seconds, name in ((1, 12.0, "log.csv"), (2, 6.0, "other.csv")):
        rng = np.random.default_rng(seed)
        r = commands(rng, seconds)
        q = followed(model, r) + NOISE_RAD * rng.standard_normal(r.shape)
        columns = [
            "time",
            *(f"{joint}_position" for joint in joints),
            *(f"{joint}_command" for joint in joints),
        ]
        table = np.column_stack([np.arange(len(r)) / RATE_HZ, q, r])
        np.savetxt(folder / name, table, fmt="%.6f", delimiter=",", header=",".join(columns), comments="")


if __name__ == "__main__":
    write_logs(Path.cwd())
