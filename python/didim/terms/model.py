"""The model of a log: all terms of its torque, their unknowns, and the rows (7) that they give along windows.

    Y = sum of the terms' columns times their unknowns + their known torque

Tested in ``tests/test_identify.py`` and ``tests/test_logs.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError
from ..robot.robot import Robot
from ..signal.filters import row_values
from ..signal.noise import noise_correlation
from ..signal.processing import SignalProcessing
from ..signal.window import Window, at_place
from .base import At, Base, roles_of
from .rows import LinearSystem, stacked
from .share import ColumnBlock, Share
from .unknown import Role, Unknown, Unknowns


class Term(Protocol):
    """A part of the torque that is linear in its unknowns."""

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Its unknowns, k of them."""

    def columns(self, window: Window, at: At) -> Array:
        """Return the derivative of the torque by the unknowns in the rows of a window, (n_dof, n_rows, k)."""


@dataclass(frozen=True, eq=False)
class Model:
    """All terms of a robot in a log.

    The vector of unknowns has the b base parameters of the robot first and then the e of the shares; the extended standard
    parameters have the p of the robot first.

    Attributes
    ----------
    own : Robot
        The robot.
    shares : tuple of Share
        What only some recordings have.
    roles : mapping of str to (role, float)
        Unknowns that are not estimated, with their values.
    reference : mapping of str to str
        Recording whose offsets (friction) are those of the robot, by kind; the shares of others are differences from it.
    """

    own: Robot
    shares: tuple[Share, ...] = ()
    roles: Mapping[str, tuple[Role, float]] = field(default_factory=dict)
    reference: Mapping[str, str] = field(default_factory=dict)

    @property
    def terms(self) -> tuple[Term, ...]:
        """All terms, in the order of their unknowns."""
        return (Base(self.own), *self.shares)

    @cached_property
    def unknowns(self) -> Unknowns:
        """The vector of unknowns, (b + e,)."""
        entries = Unknowns(tuple(each for term in self.terms for each in term.unknowns))
        return entries.with_roles(self.roles)

    def choosing(self, fixed: Mapping[str, float], dropped: Iterable[str] = ()) -> Model:
        """Return the model with fixed and dropped base parameters, and all others estimated.

        Raises
        ------
        FitError
            See `roles_of`.
        """
        return replace(self, roles=roles_of(self.own, fixed, dropped))

    def with_robot(self, robot: Robot) -> Model:
        """Return the model of another robot, whose shares keep the standard parameters of the same names.

        Raises
        ------
        FitError
            For a fixed or dropped parameter that the other robot does not have.
        """
        given = self.unknowns.given
        own = replace(self, own=robot).choosing(given("fixed"), given("dropped"))
        if robot.parameter_names == self.own.parameter_names:
            return own
        names, others = self.own.parameter_names, robot.parameter_names
        return replace(own, shares=tuple(share.for_parameters(names, others) for share in self.shares))

    @property
    def simple(self) -> bool:
        """Whether all recordings have only the parameters of the robot."""
        return not self.shares

    @cached_property
    def blocks(self) -> tuple[ColumnBlock, ...]:
        """Descriptions of the unknowns of shares."""
        return tuple(share.block for share in self.shares if share.block.names)

    def slices(self) -> list[tuple[Share, slice]]:
        """Return each share with its slice of their e unknowns."""
        places, start = [], 0
        for share in self.shares:
            places.append((share, slice(start, start + len(share.block.names))))
            start = places[-1][1].stop
        return places

    @cached_property
    def n_base(self) -> int:
        """Number of base parameters."""
        return len(self.own.base_parameters.names)

    @property
    def n_further(self) -> int:
        """Number of unknowns of the shares."""
        return len(self.unknowns.entries) - self.n_base

    @property
    def n_gains(self) -> int:
        """Number of drive gains among the unknowns; they are the last."""
        return sum(len(block.names) for block in self.blocks if block.kind == "gain")

    @property
    def has_known(self) -> bool:
        """Whether a payload is known in part or as a whole."""
        return any(share.fixed is not None for share in self.shares)

    def lift(self, beta: Array) -> Array:
        """Return extended standard parameters, (p + e,), of the unknowns, (b + e,)."""
        return np.concatenate([self.own.base_parameters.lift(beta[: self.n_base]), beta[self.n_base :]])

    def project(self, x: Array) -> Array:
        """Return the unknowns, (b + e,), of extended standard parameters, (p + e,)."""
        p = len(self.own.parameter_names)
        return np.concatenate([self.own.base_parameters.project(x[:p]), x[p:]])

    def standard(self, x: Array, recording: int) -> Array:
        """Return the standard parameters (..., p) of the robot in a recording, of extended ones, (..., p + e)."""
        p = len(self.own.parameter_names)
        own = x[..., :p]
        for share, places in self.slices():
            own = own + share.standard(x[..., p:][..., places], recording)
        return np.ascontiguousarray(own)

    def base(self, beta: Array, recording: int) -> Array:
        """Return the base parameters (b,) of the robot in a recording, of all unknowns, (b + e,)."""
        return np.asarray(self.own.base_parameters.matrix @ self.standard(self.lift(beta), recording))

    def directions(self, recording: int) -> Array:
        """Return the base parameters of the robot in a recording by the unknowns, (b, b + e)."""
        matrix = self.own.base_parameters.matrix
        parts = [
            matrix @ (share.directions if recording in share.recordings else 0.0 * share.directions)
            for share in self.shares
        ]
        return np.concatenate([np.eye(self.n_base), *parts], axis=1)

    def extended(self, x: Array, further: Mapping[str, float] | None = None) -> Array:
        """Return standard parameters, (p,) or already extended, with those of shares by name; those without a value are zero."""
        p = len(self.own.parameter_names)
        if len(x) == p + self.n_further:
            return x
        values = further or {}
        return np.concatenate([x[:p], [values.get(name, 0.0) for name in self.unknowns.names[self.n_base :]]])

    def columns(self, window: Window, at: At) -> Array:
        """Return the columns of all unknowns in a window, (n_dof, n_rows, b + e)."""
        parts = [term.columns(window, at) for term in self.terms]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)

    def rows(
        self, windows: Sequence[Window], signal: SignalProcessing, beta: Array | None = None
    ) -> LinearSystem:
        """Return (7) of several windows, with the torque of what is known moved to the left side.

        Parameters
        ----------
        windows : sequence of Window
            At least one, along measured or simulated motion.
        signal : SignalProcessing
            Decimation: Y and every column of W pass the same filter, which preserves the linear relation between them.
        beta : ndarray, shape (b + e,), optional
            Values of the unknowns for the torque of links and rotors in the columns of load friction, which is zero without
            them; the b of the robot alone are those of a log without shares.

        Returns
        -------
        LinearSystem
            Columns of the estimated unknowns only.

        Raises
        ------
        SignalError
            When the decimation cannot be applied; the message names recording and window.
        FitError
            When numbers are too large for floating point.

        Notes
        -----
        ``test_identify.py`` checks the order of the rows, and recovers the parameters from noise-free recordings.
        """
        at = At(self.own, signal, None if beta is None else self._standard_of(beta))
        w_parts = [self.columns(window, at) for window in windows]
        y_parts = [torques(window, signal) for window in windows]
        counts = [y.shape[1] for y in y_parts]
        names, estimated, n_dof = self.unknowns.names, self.unknowns.estimated, self.own.n_dof
        # The core's columns are contiguous, those of the system are not: one copy joins and transposes them.
        w = np.concatenate(w_parts, axis=1, out=np.empty((n_dof, sum(counts), len(names))))
        w = w.reshape(-1, len(names))
        y = np.concatenate(y_parts, axis=1).reshape(-1)
        known = self._known(windows, at, w, counts)
        if known is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                y = y - known
            if not np.isfinite(y).all():
                raise FitError(
                    "the torques of the fixed parameters are too large for floating point; check their values"
                )
        if len(estimated) < len(names):
            w = w[:, estimated]
        return LinearSystem(
            w=np.ascontiguousarray(w),
            y=np.ascontiguousarray(y),
            blocks=stacked(
                n_dof,
                counts,
                places=[(window.recording, window.number) for window in windows],
                rates_hz=[window.rate_hz / math.prod(signal.decimation) for window in windows],
                correlation=noise_correlation(signal),
            ),
            names=tuple(names[index] for index in estimated),
            known=known,
        )

    def _standard_of(self, beta: Array) -> Callable[[Window], Array]:
        """Return the function of the standard parameters in a window."""
        x = self.extended(self.lift(beta))
        return lambda window: self.standard(x, window.recording)

    def _known(self, windows: Sequence[Window], at: At, w: Array, counts: Sequence[int]) -> Array | None:
        """Return the torque of fixed unknowns and of known parts, (r,); None where all is estimated."""
        if len(self.unknowns.estimated) == len(self.unknowns.entries) and not self.has_known:
            return None
        with np.errstate(over="ignore", invalid="ignore"):  # the caller reports it
            known = w @ self.unknowns.values
            if self.has_known:
                parts = [np.zeros((self.own.n_dof, count)) for count in counts]
                for share in self.shares:
                    for window, part in zip(windows, parts, strict=True):
                        part += share.known(window, at)
                known = known + np.concatenate(parts, axis=1).reshape(-1)
        return known


def torques(window: Window, signal: SignalProcessing) -> Array:
    """Return the decimated torques of a window, (n_dof, n_rows), including those of known parameters."""
    with at_place(window.place):
        y = row_values(window.tau, signal).T
    if y.shape[1] == 0:
        raise FitError(f"{window.place}: decimation leaves nothing of {counted(window.q.shape[0], 'sample')}")
    return y
