"""`check`: look at a log before it is fitted.

Each check is a function of a module beside this one. Here is their order, and which of them makes others idle: a contradiction
that is reported is corrected before the next check looks. Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array, real_array
from ..errors import FitError, RankError, SignalError
from ..evidence.loop.law import Recovered, recovered
from ..evidence.naming import torque_findings
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import load_experiment
from ..log.recording import Recording
from ..log.sampling import MINIMUM_SAMPLES, TimeFault
from ..methods.idim_ls import IDIMLS
from ..methods.job import Job
from ..regression.fit import Fit
from ..regression.least_squares import solve
from ..regression.linear_system import LinearSystem
from ..result.identification import Identification
from ..signal.decimation import decimate, decimation_stages, least_samples
from ..signal.processing import SignalProcessing
from ..signal.segments import Segment, stretches
from ..studies.run import standard_parameters
from .bandwidth import check_bandwidth
from .causes import (
    check_causes,
    check_loop,
    check_payload,
    contradicts,
    finding_of,
    loop_table,
    rows_of,
    unchecked_gains,
)
from .channels import check_channels
from .excitation import check_excitation
from .finding import Finding, Findings
from .late import check_delay
from .limits import check_limits
from .probe import Probe
from .readings import Reader, as_declared
from .reference import check_reference
from .sampled import time_findings
from .spikes import check_spikes
from .standstill import check_standstill

MOST_SAMPLES = 30_000
"""Samples that other readings are tried on at most: in three stretches, evenly over a longer log."""
CERTAIN = 0.2
"""Share of the residual below which another reading of the columns needs no comparison with hypotheses on the robot file."""
QUICK_ROWS = 100
"""Rows of each joint that all other readings are tried on first: of the 60 parameters of six joints each has ten."""


def check(
    experiment: Experiment | str | Path,
    parameters: str | Path | Identification | ArrayLike | None = None,
    *,
    data: str | Path | None = None,
) -> Findings:
    """Look at a log for what spoils a fit.

    Parameters
    ----------
    experiment : Experiment, str or Path
        An experiment, or its file. Only a file can have wrong time stamps: an `Experiment` has none.
    parameters : str, Path, Identification or array, optional
        Known parameters: result (or its .json, .toml or .npz), name of a set of the robot, or standard ones, (n_parameters,).
        With them the scale of each joint is checked, which a log alone often does not determine.
    data : str or Path, optional
        Folder of the data files of an experiment file.

    Returns
    -------
    Findings
        A sequence of `Finding`, empty for a log with nothing to say about.

    Raises
    ------
    DidimError
        One of its kinds, when the experiment or the parameters cannot be read.

    Notes
    -----
    ``test_check.py`` plants a defect of each kind, and finds none where there is none.
    """
    found: list[Finding] = []
    if not isinstance(experiment, Experiment):
        faults: list[tuple[str, TimeFault]] = []
        experiment = load_experiment(experiment, data=data, faults=faults)
        found += time_findings(faults)
    # Load friction is not linear in the parameters, and none of the checks turns on it.
    linear = [term for term in experiment.robot.friction.terms if term.law != "load"]
    experiment = replace(experiment, robot=experiment.robot.with_terms(linear))
    known = None if parameters is None else _standard(experiment, parameters)
    recordings = []
    for recording in experiment.recordings:
        recording.measured_positions()  # refuses a log without them
        of_columns = check_channels(recording)
        found += of_columns
        if experiment.signal.spikes is None:
            found += check_spikes(recording)
        recordings.append(_filterable(_without(recording, of_columns), experiment.signal))
    experiment = replace(experiment, recordings=tuple(recordings))
    found += check_reference(experiment)
    found += check_bandwidth(experiment)
    cutoff = experiment.signal.cutoff_hz
    filtered = cutoff is None or all(cutoff < item.rate_hz / 2.0 for item in experiment.recordings)
    without = [recording.name for recording in experiment.recordings if recording.tau is None]
    if without:
        found.append(
            Finding(
                kind="no-torque",
                sentence=f"recording '{without[0]}' has no torques",
                advice="Add a table [recording.torque]; only CLOE with its output 'position' does without",
                recording=without[0],
            )
        )
    with np.errstate(over="ignore", invalid="ignore"):  # torques beyond floating point are refused by the fit
        shown = recovered(experiment)
    notes: list[str] = []
    without += [item.recording or "" for item in found if item.kind == "constant-torque"]
    if filtered and not without and any(recording.role == "fit" for recording in experiment.recordings):
        found += _model(experiment, known, shown, notes)
    return Findings(
        experiment.name,
        tuple(found),
        experiment.robot.joint_names,
        loop_table(shown),
        tuple(notes),
        tuple(experiment.digests.values()),
    )


def _without(recording: Recording, findings: Sequence[Finding]) -> Recording:
    """Leave out the samples of findings, which would spoil all further checks."""
    used = np.zeros(len(recording.q), dtype=bool)
    for start, stop in recording.windows:
        used[start:stop] = True
    cuts = {start for start, _ in recording.windows}
    for item in findings:
        if item.kind in ("stuck", "jump", "gap") and item.sample is not None:
            last = item.sample if item.last_sample is None else item.last_sample
            used[item.sample : last + 2] = False
            cuts.add(last + 2)
    if len(cuts) == len(recording.windows):
        return recording
    edges = np.flatnonzero(np.diff(np.concatenate([[0], used.astype(int), [0]]))).reshape(-1, 2).tolist()
    longest = max((stop - start for start, stop in edges), default=0)
    windows = tuple(
        (start, stop) for start, stop in edges if stop - start >= max(MINIMUM_SAMPLES, 0.1 * longest)
    )
    return replace(recording, windows=windows) if windows else recording


def _filterable(recording: Recording, signal: SignalProcessing) -> Recording:
    """Leave out windows that are too short for the filters, where others are not: gaps of a log cut it anywhere."""
    least = least_samples(signal) + signal.trim_start + signal.trim_end
    windows = tuple((start, stop) for start, stop in recording.windows if stop - start >= least)
    return replace(recording, windows=windows) if windows else recording


def _standard(experiment: Experiment, parameters: str | Path | Identification | ArrayLike) -> Array:
    """Return known standard parameters, (n_parameters,)."""
    robot = experiment.robot
    if isinstance(parameters, (str, Path)):
        return standard_parameters(robot, str(parameters))
    if isinstance(parameters, Identification):
        if parameters.parameter_names != robot.parameter_names:
            raise FitError(
                f"the result is of robot '{parameters.robot}', the experiment has robot '{robot.name}'"
            )
        return parameters.parameters
    x = real_array("parameters", parameters, FitError)
    if x.shape != (len(robot.parameter_names),) or not np.isfinite(x).all():
        raise FitError(
            f"parameters must be {len(robot.parameter_names)} finite numbers for robot '{robot.name}', got shape {x.shape}"
        )
    return x


def _model(
    experiment: Experiment, known: Array | None, shown: Recovered | None, notes: list[str]
) -> list[Finding]:
    """Run the checks that need the model of the robot, and add what the log cannot show to `notes`."""
    # A wrong fixed value must not speak for the log.
    job = IDIMLS(fixed={}).job(experiment)
    if job.parameters.n_gains:
        # Currents of joints with gains of their own are not torques of one robot.
        return [
            Finding(
                kind="drive-gain",
                sentence="the drive gains are to be estimated, so nothing was compared with the model of the robot",
                advice="Identify them by idim-ls, and check again with gain = [...]",
            )
        ]
    robot = job.robot
    declared = job.declared_delay
    least = least_samples(job.signal)
    try:
        parts = job.parts("fit", declared)
        probe = Probe(job, stretches(parts, MOST_SAMPLES, least))
        whole = probe if probe.n_samples == sum(len(part.q) for part in parts) else Probe(job, parts)
    except (SignalError, FitError) as error:
        return [
            Finding(
                kind="signal",
                sentence=f"the log cannot be filtered as [signal] says: {error}",
                advice="Choose filters that suit rate and length of the log",
            )
        ]
    beta = None
    if known is not None:
        beta = job.parameters.project(job.parameters.extended(known))[job.selection.estimated]
        probe = Probe(job, stretches(parts, MOST_SAMPLES, least), beta)
    (recording, *_) = (item for item in experiment.recordings if item.role == "fit")
    timed = all("time" in item.origin for item in experiment.recordings)
    quick = Probe(job, stretches(parts, _quick_samples(job, parts), least), beta)
    reader = Reader(
        probe, quick, robot, recording, timed=timed, noise=_noise(job, parts), known=known is not None
    )
    found = reader.gross()
    solved = _solved(job, parts)
    rows = rows_of(job, parts) if known is None and job.parameters.simple else None
    if rows is not None and reader.left > CERTAIN and solved is not None and contradicts(*solved):
        cause = check_causes(rows)
        if cause is not None and cause[1] < reader.left:
            return [cause[0]]
    if found:
        # What else a log declared so wrongly seems to have comes from that.
        return found
    turned = [] if solved is None else torque_findings(solved[0])
    if turned:
        return [finding_of(item) for item in turned]
    found = check_payload(job, parts, solved, beta)
    if job.parameters.simple:
        x = None if solved is None else robot.base_parameters.lift(job.selection.expand(solved[1].solution))
        found += check_loop(experiment, x, shown)
    found += check_delay(job, declared) or reader.fine()
    found += check_limits(experiment, parts)
    found += check_standstill(robot, parts)
    if rows is not None:
        notes += unchecked_gains(rows)
    return found + check_excitation(robot, parts, whole, as_declared(robot.n_dof))


def _solved(job: Job, parts: Sequence[Segment]) -> tuple[LinearSystem, Fit] | None:
    """Return the linear system of a log and its solution; None where the log does not identify all parameters."""
    system = job.system(parts)
    try:
        # Thresholds of these checks are those of white noise.
        return system, solve(system, replace(job.settings, uncertainty="white"))
    except RankError:  # reported as parameters that the log does not identify
        return None


def _quick_samples(job: Job, parts: Sequence[Segment]) -> int:
    """Count the samples that leave enough rows of each joint, of a fifth of the motion at least."""
    rows = QUICK_ROWS + 6 * job.signal.edge_rows * len(parts)
    return max(rows * math.prod(job.signal.decimation), sum(len(part.q) for part in parts) // 5)


def _noise(job: Job, parts: Sequence[Segment]) -> Array:
    """Return the standard deviation of the noise of the decimated torques, (n_dof,), if it is white at the rate of the log."""
    tau = np.concatenate([np.diff(part.tau, 2, axis=0) for part in parts])
    # The median does not see the jumps of friction; second differences of white noise have sqrt(6) times its size.
    raw = np.median(np.abs(tau), axis=0) / 0.6745 / np.sqrt(6.0)
    n_samples = max(len(part.q) for part in parts)
    white = np.random.default_rng(0).standard_normal((n_samples, 8))
    kept = decimate(white, decimation_stages(n_samples, job.signal))[job.signal.kept_rows]
    return np.asarray(raw * np.sqrt(np.mean(kept**2)))
