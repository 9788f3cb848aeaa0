"""What a result leaves of the torques along the measured motion, sample by sample and on the rows: the same for every method.

    r = tau - ID(q, dq, ddq; x),    lasting^2 = mean(r_rows^2) - (noise of the log on the rows)^2

so that white noise of the sensor, however large, speaks against nothing, and an error that lasts does.
Tested in ``tests/test_evidence_result.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array, quotient, rms
from ..model.dynamics import inverse_dynamics
from ..result.finding import Finding, Grade, Remedy
from ..result.identification import Identification
from ..robot.robot import Robot
from ..signal.filters import row_values
from ..signal.noise import noise_correlation, row_noise
from ..signal.processing import SignalProcessing
from ..signal.spikes import alone, without_lone
from ..signal.window import Window
from ..terms.model import Model
from ..terms.rows import Block, LinearSystem, stacked
from .thresholds import (
    FEWEST_SPIKES,
    NEGLIGIBLE,
    SIZE_DOUBTFUL,
    SIZE_JOINT,
    SIZE_WRONG,
    SPIKES_SHARE,
    USELESS,
)

LARGER = 1.5
"""Ratio of the error on a held-out recording to that of the fit from which it is reported: correct logs have 0.9 to 1.1."""


@dataclass(frozen=True, eq=False)
class Residual:
    """Errors of the torques along the measured motion.

    Attributes
    ----------
    error, torque : (n, n_rows) arrays
        Measured less modelled torques on the rows, and the measured ones.
    noise : (n,) array
        Standard deviation of the white noise of the log on the rows.
    blocks : tuple of Block
        Rows of each joint in each window.
    """

    error: Array
    torque: Array
    noise: Array
    blocks: tuple[Block, ...]

    def lasting(self, growth: float = 1.0) -> Array:
        """Root mean square of the error, times a factor, beside white noise, (n,)."""
        squares = growth**2 * np.mean(self.error**2, axis=1)
        return np.asarray(np.sqrt(np.maximum(squares - self.noise**2, 0.0)))

    @property
    def size(self) -> Array:
        """Root mean square of the torques, (n,)."""
        return rms(self.torque.T)

    def share(self, growth: float = 1.0) -> float:
        """Lasting error of all joints together over their torques."""
        size = float(np.linalg.norm(self.size))
        return float(np.linalg.norm(self.lasting(growth))) / size if size > 0.0 else 0.0


def residual_of(
    robot: Robot,
    logs: Model,
    beta: Array,
    parts: Sequence[Window],
    signal: SignalProcessing,
    system: LinearSystem | None = None,
) -> Residual:
    """Return the errors of base parameters, (b + e,), along filtered windows of a log.

    `system` are the rows (7) of the windows with all base columns, if there are any.

    Raises
    ------
    DidimError
        For windows that the decimation leaves nothing of.
    """
    whites = [part.noise * row_noise(signal, part.rate_hz)[0] for part in parts]
    if system is not None:
        error, torque = (values.reshape(robot.n_dof, -1) for values in (system.residual(beta), system.y))
        return Residual(error, torque, np.median(whites, axis=0), system.blocks)
    errors, torques = [], []
    for part in parts:
        x = logs.standard(logs.lift(beta), part.recording)
        error = part.tau - inverse_dynamics(robot, part.q, part.dq, part.ddq, x, temperature=part.temperature)
        errors.append(row_values(error, signal).T)
        torques.append(row_values(part.tau, signal).T)
    blocks = stacked(
        robot.n_dof,
        [errors_of_joint.shape[1] for errors_of_joint in errors],
        places=[(part.recording, part.number) for part in parts],
        correlation=noise_correlation(signal),
    )
    return Residual(
        np.ascontiguousarray(np.concatenate(errors, axis=1)),
        np.concatenate(torques, axis=1),
        np.median(whites, axis=0),
        blocks,
    )


def size_findings(residual: Residual, growth: float = 1.0, *, chosen: bool = False) -> list[Finding]:
    """Return a finding where the model misses more of the torques than a sound result does.

    `growth` is the error of blocks left out over that of the same blocks fitted: torques that nothing was fitted to count.
    `chosen` is whether friction terms were chosen already, so choosing them is not advised again.
    """
    share, size = residual.share(growth), max(float(np.linalg.norm(residual.size)), np.finfo(float).tiny)
    error = float(np.linalg.norm(residual.error) / np.sqrt(residual.error.shape[1]) / size)
    # Torques predicted no better than by zero do not belong to this robot, whether they are noise or not.
    useless = error > SIZE_WRONG and growth * error > USELESS
    if useless:
        share = growth * error
    if not share > SIZE_DOUBTFUL:
        return []
    grade: Grade = "wrong" if useless or residual.share() > SIZE_WRONG else "doubtful"
    return [size_finding(grade, share, quotient(residual.lasting(growth), residual.size), chosen=chosen)]


def size_finding(grade: Grade, share: float, shares: Array, **facts: bool) -> Finding:
    """Return the finding that a share is missed, most in the joints whose own shares, (n_dof,), are larger."""
    joints = np.flatnonzero(shares > max(SIZE_JOINT, share))
    return Finding(
        code="size",
        grade=grade,
        joints=tuple(int(joint) + 1 for joint in joints),
        value=share,
        effect=share,
        facts={"limit": SIZE_DOUBTFUL, "shares": shares[joints].tolist(), **facts},
    )


def spike_findings(
    parts: Sequence[Window], signal: SignalProcessing, fewest: int | None = None
) -> list[Finding]:
    """Return a finding where single samples of the torques stand alone, by their effect or so many; none once they are replaced."""
    if signal.spikes is not None:
        return []
    masks = [alone(part.tau) for part in parts]
    if not any(mask.any() for mask in masks):
        return []
    counts = np.sum([mask.sum(axis=0) for mask in masks], axis=0)
    n_samples = sum(len(mask) for mask in masks)
    off = np.sum(
        [
            np.sum((part.tau - without_lone(part.tau)) ** 2, axis=0)
            for part, mask in zip(parts, masks, strict=True)
            if mask.any()
        ]
        or [np.zeros(len(counts))],
        axis=0,
    )
    spread = np.std(np.concatenate([part.tau.T for part in parts], axis=1), axis=1)
    share = np.sqrt(off / n_samples) / np.maximum(spread, np.finfo(float).tiny)
    # One sample of forty at most is found alone: more are the noise of that torque.
    spiky = (share >= SPIKES_SHARE) & (counts >= FEWEST_SPIKES * n_samples)
    joints = np.flatnonzero(spiky if fewest is None else counts >= fewest)
    if not len(joints):
        return []
    count = int(counts[joints].sum())
    return [
        Finding(
            code="spikes",
            grade="doubtful",
            joints=tuple(int(joint) + 1 for joint in joints),
            value=count / (n_samples * len(joints)),
            remedy=Remedy(file="experiment", table="[signal]", key="spikes", action="set", value="hampel"),
            facts={"count": count},
        )
    ]


def held_out_findings(fit: Identification) -> list[Finding]:
    """Return a finding for each held-out recording whose torques a result predicts worse than those it was fitted to.

    Errors are compared as torques, not as shares of them: a slow motion has the noise of a fast one and smaller torques.
    """
    if fit.uncertainty is None or fit.uncertainty.joint_std is None:
        return []
    own = np.asarray(fit.uncertainty.joint_std)
    findings = []
    for each in fit.held_out:
        error, share = np.array(each.error_rms), np.nan_to_num(each.relative_error)
        if error.shape != own.shape:
            continue
        ratio = error / np.maximum(own, np.finfo(float).tiny)
        joints = np.flatnonzero((ratio > LARGER) & (share > NEGLIGIBLE))
        if not len(joints):
            continue
        findings.append(
            Finding(
                code="held-out",
                grade="doubtful",
                joints=tuple(int(joint) + 1 for joint in joints),
                recordings=(each.name,),
                value=float(ratio[joints].max()),
                effect=float(share[joints].max()),
                facts={"share": float(share[joints].max()), "ratios": ratio[joints].tolist()},
            )
        )
    return findings
