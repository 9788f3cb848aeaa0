"""Builder of results for all methods: rows, degrees of freedom and errors are counted in one way.

Tested in ``tests/test_builder.py``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from .._tools.arrays import Array, quotient, ratio
from .._tools.version import __version__
from ..evidence.physics import physical_findings
from ..evidence.torques import contradiction_findings
from ..evidence.whiteness import whiteness, whiteness_findings
from ..experiment.experiment import Experiment
from ..experiment.loop import recordings_of
from ..model.dynamics import rigid_torque
from ..model.physics import Flag, physical_flags
from ..regression.consistent.diagnosis import diagnosis
from ..regression.fit import Fit
from ..regression.friction.alarm import Along, friction_alarm, sampling_errors
from ..regression.logs.drift import Difference, differences, drifts
from ..regression.logs.load import Load, load_between
from ..regression.solver import solver_name
from ..result.finding import Finding
from ..result.further import Further
from ..result.identification import Identification
from ..result.iteration import Iteration, Status
from ..result.uncertainty import Uncertainty
from ..robot.robot import Robot
from ..signal.noise import encoder_step
from ..signal.window import Window
from ..terms.rows import LinearSystem
from .job import Delay, Job
from .method import Described
from .uncertainty import Spread, position_shift, spread_of_fit, with_model_errors

CLEAR_MASS = 3.0
"""Mass of a load, in its standard deviations, below which the finding is a note only: 0.05 +- 0.04 kg need not be declared."""
LARGEST_CONDITION_NUMBER = 1e10
"""Condition number beyond which the estimate has fewer than about six correct digits."""


@dataclass(frozen=True)
class TorqueErrors:
    """Torque errors, summed over rows.

    Attributes
    ----------
    norms : (n_dof,) array
        Norm of the error of each joint (N.m or N).
    torques : (n_dof,) array
        Norm of the measured torque of each joint (N.m or N).
    n_rows : int
        Rows of all joints.
    """

    norms: Array
    torques: Array
    n_rows: int

    @property
    def relative(self) -> Array:
        """Norm of the error over that of the torque of each joint, (n_dof,); NaN without torques."""
        return quotient(self.norms, self.torques, np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """End of a run: all that a result records beside the estimate.

    Attributes
    ----------
    job : Job
        Experiment and settings of the run.
    method : Described
        Name of the method, and the motion of its predictions.
    status, history, delay, remarks, evidence
        As in `Identification`.
    q : (n_samples, n_dof) array
        Positions at which physical consistency is checked.
    settings : mapping
        Additional settings of the method for the record.
    """

    job: Job
    method: Described
    status: Status
    history: Sequence[Iteration]
    delay: Delay
    q: Array
    settings: Mapping[str, Any] = field(default_factory=dict)
    remarks: Sequence[str] = ()
    evidence: Sequence[Finding] = ()


def identification(
    run: Run,
    *,
    beta: Array,
    spread: Spread,
    errors: TorqueErrors,
    condition_number: float,
    held_out: bool = True,
    standard: Array | None = None,
) -> Identification:
    """Build the result of a run.

    Parameters
    ----------
    run : Run
        End of the run.
    beta : (b,) array
        All base parameters, fixed ones included, then the further parameters of the logs.
    spread : Spread
        Covariance of the estimated parameters, and its source, to which the residuals of the joints are added here.
    errors : TorqueErrors
        Errors of the torques on the rows of the fit.
    condition_number : float
        Condition number of the columns.
    held_out : bool
        Whether held-out recordings have torques for comparison.
    standard : (n_parameters,) array, optional
        Physically consistent standard parameters, optionally followed by those of the logs; by default beta lifted.
    """
    job, method = run.job, run.method
    robot = job.robot
    full, uncertainty = job.model.unknowns.expand_covariance(spread.covariance), spread.uncertainty
    b, norm = job.model.n_base, float(np.linalg.norm(errors.norms))
    further = None
    if not job.model.simple:
        uncertainty, further = _split(job, beta, full, uncertainty)
    freedom = max(1, job.settings.divisor(errors.n_rows, len(job.model.unknowns.estimated)))
    if uncertainty is not None:
        per_joint = freedom / max(1, len(errors.norms))
        uncertainty = replace(uncertainty, joint_std=errors.norms / np.sqrt(per_joint))
    flags = _flags(run, beta[:b], full[:b, :b])
    return Identification(
        name=job.experiment.name,
        robot=robot.name,
        method=method.name,
        status=run.status,
        names=robot.base_parameters.names,
        units=robot.base_parameters.units,
        roles=job.model.unknowns.roles[:b],
        beta=beta[:b],
        covariance=full[:b, :b],
        parameter_names=robot.parameter_names,
        parameters=robot.base_parameters.lift(beta[:b])
        if standard is None
        else standard[: len(robot.parameter_names)],
        relative_error=errors.relative,
        overall_relative_error=ratio(norm, np.linalg.norm(errors.torques)),
        error_norm=norm,
        error_std=norm / float(np.sqrt(freedom)),
        condition_number=condition_number,
        n_rows=errors.n_rows,
        uncertainty=uncertainty,
        further=further,
        history=tuple(run.history),
        held_out=tuple(job.held_out(beta, run.delay)) if held_out else (),
        warnings=tuple(flag.sentence for flag in flags),
        remarks=tuple(run.remarks),
        evidence=(*run.evidence, *physical_findings(flags)),
        delay=run.delay.record(),
        settings=record(job, prediction={"motion": method.motion, "raw": method.raw}, **run.settings),
        digests=digests(job.experiment),
    )


def _flags(run: Run, beta: Array, covariance: Array) -> tuple[Flag, ...]:
    """Return what is physically impossible of base parameters, (b,)."""
    job = run.job
    named = zip(job.robot.base_parameters.names, job.model.unknowns.roles[: beta.size], strict=True)
    estimated = {name for name, role in named if role == "estimated"}
    flags = physical_flags(job.robot, beta, covariance, run.q, unknown=estimated)
    if run.status.converged:
        return flags
    # Signs of unfinished iterations, without standard deviations, are not evidence.
    return tuple(flag for flag in flags if np.isfinite(flag.sigmas) or not {*flag.parameters} & estimated)


def _split(
    job: Job, beta: Array, covariance: Array, uncertainty: Uncertainty | None
) -> tuple[Uncertainty | None, Further]:
    """Return the uncertainty of only the robot's parameters, and the further parameters of the logs."""
    b, names = job.model.n_base, job.robot.base_parameters.names
    white = np.full(job.model.n_further, np.nan)
    if uncertainty is not None:
        white = uncertainty.std_white[b:]
        uncertainty = replace(
            uncertainty,
            std_white=uncertainty.std_white[:b],
            deletions=uncertainty.deletions[:, :b],
            positions=uncertainty.positions[:b],
            noise=uncertainty.noise[:b],
            single_block={key: value for key, value in uncertainty.single_block.items() if key in names},
        )
    used = {recording.payload for recording in job.experiment.recordings}
    return uncertainty, Further(
        blocks=job.model.blocks,
        values=beta[b:],
        covariance=covariance,
        std_white=white,
        payloads={name: recording for name, recording in job.experiment.payloads.items() if name in used},
        reference=job.model.reference,
        flange=job.experiment.flange,
    )


