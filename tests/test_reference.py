"""References: samples, Fourier series and point to point against closed forms, limits kept, wrong ones refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from didim.errors import ReferenceError
from didim.loop.reference import Reference

Array = NDArray[np.float64]


def test_samples_of_a_polynomial_of_fourth_degree_are_met_everywhere() -> None:
    polynomials = [
        np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.5, -0.7]),
        np.polynomial.Polynomial([1.0, 2.0]),
    ]
    t = np.arange(21) / 10.0
    reference = Reference.sampled(np.column_stack([p(t) for p in polynomials]), rate_hz=10.0)
    assert (reference.n_dof, reference.kind) == (2, "sampled")
    assert reference.duration == pytest.approx(2.0, abs=1e-14)
    between = np.linspace(0.0, 2.0, 333)
    for order, values in enumerate(reference.at(between)):
        expected = np.column_stack([p.deriv(order)(between) if order else p(between) for p in polynomials])
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-9)


def test_a_sampled_motion_passes_its_samples_with_continuous_acceleration() -> None:
    t = np.arange(200) / 100.0
    q = np.column_stack([np.sin(7.0 * t), np.cos(3.0 * t)])
    reference = Reference.sampled(q, rate_hz=100.0)
    np.testing.assert_allclose(reference.at(t)[0], q, rtol=0, atol=1e-14)
    # The least of a time step to either side of each inner sample.
    before, after = (reference.at(t[1:-1] + side * 1e-9)[2] for side in (-1.0, 1.0))
    np.testing.assert_allclose(before, after, rtol=0, atol=1e-4)
    np.testing.assert_allclose(after[2:-2, 0], -49.0 * q[3:-3, 0], rtol=0, atol=1e-2)


def test_velocities_and_accelerations_are_derivatives() -> None:
    reference = Reference.sampled(np.random.default_rng(0).standard_normal((20, 3)), rate_hz=10.0)
    t, h = np.linspace(0.013, 1.88, 50), 1e-6
    q, dq, _ = (
        np.subtract(a, b) / (2.0 * h) for a, b in zip(reference.at(t + h), reference.at(t - h), strict=True)
    )
    _, velocity, acceleration = reference.at(t)
    np.testing.assert_allclose(q, velocity, rtol=0, atol=1e-6)
    np.testing.assert_allclose(dq, acceleration, rtol=0, atol=1e-4)


def test_a_fourier_series_is_its_sum() -> None:
    rng = np.random.default_rng(1)
    sine, cosine = rng.standard_normal((2, 5, 3))
    offset = np.array([0.1, -0.2, 0.3])
    reference = Reference.fourier(sine, cosine, period_s=2.5, offset=offset, duration_s=4.0)
    assert reference.duration == 4.0
    t = np.linspace(0.0, 4.0, 777)
    w = 2.0 * np.pi * np.arange(1, 6) / 2.5
    s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    expected = (
        offset + s @ sine + c @ cosine,
        (c * w) @ sine - (s * w) @ cosine,
        -(s * w**2) @ sine - (c * w**2) @ cosine,
    )
    for got, want, room in zip(reference.at(t), expected, (1e-9, 1e-7, 1e-4), strict=True):
        np.testing.assert_allclose(got, want, rtol=0, atol=room)
    assert Reference.fourier(sine, cosine, period_s=2.5).duration == 2.5


LIMITS = {
    "max_position": np.array([2.6, 1.8, 0.5]),
    "max_velocity": np.array([4.5, 4.5, 1.0]),
    "max_acceleration": np.array([25.0, 10.0, 60.0]),
}


def test_a_random_series_starts_at_rest_and_meets_one_limit_of_each_joint() -> None:
    offset = np.array([0.5, -1.0, 0.0])
    options: dict[str, Any] = {"harmonics": 12, "period_s": 5.0, "offset": offset, **LIMITS}
    reference = Reference.random_fourier(**options, duration_s=10.0)
    q, dq, ddq = reference.at([0.0, 5.0])
    np.testing.assert_allclose(q, [offset, offset], rtol=0, atol=1e-9)
    np.testing.assert_allclose(dq, 0.0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(ddq, 0.0, rtol=0, atol=1e-6)
    q, dq, ddq = reference.at(np.linspace(0.0, 10.0, 20_001))
    shares = np.array(
        [
            np.abs(values).max(axis=0) / limit
            for values, limit in zip((q - offset, dq, ddq), LIMITS.values(), strict=True)
        ]
    )
    # The peaks are looked for on samples of their own, hence the room.
    np.testing.assert_allclose(shares.max(axis=0), 1.0, rtol=0, atol=1e-3)
    again, other = Reference.random_fourier(**options), Reference.random_fourier(**options, seed=1)
    times = np.linspace(0.0, 5.0, 100)
    np.testing.assert_array_equal(again.at(times)[0], Reference.random_fourier(**options).at(times)[0])
    assert np.abs(again.at(times)[0] - other.at(times)[0]).max() > 0.1


def test_a_long_move_is_a_trapezium_of_velocity() -> None:
    # 0.25 s of acceleration, 1.75 s at 0.5, 0.25 s of braking, with 1 s of rest on either side.
    reference = Reference.point_to_point([[0.0], [1.0]], max_velocity=0.5, max_acceleration=2.0, dwell_s=1.0)
    assert reference.duration == pytest.approx(4.25, abs=1e-12)
    t = np.array([0.5, 1.125, 1.25, 2.0, 3.0, 3.125, 3.9])
    q, dq, ddq = (values[:, 0] for values in reference.at(t))
    np.testing.assert_allclose(q, [0.0, 0.015625, 0.0625, 0.4375, 0.9375, 0.984375, 1.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(dq, [0.0, 0.25, 0.5, 0.5, 0.5, 0.25, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ddq[[0, 1, 3, 5, 6]], [0.0, 2.0, 0.0, -2.0, 0.0], rtol=0, atol=1e-12)


def test_a_short_move_is_a_triangle() -> None:
    reference = Reference.point_to_point([[0.0], [-0.5]], max_velocity=10.0, max_acceleration=2.0)
    assert reference.duration == pytest.approx(1.0, abs=1e-12)
    _, dq, _ = reference.at([0.25, 0.5, 0.75])
    np.testing.assert_allclose(dq[:, 0], [-0.5, -1.0, -0.5], rtol=0, atol=1e-9)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(2, 5), st.sampled_from([0.0, 0.3]))
def test_points_are_met_at_rest_within_the_limits(seed: int, n: int, points: int, dwell: float) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-2.0, 2.0, (points, n))
    velocity, acceleration = rng.uniform(0.1, 3.0, (2, n))
    reference = Reference.point_to_point(
        places, max_velocity=velocity, max_acceleration=acceleration, dwell_s=dwell
    )
    # The slowest joint of each move decides how long it takes.
    way = np.abs(np.diff(places, axis=0))
    ramp = np.minimum(velocity / acceleration, np.sqrt(way / acceleration))
    lengths = (ramp + way / (acceleration * ramp)).max(axis=1)
    departures = dwell + np.concatenate([[0.0], np.cumsum(lengths + dwell)])
    assert reference.duration == pytest.approx(departures[-1], abs=1e-9)
    q, dq, _ = reference.at(departures)
    np.testing.assert_allclose(q, places, rtol=0, atol=1e-8)
    np.testing.assert_allclose(dq, 0.0, rtol=0, atol=1e-6)
    _, dq, ddq = reference.at(np.linspace(0.0, reference.duration, 999))
    assert np.all(np.abs(dq) <= velocity * (1.0 + 1e-9))
    assert np.all(np.abs(ddq) <= acceleration * (1.0 + 1e-9))


Q = np.zeros((10, 2))
TWO = {"max_position": [1.0, 1.0], "max_velocity": [1.0, 1.0], "max_acceleration": [1.0, 1.0]}


def random(**changes: Any) -> Reference:
    return Reference.random_fourier(**{"harmonics": 5, "period_s": 1.0, **TWO, **changes})


def move(points: Any = ((0.0, 0.0), (1.0, 1.0)), **changes: Any) -> Reference:
    return Reference.point_to_point(points, **{"max_velocity": 1.0, "max_acceleration": 1.0, **changes})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Reference.sampled(Q[:, 0], rate_hz=10), "q must have shape (rows, n_dof), got (10,)"),
        (lambda: Reference.sampled(Q[:4], rate_hz=10), "needs at least 5 samples, got 4"),
        (lambda: Reference.sampled(np.full((9, 2), np.nan), rate_hz=10), "q is NaN at sample 1, column 1"),
        (lambda: Reference.sampled(Q, rate_hz=0), "rate_hz must be positive, got 0"),
        (lambda: Reference.sampled(Q, rate_hz=math.nan), "rate_hz must be positive, got nan"),
        (lambda: Reference.sampled(np.zeros((9, 129)), rate_hz=10), "a reference has 1 to 128 joints, got 129"),
        (lambda: Reference.sampled("abc", rate_hz=10), "q must be an array of real numbers"),
        (lambda: Reference.sampled(Q, rate_hz=10).at(Q), "t must have shape (n_times,), got (10, 2)"),
        (lambda: Reference.fourier(Q, Q[1:], period_s=1), "must have one shape (n_harmonics, n_dof), got"),
        (lambda: Reference.fourier(Q[:0], Q[:0], period_s=1), "must have one shape (n_harmonics, n_dof), got"),
        (lambda: Reference.fourier(Q, Q, period_s=-1), "period and duration must be positive, got -1"),
        (lambda: Reference.fourier(Q, Q, period_s=1, duration_s=0), "must be positive, got 1 and 0 s"),
        (lambda: Reference.fourier(Q, Q, period_s=1, duration_s=1e9), "1e+09 s with 10 harmonics in 1 s is too"),
        (lambda: Reference.fourier(Q, Q, period_s=1e-300, duration_s=1e300), "harmonics in 1e-300 s is too long"),
        (
            lambda: Reference.fourier(np.ones((1000, 1)), np.ones((1000, 1)), period_s=1, duration_s=2),
            "2 s with 1000 harmonics in 1 s is too long",
        ),
        (  # as large as one of four joints in the core
            lambda: Reference.fourier(np.ones((4, 1)), np.ones((4, 1)), period_s=5e-5, duration_s=0.6),
            "0.6 s with 4 harmonics in 5e-05 s is too long",
        ),
        (lambda: Reference.fourier(Q, Q, period_s=1, offset=[1, 2, 3]), "offset needs 2 numbers, one per joint"),
        (lambda: Reference.fourier(Q, Q, period_s=1, offset=math.nan), "position of joint 1 at knot 1"),
        (lambda: random(harmonics=3), "needs at least 4 harmonics, got 3"),
        (lambda: random(max_velocity=[1.0, 1.0, 1.0]), "max_position needs 3 numbers, one per joint, got 2"),
        (lambda: random(max_velocity=[1.0, 0.0]), "max_velocity must be positive, got [1.0, 0.0]"),
        (lambda: random(max_acceleration=math.nan), "max_acceleration must be positive, got [nan]"),
        (lambda: random(offset=[0.0] * 3), "offset needs 2 numbers, one per joint, got an array of shape (3,)"),
        (lambda: random(seed=-1), "seed must not be negative, got -1"),
        (lambda: random(period_s=math.nan), "period and duration must be positive, got nan"),
        (lambda: move([[0.0, 0.0]]), "at least two different points, got 1"),
        (lambda: move([[0.0, 0.0]] * 2), "at least two different points, got 1"),
        (lambda: move([0.0, 0.0]), "points must have shape (rows, n_dof), got (2,)"),
        (lambda: move([[0.0, 0.0], [1.0, math.nan]]), "points is NaN at sample 2, column 2"),
        (lambda: move(max_velocity=[1.0] * 3), "max_velocity needs 2 finite numbers, one per joint"),
        (lambda: move(max_velocity=0.0), "velocity of joint 1 must be positive, got 0"),
        (lambda: move(max_acceleration=[1.0, -2.0]), "acceleration of joint 2 must be positive, got -2"),
        (lambda: move(dwell_s=-1.0), "dwell_s must not be negative, got -1"),
    ],
)  # fmt: skip
def test_a_wrong_reference_is_one_sentence(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ReferenceError) as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_in_a_very_long_period_positions_meet_their_limit() -> None:
    """Velocities and accelerations that vanish leave their limits without meaning, and nothing is divided by zero."""
    slow = random(period_s=1e300, max_position=[0.5, 1.0])
    q, dq, _ = slow.at(np.linspace(0.0, 1e300, 1001))
    np.testing.assert_allclose(np.abs(q).max(axis=0), [0.5, 1.0], rtol=0.02)
    assert np.abs(dq).max() < 1e-290
