"""Limbs of a robot: their own models, and derivatives of which one simulation serves a parameter of each limb."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.experiment.experiment import Experiment
from didim.methods.cloe.output_error import OutputError
from didim.methods.didim.response import Response
from didim.methods.didim.slack import Loop, SolvedIterate
from didim.methods.didim.windows import Simulated, simulated_all, windows_of
from didim.model.limbs import Directions, limbs_of
from didim.result.iteration import Reporter
from didim.robot.robot import Robot
from simulated import closed_loop_log
from test_trees import legs
from urdfs import inertial_text, joint_text

Array = NDArray[np.float64]


def loaded(folder: Path, text: str) -> Robot:
    (folder / "robot.urdf").write_text(text)
    return didim.load_robot(folder / "robot.urdf", tip="")


@pytest.fixture(scope="module")
def walker(tmp_path_factory: pytest.TempPathFactory) -> tuple[Experiment, Array]:
    """A short log of three legs of two joints, and its parameters."""
    robot = loaded(tmp_path_factory.mktemp("walker"), legs(3, 2))
    robot = robot.with_friction(smoothing_rad_s=0.02, coulomb="tanh")
    x = robot.parameter_set("urdf").copy()
    for j in range(robot.n_dof):
        x[[robot.parameter_names.index(f"{key}{j + 1}") for key in ("Ia", "Fv", "Fc")]] = 0.3, 0.5, 0.2
    return closed_loop_log(robot, x, torque_noise=0.05), x


def hand(leaders: tuple[int, int] = (0, 1)) -> str:
    """A palm with two fingers that bend, a tip on each that follows a finger."""
    rng = np.random.default_rng(0)
    parts = [f'<link name="palm">{inertial_text(rng)}</link>']
    for k, factor in enumerate((0.7, -0.4)):
        leader = f"bend{leaders[k]}"
        parts += [f'<link name="{part}{k}">{inertial_text(rng)}</link>' for part in ("finger", "tip")]
        follow = f'<mimic joint="{leader}" multiplier="{factor}" offset="0.1"/>'
        axis, xyz = (0.0, 1.0, 0.0), (0.0, 0.03 * k, 0.1)
        parts.append(joint_text(f"bend{k}", "revolute", "palm", f"finger{k}", xyz=xyz, axis=axis))
        parts.append(
            joint_text(f"curl{k}", "revolute", f"finger{k}", f"tip{k}", xyz=xyz, axis=axis, inside=follow)
        )
    return f'<robot name="hand">{"".join(parts)}</robot>'


def test_limbs_with_followers_move_by_themselves(tmp_path: Path) -> None:
    robot = loaded(tmp_path, hand())
    limbs = limbs_of(robot)
    assert [(limb.joints, limb.robot.n_joints) for limb in limbs] == [((0,), 2), ((1,), 2)]
    rng = np.random.default_rng(0)
    x = rng.uniform(0.1, 1.0, len(robot.parameter_names))
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 7, 2))
    whole = didim.inverse_dynamics(robot, q, dq, ddq, x)
    assert sorted(np.concatenate([limb.indices for limb in limbs])) == list(range(len(x)))
    for limb in limbs:
        at = list(limb.joints)
        alone = didim.inverse_dynamics(limb.robot, q[:, at], dq[:, at], ddq[:, at], x[limb.indices])
        np.testing.assert_allclose(alone, whole[:, at], rtol=1e-12, atol=1e-12)


def test_a_follower_of_another_limb_joins_both(tmp_path: Path) -> None:
    assert [limb.joints for limb in limbs_of(loaded(tmp_path, hand((0, 0))))] == [(0, 1)]


def singly(robot: Robot, acts: NDArray[np.bool_]) -> Directions:
    """Directions of a simulation per parameter, and all that responds."""
    count = acts.shape[1]
    return Directions(np.arange(count), np.ones((count, robot.n_dof), dtype=bool))


def test_a_parameter_of_each_limb_shares_a_simulation(walker: tuple[Experiment, Array]) -> None:
    robot = walker[0].robot
    acts = np.zeros((6, 6), dtype=bool)
    # Joint 1, the second leg, joints of the first and the third, the second again, nothing, the third.
    for column, joints in enumerate(([0], [2, 3], [1, 5], [3], [], [4])):
        acts[joints, column] = True
    found = Directions.of(robot, acts)
    assert found.number.tolist() == [0, 0, 1, 1, 2, 0]
    assert ["".join(map(str, row)) for row in found.joints.astype(int)] == [
        "110000", "001100", "110011", "001100", "111111", "000011",
    ]  # fmt: skip
    steps = np.arange(1.0, 7.0)
    np.testing.assert_array_equal(
        found.changes(steps), [[1, 2, 0, 0, 0, 6], [0, 0, 3, 4, 0, 0], [0, 0, 0, 0, 5, 0]]
    )


def test_a_chain_has_a_simulation_per_parameter() -> None:
    found = Directions.of(didim.load_robot("ur5e"), np.eye(6, 9, dtype=bool) | (np.arange(9) > 5))
    assert found.number.tolist() == list(range(9))
    assert found.joints.all()


def test_derivatives_of_output_errors_of_all_limbs_at_once(
    walker: tuple[Experiment, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    log, _ = walker
    method = didim.CLOE(start="idim-ls", output="both")
    job = method.job(log, log.simulation.robot(log.robot))
    found = []
    for of in (Directions.of, singly):
        monkeypatch.setattr(Directions, "of", of)
        problem = OutputError(method, job, Reporter())
        (errors,), _ = problem.errors(problem.start[None])
        begun = problem.n_simulations
        found.append((problem.derivatives(problem.start, errors), problem.n_simulations - begun))
    (together, few), (one_by_one, many) = found
    assert (few, many) == (len(one_by_one) // 3, len(one_by_one))
    np.testing.assert_allclose(together, one_by_one, rtol=0.0, atol=1e-9 * np.abs(one_by_one).max())


def test_a_diverging_limb_leaves_the_derivatives_of_the_others(
    walker: tuple[Experiment, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parameters whose common simulation ends early are changed to the other side, one by one."""
    log, _ = walker
    method = didim.CLOE(start="idim-ls")
    problem = OutputError(method, method.job(log, log.simulation.robot(log.robot)), Reporter())
    (errors,), _ = problem.errors(problem.start[None])
    inner = problem.derivatives(problem.start, errors)
    known, calls = OutputError.errors, list[int]()

    def at_the_edge(problem: OutputError, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        rows, completed = known(problem, points)
        calls.append(len(points))
        if len(calls) == 1:
            rows[2], completed[2] = np.nan, False
        return rows, completed

    monkeypatch.setattr(OutputError, "errors", at_the_edge)
    edge = problem.derivatives(problem.start, errors)
    assert calls == [len(inner) // 3, 3]
    sizes = np.linalg.norm(inner, axis=1)
    assert np.all(np.linalg.norm(edge - inner, axis=1) < 1e-2 * sizes)
    np.testing.assert_array_equal(edge == 0.0, inner == 0.0)


def test_the_response_of_all_limbs_at_once(
    walker: tuple[Experiment, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    log, x = walker
    method = didim.DIDIM(physical=False)
    job = method.job(log, log.simulation.robot(log.robot))
    windows = windows_of(job, job.delay())
    loop = Loop(job, windows, job.parameters, job.solve)
    counts: list[int] = []

    def rows(changes: Sequence[Array]) -> list[Array]:
        counts.append(len(changes))
        runs = simulated_all(windows, [loop.moved(x, change) for change in changes])
        return [loop.torques(run) for run in runs if isinstance(run, Simulated)]

    (run,) = simulated_all(windows, [x])
    assert isinstance(run, Simulated)
    place = SolvedIterate.of(loop, x, run)
    found = []
    for of in (Directions.of, singly):
        monkeypatch.setattr(Directions, "of", of)
        response = Response.at(place.system, place.fit, rows, loop.torques(run), job.robot)
        assert response is not None
        found.append(response.slopes)
    count = len(place.system.names)
    assert counts == [count // 3, count]
    np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=1e-9 * np.abs(found[1]).max())
