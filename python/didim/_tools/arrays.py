"""Arrays from users: real numbers as float64, anything else refused in one sentence.

NumPy would drop the imaginary part of a complex number, convert the text "1.5" to a number and None to NaN.
Tested in ``tests/test_arrays.py``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DidimError

Array = NDArray[np.float64]

LARGEST_POSITION = 1e9
"""Largest position of a joint (rad or m): larger angles have lost their digits, and the core's sine ends at 1e15."""

LARGEST_SQUARED = 1e150
"""Largest number whose square may be summed: squares stay far below the limit of floating point."""

_FLOAT64 = np.dtype(np.float64)


def real_array(what: str, value: ArrayLike, error: type[DidimError]) -> Array:
    """Return `value` as float64, of any shape and not necessarily finite; a copy only if needed.

    Parameters
    ----------
    what : str
        Name in messages.
    value : array_like
        Real numbers.
    error : type of DidimError
        Class of the error to raise.

    Raises
    ------
    DidimError
        Of class `error`, for complex numbers, texts, objects and rows of different length.
    """
    if type(value) is np.ndarray and value.dtype is _FLOAT64:  # by far the most frequent case: no conversion
        return value
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):  # such as rows of different length
        raise error(f"{what} must be an array of real numbers") from None
    if array.dtype.kind not in "fiub":
        kind = "complex numbers" if array.dtype.kind == "c" else f"values of type {array.dtype}"
        raise error(f"{what} must be an array of real numbers, got {kind}")
    return np.asarray(array, dtype=np.float64)


def surely_within(array: Array, limit: float) -> bool:
    """Check by one sum of squares that every number is finite and at most `limit` in size.

    False only means that each number must be checked, for example if some are close to the limit or the sum overflows. The
    bound is half the squared limit, because of rounding.
    """
    return bool(np.vdot(array, array) <= 0.5 * limit * limit)


def ratio(part: float | np.floating, whole: float | np.floating) -> float:
    """Return part over whole; NaN without a whole."""
    return float(part / whole) if whole > 0.0 else float("nan")


def quotient(values: Array, sizes: Array, otherwise: float = 0.0) -> Array:
    """Return values over sizes, and `otherwise` where a size is not positive; shapes are broadcast."""
    out = np.full(np.broadcast_shapes(values.shape, sizes.shape), otherwise)
    return np.asarray(np.divide(values, sizes, out=out, where=sizes > 0.0))


def unit_diagonal(matrix: Array) -> tuple[Array, Array]:
    """Return a symmetric matrix (n, n) scaled to a diagonal of ones, and the roots of its diagonal, (n,); a zero stays, with 1."""
    size = np.sqrt(np.diag(matrix))
    size[size == 0.0] = 1.0
    return matrix / np.outer(size, size), size


def rms(values: Array) -> Array:
    """Return the root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def relative_percent(std: Array, values: Array) -> Array:
    """Equation (11): standard deviations in percent of the size of their values; NaN for values of zero."""
    with np.errstate(over="ignore"):  # infinite for tiny values
        return 100.0 * quotient(std, np.abs(values), np.nan)


def true_ranges(flags: NDArray[np.bool_], shortest: int = 1) -> list[tuple[int, int]]:
    """Return the half-open ranges of at least `shortest` true flags in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(start, stop) for start, stop in edges.reshape(-1, 2).tolist() if stop - start >= shortest]
