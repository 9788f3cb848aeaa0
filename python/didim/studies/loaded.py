"""The robot of a result with the payload, own offsets and drive gains of each recording, and a log as the result reads it.

Tested in ``tests/test_logs.py`` and ``tests/test_wrong_calls.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from .._tools.arrays import Array
from .._tools.saved import plain, restored
from .._tools.words import series
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..methods.start import further_of
from ..result.finding import Finding
from ..result.identification import Identification
from ..robot.friction import Friction
from ..robot.payload import NOTHING
from ..robot.robot import Robot
from ..signal.processing import SignalProcessing
from ..terms.build import model_of

FRICTION = re.compile(r"(F[a-z]+|Off|Rest)\d+[+-]?")
"""Pattern of the names of friction parameters."""
OF_SIMULATION = ("coulomb", "smoothing", "dead_zone")
"""Keys of friction that a result of simulated motion has for its simulation, not for measured motion."""
OF_RATE = ("trim_start", "trim_end", "decimation")
"""Keys of filters in samples, which belong to the rate of a log."""
SAME_RATE = 0.01
"""Largest difference of two rates, as a share, at which samples are as long: clocks differ by less."""


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
    parameters = model_of(robot, experiment.recordings, experiment.payloads, experiment.flange, checked=False)
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


def as_fitted(fit: Identification, experiment: Experiment) -> tuple[Experiment, list[Finding]]:
    """Return a log as a result reads it: with its friction, its filters and its drive gains; and a note on what the file has else.

    A result of simulated motion leaves sign, smoothing and dead zone of Coulomb friction to the file: its own are those of the
    simulation. Filters in samples are the result's at its rate only, and its cut-off where the log's rate has room for it.
    Windows are times of the log, and its own.

    Raises
    ------
    FitError
        For currents, and a result without drive gains.
    """
    rubbing, taken = with_friction_of(fit, experiment), []
    before, after = (_settings(each.robot.friction) for each in (experiment, rubbing))
    open_terms = {"terms"} if experiment.robot.friction.open else set()
    taken += _taken(before, after, open_terms)
    signal = _signal(fit, experiment)
    taken += _taken(asdict(experiment.signal), asdict(signal), set())
    note = [Finding(code="as-fitted", grade="note", facts={"taken": taken})] if taken else []
    return with_gains_of(fit, replace(rubbing, signal=signal)), note


def with_friction_of(fit: Identification, experiment: Experiment) -> Experiment:
    """Return the experiment with the friction of a result, which may have been chosen by the identification."""
    saved = fit.robot_record.get("friction")
    own = experiment.robot.friction
    if saved is None:
        return replace(experiment, robot=experiment.robot.with_terms(())) if own.open else experiment
    friction = replace(restored(Friction, saved), auto=False)
    if fit.recorded_motion not in (None, "measured"):
        friction = replace(friction, **{key: getattr(own, key) for key in OF_SIMULATION})
    if friction == own:
        return experiment
    return replace(experiment, robot=replace(experiment.robot, friction=friction))


def _settings(friction: Friction) -> dict[str, Any]:
    """Return what a file says of friction: names of its terms, and the smoothing only where there is some."""
    settings = {key: getattr(friction, key) for key in ("model", "coulomb", "coupling", "dead_zone")}
    if friction.coulomb == "tanh":
        settings["smoothing"] = friction.smoothing
    return {**settings, "terms": tuple(term.parameter for term in friction.terms)}


def _signal(fit: Identification, experiment: Experiment) -> SignalProcessing:
    """Return the filters of a result for a log."""
    signal, own = fit.recorded_signal, experiment.signal
    if signal is None or not experiment.recordings:
        return own
    rates = [recording.rate_hz for recording in experiment.recordings]
    fitted = [each["rate_hz"] for each in fit.settings.get("recordings", ()) if each.get("rate_hz")]
    if not fitted or any(abs(rate / fitted[0] - 1.0) > SAME_RATE for rate in rates):
        signal = replace(signal, **{key: getattr(own, key) for key in OF_RATE})
    if signal.cutoff_hz is not None and signal.cutoff_hz >= 0.5 * min(rates):
        signal = replace(signal, cutoff_hz=own.cutoff_hz)
    return signal


def _taken(before: Mapping[str, Any], after: Mapping[str, Any], but: set[str]) -> list[dict[str, Any]]:
    """Return keys with the values of the result and of the file, where they differ."""
    return [
        {"key": key, "value": _shown_value(after[key]), "file": _shown_value(before.get(key))}
        for key in after
        if key not in but and after[key] != before.get(key)
    ]


def _shown_value(value: Any) -> Any:
    """Return one value for equal ones, and lists for tuples."""
    if isinstance(value, tuple):
        return value[0] if len(value) > 1 and len(set(value)) == 1 else plain(list(value))
    return "none" if value is None else value
