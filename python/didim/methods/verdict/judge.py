"""The judgement: evidence that costs more is looked for where the cheap evidence is suspicious.

Tested in ``tests/test_verdict_faults.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ...errors import DidimError
from ...experiment.experiment import Experiment
from ...result.identification import Identification
from ...result.verdict import Reason
from ...robot.payload import NOTHING
from ..idim_ls import IDIMLS
from ..method import FitSettings, MethodSettings
from .causes.search import explained
from .held_out import held_out_reasons
from .loop import loop_reasons
from .simulated import Beside, least_errors, simulated_reasons
from .torques import TORQUE_CODES, constant_torque_reasons

SUSPICIOUS = frozenset({"not-white", "not-physical"})
"""Codes of grave reasons that say that the log contradicts its model, but not why."""
ROUNDING = 1e-9
"""Relative error up to which a residual is that of floating point."""


def judged(
    fit: Identification, experiment: Experiment, method: object, say: Callable[[str], None]
) -> Identification:
    """Return a result with the evidence that its method has not collected.

    Parameters
    ----------
    fit : Identification
        Result of a method.
    experiment : Experiment
        What it was made of, with the friction that was chosen.
    method : Method
        Its settings.
    say : callable
        Called with sentences on the progress.
    """
    if fit.further is not None and fit.further.gains is not None:
        experiment = experiment.with_gains(fit.further.gains)
    # CLOE from positions alone has no use for torques.
    found = [] if getattr(method, "output", None) == "position" else constant_torque_reasons(experiment)
    if fit.n_simulations:
        found += loop_reasons(experiment, fit.parameters if fit.converged else None)
        found += _simulated(fit, experiment, method, bool(found))
    found += held_out_reasons(fit)
    codes = {reason.code for reason in (*fit.verdict.grave, *found)}
    explicable = (
        fit.overall_relative_error > ROUNDING
    )  # hypotheses explain a residual, and of rounding there is nothing to explain
    if explicable and codes & SUSPICIOUS and not codes & TORQUE_CODES:
        say("the log contradicts its model: looking for the cause")
        found += _causes(experiment, method)
    return replace(fit, evidence=(*found, *fit.evidence)) if found else fit


def _simulated(fit: Identification, experiment: Experiment, method: object, doubted: bool) -> list[Reason]:
    """Return what the simulated robot says against a result, for logs that share all parameters."""
    record = fit.settings.get("simulated")
    shared = all(item.payload == NOTHING and not item.own for item in experiment.recordings)
    if not (record and fit.converged and shared and isinstance(method, MethodSettings)):
        return []
    # Only a system (7) has a residual whose whiteness was tested.
    doubted = doubted or not isinstance(method, FitSettings) or "not-white" in {r.code for r in fit.evidence}
    try:
        job = IDIMLS(
            signal=method.signal,
            fixed=method.fixed,
            dropped=method.dropped,
            compensate_samples=method.compensate_samples,
        ).job(experiment)
    except DidimError:  # settings that are not those of IDIM-LS
        return []
    found = Beside.of_record(record)
    return simulated_reasons(experiment, found, lambda: least_errors(job), doubted=doubted)


def _causes(experiment: Experiment, method: object) -> list[Reason]:
    """Return the hypothesis that explains the log, along its measured motion."""
    signal = method.signal if isinstance(method, MethodSettings) else None
    try:
        # A wrong fixed value must not speak for the log.
        job = IDIMLS(signal=signal, fixed={}, dropped=()).job(experiment)
        if not job.parameters.simple:
            return []  # the hypotheses are made for logs that share all parameters
        return explained(job, job.parts("fit", job.declared_delay)).reasons()
    except DidimError:  # without positions, or filtered otherwise: there is no measured motion
        return []
