"""Recursive least squares: the batch estimate, whatever the chunks."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.errors import FitError, RankError, ShapeError
from didim.regression.triangles import Triangles

ROBOT = didim.load_robot("planar2")


def log(seed: int = 0, n: int = 700) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 7.0, n)[:, None]
    omega, phase = rng.uniform(1.0, 4.0, (2, 1, 2))
    q = np.sin(omega * t + phase)
    dq, ddq = omega * np.cos(omega * t + phase), -(omega**2) * q
    beta = rng.uniform(0.5, 2.0, len(ROBOT.base_parameters.names))
    tau = didim.inverse_dynamics(ROBOT, q, dq, ddq, ROBOT.base_parameters.lift(beta))
    return q, dq, ddq, tau + rng.standard_normal(tau.shape) * [0.3, 0.05], beta


def rows_of(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    return didim.regressor(ROBOT, q, dq, ddq)[:, :, list(ROBOT.base_parameters.indices)]


def batch(w: np.ndarray, y: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Least squares with weights per joint from a first solution without, by NumPy."""
    time = np.ones(len(y)) if weights is None else np.sqrt(weights)
    sigma = np.ones(y.shape[1])
    for _ in range(2):
        scale = (time[:, None] / sigma)[:, :, None]
        x = np.linalg.lstsq((w * scale).reshape(-1, w.shape[2]), (y[:, :, None] * scale).ravel(), rcond=None)[
            0
        ]
        sigma = np.sqrt(np.sum((time[:, None] * (y - w @ x)) ** 2, axis=0))
    return np.asarray(x)


@pytest.mark.parametrize("chunks", [(0, 700), (0, 1, 3, 100, 101, 450, 700), tuple(range(0, 701, 7))])
def test_the_estimate_is_that_of_all_rows_at_once(chunks: tuple[int, ...]) -> None:
    q, dq, ddq, tau, _ = log()
    recursive = didim.Recursive(ROBOT)
    for start, stop in pairwise(chunks):
        part = slice(start, stop)
        recursive.update(q[part], dq[part], ddq[part], tau[part])
    found = recursive.estimate()
    assert found.beta == pytest.approx(batch(rows_of(q, dq, ddq), tau), rel=1e-10)
    assert recursive.n_samples == 700
    assert recursive.n_rows == 700.0


def test_the_errors_are_as_large_as_sigma_says() -> None:
    ratios = []
    for seed in range(20):
        q, dq, ddq, tau, beta = log(seed)
        recursive = didim.Recursive(ROBOT)
        recursive.update(q, dq, ddq, tau)
        found = recursive.estimate()
        ratios.append((found.beta - beta) / found.std)
        assert found.joint_std == pytest.approx([0.3, 0.05], rel=0.15)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.15)


def test_averages_do_not_depend_on_the_chunks() -> None:
    q, dq, ddq, tau, _ = log()
    recursive = didim.Recursive(ROBOT, average=10)
    for start, stop in pairwise((0, 3, 57, 58, 400, 700)):
        part = slice(start, stop)
        recursive.update(q[part], dq[part], ddq[part], tau[part])
    w, y = (values.reshape(70, 10, *values.shape[1:]).mean(axis=1) for values in (rows_of(q, dq, ddq), tau))
    assert recursive.estimate().beta == pytest.approx(batch(w, y), rel=1e-10)
    other = didim.Recursive(ROBOT)
    other.update_rows(w, y)
    assert other.estimate().beta == pytest.approx(recursive.estimate().beta, rel=1e-10)


def test_forgetting_weights_rows_by_their_age() -> None:
    q, dq, ddq, tau, _ = log()
    recursive = didim.Recursive(ROBOT, forgetting=0.99)
    for start, stop in pairwise((0, 20, 350, 700)):
        part = slice(start, stop)
        recursive.update(q[part], dq[part], ddq[part], tau[part])
    ages = np.arange(699, -1, -1)
    assert recursive.estimate().beta == pytest.approx(batch(rows_of(q, dq, ddq), tau, 0.99**ages), rel=1e-9)
    assert recursive.n_rows == pytest.approx(np.sum(0.99**ages))


def test_a_change_of_the_robot_is_followed() -> None:
    q, dq, ddq, tau, beta = log()
    changed = didim.inverse_dynamics(ROBOT, q, dq, ddq, ROBOT.base_parameters.lift(1.3 * beta))
    recursive = didim.Recursive(ROBOT, forgetting=0.98)
    recursive.update(q, dq, ddq, tau)
    recursive.update(q, dq, ddq, changed)
    assert recursive.estimate().beta == pytest.approx(1.3 * beta, rel=1e-3)


