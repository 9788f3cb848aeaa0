"""The controller as the log shows it, beside the declared one. Tested in ``tests/test_verdict_faults.py``.

The measured torque is compared with the torque of the declared law (`loop_rows`). If they differ, other laws are tried: other
gains, a delay, a reference that was logged late, a limit, a torque that is fed forward. The best one is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ..._tools.arrays import Array
from ...errors import DidimError
from ...experiment.experiment import Experiment
from ...experiment.specs import ControllerSpec, ReferenceSpec
from ...model.dynamics import inverse_dynamics
from ...result.finding import Finding
from ...terms.rows import unit_columns
from .law_rows import LawRows

AGREES = 0.03
"""Largest error of the declared law, as a share of the joint's torque beside its white noise: that of filters."""
EXPLAINS = 0.5
"""Ratio of squared errors below which another law is named."""
ASTRAY = 0.3
"""Error of the declared law, as a share of the torque, from which the result is wrong if no other law explains it."""
GAIN = 0.03
"""Smallest relative difference of a gain from the declared one that is reported."""
ANSWER = (0.01, 100.0)
"""Range of gains over the declared ones that are an answer, other units included; a controller does not have others."""
GAIN_SIGMAS = 5.0
"""Smallest difference of a gain, in its standard deviations, that is reported."""
LAGS = (-3.0, -1.5, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0)
"""Delays that are tried (samples)."""
LIMITS = (0.75, 0.85, 0.9, 0.94, 0.97, 1.0)
"""Torque limits that are tried, as shares of the largest measured torque, which noise raises above the limit."""
BLOCKS = 10
"""Number of blocks of rows that are left out in turn where signals of the loop explain the error of the law."""
LATE = (-3.0, 3.0, 8.0)
"""Delays of the law's terms among these signals (samples)."""
LEAST_SINGULAR = 1e-3
"""Singular value of these signals, as a share of the largest, below which a direction is noise of the others, and is left out."""
NEAR_LIMIT = 0.85
"""Share of the largest torque above which its excess is one of them."""


@dataclass(frozen=True, eq=False)
class Law:
    """Another law, by the code of its finding, and its error on the rows, (n_rows, n_dof)."""

    code: str
    error: Array
    joints: tuple[int, ...] = ()
    value: float | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Recovered:
    """A controller as the log shows it.

    Attributes
    ----------
    names : tuple of str
        Terms of the law.
    factors, sigmas : (n_terms, n_dof) arrays
        Gains over the declared ones, and their standard deviations.
    relative : (n_dof,) array
        Error of the declared law over the torque.
    rows : LawRows
        What they were found on.
    """

    names: tuple[str, ...]
    factors: Array
    sigmas: Array
    relative: Array
    rows: LawRows

    def keys(self) -> tuple[tuple[str, ...], Array, Array]:
        """Return the keys of ``[controller]`` with their factors and standard deviations, as `factors` and `sigmas`.

        The terms of a cascade are kp kv, kv and kv/Ti; its keys are kp, kv and integral_time_s.
        """
        if self.rows.controller.kind != "cascade" or not {"kp", "kv"}.issubset(self.names):
            return self.names, self.factors, self.sigmas
        factors, sigmas = self.factors.copy(), self.sigmas.copy()
        at = {name: k for k, name in enumerate(self.names)}
        names = list(self.names)
        size = np.where(self.factors == 0.0, np.finfo(float).tiny, np.abs(self.factors))
        share = self.sigmas / size
        for name, key in (("kp", "kp"), ("ki", "integral_time_s")):
            if name not in at:
                continue
            k, v = at[name], at["kv"]
            top, bottom = (k, v) if name == "kp" else (v, k)
            factors[k] = self.factors[top] / np.copysign(size[bottom], self.factors[bottom])
            sigmas[k] = np.abs(factors[k]) * np.hypot(share[k], share[v])
            names[k] = key
        return tuple(names), factors, sigmas


