"""Fields of a saved result, from its JSON. Tested in ``tests/test_identification.py``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from .finding import Finding
from .further import Further
from .iteration import HeldOut, Iteration
from .status import Status
from .uncertainty import Uncertainty
from .verdict import DERIVED, Use

TABLES = ("cloe", "consistent", "positions", "prediction", "robot", "signal", "versions")
"""Settings of a result that are tables, if they are there."""


def fields_of(data: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of an `Identification` by name, from the JSON of `Identification.to_dict`.

    Raises
    ------
    KeyError, AttributeError, TypeError, ValueError, OverflowError, IndexError
        For JSON of a different structure.
    """
    parameters = data["parameters"]
    known = ("iteration", "relative_error", "step")
    return {
        "name": data["name"],
        "robot": data["robot"],
        "method": data["method"],
        "status": Status[data["status_name"]],
        "names": tuple(item["name"] for item in parameters),
        "units": tuple(item["unit"] for item in parameters),
        "roles": tuple(item["role"] for item in parameters),
        "beta": np.array([item["value"] for item in parameters]),
        "covariance": np.array(data["covariance"]).reshape(len(parameters), len(parameters)),
        "parameter_names": tuple(data["standard_parameters"]),
        "parameters": np.array(list(data["standard_parameters"].values())),
        "relative_error": np.array([_number(value) for value in data["relative_error"]]),
        "overall_relative_error": _number(data["overall_relative_error"]),
        "error_norm": data["error_norm"],
        "error_std": data["error_std"],
        "condition_number": _number(data["condition_number"], math.inf),
        "n_rows": data["n_rows"],
        "n_simulations": data["n_simulations"],
        "elapsed": data["elapsed_s"],
        "history": tuple(
            Iteration(
                iteration=item["iteration"],
                relative_error=_number(item["relative_error"]),
                step=_number(item["step"]),
                more={key: _number(value) for key, value in item.items() if key not in known},
            )
            for item in data["history"]
        ),
        "held_out": tuple(
            HeldOut(
                name=item["name"],
                relative_error=tuple(_number(value) for value in item["relative_error"]),
                overall_relative_error=_number(item["overall_relative_error"]),
                error_rms=tuple(_number(value) for value in item.get("error_rms", ())),
            )
            for item in data["held_out"]
        ),
        "warnings": _texts(data["warnings"]),
        "remarks": _texts(data.get("remarks", ())),
        "ending": str(data.get("ending", "")),
        "evidence": tuple(
            Finding.from_dict(item)
            for item in data.get("verdict", {}).get("reasons", ())
            if item["code"] not in DERIVED
        ),
        "uses": tuple(Use(**item) for item in data.get("verdict", {}).get("uses", ())),
        "uncertainty": None
        if data.get("uncertainty") is None
        else Uncertainty.from_dict(
            data["uncertainty"], np.array([_number(item["std_white"]) for item in parameters])
        ),
        "further": None if data.get("further") is None else Further.from_dict(data["further"]),
        "output_error": _pair(data.get("output_error")),
        "delay": data["delay"],
        "settings": _tables(data["settings"]),
        "digests": data["digests"],
    }


def _pair(values: list[float | None] | None) -> tuple[float, float] | None:
    return None if values is None else (_number(values[0]), _number(values[1]))


def _tables(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the settings; what is read as a table by its readers must be one."""
    robot = settings.get("robot")
    tables = {key: settings.get(key) for key in TABLES}
    if isinstance(robot, dict):
        tables["robot.friction"] = robot.get("friction")
    for key, table in tables.items():
        if not (table is None or isinstance(table, dict)):
            raise TypeError(f"settings.{key} is {table!r:.40} in place of a table")
    return settings


def _texts(values: Iterable[object]) -> tuple[str, ...]:
    texts = tuple(values)
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("a sentence is no text")
    return texts  # type: ignore[return-value]


def _number(value: float | None, missing: float = math.nan) -> float:
    return missing if value is None else float(value)
