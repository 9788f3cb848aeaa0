"""The result of an identification: immutable, printed, saved as JSON and restored whole (``tests/test_identification.py``)."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array, quotient, relative_percent
from .._tools.notebook import page, pandas
from .._tools.pickling import Pickled, make_read_only
from .._tools.saved import SCHEMA, UNBOUNDED, plain, read_saved, restored, save_json
from .._tools.words import counted, percent_text
from ..errors import FitError
from ..regression.friction.alarm import FrictionAtSpeeds, Sliding
from ..robot.parameter_file import write_parameters
from ..robot.parameters import friction_names
from ..signal.processing import SignalProcessing
from ..terms.unknown import Role
from .consistent import recorded_robot, table_of
from .finding import Finding
from .further import Further
from .iteration import HeldOut, Iteration, Status
from .positions.record import PositionRecord
from .positions.table import position_lines
from .samples import Sampled
from .table import (
    WELL_IDENTIFIED_PERCENT,
    Estimates,
    Row,
    delay_lines,
    error_rows,
    limb_headings,
    parameter_lines,
    parameter_rows,
    table_lines,
)
from .uncertainty import Uncertainty, student_factor
from .verdict import DERIVED, Use, Verdict, derived

SAVED = (
    *("name", "robot", "method", "n_simulations", "condition_number", "relative_error"),
    *("overall_relative_error", "error_norm", "error_std", "n_rows", "warnings", "held_out", "delay"),
    *("settings", "digests", "covariance"),
)
"""Fields that JSON has under their own name."""
OPTIONAL = ("remarks", "ending", "output_error")
"""Fields that JSON has under their own name, and that results of older versions lack."""
TABLES = ("cloe", "consistent", "positions", "prediction", "robot", "signal", "versions")
"""Settings of a result that are tables, if they are there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification(Sampled, Pickled):
    """Identified parameters of a robot, their uncertainty and the errors on the log.

    All values are in SI units on the joint side. Tested in ``tests/test_identification.py``.

    Attributes
    ----------
    name, robot, method : str
        Experiment, robot and method ("idim-ls").
    status : Status
        Ending of the identification.
    names, units, roles : tuple of str
        Names, units and roles of the base parameters; a role is "estimated", "fixed" or "dropped".
    beta : ndarray, shape (b,)
        Base parameters.
    covariance : ndarray, shape (b, b)
        Covariance of beta; zero for fixed and dropped parameters, and zero throughout if no standard deviations are known, as
        after an iteration that did not converge.
    parameter_names : tuple of str
        Names of the standard parameters.
    parameters : ndarray, shape (p,)
        Standard parameters with the torques of beta (lifted), in the order of ``robot.parameter_names``.
    relative_error : ndarray, shape (n_dof,)
        Norm of each joint's torque error over that of its torque, 0.07 = 7 %.
    overall_relative_error : float
        The same for all joints together.
    error_norm : float
        ``|Y - W beta|``, without weights.
    error_std : float
        Standard deviation of the torque error (N.m), with the divisor of the settings.
    condition_number : float
        Condition number of the observation matrix W, without weights.
    n_rows : int
        Rows of W.
    uncertainty : Uncertainty or None
        Source of the standard deviations; None without any, and for results of older versions.
    further : Further or None
        Further parameters of the logs: payloads, own offsets and friction, drive gains.
    output_error : (float, float) or None
        Norm of measured less simulated torque over that of measured torque, (12): with the initial parameters and with
        these; None for IDIM-LS, which does not simulate.
    n_simulations : int
        Number of simulations of the direct dynamic model; 0 for IDIM-LS.
    elapsed : float
        Seconds.
    history : tuple of Iteration
        One per solution or iteration.
    held_out : tuple of HeldOut
        Held-out recordings.
    warnings : tuple of str
        Sentences on physically impossible parameters.
    remarks : tuple of str
        Sentences on the result, for example on a suspicious log or too large a step.
    delay : mapping
        "compensated_samples" (a number, or a list with one per joint); "hold_s", the sample time of a digital controller whose
        hold is compensated along measured motion; "estimated_samples", "estimated_seconds", "estimated_std_samples",
        "estimated_joints", "estimated_joints_std" and "estimated_cutoff_hz" if the delay was estimated.
    settings, digests : mapping
        Settings of the identification; SHA-256 of every file read.
    ending : str
        Sentence on the stopping rule that fired, or on the result if none did; empty if the status is sufficient.
    evidence : tuple of Finding
        Findings for or against the result, in addition to status, warnings and remarks: see `verdict`.
    uses : tuple of Use
        Suitability of the result for each use: see `verdict`.
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
    condition_number: float = field(metadata=UNBOUNDED)
    n_rows: int
    uncertainty: Uncertainty | None = None
    further: Further | None = None
    output_error: tuple[float, float] | None = None
    n_simulations: int = 0
    elapsed: float = 0.0
    history: tuple[Iteration, ...] = ()
    held_out: tuple[HeldOut, ...] = ()
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    delay: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    digests: Mapping[str, str] = field(default_factory=dict)
    ending: str = ""
    evidence: tuple[Finding, ...] = ()
    uses: tuple[Use, ...] = ()

    def __post_init__(self) -> None:
        n_base = len(self.names)
        shapes = {
            "beta": (n_base,),
            "covariance": (n_base, n_base),
            "parameters": (len(self.parameter_names),),
            "relative_error": (len(self.relative_error),),
        }
        make_read_only(self, shapes)
        for key, shape in shapes.items():
            if (got := getattr(self, key).shape) != shape:
                raise FitError(f"{key} must have shape {shape}, got {got}")
        for key in ("delay", "settings", "digests"):
            object.__setattr__(self, key, MappingProxyType(copy.deepcopy(dict(getattr(self, key)))))

    @property
    def std(self) -> Array:
        """Standard deviations of beta, shape (b,); zero for fixed and dropped parameters."""
        return cast(Array, np.sqrt(np.diag(self.covariance)))

    @property
    def relative_std_percent(self) -> Array:
        """Equation (11), shape (b,), percent; NaN where beta is zero."""
        return relative_percent(self.std, self.beta)

    @property
    def std_white(self) -> Array:
        """Standard deviations (10), as if all rows were independent, shape (b,); NaN for results that do not have them."""
        return np.full(len(self.names), np.nan) if self.uncertainty is None else self.uncertainty.std_white

    @property
    def std_ratio(self) -> Array:
        """Ratio of the standard deviations to those of (10), shape (b,): the effect of correlated model errors; or NaN."""
        return quotient(self.std, self.std_white, np.nan)

    def confidence_interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Return both ends of the confidence intervals of beta.

        Parameters
        ----------
        level : float
            Probability that an interval covers its parameter, between 0 and 1.

        Returns
        -------
        low, high : ndarray, shape (b,)
            SI units, joint side; NaN without standard deviations, and the value itself for fixed and dropped parameters.

        Raises
        ------
        FitError
            For a level that is not between 0 and 1.

        Notes
        -----
        The degrees of freedom of Student's distribution are the independent blocks less one, or the rows less the parameters
        (`didim.result.uncertainty`). ``test_uncertainty.py`` checks the coverage.
        """
        return self._estimates(level).interval

    def friction_at(self, joint: int, speeds: ArrayLike) -> FrictionAtSpeeds:
        """Return friction of a joint at speeds, with its 95 % interval.

        The joint moves alone, in steady sliding, at the median load of the log; friction is half the difference between both
        directions. What the log tells is friction at speeds: parameters of friction that exchange, or whose law is not that of
        the joint, are less certain than it is.

        Parameters
        ----------
        joint : int
            Joint, from 0.
        speeds : array_like, shape (k,)
            Speeds above zero (rad/s or m/s).

        Raises
        ------
        FitError
            For a joint or a speed that does not exist, and for a result without standard deviations.

        Notes
        -----
        ``test_friction_exchange.py`` compares it with friction that is known, where a law is missing too.
        """
        known = recorded_robot(self.robot, self.settings)
        try:
            v = np.atleast_1d(np.asarray(speeds, dtype=np.float64))
        except (TypeError, ValueError):
            raise FitError(f"speeds must be numbers, got {speeds!r:.40}") from None
        if isinstance(joint, bool) or not isinstance(joint, Integral) or not 0 <= joint < known.n_dof:
            raise FitError(
                f"joint {joint} does not exist: the joints of {self.robot!r} are 0 to {known.n_dof - 1}"
            )
        if v.ndim != 1 or not (np.isfinite(v) & (v > 0.0)).all():
            raise FitError("speeds must be finite and above zero")
        uncertainty = self.uncertainty
        if uncertainty is None or not self.std.any():
            raise FitError("the result has no standard deviations, so friction at speeds has no interval")
        alarm = uncertainty.friction
        older = not len(uncertainty.load) and known.friction.has_load
        if older or (alarm is not None and alarm.raised and not alarm.missing):
            raise FitError(
                "the result of an older version lacks what friction at speeds needs: identify the log again"
            )
        return Sliding(
            robot=known,
            x=self.parameters,
            load=uncertainty.load if len(uncertainty.load) else np.zeros(known.n_dof),
            names=self.names,
            velocities=uncertainty.velocities,
            covariance=uncertainty.noise_covariance(self.covariance, self.std),
            factor=uncertainty.factor(0.95),
            alarm=uncertainty.friction,
        ).at(joint, v)

    def interval_factor(self, level: float = 0.95) -> float:
        """Return half the width of a confidence interval in standard deviations.

        Raises
        ------
        FitError
            For a level that is not between 0 and 1.
        """
        freedom = np.inf if self.uncertainty is None else self.uncertainty.degrees_of_freedom
        return student_factor(level, freedom)

    @property
    def converged(self) -> bool:
        """Whether the method converged."""
        return self.status.converged

    @property
    def verdict(self) -> Verdict:
        """Whether the result is sound, doubtful or wrong, and why: evidence, status, warnings and remarks (docs/verdict.md)."""
        given = {reason.sentence for reason in self.evidence}
        warnings = [text for text in self.warnings if text not in given]  # of results without evidence
        return Verdict.of([*self.evidence, *derived(self.status, warnings, self.remarks)], self.uses)

    @property
    def conclusion(self) -> str:
        """Ending of the identification, with the stopping rule."""
        return f"{self.status.value} {self.ending}".rstrip()

    @property
    def n_iterations(self) -> int:
        """Number of iterations, that of the last entry of the history."""
        return self.history[-1].iteration if self.history else 0

    def parameter_rows(self) -> list[tuple[str, ...]]:
        """Return heading and cells of the table of parameters."""
        marks: dict[str, str] = {}
        if self.uncertainty is not None:
            exchanged = {name for each in self.uncertainty.at_speeds for name in each.parameters}
            marks = {name: "exchanges" for name in self.names if name in exchanged}
            marks |= dict.fromkeys(self.uncertainty.single_block, "one block")
        return parameter_rows(self._estimates(), marks, self._unstated())

    def _unstated(self) -> frozenset[str]:
        """Return parameters of friction that no interval tells where a law is missing: friction at speeds stands for them."""
        missing = () if self.uncertainty is None else self.uncertainty.at_speeds
        poor = self.relative_std_percent > WELL_IDENTIFIED_PERCENT
        own = {name for each in missing if each.seen for name in friction_names(each.joint)}
        return frozenset(name for name, bad in zip(self.names, poor, strict=True) if bad and name in own)

    def value_rows(self) -> list[dict[str, Any]]:
        """Return a row of each parameter, with the columns of `to_dataframe`."""
        base = [{**row, "group": "robot"} for row in self._estimates().value_rows()]
        return base + ([] if self.further is None else self.further.value_rows(self.interval_factor()))

    @property
    def estimate(self) -> tuple[Row, ...]:
        """Unknowns of the robot, then those of its logs, each with its 95 % interval: see `Row`."""
        return tuple(Row.of(row) for row in self.value_rows())

    def _estimates(self, level: float = 0.95) -> Estimates:
        columns = self.names, self.units, self.roles, self.beta, self.std, self.std_white
        return Estimates(*columns, self.interval_factor(level))

    def error_rows(self) -> list[tuple[str, ...]]:
        """Return heading and cells of the table of errors: fit, then held-out recordings."""
        held_out = [
            (f"held out: {recording.name}", recording.relative_error, recording.overall_relative_error)
            for recording in self.held_out
        ]
        return error_rows([("fit", tuple(self.relative_error), self.overall_relative_error), *held_out])

    def __str__(self) -> str:
        if (record := PositionRecord.of(self.settings)) is not None:
            return "\n".join([*position_lines(record, self.name, self.robot), *self.lines_after_tables()])
        count = counted(len(self.names), "base parameter")
        lines = [f"{self.name}: {count} of robot {self.robot} by {self.method}", ""]
        lines += parameter_lines(self.parameter_rows(), limb_headings(self.robot_record))
        lines += [] if self.further is None else self.further.lines(self.interval_factor())
        lines += ["", *table_lines(self.error_rows())]
        return "\n".join([*lines, *self.lines_after_tables()])

    @property
    def recorded_motion(self) -> str | None:
        """The motion along which the method predicts, "measured" or "simulated"; None for results of version 0.1.0."""
        return cast("str | None", self.settings.get("prediction", {}).get("motion"))

    @property
    def recorded_signal(self) -> SignalProcessing | None:
        """The filters of the run; None where they are not recorded."""
        saved = self.settings.get("signal")
        return None if saved is None else SignalProcessing(**saved)

    def lines_after_tables(self) -> list[str]:
        """Return the lines of the printed result after its tables."""
        # Readers read the last line first: it must not sound better than the result is.
        ending = [*self.verdict.lines(), "", self.conclusion, self.verdict.sentence]
        if PositionRecord.of(self.settings) is not None:
            return ending
        names = self.joint_names
        lines = [f"joints: {', '.join(f'{j + 1} {name}' for j, name in enumerate(names))}"] if names else []
        lines.append("")
        lines.append(
            f"condition number {self.condition_number:.6g}, error norm {self.error_norm:.7g}, "
            f"standard deviation of the error {self.error_std:.5g}, {self.n_rows} rows"
        )
        lines += [] if self.uncertainty is None else self.uncertainty.lines(self.std)
        lines += delay_lines(self.delay, measured=self.recorded_motion == "measured")
        if self.output_error is not None:
            before, after = (percent_text(100.0 * error) for error in self.output_error)
            lines.append(
                f"simulated torques off by {after} % (initial parameters: {before} %), after "
                f"{counted(self.n_simulations, 'simulation')}"
            )
        if "consistent" in self.settings:
            lines += ["", *table_of(self.settings["consistent"])]
        return [*lines, *ending]

    def _repr_html_(self) -> str:
        title = str(self).partition("\n")[0]
        after = "\n".join(self.lines_after_tables())
        return page(title, self.parameter_rows(), self.error_rows(), after.strip("\n"))

    def to_dataframe(self) -> Any:
        """Return the tables of parameters as a pandas ``DataFrame``, indexed by name.

        Base parameters come first, then those of the logs: payloads, own offsets and friction of recordings, drive gains.

        Returns
        -------
        DataFrame
            Columns ``unit``, ``value``, ``std``, ``relative_std_percent``, ``low``, ``high``, ``std_white`` and ``role``, as in the
            JSON of a result (SI units, joint side), and ``group``: "robot", "payload", "offset", "friction" or "gain".

        Raises
        ------
        DidimError
            Without pandas (``tests/test_notebook.py``).
        """
        return (
            pandas().DataFrame(self.value_rows()).rename(columns={"name": "parameter"}).set_index("parameter")
        )

    def __repr__(self) -> str:
        return (
            f"<Identification {self.name!r}: {self.method}, {len(self.names)} parameters, {self.status.name}>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and texts; NaN and infinity become None."""
        further = {} if self.further is None else {"further": self.further.to_dict()}
        return {
            "schema": SCHEMA,
            "status": self.status.value,
            "status_name": self.status.name,
            "converged": self.converged,
            "verdict": self.verdict.to_dict(),
            "n_iterations": self.n_iterations,
            "elapsed_s": self.elapsed,
            **{key: plain(getattr(self, key)) for key in (*SAVED, *OPTIONAL)},
            "parameters": self._estimates().value_rows(),
            "uncertainty": None if self.uncertainty is None else self.uncertainty.to_dict(),
            **further,
            "history": [iteration.to_dict() for iteration in self.history],
            "standard_parameters": plain(dict(zip(self.parameter_names, self.parameters, strict=True))),
        }

    def save(self, path: str | Path) -> None:
        """Write the JSON of `to_dict`; see `didim._tools.saved.save_json`."""
        save_json(path, self.to_dict(), self.digests.values())

    def save_parameters(self, path: str | Path) -> None:
        """Write the parameters alone, as TOML or npz.

        See `didim.robot.parameter_file.write_parameters`.
        """
        keys = ("names", "units", "roles", "beta", "std", "covariance", "parameter_names", "parameters")
        title = f"{self.name}: base parameters of robot {self.robot} by {self.method}. {self.conclusion}"
        arrays = {key: np.asarray(getattr(self, key)) for key in keys}
        write_parameters(path, arrays, (title, *self.warnings), self.digests.values())

    @classmethod
    def load(cls, path: str | Path) -> Identification:
        """Restore a result from the file of `save`.

        Raises
        ------
        FitError
            When the file cannot be read, or is not such JSON; the message names the missing field.
        """
        data = read_saved(path)
        try:
            return checked(restored(cls, _fields(data)))
        except KeyError as error:
            raise FitError(f"{path}: key {error} is missing or unknown") from None
        except (AttributeError, TypeError, ValueError, OverflowError, IndexError) as error:
            raise FitError(f"{path}: not the result of an identification: {error}") from None


def _fields(data: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a result from the JSON of `Identification.to_dict`."""
    parameters, standard, verdict = data["parameters"], data["standard_parameters"], data.get("verdict", {})
    names, units, roles, beta, white = (
        [row[key] for row in parameters] for key in ("name", "unit", "role", "value", "std_white")
    )
    uncertainty, further = data.get("uncertainty"), data.get("further")
    reasons = (reason for reason in verdict.get("reasons", ()) if reason["code"] not in DERIVED)
    return {
        **{key: data[key] for key in SAVED},
        **{key: data[key] for key in OPTIONAL if key in data},
        "settings": _tables(data["settings"]),
        "status": Status[data["status_name"]],
        "names": names,
        "units": units,
        "roles": roles,
        "beta": beta,
        "covariance": np.reshape(np.array(data["covariance"]), (len(names), len(names))),
        "parameter_names": list(standard),
        "parameters": list(standard.values()),
        "uncertainty": None
        if uncertainty is None
        else Uncertainty.from_dict(uncertainty, np.array(white, dtype=np.float64)),
        "further": None if further is None else Further.from_dict(further),
        "elapsed": data["elapsed_s"],
        "history": [Iteration.from_dict(reason) for reason in data["history"]],
        "evidence": [Finding.from_dict(reason) for reason in reasons],
        "uses": verdict.get("uses", ()),
    }


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


def checked(fit: Identification) -> Identification:
    """Refuse numbers that cannot come from an identification.

    Raises
    ------
    ValueError
        Naming the parameter (``test_identification.py``).
    """
    for what, names, values in (
        ("value", fit.names, fit.beta),
        ("value", fit.parameter_names, fit.parameters),
        ("variance", fit.names, np.diag(fit.covariance)),
    ):
        for name, value in zip(names, values, strict=True):
            if not math.isfinite(value) or (what == "variance" and value < 0.0):
                raise ValueError(f"the {what} of {name} is {value:g}")
    if not np.isfinite(fit.covariance).all():
        raise ValueError("the covariance has an entry that is not finite")
    return fit
