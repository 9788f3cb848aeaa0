"""Identification of the dynamic parameters of robots from logged motion and torque.

The paper's equation numbers are used throughout: inverse dynamic model (1), regressor (2), standard
parameters (3), observation matrix (6), base parameters (7), least squares and covariance (8) to (11).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._tools.threads import set_threads
from ._tools.version import __version__ as __version__
from .errors import (
    DidimError,
    ExperimentError,
    FitError,
    IndefiniteError,
    RankError,
    RecordingError,
    RobotError,
    RobotWarning,
    ShapeError,
    SignalError,
    StudyError,
)

if TYPE_CHECKING:
    from . import formats, plot, report
    from .diagnosis.check import check
    from .diagnosis.finding import Finding, Findings
    from .excitation.clearance import Workspace
    from .excitation.design import Excitation
    from .excitation.excite import excite
    from .excitation.settings import ExcitationSettings
    from .experiment.experiment import Experiment
    from .experiment.experiment_file import load_experiment
    from .export.code.c_header import to_c
    from .export.code.latex import to_latex
    from .export.mjcf import to_mjcf
    from .export.sdf import to_sdf
    from .export.urdf import to_urdf
    from .log.recording import Recording
    from .loop.controller import Controller, Digital
    from .loop.memory import ControllerMemory
    from .loop.outcome import SimulationStatus
    from .loop.reference import Reference
    from .loop.simulation import Simulation, StepWarning, simulate
    from .methods.cloe.cloe import CLOE
    from .methods.didim.didim import DIDIM
    from .methods.ekf import EKF
    from .methods.identify import identify
    from .methods.idim_iv import IDIMIV
    from .methods.idim_ls import IDIMLS
    from .methods.maximum_likelihood import MaximumLikelihood
    from .model.dynamics import direct_dynamics, gravity, inertia_matrix, inverse_dynamics, regressor
    from .monte_carlo.results import StudyResults
    from .monte_carlo.study import study
    from .regression.consistent.bounds import Bounds
    from .regression.consistent.prior import Prior
    from .regression.consistent.solver import Consistent
    from .regression.recursive import Recursive, RecursiveEstimate
    from .regression.settings import LeastSquaresSettings
    from .result.contrast import Contrast, contrast
    from .result.identification import Identification
    from .result.status import Status
    from .robot.base_parameters import BaseParameters
    from .robot.collision import Capsule
    from .robot.friction import Friction, FrictionTerm
    from .robot.parameter_file import load_parameters
    from .robot.payload import Payload
    from .robot.robot import Robot
    from .robot.robot_file import load_robot
    from .signal.processing import SignalProcessing
    from .studies.compare import compare
    from .studies.comparison import Comparison
    from .studies.simulated_log import packaged_experiment, simulated_log
    from .studies.validation import Validation, validate

__all__ = [
    "CLOE",
    "DIDIM",
    "EKF",
    "IDIMIV",
    "IDIMLS",
    "BaseParameters",
    "Bounds",
    "Capsule",
    "Comparison",
    "Consistent",
    "Contrast",
    "Controller",
    "ControllerMemory",
    "DidimError",
    "Digital",
    "Excitation",
    "ExcitationSettings",
    "Experiment",
    "ExperimentError",
    "Finding",
    "Findings",
    "FitError",
    "Friction",
    "FrictionTerm",
    "Identification",
    "IndefiniteError",
    "LeastSquaresSettings",
    "MaximumLikelihood",
    "Payload",
    "Prior",
    "RankError",
    "Recording",
    "RecordingError",
    "Recursive",
    "RecursiveEstimate",
    "Reference",
    "Robot",
    "RobotError",
    "RobotWarning",
    "ShapeError",
    "SignalError",
    "SignalProcessing",
    "Simulation",
    "SimulationStatus",
    "Status",
    "StepWarning",
    "StudyError",
    "StudyResults",
    "Validation",
    "Workspace",
    "check",
    "compare",
    "contrast",
    "direct_dynamics",
    "excite",
    "formats",
    "gravity",
    "identify",
    "inertia_matrix",
    "inverse_dynamics",
    "load_experiment",
    "load_parameters",
    "load_robot",
    "packaged_experiment",
    "plot",
    "regressor",
    "report",
    "set_threads",
    "simulate",
    "simulated_log",
    "study",
    "to_c",
    "to_latex",
    "to_mjcf",
    "to_sdf",
    "to_urdf",
    "validate",
]


_LATER = {
    "CLOE": "methods.cloe.cloe",
    "DIDIM": "methods.didim.didim",
    "EKF": "methods.ekf",
    "IDIMIV": "methods.idim_iv",
    "IDIMLS": "methods.idim_ls",
    "BaseParameters": "robot.base_parameters",
    "Comparison": "studies.comparison",
    "Contrast": "result.contrast",
    "Capsule": "robot.collision",
    "Controller": "loop.controller",
    "ControllerMemory": "loop.memory",
    "Digital": "loop.controller",
    "Excitation": "excitation.design",
    "ExcitationSettings": "excitation.settings",
    "Experiment": "experiment.experiment",
    "Finding": "diagnosis.finding",
    "Findings": "diagnosis.finding",
    "Friction": "robot.friction",
    "FrictionTerm": "robot.friction",
    "Bounds": "regression.consistent.bounds",
    "Consistent": "regression.consistent.solver",
    "Prior": "regression.consistent.prior",
    "Identification": "result.identification",
    "LeastSquaresSettings": "regression.settings",
    "MaximumLikelihood": "methods.maximum_likelihood",
    "Payload": "robot.payload",
    "Recording": "log.recording",
    "Recursive": "regression.recursive",
    "RecursiveEstimate": "regression.recursive",
    "Reference": "loop.reference",
    "Robot": "robot.robot",
    "SignalProcessing": "signal.processing",
    "Simulation": "loop.simulation",
    "SimulationStatus": "loop.outcome",
    "Status": "result.status",
    "StepWarning": "loop.simulation",
    "StudyResults": "monte_carlo.results",
    "Validation": "studies.validation",
    "Workspace": "excitation.clearance",
    "check": "diagnosis.check",
    "compare": "studies.compare",
    "contrast": "result.contrast",
    "direct_dynamics": "model.dynamics",
    "excite": "excitation.excite",
    "gravity": "model.dynamics",
    "identify": "methods.identify",
    "inertia_matrix": "model.dynamics",
    "inverse_dynamics": "model.dynamics",
    "load_experiment": "experiment.experiment_file",
    "load_parameters": "robot.parameter_file",
    "load_robot": "robot.robot_file",
    "packaged_experiment": "studies.simulated_log",
    "regressor": "model.dynamics",
    "simulate": "loop.simulation",
    "simulated_log": "studies.simulated_log",
    "study": "monte_carlo.study",
    "to_c": "export.code.c_header",
    "to_latex": "export.code.latex",
    "to_mjcf": "export.mjcf",
    "to_sdf": "export.sdf",
    "to_urdf": "export.urdf",
    "validate": "studies.validation",
}
"""Modules of the names that are loaded when they are asked for: a program waits for the parts it uses, and for no others."""


if not TYPE_CHECKING:  # type checkers refuse names that are not above

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
