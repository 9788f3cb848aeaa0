"""Dotted keys: changes by a scenario of an experiment file, of a robot file, or of the settings of methods.

``signal.cutoff_hz`` is a key of the experiment, ``robot.joint.2.d_m`` one of the robot file (the second joint), and
``method.max_iterations`` a setting of every method. ``truth.`` in front restricts a key to the simulated robot,
``model.`` to the robot model of the methods. Tested in ``tests/test_study_spec.py``.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import StudyError

Keys = Mapping[str, Any]

PROCESSING = ("signal", "least_squares", "delay", "parameters")
"""Tables of an experiment that control the processing of a log; they do not change the simulated log."""


@dataclass(frozen=True)
class Parts:
    """Keys of a scenario, grouped by the content that they change.

    Attributes
    ----------
    truth, model : dict
        Keys of the experiment, for the simulated log and for the methods.
    truth_robot, model_robot : dict
        Keys of the robot file, likewise.
    method : dict
        Settings of all methods.
    """

    truth: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    truth_robot: dict[str, Any] = field(default_factory=dict)
    model_robot: dict[str, Any] = field(default_factory=dict)
    method: dict[str, Any] = field(default_factory=dict)


def parts_of(keys: Keys) -> Parts:
    """Group the keys of a scenario by the content that they change.

    Raises
    ------
    StudyError
        For a key without a table, or ``truth.`` in front of a key that changes nothing of a simulated log.
    """
    parts = Parts()
    for key, value in keys.items():
        side = next((prefix for prefix in ("truth.", "model.") if key.startswith(prefix)), "")
        inner = key.removeprefix(side)
        root, _, rest = inner.partition(".")
        if not rest:
            raise StudyError(
                f"key {key!r} names no table: write it as TABLE.KEY, such as signal.cutoff_hz or robot.friction.coulomb"
            )
        if root == "method":
            if side:
                raise StudyError(
                    f"key {key!r}: methods have settings on their own side only; leave out {side!r}"
                )
            parts.method[rest] = value
            continue
        if root in PROCESSING and side == "truth.":
            raise StudyError(f"key {key!r}: [{root}] does not change a simulated log; leave out 'truth.'")
        if root == "measurement" and side == "model.":
            raise StudyError(f"key {key!r}: methods do not use the noise of a log; omit 'model.'")
        own = root == "robot"
        truth, model = (parts.truth_robot, parts.model_robot) if own else (parts.truth, parts.model)
        if side != "model." and root not in PROCESSING:
            truth[rest if own else inner] = value
        if side != "truth.":
            model[rest if own else inner] = value
    return parts


def changed(content: Mapping[str, Any], keys: Keys, what: str) -> dict[str, Any]:
    """Return the content of a file with dotted keys set.

    A number in a key is an index of a list, from 1. The value ``{ times = 0.7 }`` multiplies the number or numbers of the file.

    Parameters
    ----------
    content : mapping
        Content as parsed by `tomllib`; it is not modified.
    keys : mapping
        Values by dotted key.
    what : str
        Name of the file in messages.

    Raises
    ------
    StudyError
        When a key leads through a value that is not a table, or multiplies what is not a number.
    """
    made: dict[str, Any] = copy.deepcopy(dict(content))
    for key, value in keys.items():
        *steps, last = key.split(".")
        node: Any = made
        for step in steps:
            node = _enter(node, step, key, what)
        if isinstance(value, Mapping) and set(value) == {"times"}:
            value = _times(_enter(node, last, key, what, make=False), value["times"], key, what)
        if isinstance(node, list):
            node[_index(node, last, key, what)] = copy.deepcopy(value)
        else:
            node[last] = copy.deepcopy(value)
    return made


def _enter(node: Any, step: str, key: str, what: str, *, make: bool = True) -> Any:
    if isinstance(node, list):
        child = node[_index(node, step, key, what)]
    else:
        if step not in node and not make:
            raise StudyError(f"{what} has no {key!r} to multiply: give its value")
        child = node.setdefault(step, {})
    if make and not isinstance(child, dict | list):
        raise StudyError(f"key {key!r}: {step!r} is a value in {what}, and not a table")
    return child


def _index(node: list[Any], step: str, key: str, what: str) -> int:
    if not step.isdecimal() or not 1 <= int(step) <= len(node):
        raise StudyError(f"key {key!r}: {step!r} must be a place from 1 to {len(node)} in a list of {what}")
    return int(step) - 1


def _times(value: Any, factor: Any, key: str, what: str) -> Any:
    if isinstance(value, list):
        factors = factor if isinstance(factor, list) else [factor] * len(value)
        if len(factors) != len(value):
            raise StudyError(f"key {key!r}: {len(factors)} factors for {len(value)} numbers of {what}")
        return [_times(part, by, key, what) for part, by in zip(value, factors, strict=True)]
    if any(isinstance(part, bool) or not isinstance(part, int | float) for part in (value, factor)):
        raise StudyError(
            f"key {key!r}: times multiplies a number of {what} by a number, not {value!r} by {factor!r}"
        )
    return value * factor
