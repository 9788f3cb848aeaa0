r"""An additional load on an end link: of one log compared with the others, or with known parameters.

The ten parameters l of a rigid load add ``C l`` to the torques, where C are the columns of the last body in the rows of the log.
A tree has a last body per limb: the load is on that where it explains most.
Together with the columns A that are estimated at the same time,

    l = (C~^T C~)^+ C~^T rho,    C~ = C - Q Q^T C,    A = Q R,
    V = (C~^T C~)^+ m/(m - 1) sum_i s_i s_i^T (C~^T C~)^+,    s_i = C~_i^T (rho - C~ l)_i

over m intervals of time, as in `drift`. The load is significant if ``l^T V^+ l`` is. Tested in ``tests/test_load.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array
from ...robot.payload import ends, link_columns
from ...robot.robot import Robot
from ...terms.rows import LinearSystem, Rows, unit_columns
from ..covariance import intervals
from ..fit import Fit
from ..least_squares import per_row
from ..settings import BLOCKS
from .drift import DEPENDENT_EIGENVALUE, FEWEST

FALSE_LOADS = 1e-4
"""Probability of a false alarm on a log without a load."""
EXPLAINED = 0.2
"""Smallest share of the log's squared residual that a load must explain: less is model error."""
KNOWN = 0.99
"""Length of the mass's direction in the identifiable space from which the mass is reported."""


@dataclass(frozen=True)
class Load:
    """An additional load.

    Attributes
    ----------
    mass, std : float
        Mass and its standard deviation (kg); NaN if the log does not identify it.
    explained : float
        Share of the log's squared residual that it explains.
    link : str
        The link in words, ``last body`` of joints in a line.
    """

    mass: float
    std: float
    explained: float
    link: str = "last body"

    @property
    def mass_or_none(self) -> float | None:
        """Mass (kg), None if the log does not identify it."""
        return self.mass if np.isfinite(self.mass) else None

    def __str__(self) -> str:
        if not np.isfinite(self.mass):
            return f"carries a load on its {self.link}"
        direction = "heavier" if self.mass > 0.0 else "lighter"
        return f"has a {self.link} that is {abs(self.mass):.3g} +- {self.std:.1g} kg {direction}"


def load_between(system: LinearSystem, fit: Fit, robot: Robot, blocks: int = 20) -> list[tuple[int, Load]]:
    """Return the recordings that differ from the first one by a load, with the load.

    Parameters
    ----------
    system, fit : LinearSystem, Fit
        System of several recordings with common parameters, and its solution.
    robot : Robot
        Robot with the base parameters of the columns.
    blocks : int
        Intervals of time for each log.
    """
    numbers = sorted({block.recording for block in system.blocks})
    loads = []
    weighted = system.w * fit.weights[:, None]
    left = np.linalg.qr(weighted)[0]
    bodies = _last_bodies(system, robot)
    for number in numbers[1:]:
        own = np.concatenate([block.numbers for block in system.blocks if block.recording == number])
        columns = np.zeros((system.y.size, 10))
        by_link = []
        for link, body in bodies:
            columns[own] = (weighted @ body)[own]
            by_link.append(
                _load(system, columns, left, fit.residual * fit.weights, own, blocks * len(numbers), link)
            )
        load = _clearest(by_link)
        if load is not None:
            loads.append((number, load))
    return loads


def load_beyond(system: LinearSystem, beta: Array, robot: Robot) -> Load | None:
    """Return the load of a log beyond known parameters; friction and offsets may differ from these.

    Parameters
    ----------
    system : LinearSystem
        System of the log.
    beta : (b,) array
        Known values of its columns.
    robot
        As for `load_between`.
    """
    residual = system.y - system.w @ beta
    sizes = np.maximum(system.norms(residual), np.finfo(float).tiny)
    weights = per_row(system, 1.0 / sizes)
    free = [k for k, name in enumerate(system.names) if name.startswith(("F", "Off"))]
    weighted = system.w * weights[:, None]
    left = np.linalg.qr(weighted[:, free])[0] if free else np.zeros((system.y.size, 0))
    every, residual = np.arange(system.y.size), residual * weights
    return _clearest(
        [
            _load(system, weighted @ body, left, residual, every, BLOCKS, link)
            for link, body in _last_bodies(system, robot)
        ]
    )


def _last_bodies(system: LinearSystem, robot: Robot) -> list[tuple[str, Array]]:
    """Return each end link in words, and the effect of a unit of each of its parameters on those of the columns, (b, 10)."""
    base = robot.base_parameters
    rows = [base.names.index(name) for name in system.names]
    bodies = []
    for joint in ends(robot):
        units = link_columns(robot, joint)
        effects = np.column_stack([base.project(units[:, k]) for k in range(10)])
        link = "last body" if robot.geometry.in_line else f"body of {robot.joint_label(joint)}"
        bodies.append((link, np.asarray(effects[rows])))
    return bodies


def _clearest(loads: Sequence[Load | None]) -> Load | None:
    """Return the load that explains most."""
    return max(filter(None, loads), key=lambda load: load.explained, default=None)


def _load(
    system: LinearSystem,
    columns: Array,
    left: Array,
    residual: Array,
    own: Rows,
    blocks: int,
    link: str,
) -> Load | None:
    from scipy.special import fdtrc  # not scipy.stats, which takes half a second to load

    parts = [part.rows for part in intervals(system.blocks, blocks)]
    m = len(parts)
    rest = residual - left @ (left.T @ residual)
    beside, scale = unit_columns(columns)
    beside -= left @ (left.T @ beside)
    values, vectors = np.linalg.eigh(beside.T @ beside)
    good = values > max(DEPENDENT_EIGENVALUE, 1e-6) * values[-1]
    rank = int(good.sum())
    if m < max(FEWEST, rank + 2) or not values[-1] > 0.0:
        return None
    directions = vectors[:, good]
    reduced = beside @ (directions / np.sqrt(values[good]))  # orthonormal columns
    projected = reduced.T @ rest
    error = rest - reduced @ projected
    scores = np.array([reduced[rows].T @ error[rows] for rows in parts])
    covariance = m / (m - 1) * scores.T @ scores
    statistic = float(projected @ np.linalg.solve(covariance, projected)) * (m - rank) / (rank * (m - 1))
    before = float(rest[own] @ rest[own])
    explained = 1.0 - float(error[own] @ error[own]) / before if before > 0.0 else 0.0
    if not (fdtrc(rank, m - rank, statistic) < FALSE_LOADS and explained > EXPLAINED):
        return None
    back = (directions / np.sqrt(values[good])) / scale[:, None]
    known = float(np.linalg.norm(directions[9])) >= KNOWN
    mass = float(back[9] @ projected) if known else float("nan")
    std = float(np.sqrt(back[9] @ covariance @ back[9])) if known else float("nan")
    return Load(mass, std, explained, link)
