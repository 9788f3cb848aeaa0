"""The constrained problem against Clarabel, another solver of conic programs: without the prior both solve the same one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import Robot
from didim.model.consistency import Cone
from didim.regression.consistent.prior import generic_prior
from didim.regression.consistent.problem import ConstrainedProblem
from didim.regression.selection import select
from didim.studies.simulated_log import simulated_log

clarabel = pytest.importorskip("clarabel")
sparse = pytest.importorskip("scipy.sparse")

Array = NDArray[np.float64]


def triangle(matrix: Array) -> Array:
    """Upper triangle column by column, off-diagonal elements times the root of two, as Clarabel has it."""
    rows, columns = np.triu_indices(len(matrix))
    order = np.lexsort((rows, columns))
    rows, columns = rows[order], columns[order]
    return np.asarray(matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0)))


def half_distance(conditions: Sequence[Cone], rows: Array, right: Array) -> float:
    """``1/2 |A x - z|^2`` at its smallest under the conditions, by Clarabel."""
    # In units of each parameter: those of the noise where the rows know it. The residual has unknowns of its own, so that
    # nothing is squared.
    sizes = np.linalg.norm(rows, axis=0)
    units = 1.0 / np.where(sizes > 1e-6 * sizes.max(), sizes, np.median(sizes))
    (r, p), rows = rows.shape, rows * units
    blocks, constants = [np.hstack([rows, -np.eye(r)])], [right]
    cones = [clarabel.ZeroConeT(r)]
    for condition in conditions:
        block = np.zeros((triangle(condition.constant).size, p + r))
        for index, basis in zip(condition.indices, condition.basis, strict=True):
            block[:, index] -= triangle(basis) * units[index]
        blocks.append(block)
        constants.append(triangle(condition.constant))
        cones.append(clarabel.PSDTriangleConeT(len(condition.constant)))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    solution = clarabel.DefaultSolver(
        sparse.diags(np.append(np.zeros(p), np.ones(r))).tocsc(),
        np.zeros(p + r),
        sparse.csc_matrix(np.vstack(blocks)),
        np.concatenate(constants),
        cones,
        settings,
    ).solve()
    return float(solution.obj_val)


def both(robot: Robot, root: Array, beta: Array) -> tuple[float, float]:
    """Half the squared distance by the core and by Clarabel."""
    problem = ConstrainedProblem(robot, select(robot, {}, ()), generic_prior(robot), 0.0)
    solved = problem.solve(root, root @ beta)
    assert solved.ending == "solved"
    # The conditions on links in units of the prior, which changes no set.
    return solved.half_distance, half_distance(
        problem.conditions, root @ robot.base_parameters.matrix, root @ beta
    )


def test_the_simulated_log_of_the_paper() -> None:
    """Half the squared distance of the estimate of IDIM-LS, in its white metric, with the filter of 60 Hz (methods.md 3.3)."""
    experiment = didim.packaged_experiment("tx40")
    log = simulated_log(experiment, experiment.robot.parameter_set("didim"), seed=0)
    method = didim.IDIMLS(uncertainty="white", signal=replace(log.signal, cutoff_hz=60.0))
    fit = didim.identify(log, method)
    root = np.linalg.inv(np.linalg.cholesky(fit.covariance))
    ours, other = both(log.robot, root, fit.beta)
    assert ours == pytest.approx(other, rel=1e-6)
    assert ours == pytest.approx(669.93, abs=0.01)


def test_the_real_log(shared: Path, project: Path) -> None:
    experiment = didim.load_experiment(
        project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40"
    )
    fit = didim.identify(experiment, didim.IDIMLS(uncertainty="decimated"))
    ours, other = both(experiment.robot, np.linalg.inv(np.linalg.cholesky(fit.covariance)), fit.beta)
    assert ours == pytest.approx(6.697, abs=1e-3)
    assert ours == pytest.approx(other, rel=1e-6)
