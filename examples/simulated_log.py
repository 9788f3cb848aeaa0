"""Identify a TX40 from a simulated log, and hold the result against the truth.

The robot follows a rich Fourier reference; its torques come from the inverse dynamic model (1) with the
parameters of Table II, and encoder and torque noise are laid over them, as large as on a real machine. What
is written to ``out/`` is what a data logger would leave, motor side, with an experiment file that says how
to read it. The command line does the rest:

    didim identify out/simulated_tx40.toml --method idim-ls

The exit code is 0 if at least 95 % of the parameters lie within three reported standard deviations of the
truth, else 1.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim
from didim.cli import main as command_line

Array = NDArray[np.float64]

RATE_HZ = 1000.0
PERIOD_S = 10.0
HARMONICS = 20
# What the reference may reach, joint by joint, and the noise of the sensors: joint side, rad and N.m.
LARGEST_POSITION_RAD = np.array([2.6, 1.8, 2.0, 3.5, 1.9, 4.0])
LARGEST_VELOCITY_RAD_S = np.array([4.5, 4.5, 6.5, 6.5, 5.0, 10.0])
LARGEST_ACCELERATION_RAD_S2 = np.array([25.0, 25.0, 35.0, 60.0, 60.0, 90.0])
ENCODER_NOISE_RAD = np.array([1.0, 1.0, 2.0, 2.0, 2.0, 3.0]) * 1e-6
TORQUE_NOISE_N_M = np.array([0.5, 0.5, 0.2, 0.1, 0.1, 0.1])

EXPERIMENT = """\
schema = 1
robot = "tx40"
name = "TX40, simulated log"

[[recording]]
rate_hz = 1000
[recording.position]
file = "simulated_position.csv"
unit = "rad"
side = "motor"
[recording.torque]
file = "simulated_torque.csv"
unit = "N.m"
side = "motor"

[signal]
cutoff_hz = 50
trim_start = 100
trim_end = 100
decimation = [5, 4] # to 50 Hz, of which the filter passes 20 Hz

[least_squares]
weights = "per-joint"
reweightings = 1
"""


def fourier_reference(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of a periodic motion within the limits, each (n_samples, 6)."""
    t = np.arange(round(PERIOD_S * RATE_HZ)) / RATE_HZ
    frequency = 2.0 * np.pi * np.arange(1, HARMONICS + 1) / PERIOD_S
    # Amplitudes fall with the frequency, so that every harmonic adds as much to the velocity as any other.
    cosine, sine = rng.standard_normal((2, HARMONICS, 6)) / frequency[:, None]
    c, s = np.cos(np.outer(t, frequency)), np.sin(np.outer(t, frequency))
    w = frequency[:, None]
    q = c @ cosine + s @ sine
    dq = c @ (w * sine) - s @ (w * cosine)
    ddq = -c @ (w**2 * cosine) - s @ (w**2 * sine)
    scale = np.minimum.reduce(
        [
            LARGEST_POSITION_RAD / np.abs(q).max(axis=0),
            LARGEST_VELOCITY_RAD_S / np.abs(dq).max(axis=0),
            LARGEST_ACCELERATION_RAD_S2 / np.abs(ddq).max(axis=0),
        ]
    )
    return scale * q, scale * dq, scale * ddq


def write_log(folder: Path, seed: int) -> Path:
    """Simulate the log, write it as two CSV files, and return the path of the experiment file beside them."""
    robot = didim.load_robot("tx40")
    if robot.reduction is None:
        raise SystemExit("robot 'tx40' has no reduction matrix")
    rng = np.random.default_rng(seed)
    q, dq, ddq = fourier_reference(rng)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, robot.sets["didim"])
    q = q + ENCODER_NOISE_RAD * rng.standard_normal(q.shape)
    tau = tau + TORQUE_NOISE_N_M * rng.standard_normal(tau.shape)

    folder.mkdir(parents=True, exist_ok=True)
    # (22): q_motor = R q, and tau = R^T tau_motor.
    q_motor = q @ robot.reduction.T
    tau_motor = np.linalg.solve(robot.reduction.T, tau.T).T
    header = ",".join(f"motor_{j}" for j in range(1, robot.n_dof + 1))
    for name, values in (("position", q_motor), ("torque", tau_motor)):
        np.savetxt(folder / f"simulated_{name}.csv", values, "%.12g", ",", header=header, comments="")
    experiment = folder / "simulated_tx40.toml"
    experiment.write_text(EXPERIMENT, encoding="utf-8")
    return experiment


def compare(fit: didim.Identification) -> float:
    """Print estimate and truth side by side, and return the share of estimates within three sigma."""
    robot = didim.load_robot("tx40")
    truth = dict(zip(robot.base_parameters.names, robot.set_base("didim"), strict=True))
    print(f"\n{'parameter':10} {'truth':>12} {'estimate':>12} {'sigma':>10} {'error/sigma':>12}")
    within = 0
    for name, value, sigma in zip(fit.names, fit.beta, fit.std, strict=True):
        error = (value - truth[name]) / sigma
        within += abs(error) <= 3.0
        print(f"{name:10} {truth[name]:12.5g} {value:12.5g} {sigma:10.2g} {error:12.2f}")
    share = within / len(fit.names)
    print(f"\n{within} of {len(fit.names)} parameters ({share:.1%}) lie within three sigma of the truth.")
    return share


def main() -> int:
    """Write the log, identify it with the command line, and judge the result."""
    parser = argparse.ArgumentParser(description="Identify a TX40 from a simulated log.")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    parser.add_argument("--seed", type=int, default=1, help="seed of motion and noise (default: 1)")
    arguments = parser.parse_args()

    experiment = write_log(arguments.out, arguments.seed)
    result = arguments.out / "simulated_tx40.json"
    command = ["identify", str(experiment), "--method", "idim-ls", "--json", str(result)]
    print("didim", *command, flush=True)
    code = command_line(command)
    if code != 0:
        return code
    return 0 if compare(didim.Identification.load(result)) >= 0.95 else 1


if __name__ == "__main__":
    sys.exit(main())
