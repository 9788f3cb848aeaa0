"""Sentences of findings on a log that a result was not fitted to: payloads, validations, residuals.

Tested in ``tests/test_wrong_calls.py``.
"""

from __future__ import annotations

from typing import Any

from ..._tools.words import joints_text, series

Finding = Any
"""The class of `didim.result.finding`."""


def _of(f: Finding) -> str:
    return joints_text(joint - 1 for joint in f.joints)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g}" if share < 0.995 else f"{100.0 * share:.0f}"


def _mass(kilograms: float, digits: int = 3) -> str:
    """Return a mass as text: in grams below 1 kg."""
    size = abs(kilograms)
    return f"{1e3 * size:.2g} g" if size < 0.0995 else f"{size:.{digits}g} kg"


def _and_sigma(f: Finding) -> str:
    return f"{abs(f.value):.3g} +- {f.deviation:.1g} kg"


def larger(f: Finding) -> str:
    """Return the sentence on errors above those of the fit, in a log that it was not fitted to."""
    ratios = f.facts["ratios"]
    low, high = (f"{value:.2g}" if value < 99.5 else f"{value:.0f}" for value in (min(ratios), max(ratios)))
    times = low if low == high else f"{low} to {high}"
    where = f"recording {series(f.recordings, 20)}: the torques of {_of(f)}"
    return (
        f"{where} are off by up to {_percent(f.facts['share'])} %, {times} times as much (N.m) as in the fit"
    )


def larger_advice(f: Finding) -> str:
    """Return the advice for it."""
    if f.facts["explained"]:
        return ""
    if f.grade == "wrong":
        return (
            "No unit, side, order or sign of the columns, no load and no other parameters explain it: is this log of the robot "
            "of the result?"
        )
    return "The logs differ (load, temperature, friction), or the fit lacks motion that this one has"


def _left(f: Finding) -> str:
    return f"{_percent(f.facts['left'])} % of the error remain (geometric mean)"


def _undeclared(f: Finding) -> str:
    load = "a load" if f.value is None or f.value > 0.0 else "less load"
    mass = "" if f.value is None else f" of {_and_sigma(f)}"
    link = f.facts["link"]
    if f.value is not None and f.value < 0.0:
        return f"the {link} carries {_and_sigma(f)} less than in the log of the fit: with that {_left(f)}"
    return f"the {link} carries {load}{mass} that is not declared: with it {_left(f)}"


def _undeclared_advice(f: Finding) -> str:
    if f.value is not None and f.value < 0.0:
        return 'Fit the robot without its tool, and declare the tool: [payload.NAME] and payload = "NAME" under [[recording]]'
    return 'Declare it: [payload.NAME] and payload = "NAME" under [[recording]]; didim payload estimates it'


def _no_load(f: Finding) -> str:
    bound = "" if f.value is None else f", below {_mass(max(f.value, 0.0))}"
    if f.facts["same"]:
        return f"no load seen{bound}: the robot was fitted to this log, so what it carries is in the robot already"
    return f"no load seen{bound}: nothing is on the flange that the log of the fit did not have there"


def _as_fitted(f: Finding) -> str:
    parts = (f"{each['key']} = {each['value']} (file: {each['file']})" for each in f.facts["taken"])
    return f"taken from the result, not from this log's file: {series(parts, 130)}"


WORDS: dict[str, tuple[Any, Any]] = {
    "other-friction": (
        lambda f: (
            f"the friction{f' of {_of(f)}' if f.joints else ''} is not that of the result: with friction of this log's own "
            f"{_left(f)}"
        ),
        'Give the recording friction = "own" where the command estimates a payload, or fit a log at this temperature',
    ),
    "undeclared-load": (_undeclared, _undeclared_advice),
    "other-robot": (
        lambda f: (
            f"this log is not of the robot of the result: its links miss {_percent(f.value)} % of the torques, and other "
            f"parameters of the same geometry {_percent(f.effect)} %"
        ),
        "Fit a log of this robot; a reading of the columns, friction and a load were tried and do not explain it",
    ),
    "no-load": (
        _no_load,
        lambda f: (
            "Fit a log without the tool"
            if f.facts["same"]
            else "If there is a load, it was there in the log of the fit too: fit a log without it"
        ),
    ),
    "load-inside": (
        lambda f: (
            f"this log has {_and_sigma(f)} less than the robot of the result: no load has a negative mass"
        ),
        "The log of the fit had a tool that is in the robot now: fit a log without it",
    ),
    "absurd-load": (
        lambda f: (
            f"no arm carries this load{'' if f.value is None else f' of {f.value:.3g} kg'}: its torques are {f.effect:.2g} times "
            "those of the robot itself"
        ),
        "Look at the unit and the side of the torques, and run didim check",
    ),
    "no-body": (
        lambda f: (
            f"the estimate is half a squared distance of {f.value:.3g} from the nearest body: more than noise explains"
        ),
        "The robot, the log or its offsets are not those of the result",
    ),
    "not-completed": (
        lambda f: f"recording '{f.recordings[0]}': the simulation {f.facts['ending']}",
        "Look at [controller] and [reference], and at the step of the simulation",
    ),
    "as-fitted": (_as_fitted, ""),
}
"""Sentence and advice by code."""
