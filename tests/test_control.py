"""Controllers: the law by hand on a sliding mass, closed forms, sampled laws, and wrong ones refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.errors import ControllerError
from didim.loop.controller import Controller, Digital
from didim.loop.reference import Reference
from didim.loop.simulation import Simulation
from didim.robot.robot import Geometry, Robot
from robots import make_robot

Array = NDArray[np.float64]

MASS = 2.0


def slider(n: int = 1) -> tuple[Robot, Array]:
    """Level slides at right angles, with masses and without friction: each joint is a mass of its own."""
    geometry = Geometry(
        kinds=("prismatic",) * n,
        alpha=(0.0, np.pi / 2)[:n],
        d=(0.0,) * n,
        theta=(0.0,) * n,
        r=(0.0,) * n,
        gravity=(0.0, 0.0, 0.0),
        coupling=tuple(tuple(row) for row in np.eye(n).tolist()),
    )
    robot = make_robot(geometry)
    x = np.zeros(len(robot.parameter_names))
    for joint in range(n):
        x[robot.parameter_names.index(f"Ia{joint + 1}")] = MASS
    return robot, x


def still(seconds: float) -> Reference:
    """Rest at zero."""
    return Reference.sampled(np.zeros((5, 1)), rate_hz=4.0 / seconds)


def wave(seconds: float = 1.0) -> Reference:
    return Reference.fourier([[0.3]], [[0.1]], period_s=1.0, duration_s=seconds)


def slide(
    controller: Controller, reference: Reference, start: float | None = None, **options: Any
) -> Simulation:
    robot, x = slider()
    state = None if start is None else ([start], [0.0])
    settings = {"rate_hz": 100.0, "step": 1e-3, "fine_step": 1e-3, "start": state, "check": False}
    return didim.simulate(robot, x, reference, controller, **{**settings, **options})


def test_the_law_is_what_the_page_says() -> None:
    """Torques of a run, from its own positions and velocities, by the formula."""
    reference = wave()
    controller = Controller.pd(
        [30.0], [4.0], reference_velocity=0.7, acceleration=0.3, gain=5.0, saturation=2.5
    )
    run = slide(controller, reference)
    q, dq, ddq = reference.at(run.t)
    u = 30.0 * (q - run.q) + 4.0 * (0.7 * dq - run.dq) + 0.3 * ddq
    np.testing.assert_allclose(run.tau, 5.0 * np.clip(u, -2.5, 2.5), rtol=0, atol=1e-6)
    # Saturated for a part of the time: the test must see both sides.
    assert 0.05 < np.mean(np.abs(u) > 2.5) < 0.95
    np.testing.assert_allclose(run.ddq, run.tau / MASS, rtol=0, atol=1e-12)


def test_a_tuned_pd_has_its_frequency_and_damping() -> None:
    """Free decay: ``x0 e^(-z w t) (cos(wd t) + z w / wd sin(wd t))``, whatever the drive gain."""
    frequency, damping = 1.5, 0.3
    controller = Controller.tuned([frequency], [damping], [MASS], gain=[7.0], reference_velocity=0.0)
    run = slide(controller, still(2.0), 0.5)
    w = 2.0 * np.pi * frequency
    wd = w * math.sqrt(1.0 - damping**2)
    decay = 0.5 * np.exp(-damping * w * run.t)
    expected = decay * (np.cos(wd * run.t) + damping * w / wd * np.sin(wd * run.t))
    np.testing.assert_allclose(run.q[:, 0], expected, rtol=0, atol=1e-9)


def test_a_pid_is_its_transfer_function() -> None:
    # M s^3 + kv s^2 + kp s + ki = 2 (s + 1)(s + 2)(s + 3)
    run = slide(Controller.pid([22.0], [12.0], [12.0]), still(2.0), 1.0)
    expected = -2.5 * np.exp(-run.t) + 8.0 * np.exp(-2.0 * run.t) - 4.5 * np.exp(-3.0 * run.t)
    np.testing.assert_allclose(run.q[:, 0], expected, rtol=0, atol=1e-9)


def test_a_cascade_with_integral_time_is_its_transfer_function() -> None:
    # u = kv (v + int v / Ti) with v = -kp q - dq: M s^3 + kv s^2 + kv (kp + 1/Ti) s + kv kp / Ti.
    kv, kp, ti = 12.0, 1.25, 1.0 / 0.58
    controller = Controller.cascade([kp], [kv], integral_time_s=[ti])
    roots = np.roots([MASS, kv, kv * (kp + 1.0 / ti), kv * kp / ti])
    # q(0) = 1, q'(0) = 0, q''(0) = -kv kp / M; the integral of v starts at zero.
    amplitudes = np.linalg.solve(np.vander(roots, increasing=True).T, [1.0, 0.0, -kv * kp / MASS])
    run = slide(controller, still(3.0), 1.0)
    expected = (amplitudes * np.exp(np.outer(run.t, roots))).sum(axis=1).real
    np.testing.assert_allclose(run.q[:, 0], expected, rtol=0, atol=1e-9)
    proportional = slide(Controller.cascade([kp], [kv]), wave())
    q, _, _ = wave().at(proportional.t)
    law = kv * (kp * (q - proportional.q) - proportional.dq)
    np.testing.assert_allclose(proportional.tau, law, rtol=0, atol=1e-6)


def test_the_integral_holds_while_the_output_is_saturated() -> None:
    controller = Controller.pid([22.0], [12.0], [30.0], gain=2.0, saturation=0.5)
    run = slide(controller, still(20.0), 1.0)
    assert np.abs(run.tau).max() == 1.0
    # The first second at the limit of 1 N on 2 kg.
    assert run.q[100, 0] == pytest.approx(0.75, abs=1e-9)
    # With windup it would be carried past zero by as much as it came from.
    assert run.q.min() > -0.3
    assert abs(run.q[-1, 0]) < 1e-3


def test_what_is_fed_forward_leaves_nothing_to_the_feedback() -> None:
    """Mass times reference acceleration, by the gain of the acceleration and by a torque: both follow to rounding."""
    reference = wave()
    by_gain = slide(Controller.pd([1.0], [1.0], acceleration=MASS / 3.0, gain=3.0), reference)
    t = np.arange(10_001) / 1e4
    signal = MASS * reference.at(t)[2]
    by_torque = slide(Controller.pd([1.0], [1.0], gain=3.0).with_feedforward(signal, rate_hz=1e4), reference)
    target = reference.at(by_gain.t)[0]
    np.testing.assert_allclose(by_gain.q, target, rtol=0, atol=1e-9)
    # Straight lines between the samples of the signal: 1e-8 of its curvature.
    np.testing.assert_allclose(by_torque.q, target, rtol=0, atol=1e-6)
    without = slide(Controller.pd([1.0], [1.0], gain=3.0), reference)
    assert np.abs(without.q - target).max() > 0.05


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("smoothing", [(1.0,), (0.5, 0.5), (0.5, 0.3, 0.2)])
@pytest.mark.parametrize("resolution", [0.0, 0.02])
def test_a_digital_law_by_hand(delay: int, smoothing: tuple[float, ...], resolution: float) -> None:
    """The difference equation of `u`, and constant acceleration between its samples."""
    T, kp, kv, ki = 0.05, 6.0, 3.0, 2.0
    digital = Digital(
        sample_time_s=T, delay_samples=delay, smoothing=smoothing, resolution=(resolution,) * (resolution > 0)
    )
    controller = Controller.pid([kp], [kv], [ki], reference_velocity=0.5, saturation=1.5, digital=digital)
    reference = wave()
    run = slide(controller, reference, 0.4)
    target, speed, _ = (values[:, 0] for values in reference.at(np.arange(20) * T))
    taps = len(smoothing)
    q, dq, z = 0.4, 0.0, 0.0
    past, outputs = [q] * (taps + 1), [0.0] * (delay + 1)
    for k in range(20):
        seen = round(q / resolution) * resolution if resolution else q
        past = [seen, *past[:taps]]
        smooth = [sum(w * p for w, p in zip(smoothing, past[i:], strict=False)) for i in (0, 1)]
        e = target[k] - seen
        free = kp * e + kv * (0.5 * speed[k] - (smooth[0] - smooth[1]) / T) + ki * z
        u = min(max(free, -1.5), 1.5)
        z += 0.0 if (free - u) * e > 0.0 else T * e
        outputs = [u, *outputs[:delay]]
        acting = outputs[delay]
        # The output holds from its sample to the next: records are 10 ms apart, samples 50 ms.
        np.testing.assert_allclose(run.tau[5 * k : 5 * k + 5, 0], acting, rtol=0, atol=1e-9)
        assert run.q[5 * k, 0] == pytest.approx(q, abs=1e-9)
        q, dq = q + T * dq + 0.5 * acting / MASS * T**2, dq + acting / MASS * T


def test_controller_and_records_may_have_any_rates() -> None:
    """Samples of the controller at 3 ms, records at 10 ms: the torque at a record is that of the last sample before it."""
    digital = Digital(sample_time_s=3e-3)
    controller = Controller.pd([30.0], [4.0], digital=digital)
    coarse = slide(controller, wave(), rate_hz=100.0)
    fine = slide(controller, wave(), rate_hz=1000.0)
    np.testing.assert_allclose(coarse.tau, fine.tau[::10], rtol=0, atol=1e-9)
    changes = np.flatnonzero(np.diff(fine.tau[:, 0]))
    assert np.all((changes + 1) % 3 == 0)
    assert len(changes) > 300


def test_joints_have_laws_of_their_own() -> None:
    robot, x = slider(2)
    reference = Reference.sampled(np.zeros((5, 2)), rate_hz=4.0)
    controller = Controller.pd([20.0, 5.0], [3.0, 1.0], gain=[1.0, 2.0], saturation=[math.inf, 1.0])
    run = didim.simulate(robot, x, reference, controller, start=([0.5, 0.5], [0.0, 0.0]), rate_hz=100.0)
    law = np.array([20.0, 5.0]) * -run.q + np.array([3.0, 1.0]) * -run.dq
    law[:, 1] = 2.0 * np.clip(law[:, 1], -1.0, 1.0)
    np.testing.assert_allclose(run.tau, law, rtol=0, atol=1e-9)


def test_a_scale_of_the_gains_leaves_what_is_fed_forward_by_torque() -> None:
    reference = wave()
    signal = np.full((3, 1), 0.8)
    base = Controller.pd([30.0], [4.0]).with_feedforward(signal, rate_hz=1.0)
    scaled = slide(base, reference, gain_scale=[2.5])
    by_hand = slide(Controller.pd([75.0], [10.0]).with_feedforward(signal, rate_hz=1.0), reference)
    np.testing.assert_allclose(scaled.tau, by_hand.tau, rtol=0, atol=1e-9)


ONE = [1.0, 1.0]


def digital(**changes: Any) -> Digital:
    return Digital(**{"sample_time_s": 1e-3, **changes})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Controller.pd(ONE, [1.0] * 3), "kp needs 3 numbers, one per joint, got 2"),
        (lambda: Controller.pd([1.0, math.nan], ONE), "kp must be finite, got [1.0, nan]"),
        (lambda: Controller.pd(ONE, [1.0, math.inf]), "kv must be finite, got [1.0, inf]"),
        (lambda: Controller.pd([ONE], ONE), "kp needs one number per joint, got an array of shape (1, 2)"),
        (lambda: Controller.pd([], []), "kp needs 1 numbers, one per joint, got 0"),
        (lambda: Controller.pd("a", 1.0), "kp must be an array of real numbers"),
        (lambda: Controller.pd(ONE, ONE, gain=0.0), "the drive gain of joint 1 is zero"),
        (lambda: Controller.pd(ONE, ONE, gain=[1.0] * 3), "gain needs 2 numbers, one per joint, got 3"),
        (lambda: Controller.pd(ONE, ONE, saturation=[1.0, 0.0]), "the saturation of joint 2 must be positive"),
        (lambda: Controller.pd(ONE, ONE, saturation=math.nan), "saturation must be finite, got nan"),
        (lambda: Controller.pid(ONE, ONE, [1.0] * 3), "kp needs 3 numbers, one per joint, got 2"),
        (lambda: Controller.cascade(ONE, ONE, integral_time_s=0.0), "integral_time_s must be positive, got"),
        (lambda: Controller.tuned([1.0, -1.0], 0.7, ONE), "natural_frequency_hz must be positive, got [1.0, -1"),
        (lambda: Controller.tuned([1e308, 1.0], 0.7, ONE), "kp must be finite, got [inf, "),
        (lambda: Controller.tuned(ONE, 0.0, ONE), "damping must be positive, got [0.0, 0.0]"),
        (lambda: Controller.tuned(ONE, 0.7, [1.0, -2.0]), "inertia must be positive, got [1.0, -2.0]"),
        (lambda: Controller.tuned(ONE, 0.7, ONE, gain=0.0), "gain must not be zero, got [0.0, 0.0]"),
        (lambda: Controller.tuned(ONE, 0.7, ONE, gain=[1.0] * 3), "gain needs 2 numbers, one per joint, got 3"),
        (lambda: fed(np.zeros((5, 3))), "tau must have shape (n_samples, 2), got (5, 3)"),
        (lambda: fed(np.zeros(5)), "tau must have shape (n_samples, 2), got (5,)"),
        (lambda: fed(np.zeros((0, 2))), "tau must have shape (n_samples, 2), got (0, 2)"),
        (lambda: fed(np.full((5, 2), math.nan)), "NaN at sample 1, column 1"),
        (lambda: fed(np.zeros((5, 2)), rate_hz=-1.0), "needs a positive rate"),
        (lambda: digital(sample_time_s=0.0), "sample_time_s must be positive, got 0"),
        (lambda: digital(sample_time_s=math.nan), "sample_time_s must be positive, got nan"),
        (lambda: digital(delay_samples=-1), "delay_samples must be 0 to 1000, got -1"),
        (lambda: digital(delay_samples=1.5), "delay_samples must be an integer, got 1.5"),
        (lambda: digital(smoothing=()), "smoothing needs one or more finite weights"),
        (lambda: digital(smoothing=(1.0, math.nan)), "smoothing needs one or more finite weights"),
        (lambda: digital(smoothing=1.0), "smoothing must be a list of numbers, got 1.0"),
        (lambda: digital(resolution="fine"), "resolution must be an array of real numbers"),
        (lambda: digital(resolution=(-1.0,)), "resolution must be finite and not negative, got [-1.0]"),
        (
            lambda: Controller.pd(ONE, ONE, digital=digital(resolution=(1.0,) * 3)),
            "resolution needs 2 entries, one per joint, got 3",
        ),
    ],
)  # fmt: skip
def test_a_wrong_controller_is_one_sentence(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ControllerError) as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def fed(tau: Array, rate_hz: float = 10.0) -> Controller:
    return Controller.pd(ONE, ONE).with_feedforward(tau, rate_hz=rate_hz)
