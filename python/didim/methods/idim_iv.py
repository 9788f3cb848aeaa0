"""IDIM-IV: the inverse dynamic model along measured motion, with instruments from simulated motion.

    beta^(k+1) = (Z^T O W)^-1 Z^T O Y          Z = W along the motion simulated with beta^k

W contains the noise of the measured motion; Z does not, so Z^T W is free of its bias. The iteration, its safe steps and its
start are those of DIDIM. Source: Janot, Vandanjon and Gautier (2014). Tested in ``tests/test_contrast.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..errors import FitError
from ..experiment.experiment import Experiment
from ..regression.classical.instrumental import (
    Diagnosis,
    instrument_diagnosis,
    solve_with_instruments,
)
from ..regression.consistent.solver import ConsistentSolver
from ..result.identification import Identification
from ..result.iteration import Reporter
from .didim.iterations import Iterations
from .didim.problem import Solved
from .didim.settings import DIDIMSettings
from .method import Motion

WEAK = 0.5
"""Share of a column that the instruments do not explain, above which the instrument counts as weak."""


@dataclass(frozen=True, kw_only=True)
class IDIMIV(DIDIMSettings):
    """IDIM-IV with its settings: those of `DIDIMSettings`, with another stopping rule.

    The instruments are the regressor (2) along the simulated motion. Tested in ``tests/test_contrast.py``.

    Parameters
    ----------
    sigma_fraction : float
        Stop after a full step that changes no parameter by more than this fraction of its standard deviation.
    tolerance : float
        Alternative stopping rule: the norm of the residual changes by less than this share; 0 by default, because the residual
        along the measured motion hardly depends on the instruments.

    physical : bool
        Project the estimate of every iteration to the nearest robot, as in consistent DIDIM.

    Notes
    -----
    ``fit.settings["instruments"]`` of the result contains the strength of the instruments, the Durbin-Wu-Hausman test and
    Durbin and Watson's statistic. `didim.contrast` with IDIM-LS and DIDIM shows whether the filter or the controller is wrong
    (docs/idim_ls.md).
    """

    name: ClassVar[str] = "idim-iv"
    motion: ClassVar[Motion] = "measured"

    tolerance: float = 0.0
    sigma_fraction: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.solver not in (None, "least-squares"):
            raise FitError("IDIM-IV solves the linear system with its instruments: it has no other solver")

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        """Identify the parameters of an experiment's robot, as `Method.run`."""
        job = self.job(experiment, experiment.simulated_robot)
        if not isinstance(job.solver, ConsistentSolver):
            job = replace(job, solver=solve_with_instruments, solver_choice=solve_with_instruments)
        iterations = Iterations(self, job, reporter)
        return _with_diagnosis(iterations.result(), iterations.solved)


def _with_diagnosis(fit: Identification, solved: Solved) -> Identification:
    """Return the result with the diagnosis of the instruments, in its settings and as remarks."""
    if solved.held:  # without an estimate of all parameters there is no result to judge
        return fit
    names, diagnosis = solved.system.names, instrument_diagnosis(solved.system, solved.fit)
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
    sentences = [
        f"the simulated motion misses {100.0 * float(np.median(strength)):.2g} % of a column of W (median), at most "
        f"{100.0 * strength[worst]:.2g} % ({names[worst]})"
        + (": a weak instrument, whose estimate has a bias of its own" if strength[worst] > WEAK else "")
    ]
    if diagnosis.test is not None:
        test = diagnosis.test
        sentences.append(
            f"Durbin-Wu-Hausman test: F = {test.statistic:.3g} with {test.added} and {test.remaining} degrees of freedom, "
            f"p = {test.p_value:.2g} if the errors were white; the contrast with IDIM-LS does without that"
        )
    return sentences
