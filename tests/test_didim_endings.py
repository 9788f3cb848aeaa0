"""Endings of DIDIM: the rule that fired, slow contraction, the best iterate without sigmas, starts whose joints stick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from arm import arm_log, noisy
from didim import CLOE, IDIMLS, Experiment, Identification, Status, identify
from didim.errors import RankError
from didim.experiment.specs import Measurement, SimulationSettings
from didim.loop.closed_loop import ClosedLoop
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.methods.didim.convergence import contraction_of, rule_sentence
from didim.methods.didim.problem import Iterate, Solved
from didim.methods.didim.steps import SecantSteps
from didim.studies.comparison import text_of
from didim.studies.simulated_log import measured, packaged_experiment
from plain import plain_didim, stub
from scripts import script

Array = NDArray[np.float64]

SLIDE = """\
schema = 1
name = "slide"
description = "one prismatic joint"
gravity_m_s2 = [0.0, 0.0, 0.0]
[[joint]]
kind = "prismatic"
alpha_deg = 0.0
d_m = 0.0
theta_deg = 0.0
r_m = 0.0
limits = { position_m = [-2.0, 2.0], velocity_m_s = 3.0, force_n = 500.0 }
[friction]
coulomb = "tanh"
smoothing_m_s = 0.004
[parameters.reference]
Ia1 = 2.0
Fv1 = 5.0
Fc1 = 3.0
Off1 = 0.5
"""


@pytest.fixture(scope="module")
def arm() -> Experiment:
    return noisy(arm_log(1))


@pytest.fixture(scope="module")
def slack() -> Experiment:
    """The same robot in a loop of 2 Hz: the iteration contracts slowly."""
    return noisy(arm_log(1, natural_frequency_hz=2.0))


# The rule that fired.


@pytest.mark.parametrize(
    ("moved", "change", "told"),
    [
        (0.1, 1e-4, "Stopped by both rules: the last step changed no parameter by more than 0.1 sigma (limit 0.3), and "),
        (0.1, 0.02, "Stopped by the rule on the parameters: the last step changed no parameter by more than 0.1 sigma"),
        (2.6, 1e-4, "Stopped by the rule on the residual: the residual changed by 0.01 % (limit 0.1 %), but the last step "),
    ],
)  # fmt: skip
def test_the_rule_that_fired_is_named(moved: float, change: float, told: str) -> None:
    sentence = rule_sentence(moved, 0.3, change, 1e-3, exact=False)
    assert sentence.startswith(told)
    if moved > 0.3:
        assert sentence.endswith("changed a parameter by 2.6 sigma.")


def test_a_result_tells_its_rule_and_keeps_it(arm: Experiment, tmp_path: Path) -> None:
    fit = identify(arm, plain_didim())
    assert fit.converged
    last = fit.history[-1].more
    by_parameters, by_residual = (
        last["largest_change_in_sigma"] <= 0.3,
        last["residual_change"] <= 1e-3,
    )
    assert by_parameters or by_residual
    assert ("both rules" in fit.ending) == (by_parameters and by_residual)
    assert ("on the residual" in fit.ending) == (by_residual and not by_parameters)
    assert f"Converged: the stopping rule of the method is met. {fit.ending}\n" in str(fit)
    fit.save(tmp_path / "fit.json")
    assert Identification.load(tmp_path / "fit.json").ending == fit.ending
    by_residual_alone = identify(arm, plain_didim(sigma_fraction=0.0, tolerance=0.025))
    assert by_residual_alone.ending.startswith("Stopped by the rule on the residual: ")


# Contraction.


@pytest.mark.parametrize("rates", [(0.3, 0.1), (0.8, 0.5), (0.95, 0.4), (0.9, -0.6)])
def test_the_remaining_distance_bounds_that_of_a_linear_iteration(rates: tuple[float, float]) -> None:
    """x - x* is a sum of two modes with known rates: the distance left is known."""
    rng = np.random.default_rng(1)
    modes = rng.standard_normal((2, 12)) * [[1.0], [3.0]]
    distance = [sum(rate**k * mode for rate, mode in zip(rates, modes, strict=True)) for k in range(14)]
    steps = [after - before for before, after in pairwise(distance)]
    for count in range(5, 13):
        found = contraction_of(steps[max(0, count - 8) : count])
        left = np.asarray(distance[count])
        assert np.sqrt(np.mean(left**2)) <= found.remaining_rms * (1.0 + 1e-9)
        assert np.abs(left).max() <= found.remaining_largest * (1.0 + 1e-9)
        assert found.remaining_rms < 8.0 * np.sqrt(np.mean(left**2))
    assert contraction_of(steps).rate == pytest.approx(max(map(abs, rates)), abs=0.02)
    growing = contraction_of([np.ones(3), 2.0 * np.ones(3)])
    assert growing.remaining_largest == np.inf


def test_a_stiff_loop_says_nothing_of_contraction(arm: Experiment) -> None:
    fit = identify(arm, plain_didim())
    assert fit.remarks == ()
    assert fit.history[-1].more["remaining_sigma"] < 0.3


# Without convergence: the best iterate, no standard deviations.


def test_a_run_that_fails_returns_its_best_iterate_without_sigmas(arm: Experiment, tmp_path: Path) -> None:
    (recording,) = arm.recordings
    assert recording.tau is not None
    turned = replace(arm, recordings=(replace(recording, tau=-recording.tau),))
    found = identify(turned, plain_didim())
    assert not found.converged
    errors = [found.history[0].more["output_error_before"]]
    errors += [item.more["output_error_after"] for item in found.history]
    assert found.output_error is not None
    assert found.output_error[1] == np.nanmin(errors)
    assert not found.std.any()
    text = str(found)
    assert "not well identified" not in text
    assert "The result is the best of the start and " in text
    assert "it has no standard deviations.\n" in text
    assert text.splitlines()[-1].startswith("Verdict: wrong")
    found.save(tmp_path / "fit.json")
    assert not Identification.load(tmp_path / "fit.json").std.any()


def test_iterations_used_up_leave_no_sigmas(arm: Experiment) -> None:
    two = identify(arm, plain_didim(max_iterations=2))
    assert two.status is Status.NOT_CONVERGED
    assert not two.covariance.any()
    assert "iteration 2, with simulated torques off by" in two.ending


# Starts.


@pytest.fixture(scope="module")
def creeping(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    """A slide that swings about a ramp, in both directions; a heavily damped start only creeps forwards."""
    path = tmp_path_factory.mktemp("slide") / "slide.toml"
    path.write_text(SLIDE, encoding="utf-8")
    robot = didim.load_robot(path)
    t = np.arange(0.0, 4.001, 0.002)[:, None]
    experiment = Experiment(
        name="slide",
        robot=robot,
        recordings=(),
        reference=Reference.sampled(0.2 * t + 0.04 * np.sin(3.0 * np.pi * t), rate_hz=500.0),
        controller=Controller.tuned([3.0], [0.7], [2.0]),
        signal=didim.SignalProcessing(cutoff_hz=50.0, trim_start=300, trim_end=25, decimation=(10,)),
        simulation=SimulationSettings(rate_hz=500.0, step_s=5e-4),
    )
    log = didim.simulated_log(experiment, robot.parameter_set("reference"), noise=False, refinement=1)
    (recording,) = log.recordings
    assert recording.tau is not None
    noise = 0.2 * np.random.default_rng(0).standard_normal(recording.tau.shape)
    return replace(log, recordings=(replace(recording, tau=recording.tau + noise),))


def test_a_start_whose_joint_moves_one_way_only_does_not_blame_the_log(creeping: Experiment) -> None:
    start = creeping.robot.parameters_by_name({"Ia1": 2.0, "Fc1": 1.0, "Fv1": 400.0})
    fit = identify(creeping, plain_didim(start=start, gain_updating="never"))
    assert fit.converged
    other = identify(creeping, plain_didim(start="idim-ls"))
    assert np.max(np.abs(fit.beta - other.beta) / other.std) < 0.3
    assert fit.remarks[0].startswith(
        "the motion simulated with the start does not identify 'Off1': a simulated joint "
    )


def test_a_log_that_does_not_identify_a_parameter_is_still_refused(creeping: Experiment) -> None:
    """The same motion, but the log itself is the creeping one."""
    start = creeping.robot.parameters_by_name({"Ia1": 2.0, "Fc1": 1.0, "Fv1": 400.0})
    poor = didim.simulated_log(replace(creeping, recordings=()), start, noise=False, refinement=1)
    with pytest.raises(RankError, match="the log does not separate 1 of 4 parameters"):
        identify(poor, plain_didim(start=start, gain_updating="never"))


# Counts, settings, callbacks.


def test_every_simulation_is_counted(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    run = ClosedLoop.run

    def counting(self: ClosedLoop, *arguments: Any, **options: Any) -> Any:
        runs.append(1)
        return run(self, *arguments, **options)

    monkeypatch.setattr(ClosedLoop, "run", counting)
    every: list[dict[str, Any]] = [{}, {"max_iterations": 1}, {"stop": False, "max_iterations": 6}]
    for settings in every:
        runs.clear()
        fit = identify(arm, plain_didim(**settings))
        assert fit.n_simulations == len(runs)


def test_idim_ls_within_didim_has_all_its_settings(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    run = IDIMLS.run

    def noting(self: IDIMLS, *arguments: Any) -> Any:
        asked.append(self)
        return run(self, *arguments)

    monkeypatch.setattr(IDIMLS, "run", noting)
    settings: dict[str, Any] = {
        "weights": "per-joint",
        "reweightings": 3,
        "variance": "r-1",
        "uncertainty": "decimated",
        "blocks": 10,
    }
    identify(arm, plain_didim(start="idim-ls", **settings))
    (method,) = asked
    assert {key: getattr(method, key) for key in settings} == settings


@pytest.mark.slow
def test_the_callback_hears_each_iteration_once_though_steps_in_time_get_smaller(project: Path) -> None:
    """A start too stiff for the steps of the experiment, in the middle of the run."""
    experiment = packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    log = measured(didim.simulated_log(experiment, x, noise=False, refinement=1))
    start = script(project / "benches" / "calibration.py").random_starts(log, "didim", 4, seed=0)[3]
    heard: list[int] = []
    fit = identify(
        log, plain_didim(start=start), callback=lambda iteration: heard.append(iteration.iteration)
    )
    assert fit.remarks[0].startswith("from this start the simulation fails with the steps of the experiment")
    assert heard == list(range(1, fit.n_iterations + 1))


def test_compare_shows_remarks_and_one_kind_of_torque_errors(slack: Experiment) -> None:
    (recording,) = slack.recordings
    assert recording.q_ref is not None
    reference = Reference.sampled(recording.q_ref, rate_hz=recording.rate_hz)
    comparison = didim.compare(
        replace(slack, reference=reference, recordings=(), measurement=Measurement(torque_noise=(0.2, 0.1))),
        parameters="reference",
        methods=[
            IDIMLS(),
            plain_didim(sigma_fraction=0.0, tolerance=0.025),
            CLOE(start="reference", max_iterations=2),
        ],
    )
    text = text_of(comparison, every=True)
    assert any(remark.startswith("slow contraction") for remark in comparison.fits["didim"].remarks)
    for fit in comparison.fits.values():
        for remark in fit.remarks:
            assert remark in text
    # The errors of IDIM-LS and DIDIM are of filtered torques, those of CLOE are not: beside each other stand errors of one kind.
    assert set(comparison.torque_errors) == {"truth", "start", "idim-ls", "didim", "cloe-levenberg-marquardt"}
    truth = comparison.torque_errors["truth"]
    for name, errors in comparison.torque_errors.items():
        assert np.all(errors > 0.9 * truth), name
        shown = "".join(f"{100.0 * error:9.3f}" for error in errors)
        assert shown in text or name == "start"
    assert comparison.to_dict()["torque_errors"]["didim"] == comparison.torque_errors["didim"].tolist()


def test_remarks_of_the_measured_motion_are_not_taken_for_torque_signs() -> None:
    """A short log makes IDIM-LS remark on its blocks; DIDIM that does not converge must not call that a wrong sign."""
    log = arm_log(1)
    log = replace(log, signal=replace(log.signal, decimation=(10, 5)))
    assert identify(log, IDIMLS()).remarks
    fit = identify(log, plain_didim(max_iterations=1))
    assert not fit.converged
    assert "torque-sign" not in {reason.code for reason in fit.verdict.reasons}


def test_what_is_left_of_a_contraction_is_half_more_than_its_geometric_series() -> None:
    """Steps of 2 and 1 leave 0.5 + 0.25 + ... = 1 if the rate stays; it may still rise."""
    left = contraction_of([np.array([2.0, 1.0]), np.array([1.0, 0.5])])
    assert left.rate == pytest.approx(0.5)
    assert left.remaining_largest == pytest.approx(1.5)
    assert left.remaining_rms == pytest.approx(1.5 * np.sqrt(0.625))


def test_a_secant_step_is_not_shorter_than_three_tenths() -> None:
    damped = object.__new__(SecantSteps)
    damped._before, damped._length = np.array([1.0]), 1.0
    for ahead, length in ((-9.0, 0.3), (-1.5, 0.4), (0.5, 1.0)):
        assert damped._secant(np.array([ahead]), np.eye(1)) == pytest.approx(length)


def secant(cost: Callable[[Array], float]) -> SecantSteps:
    """Steps of one parameter, of one standard deviation each, at whose end the simulation has a cost."""
    return SecantSteps(
        stub(
            job=stub(estimated=lambda step: step),
            changes_in_sigma=lambda solved: np.ones(1),
            method=stub(sigma_fraction=0.1),
            windows=[stub(tau=np.ones(1))],
            choose_steps=lambda x: None,
            shares=lambda lengths: float(lengths[0]),
            simulate=lambda x, *more: stub(x=x, errors=np.array([cost(x)])),
            reporter=None,
        )
    )


def step_of(steps: SecantSteps, x: float, target: float, iteration: int, error: float = 1.0) -> Any:
    """Take the step from a place to its solution, both of one parameter; the error is that at the place."""
    run = stub(errors=np.array([error]), scale=None)
    along = Iterate(np.array([x]), run, iteration)
    fit = stub(covariance=np.eye(1), weights=np.ones(1))
    system = stub(joints=[slice(0, 1)])
    return steps.step(Solved(along, system, fit, np.array([target]), np.ones(1)))


def test_the_third_step_of_a_two_cycle_is_halved() -> None:
    """Each full step lands where the one before began: the secant step goes to the middle, from the third on."""
    steps = secant(lambda x: 1.0)
    cycle = [(0.0, 1.0), (1.0, 0.0), (0.0, 1.0)]
    assert [step_of(steps, x, target, k).length for k, (x, target) in enumerate(cycle)] == [1.0, 1.0, 0.5]


@pytest.mark.parametrize(("rise", "length"), [(1.015, 1.0), (1.025, 0.5)])
def test_a_secant_step_may_raise_the_cost_by_two_percent(rise: float, length: float) -> None:
    """The cost is 1 at the iterate and after half of the step, and `rise` after all of it."""
    step = step_of(secant(lambda x: rise if x[0] == 1.0 else 1.0), 0.0, 1.0, 0)
    assert step.length == length
    assert step.after.x == pytest.approx([length])
