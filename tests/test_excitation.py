"""Designed motions: gradients, limits, criteria, earlier information, and the circle from a design to its parameters."""

from __future__ import annotations

import _thread
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
import didim._core as _core
from didim._tools.arrays import Array
from didim.errors import ExcitationError
from didim.excitation.clearance import Clearance, Workspace
from didim.excitation.criterion import criterion, log_determinant
from didim.excitation.design import Excitation, standard_deviations
from didim.excitation.excite import excite
from didim.excitation.limits import motion_limits
from didim.excitation.points import PointDesign, _Move
from didim.excitation.prior import noise_from, prior_information
from didim.excitation.problem import FINE, Information, Problem
from didim.excitation.ramps import ramp
from didim.excitation.series import ScaledSeries, SeriesBasis
from didim.excitation.settings import ExcitationSettings
from didim.log.recording import Recording
from didim.robot.collision import Capsule
from didim.robot.robot import Robot
from pickling_executor import Pickling
from robots import random_motion
from scripts import script

SMALL: dict[str, Any] = {
    "duration_s": 4.0,
    "harmonics": 5,
    "iterations": 60,
    "starts": 2,
    "acceleration": 20.0,
    "torque_noise": (0.4, 0.2),
    "rate_hz": 200.0,
}
"""A design for the planar arm that takes a fraction of a second."""


@pytest.fixture(scope="module")
def planar() -> Robot:
    return didim.load_robot("planar2")


@pytest.fixture(scope="module")
def design(planar: Robot) -> Excitation:
    return excite(planar, ExcitationSettings(**SMALL, parameters="reference"))


def smooth(robot: Robot) -> Robot:
    return robot.with_smoothing([0.1] * robot.n_dof)


@pytest.mark.parametrize("model", ["symmetric", "asymmetric"])
def test_the_information_is_that_of_the_regressor_and_the_gradient_its_difference(
    planar: Robot, model: str
) -> None:
    robot = smooth(planar.with_friction(model=model))
    states = random_motion(np.random.default_rng(3), 37, 2)
    q, dq, ddq = states.q, states.dq, states.ddq
    columns = list(robot.base_parameters.indices)
    weights = np.array([2.0, 7.0])
    w = didim.regressor(robot, q, dq, ddq)[:, :, columns]
    matrix = _core.information(robot.core, q, dq, ddq, columns, weights)
    np.testing.assert_allclose(matrix, np.einsum("sia,i,sib->ab", w, weights, w), rtol=1e-11, atol=1e-11)
    rng = np.random.default_rng(0)
    derivative = rng.normal(size=matrix.shape)
    derivative = derivative + derivative.T
    x, torque_weights = rng.normal(size=len(robot.parameter_names)), rng.normal(size=q.shape)

    def value(q: Array, dq: Array, ddq: Array) -> float:
        torques = didim.inverse_dynamics(robot, q, dq, ddq, x)
        found = _core.information(robot.core, q, dq, ddq, columns, weights)
        return float((found * derivative).sum() + (torques * torque_weights).sum())

    gradient = _core.information_gradient(
        robot.core, q, dq, ddq, columns, weights, derivative, torque_weights, x
    )
    step = 1e-6
    for kind, slopes in enumerate(gradient):
        change = rng.normal(size=q.shape)
        sides = []
        for sign in (1.0, -1.0):
            motion = [q, dq, ddq]
            motion[kind] = motion[kind] + sign * step * change
            sides.append(value(*motion))
        assert float((slopes * change).sum()) == pytest.approx((sides[0] - sides[1]) / (2.0 * step), rel=1e-6)


def test_the_core_refuses_arrays_that_do_not_fit(planar: Robot) -> None:
    q = np.zeros((3, 2))
    with pytest.raises(ValueError, match="column 99 does not exist"):
        _core.information(planar.core, q, q, q, [99], np.ones(2))
    with pytest.raises(ValueError, match="weights has 3 numbers where 2 are needed"):
        _core.information(planar.core, q, q, q, [0], np.ones(3))
    with pytest.raises(ValueError, match="the derivative has 4 numbers where 1 are needed"):
        _core.information_gradient(planar.core, q, q, q, [0], np.ones(2), np.ones((2, 2)))


