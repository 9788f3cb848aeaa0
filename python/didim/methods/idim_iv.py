"""IDIM-IV: the inverse dynamic model with measured motion, and the simulated one as instruments.

    beta^(k+1) = (Z^T O W)^-1 Z^T O Y          Z = W along the motion simulated with beta^k

W has the noise of the measured motion in it, Z has not; what both share is free of it. The iteration, its safe steps and its
start are those of DIDIM. Source: Janot, Vandanjon and Gautier (2014). Tested in ``tests/test_contrast.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..errors import FitError
from ..experiment.experiment import Experiment
from ..regression.classical.instrumental import Diagnosis, solve_with_instruments
from ..regression.consistent.nearest import root_of
from ..regression.consistent.solver import ConsistentSolver
from ..regression.fit import Fit, Progress
from ..regression.linear_system import LinearSystem
from ..regression.settings import LeastSquaresSettings
from ..result.identification import Identification
from ..result.iteration import Iteration
from .didim.consistent import ConsistentRun
from .didim.didim import Iterations
from .didim.settings import DIDIMSettings
from .didim.windows import Point
from .job import Job
from .method import Motion

WEAK = 0.5
"""Share of a column that the instruments do not explain, from which the instrument is called weak."""


@dataclass(frozen=True, kw_only=True)
class IDIMIV(DIDIMSettings):
    """IDIM-IV with its settings: those of `DIDIMSettings`, with another end.

    Parameters
    ----------
    sigma_fraction : float
        Stop after a full step that changes no parameter by more than this fraction of its standard deviation.
    tolerance : float
        Or when the norm of the residual changes by less than this share; 0 by default, because the residual along the measured
        motion hardly depends on the instruments.

    physical : bool
        Move the estimate of every iteration to the nearest robot, as consistent DIDIM does.

    Notes
    -----
    The result has in ``fit.settings["instruments"]`` the strength of the instruments, the Durbin-Wu-Hausman test and Durbin
    and Watson's statistic. `didim.contrast` with IDIM-LS and DIDIM says whether the filter or the controller is wrong
    (docs/idim_iv.md).
    """

    name: ClassVar[str] = "idim-iv"
    summary: ClassVar[str] = (
        "instrumental variables: rows of the measured motion, instruments of the simulated one; needs [controller]"
    )
    motion: ClassVar[Motion] = "measured"

    tolerance: float = 0.0
    sigma_fraction: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.solver not in (None, "least-squares"):
            raise FitError("IDIM-IV solves the linear system with its instruments: it has no other solver")

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify the parameters of an experiment's robot; parameters as for `IDIMLS.run`.

        Raises
        ------
        DidimError
            One of its kinds: without a reference or a controller, for a start with which the robot cannot be simulated,
            for a log that allows no estimate.
        """
        solver = _Instruments()
        job = self.job(experiment, experiment.simulation.robot(experiment.robot))
        if isinstance(job.solver, ConsistentSolver):
            run = _ConsistentInstruments(self, job, job.solver, progress, say)
            return _with_diagnosis(run.result(), run.instruments)
        job = replace(job, solver=solver, solver_choice=solver)
        iterations = _InstrumentalIterations(self, job, solver, progress, say)
        point = iterations.simulate()
        while not iterations.over:
            system = iterations.observe(point)  # Y and W along the measured motion; Z along the simulated one
            solved = iterations.solve(point, system)
            step = iterations.step(point, solved)
            point = iterations.stop(point, solved, step)
        return _with_diagnosis(iterations.result(point), solver)


class _Instruments:
    """The solver of one run; `system` has the instruments, and `diagnosis` is that of the last solution."""

    name = "instrumental"
    system: LinearSystem
    diagnosis: Diagnosis | None = None
    names: tuple[str, ...] = ()

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        """Solve (7) with the instruments of the same columns."""
        columns = [self.system.names.index(name) for name in system.names]
        every = columns == list(range(len(self.system.names)))
        instruments = self.system.w if every else self.system.w[:, columns]
        fit, self.diagnosis = solve_with_instruments(system, instruments, settings)
        self.names = system.names
        return fit


class _InstrumentalIterations(Iterations):
    """The iterations of DIDIM, whose regressor is the instrument."""

    def __init__(
        self,
        method: IDIMIV,
        job: Job,
        solver: _Instruments,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> None:
        super().__init__(method, job, progress, say)
        self._solver = solver
        # Along the measured motion nothing changes.
        self._measured = job.system(job.parts("fit", self.loops.delay))

    def observe(self, point: Point) -> LinearSystem:
        """Return (7) along the measured motion, and keep the regressor along the simulated one as instruments."""
        self._solver.system = super().observe(point)
        return self.about(point, self._measured)


class _ConsistentInstruments(ConsistentRun):
    """The iterations of consistent DIDIM with the estimate of the instruments, moved to the nearest robot (10)."""

    @cached_property
    def instruments(self) -> _Instruments:
        """The instruments of the last solution."""
        return _Instruments()

    def solved(self, point: Point) -> tuple[LinearSystem, Fit]:
        """Return the rows along the measured motion, and the robot nearest to the estimate of the instruments."""
        self.instruments.system = self.observed(point)
        free = self.instruments(self.measured, self.job.settings)
        problem = self.solver.problem
        assert problem is not None
        root = root_of(free.covariance)
        constrained = problem.solve(root, root @ free.solution)
        solution = np.asarray(problem.matrix @ constrained.x)
        return self.measured, replace(
            free,
            solution=solution,
            residual=self.measured.y - self.measured.w @ solution,
            standard=constrained.x,
            record={
                "gamma": problem.gamma,
                "prior": problem.prior.name,
                "half_distance": constrained.half_distance,
                "iterations": constrained.iterations,
            },
        )


def _with_diagnosis(fit: Identification, solver: _Instruments) -> Identification:
    """Return the result with what the instruments say, in its settings and as remarks."""
    diagnosis, names = solver.diagnosis, solver.names
    if diagnosis is None:
        return fit
    test = diagnosis.test
    record = {
        "strength": {name: float(value) for name, value in zip(names, diagnosis.strength, strict=True)},
        "durbin_wu_hausman": None if test is None else vars(test),
        "durbin_watson": [float(value) if np.isfinite(value) else None for value in diagnosis.durbin_watson],
    }
    return replace(
        fit,
        settings={**fit.settings, "instruments": record},
        remarks=(*fit.remarks, *_sentences(diagnosis, names)),
    )


def _sentences(diagnosis: Diagnosis, names: tuple[str, ...]) -> list[str]:
    strength = diagnosis.strength
    worst = int(np.argmax(strength))
    found = [
        f"the simulated motion misses {100.0 * float(np.median(strength)):.2g} % of a column of W (median), at most "
        f"{100.0 * strength[worst]:.2g} % ({names[worst]})"
        + (": a weak instrument, whose estimate has a bias of its own" if strength[worst] > WEAK else "")
    ]
    if diagnosis.test is not None:
        test = diagnosis.test
        found.append(
            f"Durbin-Wu-Hausman test: F = {test.statistic:.3g} with {test.added} and {test.remaining} degrees of freedom, "
            f"p = {test.p_value:.2g} if the errors were white; the contrast with IDIM-LS does without that"
        )
    return found
