"""Samples of a robot as its log tells it: correlated draws of what a fit has estimated, for training in simulation.

The draws have Student's distribution with the covariance of the fit, given that they are between the bounds: none is moved to a
bound. With ``x = theta + S z``, ``S S^T`` the covariance and z normal with variance 1 / w, w chi-squared over its degrees of
freedom, Gibbs' sampler draws one coordinate of z after the other from its normal distribution between the ends that the bounds
leave, then w given z. A fit of torques needs none: each draw is the robot nearest to one of its base parameters. Tested in
``tests/test_samples.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any, cast

import numpy as np

from .._tools.arrays import Array, quotient
from .._tools.saved import plain, save_json, save_npz
from .._tools.words import columned, series
from ..errors import FitError
from ..regression.consistent.nearest import FEWEST_DRAWS, LEAST_FREEDOM, Nearness
from ..regression.consistent.prior import Prior
from ..robot.robot import Robot
from .consistent import MovedToRobot
from .positions.record import PositionRecord

SUFFIXES = (".npz", ".json")
"""Suffixes of files of samples."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Draws of the unknowns of a fit, joint side, SI units.

    Attributes
    ----------
    names, kinds, units : tuple of str
        Those of the unknowns: ``Ia3``, ``Ia``, ``kg.m^2``.
    joints : tuple of tuple of str
        Names of the joints that have each; those of a link or a motor for the parameters of a fit of torques.
    origins : tuple of str
        "log", "prior", "bound" (the estimate is at one) or "held" (the log does not tell it, and all draws have its value).
    texts : tuple of str
        What is known in the place of one that is held; empty for the others.
    estimate : (p,) array
        The estimates.
    values : (n, p) array
        The draws.
    runs : (p,) array
        Standard deviation from log to log, which widens the draws of each by itself; zero for a fit of one log.
    seed : int
        Seed of NumPy's default generator.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    joints: tuple[tuple[str, ...], ...]
    origins: tuple[str, ...]
    texts: tuple[str, ...]
    estimate: Array
    values: Array
    runs: Array
    seed: int

    @property
    def ranges(self) -> Array:
        """Marginal ranges, (3, p): 5, 50 and 95 %."""
        return np.asarray(np.percentile(self.values, (5, 50, 95), axis=0))

    def to_dict(self) -> dict[str, Any]:
        """Return everything by name, as the files have it."""
        known = {key: getattr(self, key) for key in self.__dataclass_fields__}
        return {**known, "percent": (5, 50, 95), "ranges": self.ranges}

    def save(self, path: str | Path) -> None:
        """Write ``.npz``, arrays by name with the joints of an unknown in one text, or ``.json``.

        Raises
        ------
        FitError
            When the name has another suffix.
        OSError
            When the file cannot be written.
        """
        path, content = Path(path), self.to_dict()
        if path.suffix == ".json":
            save_json(path, plain(content))
        elif path.suffix == ".npz":
            save_npz(path, {**content, "joints": [" ".join(names) for names in self.joints]})
        else:
            raise FitError(f"a file of samples ends in .npz or .json, and '{path.name}' does not")

    def __str__(self) -> str:
        rows = [("", "unit", "estimate", "5 %", "50 %", "95 %", "from")]
        for k, low, mid, high in zip(range(len(self.names)), *self.ranges, strict=True):
            numbers = [f"{value:.4g}" for value in (self.estimate[k], low, mid, high)]
            rows.append((self.names[k], self.units[k], *numbers, self.origins[k]))
        held = [name for name, origin in zip(self.names, self.origins, strict=True) if origin == "held"]
        told = [f"the log does not tell {series(held)}: all draws have one value of each"] if held else []
        if self.runs.any():
            told.append("the draws are widened by what the logs differ among each other")
        return "\n".join([*columned(rows, 2), "", f"{len(self.values)} correlated draws", *told])


