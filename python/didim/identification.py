"""The result of an identification: immutable, printed as a table, saved as JSON and restored whole."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .errors import FitError
from .files import write_atomically
from .selection import Role
from .status import Status
from .table import render

Array = NDArray[np.float64]

SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """One iteration of a method, as told to ``callback`` and kept in ``history``.

    Attributes
    ----------
    iteration : int
        Counted from 1.
    relative_error : float
        Norm of the torque error over that of the torque, all joints.
    step : float
        Norm of the change of beta over that of beta (from zero in the first iteration).
    more : mapping of str to float
        What else the method has to say.
    """

    iteration: int
    relative_error: float
    step: float
    more: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """How well the estimate predicts the torques of a recording that it was not made from.

    Attributes
    ----------
    name : str
        Recording.
    relative_error : tuple of float
        Per joint, 0.07 = 7 %.
    overall_relative_error : float
        Of all joints together.
    """

    name: str
    relative_error: tuple[float, ...]
    overall_relative_error: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """Identified parameters of a robot, how certain they are, and how well they explain the log.

    All values are in SI units on the joint side.

    Attributes
    ----------
    name, robot, method : str
        Experiment, robot and method ("idim-ls").
    status : Status
        How it ended.
    names, units, roles : tuple of str
        Of the base parameters; a role is "estimated", "fixed" or "dropped".
    beta : ndarray, shape (b,)
        Base parameters.
    covariance : ndarray, shape (b, b)
        Equation (10); zero for fixed and dropped parameters.
    parameter_names : tuple of str
        Of the standard parameters.
    parameters : ndarray, shape (p,)
        Standard parameters with the torques of beta (lifted), in the order of ``robot.parameter_names``.
    relative_error : ndarray, shape (n_dof,)
        Norm of each joint's torque error over that of its torque, 0.07 = 7 %.
    overall_relative_error : float
        The same for all joints together.
    error_norm : float
        ``|Y - W beta|``, without weights.
    error_std : float
        Its standard deviation, by the divisor that the settings choose.
    condition_number : float
        Of the observation matrix W, without weights.
    n_rows : int
        Rows of W.
    output_error : (float, float) or None
        Norm of measured less simulated torque over that of measured torque, (12): with the initial parameters and with
        these; None for IDIM-LS, which simulates nothing.
    n_simulations : int
        Simulations of the direct dynamic model; none for IDIM-LS.
    elapsed : float
        Seconds.
    history : tuple of Iteration
        One per solution or iteration.
    held_out : tuple of HeldOut
        Recordings that were kept out of the fit.
    warnings : tuple of str
        Sentences on what physics forbids.
    remarks : tuple of str
        Sentences on what a reader should know: a log that looks wrong, a step that is too large.
    delay : mapping of str to float
        "compensated_samples", and "estimated_samples" and "estimated_seconds" if the delay was estimated.
    settings, digests : mapping
        What was asked for; SHA-256 of every file read.

    Notes
    -----
    ``test_identification.py`` saves, loads and compares everything.
    """

    name: str
    robot: str
    method: str
    status: Status
    names: tuple[str, ...]
    units: tuple[str, ...]
    roles: tuple[Role, ...]
    beta: Array
    covariance: Array
    parameter_names: tuple[str, ...]
    parameters: Array
    relative_error: Array
    overall_relative_error: float
    error_norm: float
    error_std: float
    condition_number: float
    n_rows: int
    output_error: tuple[float, float] | None = None
    n_simulations: int = 0
    elapsed: float = 0.0
    history: tuple[Iteration, ...] = ()
    held_out: tuple[HeldOut, ...] = ()
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    delay: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    digests: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n_base = len(self.names)
        shapes = {
            "beta": (n_base,),
            "covariance": (n_base, n_base),
            "parameters": (len(self.parameter_names),),
            "relative_error": (len(self.relative_error),),
        }
        for key, shape in shapes.items():
            values = np.array(getattr(self, key), dtype=np.float64)
            if values.shape != shape:
                raise FitError(f"{key} must have shape {shape}, got {values.shape}")
            values.flags.writeable = False
            object.__setattr__(self, key, values)
        for key in ("delay", "settings", "digests"):
            object.__setattr__(self, key, MappingProxyType(copy.deepcopy(dict(getattr(self, key)))))

    @property
    def std(self) -> Array:
        """Standard deviations of beta, shape (b,); zero for fixed and dropped parameters."""
        return cast(Array, np.sqrt(np.diag(self.covariance)))

    @property
    def relative_std_percent(self) -> Array:
        """Equation (11), shape (b,), percent; NaN where beta is zero."""
        size = np.abs(self.beta)
        with np.errstate(over="ignore"):  # infinite where beta is next to nothing
            return 100.0 * np.divide(self.std, size, out=np.full_like(size, np.nan), where=size > 0.0)

    @property
    def converged(self) -> bool:
        """Whether the method reached what it aims at."""
        return self.status.converged

    @property
    def n_iterations(self) -> int:
        """Number of iterations, that of the last entry of the history."""
        return self.history[-1].iteration if self.history else 0

    def __str__(self) -> str:
        return render(self)

    def __repr__(self) -> str:
        return (
            f"<Identification {self.name!r}: {self.method}, {len(self.names)} parameters, {self.status.name}>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain lists, numbers and strings; NaN and infinity become None."""
        values = zip(
            self.names, self.units, self.beta, self.std, self.relative_std_percent, self.roles, strict=True
        )
        return {
            "schema": SCHEMA,
            "name": self.name,
            "robot": self.robot,
            "method": self.method,
            "status": self.status.value,
            "status_name": self.status.name,
            "converged": self.converged,
            "n_iterations": self.n_iterations,
            "n_simulations": self.n_simulations,
            "output_error": None if self.output_error is None else [_finite(e) for e in self.output_error],
            "elapsed_s": self.elapsed,
            "condition_number": _finite(self.condition_number),
            "relative_error": [_finite(value) for value in self.relative_error],
            "overall_relative_error": _finite(self.overall_relative_error),
            "error_norm": self.error_norm,
            "error_std": self.error_std,
            "n_rows": self.n_rows,
            "parameters": [
                {
                    "name": name,
                    "unit": unit,
                    "value": float(value),
                    "std": float(std),
                    "relative_std_percent": _finite(percent),
                    "role": role,
                }
                for name, unit, value, std, percent, role in values
            ],
            "warnings": list(self.warnings),
            "remarks": list(self.remarks),
            "held_out": [
                {
                    "name": item.name,
                    "relative_error": [_finite(value) for value in item.relative_error],
                    "overall_relative_error": _finite(item.overall_relative_error),
                }
                for item in self.held_out
            ],
            "history": [
                {
                    "iteration": item.iteration,
                    "relative_error": _finite(item.relative_error),
                    "step": _finite(item.step),
                    **{key: _finite(value) for key, value in item.more.items()},
                }
                for item in self.history
            ],
            "delay": dict(self.delay),
            "settings": copy.deepcopy(dict(self.settings)),
            "digests": dict(self.digests),
            "standard_parameters": dict(
                zip(self.parameter_names, (float(value) for value in self.parameters), strict=True)
            ),
            "covariance": self.covariance.tolist(),
        }

    def save(self, path: str | Path) -> None:
        """Write the JSON of `to_dict`, whole or not at all.

        Raises
        ------
        OSError
            When the file cannot be written.
        """
        text = json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)
        write_atomically(Path(path), text + "\n")

    def save_parameters(self, path: str | Path) -> None:
        """Write the parameters alone, as TOML or npz: see `didim.parameter_files.save_parameters`."""
        from .parameter_files import save_parameters

        save_parameters(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Identification:
        """Restore what `save` wrote.

        Raises
        ------
        FitError
            When the file is no such JSON; the message says what is missing.
        OSError
            When it cannot be read.
        """
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:  # no UTF-8, no JSON, an integer of thousands of digits
            raise FitError(f"{path}: not a JSON file: {error}") from None
        if not isinstance(data, dict) or "schema" not in data:
            raise FitError(f"{path}: not the result of an identification, it has no 'schema'")
        if data["schema"] != SCHEMA:
            raise FitError(
                f"{path}: schema {data['schema']} is not the schema {SCHEMA} that this version reads"
            )
        try:
            return cls._from_dict(data)
        except KeyError as error:
            raise FitError(f"{path}: key {error} is missing or unknown") from None
        except (AttributeError, TypeError, ValueError, OverflowError, IndexError) as error:
            raise FitError(f"{path}: not the result of an identification: {error}") from None

    @classmethod
    def _from_dict(cls, data: dict[str, Any]) -> Identification:
        parameters = data["parameters"]
        known = ("iteration", "relative_error", "step")
        return cls(
            name=data["name"],
            robot=data["robot"],
            method=data["method"],
            status=Status[data["status_name"]],
            names=tuple(item["name"] for item in parameters),
            units=tuple(item["unit"] for item in parameters),
            roles=tuple(item["role"] for item in parameters),
            beta=np.array([item["value"] for item in parameters]),
            covariance=np.array(data["covariance"]).reshape(len(parameters), len(parameters)),
            parameter_names=tuple(data["standard_parameters"]),
            parameters=np.array(list(data["standard_parameters"].values())),
            relative_error=np.array([_number(value) for value in data["relative_error"]]),
            overall_relative_error=_number(data["overall_relative_error"]),
            error_norm=data["error_norm"],
            error_std=data["error_std"],
            condition_number=_number(data["condition_number"], math.inf),
            n_rows=data["n_rows"],
            n_simulations=data["n_simulations"],
            elapsed=data["elapsed_s"],
            history=tuple(
                Iteration(
                    iteration=item["iteration"],
                    relative_error=_number(item["relative_error"]),
                    step=_number(item["step"]),
                    more={key: _number(value) for key, value in item.items() if key not in known},
                )
                for item in data["history"]
            ),
            held_out=tuple(
                HeldOut(
                    name=item["name"],
                    relative_error=tuple(_number(value) for value in item["relative_error"]),
                    overall_relative_error=_number(item["overall_relative_error"]),
                )
                for item in data["held_out"]
            ),
            warnings=tuple(data["warnings"]),
            remarks=tuple(data.get("remarks", ())),
            output_error=_pair(data.get("output_error")),
            delay=data["delay"],
            settings=data["settings"],
            digests=data["digests"],
        )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _pair(values: list[float | None] | None) -> tuple[float, float] | None:
    return None if values is None else (_number(values[0]), _number(values[1]))


def _number(value: float | None, missing: float = math.nan) -> float:
    return missing if value is None else float(value)
