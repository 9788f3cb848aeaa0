"""What MuJoCo loses of each friction law: our closed loop against MuJoCo with the exported parameters.

    python benches/friction_in_mujoco.py

The planar arm follows a motion with stops under the same PD law in both, at steps of 0.1 ms. The table has the differences of
positions (mrad, rms) and torques (% of their rms). docs/friction.md has it.
"""

from __future__ import annotations

import sys

import mujoco
import numpy as np
from numpy.typing import NDArray

import didim
from didim.export.write import export
from didim.robot.friction import FrictionTerm, Law

Array = NDArray[np.float64]
RATE_HZ = 200.0
"""Records per second."""
STEP_S = 1e-4
"""Step of both simulations (s)."""
REFERENCE = didim.Reference.point_to_point(
    [[0.0, 0.0], [0.8, -0.9], [-0.4, 0.6], [0.2, 0.1]],
    max_velocity=[1.5, 2.0],
    max_acceleration=[6.0, 9.0],
    dwell_s=0.3,
)
INERTIA = np.array([1.5, 0.2])
FREQUENCY = 2.0 * np.pi * np.array([8.0, 12.0])
GAINS = INERTIA * FREQUENCY**2, 1.4 * INERTIA * FREQUENCY
"""Gains of the PD law: on the position (N.m/rad) and on the velocity (N.m.s/rad)."""
CASES: dict[str, tuple[tuple[Law, float, float], ...]] = {
    "viscous and Coulomb": (),
    "hold": (("hold", 0.0, 0.0),),
    "atan, 0.3 rad/s": (("atan", 0.3, 0.4),),
    "Stribeck, 0.15 rad/s": (("stribeck", 0.15, 0.4),),
    "Dahl, 2 mrad": (("dahl", 2e-3, 1.0),),
    "Dahl, 20 mrad": (("dahl", 2e-2, 1.0),),
    "load": (("load", 0.0, 0.1),),
}
"""Laws at both joints: velocity or displacement, and the parameter over Fc; of load alone."""


def subject(laws: tuple[tuple[Law, float, float], ...]) -> tuple[didim.Robot, Array]:
    """Return the arm with laws at both joints, and its standard parameters, without offsets."""
    plain = didim.load_robot("planar2").with_smoothing([0.005, 0.005])
    terms = [FrictionTerm(law=law, joint=j, velocity=v) for law, v, _ in laws for j in range(2)]
    robot = plain.with_terms(terms)
    values = dict(zip(plain.parameter_names, plain.parameter_set("reference").tolist(), strict=True))
    for j in (1, 2):
        values[f"Off{j}"] = 0.0
        for law, _, share in laws:
            name = {"atan": "Fa", "stribeck": "Fs", "dahl": "Fz", "load": "Fl"}.get(law)
            if name:
                values[f"{name}{j}"] = share if law == "load" else share * values[f"Fc{j}"]
        if any(law == "dahl" for law, _, _ in laws):
            values[f"Fc{j}"] = 0.0
    return robot, np.array([values[name] for name in robot.parameter_names])


def ours(robot: didim.Robot, x: Array) -> tuple[Array, Array]:
    """Return positions and torques of our closed loop."""
    controller = didim.Controller.tuned(FREQUENCY / (2.0 * np.pi), 0.7, inertia=INERTIA.tolist())
    run = didim.simulate(
        robot, x, REFERENCE, controller, rate_hz=RATE_HZ, step=STEP_S, fine_step=STEP_S, check=False
    )
    return run.q, run.tau


def mujocos(robot: didim.Robot, x: Array, count: int) -> tuple[Array, Array]:
    """Return the same of MuJoCo with the exported file."""
    content, _ = export(robot, x, "mjcf")
    model = mujoco.MjModel.from_xml_string(content.decode())
    model.opt.timestep = STEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    every = round(1.0 / (RATE_HZ * STEP_S))
    wanted, speed, _ = REFERENCE.at(np.arange(every * count) * STEP_S)
    q, tau = np.zeros((count, 2)), np.zeros((count, 2))
    data.qpos[:] = wanted[0]
    for k in range(every * count):
        torque = GAINS[0] * (wanted[k] - data.qpos) + GAINS[1] * (speed[k] - data.qvel)
        if k % every == 0:
            q[k // every], tau[k // every] = data.qpos, torque
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    return q, tau


def main() -> int:
    """Print the table."""
    print(f"{'law':24}{'position, mrad':>16}{'torque, %':>12}")
    for name, laws in CASES.items():
        robot, x = subject(laws)
        q, tau = ours(robot, x)
        other_q, other_tau = mujocos(robot, x, len(q))
        far = 1e3 * np.sqrt(np.mean((q - other_q) ** 2))
        share = 100.0 * np.linalg.norm(tau - other_tau) / np.linalg.norm(tau)
        print(f"{name:24}{far:16.3f}{share:12.2f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
