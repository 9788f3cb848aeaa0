"""Filters, differences and decimation against SciPy, MATLAB's definitions, and signals with known answers."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from didim import _core
from didim.errors import SignalError
from didim.signal.filters import (
    _decimation_filter,
    butterworth,
    central_differences,
    chebyshev,
    decimate,
    decimation_stages,
    differentiate,
    steady_states,
    zero_phase_butterworth,
)
from didim.signal.noise import _squared_gain, noise_correlation
from didim.signal.processing import Form, SignalProcessing
from didim.signal.spectrum import welch

Array = NDArray[np.float64]


def noise(n_samples: int, columns: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return np.asarray(np.cumsum(rng.standard_normal((n_samples, columns)), axis=0))


@pytest.mark.parametrize("order", range(1, 11))
@pytest.mark.parametrize("share", [0.001, 0.02, 0.5, 0.8, 0.97])
@pytest.mark.parametrize("ripple", [None, 0.05, 3.0])
def test_filters_are_designed_as_by_scipy(order: int, share: float, ripple: float | None) -> None:
    """Poles, gain and the whole response; states in which sections rest give what the filter does to a step that never began."""
    expected: Any  # scipy-stubs know real poles only
    if ripple is None:
        own, expected = butterworth(order, share), scipy.signal.butter(order, share, output="zpk")
    else:
        own = chebyshev(order, ripple, share)
        expected = scipy.signal.cheby1(order, ripple, share, output="zpk")
    np.testing.assert_allclose(np.sort_complex(own.poles), np.sort_complex(expected[1]), rtol=1e-13)
    np.testing.assert_allclose(own.gain, expected[2], rtol=1e-13)
    sos = own.sections()
    assert (np.diff(sos[:, 5]) >= 0.0).all()
    w = np.linspace(0.0, np.pi * min(1.0, 2.0 * share), 50)
    response = scipy.signal.freqz_sos(sos, w)[1]
    theirs = scipy.signal.freqz_sos(scipy.signal.zpk2sos(*expected), w)[1]
    transfer = own.transfer_function().reshape(2, -1)
    for product, factors in zip(transfer, scipy.signal.zpk2tf(*expected), strict=True):
        np.testing.assert_allclose(product, factors, rtol=1e-12, atol=1e-13 * np.abs(factors).max())
    near = 1.0 - np.abs(own.poles).max()
    np.testing.assert_allclose(response, theirs, rtol=0, atol=1e-14 / near)
    np.testing.assert_allclose(
        steady_states(sos), scipy.signal.sosfilt_zi(sos), rtol=1e-13 / near, atol=1e-15
    )


@pytest.mark.parametrize(("size", "trend"), [(64, None), (65, 0), (128, 1), (33, 1)])
def test_spectra_are_scipys(size: int, trend: int | None) -> None:
    x = noise(500, 2)
    how: Any = {None: False, 0: "constant", 1: "linear"}[trend]  # scipy-stubs do not know "linear"
    f, expected = scipy.signal.welch(x, 200.0, nperseg=size, detrend=how, axis=0)
    own = welch(x, 200.0, size, trend)
    np.testing.assert_allclose(own[0], f, rtol=1e-15)
    np.testing.assert_allclose(own[1], expected, rtol=1e-9, atol=1e-12 * expected.max())


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 8, 10])
@pytest.mark.parametrize("columns", [1, 3, 8, 9])
def test_butterworth_with_default_padding_is_scipys_sosfiltfilt(order: int, columns: int) -> None:
    x = noise(300, columns, order)
    expected = scipy.signal.sosfiltfilt(scipy.signal.butter(order, 50.0, fs=1000.0, output="sos"), x, axis=0)
    filtered = zero_phase_butterworth(x, 1000.0, 50.0, order)
    assert filtered.shape == x.shape
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-11 * np.abs(x).max())


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_butterworth_with_matlab_padding_is_filtfilt_of_the_transfer_function(order: int) -> None:
    x = noise(400, 2)
    b, a = scipy.signal.butter(order, 100.0, fs=1000.0)
    expected = scipy.signal.filtfilt(b, a, x, axis=0, padlen=3 * (max(len(a), len(b)) - 1))
    filtered = zero_phase_butterworth(x, 1000.0, 100.0, order, "matlab")
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-10 * np.abs(x).max())
    # The two conventions differ at the edges, and only in their padding.
    other = zero_phase_butterworth(x, 1000.0, 100.0, order, "scipy")
    assert np.abs(other - filtered).max() > 1e-9
    np.testing.assert_allclose(other[150:250], filtered[150:250], rtol=0, atol=1e-9)


@given(
    n_samples=st.integers(28, 200),
    columns=st.integers(1, 10),
    padding=st.integers(0, 27),
    factor=st.integers(1, 7),
    threads=st.integers(1, 4),
    data=st.data(),
)
def test_core_filters_and_keeps_as_defined(
    n_samples: int, columns: int, padding: int, factor: int, threads: int, data: st.DataObject
) -> None:
    first = data.draw(st.integers(0, factor - 1))
    x = noise(n_samples, columns, n_samples)
    sos = scipy.signal.cheby1(8, 0.05, 0.2, output="sos")
    stage = (sos, scipy.signal.sosfilt_zi(sos), padding, factor, first)
    expected = scipy.signal.sosfiltfilt(sos, x, axis=0, padlen=padding)[first::factor]
    kept = _core.decimate(x, [stage], threads=threads)
    np.testing.assert_allclose(kept, expected, rtol=0, atol=1e-10 * np.abs(x).max())
    np.testing.assert_array_equal(kept, _core.decimate(x, [stage], threads=1))
    # Columns do not know of each other.
    np.testing.assert_array_equal(kept[:, :1], _core.decimate(np.ascontiguousarray(x[:, :1]), [stage]))


@pytest.mark.parametrize("factor", [2, 5, 10])
@pytest.mark.parametrize("n_samples", [100, 101, 109])
def test_decimation_is_scipys(factor: int, n_samples: int) -> None:
    x = noise(n_samples, 3)
    stages = decimation_stages(n_samples, SignalProcessing(decimation=(factor,)))
    expected = scipy.signal.decimate(x, factor, axis=0, zero_phase=True)
    np.testing.assert_allclose(decimate(x, stages), expected, rtol=0, atol=1e-10 * np.abs(x).max())


def test_two_stages_are_scipys_two_calls() -> None:
    x = noise(4500, 2)
    stages = decimation_stages(4500, SignalProcessing(decimation=(10, 10)))
    once = scipy.signal.decimate(x, 10, axis=0, zero_phase=True)
    expected = scipy.signal.decimate(once, 10, axis=0, zero_phase=True)
    np.testing.assert_allclose(decimate(x, stages), expected, rtol=0, atol=1e-10 * np.abs(x).max())


@pytest.mark.parametrize("n_samples", [200, 201, 204, 209])
def test_matlab_decimation_ends_on_the_last_sample(n_samples: int) -> None:
    factor = 5
    x = noise(n_samples, 2)
    signal = SignalProcessing(decimation=(factor,), decimation_convention="matlab")
    # decimate.m: nout = ceil(nd/r); nbeg = r - (r*nout - nd); odata(nbeg:r:nd), odata from filtfilt(b, a, .).
    b, a = scipy.signal.cheby1(8, 0.05, 0.8 / factor)
    filtered = scipy.signal.filtfilt(b, a, x, axis=0, padlen=3 * 8)
    kept = int(np.ceil(n_samples / factor))
    begin = factor - (factor * kept - n_samples)
    expected = filtered[begin - 1 :: factor]
    decimated = decimate(x, decimation_stages(n_samples, signal))
    assert decimated.shape == (kept, 2)
    # Order 8 as a transfer function has lost several digits already.
    np.testing.assert_allclose(decimated, expected, rtol=0, atol=1e-6 * np.abs(x).max())
    # In sections, what is kept is exactly the samples counted back from the last.
    sos = scipy.signal.cheby1(8, 0.05, 0.8 / factor, output="sos")
    exact = scipy.signal.sosfiltfilt(sos, x, axis=0, padlen=24)[::-1][::factor][::-1]
    np.testing.assert_allclose(decimated, exact, rtol=0, atol=1e-10 * np.abs(x).max())


def test_decimation_by_a_hundred_is_sound_in_sections() -> None:
    t = np.arange(45000) / 5000.0
    x = np.column_stack([np.sin(2 * np.pi * 0.5 * t), np.cos(2 * np.pi * 1.3 * t)])
    stages = decimation_stages(t.size, SignalProcessing(decimation=(100,)))
    inside = slice(30, -30)
    # The pass band ripples by 0.05 dB a pass: 1.2 % for both.
    np.testing.assert_allclose(decimate(x, stages)[inside], x[::100][inside], atol=0.012)


def test_linear_relations_survive_the_parallel_filter() -> None:
    w = noise(1000, 7)
    beta = np.arange(1.0, 8.0)
    stages = decimation_stages(1000, SignalProcessing(decimation=(4, 3)))
    y = decimate((w @ beta)[:, None], stages)[:, 0]
    np.testing.assert_allclose(decimate(w, stages) @ beta, y, atol=1e-9 * np.abs(y).max())


def test_derivatives_of_a_sine() -> None:
    rate = 1000.0
    t = np.arange(3000) / rate
    omega = 2 * np.pi * np.array([0.5, 1.0])
    q, dq, ddq = differentiate(np.sin(t[:, None] * omega), rate, SignalProcessing(cutoff_hz=100.0))
    inside = slice(100, -100)
    np.testing.assert_allclose(q[inside], np.sin(t[:, None] * omega)[inside], atol=1e-7)
    # Central differences damp by (omega dt)^2 / 6.
    np.testing.assert_allclose(dq[inside], (omega * np.cos(t[:, None] * omega))[inside], atol=1e-4)
    np.testing.assert_allclose(ddq[inside], (-(omega**2) * np.sin(t[:, None] * omega))[inside], atol=1e-3)


@pytest.mark.parametrize("measured", [False, True])
def test_motion_that_is_fast_for_its_rate_keeps_its_derivatives(measured: bool) -> None:
    rate, omega = 100.0, 2 * np.pi * np.array([0.1, 1.5])
    phase = np.arange(1500)[:, None] / rate * omega
    q, dq, ddq = np.sin(phase), omega * np.cos(phase), -(omega**2) * np.sin(phase)
    given = dq if measured else None
    inside = slice(100, -100)
    signal = SignalProcessing(cutoff_hz=40.0)
    derived = differentiate(q, rate, signal, given)
    for derivative, true in zip(derived[1:], (dq, ddq), strict=True):
        np.testing.assert_allclose(
            derivative[inside, 1], true[inside, 1], atol=1e-5 * np.abs(true[:, 1]).max()
        )
    # Central differences alone lose 0.15 % of each derivative; the slow joint has them, to the last digit.
    plain = [central_differences(derived[0], 1.0 / rate), central_differences(derived[1], 1.0 / rate)]
    lost = 1.0 - np.abs(plain[0][inside, 1]).max() / omega[1]
    assert lost == pytest.approx((omega[1] / rate) ** 2 / 6.0, rel=0.01)
    np.testing.assert_array_equal(derived[2][:, 0], plain[1][:, 0])
    for other in (replace(signal, ends="first-order"), replace(signal, cutoff_hz=None)):
        _, speed, acceleration = differentiate(q, rate, other, given)
        np.testing.assert_array_equal(acceleration, central_differences(speed, 1.0 / rate, other.ends))


def test_noise_beyond_the_motion_is_not_sharpened() -> None:
    rate, signal = 100.0, SignalProcessing(cutoff_hz=40.0)
    t = np.arange(3000)[:, None] / rate
    motion, error = np.sin(2 * np.pi * 1.5 * t), 1e-4 * np.random.default_rng(1).standard_normal((3000, 1))
    difference = differentiate(motion + error, rate, signal)[2] - differentiate(motion, rate, signal)[2]
    filtered = differentiate(error, rate, replace(signal, ends="first-order"))[2]
    share = np.std(difference[100:-100]) / np.std(filtered[100:-100])
    assert share < 1.01  # 1.82 with differences of fourth order


def test_without_cut_off_positions_stay_as_they_are() -> None:
    x = noise(50, 2)
    q, dq, ddq = differentiate(x, 10.0, SignalProcessing(cutoff_hz=None))
    np.testing.assert_array_equal(q, x)
    np.testing.assert_array_equal(dq, central_differences(x, 0.1))
    np.testing.assert_array_equal(ddq, central_differences(dq, 0.1))


def test_central_differences_are_exact_for_parabolas() -> None:
    dt = 0.01
    t = dt * np.arange(20)[:, None]
    np.testing.assert_allclose(central_differences(3.0 * t**2 - t, dt), 6.0 * t - 1.0, atol=1e-12)
    dx = central_differences(3.0 * t**2 - t, dt, "first-order")
    np.testing.assert_allclose(dx[1:-1], (6.0 * t - 1.0)[1:-1], atol=1e-12)
    # One-sided ones of first order: the slope half a sample inside.
    np.testing.assert_allclose(
        dx[[0, -1], 0], [6.0 * dt / 2 - 1.0, 6.0 * (t[-1, 0] - dt / 2) - 1.0], atol=1e-12
    )


def test_no_decimation_is_a_copy() -> None:
    x = noise(5, 2)
    kept = decimate(x, decimation_stages(5, SignalProcessing()))
    np.testing.assert_array_equal(kept, x)
    assert kept is not x
    assert noise_correlation(SignalProcessing()) is None


def test_the_ends_of_decimated_noise_are_left_out_for_a_reason() -> None:
    signal = SignalProcessing(decimation=(5, 10))
    stages = decimation_stages(5000, signal)
    rng = np.random.default_rng(0)
    kept = np.stack([decimate(rng.standard_normal((5000, 6)), stages) for _ in range(100)])
    variance = np.mean(kept**2, axis=(0, 2))
    middle = np.median(variance)
    assert variance[0] > 30.0 * middle
    assert variance[signal.kept_rows].max() < 1.6 * middle


@pytest.mark.parametrize("factors", [(10,), (5, 4)])
def test_correlation_that_decimated_noise_has(factors: tuple[int, ...]) -> None:
    x = np.random.default_rng(3).standard_normal((400_000, 4))
    signal = SignalProcessing(decimation=factors)
    kept = decimate(x, decimation_stages(x.shape[0], signal))
    correlation = noise_correlation(signal)
    assert correlation is not None
    for lag in range(6):
        found = np.mean(kept[: len(kept) - lag] * kept[lag:]) / np.mean(kept**2)
        assert found == pytest.approx(correlation[lag], abs=0.012)
    assert correlation[1] > 0.15


@pytest.mark.parametrize("factor", [2, 3, 10, 100])
@pytest.mark.parametrize("size", [20_000, 20_001])
def test_the_gain_of_the_decimation_filter_is_that_of_its_sections(factor: int, size: int) -> None:
    sos = _decimation_filter(factor)[0]
    _, response = scipy.signal.sosfreqz(sos, worN=size, whole=True)
    np.testing.assert_allclose(_squared_gain(factor, size), np.abs(response) ** 2, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize(
    ("cutoff", "rate", "message"),
    [
        (600.0, 1000.0, "the cut-off of 600 Hz must be below half the sampling rate, 500 Hz at 1000 Hz"),
        (500.0, 1000.0, "the cut-off of 500 Hz must be below half the sampling rate, 500 Hz at 1000 Hz"),
    ],
)
def test_cut_off_above_nyquist_is_told(cutoff: float, rate: float, message: str) -> None:
    with pytest.raises(SignalError) as error:
        zero_phase_butterworth(noise(100, 2), rate, cutoff)
    assert str(error.value) == message


@pytest.mark.parametrize(("padding", "needed"), [("scipy", 15), ("matlab", 12)])
def test_too_few_samples_for_the_filter_are_told(padding: Literal["scipy", "matlab"], needed: int) -> None:
    zero_phase_butterworth(noise(needed + 1, 1), 1000.0, 100.0, 4, padding)
    with pytest.raises(SignalError) as error:
        zero_phase_butterworth(noise(needed, 1), 1000.0, 100.0, 4, padding)
    message = f"the zero-phase filter of order 4 needs more than {needed} samples, the record has {needed}"
    assert str(error.value) == message


def test_too_few_samples_for_decimation_are_told() -> None:
    with pytest.raises(SignalError) as error:
        decimation_stages(270, SignalProcessing(decimation=(10, 10)))
    assert str(error.value) == "decimation by 10 needs more than 27 samples, stage 2 of 2 gets 27"
    with pytest.raises(SignalError, match="needs more than 24 samples, stage 1 of 1 gets 24"):
        decimation_stages(24, SignalProcessing(decimation=(10,), decimation_convention="matlab"))


def test_shape_and_content_are_checked() -> None:
    with pytest.raises(SignalError, match=r"must have shape \(n_samples, m\), got \(5,\)"):
        central_differences(np.zeros(5), 0.1)
    with pytest.raises(SignalError, match="at least 3 samples, got 1"):
        central_differences(np.zeros((1, 2)), 0.1)
    x = noise(50, 3)
    x[17, 2] = np.nan
    with pytest.raises(SignalError, match="sample 17 of signal 2 is not a finite number"):
        zero_phase_butterworth(x, 1000.0, 100.0)


def test_strides_and_precision_do_not_matter() -> None:
    x = noise(200, 6)
    expected = zero_phase_butterworth(x, 1000.0, 100.0)
    np.testing.assert_array_equal(zero_phase_butterworth(np.asfortranarray(x), 1000.0, 100.0), expected)
    np.testing.assert_array_equal(zero_phase_butterworth(x[:, ::-1], 1000.0, 100.0), expected[:, ::-1])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cutoff_hz": -5.0}, "cutoff_hz must be a positive frequency, got -5.0"),
        ({"cutoff_hz": float("nan")}, "cutoff_hz must be a positive frequency, got nan"),
        ({"cutoff_hz": float("inf")}, "cutoff_hz must be a positive frequency, got inf"),
        ({"cutoff_hz": "50"}, "cutoff_hz must be a positive frequency, got '50'"),
        ({"cutoff_hz": True}, "cutoff_hz must be a positive frequency, got True"),
        ({"order": 0}, "order must be a whole number from 1 to 10, got 0"),
        ({"order": 11}, "order must be a whole number from 1 to 10, got 11"),
        ({"order": 4.0}, "order must be a whole number from 1 to 10, got 4.0"),
        ({"order": True}, "order must be a whole number from 1 to 10, got True"),
        ({"trim_start": 2.5}, "trim_start must be a whole number of at least 0, got 2.5"),
        ({"trim_end": "3"}, "trim_end must be a whole number of at least 0, got '3'"),
        ({"decimation": (10.0,)}, "each decimation factor must be a whole number of at least 2, got 10.0"),
        ({"decimation": (True,)}, "each decimation factor must be a whole number of at least 2, got True"),
        ({"decimation": 10}, "decimation must be a tuple of whole numbers, got 10"),
        ({"decimation": "10"}, "decimation must be a tuple of whole numbers, got '10'"),
        ({"trim_end": -1}, "trim_end must be a whole number of at least 0, got -1"),
        ({"edge_rows": -1}, "edge_rows must be a whole number of at least 0, got -1"),
        ({"edge_rows": 1.0}, "edge_rows must be a whole number of at least 0, got 1.0"),
        ({"decimation": (10, 1)}, "each decimation factor must be a whole number of at least 2, got 1"),
        ({"padding": "octave"}, "padding must be 'scipy' or 'matlab', got 'octave'"),
        ({"decimation_convention": "R"}, "decimation_convention must be 'scipy' or 'matlab', got 'R'"),
    ],
)
def test_settings_are_checked_when_made(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SignalError) as error:
        SignalProcessing(**settings)  # type: ignore[arg-type]
    assert str(error.value) == message


def test_settings_are_plain_numbers_afterwards() -> None:
    signal = SignalProcessing(cutoff_hz=50, order=np.int64(2), decimation=[np.int64(5)])  # type: ignore[arg-type]
    assert signal == SignalProcessing(cutoff_hz=50.0, order=2, decimation=(5,))
    assert json.loads(json.dumps(asdict(signal)))["decimation"] == [5]


@pytest.mark.parametrize(
    ("order", "cutoff", "rate", "form"),
    [
        (4, 50.0, 5000.0, "transfer-function"),  # examples/tx40_log.toml
        (10, 50.0, 500.0, "transfer-function"),
        (10, 0.05, 5000.0, "sections"),
        (1, 0.05, 5000.0, "sections"),
    ],
)
def test_a_sound_filter_leaves_constants_as_they_are(
    order: int, cutoff: float, rate: float, form: Form
) -> None:
    x = np.ones((100, 2))
    filtered = zero_phase_butterworth(x, rate, cutoff, order, "scipy", form)
    np.testing.assert_allclose(filtered, x, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("order", "cutoff", "rate", "form"),
    [
        (8, 20.0, 5000.0, "transfer-function"),
        (10, 5.0, 500.0, "transfer-function"),
        (8, 498.0, 1000.0, "transfer-function"),
        (4, 1e-9, 500.0, "sections"),
        (1, 1e-12, 500.0, "sections"),
        (4, 1e-300, 1e300, "sections"),
        (4, 40.0, 1e300, "transfer-function"),
    ],
)
def test_a_filter_that_rounding_spoils_is_refused(order: int, cutoff: float, rate: float, form: Form) -> None:
    with pytest.raises(SignalError) as error:
        zero_phase_butterworth(noise(100, 1), rate, cutoff, order, "scipy", form)
    said = f"rounding spoils a filter of order {order} at {cutoff:g} Hz, sampled at {rate:g} Hz: move the "
    assert str(error.value).startswith(said + "cut-off away from zero and from half the sampling rate")
    assert str(error.value).endswith("use form 'sections'") is (form == "transfer-function")


def test_the_order_of_a_direct_call_is_bounded_too() -> None:
    with pytest.raises(SignalError, match=r"^order must be a whole number from 1 to 10, got 1000$"):
        zero_phase_butterworth(noise(100, 1), 1000.0, 100.0, 1000)


def test_a_decimation_beyond_the_record_or_beyond_rounding() -> None:
    with pytest.raises(
        SignalError, match=r"decimation by 1000 needs more than 999 samples, stage 1 of 1 gets 9"
    ):
        decimation_stages(900, SignalProcessing(decimation=(1000,)))
    huge = SignalProcessing(decimation=(10**400,))
    with pytest.raises(SignalError, match="needs more than 9999"):
        decimation_stages(900, huge)
    decimation_stages(10**7, SignalProcessing(decimation=(10**4,)))
    with pytest.raises(
        SignalError, match="rounding spoils the filter of a decimation by 1000000: take several"
    ):
        decimation_stages(10**7, SignalProcessing(decimation=(10**6,)))


def test_derivatives_that_overflow_are_told() -> None:
    with pytest.raises(SignalError, match=r"^derivatives at a sampling time of 1e-300 s are too large"):
        differentiate(noise(50, 2), 1e300, SignalProcessing())


def test_what_the_core_refuses_is_a_sentence() -> None:
    (stage,) = decimation_stages(100, SignalProcessing(decimation=(2,)))
    with pytest.raises(SignalError, match="filter stage 0 needs more than 27 samples"):
        decimate(noise(20, 1), [stage])


@pytest.mark.parametrize("factors", [(10**6,), (10,) * 9])
def test_noise_of_a_decimation_that_cannot_be_is_refused(factors: tuple[int, ...]) -> None:
    """Before its spectrum takes gigabytes."""
    with pytest.raises(SignalError, match=r"a decimation by 10+ in all is too large, 10000 is possible"):
        noise_correlation(SignalProcessing(decimation=factors))