def fitted(
    run: Run,
    system: LinearSystem,
    fit: Fit,
    *,
    beta: Array | None = None,
    parts: Sequence[Window] = (),
) -> Identification:
    """Build the result of a run that ends with the solution of a system (7); see `identification`.

    `beta` are the final parameters, (b,), if they differ from the last solution. `parts` is the motion of the system, if its
    residual can be tested for missing friction, and along measured motion for what only parameters of no robot explain.
    """
    job, converged = run.job, run.status.converged
    spread = spread_of_fit(system, fit, job.settings, job.model.unknowns)
    if parts and converged:
        spread = _with_model_errors(run, system, fit, parts, spread)
    errors = TorqueErrors(system.norms(fit.residual), system.norms(system.measured), system.y.size)
    lasting = whiteness_findings(
        whiteness(fit.residual, system.blocks, len(system.joints)),
        errors.relative,
        spread.uncertainty,
        np.sqrt(np.diag(job.model.unknowns.expand_covariance(spread.covariance))),
    )
    moved = drift_of(job, system, fit) if converged else []
    loads = load_findings(job, system, fit) if converged else []
    # A simulating method compares the torques along measured motion before it begins.
    measured = bool(parts) and converged and run.method.motion == "measured"
    torn = contradiction_findings(diagnosis(fit)) if measured and fit.standard is not None else []
    drift = {"drift": [asdict(difference) for difference in moved]} if moved else {}
    run = replace(
        run,
        settings={"solver": {"name": solver_name(job.solver_choice), **fit.record}, **drift, **run.settings},
        remarks=(*fit.remarks, *run.remarks, *spread.remarks),
        evidence=(*run.evidence, *torn, *lasting, *drift_findings(job, moved), *loads),
    )
    return identification(
        run,
        beta=job.model.unknowns.expand(fit.solution) if beta is None else beta,
        spread=spread,
        errors=errors,
        condition_number=fit.condition_number,
        standard=fit.standard,
    )


def _with_model_errors(
    run: Run, system: LinearSystem, fit: Fit, parts: Sequence[Window], spread: Spread
) -> Spread:
    """Return a spread with the bias by missing friction, errors of positions, and friction at speeds."""
    job, recordings = run.job, run.job.experiment.recordings
    # Simulated motion has no encoders.
    numbers = {part.recording for part in parts} if run.method.motion == "measured" else ()
    steps = {k: encoder_step(recordings[k].measured_positions()) for k in numbers}
    x = job.lift(fit.solution)
    standard = [job.model.standard(x, part.recording) for part in parts]
    load = [
        rigid_torque(job.robot, part.q, part.dq, part.ddq, values)
        for part, values in zip(parts, standard, strict=True)
    ]
    along = Along(
        robot=job.robot,
        x=x[: len(job.robot.parameter_names)],
        parts=parts,
        signal=job.signal,
        load=load,
        encoder_step=np.max(list(steps.values()), axis=0) if steps else None,
        errors=sampling_errors(job.robot, parts, standard, load) if steps else [],
    )
    alarm = friction_alarm(system, fit, along)
    moved = position_shift(job, system, fit, parts, steps)
    return with_model_errors(spread, alarm, moved, along, job.model, system.names)


