"""Limbs of a robot: their own models, and derivatives of which one simulation serves a parameter of each limb."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.errors import FitError, SimulationError
from didim.evidence.causes import Search
from didim.evidence.hypotheses.geometry import gravities, lengths
from didim.evidence.hypotheses.hypothesis import Hypothesis
from didim.evidence.hypotheses.positions import exchanged, positions
from didim.evidence.naming import torque_findings
from didim.evidence.rows import LogRows
from didim.experiment.experiment import Experiment
from didim.experiment.specs import Measurement
from didim.loop.closed_loop import ClosedLoop
from didim.loop.controller import Digital
from didim.loop.memory import ControllerMemory
from didim.loop.outcome import Outcome, SimulationStatus
from didim.methods.cloe.jacobian import Jacobian
from didim.methods.cloe.output_error import OutputError
from didim.methods.didim.problem import EVERYTHING, Iterate, Part, Problem, Simulated
from didim.methods.didim.slack import response
from didim.model.limbs import Directions, Limb, limbs_of, renamed
from didim.result.iteration import Iteration, Reporter, Status
from didim.robot.robot import Robot
from didim.studies.simulated_log import simulated_log
from simulated import closed_loop_log
from urdfs import inertial_text, joint_text, legs

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


def dense(jacobian: Jacobian, n_rows: int) -> Array:
    """Derivatives of all errors, (n, n_rows)."""
    found = np.zeros((len(jacobian.normal), n_rows))
    for part in jacobian.parts:
        found[np.ix_(part.columns, part.rows)] = part.slopes
    return found


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
    (apart, few), (together, many) = found
    one_by_one = dense(together, errors.size)
    n = len(one_by_one)
    assert (few, many) == (n // 3, n)
    assert [part.columns.size for part in apart.parts] == [n // 3] * 3
    np.testing.assert_allclose(
        dense(apart, errors.size), one_by_one, rtol=0.0, atol=1e-9 * np.abs(one_by_one).max()
    )
    # What a search asks of them, by the textbook.
    step = np.linspace(-1.0, 1.0, n)
    for jacobian in (apart, together):
        g = dense(jacobian, errors.size).T
        np.testing.assert_allclose(jacobian.normal, g.T @ g, rtol=1e-12, atol=1e-12 * np.abs(g.T @ g).max())
        np.testing.assert_allclose(jacobian.gradient(errors), g.T @ errors, rtol=1e-9)
        np.testing.assert_allclose(jacobian.changed(errors, step), errors + g @ step, rtol=1e-9)
        rows = jacobian.triangles(step, errors)
        right = g.T @ (g @ step - errors)
        np.testing.assert_allclose(
            rows[:, :n].T @ rows[:, n], right, rtol=1e-9, atol=1e-9 * np.abs(right).max()
        )


@pytest.mark.slow
def test_standard_deviations_of_all_limbs_at_once(
    walker: tuple[Experiment, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each limb has its own part of the covariance and of the jackknife."""
    method = didim.CLOE(start="idim-ls", output="both", max_iterations=3)
    apart = didim.identify(walker[0], method)
    monkeypatch.setattr(Directions, "of", singly)
    together = didim.identify(walker[0], method)
    np.testing.assert_allclose(apart.beta / together.std, together.beta / together.std, atol=1e-4)
    size = np.outer(together.std, together.std)
    np.testing.assert_allclose(apart.covariance / size, together.covariance / size, atol=1e-5)
    assert apart.uncertainty is not None
    assert together.uncertainty is not None
    for key in ("std_white", "deletions"):
        one, other = (getattr(fit.uncertainty, key) / together.std for fit in (apart, together))
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_a_diverging_limb_leaves_the_derivatives_of_the_others(
    walker: tuple[Experiment, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parameters whose common simulation ends early are changed to the other side, one by one."""
    log, _ = walker
    method = didim.CLOE(start="idim-ls")
    problem = OutputError(method, method.job(log, log.simulation.robot(log.robot)), Reporter())
    (errors,), _ = problem.errors(problem.start[None])
    inner = dense(problem.derivatives(problem.start, errors), errors.size)
    known, calls = OutputError.errors, list[int]()

    def at_the_edge(problem: OutputError, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        rows, completed = known(problem, points)
        calls.append(len(points))
        if len(calls) == 1:
            rows[2], completed[2] = np.nan, False
        return rows, completed

    monkeypatch.setattr(OutputError, "errors", at_the_edge)
    edge = dense(problem.derivatives(problem.start, errors), errors.size)
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
    problem = Problem(method, job, Reporter())
    run = problem.simulate(x)
    assert isinstance(run, Simulated)
    place, origin = problem.solve(Iterate(x, run, 0)), problem.simulated_rows(run)
    counts: list[int] = []
    usual = problem.torques_after

    def rows(around: Array, changes: Sequence[Array]) -> list[Array] | None:
        counts.append(len(changes))
        return usual(around, changes)

    monkeypatch.setattr(problem, "torques_after", rows)
    found = []
    for of in (Directions.of, singly):
        monkeypatch.setattr(Directions, "of", of)
        slopes = response(problem, place, origin)
        assert slopes is not None
        found.append(slopes)
    count = len(place.system.names)
    assert counts == [count // 3, count]
    np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=1e-9 * np.abs(found[1]).max())


def alone(log: Experiment, limb: Limb) -> Experiment:
    """The log of one limb."""
    at = list(limb.joints)
    assert isinstance(log.reference, didim.Reference)
    assert isinstance(log.controller, didim.Controller)
    recordings = []
    for item in log.recordings:
        assert item.tau is not None
        recordings.append(replace(item, q=item.q[:, at], dq=None, tau=item.tau[:, at], q_ref=None))
    return replace(
        log,
        robot=limb.of(log.robot),
        recordings=tuple(recordings),
        reference=log.reference.of_joints(at),
        controller=log.controller.of_joints(at),
        simulation=replace(log.simulation, smoothing=(0.02,) * len(at)),
    )


@pytest.fixture(scope="module")
def slack(walker: tuple[Experiment, Array]) -> Experiment:
    """The same robot with a slack loop at its second leg, which takes more iterations."""
    log, x = walker
    controller = didim.Controller.tuned([8.0, 8.0, 1.5, 1.5, 8.0, 8.0], [0.7] * 6, [0.5] * 6)
    noise = Measurement(torque_noise=(0.05,) * 6, position_noise=(1e-5,) * 6, seed=1)
    return simulated_log(replace(log, controller=controller, recordings=(), measurement=noise), x)


PLAIN = didim.DIDIM(physical=False)


def parts_of(log: Experiment, method: didim.DIDIM) -> list[Part]:
    return Problem(method, method.job(log, log.simulated_robot), Reporter()).parts


def test_each_limb_rests_where_it_would_by_itself(walker: tuple[Experiment, Array]) -> None:
    """After as many iterations as by itself; the covariance is that along the motion of the last iteration of all."""
    log, _ = walker
    entries: list[Iteration] = []

    def add(entry: Iteration) -> bool:
        entries.append(entry)
        return False

    whole = didim.identify(log, PLAIN, callback=add)
    assert whole.converged
    fits = [didim.identify(alone(log, limb), PLAIN) for limb in limbs_of(log.robot)]
    for limb, fit in zip(limbs_of(log.robot), fits, strict=True):
        at = [whole.names.index(renamed(name, limb.links)) for name in fit.names]
        np.testing.assert_allclose(whole.beta[at] / fit.std, fit.beta / fit.std, atol=1e-7)
        np.testing.assert_allclose(whole.std[at], fit.std, rtol=0.02)
    counts = [fit.n_iterations for fit in fits]
    assert min(counts) < max(counts)
    assert whole.ending.endswith(f"Iterations by limb: {', '.join(map(str, counts))}.")
    assert tuple(entries) == whole.history
    assert [item.iteration for item in entries] == list(range(1, max(counts) + 1))
    assert whole.n_simulations == max(fit.n_simulations for fit in fits)


def test_a_slack_limb_goes_on_to_its_fixed_point(slack: Experiment) -> None:
    whole = didim.identify(slack, PLAIN)
    assert whole.converged
    assert any(text.startswith("slow contraction: an iteration in this slack loop") for text in whole.remarks)
    start = replace(PLAIN, start=whole, sigma_fraction=1e-4, tolerance=0.0, max_iterations=60)
    end = didim.identify(slack, start)
    distance = np.max(np.abs(end.beta - whole.beta) / whole.std)
    assert distance <= whole.history[-1].more["remaining_sigma"] <= 0.15


@pytest.mark.parametrize("method", [PLAIN, didim.IDIMIV(physical=False)], ids=["didim", "idim-iv"])
def test_small_steps_in_time_are_given_up_at_the_end(
    walker: tuple[Experiment, Array], method: didim.DIDIM, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limbs then move again, with the usual steps: a motion that was kept would be that of other parameters."""
    log, _ = walker
    plain = didim.identify(log, method)
    usual, calls = Problem.simulate, []

    def simulate(self: Problem, x: Array, *rest: Any) -> Simulated | Outcome:
        calls.append(x)
        return Outcome(SimulationStatus.DIVERGED, 0.5, 1) if len(calls) == 3 else usual(self, x, *rest)

    monkeypatch.setattr(Problem, "simulate", simulate)
    fit = didim.identify(log, method)
    assert any("until the end is near they are" in text for text in fit.remarks)
    assert fit.converged
    assert np.max(np.abs(fit.beta - plain.beta) / plain.std) < 0.3
    assert fit.output_error is not None
    assert plain.output_error is not None
    assert fit.output_error[1] == pytest.approx(plain.output_error[1], rel=0.01)


def test_a_limb_that_finds_no_end_leaves_the_others_their_best(walker: tuple[Experiment, Array]) -> None:
    """Torques of the first leg have the wrong sign: the run does not converge, and the other legs are as they were."""
    log, _ = walker
    (recording,) = log.recordings
    assert recording.tau is not None
    tau = recording.tau * np.where(np.arange(6) < 2, -1.0, 1.0)
    right, wrong = (
        didim.identify(replace(log, recordings=(replace(recording, tau=each),)), PLAIN)
        for each in (recording.tau, tau)
    )
    assert not wrong.converged
    of_others = [name.rstrip("R+-")[-1] in "3456" for name in right.names]
    assert np.max(np.abs(wrong.beta - right.beta)[of_others]) < 0.01


def test_a_run_that_is_stopped_ends_all_limbs(slack: Experiment) -> None:
    fit = didim.identify(slack, PLAIN, callback=lambda entry: entry.iteration == 4)
    assert fit.status is Status.STOPPED
    assert fit.n_iterations == 4
    assert not fit.std.any()


def test_a_simulation_that_ends_early_names_the_joint_of_the_robot(slack: Experiment) -> None:
    controller = didim.Controller.pd([300.0, 300.0, 300.0, 300.0, -300.0, 300.0], [30.0] * 6)
    with pytest.raises(FitError, match=r"cannot start from these .* diverged at .* joint [56] has left"):
        didim.identify(replace(slack, controller=controller), PLAIN)


def test_limbs_that_share_something_rest_together(slack: Experiment) -> None:
    assert len(parts_of(slack, PLAIN)) == 3
    moves = didim.Reference.point_to_point(
        [[0.0] * 6, [0.1, 0.2, 0.3, 0.1, 0.2, 0.3]], max_velocity=1.0, max_acceleration=5.0, dwell_s=2.0
    )
    third = [name for name in slack.robot.base_parameters.names if name.rstrip("R+-")[-1] in "56"]
    for log, method in (
        (slack, didim.DIDIM()),
        (slack, didim.DIDIM(solver="huber")),
        (slack, replace(PLAIN, dropped=third)),
        (replace(slack, reference=moves), PLAIN),
        (alone(slack, limbs_of(slack.robot)[0]), PLAIN),
    ):
        assert parts_of(log, method) == [EVERYTHING]


def as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate all limbs with common steps."""
    monkeypatch.setattr("didim.loop.closed_loop.limbs_of", lambda robot: limbs_of(robot)[:1])


DIGITAL = Digital(sample_time_s=0.004, delay_samples=1, smoothing=(0.5, 0.5))


@pytest.mark.parametrize("resolution", [(), (0.1,), (0.1, 0.2, 0.3, 0.4)])
def test_a_limb_has_its_own_encoders(resolution: tuple[float, ...]) -> None:
    digital = replace(DIGITAL, resolution=resolution)
    controller = didim.Controller.pd([1.0, 2.0, 3.0, 4.0], [5.0] * 4, digital=digital).of_joints((3, 1))
    assert controller.digital == replace(
        digital, resolution=resolution if len(resolution) < 4 else (0.4, 0.2)
    )
    assert controller.laws[:, 0].tolist() == [4.0, 2.0]


@pytest.mark.parametrize("digital", [None, DIGITAL])
def test_limbs_are_simulated_apart(
    walker: tuple[Experiment, Array], monkeypatch: pytest.MonkeyPatch, digital: Digital | None
) -> None:
    """Each as in the whole robot, with the steps of its own reversals only."""
    log, x = walker
    robot = log.robot
    rng = np.random.default_rng(0)
    q = log.recordings[0].q[:600]
    controller = didim.Controller.pid(
        kp=rng.uniform(200.0, 400.0, 6),
        kv=rng.uniform(20.0, 40.0, 6),
        ki=rng.uniform(20.0, 40.0, 6),
        gain=rng.uniform(1.0, 2.0, 6),
        saturation=200.0,
        digital=digital,
    ).with_feedforward(rng.normal(size=(100, 6)), rate_hz=50.0)
    outputs, positions = (None, None) if digital is None else (rng.normal(size=(1, 6)), q[:2])
    loop = ClosedLoop.of(
        robot,
        didim.Reference.sampled(q, rate_hz=500.0),
        controller,
        rate_hz=500.0,
        duration_s=1.0,
        step=1e-3,
        fine_step=[1e-4, 1e-4, 2e-4, 2e-4, 5e-4, 5e-4],
        start=(q[0] + 0.01, rng.normal(size=6)),
        external=(10.0, rng.normal(size=(20, 6))),
        memory=ControllerMemory(
            start="torque", values=tuple(rng.normal(size=6)), outputs=outputs, positions=positions
        ),
    ).along(didim.Reference.sampled(q[::5] + 1e-3 * np.sin(np.arange(120))[:, None], rate_hz=100.0))
    assert [limb.joints for limb, _ in loop.limbs] == [(0, 1), (2, 3), (4, 5)]
    assert all(part.n_steps < loop.schedule.steps for _, part in loop.limbs)
    xs, scale = np.stack([x, 1.1 * x, 0.9 * x]), rng.uniform(0.9, 1.1, (3, 6))
    one = np.ones(6)

    def found() -> tuple[list[Array], Array]:
        fine = replace(loop).divided(8)
        arrays, outcomes = fine.run(xs, gain_scale=scale)
        costs, _ = fine.costs(
            xs,
            q[: loop.n_records],
            0.0 * q[: loop.n_records],
            weight_q=one,
            weight_tau=1e-3 * one,
            gain_scale=scale,
        )
        assert all(outcome.completed for outcome in outcomes)
        positions, torques = fine.run(xs, gain_scale=scale, signals=("q", "tau"))[0]
        assert np.array_equal(positions, arrays[0])
        assert np.array_equal(torques, arrays[3])
        return arrays, costs

    apart, costs = found()
    as_a_whole(monkeypatch)
    together, sums = found()
    for one_by_one, whole in zip(apart, together, strict=True):
        np.testing.assert_allclose(one_by_one, whole, rtol=0.0, atol=1e-5 * np.abs(whole).max())
    np.testing.assert_allclose(costs, sums, rtol=1e-5)


def test_a_robot_ends_with_the_first_of_its_limbs(walker: tuple[Experiment, Array]) -> None:
    log, x = walker
    controller = didim.Controller.pd([300.0, 300.0, -90.0, 300.0, -300.0, 300.0], [30.0] * 6)
    loop = ClosedLoop.of(
        log.robot,
        didim.Reference.sampled(log.recordings[0].q, rate_hz=500.0),
        controller,
        rate_hz=500.0,
        divergence=1.0,
    )
    arrays, (outcome,) = loop.run(x[None])
    singly = [part.run(x[None, limb.indices])[1][0] for limb, part in loop.limbs]
    first, second = singly[2].time_s, singly[1].time_s
    assert first is not None
    assert second is not None
    assert first < second
    assert singly[0].completed
    assert outcome == replace(singly[2], joint=5)
    assert np.isnan(arrays[0][0]).all(axis=1).sum() == np.sum(loop.t >= first)
    q = loop.reference.at(loop.t)[0]
    costs, (again,) = loop.costs(x[None], q, 0.0 * q, weight_q=np.ones(6), weight_tau=np.ones(6))
    assert np.isinf(costs[0])
    assert again == outcome


def test_moves_that_arrive_together_are_simulated_together(walker: tuple[Experiment, Array]) -> None:
    log, x = walker
    moves = didim.Reference.point_to_point(
        [[0.0] * 6, [0.1, 0.2, 0.3, 0.1, 0.2, 0.3]], max_velocity=1.0, max_acceleration=5.0
    )
    loop = ClosedLoop.of(log.robot, moves, didim.Controller.pd([300.0] * 6, [30.0] * 6))
    assert loop.limbs == ()
    assert loop.run(x[None])[1][0].completed
    sampled = ClosedLoop.of(
        log.robot,
        didim.Reference.sampled(log.recordings[0].q, rate_hz=500.0),
        loop.controller,
        duration_s=0.1,
    )
    with pytest.raises(SimulationError, match=f"x needs {len(x)} parameters per candidate, got"):
        sampled.run(x[None, :-1])


def test_torques_exchanged_within_and_between_limbs(walker: tuple[Experiment, Array]) -> None:
    job = didim.IDIMLS().job(walker[0])
    system = job.system(job.parts("fit", job.declared_delay))
    y = system.y.reshape(6, -1)
    assert torque_findings(system) == []
    for i, j in itertools.combinations(range(6), 2):
        order = list(range(6))
        order[i], order[j] = j, i
        (finding,) = torque_findings(replace(system, y=y[order].reshape(-1)))
        assert (finding.code, finding.joints, finding.facts["ties"]) == (
            "swapped-torques",
            (i + 1, j + 1),
            [],
        )


@pytest.mark.parametrize(("i", "j"), [(0, 3), (2, 5)])
@pytest.mark.parametrize("of_torques", [False, True])
def test_positions_exchanged_between_limbs(
    walker: tuple[Experiment, Array], i: int, j: int, of_torques: bool
) -> None:
    """Named with and without their torques, at a tenth of a milliradian of noise."""
    log, _ = walker
    order = list(range(6))
    order[i], order[j] = j, i
    (recording,) = log.recordings
    assert recording.tau is not None
    q = recording.q + 1e-4 * np.random.default_rng(0).normal(size=recording.q.shape)
    tau = recording.tau[:, order] if of_torques else recording.tau
    job = didim.IDIMLS().job(replace(log, recordings=(replace(recording, q=q[:, order], tau=tau),)))
    cause = Search(LogRows(job.robot, job.signal, job.parts("fit", job.declared_delay))).cause()
    assert cause is not None
    (tried,) = cause.tried
    code = "swapped-joints" if of_torques else "swapped-positions"
    assert (tried.hypothesis.code, tried.hypothesis.joints) == (code, (i + 1, j + 1))


def test_a_hypothesis_on_limbs_is_screened_there(walker: tuple[Experiment, Array]) -> None:
    """As in the whole robot, whose other torques stay as they are."""
    log, _ = walker
    job = didim.IDIMLS().job(log)
    rows = LogRows(job.robot, job.signal, job.parts("fit", job.declared_delay))
    limbs = limbs_of(rows.robot)
    counts = dict.fromkeys(range(len(limbs) + 1), 0)
    for family in (positions, exchanged, lengths, gravities):
        for item in family(rows):
            concerned = [k for k, limb in enumerate(limbs) if item.within(limb, rows.robot) is not None]
            counts[len(concerned)] += 1
            inside = sorted({(joint - 1) // 2 for joint in item.joints})
            assert concerned == (inside if len(inside) == 1 else [])
            found, whole = rows.rough_ratios(item), rows.screened.ratios(item)
            own = [joint for k in inside for joint in limbs[k].joints] or list(range(rows.n))
            np.testing.assert_allclose(found[own], whole[own], rtol=1e-6)
            assert np.all(np.delete(found, own) == 1.0)
            # The screening of the whole robot is approximate there too.
            np.testing.assert_allclose(np.delete(whole, own), 1.0, rtol=0.02)
    assert counts[0] > 10
    assert counts[1] > 10
    by_two = replace(next(positions(rows)), rate=2.0)
    assert by_two.within(limbs[0], rows.robot) is None
    elsewhere = Hypothesis(code="gain", joints=(1,), factors=np.array([2.0, 1.0, 1.0, 3.0, 1.0, 1.0]))
    assert elsewhere.within(limbs[0], rows.robot) is None
