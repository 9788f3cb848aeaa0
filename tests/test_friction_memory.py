"""Dahl's memory in displacement: exact between reversals, and linear in the state at its start."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from didim.regression.friction.memory import start_column, state


def walk(seed: int, n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.standard_normal((n, 2)), axis=0) * 0.01
    q[100:110] = q[100]  # at rest
    return np.asarray(q)


def stepped(q: np.ndarray, h: float, start: float) -> np.ndarray:
    """From sample to sample, as the equation says."""
    z = np.full(q.shape[1], start)
    found = [z]
    for change in np.diff(q, axis=0):
        s = np.sign(change)
        z = np.where(s == 0.0, z, s - (s - z) * np.exp(-np.abs(change) / h))
        found.append(z)
    return np.array(found)


@given(st.integers(0, 1000), st.floats(1e-3, 0.3))
def test_the_state_is_that_of_steps_from_sample_to_sample(seed: int, h: float) -> None:
    q = walk(seed)
    np.testing.assert_allclose(state(q, h), stepped(q, h, 0.0), atol=1e-12)


def test_more_samples_on_the_same_way_change_nothing() -> None:
    q = walk(3)
    fine = np.empty((2 * len(q) - 1, 2))
    fine[::2], fine[1::2] = q, 0.5 * (q[1:] + q[:-1])
    np.testing.assert_allclose(state(fine, 0.02)[::2], state(q, 0.02), atol=1e-12)


def test_what_a_start_leaves_is_linear() -> None:
    q = walk(5)
    np.testing.assert_allclose(
        stepped(q, 0.05, 0.7), state(q, 0.05) + 0.7 * start_column(q, 0.05), atol=1e-12
    )


def test_widths_are_those_of_their_joints_and_rest_keeps_the_state() -> None:
    q = walk(1)
    both = state(q, np.array([0.01, 0.1]))
    np.testing.assert_array_equal(both[:, 0], state(q, 0.01)[:, 0])
    np.testing.assert_array_equal(both[:, 1], state(q, 0.1)[:, 1])
    assert np.ptp(both[100:110], axis=0).max() == 0.0
    assert not state(np.zeros((5, 2)), 0.1).any()
