"""DIDIM in a slack loop: Newton's method to the fixed point, the distance that is left, and standard deviations that hold there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from arm import arm_log, noisy
from didim import DIDIM, Experiment, Identification, identify
from didim.loop.outcome import Outcome
from didim.methods.didim.problem import Iterate, Problem, Simulated, Solved
from didim.methods.didim.slack import NEAR, Ahead, response
from didim.result.iteration import Reporter
from plain import plain_didim
from scripts import script

Array = NDArray[np.float64]

BENCH = script(Path(__file__).parents[1] / "benches" / "slack_loop.py")


@pytest.fixture(scope="module")
def slack() -> Experiment:
    """A planar arm in a loop of 2 Hz, without noise."""
    return arm_log(1, natural_frequency_hz=2.0)


@pytest.fixture(scope="module")
def digital() -> Experiment:
    """Seven axes in a slack digital loop."""
    log: Experiment = BENCH.digital_log(1)
    return log


def distance(fit: Identification, end: Identification) -> float:
    return float(np.max(np.abs(fit.beta - end.beta)[end.std > 0.0] / end.std[end.std > 0.0]))


def iterated(experiment: Experiment, method: DIDIM, most: int = 60) -> Identification:
    """Return the fixed point, by iterations until nothing moves."""
    finer = replace(method, tolerance=0.0, sigma_fraction=1e-4, max_iterations=most)
    return identify(experiment, finer)


@pytest.mark.usefixtures("unjudged")
@pytest.mark.parametrize("tolerance", [1e-3, 0.025])
@pytest.mark.parametrize("frequency_hz", [1.0, 2.0])
def test_the_fixed_point_is_no_farther_than_the_result_says(frequency_hz: float, tolerance: float) -> None:
    log = noisy(arm_log(1, natural_frequency_hz=frequency_hz))
    fit = identify(log, plain_didim(sigma_fraction=0.0, tolerance=tolerance, max_iterations=40))
    assert fit.converged
    end = iterated(log, plain_didim(start=fit.beta))
    assert end.converged
    last = fit.history[-1].more
    assert distance(fit, end) <= last["remaining_sigma"] <= 2.0 * NEAR
    remark, wider = fit.remarks
    assert wider.startswith("standard deviations are up to ")
    assert remark.startswith(
        f"slow contraction: an iteration in this slack loop leaves {last['contraction']:.2g} of "
    )
    assert f"at most {last['remaining_sigma']:.2g}" in remark


@pytest.mark.usefixtures("unjudged")
def test_physical_iterations_end_there_too(slack: Experiment) -> None:
    log = noisy(slack)
    fit = identify(log, DIDIM(sigma_fraction=0.0, tolerance=0.025))
    assert fit.converged
    assert fit.settings["didim"]["physical"] is True
    end = iterated(log, DIDIM())
    assert distance(fit, end) <= fit.history[-1].more["remaining_sigma"] <= 2.0 * NEAR


@pytest.mark.slow
@pytest.mark.usefixtures("unjudged")
def test_standard_deviations_are_those_of_the_fixed_point(slack: Experiment) -> None:
    """Errors of eight logs are about one standard deviation, which for some parameters is far from that of a tight loop."""
    truth = slack.robot.base_parameters.project(slack.robot.parameter_set("reference"))
    off, tight = [], []
    for seed in range(8):
        fit = identify(noisy(slack, seed=seed), plain_didim(uncertainty="decimated", max_iterations=40))
        assert fit.converged
        off.append((fit.beta - truth) / fit.std)
        stiff = identify(noisy(arm_log(1), seed=seed), plain_didim(uncertainty="decimated"))
        tight.append(fit.std / stiff.std)
    assert 0.8 < np.sqrt(np.mean(np.square(off))) < 1.25
    assert np.median(tight, axis=0).max() > 1.5


def test_a_tight_loop_takes_one_simulation_more_and_no_step() -> None:
    log = noisy(arm_log(1))
    fit = identify(log, plain_didim())
    assert fit.remarks == ()
    # The start, one for each iteration, one with half the steps in time, and one in a random direction.
    assert fit.n_simulations == fit.n_iterations + 3


@pytest.mark.usefixtures("unjudged")
def test_the_response_predicts_an_iteration(slack: Experiment) -> None:
    """``F(beta) - beta* = J (beta - beta*)`` for a change of the parameters near the fixed point."""
    log = noisy(slack)
    end = iterated(log, plain_didim())
    method = plain_didim()
    job = method.job(log, log.simulation.robot(log.robot))
    problem = Problem(method, job, Reporter())

    def place(change: Array) -> Solved:
        x = end.parameters + job.model.lift(change)
        run = problem.simulate(x)
        assert isinstance(run, Simulated)
        return problem.solve(Iterate(x, run, 0))

    centre = place(np.zeros(len(end.beta)))
    slopes = response(problem, centre, problem.simulated_rows(centre.along.simulated))
    assert slopes is not None
    weights = centre.fit.weights[:, None]
    left, triangle = np.linalg.qr(centre.system.w * weights)
    jacobian = np.eye(len(triangle)) - np.linalg.solve(triangle, left.T @ (slopes * weights))
    std = centre.fit.std
    change = 0.3 * std * np.random.default_rng(3).standard_normal(len(std))
    moved = place(change)
    after = moved.fit.solution - centre.fit.solution
    error = (after - jacobian @ change) / std
    assert np.linalg.norm(after / std) > 0.1
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(after / std)
    ahead = Ahead.of(problem, moved, slopes)
    assert ahead is not None
    assert ahead.rate == pytest.approx(np.abs(np.linalg.eigvals(jacobian)).max(), rel=0.05)
    # The fixed point that the response predicts from there is nearer than the place itself.
    off = job.model.project(ahead.target - end.parameters) / std
    assert np.linalg.norm(off) < 0.3 * np.linalg.norm(change / std)


@pytest.mark.usefixtures("unjudged")
def test_a_place_without_steps_left_says_how_far_it_is(slack: Experiment) -> None:
    log = noisy(slack)
    fit = identify(log, plain_didim(sigma_fraction=0.0, tolerance=0.025))
    same = identify(
        log, plain_didim(sigma_fraction=0.0, tolerance=0.025, max_iterations=fit.n_iterations - 1)
    )
    assert same.converged
    assert distance(same, fit) <= same.history[-1].more["remaining_sigma"]
    assert "with the motion's response" not in same.remarks[0]


def test_a_simulation_that_ends_early_leaves_the_estimate_of_the_steps(
    slack: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = Outcome(didim.loop.SimulationStatus.DIVERGED)
    monkeypatch.setattr(Problem, "simulate_all", lambda self, candidates: [ended] * len(candidates))
    fit = identify(noisy(slack), plain_didim(sigma_fraction=0.0, tolerance=0.025, max_iterations=40))
    assert fit.converged
    assert any("each step is" in remark or "steps do not shrink" in remark for remark in fit.remarks)


@pytest.mark.slow
@pytest.mark.usefixtures("unjudged")
def test_an_arm_at_the_edge_of_the_robots_comes_to_rest_there(digital: Experiment) -> None:
    """Conditions hold directions that the motion follows, and Newton's method knows it.

    Steps that did not know it left 0.39 standard deviations on this log.
    """
    fit = identify(digital, DIDIM())
    assert fit.converged
    assert fit.n_iterations <= 10
    # The start, the iterations, one simulation a parameter once, and one in a random direction.
    assert fit.n_simulations <= 10 + len(fit.beta) + 2
    assert (fit.std > 0.0).all()
    assert fit.history[-1].more["remaining_sigma"] <= 1.5 * NEAR


@pytest.mark.slow
def test_a_reversed_torque_ends_the_run_soon(digital: Experiment) -> None:
    """Each iteration of such a run is farther from the log than the one before; it went on to the limit of iterations."""
    (recording,) = digital.recordings
    assert recording.tau is not None
    reversed_ = replace(recording, tau=recording.tau * np.where(np.arange(7) == 2, -1.0, 1.0))
    fit = identify(replace(digital, recordings=(reversed_,)), DIDIM())
    assert not fit.converged
    assert fit.n_iterations <= 4
    assert fit.n_simulations <= 25
    assert [finding.joints for finding in fit.evidence if finding.code == "torque-sign"] == [(3,)]
    assert any(remark.startswith("gave up after 3 iterations in a row") for remark in fit.remarks)


@pytest.mark.usefixtures("unjudged")
@pytest.mark.parametrize("physical", [True, False])
def test_a_run_at_rest_has_converged_though_no_step_comes_nearer(
    slack: Experiment, physical: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Attempts at the fixed point are few, and a run that rests by its rule ends there, with standard deviations."""
    attempts = []

    def never(problem: Problem, *rest: Any) -> tuple[None, float]:
        attempts.append(problem)
        return None, 0.0

    monkeypatch.setattr("didim.methods.didim.slack._newton", never)
    monkeypatch.setattr("didim.methods.didim.slack.NEAR", 0.0)
    log = noisy(slack)
    fit = identify(log, DIDIM(physical=physical, sigma_fraction=0.0, tolerance=0.025))
    assert fit.converged
    assert len(attempts) == (2 if physical else 1)
    before = len(attempts)
    assert (fit.std > 0.0).all()
    assert any("slow contraction" in remark for remark in fit.remarks)
    at_rest = identify(log, DIDIM(physical=physical, sigma_fraction=0.5))
    assert at_rest.converged
    assert len(attempts) == before + 1
    assert any("no step came nearer" in remark for remark in at_rest.remarks)