@pytest.mark.parametrize("start", [None, (0.3, -0.5)])
@pytest.mark.parametrize("name", ["information", "condition", "some"])
def test_the_gradient_of_the_problem_is_its_difference(
    planar: Robot, start: tuple[float, float] | None, name: str
) -> None:
    limits = motion_limits(
        planar, ExcitationSettings(acceleration=20.0, jerk=500.0, torque=[25.0, 9.0], margin=1.0)
    )
    basis = SeriesBasis(period_s=4.0, harmonics=5)
    series = ScaledSeries(basis, limits, None if start is None else np.array(start), True)
    names = planar.base_parameters.names
    information = Information(
        robot=smooth(planar), sigma=np.array([0.4, 0.2]), samples=800.0, prior=0.1 * np.eye(len(names))
    )
    capsules = [
        Capsule(link=0, start=(0.0, 0.0, 0.0), end=(0.3, 0.0, 0.1), radius=0.1),
        Capsule(link=2, start=(0.0, 0.0, 0.0), end=(0.4, 0.0, 0.0), radius=0.05),
    ]
    clearance = Clearance(planar, capsules, Workspace(lowest=(-0.5, -0.4, -1.0), highest=(0.7, 0.6, 1.0)))
    chosen = criterion(
        "condition" if name == "condition" else "information", np.array([0, 3]) if name == "some" else None
    )
    problem = Problem(series, information, chosen, planar.parameter_set("reference"), clearance)
    rng = np.random.default_rng(1)
    for power, thinning in ((8, 1), (64, 1), (64, 4)):
        series.power, problem.thinning = power, thinning
        for _ in range(3):
            v = rng.normal(size=series.size)
            change = rng.normal(size=series.size)
            _, gradient = problem.value(v, 10.0)
            step = 1e-6
            sides = [problem.value(v + sign * step * change, 10.0)[0] for sign in (1.0, -1.0)]
            assert float(gradient @ change) == pytest.approx(
                (sides[0] - sides[1]) / (2.0 * step), rel=2e-4, abs=1e-4
            )


def test_every_set_of_variables_is_at_rest_at_its_ends_and_within_the_limits(planar: Robot) -> None:
    limits = motion_limits(planar, ExcitationSettings(acceleration=20.0, jerk=300.0, margin=1.0))
    series = ScaledSeries(SeriesBasis(period_s=4.0, harmonics=5), limits, None, True)
    rng = np.random.default_rng(2)
    for _ in range(20):
        found, _ = series.build(3.0 * rng.normal(size=series.size))
        q, dq, ddq, jerk = found.motion()
        np.testing.assert_allclose(q[0], found.offset, atol=1e-12)
        np.testing.assert_allclose([dq[0], ddq[0]], 0.0, atol=1e-11)
        assert max(values.max() for values in limits.use(q, dq, ddq, jerk).values()) <= 1.0 + 1e-12


def test_a_design_keeps_every_limit_on_times_of_its_own(planar: Robot, design: Excitation) -> None:
    """The motion that is played, at a rate that has nothing to do with the optimiser's grid."""
    t, q, dq, ddq = design.sampled(1234.5)
    limits = design.limits
    torques = np.abs(didim.inverse_dynamics(planar, q, dq, ddq, planar.parameter_set("reference")))
    assert (q >= limits.lowest).all()
    assert (q <= limits.highest).all()
    assert (np.abs(dq).max(axis=0) <= limits.velocity).all()
    assert (np.abs(ddq).max(axis=0) <= limits.acceleration).all()
    assert (torques.max(axis=0) <= limits.torque * (1.0 + 1e-3)).all()
    # And each joint is near one of them.
    assert (np.max(list(design.use.values()), axis=0) > 0.97 * 0.9).all()
    # Shares are those of the limits that were given, of which the margin leaves 90 %.
    assert max(values.max() for values in design.use.values()) <= 0.9
    assert limits.whole.velocity == pytest.approx([limit.velocity for limit in planar.limits])
    assert t[-1] == pytest.approx(4.0, abs=1.0 / 1234.5)
    np.testing.assert_allclose([q[0], q[-1]], [q[0]] * 2, atol=1e-6)
    np.testing.assert_allclose([dq[0], ddq[0]], 0.0, atol=1e-6)


