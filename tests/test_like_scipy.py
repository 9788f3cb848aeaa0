"""Numbers that SciPy has too, without loading it: designs of filters to the bit, spectra, tails, quantiles, minima."""

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.signal
import scipy.special

from didim.signal.design import butterworth, chebyshev, steady_state, steady_states
from didim.signal.special import bounded_minimum, f_tail, student_quantile, student_tail
from didim.signal.spectrum import welch


@pytest.mark.parametrize("order", range(1, 11))
@pytest.mark.parametrize("kind", ["butterworth", "chebyshev"])
def test_filters_are_designed_to_the_bit(kind: str, order: int) -> None:
    theirs: Any  # scipy-stubs know real poles only
    for share in (0.004, 0.02, 0.08, 0.33, 0.7, 0.99):
        if kind == "butterworth":
            ours, theirs = butterworth(order, share), scipy.signal.butter(order, share, output="zpk")
        else:
            ours = chebyshev(order, 0.05, share)
            theirs = scipy.signal.cheby1(order, 0.05, share, output="zpk")
        b, a = scipy.signal.zpk2tf(*theirs)
        sections = scipy.signal.zpk2sos(*theirs)
        np.testing.assert_array_equal(ours.poles, theirs[1])
        np.testing.assert_array_equal(ours.sections(), sections)
        np.testing.assert_array_equal(np.array(ours.transfer_function()), [b, a])
        np.testing.assert_array_equal(steady_states(sections), scipy.signal.sosfilt_zi(sections))
        np.testing.assert_array_equal(steady_state(b, a), scipy.signal.lfilter_zi(b, a))


@pytest.mark.parametrize("straight", [False, True])
@pytest.mark.parametrize("size", [33, 64, 1000])
def test_spectra_agree(size: int, straight: bool) -> None:
    signal = np.cumsum(np.random.default_rng(size).standard_normal(1000)) + 1.0
    f, power = welch(signal, 123.0, size, straight=straight)
    detrend: Any = "linear" if straight else False
    g, expected = scipy.signal.welch(signal, 123.0, nperseg=size, detrend=detrend)
    np.testing.assert_allclose(f, g, rtol=1e-14)
    np.testing.assert_allclose(power, expected, rtol=1e-9, atol=1e-14 * expected.max())


def test_tails_and_quantiles_agree() -> None:
    for n, t in product([1.0, 2.5, 19.0, 101.0, 2700.0, 1e7], [0.0, 1e-3, 0.3, 2.0, 5.0, 30.0]):
        assert student_tail(t, n) == pytest.approx(float(scipy.special.stdtr(n, -t)), rel=1e-9)
        assert student_tail(-t, n) == pytest.approx(float(scipy.special.stdtr(n, t)), rel=1e-9)
    for n, tail in product([1.0, 2.5, 19.0, 101.0, 2700.0, 1e7, math.inf], [0.4999, 0.1, 0.025, 1e-6, 1e-12]):
        freely = math.isfinite(n)
        expected = scipy.special.stdtrit(n, tail) if freely else scipy.special.ndtri(tail)
        assert student_quantile(tail, n) == pytest.approx(-float(expected), rel=1e-9)
    for m, n, value in product([1, 5, 60], [1, 19, 2700], [1e-6, 0.5, 1.0, 2.0, 20.0]):
        assert f_tail(value, m, n) == pytest.approx(float(scipy.special.fdtrc(m, n, value)), rel=1e-9)
    assert math.isnan(student_quantile(0.1, 0.0))
    assert math.isnan(f_tail(1.0, 2.0, 0.0))
    assert f_tail(-1.0, 2.0, 3.0) == 1.0
    assert f_tail(math.inf, 2.0, 3.0) == 0.0


def test_minima_are_found_in_the_same_steps() -> None:
    generator = np.random.default_rng(1)
    for number in range(300):
        a, b, c, w = generator.standard_normal(4)
        low = generator.uniform(-3.0, 0.0)
        high = low + generator.uniform(0.0, 4.0)
        tolerance, evaluations = 10.0 ** generator.uniform(-8.0, -1.0), int(generator.integers(2, 40))

        def cost(x: float, terms: tuple[float, ...] = (a, b, c, w), flat: bool = number % 5 == 0) -> float:
            a, b, c, w = terms
            return round(a * x * x, 1) if flat else a * math.cos(3.0 * w * x + b) + c * c * (x - w) ** 2

        expected = scipy.optimize.minimize_scalar(
            cost,
            bounds=(low, high),
            method="bounded",
            options={"xatol": tolerance, "maxiter": evaluations},
        )
        assert bounded_minimum(cost, low, high, tolerance, evaluations) == expected.x
