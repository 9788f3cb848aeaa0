"""Drives and friction that a log of positions identifies, before the fit. Tested in ``tests/test_positions.py``.

The derivatives of the simulated positions at the values of the robot file give the intervals that noise, and a model error of a
usual size, would leave; unknowns that others widen beyond measure would be held by a fit, and are reported first.
"""

from __future__ import annotations

import numpy as np

from ..._tools.arrays import Array, quotient
from ..._tools.words import series
from ...experiment.experiment import Experiment
from ...experiment.loop import recordings_of
from ...result.finding import Finding, worded
from ...signal.noise import encoder_noise
from .knowledge import by_sentence, unidentified, where_of, widening
from .problem import Problem
from .search import Search, begun
from .stops import findings_of

MODEL_ERROR, LASTS_S = 1e-3, 0.2
"""Error (rad or m) that friction models leave on good robots, and the time (s) that it lasts: a quadruped's hips have 2 mrad."""
POOR = 0.5
"""Ratio of half the interval to the value, from which a parameter is poorly identified."""


def prospect(experiment: Experiment) -> tuple[list[Finding], list[str]]:
    """Return findings on what a log does not identify, and sentences on the other unknowns.

    Raises
    ------
    DidimError
        One of its kinds, for an experiment that cannot be fitted.
    """
    return prospect_of(begun(Problem(experiment)))


def prospect_of(now: Search) -> tuple[list[Finding], list[str]]:
    """Return findings and sentences, as `prospect`, of a search that stands at its start."""
    problem, experiment = now.problem, now.problem.experiment
    advice = "Log the joint moving freely, or go on without these stretches"
    findings = [_lack(each.sentence, advice, each.joints) for each in findings_of(experiment, problem.stops)]
    remarks = []
    now.held = unidentified(now, error=MODEL_ERROR)
    for sentence, columns in by_sentence(now).items():
        joints = {joint + 1 for column in columns for joint in column.joints}
        advice = "Command steps or a chirp (didim excite --positions), or take it out of [unknown]"
        findings.append(_lack(sentence, advice, tuple(sorted(joints))))
    share = _shares(now)
    for kind in dict.fromkeys(column.kind for column in problem.columns):
        at = [k for k, c in enumerate(problem.columns) if c.kind == kind and np.isfinite(share[k])]
        if at and kind not in ("Off", "bias_rad", "delay_s", "lag_s"):  # they have no size of their own
            remarks.append(f"{kind}: 95 % intervals of about {_range_text(share[at])}, before the fit")
        poor = [k for k in at if share[k] > POOR and kind in ("Ia", "Fv", "Fc")]
        if poor:
            names = series((where_of(problem.robot, problem.columns[k]) for k in poor), 90)
            sentence = (
                f"the log hardly identifies {kind} of {names}: intervals of about {_range_text(share[poor])}"
            )
            advice = "Log faster, and command steps or a chirp up to the bandwidth of the loop (didim excite --positions)"
            findings.append(_lack(sentence, advice, tuple(problem.columns[k].joints[0] + 1 for k in poor)))
    return findings, remarks


def _lack(sentence: str, advice: str, joints: tuple[int, ...]) -> Finding:
    """Return the finding on what a log does not identify."""
    return worded(kind="excitation", sentence=sentence, advice=advice, joints=joints)


def _shares(now: Search) -> Array:
    """Return half intervals over values, (n_columns,); NaN of unknowns that would be held."""
    problem, (a, _) = now.problem, now.normal()
    use = now.used(a)
    f, _ = widening(a, use)
    _, recording = recordings_of(problem.experiment)[0]
    noise = encoder_noise(recording.q)
    lasting = MODEL_ERROR**2 * max(1.0, LASTS_S * recording.rate_hz)
    error = np.sqrt([np.mean(noise[list(problem.columns[k].joints)] ** 2) + lasting for k in use])
    # Where the file has zero, what would move the joint as much as its inertia or its servo does.
    values = np.array([abs(problem.columns[k].start) or 1e3 * problem.columns[k].step for k in use])
    share = np.full(len(problem.columns), np.nan)
    half = 2.0 * error * f / np.sqrt(np.diag(a)[use])
    share[use] = quotient(half, values, np.nan)
    return share


def _range_text(shares: Array) -> str:
    low, high = 100.0 * float(np.min(shares)), 100.0 * float(np.max(shares))
    return f"{low:.2g} %" if high <= 1.1 * low else f"{low:.2g} to {high:.2g} %"
