"""One function cuts a log: what it keeps, by hand, and what of it reaches a method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import didim
from arm import arm_log
from didim import Experiment
from didim.errors import FitError
from didim.signal.filters import differentiate
from golden import tx40


def cut_in_two() -> Experiment:
    """A log of two windows, 30 samples of which are trimmed in front and 20 behind."""
    log = arm_log(1)
    (recording,) = log.recordings
    signal = replace(log.signal, trim_start=30, trim_end=20)
    return replace(log, signal=signal, recordings=(replace(recording, windows=((10, 400), (450, 900))),))


def test_each_window_is_filtered_by_itself_and_trimmed() -> None:
    log = cut_in_two()
    (recording,) = log.recordings
    found = didim.windows(log)
    assert [(window.recording, window.number, window.begin) for window in found] == [(0, 0, 10), (0, 1, 450)]
    for window, (start, stop) in zip(found, recording.windows, strict=True):
        q, dq, ddq = differentiate(recording.q[start:stop], recording.rate_hz, log.signal)
        assert recording.tau is not None
        for got, made in (
            (window.q, q),
            (window.dq, dq),
            (window.ddq, ddq),
            (window.tau, recording.tau[start:stop]),
        ):
            np.testing.assert_array_equal(got, made[30:-20])
        np.testing.assert_array_equal(window.measured, recording.q[start:stop])


@pytest.mark.parametrize("delay", [3.0, -2.0, (1.0, 4.0)])
def test_torques_move_back_by_their_delay_and_motion_keeps_its_samples(
    delay: float | tuple[float, ...],
) -> None:
    log = cut_in_two()
    plain, moved = didim.windows(log)[1], didim.windows(log, delay=delay)[1]
    (recording,) = log.recordings
    assert recording.tau is not None
    first = 450 + moved.kept.start
    for joint, late in enumerate(np.broadcast_to(delay, plain.q.shape[1]).astype(int)):
        behind = recording.tau[first + late : first + late + len(moved.tau), joint]
        np.testing.assert_array_equal(moved.tau[:, joint], behind)
    own = moved.kept.start - plain.kept.start
    common = slice(max(own, 0), min(len(plain.q), own + len(moved.q)))
    ours = slice(common.start - own, common.stop - own)
    np.testing.assert_array_equal(moved.q[ours], plain.q[common])


def test_a_simulated_window_keeps_the_samples_of_a_measured_one() -> None:
    log = tx40()
    (measured,), (simulated,) = (
        didim.windows(log, delay=2.0),
        didim.windows(log, along="simulated", delay=2.0),
    )
    assert simulated.kept == measured.kept
    np.testing.assert_array_equal(simulated.tau, measured.tau)
    assert simulated.q.size == 0
    assert simulated.loop.n_records == len(simulated.logged)
    along = simulated.along([measured.q, measured.dq, measured.ddq])
    np.testing.assert_array_equal(along.q, measured.q)


def test_raw_outputs_need_no_torques_and_torques_do() -> None:
    log = tx40()
    (recording,) = log.recordings
    silent = replace(log, recordings=(replace(recording, tau=None),))
    (window,) = didim.windows(silent, along="outputs")
    np.testing.assert_array_equal(window.measured, recording.q)
    assert not window.logged.any()
    with pytest.raises(FitError, match="has no torques"):
        didim.windows(silent)


def test_nothing_left_of_a_window_is_said_with_its_place() -> None:
    log = cut_in_two()
    with pytest.raises(FitError, match=r"window of samples 10 to 400: trimming 380 and 20 samples leaves"):
        didim.windows(log, replace(log.signal, trim_start=380))


def test_rows_are_those_that_a_method_solves() -> None:
    log = tx40()
    method = didim.IDIMLS(weights="none", dropped=("MX6",))
    rows = didim.rows(log, method)
    fit = didim.identify(log, method)
    assert rows.names == tuple(n for n, role in zip(fit.names, fit.roles, strict=True) if role == "estimated")
    estimated = np.array([role == "estimated" for role in fit.roles])
    solution = np.linalg.lstsq(rows.w, rows.y, rcond=None)[0]
    np.testing.assert_allclose((solution - fit.beta[estimated]) / fit.std[estimated], 0.0, atol=1e-8)
    assert rows.y.size == fit.n_rows
