"""The robot of a result in the recordings of an experiment: with their payloads, own offsets and drive gains.

Tested in ``tests/test_logs.py``.
"""

from __future__ import annotations

from dataclasses import replace

from .._tools.arrays import Array
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..methods.start import further_of
from ..regression.logs.parameters import LogParameters
from ..result.identification import Identification
from ..robot.payload import NOTHING
from ..robot.robot import Robot


def standard_in(fit: Identification, experiment: Experiment, robot: Robot) -> list[Array]:
    """Return the standard parameters (p,) that the robot of a result has in each recording.

    Parameters
    ----------
    fit : Identification
        Any result.
    experiment : Experiment
        Its recordings name their payloads. Offsets and friction that a recording had for itself in the fit are found by its name;
        another recording has those of the robot.
    robot : Robot
        The robot, with the friction of the prediction.

    Raises
    ------
    FitError
        For a payload that neither the result nor the experiment knows.
    """
    parameters = LogParameters.of(
        robot, experiment.recordings, experiment.payloads, experiment.flange, checked=False
    )
    further = further_of(fit)
    for block in parameters.blocks:
        if block.kind == "payload" and not set(block.full_names) <= set(further):
            raise FitError(
                f"payload '{block.owner}' is not known: neither the result '{fit.name}' nor the tables [payload] of experiment "
                f"'{experiment.name}' say all of it; `didim payload` estimates it"
            )
    x = parameters.extended(fit.parameters, further)
    return [parameters.standard(x, number) for number in range(len(experiment.recordings))]


def unloaded(experiment: Experiment) -> Experiment:
    """Return the experiment without payloads and own parameters: for what does not depend on them, where all are known."""
    plain = tuple(replace(item, payload=NOTHING, own=()) for item in experiment.recordings)
    return replace(experiment, recordings=plain)


def with_gains_of(fit: Identification, experiment: Experiment) -> Experiment:
    """Return the experiment with torques in place of currents, by the drive gains of a result.

    Raises
    ------
    FitError
        For a result without drive gains.
    """
    if all(item.drives is None for item in experiment.recordings):
        return experiment
    gains = None if fit.further is None else fit.further.gains
    recordings = []
    for item in experiment.recordings:
        if item.drives is None or item.tau is None:
            recordings.append(item)
            continue
        if gains is None:
            raise FitError(
                f"recording '{item.name}' has currents, and the result '{fit.name}' has no drive gains: write them into the file "
                "as gain = [...]"
            )
        recordings.append(item.with_gains(gains))
    return replace(experiment, recordings=tuple(recordings))
