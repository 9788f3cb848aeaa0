"""The constrained problem against Clarabel, another solver of conic programs: without the prior both solve the same one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from conditions import multipliers, violations
from didim import Robot
from didim.model.consistency import places_of
from didim.regression.consistent.prior import generic_prior
from didim.regression.consistent.problem import ConstrainedProblem
from didim.robot.rigid_body import INERTIAL
from didim.studies.simulated_log import simulated_log
from didim.terms.model import Model

clarabel = pytest.importorskip("clarabel")
sparse = pytest.importorskip("scipy.sparse")

Array = NDArray[np.float64]


def triangle(matrix: Array) -> Array:
    """Upper triangle column by column, off-diagonal elements times the root of two, as Clarabel has it."""
    rows, columns = np.triu_indices(len(matrix))
    order = np.lexsort((rows, columns))
    rows, columns = rows[order], columns[order]
    return np.asarray(matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0)))


def units_of(problem: ConstrainedProblem) -> Array:
    """Size of every standard parameter of the prior's bodies; rotors and friction of the prior are about 1."""
    units = np.ones(len(problem.robot.parameter_names))
    places = places_of(problem.robot)
    for j, body in enumerate(problem.prior.bodies, start=1):
        mass, radius = body[3, 3], np.sqrt(np.trace(body[:3, :3]) / (3.0 * body[3, 3]))
        for place, name in enumerate(INERTIAL):
            units[places[f"{name}{j}"]] = mass * radius ** (2 if place < 6 else 1 if place < 9 else 0)
    return units


def bounds_of_clarabel(problem: ConstrainedProblem, root: Array, beta: Array) -> tuple[float, float]:
    """``1/2 |R (B x - beta)|^2`` at its smallest under the conditions, by Clarabel: its dual bound and its gap.

    The unknowns are the residual, in units of the noise, and the standard parameters that regroup, in those of the prior: with
    others rounding ends Clarabel before its tolerances.
    """
    unknowns, n = problem.unknowns, len(root)
    others = unknowns.shape[1] - n
    units = units_of(problem)[np.abs(unknowns[:, :others]).argmax(axis=0)]
    columns = np.hstack([unknowns[:, :others] * units, unknowns[:, others:] @ np.linalg.inv(root)])
    fitted = unknowns[:, others:] @ beta
    blocks, constants, cones = [], [], []
    for condition in problem.conditions:
        basis = np.array([triangle(matrix) for matrix in condition.basis]).T
        blocks.append(-basis @ columns[list(condition.indices)])
        constants.append(triangle(condition.at(fitted)))
        cones.append(clarabel.PSDTriangleConeT(len(condition.constant)))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.diag(np.append(np.zeros(others), np.ones(n)))),
        np.zeros(others + n),
        sparse.csc_matrix(np.vstack(blocks)),
        np.concatenate(constants),
        cones,
        settings,
    ).solve()
    assert solution.status == clarabel.SolverStatus.Solved
    return float(solution.obj_val_dual), abs(float(solution.obj_val - solution.obj_val_dual))


def assert_optimal(robot: Robot, root: Array, beta: Array, expected: float) -> None:
    """The core's point meets every condition, and is as good as any: no digits of another solver are looked at."""
    problem = ConstrainedProblem(Model(robot), generic_prior(robot), 0.0)
    solved = problem.solve(root, root @ beta)
    assert solved.ending == "solved"
    assert violations(problem.conditions, solved.x, tolerance=0.0) == []
    bound, gap = bounds_of_clarabel(problem, root, beta)
    barriers = sum(
        float(np.trace(condition.at(solved.x) @ multiplier))
        for condition, multiplier in zip(
            problem.conditions, multipliers(problem, root, root @ beta), strict=True
        )
    )
    assert solved.half_distance - bound <= barriers + gap
    # Barriers of friction, most of that sum, do not bind: less than that is lost, and both solvers have tolerances.
    assert abs(solved.half_distance - bound) <= 1e-5 * bound + gap
    assert solved.half_distance == pytest.approx(expected, rel=1e-4)


def test_the_simulated_log_of_the_paper() -> None:
    """Half the squared distance of the estimate of IDIM-LS, in its white metric, with the filter of 60 Hz."""
    experiment = didim.packaged_experiment("tx40")
    log = simulated_log(experiment, experiment.robot.parameter_set("didim"), seed=0)
    method = didim.IDIMLS(uncertainty="white", signal=replace(log.signal, cutoff_hz=60.0))
    fit = didim.identify(log, method)
    root = np.linalg.inv(np.linalg.cholesky(fit.covariance))
    assert_optimal(log.robot, root, fit.beta, 669.93)


def test_the_real_log(shared: Path, project: Path) -> None:
    experiment = didim.load_experiment(
        project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40"
    )
    fit = didim.identify(experiment, didim.IDIMLS(uncertainty="decimated"))
    assert_optimal(experiment.robot, np.linalg.inv(np.linalg.cholesky(fit.covariance)), fit.beta, 6.697)