def test_a_design_halves_the_standard_deviations_of_a_random_motion(design: Excitation) -> None:
    assert design.ratio < 0.7
    assert design.log_det > design.random_log_det + 5.0
    assert design.std.shape == design.random_std.shape == (len(design.names),)
    text = str(design)
    assert f"standard deviations are {design.ratio:.2f} of those of the random motion" in text
    assert "use of limits %" in text
    assert "(the margin leaves 90 % of each limit)" in text
    assert "ZZ1R" in text


def test_the_result_does_not_depend_on_the_number_of_threads(planar: Robot) -> None:
    settings = ExcitationSettings(**(SMALL | {"iterations": 15, "starts": 3}), parameters="reference")
    one, two = (excite(planar, replace(settings, threads=threads)) for threads in (1, 2))
    for a, b in zip(one.sampled(), two.sampled(), strict=True):
        np.testing.assert_array_equal(a, b)
    assert one.starts == two.starts


def test_an_executor_gives_the_same_design_as_threads(planar: Robot) -> None:
    # Threads that send what other processes would be sent.
    settings = ExcitationSettings(**(SMALL | {"iterations": 15, "starts": 2}), parameters="reference")
    with Pickling(2) as executor:
        one, two = excite(planar, settings), excite(planar, settings, executor=executor)
    assert executor.calls == 2
    for a, b in zip(one.sampled(), two.sampled(), strict=True):
        np.testing.assert_array_equal(a, b)
    assert one.starts == two.starts


def test_a_small_tx40_design_beats_the_random_motion() -> None:
    robot = didim.load_robot("tx40")
    settings = ExcitationSettings(
        harmonics=8,
        iterations=60,
        starts=1,
        position=[(-reach, reach) for reach in (2.6, 1.8, 2.0, 3.5, 1.9, 4.0)],
        acceleration=[25, 25, 35, 60, 60, 90],
        torque_noise=[0.5, 0.5, 0.2, 0.1, 0.1, 0.1],
    )
    assert excite(robot, settings).ratio < 0.6


@pytest.mark.slow
def test_wanted_parameters_get_better_at_the_cost_of_the_others(planar: Robot) -> None:
    names = ("Fv1", "Fv2")
    settings = ExcitationSettings(**(SMALL | {"iterations": 200}), parameters="reference")
    design, some = excite(planar, settings), excite(planar, replace(settings, wanted=names))
    columns = [design.names.index(name) for name in names]
    assert np.log(some.std[columns]).sum() < np.log(design.std[columns]).sum() - 0.01
    assert some.log_det < design.log_det


def test_the_condition_number_is_smaller_when_it_is_asked_for(planar: Robot, design: Excitation) -> None:
    settings = ExcitationSettings(**SMALL, parameters="reference", criterion="condition")
    found = excite(planar, settings)
    assert found.condition_number < design.condition_number
    assert found.log_det < design.log_det


def recorded(robot: Robot, design: Excitation, still: int | None = None) -> didim.Experiment:
    """A log of a design without a controller: torques of the model with noise; one joint may stand still."""
    _, q, dq, ddq = design.sampled(500.0)
    if still is not None:
        q[:, still], dq[:, still], ddq[:, still] = 0.2, 0.0, 0.0
    noise = np.random.default_rng(5).normal(size=q.shape) * [0.4, 0.2]
    tau = didim.inverse_dynamics(robot, q, dq, ddq, robot.parameter_set("reference")) + noise
    return didim.Experiment(
        name="log",
        robot=robot,
        recordings=(Recording.from_arrays(q, tau, rate_hz=500.0),),
        signal=didim.SignalProcessing(cutoff_hz=60.0, trim_start=20, trim_end=20, decimation=(10,)),
    )


