"""A result beside a log that it was not fitted to: whether the errors are those of the fit, and what explains them if not.

    y_c = W_c beta^ + W_c V theta,    beta^ of the result, theta what the log may have beside it

Nothing of the robot is fitted, so the log tells what a fit swallows: the unit and the side of all torques, the order of all
joints. An accusation is tried before it is made. Each reading of the log (`didim.evidence.causes`), friction of its own, and a load
on an end link are fitted beside the known parameters and judged by D, (1) of `didim.evidence.products`; one explains the log if
the errors that it leaves are about those of the fit. Only where none does, all parameters are fitted: another robot of the same
geometry.
Tested in ``tests/test_wrong_calls.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array, quotient
from ...errors import DidimError
from ...log.recording import Recording
from ...model.dynamics import friction_places, inverse_dynamics
from ...result.finding import Finding, Grade
from ...result.identification import Identification
from ...robot.payload import ends, link_columns
from ...robot.rigid_body import INERTIAL
from ...robot.robot import Robot
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from ...terms.model import Model
from ...terms.share import independent
from ..causes import Cause, Search, torn
from ..naming import cause_findings
from ..products import Judged, Products
from ..residual import LARGER
from ..rows import LogRows
from ..thresholds import (
    BLOCKS_BETTER,
    HEALED,
    HINT,
    MARGIN,
    NAMED,
    NEGLIGIBLE,
    READ_OTHERWISE,
    ROBOT,
    SIZE_DOUBTFUL,
    SIZE_WRONG,
)
from .load import CLEAR_SIGMA, MASS


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a log beside those of the fit, joint by joint.

    Attributes
    ----------
    error, torque : (n_dof,) arrays
        Root mean squares of the errors and of the torques of the log (N.m or N), on the rows.
    of_fit : (n_dof,) array
        Root mean square of the errors of the fit on its own rows (N.m or N).
    floor : float
        Error, as a share of a joint's torque, that says nothing.
    """

    error: Array
    torque: Array
    of_fit: Array
    floor: float = NEGLIGIBLE

    @classmethod
    def beside(cls, fit: Identification, error: Array, torque: Array) -> Errors:
        """Return the errors of a log, (n_dof,) each (N.m or N), beside those of a result.

        Results of older versions have no errors in N.m: theirs are shares of the torques of this log.
        """
        known = None if fit.uncertainty is None else fit.uncertainty.joint_std
        of_fit = fit.relative_error * torque if known is None or len(known) != len(error) else known
        # Methods that simulate do not know what the filters do to the measured motion.
        measured = fit.settings.get("prediction", {}).get("motion", "measured") == "measured"
        return cls(error, torque, np.asarray(of_fit), NEGLIGIBLE if measured else SIZE_DOUBTFUL)

    @property
    def ratios(self) -> Array:
        """Error over that of the fit, (n_dof,)."""
        return self.error / np.maximum(self.of_fit, np.finfo(float).tiny)

    @property
    def shares(self) -> Array:
        """Error over the torque of each joint, (n_dof,); zero without any torque."""
        return quotient(self.error, self.torque, 0.0)

    @property
    def share(self) -> float:
        """Error of all joints together over their torques."""
        size = float(np.linalg.norm(self.torque))
        return float(np.linalg.norm(self.error)) / size if size > 0.0 else 0.0

    @property
    def larger(self) -> list[int]:
        """Joints, from 0, whose errors are above those of the fit: by more than those of recordings held out may be."""
        return np.flatnonzero((self.ratios > LARGER) & (self.shares > self.floor)).tolist()


@dataclass(frozen=True, eq=False)
class AppliedLog:
    """A log, and what is known of it by a result.

    Attributes
    ----------
    robot : Robot
        With the friction of the result.
    signal : SignalProcessing
        Filters and decimation.
    logs : Model
        What the recordings have beside the robot.
    known : (b + e,) array
        Base parameters of the result and those of the recordings; NaN for those that are fitted.
    parts : sequence of Window
        Filtered windows.
    recordings : sequence of Recording
        What they were read from.
    """

    robot: Robot
    signal: SignalProcessing
    logs: Model
    known: Array
    parts: Sequence[Window]
    recordings: Sequence[Recording]

    def rows(self) -> LogRows | None:
        """Return its rows for hypotheses; None where they are too few.

        Load friction, which is not linear in the parameters, is taken from the torques.
        """
        terms = self.robot.friction.terms
        linear = self.robot.with_terms([term for term in terms if term.law != "load"])
        known, parts = self.known, self.parts
        if len(linear.friction.terms) < len(terms):
            b = self.logs.n_base
            x = self.robot.base_parameters.lift(known[:b])
            chosen = [self.robot.parameter_names.index(name) for name in linear.parameter_names]
            parts = [replace(part, tau=part.tau - _load_friction(self, linear, x, part)) for part in parts]
            known = np.concatenate([linear.base_parameters.project(x[chosen]), known[b:]])
        if self.logs.has_known:
            known = np.append(known, 1.0)
        with suppress(DidimError), np.errstate(over="ignore", invalid="ignore"):
            rows = LogRows(self.robot, self.signal, parts, self.recordings, known, self.logs)
            if np.isfinite(rows.declared_seen).all():
                return rows
        return None


