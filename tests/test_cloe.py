"""CLOE: Levenberg and Marquardt arrive, the simplex walks, and what cannot be simulated stops neither."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import didim
from didim.errors import FitError
from didim.experiment.experiment import Experiment
from didim.experiment.specs import Measurement, SimulationSettings
from didim.methods.cloe import nelder_mead
from didim.methods.cloe.output_error import OutputError
from didim.methods.method import FitSettings
from didim.result.identification import Identification
from didim.result.iteration import Iteration, Reporter, Status
from didim.signal.noise import white_noise
from didim.signal.window import DelaySettings
from didim.studies.compare import position_norms
from didim.studies.simulated_log import measured, packaged_experiment, simulated_log
from pickling_executor import Pickling

pytestmark = pytest.mark.usefixtures("without_verdict")


@pytest.fixture(scope="module")
def tx40() -> Experiment:
    experiment = packaged_experiment("tx40")
    return simulated_log(experiment, experiment.robot.parameter_set("didim"))


@pytest.fixture(scope="module")
def truth(tx40: Experiment) -> np.ndarray:
    return tx40.robot.base_parameters.project(tx40.robot.parameter_set("didim"))


@pytest.fixture(scope="module")
def arrived(tx40: Experiment) -> Identification:
    return didim.identify(tx40, didim.CLOE())


def test_levenberg_marquardt_arrives_from_21(
    tx40: Experiment, truth: np.ndarray, arrived: Identification
) -> None:
    assert arrived.status is Status.CONVERGED
    assert arrived.method == "cloe-levenberg-marquardt"
    well = arrived.relative_std_percent < 20.0
    for std, most in ((arrived.std_white, 3.5), (arrived.std, 5.5)):  # Student's distribution has wider tails
        off = (arrived.beta - truth) / std
        assert np.abs(off[well]).max() < most
        assert 0.7 < np.sqrt(np.mean(off**2)) < 1.4
    # No higher than at the truth: the norm (19) there is that of the encoder noise.
    at_truth = position_norms(tx40, {"truth": tx40.robot.parameter_set("didim")})["truth"]
    assert arrived.settings["cloe"]["position_error_norm"] <= at_truth * (1.0 + 1e-4)
    assert arrived.history[-1].more["cost_per_row"] == pytest.approx(1.0, abs=0.03)
    correlation = arrived.covariance / np.outer(arrived.std, arrived.std)
    assert np.abs(correlation).max() <= 1.0 + 1e-9


def test_the_noise_of_the_encoders_is_seen(tx40: Experiment) -> None:
    noise = white_noise(tx40.recordings[0].q)
    np.testing.assert_allclose(noise, [1e-6, 1e-6, 2e-6, 2e-6, 2e-6, 3e-6], rtol=0.06)


def test_the_simplex_goes_down_and_counts() -> None:
    arm = short_arm()
    told: list[Iteration] = []

    def callback(iteration: Iteration) -> bool:
        told.append(iteration)
        return False

    start = 0.8 * arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    fit = didim.identify(
        arm, didim.CLOE(optimizer="nelder-mead", start=start, max_iterations=25), callback=callback
    )
    assert fit.status is Status.NOT_CONVERGED
    record = fit.settings["cloe"]
    assert record["final_norm"] < record["initial_norm"]
    assert record["iterations"] == 25
    assert record["evaluations"] <= fit.n_simulations
    assert not fit.std.any()
    assert told
    assert "no standard deviations" in fit.remarks[0]


@pytest.mark.slow
def test_emps_by_both_optimisers(project: Path, shared: Path) -> None:
    experiment = didim.load_experiment(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    # A third of the motion, which all parameters show: what is compared is where searches end.
    (recording,) = experiment.recordings
    experiment = replace(experiment, recordings=(replace(recording, windows=((0, 8000),)),))
    fits = [didim.identify(experiment, didim.CLOE(start=start)) for start in ("idim-ls", {"M1R": 80.0})]
    for fit in fits:
        assert fit.converged
        np.testing.assert_allclose(fit.beta, fits[0].beta, rtol=1e-5)
        assert (fit.std > 0.0).all()
    # From the far start; the near one is that of the other searches of this file.
    method = didim.CLOE(optimizer="nelder-mead", start={"M1R": 80.0}, variant="scaled")
    simplex = didim.identify(experiment, method)
    np.testing.assert_allclose(simplex.beta, fits[0].beta, rtol=1e-3)
    assert simplex.settings["cloe"]["evaluations"] <= (200 + 2) * simplex.beta.size
    published = position_norms(experiment, {"published": experiment.robot.parameter_set("published")})
    assert fits[0].settings["cloe"]["position_error_norm"] <= published["published"]
    torque = didim.identify(experiment, didim.CLOE(output="torque", start="idim-ls"))
    assert torque.method == "clie-levenberg-marquardt"
    np.testing.assert_allclose(torque.beta, fits[0].beta, rtol=0.02)


def short_arm(steps_s: tuple[float, float] | None = (1e-3, 5e-4)) -> Experiment:
    """A planar arm for a second: quick, and with friction everywhere. None for the steps of the package."""
    step_s, fine_step_s = steps_s or (None, None)
    robot = didim.load_robot("planar2").with_friction(coulomb="tanh", smoothing_rad_s=0.05)
    reference = didim.Reference.random_fourier(
        harmonics=6,
        period_s=1.0,
        max_position=[1.0, 1.0],
        max_velocity=[4.0, 4.0],
        max_acceleration=[60.0, 60.0],
        seed=2,
    )
    controller = didim.Controller.tuned([15.0, 15.0], 0.7, [1.0, 0.3])
    experiment = Experiment(
        name="arm",
        robot=robot,
        recordings=(),
        reference=reference,
        controller=controller,
        simulation=SimulationSettings(step_s=step_s, fine_step_s=fine_step_s),
    )
    return simulated_log(experiment, robot.parameter_set("reference"))


@pytest.mark.parametrize("output", ["position", "torque", "both"])
def test_every_output_finds_the_truth_without_noise(output: str) -> None:
    arm = short_arm()
    truth = arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    start = truth * np.linspace(0.7, 1.4, truth.size)
    fit = didim.identify(arm, didim.CLOE(output=output, start=start))  # type: ignore[arg-type]
    np.testing.assert_allclose(fit.beta, truth, rtol=1e-3, atol=1e-3 * np.abs(truth).max())


@pytest.mark.parametrize("physical", [False, True])
def test_steps_of_the_search_do_not_bias_the_estimate(physical: bool) -> None:
    """The error of a coarse integration repeats with the motion: it must not enter the estimate as noise does."""
    arm = replace(short_arm(None), measurement=Measurement(position_noise=(1e-7, 1e-7)))
    log = measured(arm, seed=3)
    coarse = replace(log, simulation=replace(log.simulation, step_s=1e-3, fine_step_s=(1e-3, 1e-3)))
    method = didim.CLOE(start="reference", physical=physical)
    fine_fit, coarse_fit = didim.identify(log, method), didim.identify(coarse, method)
    assert fine_fit.settings["cloe"]["moved_by_finer_steps"] < 0.5
    assert coarse_fit.settings["cloe"]["moved_by_finer_steps"] > 2.0
    moved = (coarse_fit.beta - fine_fit.beta) / fine_fit.std_white
    assert np.abs(moved).max() < 0.3


def test_a_start_that_cannot_be_simulated_is_named() -> None:
    arm = short_arm()
    wrong = -arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    for optimizer in ("levenberg-marquardt", "nelder-mead"):
        with pytest.raises(
            FitError,
            match=r"^arm: CLOE cannot start from these parameters: .* inertia at joint 1 is not positive",
        ):
            didim.identify(arm, didim.CLOE(optimizer=optimizer, start=wrong))


def test_stopping_keeps_the_best_point() -> None:
    arm = short_arm()
    truth = arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    start = truth * np.linspace(0.7, 1.4, truth.size)
    fit = didim.identify(arm, didim.CLOE(start=start), callback=lambda iteration: True)
    assert fit.status is Status.STOPPED
    assert fit.n_iterations == 1
    assert fit.history[0].relative_error < 0.5
    assert not np.array_equal(fit.beta, start)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: didim.CLOE(optimizer="magic"),  # type: ignore[arg-type]
            "optimizer must be 'levenberg-marquardt' or 'nelder-mead', got 'magic'",
        ),
        (lambda: didim.CLOE(output="speed"), "output must be 'position', 'torque' or 'both', got 'speed'"),  # type: ignore[arg-type]
        (lambda: didim.CLOE(max_iterations=0), "max_iterations must be a whole number"),
        (lambda: didim.CLOE(tolerance=2.0), "tolerance must be between 0 and 1, got 2.0"),
        (lambda: didim.CLOE(tolerance="a"), "tolerance must be between 0 and 1, got 'a'"),  # type: ignore[arg-type]
        (lambda: didim.CLOE(noise=["a", "b"]), "noise must be an array of real numbers"),  # type: ignore[list-item]
        (lambda: didim.CLOE(noise=[1.0, -1.0]), "noise needs positive numbers"),
        (lambda: didim.CLOE(checkpoint="nowhere/search.npz"), "there is no folder 'nowhere'"),
        (lambda: didim.CLOE(starts=2, checkpoint="search.npz"), "starts must be 1 with it"),
        (lambda: didim.CLOE(starts=0), "starts must be a whole number of at least 1, got 0"),
        (lambda: didim.CLOE(seed=-1), "seed must be a whole number of at least 0, got -1"),
        (lambda: didim.CLOE(threads=2**70), "threads must be a whole number from 1 to 4096, got 118"),
        (lambda: didim.CLOE(threads=1.5), "threads must be a whole number from 1 to 4096, got 1.5"),  # type: ignore[arg-type]
        (lambda: didim.CLOE(starts=2, checkpoint="a.npz"), "a checkpoint belongs to one search"),
    ],
)
def test_wrong_settings(make: Callable[[], object], message: str) -> None:
    with pytest.raises(FitError, match=message):
        make()


def off(arm: Experiment, factors: tuple[float, float] = (0.7, 1.4)) -> np.ndarray:
    truth = arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    return np.asarray(truth * np.linspace(*factors, truth.size))


@pytest.mark.slow
def test_the_adapted_simplex_ends_near_the_optimum_and_the_literal_one_does_not() -> None:
    arm = short_arm()
    start = {name: 0.5 for name in arm.robot.base_parameters.names if name.startswith(("Ia", "ZZ"))}
    ends = {}
    for variant in ("adaptive", "literal"):
        # Within a quarter of the evaluations that a search has by default.
        method = didim.CLOE(optimizer="nelder-mead", start=start, variant=variant, max_evaluations=700)
        fit = didim.identify(arm, method)
        record = fit.settings["cloe"]
        ends[variant] = record["final_norm"] / record["initial_norm"]
        assert record["evaluations"] <= 700 + 2 * fit.beta.size
    # The edges of the adaptive variant with the coefficients of the literal one: it descends within the evaluations given.
    method = didim.CLOE(optimizer="nelder-mead", start=start, variant="scaled", max_evaluations=300)
    record = didim.identify(arm, method).settings["cloe"]
    assert record["evaluations"] <= 300 + 2 * fit.beta.size
    assert record["final_norm"] < 0.9 * record["initial_norm"]
    assert ends["adaptive"] < 0.05
    assert ends["adaptive"] < ends["literal"]


def test_a_simplex_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    arm = short_arm()

    def search(iterations: int, checkpoint: Path | None) -> Identification:
        method = didim.CLOE(
            optimizer="nelder-mead", start=off(arm), max_iterations=iterations, checkpoint=checkpoint
        )
        return didim.identify(arm, method)

    file = tmp_path / "search.npz"
    whole = search(120, None)
    assert [entry.iteration for entry in whole.history] == [100, 119, 120]
    part = search(50, file)
    assert part.settings["cloe"]["iterations"] == 50
    again = search(120, file)
    np.testing.assert_array_equal(again.beta, whole.beta)
    assert again.settings["cloe"]["evaluations"] == whole.settings["cloe"]["evaluations"]
    assert [entry.iteration for entry in again.history] == sorted(
        {entry.iteration for entry in again.history}
    )
    with pytest.raises(FitError, match=r"search\.npz: this checkpoint belongs to another search"):
        didim.identify(arm, didim.CLOE(optimizer="nelder-mead", start=2.0 * off(arm), checkpoint=file))
    with np.load(file) as content:
        arrays = dict(content)
    np.savez(file, **{**arrays, "array_values": arrays["array_values"] + 1e-9})
    with pytest.raises(FitError, match=r"search\.npz: this checkpoint is damaged"):
        search(120, file)
    np.savez(file, **{**arrays, "record": np.array(str(arrays["record"]).replace("50", "51"))})
    with pytest.raises(FitError, match=r"search\.npz: this checkpoint is damaged"):
        search(120, file)
    file.write_bytes(b"no checkpoint")
    with pytest.raises(FitError, match=r"search\.npz: this is not a checkpoint of a search"):
        search(120, file)


def test_levenberg_marquardt_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    arm = short_arm()
    file = tmp_path / "search.npz"
    whole = didim.identify(arm, didim.CLOE(start=off(arm)))
    method = didim.CLOE(start=off(arm), checkpoint=file)
    part = didim.identify(arm, method, callback=lambda iteration: True)
    assert part.n_iterations == 1 < whole.n_iterations
    again = didim.identify(arm, method)
    np.testing.assert_array_equal(again.beta, whole.beta)
    assert again.n_iterations == whole.n_iterations
    assert again.history[0].relative_error == whole.history[0].relative_error


def test_a_checkpoint_knows_its_problem(tmp_path: Path) -> None:
    arm = short_arm()
    file = tmp_path / "search.npz"
    method = didim.CLOE(start=off(arm), checkpoint=file)
    fit = didim.identify(arm, method)
    assert fit.converged
    # A search that has ended is not searched on.
    again = didim.identify(arm, method)
    assert again.n_iterations == fit.n_iterations
    np.testing.assert_array_equal(again.beta, fit.beta)
    assert isinstance(arm.controller, didim.Controller)
    others = [
        replace(arm, simulation=replace(arm.simulation, smoothing=(0.2, 0.2))),
        replace(arm, simulation=replace(arm.simulation, step_s=2e-4)),
        replace(arm, controller=replace(arm.controller, saturation=np.array([9.0, 9.0]))),
        replace(arm, fixed={"Fv1": 1.0}),
    ]
    for other in others:
        with pytest.raises(FitError, match="belongs to another search"):
            didim.identify(other, method)


def test_ctrl_c_during_a_restart_keeps_point_and_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = short_arm()
    file = tmp_path / "search.npz"
    made: list[int] = []
    begin = nelder_mead.started

    def second_is_interrupted(
        batch: Callable[[np.ndarray], np.ndarray], points: np.ndarray
    ) -> nelder_mead.Simplex:
        made.append(len(points))
        if len(made) == 2:
            raise KeyboardInterrupt
        return begin(batch, points)

    method = didim.CLOE(optimizer="nelder-mead", start=off(arm), checkpoint=file)
    monkeypatch.setattr("didim.methods.cloe.simplex.started", second_is_interrupted)
    fit = didim.identify(arm, method)
    assert len(made) == 2
    assert fit.status is Status.INTERRUPTED
    assert fit.settings["cloe"]["position_error_norm"] == pytest.approx(fit.settings["cloe"]["final_norm"])
    monkeypatch.undo()
    went_on = didim.identify(arm, replace(method, max_evaluations=fit.settings["cloe"]["evaluations"] + 1))
    assert went_on.settings["cloe"]["final_norm"] <= fit.settings["cloe"]["final_norm"]


def test_ctrl_c_between_starts_keeps_the_first_result(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = short_arm()

    def interrupted(*arguments: object) -> list[np.ndarray]:
        raise KeyboardInterrupt

    monkeypatch.setattr("didim.methods.cloe.cloe._further_starts", interrupted)
    fit = didim.identify(arm, didim.CLOE(start=off(arm), starts=3))
    assert fit.status is Status.INTERRUPTED
    assert fit.history[-1].relative_error < 0.01


def test_torques_with_a_delay_are_refused() -> None:
    arm = replace(short_arm(), delay=DelaySettings(compensate_samples=3))
    with pytest.raises(FitError, match="takes no delay of the torque back, and compensate_samples is 3"):
        didim.identify(arm, didim.CLOE(output="torque", start=off(arm)))


@pytest.mark.parametrize("optimizer", ["levenberg-marquardt", "nelder-mead"])
def test_ctrl_c_keeps_the_best_point(optimizer: str) -> None:
    arm = short_arm()

    def interrupt(iteration: Iteration) -> bool:
        raise KeyboardInterrupt

    fit = didim.identify(arm, didim.CLOE(optimizer=optimizer, start=off(arm)), callback=interrupt)  # type: ignore[arg-type]
    assert fit.status is Status.INTERRUPTED
    assert len(fit.history) == 1
    assert 0.0 < fit.history[0].relative_error < 1.0
    at_start = didim.identify(arm, didim.CLOE(start=off(arm)), callback=lambda iteration: True).settings[
        "cloe"
    ]["initial_cost"]
    assert at_start > 0.0
    assert not np.array_equal(fit.beta, off(arm))


def test_an_executor_runs_the_further_starts() -> None:
    arm = short_arm()
    with Pickling(2) as executor:
        fit = didim.identify(arm, didim.CLOE(start=off(arm), starts=3, seed=1, executor=executor))
    assert executor.calls == 2
    alone = didim.identify(arm, didim.CLOE(start=off(arm), starts=3, seed=1))
    assert fit.settings["starts"] == alone.settings["starts"]
    np.testing.assert_array_equal(fit.beta, alone.beta)
    with pytest.raises(FitError, match=r"executor must be one of concurrent\.futures, got 'process'"):
        didim.CLOE(executor="process")  # type: ignore[arg-type]


def test_several_starts_are_counted() -> None:
    arm = short_arm()
    fit = didim.identify(arm, didim.CLOE(start=off(arm), starts=3, seed=1))
    assert fit.converged
    assert "3 of 3 starts reached the best optimum" in fit.remarks
    record = fit.settings["starts"]
    assert len(record) == 3
    one = didim.identify(arm, didim.CLOE(start=off(arm)))
    assert fit.n_simulations > 2 * one.n_simulations
    np.testing.assert_allclose(record[2]["beta"], record[0]["beta"], rtol=1e-3, atol=1e-3)
    stopped = didim.identify(arm, didim.CLOE(start=off(arm), starts=3), callback=lambda iteration: True)
    assert stopped.status is Status.STOPPED
    assert "starts" not in stopped.settings


def test_candidates_that_no_robot_has_cost_infinitely_much() -> None:
    arm = short_arm()
    job = FitSettings().job(arm, arm.simulation.robot(arm.robot))
    problem = OutputError(didim.CLOE(start=off(arm)), job, Reporter())
    points = np.stack([problem.start] * 4)
    points[1] *= -1.0  # M(q) indefinite
    points[2, 0] = np.nan
    points[3, list(arm.robot.base_parameters.names).index("Fv1")] = -1e6  # diverges
    costs = problem.costs(points)
    assert np.isfinite(costs[0])
    assert np.isposinf(costs[1:]).all()


def test_the_damping_is_raised_until_a_step_goes_down(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = short_arm()
    start = off(arm)
    tried: list[np.ndarray] = []
    known = OutputError.costs

    def costs(problem: OutputError, points: np.ndarray) -> np.ndarray:
        tried.append(points - problem.start)
        return np.full(len(points), np.inf) if len(tried) < 3 else known(problem, points)

    monkeypatch.setattr(OutputError, "costs", costs)
    found = didim.identify(arm, didim.CLOE(start=start, optimizer="levenberg-marquardt", max_iterations=1))
    assert len(tried) == 3
    shortest = [np.linalg.norm(steps, axis=1).min() for steps in tried]
    assert shortest[0] > 100.0 * shortest[1]
    assert shortest[1] > 100.0 * shortest[2]
    assert found.history[0].relative_error < 1.0


def test_a_derivative_at_the_edge_is_taken_on_the_other_side(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = short_arm()
    job = FitSettings().job(arm, arm.simulation.robot(arm.robot))
    problem = OutputError(didim.CLOE(start=off(arm)), job, Reporter())
    (errors,), _ = problem.errors(problem.start[None])
    (inner,) = (part.slopes for part in problem.derivatives(problem.start, errors).parts)
    known, calls = OutputError.errors, list[int]()

    def at_the_edge(problem: OutputError, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, completed = known(problem, points)
        calls.append(len(points))
        if len(calls) == 1:
            found[2], completed[2] = np.nan, False
        return found, completed

    monkeypatch.setattr(OutputError, "errors", at_the_edge)
    (edge,) = (part.slopes for part in problem.derivatives(problem.start, errors).parts)
    assert calls == [len(inner), 1]
    np.testing.assert_array_equal(np.delete(edge, 2, axis=0), np.delete(inner, 2, axis=0))
    assert np.linalg.norm(edge[2] - inner[2]) < 1e-2 * np.linalg.norm(inner[2])


def test_sigma_of_errors_that_are_no_noise(project: Path, shared: Path) -> None:
    """On the EMPS the position errors are model error, correlated over seconds: white noise would give tiny sigmas."""
    experiment = didim.load_experiment(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    fit = didim.identify(experiment, didim.CLOE(start="idim-ls"))
    assert any("joint 1 are correlated in time" in remark for remark in fit.remarks)
    idim = didim.identify(experiment, didim.IDIMLS())
    assert np.all(np.abs(fit.beta - idim.beta) < 4.0 * np.hypot(fit.std, idim.std))
    assert fit.std[0] > 0.1


def test_the_simplex_on_lanes_is_scipys_on_single_simulations() -> None:
    arm = short_arm()
    job = FitSettings().job(arm, arm.simulation.robot(arm.robot))
    problem = OutputError(didim.CLOE(start=off(arm)), job, Reporter())

    def batch(points: np.ndarray) -> np.ndarray:
        return np.sqrt(problem.costs(points))

    first = nelder_mead.started(batch, nelder_mead.literal_simplex(problem.start))
    found, _ = nelder_mead.minimise(batch, first, max_iterations=40, max_evaluations=10_000)
    scipys_minimize: Any = minimize
    expected = scipys_minimize(
        lambda x: float(batch(x[None])[0]),
        problem.start,
        method="Nelder-Mead",
        options={"xatol": 1e-4, "fatol": 1e-4, "maxiter": 40, "maxfev": 10_000},
    )
    np.testing.assert_allclose(found.points[0], expected.x, rtol=1e-11)
    assert found.values[0] == pytest.approx(expected.fun, rel=1e-11)
    assert (found.iterations, found.evaluations) == (expected.nit, expected.nfev)


def test_logs_that_nothing_can_be_weighed_by_are_told() -> None:
    """Torques whose squares leave floating point, and too few samples for the noise."""
    arm = short_arm()
    (recording,) = arm.recordings
    assert recording.tau is not None
    tau = recording.tau.copy()
    tau[7, 1] = 1e300
    huge = replace(arm, recordings=(replace(recording, tau=tau),))
    with pytest.raises(
        FitError, match="the torques of joint 2 are too large to be squared; check their unit"
    ):
        didim.identify(huge, didim.CLOE(start="reference"))
    short = replace(arm, recordings=(replace(recording, windows=((0, 5),)),))
    with pytest.raises(FitError, match="arm: CLOE estimates the noise from more than 5 samples, got 5"):
        didim.identify(short, didim.CLOE(start="reference"))


def test_logs_that_lack_what_is_compared_are_told() -> None:
    arm = short_arm()
    (recording,) = arm.recordings
    bare = replace(arm, recordings=(replace(recording, tau=None, name="bare"),))
    with pytest.raises(FitError, match="recording 'bare' has no torques, which output 'torque' needs"):
        didim.identify(bare, didim.CLOE(start="reference", output="torque"))
    unfit = replace(arm, recordings=(replace(recording, role="held-out"),))
    with pytest.raises(FitError, match="experiment 'arm' has no recording with role 'fit'"):
        didim.identify(unfit, didim.CLOE(start="reference"))
    with pytest.raises(FitError, match=r"noise needs 2 positive numbers, one per joint, got \(1e-06,\)"):
        didim.identify(arm, didim.CLOE(start="reference", noise=[1e-6]))


def test_starts_that_cannot_be_searched_from_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = short_arm()
    nowhere = -np.ones_like(off(arm))  # negative inertias: no robot
    monkeypatch.setattr(
        "didim.methods.cloe.cloe._further_starts", lambda problem, count, seed: [nowhere] * count
    )
    said: list[str] = []
    fit = didim.CLOE(start=off(arm), starts=3).run(arm, Reporter(say=said.append))
    assert fit.status is Status.CONVERGED
    assert "1 of 3 starts reached the best optimum; 2 could not be searched from" in fit.remarks[-1]
    assert [line for line in said if line.startswith("start 3: ") and "cannot be simulated" in line]
