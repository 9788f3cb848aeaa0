"""The robot of a result with the payload, own offsets and drive gains of each recording.

Tested in ``tests/test_logs.py``.
"""

from __future__ import annotations

import re
from dataclasses import replace

from .._tools.arrays import Array
from .._tools.words import series
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..methods.start import further_of
from ..regression.logs.parameters import LogParameters
from ..result.identification import Identification
from ..robot.payload import NOTHING
from ..robot.robot import Robot

FRICTION = re.compile(r"(F[a-z]+|Off|Rest)\d+[+-]?")
"""Pattern of the names of friction parameters."""


def standard_in(fit: Identification, experiment: Experiment, robot: Robot) -> list[Array]:
    """Return the standard parameters (p,) of a result's robot in each recording.

    Parameters
    ----------
    fit : Identification
        Any result.
    experiment : Experiment
        Its recordings name their payloads. Own offsets and friction of a recording in the fit are matched by its name; other
        recordings have those of the robot.
    robot : Robot
        The robot, with the friction of the prediction.

    Raises
    ------
    FitError
        For a payload that is in neither the result nor the experiment.
    """
    parameters = LogParameters.of(
        robot, experiment.recordings, experiment.payloads, experiment.flange, checked=False
    )
    further = further_of(fit)
    for block in parameters.blocks:
        if block.kind == "payload" and not set(block.full_names) <= set(further):
            raise FitError(
                f"payload '{block.owner}' is not known: neither the result '{fit.name}' nor [payload] of '{experiment.name}' has "
                "all of it; `didim payload` estimates it"
            )
    x = parameters.extended(fit.parameters, further)
    return [parameters.standard(x, number) for number in range(len(experiment.recordings))]


def same_parameters(fit: Identification, robot: Robot) -> None:
    """Refuse a result whose parameters differ from those of a robot, and name the difference.

    Raises
    ------
    FitError
        When geometry or friction differ (``tests/test_validate.py``).
    """
    fitted, known = fit.parameter_names, robot.parameter_names
    if fitted == known:
        return
    more = [name for name in fitted if name not in known]
    fewer = [name for name in known if name not in fitted]
    if fit.robot != robot.name or not (more or fewer):
        raise FitError(
            f"the result is for robot {fit.robot!r} with {len(fitted)} parameters, the experiment for {robot.name!r} with "
            f"{len(known)}: they must be the same robot"
        )
    places = [names for names in (_shown("the result", more), _shown("the experiment", fewer)) if names]
    friction = all(FRICTION.fullmatch(name) for name in (*more, *fewer))
    advice = "write the same [friction] for both" if friction else "the robot file has changed"
    raise FitError(f"the parameters differ: only {' and only '.join(places)}; {advice}")


def _shown(owner: str, names: list[str]) -> str:
    """Name the owner of parameters with the first of them; empty for none."""
    if not names:
        return ""
    return f"{owner} has {series(names, 40)}"


def unloaded(experiment: Experiment) -> Experiment:
    """Return the experiment without payloads and own parameters, for computations independent of them."""
    plain = tuple(replace(recording, payload=NOTHING, own=()) for recording in experiment.recordings)
    return replace(experiment, recordings=plain)


def with_gains_of(fit: Identification, experiment: Experiment) -> Experiment:
    """Return the experiment with currents converted to torques by the drive gains of a result.

    Raises
    ------
    FitError
        For a result without drive gains.
    """
    if all(recording.drives is None for recording in experiment.recordings):
        return experiment
    gains = None if fit.further is None else fit.further.gains
    recordings = []
    for recording in experiment.recordings:
        if recording.drives is None or recording.tau is None:
            recordings.append(recording)
            continue
        if gains is None:
            raise FitError(
                f"recording '{recording.name}' has currents, and the result '{fit.name}' has no drive gains: "
                "write them into the file as gain = [...]"
            )
        recordings.append(recording.with_gains(gains))
    return replace(experiment, recordings=tuple(recordings))
