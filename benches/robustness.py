"""What DIDIM makes of a wrong controller, of friction that is not in the model, and of torques that are wrong in the log.

    python benches/robustness.py [--motions 12]

simulates the log of the packaged TX40 experiment and spoils one thing at a time. Off is the estimate less the truth, in
standard deviations and in percent, over the inertial parameters with a sigma below 20 %. With --motions it then counts how
often DIDIM converges on poor motions under slack controllers, by the step of the integration. The figures are those of
docs/didim.md.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product

import numpy as np

import didim
from didim.experiment.experiment import Experiment
from didim.experiment.specs import ReferenceSpec
from didim.log.recording import Recording
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.loop.tuning import mean_inertia
from didim.studies.simulated_log import packaged_experiment, simulated_log


def main() -> None:
    parser = argparse.ArgumentParser(description="DIDIM on logs that are not what they seem.")
    parser.add_argument("--motions", type=int, default=0, help="random motions per controller")
    arguments = parser.parse_args()
    experiment = packaged_experiment("tx40")
    robot = experiment.robot
    x = robot.parameter_set("didim")
    log = simulated_log(experiment, x)
    print(f"{'':34}{'status':>15}{'iterations':>11}{'error %':>9}{'off, rms':>10}{'off %':>8}")
    tell("as it is", log, x)
    for factor in (0.7, 1.3):
        tell(f"gains of the controller x {factor:g}", with_gains(log, factor), x)
    # The log with friction of another shape: a smoothing five times that of the model.
    smooth = replace(experiment, simulation=replace(experiment.simulation, smoothing=(0.05,) * 6))
    spoilt = simulated_log(smooth, x)
    tell("friction smoothed over 0.05 rad/s", replace(log, recordings=spoilt.recordings), x)
    recording = log.recordings[0]
    assert recording.tau is not None
    # Coulomb friction that grows by 20 % of itself at one end of the motion, as a load would make it.
    q, tau = recording.q, recording.tau
    velocity = np.gradient(q, 1.0 / recording.rate_hz, axis=0)
    coulomb = np.array([x[robot.parameter_names.index(f"Fc{joint + 1}")] for joint in range(6)])
    extra = 0.2 * coulomb * np.tanh(velocity / 0.01) * (q / np.abs(q).max(axis=0))
    tell("Coulomb friction +-20 % over the way", with_torques(log, tau + extra), x)
    turned = tau.copy()
    turned[:, 2] *= -1.0
    tell("torque of joint 3 turned", with_torques(log, turned), x)
    tell("torques of joints 2 and 3 exchanged", with_torques(log, tau[:, [0, 2, 1, 3, 4, 5]]), x)
    for steps in ((5e-4, 1e-4), (1e-4, 5e-5)) if arguments.motions else ():
        poor_motions(experiment, x, arguments.motions, *steps)


def poor_motions(experiment: Experiment, x: np.ndarray, count: int, step: float, fine_step: float) -> None:
    """Count convergences on five seconds of few harmonics, with controllers of 8 and 12 Hz."""
    assert isinstance(experiment.reference, ReferenceSpec)
    settings = experiment.reference.settings
    limits = {
        "max_position": settings["max_position_rad"],
        "max_velocity": settings["max_velocity_rad_s"],
        "max_acceleration": settings["max_acceleration_rad_s2"],
    }
    simulation = replace(experiment.simulation, step_s=step, fine_step_s=fine_step)
    iterations, off, runs, too_large = [], [], 0, 0
    for seed, harmonics, frequency in product(range(count), (5, 10), (8.0, 12.0)):
        reference = Reference.random_fourier(harmonics=harmonics, period_s=5.0, seed=seed, **limits)
        inertia = mean_inertia(experiment.robot, x, reference)
        controller = Controller.tuned([frequency] * 6, [0.7] * 6, inertia)
        poor = replace(experiment, reference=reference, controller=controller, simulation=simulation)
        fit = didim.identify(simulated_log(poor, x, refinement=1), didim.DIDIM(physical=False))
        runs += 1
        if fit.converged:
            truth = experiment.robot.base_parameters.project(x)
            off.append(float(np.sqrt(np.mean(((fit.beta - truth) / fit.std) ** 2))))
            iterations.append(fit.n_iterations)
        too_large += not fit.converged and any(
            "the integration step is too large" in text for text in fit.remarks
        )
    print(
        f"steps of {1e3 * step:g} and {1e3 * fine_step:g} ms: {len(iterations)} of {runs} converge, in {min(iterations)} to "
        f"{max(iterations)} iterations, off by {np.median(off):.2f} sigma rms in the median and {max(off):.1f} at most; of the "
        f"others {too_large} say that the step is too large"
    )


def with_gains(log: Experiment, factor: float) -> Experiment:
    """Take the log for one of a controller with other gains."""
    spec = log.controller
    assert spec is not None
    right = spec if isinstance(spec, Controller) else spec.build(log.reference.made)  # type: ignore[union-attr, arg-type]
    assert isinstance(right, Controller)
    return replace(log, controller=Controller.pd(right.laws[:, 0] * factor, right.laws[:, 1] * factor))


def with_torques(log: Experiment, tau: np.ndarray) -> Experiment:
    recording = log.recordings[0]
    other = Recording.from_arrays(recording.q, tau, rate_hz=recording.rate_hz, name=recording.name)
    return replace(log, recordings=(other,))


def tell(name: str, log: Experiment, x: np.ndarray) -> None:
    try:
        fit = didim.identify(log, didim.DIDIM(physical=False))
    except didim.DidimError as error:
        print(f"{name:34} {error}")
        return
    truth = log.robot.base_parameters.project(x)
    inertial = np.array([not parameter.startswith(("F", "Off")) for parameter in fit.names])
    well = inertial & (100.0 * fit.std < 20.0 * np.abs(truth))
    off = fit.beta - truth
    sigma = float(np.sqrt(np.mean((off[well] / fit.std[well]) ** 2)))
    percent = float(np.median(np.abs(off[well] / truth[well])))
    print(
        f"{name:34}{fit.status.name:>15}{fit.n_iterations:>11}{100.0 * fit.overall_relative_error:>9.2f}{sigma:>10.1f}"
        f"{100.0 * percent:>8.2f}"
    )
    for remark in fit.remarks:
        print(f"    {remark}")


if __name__ == "__main__":
    main()
