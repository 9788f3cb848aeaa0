"""Contrasts between logs with common parameters: estimates of separate offsets and friction per log.

The columns C of own offsets (friction) of every log except the first are added together to the weighted system A after the fit:

    d = (C~^T C~)^-1 C~^T rho,    C~ = C - Q Q^T C,    A = Q R
    V = (C~^T C~)^-1 m/(m - 1) sum_i s_i s_i^T (C~^T C~)^-1,    s_i = C~_i^T (rho - C~ d)_i

over the m time intervals of the jackknife, which accounts for correlated model errors.
Tested in ``tests/test_logs.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import joints_text
from ..fit import Fit
from ..jackknife import Factors, intervals
from ..linear_system import LinearSystem

Kind = Literal["offset", "friction"]

FALSE_DRIFTS = 1e-3
"""Probability of a false alarm on logs without drift, over all columns."""
NEGLIGIBLE_DRIFT = 0.05
"""Difference, as a share of a joint's residual, below which a recording needs no parameters of its own."""
FEWEST = 3
"""Smallest number of intervals of a log for the test."""
DEPENDENT_EIGENVALUE = 1e-9
"""Eigenvalue of ``C~^T C~``, as a share of the largest, below which a combination of the columns equals one of the shared
parameters."""


@dataclass(frozen=True)
class Difference:
    """Difference of a parameter between one log and the first.

    Attributes
    ----------
    kind : {"offset", "friction"}
        Kind of the parameter.
    parameter : str
        Name, such as ``Off3``.
    joint, recording : int
        Joint and recording, from 0.
    value, std : float
        Difference and its standard deviation (SI units).
    torque : float
        Root mean square of the corresponding torque, on the rows of the joint in this log (N.m or N).
    clear : bool
        Whether it is significant and large enough for a parameter.
    """

    kind: Kind
    parameter: str
    joint: int
    recording: int
    value: float
    std: float
    torque: float
    clear: bool


def differences(system: LinearSystem, fit: Fit, kind: Kind, blocks: int = 20) -> list[Difference]:
    """Return the differences of offsets or friction from the first log, for every other log.

    Parameters
    ----------
    system : LinearSystem
        System of several recordings.
    fit : Fit
        Its solution.
    kind : {"offset", "friction"}
        Kind of the added columns.
    blocks : int
        Number of time intervals per log.
    """
    numbers = sorted({block.recording for block in system.blocks})
    if len(numbers) < 2 or system.w.shape[0] < system.w.shape[1]:
        return []
    times = intervals(system.blocks, blocks * len(numbers))
    parts = [part.rows for part in times]
    counts = {number: sum(part.recording == number for part in times) for number in numbers}
    if min(counts.values()) < FEWEST:
        return []
    columns, places = _columns(system, numbers[1:], kind)
    if not places:
        return []
    factors = Factors.of(system.w * fit.weights[:, None], fit.residual * fit.weights)
    weighted = columns * fit.weights[:, None]
    projected = weighted - factors.left @ (factors.left.T @ weighted)
    gram = projected.T @ projected
    inverse = np.linalg.pinv(gram, rcond=DEPENDENT_EIGENVALUE, hermitian=True)
    estimates = inverse @ (projected.T @ factors.residual)
    residual = factors.residual - projected @ estimates
    scores = np.array([projected[rows].T @ residual[rows] for rows in parts])
    m = len(parts)
    covariance = m / (m - 1) * inverse @ (scores.T @ scores) @ inverse
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    from scipy.special import stdtrit  # not scipy.stats, which takes half a second to load

    tail = 1.0 - 0.5 * FALSE_DRIFTS / len(places)
    # A difference only has the blocks of its two logs.
    limits = [float(stdtrit(counts[number] + counts[numbers[0]] - 2, tail)) for _, _, number in places]
    sizes = system.norms(fit.residual) / np.sqrt([rows.stop - rows.start for rows in system.joints])
    compared = []
    for index, (name, joint, number) in enumerate(places):
        rows = np.flatnonzero(columns[:, index])
        value = float(estimates[index])
        torque = abs(value) * float(np.sqrt(np.mean(columns[rows, index] ** 2)))
        clear = bool(
            abs(value) > limits[index] * std[index] > 0.0 and torque > NEGLIGIBLE_DRIFT * sizes[joint]
        )
        compared.append(Difference(kind, name, joint, number, value, float(std[index]), torque, clear))
    return compared


def _columns(
    system: LinearSystem, numbers: Sequence[int], kind: Kind
) -> tuple[Array, list[tuple[str, int, int]]]:
    """Return the columns of own parameters of some recordings, and the name, joint and recording of each."""
    columns, places = [], []
    for number in numbers:
        for joint, blocks in enumerate(system.joint_blocks):
            own = [block.rows for block in blocks if block.recording == number]
            if kind == "offset":
                parts = {f"Off{joint + 1}": np.ones(system.y.size)}
            else:
                parts = {
                    name: system.w[:, index]
                    for index, name in enumerate(system.names)
                    if name.rstrip("+-") in (f"Fv{joint + 1}", f"Fc{joint + 1}")
                }
            for name, values in parts.items():
                column = np.zeros(system.y.size)
                for rows in own:
                    column[rows] = values[rows]
                if column.any():
                    columns.append(column)
                    places.append((name, joint, number))
    return (np.stack(columns, axis=1) if columns else np.zeros((system.y.size, 0))), places


@dataclass(frozen=True)
class Drift:
    """Parameters of one kind that differ significantly between logs.

    Attributes
    ----------
    sentence, advice : str
        Observation and advice.
    joints : tuple of int
        Joints concerned, from 1.
    recordings : tuple of str
        Names of the recordings that differ from the first.
    value : float
        Largest difference, by the corresponding torque (SI units).
    """

    sentence: str
    advice: str
    joints: tuple[int, ...]
    recordings: tuple[str, ...]
    value: float


def drifts(compared: Sequence[Difference], names: Sequence[str]) -> list[Drift]:
    """Return the kinds of parameters that differ between logs.

    Parameters
    ----------
    compared : sequence of Difference
        From `differences`.
    names : sequence of str
        Names of the recordings of the experiment.
    """
    significant = []
    for kind, key in (("offset", "offsets"), ("friction", "friction")):
        clear = [item for item in compared if item.kind == kind and item.clear]
        if not clear:
            continue
        worst = max(clear, key=lambda item: item.torque)
        joints = sorted({item.joint for item in clear})
        what = "the offsets" if kind == "offset" else "the friction coefficients"
        significant.append(
            Drift(
                f"{what} of {joints_text(joints)} differ between recordings, most by {worst.value:.3g} +- "
                f"{worst.std:.2g} in {worst.parameter} of '{names[worst.recording]}'",
                f'Give the recordings {key} = "own"',
                tuple(joint + 1 for joint in joints),
                tuple(names[number] for number in sorted({item.recording for item in clear})),
                worst.value,
            )
        )
    return significant
