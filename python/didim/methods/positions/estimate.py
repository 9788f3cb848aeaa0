"""CLOE with known links: drives and friction of a robot from commanded and measured positions, without torques.

First the parameters that the log identifies, then the search. Parameters that it does not identify after all are held, and the
search goes on. Intervals come last.
Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._tools.arrays import Array, quotient, rms, unit_diagonal
from ..._tools.saved import plain
from ..._tools.words import series
from ...errors import FitError
from ...evidence.residual import size_finding
from ...evidence.thresholds import SIZE_DOUBTFUL, SIZE_WRONG
from ...experiment.experiment import Experiment
from ...experiment.unknown import ACCELERATION, SOFT
from ...result.finding import Finding, Grade, worded
from ...result.identification import Identification
from ...result.iteration import Reporter, Status
from ...result.positions.record import KEY
from ...result.uncertainty import Uncertainty
from ..builder import digests, experiment_record
from .intervals import (
    LASTING,
    Intervals,
    changes,
    errors_over_noise,
    intervals,
    model_errors,
    per_step,
    widened,
)
from .knowledge import by_sentence, held_at, unidentified, weak_pairs
from .laws import (
    LEAST_M,
    of_planned_set_points,
    search_of_either_friction,
    searched,
    with_explained_stretches,
    without_pushes,
)
from .problem import Problem, may_be_soft
from .search import Search, at_bound, begun
from .stops import findings_of

if TYPE_CHECKING:
    from ..cloe.settings import CLOESettings

MOST_ITERATIONS = 40
"""Default upper bound of the iterations: from the centre of wide bounds a quadruped takes six."""
TOLERANCE = 1e-4
"""Relative decrease of the cost below which a search ends: the parameters then move by a hundredth of their standard
deviations."""
UNLIKE = 3.0
"""Distance of a joint from its siblings, in standard deviations, from which it is reported."""
UNLIKE_SHARE = 0.4
"""Smallest distance, as a share of the siblings' median: joints of one kind differ by a third on a real quadruped."""
SCALE = "positions show no common factor of all torques: with the masses of the file and kp off by 10 %, so are Ia, Fv, Fc and Off"
"""Sentence on what no log of positions tells."""
GRAVE = frozenset({"kp", "kv", "delay_s", "lag_s", ACCELERATION})
"""Unknowns of drives whose fixed value strongly affects other estimates."""


def identify_positions(
    method: CLOESettings,
    experiment: Experiment,
    reporter: Reporter,
) -> Identification:
    """Identify drives and friction of a robot with known links.

    Raises
    ------
    FitError
        For an experiment that lacks a recorded reference, a PD law, or links.
    """
    if method.fixed is not None:
        experiment = replace(experiment, fixed=dict(method.fixed))
    if method.dropped is not None:
        experiment = replace(experiment, dropped=tuple(method.dropped))
    _check(method, experiment)
    given = method.start if isinstance(method.start, Mapping) else None
    problem = Problem(experiment, method.noise, method.threads, given)
    if not problem.columns:
        raise FitError(f"{experiment.name}: all parameters are fixed or dropped")
    now = begun(problem)
    before = problem.joint_errors(now.errors)
    now.held = unidentified(now, strict=True)
    options: dict[str, Any] = {
        "most": method.max_iterations or MOST_ITERATIONS,
        "tolerance": method.tolerance if method.tolerance != type(method).tolerance else TOLERANCE,
        "reporter": reporter,
    }
    if may_be_soft(experiment):
        now, shift = search_of_either_friction(now, options)
    else:
        now = searched(now, options)
        shift = np.zeros(len(now.theta))
    planned = of_planned_set_points(now, options)
    if len(planned.theta) > len(now.theta):
        shift = np.zeros(len(planned.theta))
        law = planned.problem.soft or planned.problem.sticks or not may_be_soft(experiment)
        if not (law or planned.status is Status.STOPPED):
            planned, shift = search_of_either_friction(planned, options)
    now = planned
    rest = without_pushes(now, options)
    if rest is not now and may_be_soft(experiment) and not (rest.problem.soft or rest.problem.sticks):
        # Pushes had hidden the law of friction.
        rest, shift = search_of_either_friction(rest, options)
    now = with_explained_stretches(rest, options)
    over = errors_over_noise(now)
    inexact = errors_over_noise(now, LEAST_M) > LASTING
    at = [bool(inexact[list(column.joints)].any()) for column in now.problem.columns]
    spread = widened(intervals(now), np.where(at, shift, 0.0))
    return _result(now, spread, before, model_errors(over, shift, now.rows / experiment.robot.n_dof))


def _check(method: CLOESettings, experiment: Experiment) -> None:
    """Refuse settings of CLOE that a search with known links does not have."""
    usual = method.optimizer == "levenberg-marquardt" and method.output == "position" and not method.physical
    if not usual or method.starts > 1:
        raise FitError('links = "fixed" is for optimizer "levenberg-marquardt" on positions, from one start')
    for key in ("checkpoint", "max_evaluations", "executor"):
        if getattr(method, key) is not None:
            raise FitError(f'links = "fixed" takes no {key}: such a search takes seconds; leave it out')
    if method.start is not None and not isinstance(method.start, Mapping):
        raise FitError(
            f'links = "fixed" starts from the robot file and [unknown]: start is a mapping of names to values, got {method.start!r}'
        )
    if method.noise is not None and len(method.noise) != experiment.robot.n_dof:
        raise FitError(f"noise needs one number per joint, {experiment.robot.n_dof}, got {len(method.noise)}")


