"""Hampel's filter on measured torques."""

from __future__ import annotations

import numpy as np
import pytest

from didim.signal.spikes import hampel


def torques(seed: int = 0, n: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.arange(n) / 1000.0
    motion = np.column_stack([20.0 * np.sin(3.0 * t), 5.0 * np.sign(np.sin(5.0 * t)) + np.sin(t)])
    return motion + rng.standard_normal((n, 2)) * [0.5, 0.1]


def test_spikes_are_found_and_replaced() -> None:
    clean = torques()
    rng = np.random.default_rng(1)
    planted = rng.random(clean.shape) < 0.005
    signs = rng.choice([-1.0, 1.0], clean.shape)
    found, spikes = hampel(clean + planted * signs * [15.0, 3.0])
    assert np.mean(spikes[planted]) > 0.97
    # Fewer than one sample in a hundred of the rest is touched, and the torques are those before the spikes.
    assert np.mean(spikes[~planted]) < 0.01
    error, noise = np.std(found - clean, axis=0), np.array([0.5, 0.1])
    assert (error < 0.25 * noise).all()


def test_steps_of_friction_stay() -> None:
    t = np.arange(2000)
    steps = np.where(t // 400 % 2, 5.0, -5.0)[:, None] + 0.01 * np.random.default_rng(0).standard_normal(
        (2000, 1)
    )
    found, _ = hampel(steps)
    assert np.abs(found - steps).max() < 0.1


@pytest.mark.parametrize("resolution", [0.0, 0.5])
def test_constant_and_coarse_signals_are_left_alone(resolution: float) -> None:
    t = np.arange(3000) / 1000.0
    signal = 3.0 * np.sin(t) if resolution else np.full(3000, 7.0)
    if resolution:
        signal = resolution * np.round(signal / resolution)
    found, spikes = hampel(signal[:, None])
    assert not spikes.any()
    assert np.array_equal(found, signal[:, None])


def test_a_spike_in_a_constant_signal_is_found() -> None:
    signal = np.zeros((100, 1))
    signal[40] = 1.0
    found, spikes = hampel(signal)
    assert list(np.flatnonzero(spikes)) == [40]
    assert not found.any()


def test_a_record_shorter_than_the_window_is_left_alone() -> None:
    short = np.array([[1.0], [100.0], [1.0]])
    found, spikes = hampel(short)
    assert np.array_equal(found, short)
    assert not spikes.any()
