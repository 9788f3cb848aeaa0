"""The payload of a log, with a robot identified from another log. Tested in ``tests/test_payload.py``.

    y = W beta + W B (v + V theta) + rho,    beta ~ N(beta^, C)

The covariance of the robot enters as additional rows for the parameters of the result. The standard deviations of the payload
have a part from the noise of the log, by the jackknife over its blocks of time, and a part from the robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import brief, series
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...methods.method import FitSettings
from ...regression.covariance import decimated
from ...regression.jackknife import Factors, independent, intervals
from ...regression.linear_system import LinearSystem, linear_system
from ...regression.logs.body import nearest_bodies
from ...regression.logs.parameters import LogParameters
from ...regression.settings import LeastSquaresSettings
from ...regression.weights import joint_sigma, per_row
from ...result.identification import Identification
from ...result.uncertainty import student_factor
from ...robot.correspondence import Pose, homogeneous
from ...robot.payload import NOTHING, Payload, frame_of_payloads
from ...robot.rigid_body import central, pseudo_inertia, roll_pitch_yaw
from ...robot.robot import Robot
from ..loaded import unloaded, with_gains_of
from ..prediction import with_friction_of
from ..validation import same_robot
from .payload_result import PayloadEstimate

UNNAMED = "payload"
"""Name of a log's payload without a name."""
WEIGHT_PASSES = 4
"""Number of solutions, each with the weights of its predecessor."""
PAYLOAD_DRAWS = 400
"""Number of draws of the estimate for the intervals of mass, centre and inertia."""
LARGEST_NUMBER_OF_FRAMES = 3
"""Number of links fixed to the last moving one that notes name."""
SAME_FRAME = 1e-7
"""Entry of a pose's difference from identity up to which two frames are the same."""
EXACT_VARIANCE = 1e-14
"""Variance, as a share of the largest with each parameter in its own unit, below which a direction of the robot is exact."""


@dataclass(frozen=True, eq=False)
class _Solved:
    """Estimate of the log's further parameters."""

    theta: Array
    covariance: Array
    residual: Array
    degrees_of_freedom: float
    n_blocks: int


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
    experiment = with_gains_of(fit, with_friction_of(fit, experiment))
    same_robot(fit, experiment)
    if not fit.std.any():
        raise FitError(
            f"the result '{fit.name}' has no standard deviations: they are needed for the uncertainty of the robot"
        )
    experiment, name = _with_unknown(experiment, link)
    robot = experiment.robot
    parameters = LogParameters.of(
        robot, experiment.recordings, experiment.payloads, experiment.flange, checked=False
    )
    job = FitSettings().job(unloaded(experiment))
    delay = job.delay()
    parts = job.parts("fit", delay)
    beta = robot.base_parameters.project(fit.parameters)  # for load friction, without the payload
    system = linear_system(robot, parts, job.signal, parameters.select({}, ()), beta, parameters)
    solved = _solve(fit, system, parameters, job.settings)
    payload = experiment.payloads[name]
    known, columns, names = payload.split
    block, entries = next(
        (block, entries)
        for block, entries in parameters.slices()
        if (block.kind, block.owner) == ("payload", name)
    )
    chosen = columns[:, [names.index(entry) for entry in block.names]]
    theta, covariance = solved.theta[entries], solved.covariance[entries, entries]
    sizes = system.norms(system.measured)
    estimate = PayloadEstimate(
        name=name,
        robot=robot.name,
        log=experiment.name,
        frame=frame_of_payloads(robot, experiment.flange, payload),
        names=block.names,
        ten=known + chosen @ theta,
        covariance=chosen @ covariance @ chosen.T,
        degrees_of_freedom=solved.degrees_of_freedom,
        n_blocks=solved.n_blocks,
        relative_error=system.norms(solved.residual) / np.where(sizes > 0.0, sizes, np.nan),
        offsets={
            entry.full_names[k]: (
                float(solved.theta[where][k]),
                float(np.sqrt(solved.covariance[where, where][k, k])),
            )
            for entry, where in parameters.slices()
            if entry.kind in ("offset", "friction")
            for k in range(len(entry.names))
        },
        remarks=other_frames(robot, experiment.flange) if payload.link is None else (),
    )
    if len(block.names) < len(names):
        missing = [entry for entry in names if entry not in block.names]
        remark = f"this arm cannot identify {series(missing)}, so there is no complete body"
        return replace(estimate, remarks=(*estimate.remarks, remark))
    return _with_body(estimate, theta, covariance, known, chosen, seed)


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
    fit: Identification, system: LinearSystem, parameters: LogParameters, settings: LeastSquaresSettings
) -> _Solved:
    """Solve for the further parameters, with the uncertainty of the robot's parameters."""
    b = parameters.n_base
    beta = parameters.robot.base_parameters.project(fit.parameters)
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


def _with_body(
    estimate: PayloadEstimate, theta: Array, covariance: Array, known: Array, columns: Array, seed: int
) -> PayloadEstimate:
    """Return the estimate with its nearest body, and intervals from draws."""
    factor = student_factor(0.95, estimate.degrees_of_freedom) / student_factor(0.95, float("inf"))
    noise = np.random.default_rng(seed).standard_normal((PAYLOAD_DRAWS, len(theta)))
    draws = theta + factor * noise @ np.linalg.cholesky(covariance).T
    bodies = nearest_bodies(np.vstack([theta, draws]), covariance, known, columns)
    numbers = np.array([_numbers(body) for body in bodies])
    low, high = np.quantile(numbers[1:], [0.025, 0.975], axis=0)
    moved = np.linalg.lstsq(columns, bodies[0] - known, rcond=None)[0] - theta
    half = 0.5 * float(moved @ np.linalg.solve(covariance, moved))
    remarks = estimate.remarks
    if half > len(theta):
        remarks = (
            *remarks,
            f"the estimate is half a squared distance of {half:.3g} from the nearest body: more than noise explains; the robot, "
            "the log or its offsets are not those of the result",
        )
    return replace(
        estimate,
        body=numbers[0],
        body_std=numbers[1:].std(axis=0, ddof=1) / factor,
        body_low=low,
        body_high=high,
        half_distance=half,
        remarks=remarks,
    )


def _numbers(ten: Array) -> Array:
    """Return mass, centre and ``XX XY XZ YY YZ ZZ`` about the centre, (10,)."""
    mass, centre, inertia = central(pseudo_inertia(ten))
    return np.array([mass, *centre, *inertia[np.triu_indices(3)]])
