"""Arrays from users: real numbers come out as float64, and what is none is one sentence at every door."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import didim
from didim._tools.arrays import LARGEST_POSITION, real_array, surely_within
from didim.errors import DidimError, ShapeError
from didim.model.dynamics import standard_vector
from didim.signal.filters import central_differences

ROBOT = didim.load_robot("planar2")
X = ROBOT.sets["reference"]
Q = np.linspace(0.0, 1.0, 40).reshape(20, 2)


@pytest.mark.parametrize(
    "value", [[[1, 2], [3, 4]], np.ones((2, 2), np.float32), np.ones((2, 2), np.uint8), [[True, False]]]
)
def test_real_numbers_are_float64(value: Any) -> None:
    array = real_array("q", value, ShapeError)
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, value)


def test_float64_is_not_copied() -> None:
    assert real_array("q", Q, ShapeError) is Q


@pytest.mark.parametrize(
    ("value", "got"),
    [
        (np.ones((2, 2), complex), ", got complex numbers"),
        ([["1.5"]], ", got values of type <U3"),
        ([[None]], ", got values of type object"),
        ([[1.0], [1.0, 2.0]], ""),
    ],
)
def test_anything_else_is_refused(value: Any, got: str) -> None:
    with pytest.raises(ShapeError) as caught:
        real_array("q", value, ShapeError)
    assert str(caught.value) == f"q must be an array of real numbers{got}"


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda bad: didim.regressor(ROBOT, Q, bad, Q), "dq"),
        (lambda bad: didim.inverse_dynamics(ROBOT, Q, Q, Q, X + 0j), "x"),
        (lambda bad: didim.direct_dynamics(ROBOT, Q, Q, bad, X), "tau"),
        (lambda bad: ROBOT.base_parameters.lift(np.zeros(len(ROBOT.base_parameters.names)) + 0j), "beta"),
        (lambda bad: ROBOT.base_parameters.project(X + 0j), "x"),
        (lambda bad: central_differences(bad, 0.1), "signals"),
        (lambda bad: didim.Recording.from_arrays(bad, rate_hz=1.0), "recording: q"),
        (lambda bad: didim.Recording.from_arrays(Q, bad, rate_hz=1.0), "recording: tau"),
        (lambda bad: didim.Recording.from_arrays(Q, Q, q_ref=bad, rate_hz=1.0), "recording: q_ref"),
        (lambda bad: didim.Recording(t=bad[:, 0], q=Q, rate_hz=1.0), "recording: t"),
    ],
)
def test_complex_arrays_are_refused_at_every_door(call: Callable[[Any], object], what: str) -> None:
    with pytest.raises(DidimError) as caught:
        call(Q + 0j)
    assert str(caught.value) == f"{what} must be an array of real numbers, got complex numbers"


def test_positions_beyond_any_joint_are_told() -> None:
    """The sine of the core is no sine beyond 1e15 rad."""
    q = np.array([[0.0, 0.0], [0.0, -1e16]])
    with pytest.raises(
        ShapeError, match=r"q of joint 2 is -1e\+16 at sample 2, where at most 1e\+09 rad or m"
    ):
        didim.inertia_matrix(ROBOT, q, X)


def test_positions_up_to_the_limit_are_taken() -> None:
    q = Q.copy()
    q[3] = LARGEST_POSITION, -LARGEST_POSITION
    assert np.isfinite(didim.inertia_matrix(ROBOT, q, X)).all()
    for q[3, 1] in (np.nextafter(-LARGEST_POSITION, -np.inf), -1e300, -np.inf):
        with pytest.raises(ShapeError, match=r"^q of joint 2 is -.* at sample 4, where at most"):
            didim.inertia_matrix(ROBOT, q, X)


def test_parameters_whose_squares_overflow_are_taken() -> None:
    x = np.full_like(X, -1e200)
    assert standard_vector(ROBOT, x) is x
    for x[2] in (np.inf, -np.inf, np.nan):
        with pytest.raises(ShapeError, match=rf"^x has {x[2]} for parameter {ROBOT.parameter_names[2]}$"):
            standard_vector(ROBOT, x)


@pytest.mark.parametrize("limit", [LARGEST_POSITION, 1e150])
def test_one_sum_never_passes_what_the_numbers_would_not(limit: float) -> None:
    assert surely_within(np.zeros((0, 6)), limit)
    rng = np.random.default_rng(3)
    for n in (1, 7, 1000):
        values = rng.uniform(-limit, limit, (n, 6)) / np.sqrt(6.0 * n)
        assert surely_within(values, limit)
        assert surely_within(values[::-1, ::2], limit)
        for wrong in (np.nextafter(limit, np.inf), -1e300, np.inf, -np.inf, np.nan):
            values[n // 2, 4] = wrong
            assert not surely_within(values, limit)


@pytest.mark.parametrize(
    "call",
    [
        lambda bad: didim.inverse_dynamics(ROBOT, Q, bad, Q, X),
        lambda bad: didim.regressor(ROBOT, Q, bad, Q),
        lambda bad: didim.inertia_matrix(ROBOT, bad, X),
        lambda bad: didim.direct_dynamics(ROBOT, Q, bad, Q, X),
    ],
)
def test_numbers_that_are_none_are_told_with_their_place(call: Callable[[Any], object]) -> None:
    bad = Q.copy()
    bad[3, 1] = np.nan
    with pytest.raises(ShapeError, match="is NaN at sample 4, column 2"):
        call(bad)
