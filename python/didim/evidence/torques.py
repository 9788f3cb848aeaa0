"""Torques that contradict each other, or the simulated robot, as evidence. Tested in ``tests/test_verdict.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from .._tools.arrays import Array
from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..regression.consistent.diagnosis import Contradiction
from ..result.finding import Finding

TORQUE_CODES = frozenset({"torque-sign", "swapped-torques", "constant-torque"})
"""Codes of findings that name a fault of the torques."""
CONTRADICTIONS = TORQUE_CODES | {"no-robot"}
"""Codes of findings that explain why no robot fits the torques."""
ASTRAY = 1.0
"""Output error (12) from which a simulated robot is further from the log than zero torque."""
LAGS = 3
"""Number of lags (samples) at which white noise has no correlation; a motion that is sampled too slowly has some at one of them."""
WHITE_SIGMAS = 4.0
"""Largest correlation of white noise, in its standard deviation ``1 / sqrt(n)``: TX40, EMPS, UR10e and UR10 have 0.97."""
MOVES = 0.05
"""Range of positions (rad or m) from which a joint moves."""
SAME = 1e-12
"""Largest range of a constant torque, as a share of its size: rounding of units and reductions."""


def is_constant(values: Array) -> bool:
    """Whether a torque has one value in all samples, (n_samples,)."""
    return bool(np.ptp(values) <= SAME * np.abs(values).max())


def constant_torque_findings(experiment: Experiment) -> list[Finding]:
    """Return a finding for each recording with torques that never change, or by noise alone though their joints move."""
    findings = []
    for recording in experiment.recordings:
        if recording.tau is None:
            continue
        tau, side = as_logged(recording, "torque", recording.tau)
        dead = [number + 1 for number, values in enumerate(tau.T) if is_constant(values)]
        if dead:
            findings.append(
                Finding(
                    code="constant-torque",
                    grade="wrong",
                    joints=tuple(dead) if side == "joint" else (),
                    recordings=(recording.name,),
                    facts={"side": side, "numbers": dead, "samples": len(tau), **_columns(recording, dead)},
                )
            )
        flat = [joint for joint in _flat(recording, recording.tau) if not dead]
        if flat:
            means = recording.tau.mean(axis=0)[flat].tolist()
            joints = tuple(joint + 1 for joint in flat)
            findings.append(
                Finding(
                    code="constant-torque",
                    grade="doubtful",
                    joints=joints,
                    recordings=(recording.name,),
                    facts={"means": means},
                )
            )
    return findings


def _flat(recording: Recording, tau: Array) -> list[int]:
    """Return the joints, from 0, that move while their torque is white noise about a constant; none without positions."""
    if not recording.has_positions:
        return []
    n_samples = sum(stop - start for start, stop in recording.windows if stop - start > LAGS)
    moves = np.ptp(np.ascontiguousarray(recording.measured_positions().T), axis=1) > MOVES
    flat = []
    for joint, values in enumerate(np.ascontiguousarray(tau.T)):
        values = values / (np.abs(values).max() or 1.0)  # torques of any size can be squared so
        windows = [values[slice(*window)] for window in recording.windows]
        errors = [part - part.mean() for part in windows if len(part) > LAGS]
        squares = sum(float(part @ part) for part in errors)
        limit = WHITE_SIGMAS * squares / np.sqrt(max(1, n_samples))
        if moves[joint] and squares > 0.0:
            products = (sum(float(part[lag:] @ part[:-lag]) for part in errors) for lag in range(1, LAGS + 1))
            if all(abs(product) < limit for product in products):
                flat.append(joint)
    return flat


def _columns(recording: Recording, numbers: Sequence[int]) -> dict[str, str]:
    """Return file and columns of torques, numbered from 1; empty for a recording of arrays."""
    origin = recording.origin.get("torque", {})
    file, columns = origin.get("file"), origin.get("columns")
    if not file:
        return {}
    names = [str(columns[number - 1]) if columns else str(number) for number in numbers]
    return {"file": str(file), "column": ", ".join(names)}


def as_logged(recording: Recording, what: Literal["position", "torque"], values: Array) -> tuple[Array, str]:
    """Return positions or torques, (n_samples, n_dof), on the side on which they were logged, and the name of that side."""
    reduction = recording.origin.get("reduction")
    if reduction is None or recording.origin.get(what, {}).get("side") != "motor":
        return values, "joint"
    matrix = np.array(reduction)
    return values @ (matrix.T if what == "position" else np.linalg.inv(matrix)), "motor"


def following_findings(output_error: float, *, updating: bool = True) -> list[Finding]:
    """Return a finding where the simulated robot does not follow, judged by the output error (12).

    `updating` is whether the gains of the first simulation are scaled: if not, that may help.
    """
    if not output_error >= ASTRAY:
        return []
    return [Finding(code="controller", grade="wrong", value=output_error, facts={"updating": updating})]


def contradiction_findings(contradictions: Sequence[Contradiction]) -> list[Finding]:
    """Return a finding for each contradiction between torques and physics (`didim.regression.consistent.diagnosis`)."""
    return [
        Finding(
            code="no-robot",
            grade="wrong" if contradiction.hopeless else "doubtful",
            effect=contradiction.constrained,
            facts={"plain": contradiction.plain, "constrained": contradiction.constrained},
        )
        for contradiction in contradictions
    ]