def test_two_logs_are_added() -> None:
    first, second = log(0), log(0)
    one, two, both = didim.Recursive(ROBOT), didim.Recursive(ROBOT), didim.Recursive(ROBOT)
    one.update(*(values[:300] for values in first[:4]))
    two.update(*(values[300:] for values in second[:4]))
    both.update(*first[:4])
    one.merge(two)
    assert one.estimate().beta == pytest.approx(both.estimate().beta, rel=1e-10)
    assert one.n_samples == 700
    assert one.n_rows == 700.0


def test_memory_stays_what_it_is() -> None:
    triangles = Triangles(2, 3)
    rng = np.random.default_rng(0)
    sizes = set()
    for _ in range(20):
        w = rng.standard_normal((9, 2, 3))
        w[:, 1, 0] = 0.0  # as a link before the joint
        triangles.fold(w, rng.standard_normal((9, 2)))
        sizes.add(tuple(len(z) for _, z in triangles.system()))
    assert sizes == {(4, 3)}


def test_fixed_parameters_are_taken_out() -> None:
    q, dq, ddq, _, beta = log()
    tau = didim.inverse_dynamics(ROBOT, q, dq, ddq, ROBOT.base_parameters.lift(beta))
    name = ROBOT.base_parameters.names[1]
    recursive = didim.Recursive(ROBOT, fixed={name: beta[1]})
    recursive.update(q, dq, ddq, tau)
    found = recursive.estimate()
    assert found.beta == pytest.approx(beta, rel=1e-8)
    assert found.std[1] == 0.0
    assert found.relative_error.max() < 1e-9


def test_what_the_motion_does_not_show_yet_is_named() -> None:
    q, dq, ddq, tau, _ = log()
    recursive = didim.Recursive(ROBOT)
    with pytest.raises(FitError, match="more chunks are needed"):
        recursive.estimate()
    still = np.zeros_like(q)
    recursive.update(q, still, still, tau)
    with pytest.raises(RankError, match="Fv1"):
        recursive.estimate()
    recursive.update(q, dq, ddq, tau)
    assert np.isfinite(recursive.estimate().beta).all()


def test_wrong_calls() -> None:
    q, dq, ddq, tau, _ = log(n=20)
    recursive = didim.Recursive(ROBOT)
    with pytest.raises(ShapeError, match=r"tau must have shape \(n_samples, 2\)"):
        recursive.update(q, dq, ddq, tau[:, :1])
    with pytest.raises(ShapeError, match="same number of samples, got 20, 20, 20, 19"):
        recursive.update(q, dq, ddq, tau[:-1])
    bad = tau.copy()
    bad[3, 1] = np.nan
    with pytest.raises(ShapeError, match="tau of joint 2 is not a finite number at sample 4"):
        recursive.update(q, dq, ddq, bad)
    assert recursive.n_samples == 0
    with pytest.raises(ShapeError, match="w must have shape"):
        recursive.update_rows(np.zeros((3, 2, 1)), np.zeros((3, 2)))
    with pytest.raises(FitError, match="average"):
        didim.Recursive(ROBOT, average=0)
    with pytest.raises(FitError, match="forgetting"):
        didim.Recursive(ROBOT, forgetting=1.5)
    with pytest.raises(FitError, match="differ in the parameters"):
        recursive.merge(didim.Recursive(ROBOT, dropped=["Fc1"]))


def test_streaming_the_real_tx40_log(project: Path, shared: Path) -> None:
    """In chunks of 0.1 s: five rows of each joint at 50 Hz."""
    experiment = didim.load_experiment(
        project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40"
    )
    method = didim.IDIMLS(uncertainty="white")
    fit = didim.identify(experiment, method)
    job = method.job(experiment)
    system = job.system(job.parts("fit"))
    w = system.w.reshape(6, -1, 60).transpose(1, 0, 2)
    y = system.y.reshape(6, -1).T
    recursive = didim.Recursive(job.robot)
    for start in range(0, len(y), 5):
        recursive.update_rows(w[start : start + 5], y[start : start + 5])
    found = recursive.estimate(reweightings=3)
    assert found.beta == pytest.approx(fit.beta, rel=1e-10)
    assert found.std == pytest.approx(fit.std, rel=1e-9)
    assert found.relative_error == pytest.approx(fit.relative_error, rel=1e-9)
