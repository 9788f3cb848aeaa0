"""Methods of a study, from their names and settings as plain data. Tested in ``tests/test_study_spec.py``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from .._tools.arrays import Array
from .._tools.settings import share
from .._tools.words import did_you_mean
from ..errors import StudyError
from ..methods.method import Method
from ..methods.table import method_class

OBJECTS = ("signal", "checkpoint", "progress")
"""Settings that are not plain data, or that a study sets by other keys."""


def method_of(
    name: str, settings: Mapping[str, Any], start: Callable[[float], Array] | None = None
) -> Method:
    """Make a method.

    Parameters
    ----------
    name : str
        Name such as "didim".
    settings : mapping
        Plain data. ``start = { spread = 0.15 }`` is a random start within 15 % of the truth, a different one for each seed.
    start : callable, optional
        Function that draws a start with a spread.

    Raises
    ------
    StudyError
        For a setting that the method does not have.
    FitError
        For an unknown method, or a wrong value.
    """
    made = method_class(name)
    options = dict(settings)
    known = [option.name for option in fields(made) if option.init] if is_dataclass(made) else list(options)
    for key in options:
        if key in OBJECTS:
            raise StudyError(
                f'method {name!r}: {key} cannot be set in a study; keys of the experiment such as "signal.cutoff_hz" can'
            )
        if key not in known:
            raise StudyError(f"method {name!r} has no setting {key!r}{did_you_mean(key, known)}")
    wanted = options.get("start")
    if isinstance(wanted, Mapping) and set(wanted) == {"spread"}:
        spread = share("start.spread", wanted["spread"], StudyError)
        # Without a seed the settings are only checked.
        options["start"] = "unit" if start is None else start(spread)
    method: Method = made(**options)
    return method
