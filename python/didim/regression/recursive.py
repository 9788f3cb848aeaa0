"""`Recursive`: weighted least squares on a growing log, chunk by chunk, in constant memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

import didim._core as _core

from .._tools.arrays import Array, quotient, real_array
from .._tools.settings import whole
from .._tools.words import series
from ..errors import CoreErrorsAs, FitError, RankError, ShapeError
from ..model.dynamics import per_joint
from ..robot.robot import Robot
from ..terms.model import Model
from .least_squares import dependence_sentence, positive_rms
from .triangles import Triangles


@dataclass(frozen=True, eq=False)
class RecursiveEstimate:
    """Estimate from all chunks so far; SI units, joint side.

    Tested in ``tests/test_recursive.py``.

    Attributes
    ----------
    names : tuple of str
        Base parameters of the robot.
    beta, std : ndarray, shape (b,)
        Estimate and its standard deviation (10), for white noise; zero deviation for fixed and dropped parameters.
    covariance : ndarray, shape (b, b)
        Equation (10).
    parameters : ndarray, shape (p,)
        Standard parameters with the same torques (lifted).
    joint_std : ndarray, shape (n_dof,)
        Root mean square of each joint's residual (N.m or N).
    relative_error : ndarray, shape (n_dof,)
        Norm of each joint's residual over that of its torque.
    n_rows : float
        Rows of each joint; with forgetting the sum of their factors.
    """

    names: tuple[str, ...]
    beta: Array
    covariance: Array
    parameters: Array
    joint_std: Array
    relative_error: Array
    n_rows: float

    @property
    def std(self) -> Array:
        """Standard deviations, shape (b,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


class Recursive:
    """Least squares on R, updated by every chunk of a log.

    Parameters
    ----------
    robot : Robot
        Robot with the regressor (2) and the base parameters.
    average : int
        Number of samples whose rows are averaged, on both sides of (7): the parallel filter of a growing log. At 5 kHz, 100
        gives 50 rows per second.
    forgetting : float
        Factor of the weight of a row with every later row of its joint, in (0, 1]; 1 for no forgetting. A factor f has a memory
        of about ``1 / (1 - f)`` rows.
    fixed : mapping of str to float, optional
        Base parameters that are known.
    dropped : iterable of str, optional
        Base parameters taken as zero.

    Raises
    ------
    FitError
        For a value out of its range or an unknown parameter.

    Notes
    -----
    `update` expects filtered positions, velocities and accelerations. The estimate equals that of weighted least squares on all
    rows, for any chunks: ``test_recursive.py``. Cost: a QR of the triangle and the new rows, per joint.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        average: int = 1,
        forgetting: float = 1.0,
        fixed: Mapping[str, float] | None = None,
        dropped: Iterable[str] = (),
    ) -> None:
        average = whole("average", average, FitError, least=1)
        if (
            isinstance(forgetting, bool)
            or not isinstance(forgetting, (int, float))
            or not 0.0 < forgetting <= 1.0
        ):
            raise FitError(f"forgetting must be greater than 0 and at most 1, got {forgetting!r}")
        self.robot, self.average = robot, average
        self._unknowns = Model(robot).choosing(fixed or {}, tuple(dropped)).unknowns
        self._estimated = self._unknowns.estimated
        self._columns = list(robot.base_parameters.indices)
        self._triangles = Triangles(robot.n_dof, len(self._estimated), float(forgetting))
        self._rest = (np.zeros((len(self._estimated), robot.n_dof, 0)), np.zeros((robot.n_dof, 0)))
        self.n_samples = 0

    @property
    def n_rows(self) -> float:
        """Rows of each joint so far; with forgetting the sum of their factors."""
        return self._triangles.rows

    def update(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, tau: ArrayLike) -> None:
        """Add a chunk of samples.

        Parameters
        ----------
        q, dq, ddq : (n_samples, n_dof) arrays
            Motion, joint side, SI units.
        tau : (n_samples, n_dof) array
            Measured torques (N.m or N), joint side.

        Raises
        ------
        ShapeError
            For a wrong shape or a value that is not a finite number; the whole chunk is then ignored.
        """
        motion = [self._matrix(key, value) for key, value in (("q", q), ("dq", dq), ("ddq", ddq))]
        torque = self._matrix("tau", tau)
        if any(values.shape != torque.shape for values in motion):
            raise ShapeError(
                f"q, dq, ddq and tau must have the same number of samples, got "
                f"{series(str(len(values)) for values in (*motion, torque))}"
            )
        if not len(torque):
            return
        position, velocity, acceleration = motion
        with CoreErrorsAs(ShapeError):
            rows = _core.observation(self.robot.core, position, velocity, acceleration, self._columns, [], 1)
        # The core fills columns, so this layout avoids a copy.
        w = np.asarray(rows).T.reshape(len(self._columns), self.robot.n_dof, len(torque))
        y = np.ascontiguousarray(torque.T)
        if len(self._estimated) < len(self._columns):
            y = y - np.tensordot(self._unknowns.values, w, axes=1)
            w = w[self._estimated]
        self.n_samples += len(torque)
        self._take(w, y)

    def update_rows(self, w: ArrayLike, y: ArrayLike) -> None:
        """Add filtered and decimated rows of (7); they are not averaged.

        Parameters
        ----------
        w : (n, n_dof, b) array
            Rows of each joint, over all base parameters.
        y : (n, n_dof) array
            Torques.

        Raises
        ------
        ShapeError
            For a wrong shape or a value that is not a finite number.
        """
        rows, torque = real_array("w", w, ShapeError), self._matrix("y", y)
        expected = (len(torque), self.robot.n_dof, len(self._columns))
        if rows.shape != expected:
            raise ShapeError(f"w must have shape {expected}, got {rows.shape}")
        if not np.isfinite(rows).all():
            raise ShapeError("w has a value that is not a finite number")
        known = rows @ self._unknowns.values
        self._triangles.fold(rows[:, :, self._estimated], torque - known)

    def merge(self, other: Recursive) -> None:
        """Add all rows of another object: the sum of two logs.

        Raises
        ------
        FitError
            When its robot or parameters differ.
        """
        same = other.robot.base_parameters.names == self.robot.base_parameters.names
        if not same or other._estimated != self._estimated:
            raise FitError(
                f"robot {other.robot.name!r} and robot {self.robot.name!r} differ in the parameters to estimate"
            )
        self._triangles.merge(other._triangles)
        self.n_samples += other.n_samples

    def estimate(self, reweightings: int = 1) -> RecursiveEstimate:
        """Estimate the parameters from all rows so far.

        Parameters
        ----------
        reweightings : int
            Number of times that weights per joint are estimated from the residuals, as in IDIM-LS; 0 for none.

        Returns
        -------
        RecursiveEstimate
            Equal to weighted least squares on all rows at once.

        Raises
        ------
        FitError
            With too few rows.
        RankError
            While the motion so far does not identify a parameter; the message names it.
        """
        system = self._triangles.system()
        columns, n = len(self._estimated), self.n_rows
        if n * self.robot.n_dof <= columns:
            raise FitError(
                f"{n * self.robot.n_dof:g} rows cannot determine {columns} parameters: more chunks are needed"
            )
        names = tuple(self.robot.base_parameters.names[index] for index in self._estimated)
        torques = np.array([np.linalg.norm(z) for _, z in system])
        sigma, residuals = np.ones(self.robot.n_dof), np.ones(self.robot.n_dof)
        for number in range(reweightings + 1):
            if number:
                sigma = positive_rms(residuals, torques, n)
            stacked = np.vstack([rows / size for (rows, _), size in zip(system, sigma, strict=True)])
            target = np.concatenate([z / size for (_, z), size in zip(system, sigma, strict=True)])
            # Triangles of a poor motion have few rows; the core names the missing parameters.
            missing = max(0, columns + 1 - len(target))
            stacked, target = np.pad(stacked, ((0, missing), (0, 0))), np.pad(target, (0, missing))
            with CoreErrorsAs(FitError):
                solved = _core.least_squares(stacked, target)
            if solved.dependent:
                raise RankError(dependence_sentence(names, solved.dependent))
            solution = np.asarray(solved.solution)
            residuals = np.array([np.linalg.norm(z - rows @ solution) for rows, z in system])
        variance = float(np.sum((residuals / sigma) ** 2)) / (n * self.robot.n_dof - columns)
        inverse = np.asarray(solved.inverse_r)
        beta = self._unknowns.expand(solution)
        return RecursiveEstimate(
            names=self.robot.base_parameters.names,
            beta=beta,
            covariance=self._unknowns.expand_covariance(variance * (inverse @ inverse.T)),
            parameters=self.robot.base_parameters.lift(beta),
            joint_std=residuals / np.sqrt(n),
            relative_error=quotient(residuals, torques, np.nan),
            n_rows=n,
        )

    def _take(self, w: Array, y: Array) -> None:
        """Average complete groups of samples, (b, n_dof, n) and (n_dof, n), and fold them; store the samples of the last group."""
        if self.average > 1:
            if self._rest[1].shape[1]:
                w, y = np.concatenate([self._rest[0], w], axis=2), np.concatenate([self._rest[1], y], axis=1)
            groups = y.shape[1] // self.average
            whole = groups * self.average
            self._rest = (w[:, :, whole:].copy(), y[:, whole:].copy())
            w = w[:, :, :whole].reshape(*w.shape[:2], groups, self.average).mean(axis=3)
            y = y[:, :whole].reshape(len(y), groups, self.average).mean(axis=2)
        self._triangles.fold(w.transpose(2, 1, 0), y.T)

    def _matrix(self, name: str, value: ArrayLike) -> Array:
        array = np.ascontiguousarray(per_joint(self.robot, name, value))
        if not np.isfinite(array).all():
            sample, joint = np.argwhere(~np.isfinite(array))[0]
            raise ShapeError(
                f"{name} of joint {joint + 1} is not a finite number at sample {sample + 1} of the chunk"
            )
        return array
