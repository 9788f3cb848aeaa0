"""How far from its fixed point does DIDIM stop when the control loop is slack, and what does it say about it?

    python benches/slack_loop.py [--frequency 1.0] [--seeds 3] [--json FILE]

simulates logs of an arm of seven revolute joints (the geometry of a KUKA iiwa, made-up bodies) under a PD controller of a natural
frequency of 1 Hz, where packaged experiments have 8 to 20 Hz, adds noise, and identifies each by DIDIM with everything declared
correctly. Printed are the contraction rate, the remaining distance that the result reports, and the actual distances from the
truth and from the fixed point (the same run with ``tolerance = 0`` and 60 iterations), in standard deviations.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim
from didim.experiment.specs import Measurement, SimulationSettings
from didim.loop.controller import Controller, Digital
from didim.loop.reference import Reference
from didim.loop.tuning import mean_inertia
from didim.regression.settings import LeastSquaresSettings
from didim.studies.simulated_log import measured

Array = NDArray[np.float64]

TILTS_DEG = (0, -90, 90, 90, -90, -90, 90)
"""``alpha`` of the modified Denavit-Hartenberg rows."""
OFFSETS_M = (0.34, 0.0, 0.40, 0.0, 0.40, 0.0, 0.126)
"""``r`` of the rows."""
MASSES = (4.0, 4.0, 3.0, 2.7, 1.7, 1.8, 0.3)
"""Masses of the links (kg), about those of such an arm."""


def robot_text() -> str:
    """Return the robot file: geometry, friction, and the parameter set "truth"."""
    lines = [
        'schema = 1\nname = "seven"\ndescription = "seven revolute joints"\ngravity_m_s2 = [0.0, 0.0, -9.81]'
    ]
    for tilt, offset in zip(TILTS_DEG, OFFSETS_M, strict=True):
        lines.append(
            f'[[joint]]\nkind = "revolute"\nalpha_deg = {tilt}.0\nd_m = 0.0\ntheta_deg = 0.0\nr_m = {offset}\n'
            "limits = { position_rad = [-3.0, 3.0], velocity_rad_s = 3.0, torque_n_m = 300.0 }"
        )
    lines.append(
        '[friction]\ncoulomb = "tanh"\nsmoothing_rad_s = 0.02\nmodel = "symmetric"\n[parameters.truth]'
    )
    for joint, mass in enumerate(MASSES, start=1):
        centre = np.array([0.01, 0.02 * (-1) ** joint, 0.06 * (-1) ** joint])
        inertia = mass * np.array([0.010, 0.009, 0.004])
        about = inertia + mass * np.array(
            [
                centre[1] ** 2 + centre[2] ** 2,
                centre[0] ** 2 + centre[2] ** 2,
                centre[0] ** 2 + centre[1] ** 2,
            ]
        )
        values = {"M": mass, "XX": about[0], "YY": about[1], "ZZ": about[2]}
        values |= dict(zip(("MX", "MY", "MZ"), mass * centre, strict=True))
        values |= {
            "XY": -mass * centre[0] * centre[1],
            "XZ": -mass * centre[0] * centre[2],
            "YZ": -mass * centre[1] * centre[2],
        }
        size = 0.6 ** (joint - 1)
        values |= {"Ia": 0.9 * size, "Fv": 3.0 * size, "Fc": 4.0 * size, "Off": 0.3 * size}
        lines += [f"{name}{joint} = {float(value)!r}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def slack_log(
    frequency_hz: float, *, harmonics: int = 10, period_s: float = 10.0
) -> tuple[didim.Experiment, Array]:
    """Return the log without noise, and the standard parameters that made it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "seven.toml")
        path.write_text(robot_text(), encoding="utf-8")
        robot = didim.load_robot(path)
    x = np.asarray(robot.parameter_set("truth"))
    reference = Reference.random_fourier(
        harmonics=harmonics,
        period_s=period_s,
        max_position=[1.0] * 7,
        max_velocity=[1.5] * 7,
        max_acceleration=[8.0] * 7,
        seed=1,
    )
    controller = Controller.tuned([frequency_hz] * 7, 0.7, mean_inertia(robot, x, reference))
    experiment = didim.Experiment(
        name=f"seven joints, {frequency_hz:g} Hz",
        robot=robot,
        recordings=(),
        signal=didim.SignalProcessing(cutoff_hz=100.0, trim_start=20, trim_end=20, decimation=(10,)),
        least_squares=LeastSquaresSettings(weights="per-joint", uncertainty="decimated"),
        reference=reference,
        controller=controller,
        simulation=SimulationSettings(rate_hz=500.0, duration_s=period_s),
        measurement=Measurement(
            position_noise=(2e-6,) * 7, torque_noise=tuple(0.5 * 0.6**joint for joint in range(7))
        ),
    )
    return didim.simulated_log(experiment, x, noise=False, refinement=2), x


