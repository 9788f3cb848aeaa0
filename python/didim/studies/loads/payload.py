"""The payload of a log, with a robot identified from another log. Tested in ``tests/test_payload.py``.

    y = W beta + W B (v + V theta) + rho,    beta ~ N(beta^, C)

The covariance of the robot enters as additional rows for the parameters of the result. The standard deviations of the payload
have a part from the noise of the log, by the jackknife over its blocks of time, and a part from the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import brief, series
from ...errors import FitError
from ...evidence.applied.load import body_findings, load_findings
from ...evidence.applied.log import AppliedLog, Errors, applied_findings
from ...experiment.experiment import Experiment
from ...log.recording import Recording
from ...methods.method import FitSettings
from ...regression.covariance import Factors, decimated, independent, intervals
from ...regression.least_squares import joint_sigma, per_row
from ...regression.logs.body import nearest_bodies
from ...regression.settings import LeastSquaresSettings
from ...result.finding import Finding
from ...result.identification import Identification
from ...result.uncertainty import student_factor
from ...robot.correspondence import Pose, homogeneous
from ...robot.payload import NOTHING, Payload, frame_of_payloads
from ...robot.rigid_body import central, pseudo_inertia, roll_pitch_yaw
from ...robot.robot import Robot
from ...signal.window import Window
from ...terms.build import model_of
from ...terms.model import Model
from ...terms.rows import LinearSystem
from ...terms.share import ColumnBlock
from ..loaded import as_fitted, unloaded
from ..validation import same_robot
from .payload_result import PayloadEstimate

UNNAMED = "payload"
"""Name of a log's payload without a name."""


UNKNOWN_BODY = frozenset({"no-load", "load-inside", "absurd-load"})
"""Codes of findings by which centre and inertia of a payload are not known."""
LARGEST_NUMBER_OF_FRAMES = 3
"""Number of links fixed to the last moving one that notes name."""
SAME_FRAME = 1e-7
"""Entry of a pose's difference from identity up to which two frames are the same."""
WEIGHT_PASSES = 4
"""Number of solutions, each with the weights of its predecessor."""
EXACT_VARIANCE = 1e-14
"""Variance, as a share of the largest with each parameter in its own unit, below which a direction of the robot is exact."""
PAYLOAD_DRAWS = 400
"""Number of draws of the estimate for the intervals of mass, centre and inertia."""


@dataclass(frozen=True, eq=False)
class _Solved:
    """Estimate of the log's further parameters."""

    theta: Array
    covariance: Array
    residual: Array
    degrees_of_freedom: float
    n_blocks: int


@dataclass(frozen=True, kw_only=True, eq=False)
class _Found:
    """A log as the result reads it, and the payload in it.

    `entries` are those of the payload among the further parameters, `known` and `columns` make its ten parameters of them, and
    `missing` are those that the arm cannot identify.
    """

    experiment: Experiment
    parameters: Model
    parts: Sequence[Window]
    system: LinearSystem
    solved: _Solved
    entries: slice
    known: Array
    columns: Array
    missing: tuple[str, ...]

    @property
    def theta(self) -> Array:
        """Unknown parameters of the payload, (k,)."""
        return self.solved.theta[self.entries]

    @property
    def covariance(self) -> Array:
        """Their covariance, (k, k)."""
        return self.solved.covariance[self.entries, self.entries]


def identify_payload(
    fit: Identification, experiment: Experiment, *, link: str | None = None, seed: int = 0
) -> PayloadEstimate:
    """Estimate an unknown payload of a log with the robot of a result.

    Parameters
    ----------
    fit : Identification
        Robot with its covariance, from a log without this payload.
    experiment : Experiment
        The log. Its recordings to fit name the payload; the table ``[payload.NAME]`` may give known properties. If none is
        named, all ten parameters are unknown. Own offsets of recordings with ``offsets = "own"`` are estimated too.
    link : str, optional
        Link that carries a payload without a table, as `didim.Payload` has it.
    seed : int
        Seed of the draws.

    Returns
    -------
    PayloadEstimate
        Ten parameters about the flange, and mass, centre and inertia of the nearest body with intervals.

    Raises
    ------
    FitError
        For another robot, a known payload, and more than one unknown payload.
    DidimError
        As for an identification.

    Notes
    -----
    ``test_payload.py`` compares errors with standard deviations; ``benches/payloads.py`` does so for ten random payloads.
    """
    found, estimate, taken = _found(fit, experiment, link)
    evidence = [*taken, *_evidence(fit, found, estimate)]
    estimate = replace(estimate, fit_error=fit.relative_error, evidence=tuple(evidence))
    if any(finding.code in UNKNOWN_BODY or finding.grade == "wrong" for finding in evidence):
        return estimate
    if found.missing:
        remark = f"this arm cannot identify {series(found.missing)}, so there is no complete body"
        return replace(estimate, remarks=(*estimate.remarks, remark))
    return _with_body(estimate, found, seed)


