"""Checks of settings, with the same message for the same fault everywhere. Tested in ``tests/test_settings.py``."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from ..errors import DidimError
from .words import brief, series

if TYPE_CHECKING:
    from .keys import Keys


def check_declared(settings: Any, keys: Keys, error: type[DidimError]) -> None:
    """Check the fields of a frozen dataclass that are declared keys of one type; None is valid where it is the default.

    Parameters
    ----------
    settings : dataclass
        Its whole and positive numbers become those of Python.
    keys : Keys
        Bounds and choices.
    error : type of DidimError
        Class of the error to raise.
    """
    for setting in fields(settings):
        key, value = keys.rows.get(setting.name), getattr(settings, setting.name)
        if key is None or (value is None and setting.default is None):
            continue
        if key.type == "integer":
            value = whole(key.name, value, error, least=key.minimum, most=key.maximum)
        elif key.type == "number" and (key.above is not None or (key.minimum or 0.0) > 0.0):
            value = positive(key.name, value, error, "frequency" if key.unit == "Hz" else "number")
            if key.minimum is not None and value < key.minimum:
                raise error(f"{key.name} must be at least {key.minimum:g}, got {brief(repr(value))}")
        elif key.type == "true or false":
            one_of(key.name, value, (True, False), error)
        elif key.choices:
            one_of(key.name, value, key.choices, error)
        object.__setattr__(settings, setting.name, value)


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
    raise error(f"{name} must be a whole number{bounds}, got {brief(repr(value))}")


def share(
    name: str, value: object, error: type[DidimError], *, most: float = 1.0, inside: bool = False
) -> float:
    """Return a number from zero to a bound, which are included unless it must be `inside` of them; other parameters as `whole`."""
    number = real_number(value)
    if 0.0 < number < most or (not inside and number in (0.0, most)):
        return number
    raise error(f"{name} must be between 0 and {most:g}, got {brief(repr(value))}")


def positive(name: str, value: object, error: type[DidimError], unit: str = "number") -> float:
    """Return a positive finite number; `unit` is its noun in the message, other parameters as `whole`."""
    number = real_number(value)
    if 0.0 < number < float("inf"):
        return number
    raise error(f"{name} must be a positive {unit}, got {brief(repr(value))}")


def real_number(value: object) -> float:
    """Return a real number as a float; nan for anything else, and for a whole number that no float holds."""
    if isinstance(value, Real) and not isinstance(value, bool):
        with suppress(OverflowError):
            return float(value)
    return float("nan")


def one_of(name: str, value: object, choices: Sequence[object], error: type[DidimError]) -> None:
    """Refuse a value that is not among the choices; parameters as `whole`."""
    # Equality does not suffice: 1 == True.
    if any(value is choice or (type(value) is type(choice) and value == choice) for choice in choices):
        return
    *first, last = (repr(choice) for choice in choices)
    text = f"{series(first, 60)} or {last}" if first else last
    raise error(f"{name} must be {text}, got {brief(repr(value), 40)}")
