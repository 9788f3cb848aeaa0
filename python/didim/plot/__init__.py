"""Pictures of results: every function returns a matplotlib Figure without displaying it.

    figure = didim.plot.torques(fit, experiment)
    figure.savefig("torques.pdf")

matplotlib is the extra ``plot`` of the package: ``pip install didim[plot]``. No function changes the state of pyplot. Units are
SI, on the joint side. Tested in ``tests/test_plot.py``.
"""

from __future__ import annotations

from .estimates import convergence, correlation, parameters
from .external import external
from .friction import friction
from .logs import overlay, residuals, torques
from .motion import motion, spectra
from .positions import positions
from .skeleton import robot
from .style import require, svg

__all__ = [
    "convergence", "correlation", "external", "friction", "motion", "overlay", "parameters",
    "positions", "require", "residuals", "robot", "spectra", "svg", "torques",
]  # fmt: skip