def payload_in(fit: Identification, experiment: Experiment, link: str | None = None) -> PayloadEstimate:
    """Return the estimate of `identify_payload` without its body and without evidence: ten parameters and their covariance."""
    return _found(fit, experiment, link)[1]


def _found(
    fit: Identification, experiment: Experiment, link: str | None
) -> tuple[_Found, PayloadEstimate, list[Finding]]:
    """Estimate the further parameters of a log as the result reads it; return the payload among them, and a note on the reading."""
    experiment, taken = as_fitted(fit, experiment)
    same_robot(fit, experiment)
    if not fit.std.any():
        raise FitError(
            f"the result '{fit.name}' has no standard deviations: they are needed for the uncertainty of the robot"
        )
    experiment, name = _with_unknown(experiment, link)
    robot = experiment.robot
    parameters = model_of(robot, experiment.recordings, experiment.payloads, experiment.flange, checked=False)
    job = FitSettings().job(unloaded(experiment))
    delay = job.delay()
    parts = job.parts("fit", delay)
    beta = robot.base_parameters.project(fit.parameters)  # for load friction, without the payload
    system = parameters.rows(parts, job.signal, beta)
    solved = _solve(fit, system, parameters, job.settings)
    block, entries = next(
        (share.block, entries)
        for share, entries in parameters.slices()
        if (share.block.kind, share.block.owner) == ("payload", name)
    )
    known, columns, names = experiment.payloads[name].split
    chosen = columns[:, [names.index(entry) for entry in block.names]]
    found = _Found(
        experiment=experiment,
        parameters=parameters,
        parts=parts,
        system=system,
        solved=solved,
        entries=entries,
        known=known,
        columns=chosen,
        missing=tuple(entry for entry in names if entry not in block.names),
    )
    return found, _estimate(found, block), taken


def _estimate(found: _Found, block: ColumnBlock) -> PayloadEstimate:
    """Return the estimate of a payload's block of parameters, without its body."""
    experiment, solved, system = found.experiment, found.solved, found.system
    robot, payload = experiment.robot, experiment.payloads[block.owner]
    sizes = system.norms(system.measured)
    return PayloadEstimate(
        name=block.owner,
        robot=robot.name,
        log=experiment.name,
        frame=frame_of_payloads(robot, experiment.flange, payload),
        names=block.names,
        ten=found.known + found.columns @ found.theta,
        covariance=found.columns @ found.covariance @ found.columns.T,
        degrees_of_freedom=solved.degrees_of_freedom,
        n_blocks=solved.n_blocks,
        relative_error=system.norms(solved.residual) / np.where(sizes > 0.0, sizes, np.nan),
        offsets={
            share.block.full_names[k]: (
                float(solved.theta[where][k]),
                float(np.sqrt(solved.covariance[where, where][k, k])),
            )
            for share, where in found.parameters.slices()
            if share.block.kind in ("offset", "friction")
            for k in range(len(share.block.names))
        },
        remarks=other_frames(robot, experiment.flange) if payload.link is None else (),
    )


