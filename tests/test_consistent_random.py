"""Random robots under physical conditions: checks that know nothing of the solver (hypothesis)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import didim
from conditions import multipliers, smallest_of
from didim import Robot
from didim.model.drive_cones import Drives, simulable_cones
from didim.model.dynamics import inertia_matrix
from didim.regression.consistent.prior import generic_prior
from didim.regression.consistent.problem import LEAST_WEIGHT, Constrained, ConstrainedProblem, Simulability
from didim.terms.model import Model

Array = NDArray[np.float64]

# The same examples on every machine, few of them: each takes the base parameters of another robot.
PROFILE = settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@st.composite
def robots(draw: st.DrawFn, most: int = 9) -> Robot:
    """A chain of 1 to 9 joints of both kinds, sometimes with a coupled wrist."""
    n = draw(st.integers(1, most))
    kinds = draw(st.lists(st.sampled_from(["revolute", "revolute", "prismatic"]), min_size=n, max_size=n))
    tilts = draw(st.lists(st.sampled_from([0.0, 90.0, -90.0, 35.0]), min_size=n, max_size=n))
    lengths = draw(st.lists(st.sampled_from([0.0, 0.1, 0.35]), min_size=2 * n, max_size=2 * n).map(np.array))
    coupled = n >= 2 and kinds[-1] == kinds[-2] == "revolute" and draw(st.booleans())
    lines = ['schema = 1\nname = "chain"\ndescription = "random"\ngravity_m_s2 = [0.0, 0.0, -9.81]']
    for j, (kind, tilt) in enumerate(zip(kinds, tilts, strict=True)):
        place = lengths[2 * j + 1]
        lines.append(
            f'[[joint]]\nkind = "{kind}"\nalpha_deg = {tilt}\nd_m = {lengths[2 * j]}\n'
            + (
                f"theta_deg = 0.0\nr_m = {place}"
                if kind == "revolute"
                else f"theta_deg = {100.0 * place}\nr_m = 0.0"
            )
        )
    if coupled:
        matrix = np.eye(n)
        matrix[-1, -2] = draw(st.sampled_from([1.0, -0.7]))
        lines.append(f"[transmission]\ncoupling = {matrix.tolist()}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "chain.toml")
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        robot = didim.load_robot(path)
    return robot.with_smoothing([0.01] * n)


def bodies(robot: Robot, x: Array) -> list[Array]:
    """Pseudo-inertias by the definition, written out anew."""
    value = dict(zip(robot.parameter_names, x, strict=True))
    found = []
    for j in range(1, robot.n_dof + 1):
        inertia = np.array(
            [
                [value[f"XX{j}"], value[f"XY{j}"], value[f"XZ{j}"]],
                [value[f"XY{j}"], value[f"YY{j}"], value[f"YZ{j}"]],
                [value[f"XZ{j}"], value[f"YZ{j}"], value[f"ZZ{j}"]],
            ]
        )
        body = np.empty((4, 4))
        body[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        body[3, :3] = body[:3, 3] = [value[f"M{axis}{j}"] for axis in "XYZ"]
        body[3, 3] = value[f"M{j}"]
        found.append(body)
    return found


def dissipated(robot: Robot, x: Array, speeds: Array) -> Array:
    """Power of the friction at speeds (m, n), by its torque."""
    rest = [name.startswith(("Fv", "Fc")) for name in robot.parameter_names]
    friction = np.where(rest, x, 0.0)
    zeros = np.zeros_like(speeds)
    tau = didim.inverse_dynamics(robot, zeros, speeds, zeros, friction)
    return np.asarray(np.sum(tau * speeds, axis=1))


def problem_of(
    robot: Robot, rng: np.random.Generator, gamma: float, noise: float
) -> tuple[ConstrainedProblem, Array, Array]:
    """A problem whose estimate is that of a random robot, moved by some noise."""
    problem = ConstrainedProblem(Model(robot), generic_prior(robot), gamma)
    b = len(robot.base_parameters.names)
    root = np.linalg.qr(rng.normal(size=(4 * b, b)))[1] * np.exp(rng.uniform(2.0, 5.0))
    truth = problem.start * np.exp(0.1 * rng.normal(size=len(problem.start)))
    return problem, root, root @ robot.base_parameters.project(truth) + noise * rng.normal(size=b)


def optimality(
    problem: ConstrainedProblem, root: Array, right: Array, solved: Constrained
) -> tuple[float, float]:
    """Violations of the optimality conditions by the multipliers: ``F Z = weight I`` (nats), and the gradient of the Lagrangian.

    The gradient is in units of the curvature of each parameter (root of nats).
    """
    a = root @ problem.matrix
    residual = a.T @ (a @ solved.x - right)
    curvature, complementarity = np.sum(a**2, axis=0), 0.0
    for condition, multiplier in zip(problem.conditions, multipliers(problem, root, right), strict=True):
        weight, slope = max(condition.weight, LEAST_WEIGHT), np.eye(len(multiplier))
        if condition.slope is not None and condition.weight >= LEAST_WEIGHT:
            slope = condition.slope
        factor = np.linalg.cholesky(condition.at(solved.x))
        products = np.linalg.eigvalsh(factor.T @ multiplier @ factor)
        assert products.min() > 0.0
        complementarity = max(complementarity, float(np.abs(products - weight).max()))
        places = list(condition.indices)
        residual[places] += np.tensordot(condition.basis, weight * slope - multiplier, 2)
        scaled = np.linalg.solve(factor, condition.basis) @ np.linalg.cholesky(multiplier)
        curvature[places] += np.sum(scaled**2, axis=(1, 2))
    return complementarity, float(np.max(np.abs(residual) / np.sqrt(curvature)))


@PROFILE
@given(robots(), st.integers(0, 10_000), st.sampled_from([1e-2, 1e-4, 0.06]), st.sampled_from([1.0, 100.0]))
def test_solutions_are_robots_and_optimal(robot: Robot, seed: int, gamma: float, noise: float) -> None:
    rng = np.random.default_rng(seed)
    problem, root, right = problem_of(robot, rng, gamma, noise)
    solved = problem.solve(root, right)
    assert solved.ending == "solved"
    assert solved.iterations <= 20
    for body in bodies(robot, solved.x):
        assert np.linalg.eigvalsh(body)[0] > -1e-12 * np.trace(body)
    speeds = rng.normal(size=(200, robot.n_dof)) * np.exp(rng.uniform(-6, 1, (200, 1)))
    power = dissipated(robot, solved.x, speeds)
    assert np.all(power >= -1e-9 * np.abs(power).max())
    q = rng.uniform(-np.pi, np.pi, (20, robot.n_dof))
    masses = np.linalg.eigvalsh(inertia_matrix(robot, q, solved.x))
    assert np.all(masses[:, 0] > -1e-9 * masses[:, -1])
    complementarity, stationarity = optimality(problem, root, right, solved)
    assert complementarity <= 1e-8
    assert stationarity <= 1e-8
    a = root @ problem.matrix
    # No neighbour that is a robot is better.
    objective = _objective(problem, a, right)
    best = objective(solved.x)
    for _ in range(5):
        other = solved.x + 1e-4 * np.exp(rng.uniform(-4, 0)) * (problem.start - solved.x) * rng.uniform(0, 1)
        assert objective(other) >= best - 1e-8 * (1.0 + abs(best))


def _objective(problem: ConstrainedProblem, a: Array, right: Array) -> Callable[[Array], float]:
    def value(x: Array) -> float:
        total = 0.5 * float(np.sum((a @ x - right) ** 2))
        for condition in problem.conditions:
            matrix = condition.at(x)
            total -= max(condition.weight, LEAST_WEIGHT) * float(np.linalg.slogdet(matrix)[1])
            if condition.slope is not None:
                total += condition.weight * float(np.sum(condition.slope * matrix))
        return total

    return value


@PROFILE
@given(robots(), st.integers(0, 10_000))
def test_a_feasible_estimate_comes_back_where_the_prior_vanishes(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem, root, right = problem_of(robot, rng, 0.0, 0.0)
    solved = problem.solve(root, right)
    assert solved.ending == "solved"
    assert np.abs(root @ problem.matrix @ solved.x - right).max() < 0.02


@PROFILE
@given(robots(7), st.integers(0, 10_000), st.sampled_from([1e-4, 2.5e-5]))
def test_rates_of_feasible_robots_are_below_the_bound_in_every_pose(
    robot: Robot, seed: int, step: float
) -> None:
    """(C): lambda_max(M^-1 diag(Fv + kv + Fc/v)) <= c/h for random x that meet (B) and random q."""
    from scipy.linalg import eigh

    rng = np.random.default_rng(seed)
    n, rate = robot.n_dof, 1.5
    damping, v = rng.uniform(0.0, 5.0, n), robot.friction.smoothing
    wanted = Simulability(step, rate, tuple(damping), tuple(v))
    problem = ConstrainedProblem(Model(robot), generic_prior(robot), 1e-2, simulability=wanted)
    b = len(robot.base_parameters.names)
    root = np.linalg.qr(rng.normal(size=(4 * b, b)))[1] * 30.0
    truth = problem.start * np.exp(0.3 * rng.normal(size=len(problem.start)))
    light = [name.startswith("Ia") for name in robot.parameter_names]
    truth[light] *= 1e-3
    x = problem.solve(root, root @ robot.base_parameters.project(truth)).x
    drives = Drives(robot)
    assert all(
        smallest_of(item, x) > -1e-9 for item in simulable_cones(drives, step, rate, damping.tolist(), v)
    )
    friction = np.diag(damping)
    for group in drives.groups:
        sides, shafts = ("",) * len(group), (1.0,) * len(drives.motors(group))
        for terms in (
            drives.viscous(group, sides),
            drives.slopes(group, sides, (1.0,) * len(group), shafts, v),
        ):
            for name, term in terms.items():
                friction[np.ix_(group, group)] += x[drives.places[name]] * term
    q = rng.uniform(-np.pi, np.pi, (30, n))
    fastest = max(float(eigh(friction, mass, eigvals_only=True)[-1]) for mass in inertia_matrix(robot, q, x))
    assert fastest <= rate / step * (1.0 + 1e-6)