def test_a_log_without_a_joint_makes_the_next_design_move_that_joint(
    planar: Robot, design: Excitation
) -> None:
    robot = smooth(planar)
    poor = recorded(robot, design, still=1)
    sigma = np.array([0.4, 0.2])
    information = prior_information(poor, robot, sigma, 500.0)
    assert np.linalg.matrix_rank(information, hermitian=True, tol=1e-6) < len(information)
    settings = ExcitationSettings(**(SMALL | {"rate_hz": 500.0}), parameters="reference", prior=(poor,))
    second = excite(robot, settings)
    assert np.ptp(second.sampled()[1][:, 1]) > 2.0
    # Both logs together are worth nearly as much as two.
    fresh = excite(robot, replace(settings, prior=(), periods=2))
    assert np.exp(np.mean(np.log(second.std / fresh.std))) < 1.3


def test_a_result_is_worth_the_inverse_of_its_covariance(planar: Robot, design: Excitation) -> None:
    robot = smooth(planar)
    fit = didim.identify(recorded(robot, design))
    information = prior_information(fit, robot, np.ones(2), 1.0)
    np.testing.assert_allclose(information @ fit.covariance, np.eye(len(fit.names)), atol=1e-5)
    settings = ExcitationSettings(**(SMALL | {"iterations": 5}), prior=(fit,))
    assert (excite(robot, settings).std < fit.std).all()


def test_a_prior_of_another_robot_is_refused(planar: Robot, design: Excitation) -> None:
    fit = didim.identify(recorded(smooth(planar), design))
    other = planar.with_friction(model="asymmetric")
    with pytest.raises(ExcitationError, match="Fv1\\+ is not a base parameter of both it and 'planar2'"):
        excite(other, ExcitationSettings(**SMALL, prior=(fit,)))
    with pytest.raises(ExcitationError, match="with other parameters than robot 'planar2'"):
        excite(other, ExcitationSettings(**SMALL, prior=(recorded(planar, design),)))


def test_terms_of_temperature_are_left_out_of_a_design_with_a_remark(
    planar: Robot, design: Excitation
) -> None:
    """Their columns are zero at the reference temperature."""
    warm = planar.with_friction(temperature_viscous=[1])
    settings = ExcitationSettings(**(SMALL | {"iterations": 2}), parameters="reference")
    prior = replace(recorded(planar, design), robot=warm)
    found = excite(warm, replace(settings, prior=(prior,)))
    expected = excite(planar, replace(settings, prior=(recorded(planar, design),)))
    assert found.names == expected.names
    np.testing.assert_array_equal(found.std, expected.std)
    assert any("terms of temperature are left out" in remark for remark in found.remarks)


