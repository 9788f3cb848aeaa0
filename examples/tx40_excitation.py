"""The full circle: design a motion for the TX40, simulate its log with noise, identify, and compare sigma with the prediction."""

from dataclasses import replace

import numpy as np

import didim

experiment = didim.packaged_experiment("tx40")
settings = didim.excitation.ExcitationSettings(
    position=[(-reach, reach) for reach in (2.6, 1.8, 2.0, 3.5, 1.9, 4.0)],
    velocity=[4.5, 4.5, 6.5, 6.5, 5.0, 10.0],
    acceleration=[25, 25, 35, 60, 60, 90],
    torque_noise=[0.5, 0.5, 0.2, 0.1, 0.1, 0.1],
    log_rate_hz=1000,
    parameters="didim",
)
design = didim.excite(experiment.robot, settings)
truth = experiment.robot.sets["didim"]
log = didim.simulated_log(replace(experiment, reference=design.reference), truth)
# The truth is the table of the paper, which is not quite a physical robot. The prediction is for white noise, so it is compared
# with the standard deviations of (10), corrected for decimation.
fit = didim.identify(log, didim.DIDIM(physical=False, uncertainty="decimated"))
error = (fit.beta - experiment.robot.base_parameters.project(truth)) / fit.std
print(f"expected: {design.ratio:.2f} of the random motion's standard deviations")
print(
    f"identified: {np.median(fit.std / design.std):.2f} of the expected ones, error / sigma {np.sqrt(np.mean(error**2)):.2f}"
)
