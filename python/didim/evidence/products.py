"""The one engine of all hypotheses: products of columns and torques, joint by joint, channel by channel, block by block.

With ``G_pb = W_pb' W_pb``, ``H_pcb = W_pb' y_cb`` and ``Y_cb = y_cb' y_cb`` of joint p, torque channel c and block of time b, a
hypothesis is a row ``p(c)`` and a factor ``s_c`` for each channel, which is predicted by ``s_c W_p(c) beta``:

    A_b = sum_c v_c s_c^2 G_p(c)b,   r_b = sum_c v_c s_c H_p(c)cb,   beta_(b) = (A - A_b)^-1 (r - r_b)
    E_cb = Y_cb - 2 s_c beta_(b)' H_p(c)cb + s_c^2 beta_(b)' G_p(c)b beta_(b)

Errors are those of blocks that were left out, in the units of the logged channels, and weights ``v_c`` those of the hypothesis
itself. What it changes is

    D = sum_c log(sum_b E_cb / sum_b E_cb as declared)                                                           (1)

-1.4 where the error of one joint is halved and the others keep theirs. Branches of a tree share no columns: each part of joints is
solved by itself, and a hypothesis on one leaves the others as they are. Tested in ``tests/test_evidence_products.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array

BLOCKS = 10
"""Number of time blocks that are left out in turn."""
REWEIGHTINGS = 3
"""Number of solutions from which the weights of the channels are computed."""
RIDGE = 1e-11
"""Addition to products of unit-norm columns, as a share of their trace: dependent columns then share what they explain."""
LEAST_SHARE = 1e-14
"""Lower bound of a channel's squared error, as a share of its squared torque: less is rounding."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Errors of a hypothesis.

    Attributes
    ----------
    unseen : (n, m) array
        Squared errors of each channel on each block, fitted without that block.
    beta, std : (p,) arrays
        Parameters of all blocks, and their standard deviations by leaving out blocks.
    """

    unseen: Array
    beta: Array
    std: Array

    def against(self, other: Judged) -> float:
        """Return (1) against the errors of another hypothesis, such as the declared one."""
        return float(np.sum(np.log(self.unseen.sum(axis=1) / other.unseen.sum(axis=1))))

    def better_blocks(self, other: Judged) -> int:
        """Count the blocks whose errors are smaller than another hypothesis leaves, all channels together."""
        return int(np.count_nonzero(np.sum(np.log(self.unseen / other.unseen), axis=0) < 0.0))


@dataclass(frozen=True, eq=False)
class Products:
    """Products of columns of norm 1 and of torques, by joint, channel and block.

    Attributes
    ----------
    g : (n, m, p, p) array
        ``W' W``.
    h : (n, n, m, p) array
        ``W' y`` of the rows of joint p with channel c.
    y : (n, m) array
        ``y' y``.
    scale : (p,) array
        Norms of the columns.
    given : (p,) array or None
        Parameters that are known, NaN for those that are fitted beside them; None where all are fitted.
    """

    g: Array
    h: Array
    y: Array
    scale: Array
    given: Array | None = None
    _solutions: dict[tuple[str, bytes, bytes, bytes], tuple[Array, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, columns: Array, torque: Array, blocks: int = BLOCKS, given: Array | None = None) -> Products:
        """Return the products of columns, (n, rows, p), and torques, (n, rows), in blocks of time."""
        cuts = [slice(part[0], part[-1] + 1) for part in np.array_split(np.arange(torque.shape[1]), blocks)]
        n, _, p = columns.shape
        g, h = np.empty((n, blocks, p, p)), np.empty((n, n, blocks, p))
        for b, c in enumerate(cuts):
            np.matmul(columns[:, c].transpose(0, 2, 1), columns[:, c], out=g[:, b])
            np.matmul(torque[None, :, c], columns[:, c], out=h[:, :, b])
        scale = np.sqrt(np.einsum("jmpp->p", g))
        scale[scale == 0.0] = 1.0
        g *= np.outer(1.0 / scale, 1.0 / scale)
        h /= scale
        squares = np.stack([np.sum(torque[:, c] ** 2, axis=1) for c in cuts], axis=1)
        return cls(g, h, squares, scale, given)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.y)

    @cached_property
    def parts(self) -> tuple[NDArray[np.intp], list[NDArray[np.intp]]]:
        """Part of each joint, (n,), and the columns of each part: parts share none. Columns without rows are with the first."""
        used = np.einsum("jmpp->jp", self.g) > 0.0
        joined = used @ used.T | np.eye(self.n, dtype=bool)
        for _ in range(self.n.bit_length()):  # joints that share a column with a joint in common
            if joined.all():
                return np.zeros(self.n, dtype=np.intp), [np.arange(len(self.scale))]
            joined = joined @ joined
        _, part = np.unique(joined.argmax(axis=1), return_inverse=True)
        columns = np.stack([used[part == k].any(axis=0) for k in range(part.max() + 1)])
        columns[0] |= ~columns.any(axis=0)
        return part, [np.flatnonzero(own) for own in columns]

    def judged(self, order: Sequence[int] | None = None, factors: Array | None = None) -> Judged:
        """Return the errors where channel c is predicted by the rows of joint ``order[c]`` times ``factors[c]``."""
        unseen, beta, std = np.empty(self.g.shape[:2]), np.zeros(len(self.scale)), np.zeros(len(self.scale))
        for channels, columns, own in self._by_part("judged", order, factors):
            unseen[channels], beta[columns], std[columns] = own
        return Judged(unseen, beta / self.scale, std / self.scale)

    def seen(self, order: Sequence[int] | None = None, factors: Array | None = None) -> Array:
        """Return the squared errors of the channels in sample, (n,): a third of the work of `judged`."""
        squares = np.empty(self.n)
        for channels, _, (errors,) in self._in_sample._by_part("seen", order, factors):
            squares[channels] = errors
        return squares

    @cached_property
    def alone(self) -> Array:
        """Squared errors in sample of each channel by the rows of one joint and nothing else, (n, n), joint by channel.

        No fit in which that joint predicts the channel leaves less.
        """
        whole, (part_of, parts) = self._in_sample, self.parts
        y, errors = whole.y[:, 0], np.empty((self.n, self.n))
        for joint, columns in enumerate(parts[k] for k in part_of):
            g, h = whole.g[joint, 0][np.ix_(columns, columns)], whole.h[joint, :, 0][:, columns]
            known = None if self.given is None else (self.given * self.scale)[columns]
            beta = beside(g.copy(), h.T, known).T
            errors[joint] = y - 2.0 * np.sum(h * beta, axis=1) + np.sum(beta @ g * beta, axis=1)
        return _above_rounding(errors, y)

    def factor(self) -> float:
        """Return the factor of all torques over those of known parameters, beside what is fitted; NaN where nothing is known.

        Weighted by the torques of the channels: ``y = s W_k g + W_f theta`` is linear in s.
        """
        if self.given is None:
            return float("nan")
        known = np.where(np.isnan(self.given), 0.0, self.given * self.scale)
        basis = np.column_stack([known, np.eye(len(known))[:, np.isnan(self.given)]])
        whole, own = self._in_sample, np.arange(self.n)
        v = 1.0 / np.maximum(whole.y[:, 0], np.finfo(float).tiny)
        gram = basis.T @ np.tensordot(v, whole.g[:, 0], 1) @ basis
        return float(solved(gram, basis.T @ (v @ whole.h[own, own, 0]))[0])

    def knowing(self, given: Array) -> Products:
        """Return the products with other known parameters, (p,), NaN for those that are fitted."""
        return Products(self.g, self.h, self.y, self.scale, given)

    @cached_property
    def _in_sample(self) -> Products:
        """The same of all blocks together."""
        if self.y.shape[1] == 1:
            return self
        g, h, y = self.g.sum(1, keepdims=True), self.h.sum(2, keepdims=True), self.y.sum(1, keepdims=True)
        return Products(g, h, y, self.scale, self.given)

    def _by_part(
        self, what: str, order: Sequence[int] | None, factors: Array | None
    ) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], tuple[Array, ...]]]:
        """Give channels, columns and result of each part; one that a hypothesis leaves alone has been solved before."""
        rows, s = self._change(order, factors)
        part_of, parts = self.parts
        for k, columns in enumerate(parts):
            channels = np.flatnonzero(part_of[rows] == k)
            if not channels.size:
                continue
            own = np.array(rows)[channels]
            key = what, channels.tobytes(), own.tobytes(), s[channels].tobytes()
            if key not in self._solutions:
                h = self.h[own, channels]
                if len(columns) < len(self.scale):
                    g, h = self._own(own, columns), h[..., columns]
                else:  # as they are, because a copy takes as long as a solution
                    g = self.g if np.array_equal(own, np.arange(self.n)) else self.g[own]
                given = None if self.given is None else (self.given * self.scale)[columns]
                part = Part(g, h, self.y[channels], s[channels], given)
                self._solutions[key] = part.judged() if what == "judged" else (1.0 / part.weights(),)
            yield channels, columns, self._solutions[key]

    def _own(self, rows: Array, columns: NDArray[np.intp]) -> Array:
        return self.g[rows[:, None, None], :, columns[:, None], columns].transpose(0, 3, 1, 2)

    def predicted(
        self, beta: Array, order: Sequence[int] | None = None, factors: Array | None = None
    ) -> Array:
        """Return the squared errors of the channels, (n,), for given parameters, (p,): those of another log."""
        rows, s = self._change(order, factors)
        part = Part(self.g[rows], self.h[rows, np.arange(self.n)], self.y, s)
        return part.squares(beta * self.scale)

    def _change(self, order: Sequence[int] | None, factors: Array | None) -> tuple[list[int], Array]:
        rows = list(range(self.n)) if order is None else list(order)
        return rows, np.ones(self.n) if factors is None else np.asarray(factors, dtype=np.float64)


@dataclass(eq=False)
class Declared:
    """A log as declared: all that hypotheses on its torques need.

    Attributes
    ----------
    names : tuple of str
        Names of the columns.
    products : Products
        Products of columns and torques.
    declared : Judged
        Errors of the declared model.
    """

    names: tuple[str, ...]
    products: Products
    declared: Judged

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.products.n


@dataclass(frozen=True, eq=False)
class Part:
    """Channels with the columns that they share: products (n, m, p, p), (n, m, p) and (n, m), and factors (n,)."""

    g: Array
    h: Array
    y: Array
    s: Array
    given: Array | None = None

    def judged(self) -> tuple[Array, Array, Array]:
        """Return errors on blocks left out, (n, m), parameters and standard deviations, (p,), of columns of norm 1."""
        g, h, s, v = self.g, self.h, self.s, self.weights()
        a = ((v * s * s) @ g.reshape(len(g), -1)).reshape(g.shape[1:])
        r = np.tensordot(v * s, h, 1)
        whole, moment = a.sum(axis=0), r.sum(axis=0)
        left = np.stack([self._solved(*pair) for pair in zip(whole - a, moment - r, strict=True)])
        error = (
            self.y
            - 2.0 * s[:, None] * np.einsum("nmp,mp->nm", h, left)
            + s[:, None] ** 2 * np.einsum("nmp,mp->nm", np.matmul(g, left[None, :, :, None])[..., 0], left)
        )
        m = len(left)
        spread = np.sqrt((m - 1) / m * np.sum((left - left.mean(axis=0)) ** 2, axis=0))
        return _above_rounding(error, self.y), self._solved(whole, moment), spread

    @cached_property
    def _sums(self) -> tuple[Array, Array, Array]:
        y = self.y.sum(axis=1)
        one = self.g.shape[1] == 1
        return (self.g[:, 0], self.h[:, 0], y) if one else (self.g.sum(axis=1), self.h.sum(axis=1), y)

    def weights(self) -> Array:
        """Return one over the squared errors in sample, after a few solutions, (n,)."""
        (g, h, y), s = self._sums, self.s
        flat = g.reshape(len(g), -1)
        v = 1.0 / np.maximum(y, np.finfo(float).tiny)
        for _ in range(REWEIGHTINGS):
            gram = ((v * s * s) @ flat).reshape(g.shape[1:])
            v = 1.0 / self.squares(self._solved(gram, (v * s) @ h))
        return np.asarray(v)

    def squares(self, beta: Array) -> Array:
        """Return the squared errors of given parameters of columns of norm 1, (n,)."""
        (g, h, y), s = self._sums, self.s
        error = y - 2.0 * s * (h @ beta) + s * s * ((g @ beta) @ beta)
        return _above_rounding(error, y)

    def _solved(self, gram: Array, right: Array) -> Array:
        return beside(gram, right, self.given)


def beside(gram: Array, right: Array, given: Array | None) -> Array:
    """Return the solution as `solved` beside known parameters, (p,), NaN for those that are fitted; None for none."""
    if given is None:
        return solved(gram, right)
    free = np.isnan(given)
    known = np.where(free, 0.0, given)
    solution = np.repeat(known[:, None], right.shape[1], axis=1) if right.ndim > 1 else known
    if free.any():
        rest = right[free] - (gram[free] @ known)[(...,) + (None,) * (right.ndim - 1)]
        solution[free] = solved(np.ascontiguousarray(gram[np.ix_(free, free)]), rest)
    return solution


def solved(gram: Array, right: Array) -> Array:
    """Return the solution for products (p, p), which are overwritten, and (p,) or (p, k)."""
    from scipy.linalg.lapack import dposv

    diagonal = np.einsum("pp->p", gram)
    diagonal += RIDGE * diagonal.sum()
    if diagonal.size:
        # Half the work of NumPy's, for one side of a symmetric matrix; it is transposed because LAPACK reads columns.
        _, solution, failed = dposv(gram.copy().T, right, lower=True, overwrite_a=True)
        if not failed:
            return np.asarray(solution)
    return np.asarray(np.linalg.solve(gram, right))


def _above_rounding(error: Array, size: Array) -> Array:
    """Return squared errors of channels of squared torques `size`, no smaller than rounding."""
    return np.asarray(np.maximum(error, LEAST_SHARE * np.maximum(size, np.finfo(float).tiny)))
