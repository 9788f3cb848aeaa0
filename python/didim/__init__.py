"""Identification of the dynamic parameters of robots from logged motion and torque.

The paper's equation numbers are used throughout: inverse dynamic model (1), regressor (2), standard
parameters (3), observation matrix (6), base parameters (7), least squares and covariance (8) to (11).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# Functions with the name of their module: loaded later, the module would take the place of the function.
from .compare import Comparison, compare
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
from .identify import identify
from .validate import Validation, validate
from .version import __version__ as __version__

if TYPE_CHECKING:
    from . import formats, plot, report
    from .base import BaseParameters
    from .checking import check
    from .checks.finding import Finding, Findings
    from .cloe import CLOE
    from .control import Controller, Digital
    from .didim_method import DIDIM
    from .experiment import Experiment, load_experiment
    from .identification import Identification
    from .idim_ls import IDIMLS
    from .least_squares import LeastSquaresSettings
    from .model import direct_dynamics, inertia_matrix, inverse_dynamics, regressor
    from .recording import Recording
    from .reference import Reference
    from .robot import Friction, Robot, load_robot
    from .signals import SignalProcessing
    from .simulation import Simulation, SimulationStatus, StepWarning, simulate
    from .status import Status

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
    "CLOE": "cloe",
    "DIDIM": "didim_method",
    "IDIMLS": "idim_ls",
    "BaseParameters": "base",
    "Controller": "control",
    "Digital": "control",
    "Experiment": "experiment",
    "Finding": "checks.finding",
    "Findings": "checks.finding",
    "Friction": "robot",
    "Identification": "identification",
    "LeastSquaresSettings": "least_squares",
    "Recording": "recording",
    "Reference": "reference",
    "Robot": "robot",
    "SignalProcessing": "signals",
    "Simulation": "simulation",
    "SimulationStatus": "simulation",
    "Status": "status",
    "StepWarning": "simulation",
    "check": "checking",
    "direct_dynamics": "model",
    "inertia_matrix": "model",
    "inverse_dynamics": "model",
    "load_experiment": "experiment",
    "load_robot": "robot",
    "regressor": "model",
    "simulate": "simulation",
}
"""Modules of the names that are loaded when they are asked for: a program waits for the parts it uses, and for no others."""


def __getattr__(name: str) -> Any:
    """Load what is in `_LATER`, or a module of the package."""
    if name in _LATER:
        value = getattr(import_module(f".{_LATER[name]}", __name__), name)
        globals()[name] = value  # found without this function the next time
        return value
    if name.isidentifier() and not name.startswith("_"):
        try:
            return import_module(f".{name}", __name__)
        except ModuleNotFoundError as reason:
            if reason.name != f"{__name__}.{name}":
                raise
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Every public name, loaded or not."""
    return sorted({*globals(), *__all__})
