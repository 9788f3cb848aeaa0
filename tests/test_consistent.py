"""Physically consistent parameters: conditions, the constrained problem, its solver on logs, and the nearest robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from arm import arm_log, noisy
from conditions import conditions_of, violations
from didim.model.drive_cones import Drives, friction_cones, simulable_cones
from didim.model.dynamics import inertia_matrix
from didim.regression.consistent.bounds import Bounds
from didim.regression.consistent.prior import Prior, generic_prior, prior_of
from didim.regression.consistent.problem import ConstrainedProblem
from didim.regression.consistent.solver import CONSISTENT, Consistent, triangle_of
from didim.regression.covariance import Branches, Factors, deletion_covariance, intervals
from didim.studies.simulated_log import simulated_log
from didim.terms.model import Model
from friction_logs import coulomb, logged
from friction_logs import robot as friction_robot

pytestmark = pytest.mark.usefixtures("without_verdict")

ROBOT = didim.load_robot("tx40")
MODEL = Model(ROBOT)
PRIOR = Prior(
    "masses", tuple(np.diag([0.01 * m] * 3 + [m]) for m in (8.0, 5.0, 4.0, 3.0, 1.0, 0.3)), np.ones(6)
)
EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "tx40_log_best.toml"


def metric(seed: int = 0, noise: float = 0.05) -> np.ndarray:
    """Triangle of a covariance as a log may give it."""
    rng = np.random.default_rng(seed)
    b = len(ROBOT.base_parameters.names)
    return np.linalg.qr(rng.normal(size=(4 * b, b)))[1] / noise


def test_the_physical_set_of_the_tx40_is_a_robot_and_table_ii_is_not() -> None:
    conditions = conditions_of(ROBOT)
    assert violations(conditions, ROBOT.parameter_set("didim_physical")) == []
    assert violations(conditions, ROBOT.parameter_set("didim"))


def test_a_feasible_estimate_with_a_vanishing_prior_comes_back() -> None:
    x = ROBOT.parameter_set("didim_physical")
    beta, root = ROBOT.base_parameters.project(x), metric()
    solved = ConstrainedProblem(MODEL, PRIOR, 0.0).solve(root, root @ beta)
    assert solved.ending == "solved"
    assert np.abs(root @ (ROBOT.base_parameters.project(solved.x) - beta)).max() < 0.02


def test_infeasible_estimates_become_robots_and_draws_have_the_same_bits() -> None:
    root = metric()
    beta = ROBOT.set_base("didim")
    problem = ConstrainedProblem(MODEL, PRIOR, 1e-2)
    right = root @ beta + np.random.default_rng(1).normal(size=(5, len(beta)))
    solved = problem.solve_many(root, right, threads=1)
    again = problem.solve_many(root, right, threads=2)
    for one, other in zip(solved, again, strict=True):
        assert one.ending == "solved"
        assert one.iterations <= 20
        assert violations(conditions_of(ROBOT), one.x) == []
        assert one.x.tobytes() == other.x.tobytes()


def test_fixed_and_dropped_parameters_keep_their_values() -> None:
    model = MODEL.choosing({"ZZ1R": 1.3}, ("Off2", "Fc3"))
    estimated = model.unknowns.estimated
    root = metric()[: len(estimated), : len(estimated)]
    beta = ROBOT.set_base("didim_physical")
    problem = ConstrainedProblem(model, PRIOR, 1e-2)
    found = ROBOT.base_parameters.project(problem.solve(root, root @ beta[estimated]).x)
    names = ROBOT.base_parameters.names
    assert found[names.index("ZZ1R")] == pytest.approx(1.3, abs=1e-12)
    assert found[names.index("Off2")] == found[names.index("Fc3")] == 0.0


def test_bounds_are_met_and_contradictions_are_named() -> None:
    bounds = Bounds(
        masses={6: (0.2, 0.5)},
        total_mass=(15.0, 27.0),
        centres={5: ((-0.1, 0.1),) * 3},
        ellipsoids={4: ((0.0, 0.0, 0.0), (0.3, 0.3, 0.3))},
    )
    root, beta = metric(), ROBOT.set_base("didim")
    x = ConstrainedProblem(MODEL, PRIOR, 1e-2, bounds).solve(root, root @ beta).x
    assert violations([*conditions_of(ROBOT), *bounds.cones(ROBOT)], x) == []
    wrong = Bounds(masses={6: (5.0, 6.0)}, total_mass=(1.0, 2.0))
    with pytest.raises(didim.errors.FitError, match="no parameters meet all conditions"):
        ConstrainedProblem(MODEL, PRIOR, 1e-2, wrong).solve(root, root @ beta)
    with pytest.raises(didim.errors.FitError, match="no link 9"):
        Bounds(masses={9: (0.0, 1.0)}).cones(ROBOT)


def test_rotors_bound_the_rates_of_every_pose() -> None:
    """(C) for feasible parameters of the coupled wrist: the fastest rate is below the bound of (B)."""
    from scipy.linalg import eigvalsh

    rng = np.random.default_rng(3)
    drives, v = Drives(ROBOT), ROBOT.with_smoothing([0.01] * 6).friction.smoothing
    step, rate = 1e-4, 1.5
    cones = simulable_cones(drives, step, rate, [2.0] * 6, v)
    x = generic_prior(ROBOT).parameters(ROBOT) * np.exp(0.1 * rng.normal(size=86))
    x[[k for k, name in enumerate(ROBOT.parameter_names) if name.startswith("Ia")]] *= 0.02
    assert violations(cones, x) == []
    friction = 2.0 * np.eye(6)
    for group in drives.groups:
        sides = ("",) * len(group)
        shafts = (1.0,) * len(drives.motors(group))
        terms = [drives.viscous(group, sides), drives.slopes(group, sides, (1.0,) * len(group), shafts, v)]
        for matrices in terms:
            for name, matrix in matrices.items():
                friction[np.ix_(group, group)] += x[drives.places[name]] * matrix
    q = rng.uniform(-np.pi, np.pi, (50, 6))
    fastest = max(eigvalsh(friction, mass)[-1] for mass in inertia_matrix(ROBOT, q, x))
    assert 0.0 < fastest <= rate / step


def test_priors_and_weights_are_checked() -> None:
    assert prior_of(ROBOT, "didim_physical").name == "didim_physical"
    with pytest.raises(didim.errors.FitError, match="86 standard parameters"):
        prior_of(ROBOT, np.zeros(3))
    with pytest.raises(didim.errors.FitError, match="gamma must be a number of at least 0"):
        Consistent(gamma=-1.0)


@pytest.mark.slow
def test_consistent_didim_meets_a_robot_in_two_iterations() -> None:
    experiment = didim.packaged_experiment("tx40")
    truth = experiment.robot.parameter_set("didim_physical")
    log = simulated_log(experiment, truth, seed=0)
    fit = didim.identify(log, didim.DIDIM(physical=True))
    assert fit.converged
    assert fit.n_iterations == 2
    assert violations(conditions_of(log.robot), fit.parameters) == []
    off = (fit.beta - experiment.robot.base_parameters.project(truth)) / fit.std
    assert np.sqrt(np.mean(off**2)) < 1.5
    direct = didim.identify(log, didim.IDIMLS(physical=True))
    assert violations(conditions_of(log.robot), direct.parameters) == []


def test_the_real_log_has_the_distance_of_the_oracle(shared: Path) -> None:
    """Numbers of a prototype and of Clarabel, which agree to the digits given, for the real TX40."""
    experiment = didim.load_experiment(EXAMPLE, data=shared / "data" / "tx40")
    fit = didim.identify(experiment, didim.IDIMLS(uncertainty="decimated"))
    root = np.linalg.cholesky(np.linalg.inv(fit.covariance)).T
    for gamma, distance in ((0.0, 6.697), (1e-4, 6.699), (1e-2, 6.798)):
        solved = ConstrainedProblem(Model(experiment.robot), PRIOR, gamma).solve(root, root @ fit.beta)
        assert solved.half_distance == pytest.approx(distance, abs=1e-3)
        assert solved.iterations <= 20
    near = fit.consistent(draws=40)
    sources = {item["name"]: item["source"] for item in near.settings["consistent"]["parameters"]}
    assert sources["M1"] == "prior"
    with pytest.raises(didim.errors.FitError, match=r"prior='didim_physical' needs the robot as well"):
        fit.consistent("didim_physical")
    named = fit.consistent("didim_physical", robot=experiment.robot, draws=200)
    assert named.settings["consistent"]["prior"] == "didim_physical"
    assert sources["Fv1"] == "identified"
    assert violations(conditions_of(experiment.robot), near.parameters) == []
    assert "from the prior" in str(near)


def test_intervals_of_the_nearest_robot_are_students(tmp_path: Path) -> None:
    from scipy.stats import t

    log = noisy(arm_log(0))
    fit = didim.identify(log, didim.IDIMLS(uncertainty="jackknife", blocks=6))
    assert fit.uncertainty is not None
    assert fit.uncertainty.degrees_of_freedom == 5.0
    near = fit.consistent(draws=40)
    low, high = near.confidence_interval(0.9)
    np.testing.assert_allclose(high - near.beta, t.ppf(0.95, 5) * near.std, rtol=1e-12)
    np.testing.assert_allclose(near.beta - low, t.ppf(0.95, 5) * near.std, rtol=1e-12)
    assert near.uncertainty is not None
    assert near.uncertainty.kind == "draws"
    assert near.uncertainty.blocks == ()
    assert "sigma of draws of the estimate, each moved to the nearest robot" in str(near)
    near.save(tmp_path / "near.json")
    again = didim.Identification.load(tmp_path / "near.json")
    np.testing.assert_array_equal(again.confidence_interval(0.9), (low, high))


def test_deletions_are_those_of_the_constrained_problem() -> None:
    """The jackknife of robots is that of solutions without each block; without the conditions it is up to twice as wide."""
    log = logged(friction_robot("ur5e-like"), coulomb, 4001, of="ur5e-like", noise="correlated")
    job = didim.IDIMLS(physical=True).job(log)
    system = job.system(job.parts("fit"))
    solver = CONSISTENT.for_model(job.model)
    fit, problem = solver(system, job.settings), solver.on(system)
    assert fit.precision is not None
    a, y = system.w * fit.weights[:, None], system.y * fit.weights
    blocks = [part.rows for part in intervals(system.blocks, 20)]
    true, missed = [], 0.0
    for rows in blocks:
        kept = np.setdiff1d(np.arange(len(y)), rows)
        solved = problem.solve(*triangle_of(a[kept], y[kept]))
        true.append(problem.matrix @ solved.x - fit.solution)
        missed += float(np.sum(np.square(y[rows] - a[rows] @ (problem.matrix @ solved.x))))
    expected = np.sqrt(np.diag(deletion_covariance(np.array(true))))
    residual = fit.residual * fit.weights
    factors = Factors.held(a, residual, fit.precision)
    assert np.sum(np.square(factors.left_out(blocks))) == pytest.approx(missed, rel=0.01)
    assert missed > 1.02 * np.sum(np.square(residual))
    held = factors.jackknife(blocks)
    free = Branches.of(system, fit.weights, fit.residual).jackknife(blocks)
    ratio, wide = (np.sqrt(np.diag(each.covariance)) / expected for each in (held, free))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
    assert np.percentile(np.abs(np.log(ratio)), 90) < 0.1
    assert np.percentile(wide, 95) > 2.0


def test_a_column_that_is_rounding_is_known_by_the_prior_alone() -> None:
    rng = np.random.default_rng(0)
    a = np.column_stack([rng.standard_normal((200, 3)), 1e-15 * rng.standard_normal(200)])
    known = Factors.held(a, rng.standard_normal(200), 1e-3 * np.eye(4))
    deviations = np.sqrt(np.sum(known.inverse**2, axis=1))
    np.testing.assert_allclose(
        deviations[:3], np.sqrt(np.diag(np.linalg.inv(a[:, :3].T @ a[:, :3]))), rtol=1e-2
    )
    assert deviations[3] == pytest.approx(1e-3**-0.5, rel=1e-6)


def test_further_friction_terms_only_dissipate() -> None:
    """Each law at its own lowest amplitude still takes power, at every speed; a little less gives some."""
    robot = didim.load_robot("planar2").with_friction(
        atan=[1, 2],
        atan_velocity_rad_s=[0.1, 0.1],
        stribeck=[1],
        stribeck_velocity_rad_s=[0.2, 0.2],
        forward_viscous=[2],
        root=[2],
        load=[1],
    )
    conditions = friction_cones(Drives(robot))
    labels = [condition.label for condition in conditions]
    assert {"Fa1", "Fa2", "Fs1", "Fl1"} <= set(labels)
    names = list(robot.parameter_names)
    speeds = np.linspace(-3.0, 3.0, 601)[:, None] * [1.0, 1.0]
    rest = np.zeros_like(speeds)

    def worst(**values: float) -> tuple[float, bool]:
        x = np.zeros(len(names))
        for name, value in values.items():
            x[names.index(name)] = value
        tau = didim.inverse_dynamics(robot, rest, speeds, rest, x)
        return float((tau * speeds).min()), violations(conditions, x) == []

    for inside, outside in (
        ({"Fv1": 2.0, "Fa1": -0.19}, {"Fv1": 2.0, "Fa1": -0.25}),
        ({"Fc1": 1.0, "Fs1": -0.99}, {"Fc1": 1.0, "Fs1": -1.1}),
        ({"Fv2": 1.0, "Fvp2": -0.99}, {"Fv2": 1.0, "Fvp2": -1.1}),
        # Two terms share what the viscous friction takes.
        ({"Fv2": 1.0, "Fvp2": -0.49, "Fa2": -0.05}, {"Fv2": 1.0, "Fvp2": -0.9, "Fa2": -0.09}),
        ({"Fr2": 0.1}, {"Fr2": -0.1}),
    ):
        power, met = worst(**inside)
        assert power >= -1e-12, inside
        assert met, inside
        power, met = worst(**outside)
        assert power < 0.0, outside
        assert not met, outside


def test_consistent_estimates_with_further_friction_terms() -> None:
    experiment = arm_log(2)
    robot = experiment.robot.with_friction(atan=[1, 2], atan_velocity_rad_s=[0.1, 0.1], load=[1])
    log = noisy(replace(experiment, robot=robot))
    fit = didim.identify(log, didim.IDIMLS(physical=True))
    assert violations(conditions_of(robot), fit.parameters) == []
    assert fit.parameters[robot.parameter_names.index("Fl1")] >= 0.0
    assert didim.identify(log).overall_relative_error == pytest.approx(fit.overall_relative_error, rel=0.05)
    # The robot that the result itself has, also after it was saved, has the terms too.
    nearest = fit.consistent(draws=20, robot=robot)
    assert fit.consistent(draws=20).parameters.tolist() == nearest.parameters.tolist()