class Sampled(MovedToRobot):
    """Draws of a result."""

    names: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the robot's joints; empty where its file has none."""
        return tuple(self.robot_record.get("joint_names", ()))

    @property
    def robot_record(self) -> Mapping[str, Any]:
        """The robot as the result has it, names of joints, geometry and friction; empty where it is not recorded."""
        return cast(Mapping[str, Any], self.settings.get("robot", {}))

    def samples(
        self,
        count: int = 1000,
        *,
        seed: int = 0,
        prior: str | Mapping[str, float] | Array | Prior = "generic",
        robot: Robot | None = None,
    ) -> Samples:
        """Return correlated draws of what was estimated, within what physics and the bounds of the fit allow.

        A fit of positions has its unknowns, armatures, friction, gains and delays, widened by the spread from log to log where it
        has several; what the log does not tell keeps its value, and what it has from a prior that prior's width. Other fits have
        the standard parameters of links and joints, each draw those of a robot that can exist.

        Parameters
        ----------
        count, seed : int
            Number of draws, and the seed of NumPy's default generator.
        prior, robot
            For a fit of torques, as of `consistent`.

        Raises
        ------
        FitError
            For a result without standard deviations, or of an older version.

        Notes
        -----
        ``test_samples.py`` compares with the covariance and with rejected draws, and simulates fleets whose spread is known.
        """
        if isinstance(count, bool) or not isinstance(count, Integral) or count < FEWEST_DRAWS:
            raise FitError(f"samples need at least {FEWEST_DRAWS} draws, a whole number, got {count!r:.40}")
        record = PositionRecord.of(self.settings)
        if record is None:
            return self._robots(count, seed, prior, robot)
        rows, uncertainty = record.rows, self.uncertainty
        if uncertainty is None:
            raise FitError(
                "the result has no standard deviations: its log is too short, and samples need them"
            )
        if not all("bounds" in row for row in rows):
            raise FitError("the result of an older version lacks what samples need: identify the log again")
        runs = np.array([row["runs"] for row in rows])
        # The estimate without a block stays at its bound or leaves it to one side: that is no correlation.
        stuck = np.array([row["by"] == "bound" for row in rows])
        apart = (stuck[:, None] | stuck) & ~np.eye(len(rows), dtype=bool)
        low, high = (
            np.array([end if row["bounds"][k] is None else row["bounds"][k] for row in rows])
            for k, end in enumerate((-math.inf, math.inf))
        )
        return Samples(
            names=self.names,
            kinds=tuple(row["kind"] for row in rows),
            units=self.units,
            joints=tuple(tuple(self._joint(number) for number in row["joints"]) for row in rows),
            origins=tuple(row["by"] if row["by"] == "bound" or row["std"] else "held" for row in rows),
            texts=tuple(row["text"] for row in rows),
            estimate=self.beta,
            values=draws_between(
                self.beta,
                np.where(apart, 0.0, self.covariance) + np.diag(runs**2),
                (low, high),
                max(uncertainty.degrees_of_freedom, LEAST_FREEDOM),
                (count, seed),
            ),
            runs=runs,
            seed=seed,
        )

    def _robots(
        self, count: int, seed: int, prior: str | Mapping[str, float] | Array | Prior, robot: Robot | None
    ) -> Samples:
        """Return the robots nearest to draws of base parameters."""
        known, _, nearest = self._nearest(Nearness(prior=prior, draws=count, seed=seed), robot)
        return Samples(
            names=known.parameter_names,
            kinds=tuple(parameter.kind for parameter in known.standard_parameters),
            units=known.parameter_units,
            joints=tuple((self._joint(parameter.joint + 1),) for parameter in known.standard_parameters),
            origins=tuple("log" if identified else "prior" for identified in nearest.identified),
            texts=("",) * len(known.parameter_names),
            estimate=nearest.x,
            values=nearest.draws,
            runs=np.zeros(len(nearest.x)),
            seed=seed,
        )

    def _joint(self, number: int) -> str:
        return self.joint_names[number - 1] if number <= len(self.joint_names) else f"joint {number}"


def draws_between(
    centre: Array,
    covariance: Array,
    bounds: tuple[Array, Array],
    freedom: float,
    draws: tuple[int, int],
    rounds: int = 30,
) -> Array:
    """Return draws of Student's distribution, given that they are between bounds.

    Parameters
    ----------
    centre, covariance : (p,) and (p, p) arrays
        Of the normal distribution behind it; a variance of zero holds a value.
    bounds : (low, high), (p,) arrays
        Bounds, between which `centre` is; infinite without one.
    freedom : float
        Degrees of freedom; infinite for normal draws.
    draws : (count, seed)
        Number of draws, and seed of NumPy's default generator.
    rounds : int
        Rounds of the sampler for each draw. Of 49 unknowns, 8 within two deviations of a bound and 20 at one, two correlated to
        0.997, means and deviations after 30 are those after 300 within the error of a thousand draws.

    Returns
    -------
    (count, p) array
        The draws.
    """
    from scipy.special import ndtr, ndtri  # loads a fifth of a second

    (low, high), (count, seed) = bounds, draws
    random, size = np.random.default_rng(seed), len(centre)
    std = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(quotient(covariance, np.outer(std, std)))
    # The symmetric root is the only one: signs of eigenvectors depend on the processor.
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * std
    near = np.isfinite(low) | np.isfinite(high)
    scale = np.ones(count) if math.isinf(freedom) else random.chisquare(freedom, count) / freedom
    z = random.standard_normal((size, count)) / np.sqrt(scale)
    for _ in range(rounds):
        x = (centre + z.T @ root)[:, near]
        # One that is outside comes no further out, until it is inside.
        room = np.stack([np.minimum(low[near], x) - x, np.maximum(high[near], x) - x])
        for k, row in enumerate(root[:, near]):
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = np.sort(np.where(row == 0.0, [[[-np.inf]], [[np.inf]]], room / row), axis=0)
            # Coordinate k of z, between the ends: in the tail where the normal distribution has most digits.
            low_end = (z[k] + ends[0].max(axis=1, initial=-np.inf)) * np.sqrt(scale)
            high_end = (z[k] + ends[1].min(axis=1, initial=np.inf)) * np.sqrt(scale)
            side = np.where(low_end > 0.0, -1.0, 1.0)
            first, last = np.sort([side * low_end, side * high_end], axis=0)
            drawn = ndtri(ndtr(first) + (ndtr(last) - ndtr(first)) * random.uniform(size=count))
            new = side * np.clip(drawn, first, last) / np.sqrt(scale)
            room -= np.outer(new - z[k], row)
            z[k] = new
        if not math.isinf(freedom):
            scale = random.gamma(0.5 * (freedom + size), 2.0 / (freedom + np.sum(z**2, axis=0)))
    x = centre + z.T @ root
    inside = ((x - low >= -1e-9 * std) & (high - x >= -1e-9 * std)).all(axis=1)
    x[~inside] = (
        x[random.choice(np.flatnonzero(inside), np.count_nonzero(~inside))] if inside.any() else centre
    )
    return np.asarray(np.clip(x, low, high))