def test_the_noise_of_an_earlier_log_is_found(planar: Robot, design: Excitation) -> None:
    sigma = noise_from(recorded(smooth(planar), design), smooth(planar), 500.0)
    np.testing.assert_allclose(sigma, [0.4, 0.2], rtol=0.3)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"start": (3.5, 0.0)}, r"the start of joint 1 is 3\.5, outside what its limits leave it"),
        ({"position": [(1.0, 1.0), (-1.0, 1.0)]}, r"joint 1 has no room: its positions are limited to \[1, 1\]"),
        ({"velocity": (1.0, 0.0)}, "the velocity limit of joint 2 must lie between 1e-09 and"),
        ({"torque": 0.5, "position": [(-0.2, 0.2)] * 2}, "the limits leave no room: in none of 2000 random poses"),
        (
            {"torque": (15.0, 25.0), "start": (0.0, 0.0)},
            "the robot cannot rest at its start: joint 1 needs 21.* where at most 13.5",
        ),
        ({"wanted": ("FV1",)}, "has no base parameter 'FV1'; did you mean 'Fv1'"),
        ({"torque_noise": (1.0, 0.0)}, "torque_noise needs one positive number or 2, one per joint"),
        ({"home": (0.0,)}, "home needs 2 numbers, one per joint"),
        ({"friction": {"load": [2]}}, "the load friction of joint 2 depends on the torques that are still to be identified"),
        ({"friction": {"dead_zone_rad_s": 1e18}}, "the friction of robot 'planar2' hides Fc1: its dead zone"),
        ({"torque_noise": 1e300}, r"torque_noise needs .* at most 1e\+30, got 1e\+300"),
        ({"acceleration": 1e-320}, "the acceleration limit of joint 1 must lie between 1e-09 and 1e"),
        ({"parameters": {"Fv1": 2e30}}, r"the parameter Fv1 of the design is 2e\+30, beyond 1e\+30"),
    ],
)  # fmt: skip
def test_limits_without_room_get_one_sentence(planar: Robot, settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ExcitationError, match=sentence):
        excite(planar, ExcitationSettings(**(SMALL | {"parameters": "reference"} | settings)))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"harmonics": 3}, "harmonics must be a whole number from 4 to 200, got 3"),
        ({"kind": "chirp"}, "kind must be 'fourier' or 'point-to-point', got 'chirp'"),
        ({"criterion": "trace"}, "criterion must be 'information' or 'condition', got 'trace'"),
        ({"points": 300_000}, "points must be a whole number from 2 to 1000, got 300000"),
        ({"starts": 0}, "starts must be a whole number from 1 to 10000, got 0"),
        ({"duration_s": -1.0}, r"duration_s must be a positive number, got -1\.0"),
        ({"log_rate_hz": 1e-320}, r"log_rate_hz must be at least 0\.001"),
        ({"rate_hz": 1e7}, r"10 s at 1e\+07 Hz are 1e\+08 samples, where at most 2e\+06 are designed"),
        ({"smoothing": 1e6}, "smoothing must be at most 100 rad/s or m/s"),
        ({"wanted": ("Fv1",), "criterion": "condition"}, "the condition number is one of all parameters"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ExcitationError, match=sentence):
        ExcitationSettings(**settings)


def test_points_that_are_dwelt_on_for_days_are_too_many_samples(planar: Robot) -> None:
    settings = {
        "kind": "point-to-point",
        "points": 3,
        "dwell_s": 1e5,
        "rate_hz": 100.0,
        "parameters": "reference",
    }
    with pytest.raises(ExcitationError, match="samples, where at most"):
        excite(planar, ExcitationSettings(**(SMALL | settings)))


def test_a_robot_without_limits_is_asked_for_them() -> None:
    with pytest.raises(ExcitationError, match="robot 'gen3' has no position limits for joint 1"):
        excite("gen3")


def test_what_is_assumed_is_said(planar: Robot) -> None:
    settings = ExcitationSettings(duration_s=4.0, harmonics=5, iterations=2, starts=1)
    remarks = " ".join(excite(planar, settings).remarks)
    for words in (
        "no acceleration limits are known",
        "torque limits are not checked",
        "the noise of the torques is taken as",
    ):
        assert words in remarks


def test_an_interrupted_search_keeps_the_best_motion(planar: Robot, ctrl_c: None) -> None:
    interrupted: list[float] = []

    def progress(start: int, evaluations: int, value: float) -> None:
        if evaluations == 20 and not interrupted:
            interrupted.append(value)
            _thread.interrupt_main()

    settings = ExcitationSettings(**(SMALL | {"iterations": 20_000, "starts": 1}), parameters="reference")
    found = excite(planar, settings, progress=progress)
    assert found.interrupted
    assert "interrupted: the best motion so far" in str(found)
    assert max(values.max() for values in found.use.values()) <= 0.9


