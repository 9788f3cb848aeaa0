"""What DIDIM makes of a wrong controller, of friction that is not in the model, and of torques that are wrong in the log.

    python benches/robustness.py

simulates the log of the packaged TX40 experiment and spoils one thing at a time. Off is the estimate less the truth, in
standard deviations and in percent, over the inertial parameters with a sigma below 20 %.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import didim
from didim.compare import packaged_experiment, simulated_log
from didim.control import Controller
from didim.experiment import Experiment
from didim.recording import Recording


def main() -> None:
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
        fit = didim.identify(log, didim.DIDIM())
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
