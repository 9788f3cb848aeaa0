"""Contrasts between logs with common parameters: estimates of separate offsets and friction per log.

The columns C of own offsets (friction) of every log except the first are added together to the weighted system A after the fit:

    d = (C~^T C~)^-1 C~^T rho,    C~ = C - Q Q^T C,    A = Q R
    V = (C~^T C~)^-1 m/(m - 1) sum_i s_i s_i^T (C~^T C~)^-1,    s_i = C~_i^T (rho - C~ d)_i

over the m time intervals of the jackknife, which accounts for correlated model errors. With the friction torque f of a joint along
a log by the parameters of the first, and its change C_j d_j, its friction is higher by the share ``f^T C_j d_j / f^T f``.
Tested in ``tests/test_logs.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array
from ...robot.friction import NAMES
from ...robot.parameters import friction_names
from ...terms.rows import LinearSystem
from ..covariance import Factors, intervals
from ..fit import Fit

Kind = Literal["offset", "friction", "level"]

FALSE_DRIFTS = 1e-3
"""Probability of a false alarm on logs without drift, over all columns."""
NEGLIGIBLE_DRIFT = 0.05
"""Difference, as a share of a joint's residual, below which a recording needs no parameters of its own."""
FEWEST = 3
"""Smallest number of intervals of a log for the test."""
FRICTION = ("Fv", "Fc", *(NAMES[law] for law in ("atan", "stribeck", "root", "forward", "load", "dahl")))
"""Parameters of a joint's friction, without its number."""
DEPENDENT_EIGENVALUE = 1e-9
"""Eigenvalue of ``C~^T C~``, as a share of the largest, below which a combination of the columns equals one of the shared
parameters."""


@dataclass(frozen=True)
class Difference:
    """Difference of a parameter between one log and the first.

    Attributes
    ----------
    kind : {"offset", "friction", "level"}
        Kind of the parameter; "level" is all friction of a joint.
    parameter : str
        Name, such as ``Off3``; of a level ``friction3``.
    joint, recording : int
        Joint and recording, from 0.
    value, std : float
        Difference and its standard deviation (SI units; of a level as a share of the joint's friction along this log).
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


def differences(
    system: LinearSystem, fit: Fit, kind: Literal["offset", "friction"], blocks: int = 20
) -> list[Difference]:
    """Return the differences of offsets or friction from the first log, for every other log.

    Parameters
    ----------
    system : LinearSystem
        System of several recordings.
    fit : Fit
        Its solution.
    kind : {"offset", "friction"}
        Kind of the added columns. With "friction" the levels follow.
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
    torques = columns * estimates
    if kind == "friction":
        first = fit.solution - factors.inverse @ (factors.left.T @ (weighted @ estimates))
        keys = list(dict.fromkeys((joint, number) for _, joint, number in places))
        changed = np.array([[place[1:] == key for place in places] for key in keys])
        levels = _levels(system, first, columns, changed)
        estimates = np.concatenate([estimates, levels @ estimates])
        both = np.vstack([np.eye(len(places)), levels])
        covariance = both @ covariance @ both.T
        torques = np.hstack([torques, torques @ changed.T])
        places += [(f"friction{joint + 1}", joint, number) for joint, number in keys]
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    from scipy.special import stdtrit  # not scipy.stats, which takes half a second to load

    tail = 1.0 - 0.5 * FALSE_DRIFTS / len(places)
    # A difference only has the blocks of its two logs.
    limits = [float(stdtrit(counts[number] + counts[numbers[0]] - 2, tail)) for _, _, number in places]
    sizes = system.norms(fit.residual) / np.sqrt(system.counts)
    compared = []
    for index, (name, joint, number) in enumerate(places):
        own = torques[torques[:, index] != 0.0, index]
        torque = float(np.sqrt(np.mean(own**2))) if own.size else 0.0
        value = float(estimates[index])
        clear = bool(
            abs(value) > limits[index] * std[index] > 0.0 and torque > NEGLIGIBLE_DRIFT * sizes[joint]
        )
        of: Kind = "level" if index >= columns.shape[1] else kind
        compared.append(Difference(of, name, joint, number, value, float(std[index]), torque, clear))
    return compared


def _levels(system: LinearSystem, first: Array, columns: Array, changed: NDArray[np.bool_]) -> Array:
    """Return the relative change of a joint's friction along a log by each difference, (n_levels, n_differences).

    `first` are the parameters of the first log, (b,).
    """
    friction = np.zeros_like(system.y)
    for joint, rows in enumerate(system.joints):
        names = friction_names(joint, FRICTION)
        own = [index for index, name in enumerate(system.names) if name in names]
        friction[rows] = system.w[rows][:, own] @ first[own]
    levels = []
    for moved in changed:
        torque = np.where(columns[:, moved].any(axis=1), friction, 0.0)
        share = torque @ columns / max(float(torque @ torque), np.finfo(float).tiny)
        levels.append(np.where(moved, share, 0.0))
    return np.array(levels)


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
                    if name in friction_names(joint)
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
    kind : {"offset", "friction"}
        Their kind.
    joints : tuple of int
        Joints concerned, from 1.
    recordings : tuple of str
        Names of the recordings that differ from the first.
    worst : Difference
        Largest difference of a parameter, by the corresponding torque.
    levels : tuple of Difference
        Change of all friction of these joints in these recordings; empty for offsets.
    """

    kind: Kind
    joints: tuple[int, ...]
    recordings: tuple[str, ...]
    worst: Difference
    levels: tuple[Difference, ...]


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
    kinds: tuple[tuple[Kind, tuple[Kind, ...]], ...] = (
        ("offset", ("offset",)),
        ("friction", ("friction", "level")),
    )
    for kind, tested in kinds:
        places = {(each.recording, each.joint) for each in compared if each.kind in tested and each.clear}
        if not places:
            continue
        own = [each for each in compared if (each.recording, each.joint) in places]
        significant.append(
            Drift(
                kind=kind,
                joints=tuple(sorted({joint + 1 for _, joint in places})),
                recordings=tuple(names[number] for number in sorted({number for number, _ in places})),
                worst=max((each for each in own if each.kind == kind), key=lambda each: each.torque),
                levels=tuple(
                    each for each in own if each.kind == "level" and each.kind in tested and each.std > 0.0
                ),
            )
        )
    return significant
