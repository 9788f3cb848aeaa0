"""Rows that hypotheses are tried on, beside those of a fit, and their scores beside plain least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import didim
from didim.methods.verdict.causes.geometry import with_geometry
from didim.methods.verdict.causes.rows import ROWS, Rows
from didim.regression.linear_system import linear_system
from didim.regression.selection import select
from didim.robot.robot import Robot
from verdict_arms import ARMS, built


def rows_of(experiment: didim.Experiment) -> Rows:
    job = didim.IDIMLS().job(experiment)
    return Rows(job, job.parts("fit", job.declared_delay))


@pytest.fixture(scope="module", params=["arm7", "asymmetric"])
def rows(request: pytest.FixtureRequest) -> Rows:
    experiment = built(ARMS["arm7"], None).noisy(3, 0.01)
    if request.param == "asymmetric":  # whose columns are exchanged where a joint turns the other way
        experiment = replace(experiment, robot=experiment.robot.with_friction(model="asymmetric"))
    return rows_of(experiment)


def torque_of(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Torques that columns explain, (n_dof, n_rows)."""
    flat = columns.reshape(-1, columns.shape[2])
    return np.asarray(flat @ np.linalg.lstsq(flat, y.reshape(-1), rcond=1e-10)[0]).reshape(y.shape)


def near(found: np.ndarray, wanted: np.ndarray) -> None:
    """Within what the rougher look may miss."""
    missed = np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
    assert missed.max() < 0.03


def turned(robot: Robot) -> Robot:
    """A robot whose file has another twist, and another gravity."""
    alpha = list(robot.geometry.alpha)
    alpha[2] = -alpha[2]
    return with_geometry(robot, alpha=tuple(alpha), gravity=(0.0, 9.81, 0.0))


def test_rows_are_those_of_a_fit(rows: Rows) -> None:
    system = linear_system(rows.robot, rows.parts, rows.signal, select(rows.robot, {}, ()))
    assert 200 < rows.n_rows < 2 * ROWS
    assert len(rows.folds[0]) + len(rows.folds[1]) == rows.n_rows
    np.testing.assert_array_equal(rows.y, system.y.reshape(rows.y.shape[0], -1)[:, :: rows.thin])
    np.testing.assert_array_equal(
        rows.w, system.w.reshape(rows.y.shape[0], -1, system.w.shape[1])[:, :: rows.thin]
    )


@pytest.mark.parametrize("change", [lambda robot: robot, turned])
def test_the_rougher_look_at_another_robot(rows: Rows, change: Callable[[Robot], Robot]) -> None:
    robot = change(rows.robot)
    system = linear_system(robot, rows.parts, rows.signal, select(robot, {}, ()))
    whole = system.w.reshape(robot.n_dof, -1, system.w.shape[1])[:, :: rows.thin]
    near(torque_of(rows.screen.of_robot(robot), rows.y), torque_of(whole, rows.y))


def test_the_rougher_look_at_a_joint_that_turns_the_other_way(rows: Rows) -> None:
    turn = np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    parts = [replace(part, q=part.q @ turn, dq=part.dq @ turn, ddq=part.ddq @ turn) for part in rows.parts]
    system = linear_system(rows.robot, parts, rows.signal, select(rows.robot, {}, ()))
    whole = system.w.reshape(rows.robot.n_dof, -1, system.w.shape[1])[:, :: rows.thin]
    near(torque_of(rows.screen.of_motion(turn), rows.y), torque_of(whole, rows.y))


def test_a_hopeless_robot_is_not_looked_at_twice(rows: Rows) -> None:
    """The declared robot is right: another one is hopeless, and the same one is not named either."""
    other = turned(rows.robot)
    assert rows.rough_share(other) > 4.0
    assert rows.of_robot(other) is None
    assert rows.rough_share(rows.robot) == pytest.approx(1.0, abs=1e-9)


def test_the_right_robot_for_a_wrong_file() -> None:
    """Its score is that of the columns of a fit, not of the rougher look."""
    experiment = built(ARMS["arm7"], None).noisy(3, 0.01)
    wrong = replace(experiment, robot=turned(experiment.robot))
    rows = rows_of(wrong)
    found = rows.of_robot(experiment.robot)
    assert found is not None
    right = rows_of(experiment)
    assert found.score(rows.weights) == pytest.approx(right.declared.score(rows.weights), rel=1e-6)
    assert found.score(rows.weights) < 0.1 * rows.score


def test_a_joint_that_turns_the_other_way() -> None:
    experiment = built(ARMS["arm7"], None).noisy(3, 0.01)
    (recording,) = experiment.recordings
    turn = np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    other = replace(experiment, recordings=(replace(recording, q=recording.q @ turn),))
    found = rows_of(other).of_motion(turn, np.ones((1, 7)))
    assert found is not None
    rows = rows_of(experiment)
    assert found.score(rows.weights) == pytest.approx(rows.score, rel=1e-3)


@pytest.mark.parametrize("gain", [1.0, 1.4, -1.0])
def test_scores_are_errors_on_stretches_that_were_not_fitted(rows: Rows, gain: float) -> None:
    gains = np.ones(rows.robot.n_dof)
    gains[1] = gain
    columns = rows.w * (gains * np.sqrt(rows.weights))[:, None, None]
    torques = rows.y * np.sqrt(rows.weights)[:, None]
    squares = np.zeros(rows.robot.n_dof)
    for seen, unseen in (rows.folds, rows.folds[::-1]):
        w, y = columns[:, seen].reshape(-1, columns.shape[2]), torques[:, seen].reshape(-1)
        solution = np.linalg.lstsq(w, y, rcond=None)[0]
        squares += np.sum((torques[:, unseen] - columns[:, unseen] @ solution) ** 2, axis=1)
    wanted = np.exp(np.mean(np.log(squares)))
    assert rows.declared.score(rows.weights, gains) == pytest.approx(wanted, rel=1e-5)


def test_columns_beside_every_model(rows: Rows) -> None:
    beside = np.random.default_rng(1).standard_normal((rows.robot.n_dof, rows.n_rows, 2))
    wide = rows.widened(beside)
    assert wide.declared.w.shape[2] == rows.declared.w.shape[2] + 2
    assert rows.beside is None
    assert rows.with_columns(beside).score(wide.weights) == pytest.approx(wide.score, rel=1e-9)


def test_a_log_of_many_rows_is_thinned_out() -> None:
    experiment = built(ARMS["arm7"], None).noisy(3, 0.01)
    job = didim.IDIMLS(signal=replace(didim.IDIMLS().job(experiment).signal, decimation=())).job(experiment)
    rows = Rows(job, job.parts("fit", job.declared_delay))
    assert ROWS <= rows.n_rows < 2 * ROWS
    assert rows.w.shape[1] == rows.y.shape[1] == rows.n_rows
