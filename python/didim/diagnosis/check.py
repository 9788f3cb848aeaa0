"""`check`: look at a log before it is fitted.

Each check is a function of a module beside this one. Here is their order, and which of them skips others: a contradiction
that is reported is corrected before the next check. Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array, real_array, true_ranges
from .._tools.progress import ProgressLine
from ..errors import DidimError, FitError, SignalError
from ..evidence.causes import Search
from ..evidence.gain_check import unchecked
from ..evidence.lasting import delay_findings, joint_delay_findings
from ..evidence.loop.law import Recovered, loop_findings, recovered
from ..evidence.naming import cause_findings
from ..evidence.residual import spike_findings
from ..evidence.rows import LogRows
from ..evidence.standstill import check_standstill
from ..evidence.torques import constant_torque_findings
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import load_experiment
from ..log.recording import Recording
from ..log.sampling import MINIMUM_SAMPLES, TimeFault
from ..methods.builder import drift_findings, drift_of, load_finding, load_findings
from ..methods.idim_ls import IDIMLS
from ..methods.job import Job
from ..methods.positions.prospect import prospect
from ..regression.logs.load import load_beyond
from ..result.finding import Finding, worded
from ..result.identification import Identification
from ..signal.filters import least_samples
from ..signal.processing import SignalProcessing
from ..signal.window import Window
from ..studies.run import standard_parameters
from ..terms.rows import check_squares
from .bandwidth import check_bandwidth
from .channels import check_channels
from .excitation import check_excitation
from .finding import Findings
from .limits import check_limits, check_torque_unit
from .reference import check_reference

FEWEST_SPIKES = 3
"""Smallest number of a joint's spikes that is reported; a single sample changes no estimate."""
SHOWN = 100.0
"""Largest gain over the declared one, and error over the torque, that the table of the controller shows."""
MOST_ROUNDS = 3
"""Largest number of wrong declarations reported in one run; each is sought with its predecessors corrected."""
KNOWN_LEFT = 0.7
"""Largest remaining error with a cause beside known parameters, as a share (geometric mean of the joints): errors of the
parameters themselves (load, friction, temperature) are not a wrong declaration."""
MOST_GAPS = 5
"""Largest number of gaps that are reported one by one."""


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
        A sequence of `Finding`, empty for a clean log.

    Raises
    ------
    DidimError
        One of its kinds, when the experiment or the parameters cannot be read.

    Notes
    -----
    ``test_check.py`` plants a defect of each kind, and finds none where there is none.
    """
    with closing(ProgressLine()) as line:
        return _checked(experiment, parameters, data, lambda text: line.show(f"check: {text}"))


def _checked(
    experiment: Experiment | str | Path,
    parameters: str | Path | Identification | ArrayLike | None,
    data: str | Path | None,
    say: Callable[[str], None],
) -> Findings:
    all_findings: list[Finding] = []
    if not isinstance(experiment, Experiment):
        say("reading the log")
        faults: list[tuple[str, TimeFault]] = []
        experiment = load_experiment(experiment, data=data, faults=faults)
        all_findings += time_findings(faults)
    notes: list[str] = []

    def findings(log: Experiment, loop: tuple[tuple[str, ...], ...] = ()) -> Findings:
        digests = tuple(log.digests.values())
        return Findings(log.name, tuple(all_findings), log.robot.joint_names, loop, tuple(notes), digests)

    # Load friction is not linear in the parameters, and none of the checks turns on it.
    experiment = replace(experiment, robot=experiment.robot.without("load"))
    known = None if parameters is None else _standard(experiment, parameters)
    say("looking at the columns")
    recordings = []
    for recording in experiment.recordings:
        recording.measured_positions()  # refuses a log without them
        of_columns = check_channels(recording)
        all_findings += of_columns
        recordings.append(_filterable(_without(recording, of_columns), experiment.signal))
    experiment = replace(experiment, recordings=tuple(recordings))
    if experiment.links == "fixed":
        all_findings += _of_positions(experiment, notes)
        return findings(experiment)
    constant = constant_torque_findings(experiment)
    all_findings += [*constant, *check_reference(experiment), *check_bandwidth(experiment)]
    cutoff = experiment.signal.cutoff_hz
    filtered = cutoff is None or all(cutoff < each.rate_hz / 2.0 for each in experiment.recordings)
    without = [recording.name for recording in experiment.recordings if recording.tau is None]
    if without:
        all_findings.append(
            worded(
                kind="no-torque",
                sentence=f"recording '{without[0]}' has no torques",
                advice="Add a table [recording.torque]; only CLOE with its output 'position' does without",
                recording=without[0],
            )
        )
    say("looking at the controller")
    with np.errstate(over="ignore", invalid="ignore"):  # torques beyond floating point are refused by the fit
        shown = recovered(experiment)
    fits = any(recording.role == "fit" for recording in experiment.recordings)
    if filtered and fits and not (without or constant):
        say("searching for causes of the torque error")
        all_findings += _model(experiment, known, shown, notes)
    return findings(experiment, loop_table(shown))


def _of_positions(experiment: Experiment, notes: list[str]) -> list[Finding]:
    """Look at a log of positions of a robot with known links, and add the parameters that it identifies to `notes`."""
    try:
        findings, identified = prospect(experiment)
    except DidimError as error:
        return [
            worded(
                kind="excitation", sentence=str(error), advice="Correct the experiment file, then check again"
            )
        ]
    notes += identified
    return findings


def _without(recording: Recording, findings: Sequence[Finding]) -> Recording:
    """Leave out the samples of findings, which would spoil all further checks."""
    used = np.zeros(len(recording.q), dtype=bool)
    for start, stop in recording.windows:
        used[start:stop] = True
    cuts = {start for start, _ in recording.windows}
    for finding in findings:
        if finding.kind in ("stuck", "jump", "gap") and finding.sample is not None:
            last = finding.sample if finding.last_sample is None else finding.last_sample
            used[finding.sample : last + 2] = False
            cuts.add(last + 2)
    if len(cuts) == len(recording.windows):
        return recording
    longest = max((stop - start for start, stop in true_ranges(used)), default=0)
    windows = tuple(true_ranges(used, max(MINIMUM_SAMPLES, math.ceil(0.1 * longest))))
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
    if job.model.n_gains:
        # Currents of joints with gains of their own are not torques of one robot.
        return [
            worded(
                kind="drive-gain",
                sentence="the drive gains are to be estimated, so nothing was compared with the model of the robot",
                advice="Identify them by idim-ls, and check again with gain = [...]"
                if experiment.fixed or any(load.split[0].any() for load in experiment.payloads.values())
                else "Give gain = [...], or add a recording with a payload of known mass (mass_kg in its table [payload])",
            )
        ]
    robot, base = job.robot, job.robot.base_parameters
    beta = None if known is None else base.project(known)
    of_fit = [recording for recording in experiment.recordings if recording.role == "fit"]
    try:
        parts = job.parts("fit", job.declared_delay)
    except (SignalError, FitError) as error:
        return [
            worded(
                kind="signal",
                sentence=f"the log cannot be filtered as [signal] says: {error}",
                advice="Choose filters that suit rate and length of the log",
            )
        ]
    # Squares that leave floating point are refused before anything is made of them.
    tau = np.concatenate([part.tau for part in parts])
    with np.errstate(over="ignore"):
        sizes = np.linalg.norm(tau, axis=0)
    for joint, size in enumerate(sizes):
        check_squares(joint, size, size, measured=tau[:, joint])
    try:
        rows = LogRows(robot, job.signal, parts, of_fit, logs=job.model)
    except (SignalError, FitError) as error:
        advice = "Record longer, or decimate less under [signal]"
        return [worded(kind="excitation", sentence=f"the model cannot be tested: {error}", advice=advice)]
    own = [
        *spike_findings(parts, job.signal, FEWEST_SPIKES),
        *check_limits(experiment, parts),
        *check_standstill(robot, parts),
    ]
    if not job.model.simple:
        beta = None  # what the logs have beside the robot is not known
    hints: list[Finding] = []
    judged = rows if beta is None else LogRows(robot, job.signal, parts, of_fit, beta)
    # Beside known parameters the unit is a cause like others; without them a fit does not see it.
    thousand = check_torque_unit(robot, rows, parts) if beta is None else []
    named = [*thousand, *_causes(judged, hints)]
    if named:
        # What else a log declared so wrongly seems to have comes from that.
        return named
    findings = [*hints, *(_between(job, parts, beta) if job.model.simple else ())]
    if shown is not None:
        findings += loop_findings(experiment, base.lift(rows.beta), shown)
    if job.delay_setting != "estimate":
        late = delay_findings(rows, np.zeros(0), obeyed=False)
        findings += late if late or rows.hopeless else _joint_delays(job)
    notes += [recording.sentence for recording in unchecked(rows)]
    n_rows = sum(len(part.q) for part in parts) / math.prod(job.signal.decimation)
    return [*findings, *own, *check_excitation(rows, n_rows)]


def _causes(rows: LogRows, hints: list[Finding]) -> list[Finding]:
    """Return what is declared wrongly, each found with those before it corrected; what is not certain goes to `hints`."""
    named: list[Finding] = []
    with suppress(DidimError):  # a log that cannot be read as a cause says
        for _ in range(MOST_ROUNDS):
            cause = Search(rows).cause()
            if cause is None or not cause.certain:
                hints += cause_findings(rows, cause) if rows.known is None else []
                break
            if rows.known is not None and cause.tried[0].decisive > 2.0 * rows.n * np.log(KNOWN_LEFT):
                break
            named += cause_findings(rows, cause)
            rows = rows.under(cause.tried[0].hypothesis)
    return named


def _between(job: Job, parts: Sequence[Window], beta: Array | None) -> list[Finding]:
    """Return loads and friction that recordings do not share, and a load that known parameters, (b,), do not have."""
    if beta is not None:
        load = load_beyond(job.system(parts), beta, job.robot)
        return [] if load is None else [load_finding(load, f"beside the known parameters the robot {load}")]
    if len({part.recording for part in parts}) < 2:
        return []
    system = job.system(parts)
    try:
        fit = job.solve(system)
    except DidimError:  # reported as parameters that the log does not identify
        return []
    loads = [finding for finding in load_findings(job, system, fit) if finding.grade != "note"]
    return [*loads, *drift_findings(job, drift_of(job, system, fit))]


def _joint_delays(job: Job) -> list[Finding]:
    """Return the delays that fit each joint best, where they are not those that are compensated."""
    try:
        estimate = job.estimate_delay()
    except DidimError:  # no delay fits best, or the recordings are too short or of several rates
        return []
    declared = np.asarray(job.declared_delay.samples)
    return joint_delay_findings(estimate, declared, job.experiment.recordings[0].rate_hz)


def loop_table(shown: Recovered | None) -> tuple[tuple[str, ...], ...]:
    """Return heading and rows of the gains that a log shows over the declared ones; empty without a controller."""
    if shown is None:
        return ()
    names, factors, _ = shown.keys()
    cells = [[f"{value:.3f}" if abs(value) < SHOWN else "-" for value in row] for row in factors]
    rows = [
        (str(joint + 1), *column, f"{100.0 * left:.2g}" if left < SHOWN else "-")
        for joint, (column, left) in enumerate(zip(zip(*cells, strict=True), shown.relative, strict=True))
    ]
    return (("joint", *names, "left %"), *rows)


ADVICE = {
    "order": "Sort or correct the time stamps",
    "gap": "Find the lost samples, or write resample = true under [recording.time], which takes the stretches between gaps",
    "uneven": "Write resample = true under [recording.time], or give rate_hz in place of that table if only the stamps jitter",
    "rate": "Correct rate_hz, or leave it out",
}


def time_findings(faults: Sequence[tuple[str, TimeFault]]) -> list[Finding]:
    """Turn faults of time stamps into findings."""
    findings = []
    kinds = {"order": "uneven-time", "gap": "gap", "uneven": "uneven-time", "rate": "rate"}
    for recording in dict.fromkeys(name for name, _ in faults):
        for kind in ADVICE:
            alike = [fault for name, fault in faults if name == recording and fault.kind == kind]
            shown = alike[: MOST_GAPS if kind == "gap" else 1]
            for fault in shown:
                left = len(alike) - len(shown)
                more = f"; there are {left} more" if left and fault is shown[-1] else ""
                findings.append(
                    worded(
                        kind=kinds[kind],
                        sentence=fault.sentence + more,
                        advice=ADVICE[kind],
                        recording=recording,
                        file=fault.file,
                        sample=fault.sample,
                        value=fault.rate_hz if kind == "rate" else None,
                    )
                )
    return findings