def digital_log(seed: int) -> didim.Experiment:
    """Return a log like those of real arms: a digital loop of 1 to 2 Hz with a delay, and friction that the model lacks.

    Stribeck friction and a ripple by position act in the loop.
    """
    from didim.experiment.loop import closed_loop

    tight, x = slack_log(2.0, harmonics=6, period_s=5.0)
    n = tight.robot.n_dof
    reference = Reference.random_fourier(
        harmonics=6,
        period_s=5.0,
        max_position=[1.2] * n,
        max_velocity=[1.0] * n,
        max_acceleration=[4.0] * n,
        seed=seed,
    )
    frequencies = [2.0, 2.0, 2.0, 1.5, 1.5, 1.2, 1.0]
    controller = Controller.tuned(frequencies, [0.7] * n, mean_inertia(tight.robot, x, reference))
    experiment = replace(
        tight,
        recordings=(),
        reference=reference,
        controller=replace(controller, digital=Digital(sample_time_s=0.005, delay_samples=1)),
        signal=didim.SignalProcessing(cutoff_hz=10.0, trim_start=25, trim_end=25, decimation=(5,)),
        least_squares=LeastSquaresSettings(),
        simulation=SimulationSettings(
            rate_hz=200.0,
            smoothing=(0.02,) * n,
            step_s=5e-4,
            fine_step_s=1e-4,
            start="reference",
            duration_s=5.0,
        ),
        measurement=Measurement(position_noise=(5e-6,) * n, seed=seed),
    )
    exact = didim.simulated_log(experiment, x, noise=False, refinement=1)
    (recording,) = exact.recordings
    coulomb = np.array([x[tight.robot.parameter_names.index(f"Fc{j}")] for j in range(1, n + 1)])
    rng = np.random.default_rng([7, seed])
    ripple, phase = rng.uniform(2.0, 8.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    q, tau = recording.measured_positions(), np.zeros(0)
    for _ in range(3):  # friction along the motion that it makes
        speed = np.gradient(q, 1.0 / recording.rate_hz, axis=0)
        lacking = 0.5 * np.exp(-((speed / 0.1) ** 2)) + 0.15 * np.sin(ripple * q + phase)
        felt = replace(recording, external=-coulomb * np.tanh(speed / 0.02) * lacking)
        arrays, _ = closed_loop(exact, felt).run(x[None])
        q, tau = arrays[0][0], arrays[3][0]
    tau = tau + 0.01 * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
    return measured(replace(exact, recordings=(replace(recording, q=q, tau=tau),)), seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--frequency", type=float, default=1.0, help="natural frequency of the loop (Hz)")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--plain", action="store_true", help="the DIDIM of the paper")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    log, x = slack_log(options.frequency)
    truth = log.robot.base_parameters.project(x)
    rows = []
    for seed in range(options.seeds):
        noisy = measured(log, seed)
        fit = didim.identify(noisy, didim.DIDIM(physical=not options.plain))
        # From the start again: the parameters of a run that did not converge may not be those of a robot.
        end = didim.identify(
            noisy,
            didim.DIDIM(physical=not options.plain, tolerance=0.0, sigma_fraction=1e-4, max_iterations=60),
        )
        sigma = np.where(end.std > 0.0, end.std, np.nan)
        off, left = (fit.beta - truth) / sigma, (fit.beta - end.beta) / sigma
        row = {
            "status": fit.status.name,
            "iterations": fit.n_iterations,
            "contraction": fit.history[-1].more["contraction"],
            "reported": fit.history[-1].more["remaining_sigma"],
            "off_rms": float(np.sqrt(np.nanmean(off**2))),
            "left_rms": float(np.sqrt(np.nanmean(left**2))),
            "left_largest": float(np.nanmax(np.abs(left))),
            "fixed_point": end.status.name,
        }
        rows.append(row)
        print(
            ", ".join(
                f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}"
                for key, value in row.items()
            )
        )
        print("   ", fit.ending, *fit.remarks, sep="\n    ")
    if options.json is not None:
        options.json.write_text(json.dumps(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
