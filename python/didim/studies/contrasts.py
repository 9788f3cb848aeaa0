"""Contrasts of IDIM-LS, IDIM-IV and DIDIM on one log: whether the filter is wrong, or the controller.

Tested in ``tests/test_contrast.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._tools.notebook import Printed
from .._tools.saved import save_json
from ..experiment.experiment import Experiment
from ..methods.didim.didim import DIDIM
from ..methods.idim_iv import IDIMIV
from ..methods.idim_ls import IDIMLS
from ..result.contrast import Contrast, contrast, reading
from ..result.identification import Identification
from .compare import identified


@dataclass(frozen=True, eq=False, repr=False)
class Contrasts(Printed):
    """Three estimates of one log, and their contrasts.

    Attributes
    ----------
    experiment : str
        Name of the experiment.
    fits : mapping of str to Identification
        Results by method.
    contrasts : tuple of Contrast
        IDIM-IV less IDIM-LS, and DIDIM less IDIM-IV.
    """

    experiment: str
    fits: Mapping[str, Identification]
    contrasts: tuple[Contrast, ...]

    @property
    def reading(self) -> str:
        """Return the joint conclusion of the contrasts."""
        return reading(self.contrasts)

    def __str__(self) -> str:
        lines = [f"{self.experiment}: contrasts of three estimates", ""]
        lines += [f"- {each}" for each in self.contrasts]
        failed = [f"{name}: {fit.status.value}" for name, fit in self.fits.items() if not fit.converged]
        return "\n".join([*lines, *failed, "", f"{self.reading[0].upper()}{self.reading[1:]}."])

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``didim compare --contrast --json``."""
        return {
            "schema": 1,
            "experiment": self.experiment,
            "reading": self.reading,
            "contrasts": [each.to_dict() for each in self.contrasts],
            "methods": {name: fit.to_dict() for name, fit in self.fits.items()},
        }

    def save(self, path: str | Path) -> None:
        """Write the JSON of `to_dict`, whole or not at all."""
        save_json(
            path, self.to_dict(), {digest for fit in self.fits.values() for digest in fit.digests.values()}
        )


def contrasts_of(log: Experiment, *, verbose: bool | None = None) -> Contrasts:
    """Identify a log by IDIM-LS, IDIM-IV and DIDIM, and contrast the estimates.

    Parameters
    ----------
    log : Experiment
        Experiment with recordings, a reference and a controller.
    verbose : bool, optional
        As for `compare`.

    Raises
    ------
    DidimError
        Any of its subclasses, as for the methods.
    """
    methods = (
        IDIMLS(uncertainty="jackknife"),
        IDIMIV(uncertainty="jackknife"),
        DIDIM(physical=False, uncertainty="jackknife"),
    )
    fits = {method.name: identified(method.name, log, method, verbose=verbose) for method in methods}
    pairs = [("idim-ls", "idim-iv"), ("idim-iv", "didim")]
    known = [pair for pair in pairs if all(fits[name].uncertainty is not None for name in pair)]
    return Contrasts(log.name, fits, tuple(contrast(fits[first], fits[second]) for first, second in known))