def test_periods_and_ramps_are_smooth_and_within_the_limits(planar: Robot) -> None:
    settings = ExcitationSettings(
        **(SMALL | {"iterations": 10}), periods=3, home=(-1.0, 0.4), parameters="reference"
    )
    found = excite(planar, settings)
    t, q, dq, ddq = found.sampled()
    before, after = found.ramps
    assert before is not None
    assert after is not None
    assert t[-1] == pytest.approx(12.0 + before.duration + after.duration, abs=0.01)
    np.testing.assert_allclose([q[0], q[-1]], [[-1.0, 0.4]] * 2, atol=1e-9)
    np.testing.assert_allclose(dq[[0, -1]], 0.0, atol=1e-9)
    # Derivatives are those of the positions, over the seams too.
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[1:-1], dq[1:-1], atol=0.02)
    np.testing.assert_allclose(np.gradient(dq, t, axis=0)[1:-1], ddq[1:-1], atol=0.8)
    assert (np.abs(dq) <= found.limits.velocity * 1.001).all()
    torques = np.abs(didim.inverse_dynamics(planar, q, dq, ddq, planar.parameter_set("reference")))
    assert (torques <= found.limits.torque * 1.001).all()


def test_a_ramp_through_an_obstacle_is_refused(planar: Robot) -> None:
    limits = motion_limits(planar, ExcitationSettings(acceleration=20.0, margin=1.0))
    clearance = Clearance(planar, (), Workspace(highest=(0.3, 1.0, 1.0)))
    with pytest.raises(
        ExcitationError, match="comes too near: link 2 and the wall at x = 0\\.3 m; give another home"
    ):
        ramp(np.array([-2.0, 0.0]), np.array([2.0, 0.0]), limits, clearance, lambda *_: None)
    assert ramp(np.zeros(2), np.zeros(2), limits, clearance, lambda *_: None) is None


def test_a_motion_from_point_to_point_is_chosen_well(planar: Robot) -> None:
    settings = ExcitationSettings(
        kind="point-to-point",
        points=8,
        starts=1,
        acceleration=20.0,
        torque_noise=(0.4, 0.2),
        parameters="reference",
    )
    found = excite(planar, settings)
    assert found.ratio < 0.95
    assert found.log_det > found.random_log_det + 1.0
    assert max(values.max() for values in found.use.values()) <= 0.9 + 1e-9
    _, q, dq, ddq = found.sampled(5000.0)
    torques = np.abs(didim.inverse_dynamics(planar, q, dq, ddq, planar.parameter_set("reference")))
    assert (torques.max(axis=0) <= found.limits.torque).all()
    # Torques are what bounds this motion: a grid of 100 Hz would let some of them pass.
    assert (torques.max(axis=0) / found.limits.torque).max() > 0.95
    assert (np.abs(dq).max(axis=0) > 0.5 * found.limits.velocity).all()
    np.testing.assert_allclose(dq[[0, -1]], 0.0, atol=1e-9)
    assert len(np.asarray(found.tables["points_rad"])) == 8
    assert q.shape[1] == 2


