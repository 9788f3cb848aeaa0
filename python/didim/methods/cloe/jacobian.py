"""Derivatives of the weighted output errors, stored for each limb: an error of one limb depends on no parameter of the others.

    G = d e / d beta,    G^T G is block diagonal                                                                (A)

Errors are in the order of outputs, windows and samples, those of all joints together at each sample. Tested in
``tests/test_limbs.py`` against one simulation per parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array
from ...model.limbs import Directions
from ...terms.rows import Block, independent

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Part:
    """Derivatives of the errors of some joints with respect to some parameters; all others are zero.

    Attributes
    ----------
    joints : (j,) array of int
        Joints, from 0.
    columns : (c,) array of int
        Parameters.
    slopes : (c, n_samples * j) array
        ``G^T``.
    n_dof : int
        Number of joints of the robot.
    """

    joints: Indices
    columns: Indices
    slopes: Array
    n_dof: int

    @property
    def rows(self) -> Indices:
        """Rows of these joints among all errors, (n_samples * j,)."""
        samples = np.arange(self.slopes.shape[1] // len(self.joints))
        return np.asarray((samples[:, None] * self.n_dof + self.joints).ravel())

    @property
    def normal(self) -> Array:
        """``G^T G`` of these parameters, (c, c)."""
        return np.asarray(self.slopes @ self.slopes.T)

    def errors(self, errors: Array) -> Array:
        """Return the errors of these joints, (n_samples * j,), among all errors."""
        return errors.reshape(-1, self.n_dof)[:, self.joints].ravel()

    def blocks(self, blocks: Sequence[Block]) -> list[Block]:
        """Return the blocks of these joints, with their rows here."""
        j, number = len(self.joints), {int(joint): k for k, joint in enumerate(self.joints)}
        return [
            replace(
                block,
                rows=slice(
                    block.rows.start // self.n_dof * j + number[block.joint],
                    block.rows.stop // self.n_dof * j,
                    j,
                ),
            )
            for block in blocks
            if block.joint in number
        ]


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives of all errors.

    Attributes
    ----------
    parts : tuple of Part
        Those of each limb.
    """

    parts: tuple[Part, ...]

    @classmethod
    def of(cls, moved: Array, directions: Directions, steps: Array) -> Jacobian:
        """Return the derivatives from differences.

        Parameters
        ----------
        moved : (n_simulations, n_rows) array
            Changes of the errors.
        directions : Directions
            Parameters that each simulation changed.
        steps : (n,) array
            Change of each parameter.
        """
        n_dof = directions.joints.shape[1]
        samples = moved.reshape(len(moved), -1, n_dof)
        parts = []
        for joints, columns in independent([np.flatnonzero(column) for column in directions.joints.T]):
            slopes = np.empty((len(columns), samples.shape[1], len(joints)))
            for own, column in zip(slopes, columns, strict=True):
                np.divide(samples[directions.number[column]][:, joints], steps[column], out=own)
                own *= directions.joints[column, joints]
            parts.append(Part(joints, columns, slopes.reshape(len(columns), -1), n_dof))
        return cls(tuple(part for part in parts if part.columns.size))

    def replace_rows(self, columns: Indices, slopes: Array, directions: Directions) -> None:
        """Replace the derivatives with respect to some parameters, (k,), by others, (k, n_rows)."""
        for part in self.parts:
            for own, column in zip(part.slopes, part.columns, strict=True):
                for k in np.flatnonzero(columns == column):
                    responding = np.tile(directions.joints[column, part.joints], own.size // len(part.joints))
                    own[:] = np.where(responding, part.errors(slopes[k]), 0.0)

    @cached_property
    def normal(self) -> Array:
        """``G^T G``, (n, n)."""
        n = sum(part.columns.size for part in self.parts)
        normal = np.zeros((n, n))
        for part in self.parts:
            normal[np.ix_(part.columns, part.columns)] = part.normal
        return normal

    def gradient(self, errors: Array) -> Array:
        """Return ``G^T e``, (n,)."""
        gradient = np.zeros(len(self.normal))
        for part in self.parts:
            gradient[part.columns] = part.slopes @ part.errors(errors)
        return gradient

    def changed(self, errors: Array, step: Array) -> Array:
        """Return ``e + G step``, (n_rows,)."""
        changed_errors = errors.copy()
        for part in self.parts:
            changed_errors[part.rows] += part.slopes.T @ step[part.columns]
        return changed_errors

    def triangles(self, point: Array, errors: Array) -> Array:
        """Return rows ``[R, z]`` with the normal equations of ``[G, G point - e]``, (n_parts + n, n + 1)."""
        triangles = []
        for part in self.parts:
            right = part.slopes.T @ point[part.columns] - part.errors(errors)
            triangle = np.asarray(np.linalg.qr(np.column_stack([part.slopes.T, right]), mode="r"))
            rows: Array = np.zeros((len(triangle), len(point) + 1))
            rows[:, part.columns], rows[:, -1] = triangle[:, :-1], triangle[:, -1]
            triangles.append(rows)
        return np.vstack(triangles)
