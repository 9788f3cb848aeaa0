"""Tails and quantiles of distributions and Brent's minimum as SciPy has them, whose parts take longer to load than a fit.

``tests/test_like_scipy.py`` compares the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable

STEPS = 200
"""Most steps of a quantile: bisection alone needs 60 for the digits of a number."""
TERMS = 20000
"""Most terms of a continued fraction: some 3 times the root of the degrees of freedom are needed, and a log has 1e7 rows."""
LARGE = 50.0
"""Argument from which Stirling's series of a logarithm of Gamma, up to the seventh power, is exact to rounding."""
GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))
"""Smaller part of the golden section."""
ROUNDING = math.sqrt(2.2e-16)
"""Smallest step, as a share of the variable, that changes a cost near its minimum by more than rounding does."""


def student_tail(t: float, degrees_of_freedom: float) -> float:
    """Probability of more than `t` by Student's distribution; by the normal one for infinite degrees of freedom."""
    if t < 0.0:
        return 1.0 - student_tail(-t, degrees_of_freedom)
    if not math.isfinite(degrees_of_freedom):
        return 0.5 * math.erfc(t / math.sqrt(2.0))
    n = degrees_of_freedom
    return 0.5 * _incomplete_beta(0.5 * n, 0.5, n / (n + t * t), t * t / (n + t * t))


def student_quantile(tail: float, degrees_of_freedom: float) -> float:
    """Value that Student's variable exceeds with the probability `tail`, above 0 and up to a half; the normal one likewise.

    NaN without degrees of freedom.
    """
    n = degrees_of_freedom
    if n <= 0.0:
        return math.nan
    low, high = 0.0, 1.0
    while student_tail(high, n) > tail:
        low, high = high, 2.0 * high
    t = high
    for _ in range(STEPS):
        p = student_tail(t, n)
        low, high = (t, high) if p > tail else (low, t)
        # Newton's step on the logarithm, within the bracket.
        step = math.log(p / tail) * p / _student_density(t, n) if p > 0.0 else math.inf
        following = t + step if low <= t + step <= high else 0.5 * (low + high)
        if abs(following - t) <= 1e-15 * following:
            return following
        t = following
    return t


def f_tail(value: float, numerator: float, denominator: float) -> float:
    """Probability of more than `value` by the F distribution; NaN where a number of degrees of freedom is not positive."""
    if math.isnan(value) or not (numerator > 0.0 and denominator > 0.0):
        return math.nan
    if value <= 0.0:
        return 1.0
    a, b = 0.5 * denominator, 0.5 * numerator
    if math.isinf(value):
        return 0.0
    return _incomplete_beta(a, b, a / (a + b * value), b * value / (a + b * value))


def _student_density(t: float, n: float) -> float:
    if not math.isfinite(n):
        return math.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi)
    return math.exp(-_log_beta(0.5 * n, 0.5) - 0.5 * math.log(n) - 0.5 * (n + 1.0) * math.log1p(t * t / n))


def _incomplete_beta(a: float, b: float, x: float, y: float) -> float:
    """Regularised incomplete beta function ``I_x(a, b)``, with ``y = 1 - x``, by its continued fraction (Lentz's method)."""
    if x <= 0.0 or y <= 0.0:
        return 0.0 if x <= 0.0 else 1.0
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - _incomplete_beta(b, a, y, x)
    # The smaller of the two keeps its digits, so the logarithm of the other comes from it.
    log_x, log_y = (math.log(x), math.log1p(-x)) if x < y else (math.log1p(-y), math.log(y))
    front = math.exp(a * log_x + b * log_y - _log_beta(a, b)) / a

    def term(m: int) -> float:
        half = m // 2
        if m % 2:
            return -(a + half) * (a + b + half) * x / ((a + m - 1) * (a + m))
        return half * (b - half) * x / ((a + m - 1) * (a + m))

    return front / _continued_fraction(term)


def _continued_fraction(term: Callable[[int], float]) -> float:
    """``1 + term(1) / (1 + term(2) / (1 + ...))``."""
    tiny = 1e-300
    value = c = 1.0
    d = 0.0
    for m in range(1, TERMS):
        d = 1.0 / (1.0 + term(m) * d or tiny)
        c = 1.0 + term(m) / c or tiny
        value *= c * d
        if abs(c * d - 1.0) < 1e-16:
            break
    return value


def _log_beta(a: float, b: float) -> float:
    """``log(Gamma(a) Gamma(b) / Gamma(a + b))``: for one large argument the logarithms of Gamma would lose all digits."""
    a, b = max(a, b), min(a, b)
    if a < LARGE:
        return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    rise = _stirling(a) - _stirling(a + b) - (a - 0.5) * math.log1p(b / a)
    if b < LARGE:
        return rise - b * math.log(a + b) + b + math.lgamma(b)
    return rise + b * math.log(b / (a + b)) - 0.5 * math.log(b) + 0.5 * math.log(2.0 * math.pi) + _stirling(b)


def _stirling(x: float) -> float:
    """``log Gamma(x)`` less ``(x - 1/2) log x - x + log(2 pi) / 2``, for a large argument."""
    square = 1.0 / (x * x)
    return (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1260.0 - square / 1680.0))) / x


def bounded_minimum(
    cost: Callable[[float], float], low: float, high: float, tolerance: float, evaluations: int
) -> float:
    """Return the smallest of the costs tried, by parabolas through the best three and golden sections where these fail.

    Parameters
    ----------
    cost
        What is to be small.
    low, high
        Bounds, which are not tried themselves.
    tolerance
        How near the minimum it stops, in the unit of the variable.
    evaluations
        Most costs that are tried.
    """
    best = second = third = low + GOLDEN * (high - low)
    at_best = at_second = at_third = cost(best)
    step = before = 0.0
    for _ in range(evaluations - 1):
        middle, least = 0.5 * (low + high), ROUNDING * abs(best) + tolerance / 3.0
        if abs(best - middle) <= 2.0 * least - 0.5 * (high - low):
            break
        parabolic = False
        if abs(before) > least:
            r, q = (best - second) * (at_best - at_third), (best - third) * (at_best - at_second)
            p, q = (best - third) * q - (best - second) * r, 2.0 * (q - r)
            p, q = -p if q > 0.0 else p, abs(q)
            r, before = before, step
            parabolic = abs(p) < abs(0.5 * q * r) and q * (low - best) < p < q * (high - best)
        if parabolic:
            step = (p + 0.0) / q  # no negative zero: the sign of a step counts
            if min(best + step - low, high - best - step) < 2.0 * least:
                step = math.copysign(least, middle - best)
        else:
            before = low - best if best >= middle else high - best
            step = GOLDEN * before
        tried = best + math.copysign(max(abs(step), least), step)
        value = cost(tried)
        if value <= at_best:
            low, high = (best, high) if tried >= best else (low, best)
            third, at_third, second, at_second = second, at_second, best, at_best
            best, at_best = tried, value
            continue
        low, high = (tried, high) if tried < best else (low, tried)
        if value <= at_second or second == best:
            third, at_third, second, at_second = second, at_second, tried, value
        elif value <= at_third or third in (best, second):
            third, at_third = tried, value
    return best
