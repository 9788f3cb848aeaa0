"""Consistent least squares as a solver: ``IDIMLS(physical=True)``, ``DIDIM(physical=True)``.

The rows are weighted as by `didim.regression.least_squares.solve`, with the same number of solutions, the last one with
physical constraints. Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...terms.model import Model
from ...terms.rows import LinearSystem, unit_columns
from ..covariance import autocorrelated, covariance, inverse_root
from ..fit import Fit, Progress
from ..least_squares import joint_sigma, per_row
from ..settings import LeastSquaresSettings
from .bounds import Bounds
from .prior import GAMMA, Prior, prior_of
from .problem import ConstrainedProblem, Simulability

MOST_INFLATION = 6.0
"""Upper bound of the factor by which correlated residuals raise the prior's weight."""
UNIDENTIFIED_SINGULAR_VALUE = 1e-10
"""Singular value, as a share of the largest, below which a combination is not identified by the log."""


@dataclass(frozen=True, kw_only=True)
class Consistent:
    """Settings of consistent least squares; a solver for ``solver=``.

    It solves (7) with the conditions of bodies as constraints. Tested in ``tests/test_consistent.py``.

    Parameters
    ----------
    gamma : float, optional
        Weight of the prior on rows of unit white noise (nats). By default 0.01 times the factor by which the correlation of the
        residuals raises the variances, which is 1 for white noise and about 4 on real logs: correlated rows contain less
        information.
    prior : str, mapping, array or Prior
        "generic" for solids with the size of the arm and a mass from the log, a parameter set of the robot such as "urdf", or
        values by name.
    bounds : Bounds, optional
        Bounds on masses and centres.

    Raises
    ------
    FitError
        For a negative weight.
    """

    name: ClassVar[str] = "consistent"

    gamma: float | None = None
    prior: str | Mapping[str, float] | Array | Prior = "generic"
    bounds: Bounds | None = None

    def __post_init__(self) -> None:
        if self.gamma is None:
            return
        number = isinstance(self.gamma, Real) and not isinstance(self.gamma, bool)
        if not number or not 0.0 <= self.gamma < np.inf:
            raise FitError(f"gamma must be a number of at least 0, got {self.gamma!r}")

    def for_model(self, model: Model) -> ConsistentSolver:
        """Return the solver for the systems of a model."""
        return ConsistentSolver(settings=self, model=model)


CONSISTENT = Consistent()
"""Consistent least squares with its default settings."""


