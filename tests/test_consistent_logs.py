"""Physical conditions on what logs have beside the robot: payloads that are bodies, friction of their own that only dissipates."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from conditions import conditions_of, drive_cones, violations
from didim import Experiment, Identification
from didim.errors import FitError
from didim.methods.method import Method
from didim.regression.consistent.prior import generic_prior
from didim.regression.consistent.problem import FRICTION_WEIGHT, ConstrainedProblem, Simulability
from didim.robot.payload import Payload, flange_in_last_frame, last_link
from didim.robot.rigid_body import body_pseudo_inertia, pose, pseudo_inertia, ten_parameters
from didim.studies.simulated_log import simulated_log
from didim.terms.build import model_of
from test_solver import KnowsTheRobot

pytestmark = pytest.mark.usefixtures("without_verdict")

ROBOT = didim.load_robot("tx40")
LOAD = ten_parameters(
    body_pseudo_inertia(0.6, np.diag([6e-4, 6e-4, 4e-4]), pose(np.eye(3), (0.01, 0.02, 0.05)))
)


@cache
def two_logs(noise: float) -> Experiment:
    """Two logs of a TX40, the second with a load and with offsets and friction of its own; so many times the packaged noise."""
    plain = didim.packaged_experiment("tx40")
    assert plain.measurement is not None
    louder = tuple(noise * value for value in plain.measurement.torque_noise)
    plain = replace(plain, measurement=replace(plain.measurement, torque_noise=louder))
    x = ROBOT.parameter_set("didim_physical")
    place = last_link(ROBOT, flange_in_last_frame(ROBOT))
    free, loaded = (
        simulated_log(plain, x + place @ ten, seed=seed) for seed, ten in ((0, 0.0 * LOAD), (100, LOAD))
    )
    recordings = (
        replace(free.recordings[0], name="free"),
        replace(loaded.recordings[0], name="loaded", payload="load", own=("offsets", "friction")),
    )
    return replace(free, recordings=recordings, payloads={"load": Payload(name="load")})


@pytest.fixture(scope="module")
def noisy() -> Experiment:
    return two_logs(20.0)


def load_of(fit: Identification) -> NDArray[np.float64]:
    assert fit.further is not None
    ten, _ = fit.further.ten("load")
    return np.asarray(ten)


def test_least_squares_makes_no_body_of_this_load(noisy: Experiment) -> None:
    """The tests below would say nothing of a load that the log determines well."""
    assert np.linalg.eigvalsh(pseudo_inertia(load_of(didim.identify(noisy, didim.IDIMLS()))))[0] < -3e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        didim.IDIMLS(physical=True),
        didim.DIDIM(),
        didim.DIDIM(start="prior"),
        didim.IDIMIV(physical=True),
        didim.CLOE(physical=True, output="torque", max_iterations=1),
    ],
    ids=["idim-ls", "didim", "didim from the prior", "idim-iv", "cloe"],
)
def test_robot_and_load_are_bodies_in_every_method(noisy: Experiment, method: Method) -> None:
    if isinstance(method, didim.CLOE):  # a simulation for each parameter: a third of the logs
        noisy = replace(
            noisy, recordings=tuple(replace(item, windows=((0, 3300),)) for item in noisy.recordings)
        )
    fit = didim.identify(noisy, method)
    assert fit.converged
    assert violations(conditions_of(ROBOT), fit.parameters) == []
    assert np.linalg.eigvalsh(pseudo_inertia(load_of(fit)))[0] > 0.0
    assert load_of(fit)[9] == pytest.approx(0.6, abs=0.05)
    # The friction of each log dissipates.
    job = didim.DIDIM().job(noisy)
    assert fit.further is not None
    x = job.model.extended(fit.parameters, fit.further.by_name)
    for recording in (0, 1):
        assert violations(drive_cones(ROBOT), job.model.standard(x, recording)) == []


@pytest.mark.slow
def test_where_truth_is_feasible_plain_least_squares_gives_the_same() -> None:
    log = two_logs(1.0)
    plain = didim.identify(log, didim.DIDIM(physical=False, start="consistent"))
    consistent = didim.identify(log, didim.DIDIM())
    assert plain.converged
    assert consistent.converged
    # Neither is at the fixed point: each stops within 0.3 standard deviations of it.
    assert np.sqrt(np.mean(((consistent.beta - plain.beta) / plain.std) ** 2)) < 0.05
    np.testing.assert_allclose(load_of(consistent), load_of(plain), atol=1e-4)


def problem_of(own: tuple[str, ...], simulability: Simulability | None = None) -> ConstrainedProblem:
    """The problem of the two logs, without a log."""
    experiment = two_logs(1.0)
    recordings = (experiment.recordings[0], replace(experiment.recordings[1], own=own))
    model = model_of(ROBOT, recordings, experiment.payloads)
    prior = generic_prior(ROBOT)
    return ConstrainedProblem(model, prior, 1e-6, None, simulability)


def test_friction_of_a_recording_is_bounded_with_that_of_the_robot() -> None:
    """Targets whose sums are negative: each ends where both conditions hold, the nearest in a metric that knows them equally."""
    problem = problem_of(("friction",))
    logs = problem.model
    x = np.append(ROBOT.parameter_set("didim_physical"), np.zeros(logs.n_further))
    x[ROBOT.parameter_names.index("Fv1")] = 2.0
    place = len(ROBOT.parameter_names) - logs.n_base + logs.unknowns.names.index("loaded.Fv1")
    x[place] = -5.0
    root = 1e3 * np.eye(len(logs.unknowns.names))
    found = problem.solve(root, root @ logs.project(x)).x
    first, second = (logs.standard(found, recording) for recording in (0, 1))
    fv = ROBOT.parameter_names.index("Fv1")
    assert violations(drive_cones(ROBOT), first) == violations(drive_cones(ROBOT), second) == []
    assert first[fv] == pytest.approx(3.5, abs=1e-3)  # (2, -5) on the line Fv1 + d = 0
    assert second[fv] == pytest.approx(0.0, abs=1e-3)
    labels = [condition.label for condition in problem.conditions]
    assert "Fv1 of recording 'loaded'" in labels
    assert "payload 'load'" in labels


def test_friction_that_cancels_leaves_a_curvature() -> None:
    """Robot and recording may round to a friction of exactly zero, on the boundary of their condition."""
    problem = problem_of(("friction",))
    logs = problem.model
    x = problem.start.copy()
    x[ROBOT.parameter_names.index("Fc1")] = 5.0
    x[len(ROBOT.parameter_names) + logs.unknowns.names[logs.n_base :].index("loaded.Fc1")] = -5.0
    assert np.isfinite(problem.root(x)).all()
    assert np.isfinite(problem.covariance(1e3 * np.eye(len(logs.unknowns.names)), x)).all()


def test_rates_are_bounded_with_the_friction_of_each_recording() -> None:
    smoothing = ROBOT.with_smoothing([0.01] * 6).friction.smoothing
    bounded = problem_of(("friction",), Simulability(1e-4, 1.5, (0.0,) * 6, tuple(smoothing)))
    labels = [condition.label for condition in bounded.conditions]
    assert "Ia1" in labels
    assert "Ia1 of recording 'loaded'" in labels
    assert violations(drive_cones(ROBOT), bounded.start[: len(ROBOT.parameter_names)]) == []


def test_the_prior_of_rotors_does_not_grow_with_the_recordings() -> None:
    """Each recording repeats the conditions on the rates, and only the robot's own have the weight of the prior."""
    smoothing = tuple(ROBOT.with_smoothing([0.01] * 6).friction.smoothing)
    problem = replace(
        problem_of(("friction",), Simulability(1e-4, 1.5, (0.0,) * 6, smoothing)), gamma=10 * FRICTION_WEIGHT
    )
    rotors = [condition for condition in problem.conditions if condition.label.startswith("Ia")]
    own, repeated = (
        [condition.weight for condition in rotors if ("recording" in condition.label) == repeats]
        for repeats in (False, True)
    )
    assert len(own) == len(repeated) > 0
    assert set(own) == {problem.gamma}
    assert set(repeated) == {FRICTION_WEIGHT}


def test_own_offsets_have_no_condition() -> None:
    labels = [condition.label for condition in problem_of(("offsets",)).conditions]
    assert not any("recording" in label for label in labels)
    assert len(labels) == len(conditions_of(ROBOT)) + 1


def test_a_solver_of_ones_own_for_robots_refuses_logs_it_does_not_know(noisy: Experiment) -> None:
    with pytest.raises(FitError, match="this solver only supports robots"):
        didim.identify(noisy, didim.IDIMLS(solver=KnowsTheRobot()))


def test_fewer_rows_than_parameters_end_in_a_sentence() -> None:
    log = two_logs(1.0)
    short = tuple(replace(item, windows=((4000, 4560),)) for item in log.recordings)
    fit = didim.identify(replace(log, recordings=short), didim.IDIMLS(physical=True))
    assert fit.n_rows < len(fit.beta) + 28  # ten of the load, 18 of the recording
    assert not fit.std.any()
    assert any("fewer rows than parameters" in remark for remark in fit.remarks)
    assert violations(conditions_of(ROBOT), fit.parameters) == []