def drift_of(job: Job, system: LinearSystem, fit: Fit) -> list[Difference]:
    """Return the differences of recordings that share offsets or friction."""
    own = {key for _, recording in recordings_of(job.experiment) for key in recording.own}
    moved = []
    if "offsets" not in own:
        moved += differences(system, fit, "offset", job.settings.blocks)
    if "friction" not in own:
        moved += differences(system, fit, "friction", job.settings.blocks)
    return moved


def drift_findings(job: Job, moved: Sequence[Difference]) -> list[Finding]:
    """Return findings on recordings that differ in declared common parameters."""
    names = [recording.name for recording in job.experiment.recordings]
    return [
        Finding(
            code="drift",
            grade="doubtful",
            joints=difference.joints,
            recordings=difference.recordings,
            value=difference.worst.value,
            deviation=difference.worst.std,
            facts={
                "of": difference.kind,
                "parameter": difference.worst.parameter,
                "recording": names[difference.worst.recording],
                "levels": [
                    {
                        "recording": names[level.recording],
                        "joint": level.joint + 1,
                        "share": level.value,
                        "std": level.std,
                    }
                    for level in difference.levels
                ],
            },
        )
        for difference in drifts(moved, names)
    ]


def load_findings(job: Job, system: LinearSystem, fit: Fit) -> list[Finding]:
    """Return a finding for each recording with a load that another does not have."""
    if not job.model.simple or not {block.recording for block in system.blocks} - {
        system.blocks[0].recording
    }:
        return []
    names = [recording.name for recording in job.experiment.recordings]
    return [
        load_finding(load, f"beside the first recording '{names[number]}' {load}", names[number])
        for number, load in load_between(system, fit, job.robot, job.settings.blocks)
    ]


def load_finding(load: Load, text: str, recording: str = "") -> Finding:
    """Return the finding of a load."""
    return Finding(
        code="payload",
        grade="note" if abs(load.mass) < CLEAR_MASS * load.std else "doubtful",
        recordings=(recording,) if recording else (),
        value=load.mass_or_none,
        deviation=None if load.mass_or_none is None else load.std,
        facts={
            "text": text,
            "advice": 'Declare it: [payload.NAME] and payload = "NAME" under [[recording]]',
        },
    )


def record(job: Job, **more: Any) -> dict[str, Any]:
    """Return settings and recordings of a run as JSON data (lists instead of tuples)."""
    setting = job.delay_setting
    return experiment_record(
        job.experiment,
        job.robot,
        signal=asdict(job.signal),
        least_squares=asdict(job.settings),
        delay={"compensate_samples": setting.samples if isinstance(setting, Delay) else setting},
        fixed=job.model.unknowns.given("fixed"),
        dropped=list(job.model.unknowns.given("dropped")),
        **more,
    )


def experiment_record(experiment: Experiment, robot: Robot, **more: Any) -> dict[str, Any]:
    """Return the record of experiment and robot, with the friction of the run, as JSON data."""
    import scipy  # imports subprocess and more

    asked = {
        "versions": {"didim": __version__, "numpy": np.__version__, "scipy": scipy.__version__},
        "experiment": experiment.name,
        # With the friction of the experiment, which the digest of the robot file does not include.
        "robot": {
            "name": robot.name,
            "joint_names": robot.joint_names,
            "geometry": asdict(robot.geometry),
            "friction": asdict(robot.friction),
        },
        "fixed": dict(experiment.fixed),
        "dropped": experiment.dropped,
        "recordings": [
            {
                "name": recording.name,
                "role": recording.role,
                "rate_hz": recording.rate_hz,
                "windows": recording.windows,
                **recording.origin,
            }
            for recording in experiment.recordings
        ],
        **more,
    }
    restored: dict[str, Any] = json.loads(json.dumps(asked))
    return restored


def solved_status(fit: Fit) -> Status:
    """Return the status of a single least-squares problem."""
    if fit.stopped:
        return Status.STOPPED
    if not fit.converged:
        return Status.NOT_CONVERGED
    return Status.SOLVED if fit.condition_number < LARGEST_CONDITION_NUMBER else Status.ILL_CONDITIONED


def digests(experiment: Experiment) -> dict[str, str]:
    """Return the digests of all files of an experiment."""
    data = (item for recording in experiment.recordings for item in recording.digests.items())
    return {**experiment.digests, **{f"data {file}": digest for file, digest in data}}