def _evidence(fit: Identification, found: _Found, estimate: PayloadEstimate) -> list[Finding]:
    """Return what speaks against a payload: errors above those of the fit, what explains them, and a load that is none."""
    system, parameters, b = found.system, found.parameters, found.parameters.n_base
    robot = found.experiment.robot
    root = np.sqrt(max(1, system.y.size // robot.n_dof))
    errors = Errors.beside(
        fit, system.norms(found.solved.residual) / root, system.norms(system.measured) / root
    )
    beta = robot.base_parameters.project(fit.parameters)
    fitted = [recording for recording in found.experiment.recordings if recording.role == "fit"]
    known = np.concatenate([beta, np.full(parameters.n_further, np.nan)])
    log = AppliedLog(robot, found.experiment.signal, parameters, known, found.parts, fitted)
    findings = applied_findings(log, errors)
    if any(finding.grade == "wrong" for finding in findings):
        return findings  # what the load is comes from that
    load = system.w[:, b:][:, found.entries] @ found.theta
    load = load if system.known is None else load + system.known
    own = float(np.linalg.norm(system.w[:, :b] @ beta))
    return [
        *findings,
        *load_findings(
            estimate.ten,
            estimate.std,
            estimate.degrees_of_freedom,
            estimate.names,
            float(np.linalg.norm(load)) / own if own > 0.0 else 0.0,
            same_log=_of_the_fit(fit, fitted),
        ),
    ]


def _of_the_fit(fit: Identification, recordings: Sequence[Recording]) -> bool:
    """Whether data of the recordings are those of a fit that knew of no payload, by the digests of their files."""
    known = {digest for key, digest in fit.digests.items() if key.startswith("data ")}
    own = {digest for recording in recordings for digest in recording.digests.values()}
    return bool(known & own) and (fit.further is None or not fit.further.payloads)


def other_frames(robot: Robot, flange: Pose | None) -> tuple[str, ...]:
    """Return sentences on frames of a URDF that a pendant may use in place of that of the last moving link."""
    places = robot.correspondence
    if flange is not None or places is None or not places.links[-1].lumped:
        return ()
    last = places.links[-1]
    if not last.lumped_poses:
        return (
            f"links fixed to {last.link}: {series(last.lumped, 40)}; if the pendant uses the frame of one, write its pose "
            "there under [flange] (xyz_m, rpy_rad)",
        )
    poses = zip(last.lumped[:LARGEST_NUMBER_OF_FRAMES], last.lumped_poses, strict=False)
    return tuple(_for_coordinates_of(brief(link), homogeneous(pose)) for link, pose in poses)


def _for_coordinates_of(link: str, pose: Array) -> str:
    """Return the sentence on a link with this pose, (4, 4), in the frame of the flange."""
    if np.allclose(pose, np.eye(4), rtol=0.0, atol=SAME_FRAME):
        return f"link {link} has the same coordinates"
    # Adding zero turns -0.0 into 0.0.
    numbers = np.round([*pose[:3, 3], *roll_pitch_yaw(pose[:3, :3])], 7) + 0.0
    xyz, rpy = (", ".join(f"{value:.9g}" for value in part) for part in (numbers[:3], numbers[3:]))
    return f"for coordinates of link {link}: [flange] with xyz_m = [{xyz}], rpy_rad = [{rpy}]"


def _with_unknown(experiment: Experiment, link: str | None) -> tuple[Experiment, str]:
    """Return the experiment whose recordings name the unknown payload, and its name."""
    fitted = [recording for recording in experiment.recordings if recording.role == "fit"]
    if not fitted:
        raise FitError(f"experiment '{experiment.name}' has no recording with role 'fit'")
    used = sorted({recording.payload for recording in fitted})
    if used == [NOTHING]:
        recordings = [
            replace(recording, payload=UNNAMED) if recording.role == "fit" else recording
            for recording in experiment.recordings
        ]
        payloads = {**experiment.payloads, UNNAMED: Payload(name=UNNAMED, link=link)}
        return replace(experiment, recordings=tuple(recordings), payloads=payloads), UNNAMED
    open_names = [
        name for name in used if name in experiment.payloads and not experiment.payloads[name].known
    ]
    missing = [name for name in used if name != NOTHING and name not in experiment.payloads]
    if missing:
        payloads = {**experiment.payloads, **{name: Payload(name=name, link=link) for name in missing}}
        return _with_unknown(replace(experiment, payloads=payloads), link)
    if len(open_names) != 1:
        what = "all payloads are known" if not open_names else f"there are several: {series(open_names, 60)}"
        raise FitError(f"experiment '{experiment.name}' must have one unknown payload, and {what}")
    (name,) = open_names
    if link is not None:
        payloads = {**experiment.payloads, name: replace(experiment.payloads[name], link=link)}
        experiment = replace(experiment, payloads=payloads)
    return experiment, name


@np.errstate(over="ignore", invalid="ignore")  # absurdly large samples end in an error
def _solve(
    fit: Identification, system: LinearSystem, parameters: Model, settings: LeastSquaresSettings
) -> _Solved:
    """Solve for the further parameters, with the uncertainty of the robot's parameters."""
    b = parameters.n_base
    beta = parameters.own.base_parameters.project(fit.parameters)
    root = _root(fit.covariance)
    columns = np.hstack([system.w[:, :b] @ root, system.w[:, b:]])
    y = system.y - system.w[:, :b] @ beta
    k, e = root.shape[1], parameters.n_further
    rows = system.y.size
    prior = np.hstack([np.eye(k), np.zeros((k, e))])
    start = np.linalg.lstsq(columns[:, k:], y, rcond=None)[0]
    residual = y - columns[:, k:] @ start
    for _ in range(WEIGHT_PASSES):
        weights = per_row(system, 1.0 / joint_sigma(replace(system, y=y), residual))
        a = np.vstack([columns * weights[:, None], prior])
        solution = np.linalg.lstsq(a, np.concatenate([y * weights, np.zeros(k)]), rcond=None)[0]
        residual = y - columns @ solution
    try:
        factors = Factors.of(a, np.concatenate([residual * weights, -solution[:k]]))
    except np.linalg.LinAlgError:
        wanted = series(system.names[b:], 80)
        raise FitError(
            f"the log does not separate all of {wanted} apart: look for samples out of scale (`didim check`), or move more joints"
        ) from None
    log = replace(
        factors, left=factors.left[:rows], right=factors.right[:rows], residual=factors.residual[:rows]
    )
    from_robot = factors.inverse @ factors.left[rows:].T
    parts = intervals(system.blocks, settings.blocks)
    whole = replace(system, w=columns, y=y, known=None)
    of_log = decimated(whole, replace(settings, weights="per-joint"), log.left, log.residual, factors.inverse)
    freedom, n_blocks = float(rows - e), 0
    if settings.uncertainty == "jackknife" and len(parts) > 1:
        every = log.jackknife([part.rows for part in parts])
        found = independent(log, system.blocks, parts, every)
        ratio = np.sqrt(np.diag(found.covariance) / np.maximum(np.diag(of_log), np.finfo(float).tiny))
        of_log = of_log * np.outer(ratio, ratio)
        n_blocks = len(found.deletions)
        freedom = n_blocks - 1.0
    covariance = of_log + from_robot @ from_robot.T
    return _Solved(solution[k:], covariance[k:, k:], residual, freedom, n_blocks)


def _root(covariance: Array) -> Array:
    """Return L of full column rank with ``L L^T`` the covariance (b, b)."""
    size = np.sqrt(np.diag(covariance))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    known = values > EXACT_VARIANCE * values[-1]
    return np.asarray(scale[:, None] * vectors[:, known] * np.sqrt(values[known]))


def _with_body(estimate: PayloadEstimate, found: _Found, seed: int) -> PayloadEstimate:
    """Return the estimate with its nearest body, and intervals from draws."""
    theta, covariance, known, columns = found.theta, found.covariance, found.known, found.columns
    factor = student_factor(0.95, estimate.degrees_of_freedom) / student_factor(0.95, float("inf"))
    noise = np.random.default_rng(seed).standard_normal((PAYLOAD_DRAWS, len(theta)))
    draws = theta + factor * noise @ np.linalg.cholesky(covariance).T
    bodies = nearest_bodies(np.vstack([theta, draws]), covariance, known, columns)
    numbers = np.array([_numbers(body) for body in bodies])
    low, high = np.quantile(numbers[1:], [0.025, 0.975], axis=0)
    moved = np.linalg.lstsq(columns, bodies[0] - known, rcond=None)[0] - theta
    half = 0.5 * float(moved @ np.linalg.solve(covariance, moved))
    return replace(
        estimate,
        body=numbers[0],
        body_std=numbers[1:].std(axis=0, ddof=1) / factor,
        body_low=low,
        body_high=high,
        half_distance=half,
        evidence=(*estimate.evidence, *body_findings(half, len(theta))),
    )


def _numbers(ten: Array) -> Array:
    """Return mass, centre and ``XX XY XZ YY YZ ZZ`` about the centre, (10,)."""
    mass, centre, inertia = central(pseudo_inertia(ten))
    return np.array([mass, *centre, *inertia[np.triu_indices(3)]])