def _result(now: Search, spread: Intervals, before: Array, exactness: list[Finding]) -> Identification:
    """Return the result of a search, with the errors of the joints `before` it and findings on the exactness of those after it."""
    problem, experiment = now.problem, now.problem.experiment
    x, drive = problem.parameters(now.theta[None])
    a, _ = now.normal()
    weak, rows = weak_pairs(now, a), _rows(now, spread)
    after = problem.joint_errors(now.errors)
    siblings = _unlike(problem, rows)
    use = now.used(a)
    condition = float(np.linalg.cond(unit_diagonal(a[np.ix_(use, use)])[0])) if use.size else math.inf
    norm = math.sqrt(now.squares)
    shares = quotient(after, before, np.nan)
    return Identification(
        name=experiment.name,
        robot=experiment.robot.name,
        method="cloe-positions",
        status=now.status,
        names=tuple(column.name for column in problem.columns),
        units=tuple(column.unit for column in problem.columns),
        roles=tuple("estimated" if free else "fixed" for free in now.free),
        beta=now.theta,
        covariance=np.nan_to_num(spread.covariance),
        parameter_names=problem.robot.parameter_names,
        parameters=x[0],
        relative_error=shares,
        overall_relative_error=float(np.sqrt(np.nansum(after**2) / max(np.nansum(before**2), 1e-300))),
        error_norm=norm,
        error_std=norm / math.sqrt(max(1, now.rows - len(use))),
        condition_number=condition,
        n_rows=now.rows,
        uncertainty=Uncertainty(
            kind="jackknife",
            degrees_of_freedom=float(spread.blocks - 1),
            std_white=spread.white,
            joint_std=np.nan_to_num(after),
        )
        if spread.blocks and np.nan_to_num(spread.std).any()
        else None,
        n_simulations=problem.n_simulations,
        history=tuple(now.history),
        remarks=(*weak, *siblings),
        evidence=(
            *_evidence(now, rows, shares),
            *findings_of(experiment, problem.stops),
            *_size(experiment, after),
            *exactness,
            *changes(now, spread.drift),
        ),
        settings={
            **experiment_record(experiment, problem.robot),
            "prediction": {"motion": "simulated", "raw": True},
            KEY: {
                "drive": {kind: plain(value[0]) for kind, value in drive.items()},
                **_record(now, spread, before, after),
                "rows": rows,
                "weak": weak,
                "siblings": siblings,
            },
        },
        digests=digests(experiment),
    )


def _record(now: Search, spread: Intervals, before: Array, after: Array) -> dict[str, Any]:
    """Return errors and settings of a fit for the record of its result, with the errors of the joints at its two ends."""
    problem = now.problem
    outside = problem.joint_errors(problem.errors(now.theta, problem.held_out), problem.held_out)
    return {
        "errors": {
            "before": plain(before),
            "after": plain(after),
            "held_out": None if np.isnan(outside).all() else plain(outside),
        },
        "limbs": _limbs(problem),
        "smoothing": list(problem.robot.friction.smoothing),
        "soft": problem.soft,
        "sticks": problem.sticks,
        "pushed": [[stop.joint, stop.recording, stop.begin, stop.end] for stop in problem.pushed],
        "blocks": spread.blocks,
        "kind": spread.kind,
    }


def _limbs(problem: Problem) -> list[dict[str, Any]]:
    limbs = []
    for limb in problem.limbs:
        names = limb.robot.joint_names or tuple(f"joint {joint + 1}" for joint in limb.joints)
        limbs.append(
            {
                "name": limb.name or problem.robot.name,
                "joints": [joint + 1 for joint in limb.joints],
                "roles": [name.removeprefix(limb.name).strip("_-. ") or name for name in names],
            }
        )
    return limbs


def _rows(now: Search, spread: Intervals) -> list[dict[str, Any]]:
    bound, steps = at_bound(now), per_step(now)
    rows = []
    for k, column in enumerate(now.problem.columns):
        value, half = float(now.theta[k]), float(spread.half[k])
        by = "prior" if math.isfinite(column.sigma) else "log"
        by = "held" if k in now.held else "bound" if bound[k] else by
        known = k not in now.held and math.isfinite(half)
        rows.append(
            {
                "name": column.name,
                "kind": column.kind,
                "joints": [joint + 1 for joint in column.joints],
                "recording": column.recording,
                "unit": column.unit,
                "value": value,
                "std": float(spread.std[k]) if known else None,
                "low": max(value - half, column.low) if known else None,
                "high": min(value + half, column.high) if known else None,
                "before": column.start,
                "bounds": plain((column.low, column.high)),
                "runs": float(spread.runs[k]),
                "by": by,
                "text": held_at(now, k) if k in now.held else "",
                "per_step": float(steps[k]),
            }
        )
    return rows


