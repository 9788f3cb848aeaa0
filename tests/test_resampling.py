"""Uneven logs made even: the signal is kept, the effect on noise is the reported one, and gaps are not bridged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from didim.errors import ExperimentError, RecordingError
from didim.log.data_folder import DataFolder
from didim.log.recording import Recording
from didim.log.recording_file import read_recording
from didim.log.resampling import resampling
from plain import fake_robot
from tables import experiment_table

Array = NDArray[np.float64]


def jittery(n: int = 4000, period: float = 0.01, share: float = 0.2) -> Array:
    """Time steps that vary at random by a share of the period."""
    rng = np.random.default_rng(3)
    return np.cumsum(period * (1.0 + share * rng.uniform(-1.0, 1.0, n)))


def test_a_slow_motion_comes_through() -> None:
    """The error of a cubic goes with the fourth power of frequency times step: below 1e-5 at 1 Hz and 100 Hz."""
    t = jittery()
    plan = resampling(t, None, "a.csv")
    x = np.column_stack([np.sin(2.0 * np.pi * t), np.cos(3.0 * t)])
    assert plan.rate_hz == pytest.approx(100.0, rel=0.01)
    expected = np.column_stack([np.sin(2.0 * np.pi * plan.t), np.cos(3.0 * plan.t)])
    assert np.abs(plan.apply(x) - expected)[2:-2].max() < 1e-5
    np.testing.assert_allclose(plan.weights.sum(axis=1), 1.0, rtol=1e-12)


def test_even_stamps_stay_as_they_are() -> None:
    t = np.arange(500) / 250.0
    plan = resampling(t, None, "a.csv")
    x = np.random.default_rng(0).standard_normal((500, 3))
    assert plan.rate_hz == 250.0
    np.testing.assert_allclose(plan.apply(x), x, atol=1e-9)
    assert plan.noise_variance == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("rate", [None, 97.3, 250.0])
def test_the_effect_on_noise_is_the_one_told(rate: float | None) -> None:
    t = jittery(20000)
    plan = resampling(t, rate, "a.csv")
    noise = np.random.default_rng(1).standard_normal((len(t), 4))
    assert plan.apply(noise).var() == pytest.approx(plan.noise_variance, rel=0.02)
    assert 0.7 < plan.noise_variance < 0.95


def test_gaps_part_windows_and_short_ones_do_not() -> None:
    t = np.arange(1000) / 100.0
    t[200:] += 0.02  # two samples missing
    t[600:] += 0.5
    plan = resampling(t, None, "a.csv")
    assert plan.windows == ((0, 602), (652, 1052))
    x = plan.apply(np.column_stack([np.sin(t)]))[:, 0]
    for start, stop in plan.windows:
        assert np.abs(x - np.sin(plan.t))[start:stop].max() < 1e-7
    assert np.abs(x).max() <= 1.0  # no cubic swings out in the gap


def test_repeated_stamps_are_left_out_and_backward_ones_refused() -> None:
    t = np.repeat(np.arange(300) / 100.0, 2)[:-1]
    plan = resampling(t, None, "a.csv")
    assert plan.repeated == 299
    assert "299 repeated time stamps left out" in plan.sentence("10 to 10 ms")
    t = np.arange(300) / 100.0
    t[40] = 0.1
    with pytest.raises(RecordingError, match=r"time does not grow from row 40 \(0.39 s\) to row 41"):
        resampling(t, None, "a.csv")


def test_a_far_rate_and_too_few_samples() -> None:
    with pytest.raises(RecordingError, match=r"rate_hz = 10 is not a rate to resample at.* have 100"):
        resampling(np.arange(300) / 100.0, 10.0, "a.csv")
    with pytest.raises(RecordingError, match="needs 4 time stamps, and there are 3"):
        resampling(np.arange(3) / 100.0, None, "a.csv")
    late = np.r_[np.arange(300) / 100.0, 1e300]
    with pytest.raises(
        RecordingError, match=r"end 1e\+300 s after the first: is that of row 301 \(1e\+300 s\) wrong"
    ):
        resampling(late, None, "a.csv")
    with pytest.raises(RecordingError, match="no stretch without a gap"):
        resampling(np.array([0.0, 0.01, 0.02, 0.5, 0.51, 0.52]), None, "a.csv")


def described(folder: Path, time: dict[str, Any], **keys: Any) -> Recording:
    part = {"file": "a.csv", "side": "joint"}
    content = {
        "time": {"file": "a.csv", "columns": [1], **time},
        "position": {**part, "columns": [2, 3], "unit": "rad"},
        "velocity": {**part, "columns": [4, 5], "unit": "deg/s"},
        "torque": {**part, "columns": [6, 7], "unit": "N.m", "scale": [2.0, 0.5], "sign": [1, -1]},
        **keys,
    }
    table = experiment_table("recording", content)
    return read_recording(table, "run", fake_robot(), None, DataFolder(folder))


def write(folder: Path, t: Array) -> None:
    q = np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t)])
    dq = np.degrees(np.column_stack([3.0 * np.cos(3.0 * t), -2.0 * np.sin(2.0 * t)]))
    np.savetxt(folder / "a.csv", np.column_stack([t, q, dq, 4.0 * q]), delimiter=",", fmt="%.17g")


def test_a_recording_is_resampled_on_request(tmp_path: Path) -> None:
    """All signals alike, with a note; the message of an uneven log offers it."""
    t = jittery(1000)
    write(tmp_path, t)
    with pytest.raises(
        RecordingError, match=r"sampling is uneven.*resample = true under \[recording.time\].*0\.\d\d of its"
    ):
        described(tmp_path, {})
    recording = described(tmp_path, {"resample": True})
    assert len(recording.notes) == 1
    assert "time steps of 8.00" in recording.notes[0]
    assert "white noise keeps 0." in recording.notes[0]
    assert recording.origin["resampled"]["rate_hz"] == recording.rate_hz
    assert recording.dq is not None
    assert recording.tau is not None
    now = recording.t[5:-5]
    np.testing.assert_allclose(recording.q[5:-5, 0], np.sin(3.0 * now), atol=1e-5)
    np.testing.assert_allclose(recording.dq[5:-5, 1], -2.0 * np.sin(2.0 * now), atol=1e-4)
    np.testing.assert_allclose(recording.tau[5:-5, 0], 8.0 * np.sin(3.0 * now), atol=1e-4)
    np.testing.assert_allclose(recording.tau[5:-5, 1], -2.0 * np.cos(2.0 * now), atol=1e-4)


def test_a_window_with_a_gap_is_refused(tmp_path: Path) -> None:
    t = np.arange(1000) / 100.0
    t[600:] += 0.5
    write(tmp_path, t)
    assert described(tmp_path, {"resample": True}, windows_s=[[0.0, 5.0], [7.0, 9.0]]).windows == (
        (0, 500),
        (700, 900),
    )
    with pytest.raises(
        ExperimentError, match=r"the window \[5, 8\] s has a gap in it.*\[0, 6\], \[6.5, 10.5\] s"
    ):
        described(tmp_path, {"resample": True}, windows_s=[[5.0, 8.0]])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"scale": 0.0}, "scale must not be zero"),
        ({"sign": 2}, "sign must be 1 or -1, for all columns or one for each, got 2"),
        ({"scale": [1.0]}, "scale must hold 2 numbers, got 1"),
        ({"gain": 3.0}, "gain is for torques logged in A or V.*scale and sign are for any unit"),
    ],
)
def test_wrong_scales(tmp_path: Path, keys: dict[str, Any], message: str) -> None:
    write(tmp_path, np.arange(100) / 100.0)
    torque = {"file": "a.csv", "side": "joint", "columns": [6, 7], "unit": "N.m", **keys}
    with pytest.raises(ExperimentError, match=message):
        described(tmp_path, {}, torque=torque)


@pytest.mark.filterwarnings("error")
def test_infinite_values_are_resampled_without_a_warning() -> None:
    t = jittery(100)
    plan = resampling(t, None, "log.csv")
    values = np.full((100, 1), np.inf)
    values[::2] = -np.inf
    # Reported by Recording.
    assert not np.isfinite(plan.apply(values)).all()
