"""CLOE by the simplex of the paper: as in ``fminsearch``, and in a variant that converges.

Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ...result.identification import Identification
from ...result.iteration import Iteration, Status
from ..uncertainty import Spread
from .nelder_mead import Simplex, edged_simplex, literal_simplex, minimise, started
from .output_error import OutputError

EDGE = 0.3
"""First edge of the scaled simplex, as the share of the error norm that it changes in the outputs."""
PATIENCE, PROGRESS = 5, 0.1
"""A simplex that has not improved by the second, relative, over the first times n iterations has lost its shape."""
COLLAPSED_SHARE = 1e-4
"""Size of a collapsed simplex, as a share of its first edges and of the initial norm; fminsearch's 1e-4 otherwise."""
WORTH = 1e-6
"""Relative improvement of the norm below which a restart is the last."""
NO_DEVIATIONS = (
    "the simplex gives no standard deviations; the local optimum it ends in need not be the best one"
)
"""Sentence of every result."""
REPORT_EVERY = 100
"""Iterations between two entries of the history, and between two checkpoints."""


class SimplexSearch:
    """A search that can be interrupted, saved and resumed."""

    def __init__(self, problem: OutputError) -> None:
        self.problem, self.reporter, self.method = problem, problem.reporter, problem.method
        n = problem.start.size
        self.most_iterations = self.method.max_iterations or 200 * n
        self.most_evaluations = self.method.max_evaluations or 200 * n
        self.literal = self.method.variant == "literal"
        self.history: list[Iteration] = []
        self.stopped = False
        self.restarts, self.before = 0, math.inf
        self.norms: list[float] = []
        self.stalled, self.patient = False, False
        self.simplex: Simplex
        self.first: Simplex
        # Coordinates are in units of the first edges, so a collapsed simplex spans small fractions of 1.
        self.unit = np.ones(n)
        self.initial = float(self._values(problem.start[None])[0])
        if not math.isfinite(self.initial):
            raise problem.no_start()

    def run(self) -> Identification:
        """Search to the end."""
        problem = self.problem
        self.checkpoint = problem.checkpoint
        self.begin = time.monotonic()
        status = Status.NOT_CONVERGED
        try:
            self.first = self._continued() or self._begun()
            while True:
                simplex, collapsed = minimise(
                    lambda points: self._values(points * self.unit),
                    self.simplex,
                    adaptive=self.method.variant == "adaptive",
                    x_tolerance=COLLAPSED_SHARE,
                    f_tolerance=COLLAPSED_SHARE if self.literal else COLLAPSED_SHARE * self.initial,
                    max_iterations=self.most_iterations,
                    max_evaluations=self.most_evaluations,
                    progress=self._report,
                )
                self.simplex = simplex
                ended = collapsed or self.stalled
                if self.stopped or not ended or self.literal or not self._restart():
                    status = Status.CONVERGED if ended else Status.NOT_CONVERGED
                    break
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
        if self.stopped:
            status = Status.STOPPED
        self._save()
        if not self.history or self.history[-1].iteration != self.simplex.iterations:
            self._note(self.simplex)
        size = len(problem.estimated)
        return problem.result(
            self.best,
            status=status,
            history=self.history,
            spread=Spread(np.zeros((size, size)), None, (NO_DEVIATIONS,)),
            condition_number=math.inf,
            settings={
                "iterations": self.simplex.iterations,
                "evaluations": self.simplex.evaluations,
                "restarts": self.restarts,
                "initial_norm": self.initial,
                "final_norm": float(self.simplex.values[0]),
            },
        )

    @property
    def best(self) -> Array:
        """Best point so far."""
        return np.asarray(self.simplex.points[0] * self.unit)

    def _values(self, points: Array) -> Array:
        return np.sqrt(self.problem.costs(points))

    def _begun(self) -> Simplex:
        start = self.problem.start
        unit = np.ones_like(start)
        # State for an interruption before the first simplex.
        alone = np.array([self.initial])
        self.simplex = Simplex(start[None], alone, iterations=1, evaluations=1, simulations=1)
        if self.literal:
            points = literal_simplex(start)
        else:
            points, unit = self._edged(start, self.initial)
        first = started(lambda points: self._values(points * unit), points / unit)
        self.unit, self.simplex = unit, first
        return first

    def _edged(self, point: Array, norm: float) -> tuple[Array, Array]:
        """Return a simplex with edges that change the outputs by a share of their errors, and the lengths of the edges."""
        problem = self.problem
        jacobian = problem.derivatives(point, problem.errors(point[None])[0][0])
        sizes = np.sqrt(np.diag(jacobian.normal))
        # A parameter without effect here gets an edge by its effect on the torques.
        edges = np.where(sizes > 0.0, EDGE * norm / np.where(sizes > 0.0, sizes, 1.0), 0.1 * problem.scale)
        edges = np.minimum(edges, problem.scale)
        for k in range(point.size):
            # Half of the largest step with M(q) positive definite, on the side with the larger one.
            towards = np.zeros_like(point)
            towards[k] = 2.0 * edges[k]
            up, down = problem.safe_share(point, point + towards), problem.safe_share(point, point - towards)
            edges[k] *= up if up >= down else -down
        edges[edges == 0.0] = 1e-3 * problem.scale[edges == 0.0]
        return edged_simplex(point, edges), np.abs(edges)

    def _restart(self) -> bool:
        """Restart with a fresh simplex at the best point, since a collapsed simplex need not be at a minimum.

        Returns False once restarts no longer reduce the norm.
        """
        norm = float(self.simplex.values[0])
        # If a new shape does not help either, the optimum is near, and the simplex may collapse from now on.
        self.patient |= self.stalled and norm > (1.0 - PROGRESS) * self.before
        if not self.stalled and norm >= (1.0 - WORTH) * self.before:
            return False
        old = self.simplex
        points, unit = self._edged(self.best, norm)
        fresh = started(lambda points: self._values(points * unit), points / unit)
        # Assigned together at the end: an interruption must leave the old simplex in its own units.
        self.before, self.norms, self.stalled, self.unit = norm, [], False, unit
        self.restarts += 1
        self.simplex = replace(
            fresh,
            iterations=old.iterations + 1,
            evaluations=old.evaluations + fresh.evaluations,
            simulations=old.simulations + fresh.simulations,
        )
        self.reporter.say(f"restart {self.restarts} from norm {norm:.6g}")
        return True

    def _report(self, now: Simplex) -> bool:
        self.simplex = now
        self.norms.append(float(now.values[0]))
        patience = PATIENCE * now.points.shape[1]
        if not (self.literal or self.patient) and len(self.norms) > patience:
            self.stalled = self.norms[-1] > (1.0 - PROGRESS) * self.norms[-1 - patience]
            if self.stalled:
                return True
        if now.iterations % REPORT_EVERY and now.iterations + 1 < self.most_iterations:
            return False
        first, left = self.first, time.monotonic() - self.begin
        left *= min(
            (self.most_evaluations - now.evaluations) / max(1, now.evaluations - first.evaluations),
            (self.most_iterations - now.iterations) / max(1, now.iterations - first.iterations),
        )
        self.reporter.say(
            f"iteration {now.iterations}, {now.evaluations} evaluations: norm {now.values[0]:.6g} of {self.initial:.4g}; "
            f"at most {max(0.0, left):.0f} s left"
        )
        self._note(now)
        self._save()
        self.stopped = self.reporter.progress(self.history[-1])
        return self.stopped

    def _note(self, now: Simplex) -> None:
        self.history.append(
            Iteration(
                iteration=now.iterations,
                relative_error=float(now.values[0] / self.initial),
                step=float(np.max(np.abs(now.points[1:] - now.points[0]))),
                more={"norm": float(now.values[0]), "evaluations": float(now.evaluations)},
            )
        )

    def _save(self) -> None:
        simplex = self.simplex
        if len(simplex.points) == 1:
            return
        self.checkpoint.save(
            {
                "points": simplex.points,
                "values": simplex.values,
                "unit": self.unit,
                "norms": np.array(self.norms),
            },
            {
                "iterations": simplex.iterations,
                "evaluations": simplex.evaluations,
                "simulations": simplex.simulations,
                "all_simulations": self.problem.n_simulations,
                "restarts": self.restarts,
                "patient": self.patient,
                "before": self.before if math.isfinite(self.before) else None,
            },
            self.history,
        )

    def _continued(self) -> Simplex | None:
        """Return the state of an earlier run of the same search from its checkpoint, or None."""
        stored = self.checkpoint.load()
        if stored is None:
            return None
        arrays, numbers, self.history = stored
        self.unit, self.restarts, self.patient = arrays["unit"], numbers["restarts"], numbers["patient"]
        self.before = math.inf if numbers["before"] is None else numbers["before"]
        self.norms = arrays["norms"].tolist()
        self.problem.n_simulations = numbers["all_simulations"]
        self.simplex = Simplex(
            arrays["points"],
            arrays["values"],
            *(numbers[key] for key in ("iterations", "evaluations", "simulations")),
        )
        self.reporter.say(f"goes on from iteration {self.simplex.iterations} of {self.method.checkpoint}")
        return self.simplex
