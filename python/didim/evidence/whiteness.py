"""Whiteness of the residual, with the factor by which it makes standard deviations grow. Tested in ``tests/test_verdict.py``.

For rows whose errors have the autocorrelation ``rho_k`` the variance of a mean is ``1 + 2 sum rho_k`` times that of white noise.
The sum is taken with the weights of Bartlett, over that of noise which decimation alone has correlated:

    g_j^2 = (1 + 2 sum_k (1 - k/K) rho_jk) / (1 + 2 sum_k (1 - k/K) rho0_k),     k = 1 .. K - 1
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..result.finding import Finding, Grade
from ..result.uncertainty import Uncertainty
from ..terms.rows import Block
from .thresholds import NEGLIGIBLE

LAGS = 20
"""Largest number of lags K (rows); at most a tenth of a joint's rows."""
FEWEST_LAGS = 3
"""Smallest number of lags for the test."""
SIGNIFICANT = 4.5
"""Standard deviations of the sum beyond which a residual is not white."""
GROWTH = 1.2
"""Smallest growth of the standard deviations by correlation that is reported, if it is significant."""


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Whiteness of each joint's residual.

    Attributes
    ----------
    growth : (n_dof,) array
        g: factor by which standard deviations for white noise are too small.
    sigmas : (n_dof,) array
        By how many of its own standard deviations the sum of correlations is beyond that of white noise.
    """

    growth: Array
    sigmas: Array

    @property
    def coloured(self) -> Array:
        """Joints whose residuals are significantly correlated, (n_dof,) of bool."""
        return np.asarray((self.sigmas > SIGNIFICANT) & (self.growth > GROWTH))


def whiteness(residual: Array, blocks: Sequence[Block], n_joints: int) -> Whiteness:
    """Return the whiteness of a residual.

    Parameters
    ----------
    residual : (n_rows,) array
        Measured less modelled torque.
    blocks : sequence of Block
        Rows of each joint in each window.
    n_joints : int
        Number of joints.
    """
    growth, sigmas = np.ones(n_joints), np.zeros(n_joints)
    for joint in range(n_joints):
        own = [block for block in blocks if block.joint == joint]
        parts = [residual[block.rows] for block in own]
        n_rows = sum(len(part) for part in parts)
        lags = min(LAGS, n_rows // 10, min((len(part) for part in parts), default=0) - 1)
        if lags < FEWEST_LAGS:
            continue
        sums = np.zeros(lags)
        for part in parts:
            sums += [float(part[: len(part) - lag] @ part[lag:]) for lag in range(lags)]
        if not sums[0] > 0.0:
            continue
        expected = np.zeros(lags)
        if own[0].correlation is not None:
            known = np.asarray(own[0].correlation)[:lags]
            expected[: len(known)] = known
        weight = 1.0 - np.arange(1, lags) / lags
        correlation, of_noise = (2.0 * float(weight @ rho[1:]) for rho in (sums / sums[0], expected))
        growth[joint] = np.sqrt(max(1.0 + correlation, 0.0) / max(1.0 + of_noise, 0.1))
        sigmas[joint] = (correlation - of_noise) / (2.0 * np.sqrt(float(weight @ weight) / n_rows))
    return Whiteness(growth, sigmas)


def whiteness_findings(
    measured: Whiteness, relative_error: Array, uncertainty: Uncertainty | None, std: Array
) -> list[Finding]:
    """Return a finding where residuals last that are not negligible.

    Parameters
    ----------
    measured : Whiteness
        Of the residual.
    relative_error : (n_dof,) array
        Error of each joint's torque over that torque.
    uncertainty, std
        How the standard deviations were found, and these, (b,): jackknife ones have grown already.
    """
    joints = np.flatnonzero(measured.coloured)
    if not len(joints):
        return []
    large = np.nan_to_num(relative_error[joints]) > NEGLIGIBLE
    joints = joints[large] if large.any() else joints
    jackknifed = uncertainty is not None and uncertainty.kind == "jackknife" and bool(std.any())
    # What is left out in blocks has the correlation of the residual: those intervals are wide enough for it.
    grade: Grade = "doubtful" if large.any() and not jackknifed else "note"
    facts: dict[str, object] = {
        "shares": relative_error[joints].tolist(),
        "growth": measured.growth[joints].tolist(),
    }
    if jackknifed and uncertainty is not None:
        white = uncertainty.std_white
        facts["jackknife"] = float(np.median(std[white > 0.0] / white[white > 0.0]))
    return [
        Finding(
            code="not-white",
            grade=grade,
            joints=tuple(int(joint) + 1 for joint in joints),
            value=float(measured.growth[joints].max()),
            effect=float(np.nanmax(relative_error[joints])),
            facts=facts,
        )
    ]