def _unlike(problem: Problem, rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return sentences on joints that differ from those of the same place in other limbs."""
    single = {
        (row["joints"][0], row["kind"]): row for row in rows if len(row["joints"]) == 1 and row["by"] == "log"
    }
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for limb in _limbs(problem):
        groups.setdefault(tuple(limb["roles"]), []).append(limb)
    sentences = []
    for limbs in groups.values():
        for index, kind in ((p, k) for p in range(len(limbs[0]["joints"])) for k in ("Ia", "Fv", "Fc")):
            alike = [
                single[limb["joints"][index], kind]
                for limb in limbs
                if (limb["joints"][index], kind) in single
            ]
            for row in alike if len(alike) > 2 else ():
                others = np.array([other["value"] for other in alike if other is not row])
                usual = float(np.median(others))
                if abs(row["value"] - usual) > max(UNLIKE * (row["std"] or 0.0), UNLIKE_SHARE * abs(usual)):
                    name = problem.robot.joint_label(row["joints"][0] - 1)
                    sentences.append(
                        f"{name}: {kind} is {row['value']:.3g} {row['unit']}, where its siblings have {usual:.3g}"
                    )
    return sentences


def _size(experiment: Experiment, after: Array) -> list[Finding]:
    """Return a finding where the errors of the positions, (n_dof,), are a large share of what the servo stiffness acts on.

    That is the difference of command and position: times kp both are torques, so that their ratio is the torque that is missed.
    """
    tracked = [
        (recording.q_ref - recording.measured_positions())[slice(*window)]
        for recording in experiment.recordings
        if recording.role == "fit" and recording.q_ref is not None
        for window in recording.windows
    ]
    if not tracked:
        return []
    tracking = rms(np.concatenate(tracked))
    share = float(np.linalg.norm(after) / max(float(np.linalg.norm(tracking)), np.finfo(float).tiny))
    if not share > SIZE_DOUBTFUL:
        return []
    grade: Grade = "wrong" if share > SIZE_WRONG else "doubtful"
    return [size_finding(grade, share, after / np.maximum(tracking, np.finfo(float).tiny), positions=True)]


def _evidence(now: Search, rows: Sequence[dict[str, Any]], shares: Array) -> list[Finding]:
    """Return findings on parameters that the log does not identify, at bounds or to no better than their size, and on errors."""
    problem, findings = now.problem, []
    for sentence, columns in by_sentence(now).items():
        late = columns[0].kind in ("delay_s", "lag_s")
        findings.append(
            worded(
                kind="untold",
                sentence=sentence,
                advice="Command steps or a chirp (didim excite --positions)" if late else "",
                grade="doubtful" if columns[0].kind in GRAVE else "note",
                joints=tuple(joint + 1 for column in columns for joint in column.joints),
                parameters=tuple(column.name for column in columns),
            )
        )
    findings.append(worded(kind="untold", sentence=SCALE, advice="", grade="note"))
    planned = [row for row in rows if row["kind"] == ACCELERATION and row["by"] == "log"]
    if planned := [row for row in planned if row["std"] is not None and row["std"] <= 0.5 * row["value"]]:
        least, most = (end(float(row["value"]) for row in planned) for end in (min, max))
        text = f"{most:.3g}" if least == most else f"{least:.3g} to {most:.3g}"
        findings.append(
            worded(
                kind="set-points",
                sentence=f"set-points seem to accelerate by at most {text} rad/s^2, and lag behind faster commands",
                advice="Compare it with the register of the servos",
                grade="note",
                parameters=tuple(row["name"] for row in planned),
            )
        )
    stuck = [row for row in rows if row["by"] == "bound" and row["kind"] not in ("delay_s", "lag_s", *SOFT)]
    if stuck:
        names = series(row["name"] for row in stuck)
        findings.append(
            worded(
                kind="at-bound",
                sentence=f"at the bounds of what is possible: {names}",
                advice="Something else moves the robot like them, or the bounds are too narrow",
                parameters=tuple(row["name"] for row in stuck),
            )
        )
    loose = [
        row["name"]
        for row in rows
        if row["by"] == "log"
        and (row["std"] is None or row["std"] > 0.5 * abs(row["value"]))
        and row["kind"] not in ("Off", "delay_s", "lag_s", "bias_rad")
    ]
    if loose:
        sentence = f"known to no better than their own size: {series(loose)}"
        findings.append(
            worded(kind="loose", sentence=sentence, advice="", grade="note", parameters=tuple(loose))
        )
    poor = [k for k, share in enumerate(shares) if share > 1.0 + 1e-6]
    if poor and now.status is Status.CONVERGED:
        names = series(problem.robot.joint_label(k) for k in poor)
        sentence = f"the estimate leaves larger errors than the values of the file at {names}"
        joints = tuple(k + 1 for k in poor)
        findings.append(worded(kind="no-better", sentence=sentence, advice="", joints=joints))
    return findings