def test_points_that_break_a_limit_between_the_samples_are_not_exchanged(
    planar: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every exchange asks for the fine grid: where that refuses all moves, the random points stay."""
    exchange, asked = PointDesign._exchange, list[int]()

    def refused(design: PointDesign, a: Array, b: Array) -> bool:
        asked.append(1)
        return False

    def watched(design: PointDesign, *rest: Any) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(PointDesign, "verified", refused)
            exchange(design, *rest)

    monkeypatch.setattr(PointDesign, "_exchange", watched)
    settings = ExcitationSettings(kind="point-to-point", points=4, starts=1, acceleration=20.0)
    found = excite(planar, settings)
    assert asked
    assert found.log_det == found.random_log_det


def test_points_cannot_keep_a_jerk_limit(planar: Robot) -> None:
    settings = ExcitationSettings(kind="point-to-point", acceleration=20.0, jerk=300.0)
    with pytest.raises(ExcitationError, match="trapezoidal velocities, whose jerk has no bound"):
        excite(planar, settings)


def test_an_interrupted_exchange_of_points_keeps_the_best(
    planar: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    best: list[float] = []
    known = PointDesign.value

    def value(design: PointDesign, moves: Sequence[_Move]) -> float:
        found = known(design, moves)
        best.append(max([found, *best[-1:]]))
        if len(best) == 40:
            raise KeyboardInterrupt
        return found

    monkeypatch.setattr(PointDesign, "value", value)
    settings = ExcitationSettings(
        kind="point-to-point", points=8, starts=3, acceleration=20.0, torque_noise=0.3, parameters="reference"
    )
    found = excite(planar, settings)
    assert found.interrupted
    assert "interrupted: the best motion so far" in str(found)
    # One start only, and all that it had gained before the interruption.
    assert found.starts == pytest.approx((best[38],))
    assert found.log_det > found.random_log_det


def test_weak_parameters_are_named_with_the_reason(planar: Robot) -> None:
    settings = ExcitationSettings(
        **(SMALL | {"torque_noise": (40.0, 20.0), "iterations": 5}), parameters="reference"
    )
    sentences = excite(planar, settings).weak()
    assert any("small beside the noise" in sentence for sentence in sentences)
    assert not any("nan" in sentence for sentence in sentences)
    assert any(sentence.startswith("weak: ") and "Off1" in sentence for sentence in sentences)
    # In a narrow range gravity and offset are hardly told apart.
    narrow = replace(settings, position=[(0.0, 0.3), (0.0, 0.3)], parameters=None)
    assert any("hardly separates it from" in sentence for sentence in excite(planar, narrow).weak())


def test_limits_are_verified_on_a_grid_twenty_times_finer() -> None:
    assert FINE == 20
    basis = SeriesBasis(period_s=1.0, harmonics=4)
    assert len(basis.derivatives(FINE * basis.samples)[0]) == 20 * len(basis.grid[0])


@pytest.mark.slow
@pytest.mark.usefixtures("unjudged")
def test_the_example_goes_full_circle(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sigma as predicted; the error over sigma is one seed's."""
    done = script(project / "examples" / "tx40_excitation.py")
    capsys.readouterr()
    ratio = np.median(done.fit.std / done.design.std)
    assert 0.9 < ratio < 1.1
    assert np.sqrt(np.mean(done.error**2)) < 1.3
    assert done.design.ratio < 0.52


@pytest.mark.filterwarnings("error")
def test_a_parameter_that_the_motion_does_not_show_is_weak(design: Excitation) -> None:
    unseen = design.information.copy()
    unseen[0], unseen[:, 0] = 0.0, 0.0
    found = replace(design, information=unseen)
    assert found.std[0] > 1e7
    np.testing.assert_allclose(found.std[1:], standard_deviations(unseen[1:, 1:]), rtol=1e-6)
    assert any(design.names[0] in sentence for sentence in found.weak())
    assert any(design.names[0] in sentence for sentence in replace(found, x=None).weak())
    assert str(found)


@pytest.mark.parametrize("pair", [0.5, 1.0 - 1e-14])
def test_information_near_the_smallest_numbers_gives_no_warning(pair: float) -> None:
    """A regular and a nearly singular matrix; warnings are errors in tests."""
    scale = np.array([1e-155, 1e-155, 1.0])
    unit = np.array([[1.0, pair, 0.0], [pair, 1.0, 0.0], [0.0, 0.0, 1.0]])
    value, inverse = log_determinant(unit * np.outer(scale, scale))
    assert np.isfinite(value)
    assert inverse[2, 2] == pytest.approx(1.0)


def test_the_packaged_tx40_has_the_limits_of_its_maker() -> None:
    """A motion can be designed for it without further limits."""
    whole = motion_limits(didim.load_robot("tx40"), ExcitationSettings(margin=1.0))
    np.testing.assert_allclose(np.degrees(whole.lowest), [-180, -125, -138, -270, -120, -270], atol=1e-4)
    np.testing.assert_allclose(np.degrees(whole.highest), [180, 125, 138, 270, 133.5, 270], atol=1e-4)
    settings = ExcitationSettings(duration_s=4.0, harmonics=4, iterations=1, starts=1)
    q = excite("tx40", settings).sampled(50.0)[1]
    assert np.all((q > whole.lowest) & (q < whole.highest))
