"""Simulate an arm whose servos are not those of its MJCF, and write two logs of it: log.csv and other.csv.

    python make_logs.py

The servos are alike. Commands go out at 50 Hz, act 20 ms late, and the encoders have 4 096 counts a turn; the columns are in
degrees. Needs MuJoCo: pip install 'didim[mujoco]'. Tested in ``tests/test_in_mujoco.py``.
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
RATE_HZ, STEP_S = 50, 5e-4
"""Samples per second of the logs, and the time step of the simulation (s)."""
TRUTH = {"armature": 0.028, "damping": 0.6, "frictionloss": 0.06}
"""Every servo (kg.m^2, N.m.s/rad, N.m)."""
DELAY_S = 0.02
"""Time after which the servos follow a command."""
MIDDLE = (0.0, 0.2, 0.3, 0.4, 0.0, 0.7)
"""Middle of the motion (rad)."""
COUNTS = 4096
"""Counts of an encoder per turn."""


def true_model() -> Any:
    """Return the arm that is simulated: the MJCF with the servos of `TRUTH`."""
    model = load_model(FOLDER / "arm.xml")
    model.dof_armature[:], model.dof_damping[:] = TRUTH["armature"], TRUTH["damping"]
    model.dof_frictionloss[:] = TRUTH["frictionloss"]
    model.opt.timestep, model.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_RK4
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def commands(rng: np.random.Generator, seconds: float) -> Array:
    """Return commanded positions, (n_samples, 6): waves and jumps by turns, from rest."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    phase = 2.0 * np.pi * np.outer(t, rng.uniform(0.3, 1.2, 6)) + rng.uniform(0.0, 6.0, 6)
    jumps = np.repeat(rng.uniform(-0.4, 0.4, (round(2.0 * seconds), 6)), RATE_HZ // 2, axis=0)
    begin = np.minimum(t, 1.0)[:, None]
    return np.asarray(MIDDLE + begin * np.where((t % 4.0 < 2.0)[:, None], 0.5 * np.sin(phase), jumps))


def followed(model: Any, r: Array) -> Array:
    """Return the positions of servos that follow commands late, at the samples of the log, (n_samples, 6)."""
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
    """Write both logs into a folder: commanded and measured positions in degrees."""
    model = true_model()
    joints = [model.joint(dof).name for dof in range(model.njnt)]
    for seed, seconds, name in ((1, 24.0, "log.csv"), (2, 12.0, "other.csv")):
        r = commands(np.random.default_rng(seed), seconds)
        count = 2.0 * np.pi / COUNTS
        q = np.round(followed(model, r) / count) * count
        columns = [
            "time",
            *(f"{joint}_position" for joint in joints),
            *(f"{joint}_command" for joint in joints),
        ]
        table = np.column_stack([np.arange(len(r)) / RATE_HZ, np.degrees(q), np.degrees(r)])
        np.savetxt(folder / name, table, fmt="%.6f", delimiter=",", header=",".join(columns), comments="")


if __name__ == "__main__":
    write_logs(Path.cwd())