def _load_friction(log: AppliedLog, linear: Robot, x: Array, part: Window) -> Array:
    """Return the torques of load friction of the robot alone along a window, (n_samples, n_dof)."""
    chosen = [log.robot.parameter_names.index(name) for name in linear.parameter_names]
    motion = part.q, part.dq, part.ddq
    return np.asarray(
        inverse_dynamics(log.robot, *motion, x, temperature=part.temperature)
        - inverse_dynamics(linear, *motion, x[chosen], temperature=part.temperature)
    )


def applied_findings(log: AppliedLog, errors: Errors) -> list[Finding]:
    """Return what the errors of a log say: nothing where they are those of the fit, else their size, and what explains them."""
    if not errors.larger:
        return []
    rows = log.rows()
    explained = [] if rows is None else _explained(rows, errors, loaded=_load_is_free(log))
    return [*explained, _larger(errors, [each.name for each in log.recordings], explained)]


def _load_is_free(log: AppliedLog) -> bool:
    return any(block.kind == "payload" for block in log.logs.blocks) and bool(np.isnan(log.known).any())


def _larger(errors: Errors, names: Sequence[str], explained: Sequence[Finding]) -> Finding:
    """Return the finding that errors are larger than those of the fit."""
    joints = errors.larger
    grade: Grade = "wrong" if errors.share > SIZE_WRONG and not explained else "doubtful"
    return Finding(
        code="held-out",
        grade=grade,
        joints=tuple(joint + 1 for joint in joints),
        recordings=tuple(names),
        value=float(errors.ratios[joints].max()),
        effect=float(errors.shares[joints].max()),
        facts={
            "share": float(errors.shares[joints].max()),
            "ratios": errors.ratios[joints].tolist(),
            "applied": True,
            "explained": bool(explained),
        },
    )


def _explained(rows: LogRows, errors: Errors, *, loaded: bool) -> list[Finding]:
    """Return what explains the errors: a reading of the log, its friction, a load; else other parameters; nothing if none does.

    `loaded` is whether a load is fitted beside the robot already.
    """
    before = _beyond(rows, rows.declared_seen, errors.of_fit)
    loads = [] if loaded else [load for load in _loads(rows) if load.carried]
    freed = [_change(rows, rows.knowing(_free_friction(rows))), *loads]
    left = {
        change: _beyond(rows, change.products.seen(), errors.of_fit) for change in freed if change.d <= HINT
    }
    healing = [change for change in left if left[change] <= max(ROBOT, HEALED * before)]
    best = min(healing, key=lambda change: change.d, default=None)
    whole = best is not None and left[best] <= ROBOT
    # Other readings take seconds: a log that friction or a load explains as a whole needs none.
    cause = Search(rows, readings=errors.share > READ_OTHERWISE and not whole).cause()
    if cause is not None and not _heals(rows, cause, errors, before):
        cause = None
    if cause is not None and (best is None or cause.tried[0].decisive <= best.d + MARGIN):
        return cause_findings(rows, cause)
    if best is not None and whole:
        return [best.finding(rows)]
    # What friction or a load explains in part, other links may explain as a whole.
    return _other_robot(rows, errors, freed[0], before) or ([] if best is None else [best.finding(rows)])


def _heals(rows: LogRows, cause: Cause, errors: Errors, before: float) -> bool:
    """Whether a cause leaves about the errors of the fit, in the units of the channels that it reads otherwise."""
    hypothesis = cause.tried[0].hypothesis
    columns = rows.exact(hypothesis)
    if columns is None:
        return False
    mixing = hypothesis.mixing(rows.n)
    of_fit = np.sqrt(mixing**2 @ errors.of_fit**2)
    after = _beyond(rows, columns.products.seen(*hypothesis.channels), of_fit)
    return after <= max(ROBOT, HEALED * before)