def declared_loop(experiment: Experiment) -> bool:
    """Whether an experiment declares a real controller that follows a real reference."""
    reference, controller = experiment.reference, experiment.controller
    if reference is None or controller is None:
        return False
    if isinstance(reference, ReferenceSpec) and reference.kind == "measured":
        return False
    return not made_up(experiment)


def made_up(experiment: Experiment) -> bool:
    """Whether the gains of an experiment's controller are made up (``kind = "made-up"``)."""
    controller = experiment.controller
    return isinstance(controller, ControllerSpec) and controller.settings.get("kind") == "made-up"


def recovered(experiment: Experiment) -> Recovered | None:
    """Return the controller that the log shows; None where there is none to compare with."""
    if not declared_loop(experiment):
        return None
    try:
        rows = LawRows(experiment)
    except (DidimError, IndexError):
        return None
    columns = rows.columns()
    n_terms, n_rows, n = columns.shape
    forward = rows.reduced(rows.forward)
    factors, sigmas = np.ones((n_terms, n)), np.full((n_terms, n), np.inf)
    for joint in range(n):
        a = columns[:, :, joint].T - columns[:, :, joint].mean(axis=1)
        y = rows.measured[:, joint] - forward[:, joint]
        size = np.linalg.norm(a, axis=0)
        used = size > 0.0
        if n_rows <= n_terms + 1 or not used.any():
            continue
        q, r = np.linalg.qr(a[:, used] / size[used])
        inverse = np.linalg.pinv(r)
        law = inverse @ (q.T @ (y - y.mean()))
        rest = y - y.mean() - a[:, used] @ (law / size[used])
        sigma = np.sqrt(rest @ rest / (n_rows - n_terms - 1)) * np.linalg.norm(inverse, axis=1)
        factors[used, joint], sigmas[used, joint] = law / size[used], sigma / size[used]
    error = rows.error(rows.law())
    torque = np.linalg.norm(rows.measured - rows.measured.mean(axis=0), axis=0)
    relative = np.linalg.norm(error, axis=0) / np.maximum(torque, np.finfo(float).tiny)
    return Recovered(rows.names, factors, sigmas, relative, rows)


def loop_findings(
    experiment: Experiment, x: Array | None = None, law_found: Recovered | None = None
) -> list[Finding]:
    """Return a finding where the log contradicts the declared controller or reference.

    Parameters
    ----------
    experiment : Experiment
        With a reference and a controller.
    x : (n_parameters,) array, optional
        Standard parameters, for a torque that is fed forward along the reference.
    law_found : Recovered, optional
        The controller that the log shows, where it is known already.
    """
    law_found = recovered(experiment) if law_found is None else law_found
    if law_found is None:
        return []
    rows = law_found.rows
    declared = rows.error(rows.law())
    beyond_noise = np.sqrt(np.maximum(law_found.relative**2 - rows.noise**2, 0.0))
    off = [int(joint) for joint in np.flatnonzero(beyond_noise > AGREES)]
    if not off:
        return []
    weights = 1.0 / np.maximum(np.sum(declared**2, axis=0), np.finfo(float).tiny)
    scored = [
        (float(np.sum(weights[off] * np.sum(law.error[:, off] ** 2, axis=0))) / len(off), law)
        for law in _laws(law_found, experiment, off, x)
    ]
    worst = float(law_found.relative.max())
    left = {"worst": worst, "joint": int(np.argmax(law_found.relative)) + 1}
    score, law = min(scored, key=lambda trial: trial[0])
    if score < EXPLAINS:
        return [
            Finding(
                code=law.code,
                grade="wrong",
                joints=law.joints,
                value=law.value,
                effect=worst,
                facts={**left, "left": score**0.5, **law.facts},
            )
        ]
    # So far astray the torques are not those of the law, whatever they follow.
    follows = dict(zip(off, _followed(rows, experiment, x, off), strict=True))
    off = [
        joint
        for joint in off
        if (error := law_found.relative[joint]) > ASTRAY or error * np.sqrt(follows[joint]) > AGREES
    ]
    if not off:
        return []
    joint = max(off, key=lambda each: float(law_found.relative[each]))
    worst = float(law_found.relative[joint])
    left = {"worst": worst, "joint": joint + 1}
    return [
        Finding(
            code="controller",
            grade="wrong" if worst > ASTRAY else "doubtful",
            joints=tuple(joint + 1 for joint in off),
            value=worst,
            effect=worst,
            facts=left,
        )
    ]


