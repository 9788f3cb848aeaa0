"""The judge: collects evidence for and against a result, from the same questions for every method.

Along a measured motion: how large is the residual, is it correlated in time, what explains it, do single samples or a dead channel
spoil it, is enough identified, what is the model good for. In the closed loop: is the declared law that of the log, does the
simulated robot move as the measured one. Tested in ``tests/test_verdict_faults.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from .._tools.arrays import Array, rms
from ..errors import DidimError
from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..regression.friction.choice import further_laws
from ..regression.least_squares import estimated
from ..result.finding import Finding, Remedy
from ..result.identification import Identification
from ..result.sentences import MISSING
from ..result.verdict import Use
from ..robot.friction import KEYS
from ..robot.payload import NOTHING
from ..robot.robot import Robot
from ..signal.noise import coarsest_steps
from ..signal.processing import SignalProcessing
from ..signal.window import Window
from ..terms.model import Model
from ..terms.rows import LinearSystem
from .causes import Search
from .gain_check import unchecked
from .lasting import delay_findings, friction_findings
from .loop.law import loop_findings
from .loop.simulated import MotionComparison, simulated_findings
from .naming import cause_findings
from .residual import Residual, held_out_findings, residual_of, size_findings, spike_findings
from .rows import LogRows
from .standstill import check_standstill
from .thresholds import NEGLIGIBLE, READ_OTHERWISE
from .torques import TORQUE_CODES, constant_torque_findings
from .uses import uses_of
from .whiteness import whiteness, whiteness_findings

SUSPICIOUS = frozenset({"not-white", "not-physical", "no-robot", "size", *TORQUE_CODES})
"""Codes of findings that show a contradiction of log and model without its cause."""
ROUNDING = 1e-9
"""Relative residual below which it is rounding."""


@dataclass(frozen=True, eq=False)
class Measured:
    """The measured motion of a log, as IDIM-LS has it, whatever the method.

    Attributes
    ----------
    robot : Robot
        With the friction of the experiment.
    signal : SignalProcessing
        Filters and decimation.
    logs : Model
        What the logs have beside the robot.
    parts, outside : sequence of Window
        Filtered windows of the recordings of the fit, and of those that were held out.
    least : callable
        Returns the errors that plain IDIM-LS leaves, (n,) (N.m or N, root mean squares).
    system : LinearSystem or None
        The system (7) of `parts` with all base columns, where a run has made it.
    """

    robot: Robot
    signal: SignalProcessing
    logs: Model
    parts: Sequence[Window]
    outside: Sequence[Window]
    least: Callable[[], Array]
    system: LinearSystem | None = None


def judged(
    fit: Identification,
    experiment: Experiment,
    measured: Measured | None,
    by_law: Measured | None,
    *,
    system_tested: bool,
    uses_torques: bool,
    say: Callable[[str], None],
) -> Identification:
    """Return a result with the evidence that its method has not collected.

    Parameters
    ----------
    fit : Identification
        Result of a method.
    experiment : Experiment
        What it was made of, with the friction that was chosen.
    measured : Measured or None
        Its measured motion; None where there is none, or no torques.
    by_law : Measured or None
        The same motion with the torques of the declared controller, for methods that fit positions: the errors of these as torques.
    system_tested : bool
        Whether the method has tested the residual of its own system (7) for whiteness.
    uses_torques : bool
        Whether the method reads measured torques.
    say : callable
        Called with sentences on the progress.
    """
    # CLOE from positions alone has no use for torques.
    findings = constant_torque_findings(experiment) if uses_torques else []
    of_fit = [recording for recording in experiment.recordings if recording.role == "fit"]
    along = by_law if measured is None else measured
    rows = None if along is None else _rows(along, of_fit)
    if fit.n_simulations:
        findings += loop_findings(
            experiment, _fed_forward(fit, experiment, rows if along is measured else None)
        )
        findings += _simulated(fit, experiment, measured, bool(findings) or not system_tested)
    findings += held_out_findings(fit)
    uses: list[Use] = []
    if along is not None:
        fit, findings, uses = _along(
            along, by_law, fit, findings, rows, of_fit, system_tested=system_tested, say=say
        )
    return replace(fit, evidence=(*findings, *fit.evidence), uses=tuple(uses))


def _along(
    measured: Measured,
    by_law: Measured | None,
    fit: Identification,
    findings: list[Finding],
    rows: LogRows | None,
    fitted: Sequence[Recording],
    *,
    system_tested: bool,
    say: Callable[[str], None],
) -> tuple[Identification, list[Finding], list[Use]]:
    """Return the result, the findings along the measured motion behind those there are, and the uses.

    The search knows more than the look at the torques alone, whose causes are taken out of the result where it was done.
    """
    parts, signal = measured.parts, measured.signal
    residual = _residual(measured, fit)
    if residual is None:
        return fit, findings, []
    growth = 1.0
    held = np.zeros(0) if fit.uncertainty is None else fit.uncertainty.unseen
    if held.size:
        size = rms(residual.error.T)
        growth = float(np.linalg.norm(held * size) / max(float(np.linalg.norm(size)), np.finfo(float).tiny))
    elif rows is not None:
        growth = float(np.sqrt(rows.declared.unseen.sum() / max(float(rows.products.seen().sum()), 1e-300)))
    findings = [*findings, *size_findings(residual, growth, chosen=_chosen(fit))]
    if measured is not by_law:
        findings += spike_findings(parts, signal)
        findings += check_standstill(measured.robot, parts, rows, fit)
    if not system_tested:
        own = None if by_law is None else _residual(by_law, fit)
        findings += _lasting(residual, fit) if own is None else _lasting(own, replace(fit, uncertainty=None))
    spoiled = any(finding.code in ("spikes", "constant-torque") for finding in findings)
    if spoiled:
        # What outliers do to the law of the controller and to a simulated robot is not theirs.
        findings = [finding for finding in findings if not finding.code.startswith("controller")]
    codes = {finding.code for finding in (*findings, *fit.evidence)}
    explicable = "constant-torque" not in codes and not fit.overall_relative_error <= ROUNDING
    if rows is not None:
        alarm = None if fit.uncertainty is None else fit.uncertainty.friction
        # A torque that the law makes has no sign, gain or delay of its own.
        if explicable and measured is not by_law:
            if codes & SUSPICIOUS or (alarm is not None and alarm.raised):
                say("the log contradicts its model: looking for the cause")
                # The cause stands before what follows from it.
                findings = [*explained(rows, measured, fit), *findings]
                fit = replace(
                    fit, evidence=tuple(finding for finding in fit.evidence if "ties" not in finding.facts)
                )
            else:
                findings += _delay(rows, fit)
    by_law_rows = rows if measured is by_law or by_law is None else _rows(by_law, fitted)
    if explicable and by_law_rows is not None and by_law is not None:
        findings = [finding for finding in findings if finding.code != "friction"]
        findings += _friction(by_law_rows, by_law, fit)
    uses, uncertain = uses_of(measured.robot, fit, parts, residual, signal, growth, measured.system)
    return fit, [*findings, *uncertain], uses


def _fed_forward(fit: Identification, experiment: Experiment, rows: LogRows | None) -> Array | None:
    """Return the standard parameters of a torque that a controller may have fed forward, (n_parameters,); None without any.

    Those of IDIM-LS where there are measured torques and no friction by load: what a wrong controller does to a simulated robot is
    in those of the fit.
    """
    if rows is not None and rows.robot.parameter_names == experiment.robot.parameter_names:
        return rows.robot.base_parameters.lift(rows.beta)
    return fit.parameters if fit.converged else None


def _rows(measured: Measured, fitted: Sequence[Recording] = ()) -> LogRows | None:
    """Return the rows of a measured motion; None where they are too few for hypotheses."""
    with suppress(DidimError):
        parts, logs, system = measured.parts, measured.logs, measured.system
        return LogRows(measured.robot, measured.signal, parts, fitted, logs=logs, system=system)
    return None


def _residual(measured: Measured, fit: Identification) -> Residual | None:
    """Return the relative torque error of a result along a measured motion; None where it is not finite."""
    # Drive gains, the last of the further parameters, are in the torques already.
    beta = fit.beta if fit.further is None else np.append(fit.beta, fit.further.values)
    beta = beta[: measured.logs.n_base + measured.logs.n_further]
    with suppress(DidimError), np.errstate(over="ignore", invalid="ignore"):
        residual = residual_of(
            measured.robot, measured.logs, beta, measured.parts, measured.signal, measured.system
        )
        if np.isfinite(residual.error).all():
            return residual
    return None


def _lasting(residual: Residual, fit: Identification) -> list[Finding]:
    """Return what the whiteness of the residual says, for methods that solve no system (7)."""
    n = len(residual.error)
    shares = np.sqrt(np.mean(residual.error**2, axis=1)) / np.maximum(residual.size, np.finfo(float).tiny)
    return whiteness_findings(
        whiteness(residual.error.reshape(-1), residual.blocks, n), shares, fit.uncertainty, fit.std
    )


def explained(rows: LogRows, measured: Measured, fit: Identification | None) -> list[Finding]:
    """Return what explains a log that contradicts its model: a cause; else friction, a delay, and gains that it cannot check."""
    other = _rows(replace(measured, parts=measured.outside, system=None)) if measured.outside else None
    share = float(np.sqrt(rows.products.seen().sum() / np.sum(rows.y**2)))
    cause = Search(rows, other, readings=share > READ_OTHERWISE).cause()
    named = cause_findings(rows, cause)
    if cause is not None and cause.certain:
        return named
    return [*named, *_delay(rows, fit), *_friction(rows, measured, fit), *unchecked(rows)]


def _friction(rows: LogRows, measured: Measured, fit: Identification | None) -> list[Finding]:
    """Return friction that the model lacks; beside laws that it has, further ones are tried on blocks left out first."""
    found = friction_findings(rows, fit, chosen=fit is not None and _chosen(fit))
    if not measured.robot.friction.terms:
        return found
    return [_tried(finding, rows, measured) if finding.grade == "doubtful" else finding for finding in found]


def _tried(finding: Finding, rows: LogRows, measured: Measured) -> Finding:
    """Return a finding on missing friction as that of the joints where blocks support a further law; a note if there is none."""
    steps = coarsest_steps(recording.measured_positions() for recording in rows.recordings)
    joints = [joint - 1 for joint in finding.joints]
    with suppress(DidimError):
        found = further_laws(measured.logs, measured.parts, measured.signal, estimated, steps, joints)
        found = {
            joint: own for joint, laws in found.items() if (own := tuple(law for law in laws if law in KEYS))
        }
        if found:
            seen = {joint - 1: law for law, where in finding.facts["laws"].items() for joint in where}
            named: dict[str, list[int]] = {}
            added: dict[str, list[int]] = {}
            for joint, supported in found.items():
                # What the test sees as a law may be a sign that is kept.
                law = next((law for law in supported if law in MISSING), seen[joint])
                named.setdefault(law, []).append(joint + 1)
                for law in supported:
                    added.setdefault(KEYS[law], []).append(joint + 1)
            key, where = next(iter(added.items()))
            return replace(
                finding,
                joints=tuple(joint + 1 for joint in found),
                remedy=Remedy(
                    file="experiment", table="[friction]", key=key, action="add", joints=tuple(where)
                ),
                facts={**finding.facts, "laws": named, "law": next(iter(named)), "add": added},
            )
        return replace(finding, grade="note", remedy=None, facts={**finding.facts, "refused": True})
    return finding


def _chosen(fit: Identification) -> bool:
    """Return whether friction laws were chosen for the log, not only velocities estimated: then none is missed."""
    return "chosen" in fit.settings.get("friction", {})


def _delay(rows: LogRows, fit: Identification | None) -> list[Finding]:
    """Return a delay that the file does not compensate; the test for missing friction leaves it aside as an error of sampling."""
    if fit is None:
        return delay_findings(rows, np.zeros(0), obeyed=False)
    obeyed = bool(np.any(fit.delay.get("compensated_samples", 0.0))) or "estimated_samples" in fit.delay
    return delay_findings(rows, fit.std, obeyed=obeyed)


def _simulated(
    fit: Identification, experiment: Experiment, measured: Measured | None, doubted: bool
) -> list[Finding]:
    """Return what the simulated robot says against a result, for logs that share all parameters."""
    record = fit.settings.get("simulated")
    shared = all(each.payload == NOTHING and not each.own for each in experiment.recordings)
    if not (record and fit.converged and shared and measured is not None):
        return []
    doubted = doubted or any(
        each.code == "not-white" and (each.effect or 0.0) > NEGLIGIBLE for each in fit.evidence
    )
    return simulated_findings(experiment, MotionComparison.of_record(record), measured.least, doubted=doubted)
