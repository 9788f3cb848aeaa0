"""Validation of a result on another log, by torques along the measured motion and by simulation of the closed loop.

Tested in ``tests/test_validate.py``.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from .._tools.arrays import Array, quotient, ratio
from .._tools.notebook import Printed
from .._tools.saved import plain
from .._tools.words import series
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import experiment_of
from ..loop.outcome import Outcome
from ..result.finding import Finding
from ..result.identification import Identification
from ..result.verdict import Verdict


@dataclass(frozen=True, eq=False)
class RecordingValidation:
    """Errors on one recording, per joint.

    Attributes
    ----------
    name : str
        Recording.
    direct : (n_dof,) array or None
        Relative error of the torques predicted along the filtered measured motion, with friction and filters of the result
        (`didim.studies.loaded.as_fitted`); None without torques.
    direct_overall : float
        Of all joints together.
    simulated : dict of (n_dof,) arrays
        Relative errors of the simulated closed loop (`position`, `velocity`, `acceleration`, `torque`) over the first window,
        raw; empty without a reference and a controller, or if the simulation ended early.
    outcome : Outcome or None
        Outcome of the simulation; None without a reference and a controller.
    """

    name: str
    direct: Array | None
    direct_overall: float
    simulated: dict[str, Array]
    outcome: Outcome | None


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Printed):
    """Errors of a result on the recordings of an experiment.

    Tested in ``tests/test_validate.py``.

    Attributes
    ----------
    fit : Identification
        The result.
    experiment : str
        Name of the experiment.
    recordings : tuple of RecordingValidation
        Errors of each recording, (n_dof,) relative ones of predicted torques and of simulated signals, joint side.
    evidence : tuple of Finding
        What the errors say: see `verdict`.
    """

    fit: Identification
    experiment: str
    recordings: tuple[RecordingValidation, ...]
    evidence: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Whether the log is one of the robot of the result, read as that of the fit was: sound, doubtful or wrong."""
        ended = [
            Finding(
                code="not-completed",
                grade="wrong",
                recordings=(each.name,),
                facts={"ending": str(each.outcome)},
            )
            for each in self.recordings
            if each.outcome is not None and not each.outcome.completed
        ]
        return Verdict.of([*self.evidence, *ended])

    @property
    def completed(self) -> bool:
        """Whether every simulation reached its end."""
        return all(recording.outcome is None or recording.outcome.completed for recording in self.recordings)

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain lists and numbers; NaN and infinity become None."""
        return {
            "robot": self.fit.robot,
            "method": self.fit.method,
            "fit": self.fit.name,
            "experiment": self.experiment,
            "recordings": [
                plain(recording) | {"outcome": None if recording.outcome is None else str(recording.outcome)}
                for recording in self.recordings
            ],
            "fit_error": plain(self.fit.relative_error),
            "verdict": self.verdict.to_dict(),
        }

    def __str__(self) -> str:
        lines = [f"{self.fit.name}, by {self.fit.method}, on {self.experiment}; relative errors in %"]
        for recording in self.recordings:
            rows: dict[str, Array] = {}
            if recording.direct is not None:
                rows["torque, predicted"] = recording.direct
                rows["torque, of the fit"] = self.fit.relative_error
            rows |= {f"{name}, simulated": values for name, values in recording.simulated.items()}
            lines += ["", f"recording '{recording.name}'"]
            if rows:
                n = len(next(iter(rows.values())))
                width = max(map(len, rows))
                lines.append(" " * width + "".join(f"{f'joint {joint + 1}':>10}" for joint in range(n)))
                lines += [
                    f"{name:{width}}" + "".join(f"{100.0 * value:10.4g}" for value in values)
                    for name, values in rows.items()
                ]
            if recording.outcome is not None and not recording.outcome.completed:
                lines.append(f"the simulation {recording.outcome}")
            if recording.outcome is None:
                lines.append(
                    "not simulated: the experiment has no [controller] and [reference], or made-up gains"
                )
        return "\n".join([*lines, "", str(self.verdict)])


def same_robot(fit: Identification, experiment: Experiment) -> None:
    """Refuse the result of another robot with the same parameters.

    The robots are the same if the digests of the file or the geometries are equal; parameter sets may have been added to the
    file since. Results that record neither are accepted.
    """
    robot = experiment.robot
    known = {digest for key, digest in fit.digests.items() if key.startswith("robot ")}
    if robot.digest in known:
        return
    recorded = fit.robot_record.get("geometry")
    if recorded is None:
        if known and robot.digest:
            raise FitError(
                f"the result is for another file of robot {fit.robot!r} than the experiment's: their digests differ"
            )
        return
    here = json.loads(json.dumps(asdict(robot.geometry)))
    other = [key for key, value in here.items() if recorded.get(key, value) != value]
    if other:
        raise FitError(
            f"the result {fit.name!r} is for another robot of the same parameters than {robot.name!r}: they differ in "
            f"{series(other, 40)}"
        )


def validate(fit: Identification, experiment: Experiment | str | Path) -> Validation:
    """Compute the errors of a result on recordings, predicted and simulated.

    Predicted torques are those of (1) along the measured motion; the simulation is that of (4).
    Tested in ``tests/test_validate.py``.

    Parameters
    ----------
    fit : Identification
        Any result.
    experiment : Experiment or path
        Another log of the same robot, or its file.

    Returns
    -------
    Validation
        Errors per recording and joint.

    Raises
    ------
    FitError
        When the result is for another robot, or the experiment has no recording.
    DidimError
        As for an identification of the experiment.
    """
    from ..evidence.applied.log import AppliedLog, Errors, applied_findings
    from ..evidence.loop.law import made_up
    from ..methods.method import FitSettings
    from ..signal.window import windows_of
    from ..terms.model import Model
    from .loaded import as_fitted, same_parameters, standard_in, unloaded
    from .prediction import simulate_window
    from .run import recording_errors

    experiment, taken = as_fitted(fit, experiment_of(experiment))
    robot = experiment.simulated_robot
    same_parameters(fit, robot)
    same_robot(fit, experiment)
    if not experiment.recordings:
        raise FitError(f"experiment '{experiment.name}' has no recording to validate on")
    loaded = standard_in(fit, experiment, experiment.robot)
    job = FitSettings().job(unloaded(experiment))
    delay = job.delay()
    # Invented gains do not represent the real loop.
    closed = None not in (experiment.reference, experiment.controller) and not made_up(experiment)
    recordings, evidence = [], list(taken)
    for recording, x in zip(experiment.recordings, loaded, strict=True):
        direct, overall = None, float("nan")
        if recording.tau is not None and recording.has_positions:
            beta = experiment.robot.base_parameters.project(x)
            errors, torques, n_rows = job.predicted(recording, beta, delay)
            root = np.sqrt(max(1, n_rows))
            beside = Errors.beside(fit, errors / root, torques / root)
            if beside.larger:
                parts = windows_of(recording, experiment.signal, delay=delay.samples, hold_s=delay.hold_s)
                logs = Model(experiment.robot)
                log = AppliedLog(experiment.robot, experiment.signal, logs, beta, parts, [recording])
                evidence += applied_findings(log, beside)
            direct, overall = (
                quotient(errors, torques, np.nan),
                ratio(np.linalg.norm(errors), np.linalg.norm(torques)),
            )
        outcome, simulated = None, {}
        if closed:
            run = simulate_window(x, experiment, recording, recording.windows[0])
            outcome = run.outcome
            if outcome.completed:
                arrays = run.q, run.dq, run.ddq, run.tau
                simulated = recording_errors(experiment, recording, recording.windows[0], arrays)
        recordings.append(RecordingValidation(recording.name, direct, overall, simulated, outcome))
    return Validation(fit, experiment.name, tuple(recordings), tuple(evidence))