@dataclass(frozen=True, kw_only=True)
class ConsistentSolver:
    """Consistent least squares for the systems of one model.

    Attributes
    ----------
    settings : Consistent
        Weight, prior and bounds.
    model : Model
        Whose estimated unknowns the columns are.
    problem : ConstrainedProblem or None
        The problem, with a prior sized by a log; if None, it is built for each system.
    """

    settings: Consistent
    model: Model
    problem: ConstrainedProblem | None = None

    def on(self, system: LinearSystem, simulability: Simulability | None = None) -> ConstrainedProblem:
        """Return the problem with its prior sized by a log, and with conditions (B) if requested."""
        wish = self.settings
        prior = prior_of(self.model.own, wish.prior, system, self.model.unknowns)
        gamma = gamma_of(system) if wish.gamma is None else wish.gamma
        return ConstrainedProblem(self.model, prior, gamma, wish.bounds, simulability)

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        """Solve (7) with constraints, as `didim.regression.least_squares.solve`, but some parameters may be unidentifiable.

        Raises
        ------
        FitError
            Without rows, for numbers too large for floating point, and when no parameters meet all conditions.
        """
        if not system.y.size or not (np.isfinite(system.w).all() and np.isfinite(system.y).all()):
            raise FitError("the linear system has no rows, or values that are not finite")
        problem = self.problem or self.on(system)
        unweighted, projected = triangle_of(system.w, system.y)
        plain = _plain(unweighted, projected)
        rest = system.y - system.w @ plain
        sigma = joint_sigma(system, rest)
        weighted = settings.solutions > 1
        if not weighted:  # one size for all joints: that of all residuals
            sigma = np.full(len(sigma), max(float(np.sqrt(np.mean(rest**2))), float(sigma.min())))
        # A request to stop after the last solution has no effect.
        stopped = progress is not None and progress(1, plain, rest) and weighted
        for number in range(2, max(settings.solutions, 2) + 1):
            scale = per_row(system, 1.0 / sigma)
            triangle, right = triangle_of(system.w * scale[:, None], system.y * scale)
            constrained = problem.solve(triangle, right)
            solution = np.asarray(problem.matrix @ constrained.x)
            residual = system.y - system.w @ solution
            if stopped or (progress is not None and weighted and progress(number, solution, residual)):
                stopped = stopped or number < settings.solutions
                break
            sigma = joint_sigma(system, residual)
        weights = scale if weighted else np.ones(len(scale))
        precision = problem.precision(constrained.x)
        inverse = inverse_root(triangle.T @ triangle + precision)
        if not weighted:
            inverse, precision = inverse * scale[0], precision / scale[0] ** 2
        nearest = _plain(triangle, right)
        off = triangle @ nearest - right
        singular = np.linalg.svd(unweighted, compute_uv=False)
        return Fit(
            solution=solution,
            covariance=covariance(system, settings, weights, residual, inverse),
            residual=residual,
            weights=weights,
            precision=precision,
            condition_number=float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf"),
            stopped=bool(stopped),
            converged=constrained.ending == "solved",
            standard=constrained.x,
            record={
                "gamma": problem.gamma,
                "prior": problem.prior.name,
                "prior_mass": float(problem.prior.bodies[0][3, 3]),
                "half_distance": constrained.half_distance - 0.5 * float(off @ off),
                "iterations": constrained.iterations,
                **_errors(system, nearest, solution),
            },
        )


def _plain(w: Array, y: Array) -> Array:
    """Return the solution of least squares, even for dependent columns."""
    units, sizes = unit_columns(w)
    return np.asarray(np.linalg.lstsq(units, y, rcond=UNIDENTIFIED_SINGULAR_VALUE)[0] / sizes)


def gamma_of(system: LinearSystem) -> float:
    """Return the weight of the prior (nats) by the correlation of the plain residuals of a system (7)."""
    return GAMMA * _inflation(system)


def _inflation(system: LinearSystem) -> float:
    """Return the factor by which the correlation of the plain residuals raises variances, averaged over all directions."""
    rest = system.y - system.w @ _plain(*triangle_of(system.w, system.y))
    scale = per_row(system, 1.0 / joint_sigma(system, rest))
    q = np.linalg.qr(system.w * scale[:, None])[0]
    errors = rest * scale
    spread, _ = autocorrelated(q, errors, system.blocks, np.eye(q.shape[1]))
    squares = float(errors @ errors)
    if not squares > 0.0:
        return 1.0
    white = squares / max(1, len(errors) - q.shape[1])
    return float(np.clip(np.trace(spread) / (q.shape[1] * white), 1.0, MOST_INFLATION))


def triangle_of(w: Array, y: Array) -> tuple[Array, Array]:
    """Return ``R`` and ``z`` with ``|W b - y|^2 = |R b - z|^2 + constant``."""
    triangle = np.asarray(np.linalg.qr(np.column_stack([w, y]), mode="r"), dtype=np.float64)
    n = w.shape[1]
    return np.ascontiguousarray(triangle[:n, :n]), np.ascontiguousarray(triangle[:n, n])


def _errors(system: LinearSystem, plain: Array, solution: Array) -> dict[str, Any]:
    """Return the relative errors of plain and constrained estimate, all joints together and per joint."""
    torque = system.norms(system.measured)
    size = float(np.linalg.norm(system.measured))
    errors: dict[str, Any] = {}
    for key, estimate in (("plain", plain), ("constrained", solution)):
        error = system.y - system.w @ estimate
        errors[f"{key}_relative_error"] = float(np.linalg.norm(error) / size) if size > 0.0 else None
        norms = system.norms(error)
        errors[f"{key}_relative_errors"] = [
            float(norm / whole) if whole > 0.0 else None for norm, whole in zip(norms, torque, strict=True)
        ]
    return errors