def _followed(rows: LawRows, experiment: Experiment, x: Array | None, joints: Sequence[int]) -> Array:
    """Return the share of the squared error of joints, from 0, that signals of the loop explain on blocks left out, (n_joints,).

    Another controller makes its torque of such signals: the terms of the law, also late; the reference's speed, acceleration,
    direction and gravity's sine and cosine; the torque's square and what of it nears a limit; the model's torque along the
    reference. Noise of the torques that is short against a block follows none of them beyond the rows on which it was fitted.
    """
    reference = [stretch.loop.reference.at(stretch.t) for stretch in rows.stretches]
    torque = rows.law()
    largest = np.maximum(np.abs(torque).max(axis=0), np.finfo(float).tiny)
    signals = [
        *(column for lag in (0.0, *LATE) for column in rows.columns(lag / rows.rate_hz)),
        *(rows.reduced(each) for each in zip(*map(_of_motion, reference), strict=True)),
        torque * np.abs(torque) / largest,
        np.sign(torque) * np.maximum(np.abs(torque) - NEAR_LIMIT * largest, 0.0),
    ]
    if x is not None:
        signals.append(_along_reference(rows, experiment, x))
    every, error = np.stack(signals), rows.error(torque)
    edges = np.linspace(0, len(error), BLOCKS + 1).astype(int)
    shares = np.zeros(len(joints))
    for number, joint in enumerate(joints):
        # A block has a mean of its own, so the mean is one of the columns.
        own, columns = error[:, joint], np.column_stack([every[:, :, joint].T, np.ones(len(error))])
        left, sizes, _ = np.linalg.svd(unit_columns(columns)[0], full_matrices=False)
        basis = left[:, sizes > LEAST_SINGULAR * sizes[0]]
        rest = 0.0
        for start, stop in pairwise(edges):
            out = basis[start:stop]
            # Q^T Q = 1 less the block, kept regular where the block alone shows a signal.
            normal = (1.0 + LEAST_SINGULAR) * np.eye(basis.shape[1]) - out.T @ out
            fitted = np.linalg.solve(normal, basis.T @ own - out.T @ own[start:stop])
            rest += float(np.sum((own[start:stop] - out @ fitted) ** 2))
        shares[number] = max(0.0, 1.0 - rest / max(float(own @ own), np.finfo(float).tiny))
    return shares


def _along_reference(rows: LawRows, experiment: Experiment, x: Array) -> Array:
    """Return the model's torque along the reference on the rows, (n_rows, n_dof), with standard parameters."""
    robot = experiment.robot
    return rows.reduced(
        [inverse_dynamics(robot, *each.loop.reference.at(each.t), x) for each in rows.stretches]
    )


