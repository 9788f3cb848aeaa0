"""Simulated logs of robots with known parameters, from included experiments.

Tested in ``tests/test_compare.py``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.words import series
from ..errors import ExperimentError
from ..experiment.experiment import Experiment
from ..log.recording import Recording

PACKAGED = Path(__file__).parents[1] / "packaged" / "experiments"
"""Folder of the included experiments, by robot."""


LOG_REFINEMENT = 4
"""Ratio of the identification's time steps to those with which the log is simulated."""
MOST_PILOTS = 6
"""Upper bound of a log's simulation runs: each refines the steps where the velocities of the previous run were near zero."""


def packaged_experiment(robot: str) -> Experiment:
    """Load the experiment of an included robot.

    Tested in ``tests/test_compare.py``.

    Raises
    ------
    ExperimentError
        When there is none.
    """
    from ..experiment.experiment_file import load_experiment

    known = {path.stem: path for path in sorted(PACKAGED.glob("*.toml"))}
    if robot not in known:
        raise ExperimentError(
            f"there is no packaged experiment for robot {robot!r} (there are: {series(known, 40)}); give an experiment "
            "file with [reference], [controller] and [measurement]"
        )
    return load_experiment(known[robot])


def simulated_log(
    experiment: Experiment,
    x: Array,
    *,
    noise: bool = True,
    seed: int | None = None,
    refinement: int = LOG_REFINEMENT,
) -> Experiment:
    """Simulate the log of an experiment with known parameters.

    The motion is that of (4) with the controller. Tested in ``tests/test_compare.py``.

    Parameters
    ----------
    experiment : Experiment
        Experiment with its own reference, a controller and, for noise, a measurement.
    x : (n_parameters,) array
        Standard parameters: the truth, in SI units, joint side.
    noise : bool
        Add the measurement noise.
    seed : int, optional
        Seed of the noise; by default that of the measurement.
    refinement : int
        Ratio of the experiment's time steps to those of this simulation.

    Returns
    -------
    Experiment
        The experiment with one recording, joint side.

    Raises
    ------
    ExperimentError
        When the closed loop is not complete, or the run does not reach its end.
    """
    from ..experiment.loop import closed_loop, measured_motion
    from ..log.recording import Recording

    loop = closed_loop(experiment)
    recording: Recording | None = None
    for _ in range(MOST_PILOTS):
        arrays, outcomes = loop.divided(refinement).run(x[None])
        if not outcomes[0].completed:
            raise ExperimentError(f"{experiment.name}: the log cannot be simulated: the run {outcomes[0]}")
        before = recording
        recording = Recording.from_arrays(
            arrays[0][0], arrays[3][0], rate_hz=loop.rate_hz, name="simulated log"
        )
        # An identification derives its steps from this log, so the log must use them too.
        if before is not None and np.array_equal(before.q, recording.q):
            break
        motion = measured_motion(recording, (0, len(recording.q)), experiment.signal, loop.robot)
        if motion is None:
            break
        loop = loop.along(motion)
    assert recording is not None
    # The log has the friction model of the simulation, which the regressors of all methods use.
    robot = experiment.simulated_robot
    log = replace(experiment, robot=robot, recordings=(recording,))
    return measured(log, seed) if noise else log


def measured(log: Experiment, seed: int | None = None) -> Experiment:
    """Add the measurement noise to a simulated log.

    Parameters
    ----------
    log : Experiment
        From `simulated_log` without noise.
    seed : int, optional
        Of the noise; that of the measurement by default.

    Returns
    -------
    Experiment
        The same log if the experiment has no measurement.

    Raises
    ------
    ExperimentError
        For a negative seed.
    """
    if seed is not None and seed < 0:
        raise ExperimentError(f"the seed of the noise must not be negative, got {seed}")
    measurement = log.measurement
    (recording,) = log.recordings
    if measurement is None or recording.tau is None:
        return log
    q, tau = (measurement if seed is None else replace(measurement, seed=seed)).measure(
        recording.q, recording.tau
    )
    return replace(log, recordings=(replace(recording, q=q, tau=tau),))