def _beyond(rows: LogRows, squares: Array, of_fit: Array) -> float:
    """Return by how much squared errors, (n,), exceed those of the fit: the sum of logarithms as of physical parameters."""
    return torn(squares, of_fit**2 * rows.y.shape[1], rows.products.y.sum(axis=1))


@dataclass(frozen=True, eq=False)
class _Change:
    """Parameters that a log has of its own: D, errors and products with them, and the load's names and link."""

    d: float
    judged: Judged
    products: Products
    load: tuple[str, ...] = ()
    link: str = ""

    @property
    def mass(self) -> tuple[float, float] | None:
        """Mass of a load and its standard deviation (kg); None where it has no column of its own."""
        if "M" not in self.load:
            return None
        place = self.load.index("M") - len(self.load)
        return float(self.judged.beta[place]), float(self.judged.std[place])

    @property
    def carried(self) -> bool:
        """Whether the load may be a body, or one that was taken off: no moment of inertia clearly has the other sign than its mass.

        Errors of the robot's links are no body. Where the log tells combinations of the ten parameters alone, signs say nothing.
        """
        if len(self.load) < len(INERTIAL):
            return True
        ten, clear = (
            values[-len(INERTIAL) :] for values in (self.judged.beta, CLEAR_SIGMA * self.judged.std)
        )
        moments = [INERTIAL.index(name) for name in ("XX", "YY", "ZZ")]
        return not np.any((-ten if ten[MASS] < -clear[MASS] else ten)[moments] < -clear[moments])

    def finding(self, rows: LogRows) -> Finding:
        """Return the finding of a load, or of friction."""
        blocks = self.judged.better_blocks(rows.declared)
        left = float(np.exp(self.d / (2.0 * rows.n)))
        facts = {"left": left, "blocks": blocks, "link": self.link}
        if not self.load:
            ratios = self.judged.unseen.sum(axis=1) / rows.declared.unseen.sum(axis=1)
            joints = np.flatnonzero(ratios < np.exp(HINT / rows.n))
            return Finding(
                code="other-friction",
                grade="doubtful",
                joints=tuple(int(joint) + 1 for joint in joints),
                effect=self.d,
                facts=facts,
            )
        value, deviation = (None, None) if self.mass is None else self.mass
        clear = self.d <= NAMED and blocks >= BLOCKS_BETTER
        return Finding(
            code="undeclared-load",
            grade="wrong" if clear else "doubtful",
            value=value,
            deviation=deviation,
            effect=self.d,
            facts=facts,
        )


def _change(rows: LogRows, products: Products, load: tuple[str, ...] = (), link: str = "") -> _Change:
    judged = products.judged()
    return _Change(judged.against(rows.declared), judged, products, load, link)


def _free_friction(rows: LogRows) -> Array:
    """Return the known values of the columns with NaN for friction and offsets, (p,)."""
    assert rows.known is not None
    free = np.isin(rows.robot.base_parameters.indices, friction_places(rows.robot))
    known = rows.known.copy()
    known[: rows.logs.n_base][free] = np.nan
    return known


def _loads(rows: LogRows) -> list[_Change]:
    """Return a load on each end link; friction, which a load may change, is that of the result."""
    robot, base, changes = rows.robot, rows.robot.base_parameters.matrix, []
    assert rows.known is not None
    for joint in ends(robot):
        effects = base @ link_columns(robot, joint)
        chosen = independent(list(effects.T))
        columns = rows.w[:, :, : rows.logs.n_base] @ effects[:, chosen]
        known = np.concatenate([rows.known, np.full(len(chosen), np.nan)])
        link = "last body" if robot.geometry.in_line else f"body of {robot.joint_label(joint)}"
        names = tuple(INERTIAL[index] for index in chosen)
        changes.append(_change(rows, rows.knowing(known, columns), names, link))
    return changes


def _other_robot(rows: LogRows, errors: Errors, friction: _Change, before: float) -> list[Finding]:
    """Return the finding that only other parameters of links explain a log, where they change much of its torques."""
    free = rows.products.knowing(np.full(len(rows.products.scale), np.nan))
    squares, size = free.judged().unseen.sum(axis=1), rows.products.y.sum(axis=1)
    missed = float(np.sqrt(friction.judged.unseen.sum() / size.sum()))
    if missed <= READ_OTHERWISE or _beyond(rows, squares, errors.of_fit) > max(ROBOT, HEALED * before):
        return []
    return [
        Finding(
            code="other-robot",
            grade="wrong",
            value=missed,
            effect=float(np.sqrt(squares.sum() / size.sum())),
        )
    ]