def _of_motion(motion: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    """Return what a controller may make of a reference ``q dq ddq``, (n, n_dof) each."""
    q, dq, ddq = motion
    return dq, ddq, np.sign(dq), np.sin(q), np.cos(q)


def _laws(recovery: Recovered, experiment: Experiment, off: list[int], x: Array | None) -> Iterator[Law]:
    rows = recovery.rows
    first = recovery.factors[0, off]
    if ((first > ANSWER[0]) & (first < ANSWER[1])).all():
        yield _gains(recovery, off)
    samples = [lag / rows.rate_hz for lag in LAGS]
    tried = [
        _best(rows, samples, lambda value: rows.law(rows.terms(lag_s=value))),
        # A digital controller has its velocity from differences, half a sample late.
        _best(rows, [0.0, *samples], lambda value: rows.law(rows.terms(lag_s=value, differences=True))),
    ]
    lag, error = min(tried, key=lambda each: float(np.sum((each[1] / rows.size) ** 2)))
    yield Law("controller-delay", error, value=lag)
    leads = sorted({*samples, *(value / 1e3 for value in (5.0, 10.0, 20.0, 40.0))})
    lead, error = _best(rows, leads, lambda value: rows.law(rows.terms(lead_s=value)))
    yield Law("reference-late", error, value=lead)
    yield _limits(rows)
    if x is not None:
        share, error = _fed(rows, _along_reference(rows, experiment, x))
        yield Law("feed-forward", error, value=share)


def _gains(recovery: Recovered, off: list[int]) -> Law:
    rows = recovery.rows
    torque = np.einsum("kj,krj->rj", recovery.factors, rows.columns()) + rows.reduced(rows.forward)
    parts: list[dict[str, Any]] = []
    joints: set[int] = set()
    names, factors, sigmas = recovery.keys()
    for k, name in enumerate(names):
        changed = [
            joint for joint in off if abs(factors[k, joint] - 1.0) > max(GAIN, GAIN_SIGMAS * sigmas[k, joint])
        ]
        if changed:
            joints |= set(changed)
            values = factors[k, changed].tolist()
            parts.append({"name": name, "joints": [joint + 1 for joint in changed], "values": values})
    return Law(
        "controller-gain",
        rows.error(torque),
        joints=tuple(sorted(joint + 1 for joint in joints)),
        value=float(recovery.factors[0, off].mean()),
        facts={"gains": parts},
    )


def _best(rows: LawRows, values: Sequence[float], law: Callable[[float], Array]) -> tuple[float, Array]:
    """Return the best of some values, refined between its neighbours, and the error there."""
    from scipy.optimize import minimize_scalar

    def cost(value: float) -> float:
        return float(np.sum((rows.error(law(value)) / rows.size) ** 2))

    values = sorted(set(values))
    costs = [cost(value) for value in values]
    k = int(np.argmin(costs))
    low, high = values[max(k - 1, 0)], values[min(k + 1, len(values) - 1)]
    optimum = minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"xatol": 2e-5, "maxiter": 12}
    )
    return float(optimum.x), rows.error(law(float(optimum.x)))


def _limits(rows: LawRows) -> Law:
    """Return the law with the limit of each joint that explains its torque best."""
    top = np.max([np.abs(stretch.tau).max(axis=0) for stretch in rows.stretches], axis=0)
    errors, limits = [rows.error(rows.law())], [np.full(len(top), np.inf)]
    for share in LIMITS:
        errors.append(rows.error(rows.law(limit=share * top)))
        limits.append(share * top)
    squares = np.array([np.sum(error**2, axis=0) for error in errors])
    best = np.argmin(squares, axis=0)
    chosen = np.array([limits[int(k)][j] for j, k in enumerate(best)])
    # Between two limits of the grid the squared errors are alike: refined once, joint by joint at the same time.
    for factor in (0.97, 0.985, 1.015, 1.03):
        error = rows.error(rows.law(limit=factor * chosen))
        better = np.sum(error**2, axis=0) < squares.min(axis=0)
        chosen = np.where(better, factor * chosen, chosen)
        squares = np.vstack([squares, np.sum(error**2, axis=0)])
    error = rows.error(rows.law(limit=chosen))
    joints = [int(joint) for joint in np.flatnonzero(np.isfinite(chosen))]
    gains = [float(chosen[joint]) for joint in joints]
    return Law("saturation", error, joints=tuple(joint + 1 for joint in joints), facts={"limits": gains})


def _fed(rows: LawRows, forward: Array) -> tuple[float, Array]:
    """Return the share of a torque that is fed forward, and the error with it."""
    error = rows.error(rows.law())
    inner = forward - forward.mean(axis=0)
    size = np.maximum(np.sum(inner**2, axis=0), np.finfo(float).tiny)
    shares = np.sum(inner * error, axis=0) / size
    share = float(np.median(shares))
    return share, rows.error(rows.law() + share * forward)
