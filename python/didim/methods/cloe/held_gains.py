"""CLOE with currents, and drive gains fixed at those of IDIM-LS. Tested in ``tests/test_drive_gains.py``.

Positions say nothing of drive gains, and CLOE compares no currents, so the gains are those of the rows along the measured motion.
What CLOE estimates does not depend on them: its covariance and theirs stand side by side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...errors import FitError
from ...experiment.experiment import Experiment
from ...result.further import Further
from ...result.identification import Identification
from ...result.iteration import Reporter
from ..idim_ls import direct_estimate
from .settings import CLOESettings

Run = Callable[[Experiment, Reporter], Identification]
"""A run of CLOE on an experiment with torques."""


def run_with_held_gains(
    method: CLOESettings, run: Run, experiment: Experiment, reporter: Reporter
) -> Identification:
    """Identify the drive gains by IDIM-LS, and the other parameters by CLOE with the resulting torques.

    Raises
    ------
    FitError
        For an output with torques, whose errors would depend on the gains.
    """
    if method.output != "position":
        raise FitError(
            f"output {method.output!r} compares torques, but experiment '{experiment.name}' has currents: use output "
            "'position', or identify the drive gains by didim and give them as gain = [...]"
        )
    direct = direct_estimate(method, experiment, reporter)
    known = direct.further
    assert known is not None
    assert known.gains is not None
    fit = run(experiment.with_gains(known.gains), reporter)
    return replace(
        fit,
        further=_with_gains(fit, known),
        remarks=(
            *fit.remarks,
            "positions do not identify drive gains: these are the gains of IDIM-LS, with its standard deviations",
        ),
    )


def _with_gains(fit: Identification, direct: Further) -> Further:
    """Return the further parameters of a result followed by the drive gains of another one."""
    part = direct.part("gain")
    own = fit.further
    covariance = fit.covariance if own is None else own.covariance
    n = part.stop - part.start
    whole = np.zeros((len(covariance) + n,) * 2)
    whole[:-n, :-n], whole[-n:, -n:] = covariance, direct.covariance_of(part)
    blocks = tuple(block for block in direct.blocks if block.kind == "gain")
    if own is None:
        return Further(
            blocks=blocks, values=direct.values[part], covariance=whole, std_white=direct.std_white[part]
        )
    return replace(
        own,
        blocks=(*own.blocks, *blocks),
        values=np.concatenate([own.values, direct.values[part]]),
        covariance=whole,
        std_white=np.concatenate([own.std_white, direct.std_white[part]]),
    )
