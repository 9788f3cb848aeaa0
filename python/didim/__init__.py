"""Identification of the dynamic parameters of robots from logged motion and torque.

The paper's equation numbers are used throughout: inverse dynamic model (1), regressor (2), standard
parameters (3), observation matrix (6), base parameters (7), least squares and covariance (8) to (11).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .base import BaseParameters
from .cloe import CLOE
from .compare import Comparison, compare
from .control import Controller, Digital
from .didim_method import DIDIM
from .errors import (
    DidimError,
    ExperimentError,
    FitError,
    IndefiniteError,
    RankError,
    RecordingError,
    RobotError,
    ShapeError,
    SignalError,
)
from .experiment import Experiment, load_experiment
from .identification import Identification
from .identify import identify
from .idim_ls import IDIMLS
from .least_squares import LeastSquaresSettings
from .model import direct_dynamics, inertia_matrix, inverse_dynamics, regressor
from .recording import Recording
from .reference import Reference
from .robot import Friction, Robot, load_robot
from .signals import SignalProcessing
from .simulation import Simulation, SimulationStatus, StepWarning, simulate
from .status import Status
from .validate import Validation, validate
from .version import __version__ as __version__

if TYPE_CHECKING:
    from . import formats, plot, report
    from .checking import check
    from .checks.finding import Finding, Findings

__all__ = [
    "CLOE",
    "DIDIM",
    "IDIMLS",
    "BaseParameters",
    "Comparison",
    "Controller",
    "DidimError",
    "Digital",
    "Experiment",
    "ExperimentError",
    "Finding",
    "Findings",
    "FitError",
    "Friction",
    "Identification",
    "IndefiniteError",
    "LeastSquaresSettings",
    "RankError",
    "Recording",
    "RecordingError",
    "Reference",
    "Robot",
    "RobotError",
    "ShapeError",
    "SignalError",
    "SignalProcessing",
    "Simulation",
    "SimulationStatus",
    "Status",
    "StepWarning",
    "Validation",
    "check",
    "compare",
    "direct_dynamics",
    "formats",
    "identify",
    "inertia_matrix",
    "inverse_dynamics",
    "load_experiment",
    "load_robot",
    "plot",
    "regressor",
    "report",
    "simulate",
    "validate",
]


_LATER = {
    "check": ".checking",
    "Finding": ".checks.finding",
    "Findings": ".checks.finding",
    "formats": None,
    "plot": None,
    "report": None,
}
"""What is loaded when it is asked for, so that ``import didim`` stays fast; None for a module of its own."""


def __getattr__(name: str) -> Any:
    """Load what is in `_LATER`."""
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    place = _LATER[name]
    if place is None:
        return import_module(f"{__name__}.{name}")
    return getattr(import_module(place, __name__), name)
