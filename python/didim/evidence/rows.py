"""Rows of a log for hypotheses: those of a fit, the screening of other columns, and rows of the consistent fit.

Tested in ``tests/test_evidence_products.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError, FitError
from ..log.recording import Recording
from ..model.limbs import Limb, limb_of, links_with
from ..regression.consistent.solver import Consistent, gamma_of
from ..regression.covariance import FEWEST_ROWS
from ..regression.settings import LeastSquaresSettings
from ..robot.robot import Robot
from ..signal.filters import decimate, decimation_stages
from ..signal.noise import row_noise
from ..signal.processing import SignalProcessing
from ..signal.window import Window, stretches
from ..terms.model import Model
from ..terms.rows import LinearSystem, stacked
from .products import BLOCKS, Declared, Products
from .screen import MOTION, Screen, ScreenedRows
from .thresholds import HINT

if TYPE_CHECKING:
    from .hypotheses.hypothesis import Hypothesis

ROWS = 300
"""Smallest number of rows per joint for a hypothesis, where the log has them; fewer than twice this number are used."""
ROUGH_ROWS = 150
"""Smallest number of rows per joint for the screening, where the log has them; fewer than twice this number are used."""
SAMPLES = 6000
"""Smallest number of samples for a hypothesis."""


class Columns(NamedTuple):
    """Columns that a hypothesis explains a log with.

    Attributes
    ----------
    w : (n, n_rows, p) array
        As those of a fit, by joint.
    names : tuple of str
        Their names.
    products : Products
        Their products with the torques, channel by channel.
    """

    w: Array
    names: tuple[str, ...]
    products: Products


class LogRows(Declared):
    """The rows of a log as declared, and what hypotheses make of them.

    Parameters
    ----------
    robot : Robot
        As declared; terms of load friction, which are not linear, are left out.
    signal : SignalProcessing
        Decimation.
    parts : sequence of Window
        Filtered windows of the log.
    recordings : sequence of Recording
        What they were read from, where units, sides and rates are asked too.
    known : (p,) array, optional
        Values of the columns that are known, NaN for those that are fitted beside them.
    logs : Model, optional
        What the logs have beside the robot: its columns stand behind the base columns, and what is known of payloads is one more,
        whose factor is free.
    system : LinearSystem, optional
        The system (7) of `parts` with all base columns, which is not computed again.

    Attributes
    ----------
    w, y : (n, n_rows, p), (n, n_rows) arrays
        Columns and torques.
    names : tuple of str
        Names of the columns.
    products : Products
        Of both.
    declared : Judged
        Errors of the declared model.
    origin : mapping
        What the file says of the first recording.
    timed : bool
        Whether time stamps say the rate, or nothing is known of it.

    Raises
    ------
    DidimError
        For a log that has too few rows, or whose numbers are too large.
    """

    def __init__(
        self,
        robot: Robot,
        signal: SignalProcessing,
        parts: Sequence[Window],
        recordings: Sequence[Recording] = (),
        known: Array | None = None,
        logs: Model | None = None,
        system: LinearSystem | None = None,
    ) -> None:
        linear = [term for term in robot.friction.terms if term.law != "load"]
        self.robot = robot if len(linear) == len(robot.friction.terms) else robot.with_terms(linear)
        self.logs = (Model(robot) if logs is None else logs).choosing({}).with_robot(self.robot)
        self.signal, self.recordings, self.known = signal, recordings, known
        self.origin: Mapping[str, Any] = recordings[0].origin if recordings else {}
        self.timed = all("time" in recording.origin for recording in recordings)
        self.parts = stretches(parts, samples_wanted(signal, parts))
        self._log = parts
        self._thin = 1
        if system is not None and self.robot is robot and [*map(id, self.parts)] == [*map(id, parts)]:
            self.names, y = system.names, system.y.reshape(self.n, -1)
            w = system.w.reshape(*y.shape, -1)
        else:
            w, y, self.names = self._system(self.robot, self.parts)
        self._thin = max(1, y.shape[1] // ROWS)
        self.w, self.y = np.ascontiguousarray(w[:, :: self._thin]), np.ascontiguousarray(y[:, :: self._thin])
        if self.y.shape[1] < FEWEST_ROWS * BLOCKS:
            least = FEWEST_ROWS * BLOCKS
            raise FitError(
                f"{self.y.shape[1]} rows are left of the log by its decimation, {least} are needed"
            )
        if not y.any(axis=1).all():
            raise FitError("the torque of a joint is zero in the whole log")
        self.products = Products.of(self.w, self.y, given=known)
        self.declared = self.products.judged()
        self._screened_limbs: dict[tuple[int, ...], tuple[Limb, ScreenedRows]] = {}

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n_dof

    @property
    def beta(self) -> Array:
        """Base parameters of the robot as declared, (b,)."""
        return self.declared.beta[: self.logs.n_base]

    def under(self, hypothesis: Hypothesis) -> LogRows:
        """Return the rows as a hypothesis reads the log."""
        undone = np.linalg.inv(hypothesis.mixing(self.n)).T
        parts = [replace(part, tau=part.tau @ undone) for part in self._moved(hypothesis)]
        return LogRows(
            hypothesis.robot or self.robot, self.signal, parts, self.recordings, self.known, self.logs
        )

    @cached_property
    def declared_seen(self) -> Array:
        """Squared errors of the declared model in sample, (n,)."""
        return self.products.seen()

    @cached_property
    def hopeless(self) -> bool:
        """Whether all that is left of the torques is about their white noise, so that no hypothesis can explain more."""
        noise = np.median(
            [part.noise * row_noise(self.signal, part.rate_hz)[0] for part in self._log], axis=0
        )
        share = self.y.shape[1] * noise**2 / self.declared_seen
        return float(np.sum(np.log(np.minimum(1.0, np.maximum(share, 1e-9))))) > HINT

    @cached_property
    def screened(self) -> ScreenedRows:
        """Screening along the decimated motion."""
        step = max(1, int(self.y.shape[1]) // ROUGH_ROWS)
        motion = [self.reduced([getattr(part, key) for part in self.parts])[:, ::step] for key in MOTION]
        return ScreenedRows(
            Screen(self.robot, motion, self._whole(step)),
            self.w[:, ::step, self.logs.n_base :],
            self.y[:, ::step],
            None if self.known is None else self.robot.base_parameters.lift(self.known[: self.logs.n_base]),
            None if self.known is None else self.known[self.logs.n_base :],
        )

    def rough(self, hypothesis: Hypothesis) -> float:
        """Return about the D of a hypothesis, in sample; infinity where it cannot be computed."""
        return float(np.sum(np.log(self.rough_ratios(hypothesis))))

    def rough_ratios(self, hypothesis: Hypothesis) -> Array:
        """Return about the squared error of each channel over that of the declared model, (n,), in sample."""
        links = links_with(self.robot, (joint - 1 for joint in hypothesis.joints))
        if 0 < len(links) < self.robot.n_joints:
            if links not in self._screened_limbs:
                limb = limb_of(self.robot, links)
                self._screened_limbs[links] = limb, self.screened.of_limb(limb)
            limb, screened = self._screened_limbs[links]
            own = hypothesis.within(limb, self.robot)
            if own is not None:  # the other limbs are as declared
                ratios = np.ones(self.n)
                ratios[list(limb.joints)] = screened.ratios(own)
                return ratios
        return self.screened.ratios(hypothesis)

    def seen(self, hypothesis: Hypothesis) -> Array:
        """Return the squared errors of the channels in sample, (n,); infinity where they cannot be computed."""
        columns = self.exact(hypothesis)
        if columns is None:
            return np.full(self.n, math.inf)
        return columns.products.seen(*hypothesis.channels)

    def knowing(self, known: Array, columns: Array | None = None) -> Products:
        """Return the products with other known values, (p + m,), NaN for fitted ones, and with further columns, (n, n_rows, m)."""
        if columns is None:
            return self.products.knowing(known)
        return Products.of(np.concatenate([self.w, columns], axis=2), self.y, given=known)

    def exact(self, hypothesis: Hypothesis) -> Columns | None:
        """Return columns as those of a fit, (n, n_rows, p), names and products; None where they cannot be computed."""
        if not hypothesis.needs_columns:
            return Columns(self.w, self.names, self.products)
        try:
            w, _, names = self._system(hypothesis.robot or self.robot, self._moved(hypothesis))
        except DidimError:
            return None
        w = np.ascontiguousarray(w[:, :: self._thin])
        channels = w if hypothesis.torque is None else np.tensordot(hypothesis.torque, w, 1)
        return Columns(w, names, Products.of(channels, self.y, given=self.known))

    def _moved(self, hypothesis: Hypothesis) -> list[Window]:
        if hypothesis.position is None and hypothesis.rate == 1.0:
            return self.parts
        a = np.eye(self.n) if hypothesis.position is None else hypothesis.position.T
        r = hypothesis.rate
        return [
            replace(part, q=part.q @ a, dq=r * part.dq @ a, ddq=r**2 * part.ddq @ a) for part in self.parts
        ]

    def reduced(self, signals: Sequence[Array]) -> Array:
        """Return signals of each part, (n_samples, n) each, on the rows, (n, n_rows)."""
        rows = self.signal.kept_rows
        reduced = [decimate(values, decimation_stages(len(values), self.signal))[rows] for values in signals]
        return np.ascontiguousarray(np.concatenate(reduced)[:: self._thin].T)

    def with_columns(self, columns: Array) -> Products:
        """Return the products with further columns, (n, n_rows, m)."""
        return Products.of(np.concatenate([self.w, columns], axis=2), self.y)

    def consistent(self, robot: Robot, w: Array, y: Array) -> Array | None:
        """Return the errors of the physically consistent fit, (n, n_rows); None where there is none, or parameters are known.

        Parameters
        ----------
        robot : Robot
            Whose base columns these are.
        w, y : (n, n_rows, p), (n, n_rows) arrays
            Columns, and the torques of the joints that they belong to.
        """
        if self.known is not None:
            return None
        system, logs = self._conditioned(robot, w, y)
        settings = Consistent(gamma=self._gamma)
        try:
            fit = settings.for_model(logs)(
                system, LeastSquaresSettings(weights="per-joint", reweightings=1, uncertainty="white")
            )
        except DidimError:
            return None
        return fit.residual.reshape(self.n, -1)

    def _conditioned(self, robot: Robot, w: Array, y: Array) -> tuple[LinearSystem, Model]:
        """Return the system of which physical conditions are asked: known payloads are as they are declared."""
        logs = self.logs.with_robot(robot)
        p = logs.n_base + logs.n_further
        y = y - w[:, :, p] if logs.has_known else y
        system = LinearSystem(
            w=np.ascontiguousarray(w[:, :, :p]).reshape(-1, p),
            y=np.ascontiguousarray(y).reshape(-1),
            blocks=stacked(self.n, [w.shape[1]]),
            names=logs.unknowns.names,
        )
        return system, logs

    @cached_property
    def _gamma(self) -> float:
        """Weight of the prior, by the correlation of the residuals of the declared model."""
        return gamma_of(self._conditioned(self.robot, self.w, self.y)[0])

    def _whole(self, step: int) -> Array:
        """Return the columns of all standard parameters on every `step`-th row, (n, n_rows, m), as those of a fit."""
        return np.asarray(self.w[:, ::step, : self.logs.n_base] @ self.robot.base_parameters.matrix)

    def _system(self, robot: Robot, parts: Sequence[Window]) -> tuple[Array, Array, tuple[str, ...]]:
        """Return base columns, (n, rows, p), and torques, (n, rows), as those of a fit, before they are thinned out."""
        logs = self.logs.with_robot(robot)
        system = logs.rows(parts, self.signal)
        w = system.w.reshape(robot.n_dof, -1, system.w.shape[1])
        names = system.names
        if logs.has_known and system.known is not None:
            w = np.concatenate([w, system.known.reshape(robot.n_dof, -1, 1)], axis=2)
            names = (*names, "payload")
        return w, system.measured.reshape(robot.n_dof, -1), names


def samples_wanted(signal: SignalProcessing, parts: Sequence[Window]) -> int:
    """Return how many samples hypotheses are tried on."""
    rows = ROWS + 6 * signal.edge_rows * max(1, len(parts))
    return max(SAMPLES, rows * math.prod(signal.decimation))
