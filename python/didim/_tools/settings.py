"""Checks of settings, with the same message for the same fault everywhere. Tested in ``tests/test_settings.py``."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral, Real

from ..errors import DidimError


def whole(
    name: str, value: object, error: type[DidimError], *, least: int | None = None, most: int | None = None
) -> int:
    """Return a whole number, of Python or NumPy, as an int; 4.0 and True are refused.

    Parameters
    ----------
    name : str
        Name of the setting in the message.
    value : object
        Given value.
    error : type of DidimError
        Class of the error to raise.
    least, most : int, optional
        Bounds, both included.
    """
    if isinstance(value, Integral) and not isinstance(value, bool):
        number = int(value)
        if (least is None or number >= least) and (most is None or number <= most):
            return number
    bounds = "" if least is None else f" of at least {least}" if most is None else f" from {least} to {most}"
    raise error(f"{name} must be a whole number{bounds}, got {value!r}")


def share(
    name: str,
    value: object,
    error: type[DidimError],
    *,
    most: float = 1.0,
    inside: bool = False,
) -> float:
    """Return a number from zero to a bound, which are included unless it must be `inside` of them; other parameters as `whole`."""
    if isinstance(value, Real) and not isinstance(value, bool):
        number = float(value)
        if 0.0 < number < most or (not inside and number in (0.0, most)):
            return number
    raise error(f"{name} must be between 0 and {most:g}, got {value!r}")


def positive(name: str, value: object, error: type[DidimError], unit: str = "number") -> float:
    """Return a positive finite number; `unit` is its noun in the message, other parameters as `whole`."""
    if isinstance(value, Real) and not isinstance(value, bool) and 0.0 < float(value) < float("inf"):
        return float(value)
    raise error(f"{name} must be a positive {unit}, got {value!r}")


def one_of(name: str, value: object, choices: Sequence[object], error: type[DidimError]) -> None:
    """Refuse a value that is not among the choices; parameters as `whole`."""
    # Equality does not suffice: 1 == True.
    if any(value is choice or (type(value) is type(choice) and value == choice) for choice in choices):
        return
    *first, last = (repr(choice) for choice in choices)
    text = f"{', '.join(first)} or {last}" if first else last
    raise error(f"{name} must be {text}, got {value!r}")
