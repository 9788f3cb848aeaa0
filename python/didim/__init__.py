"""Identification of the dynamic parameters of robots from logged motion and torque.

The paper's equation numbers are used throughout: inverse dynamic model (1), regressor (2), standard
parameters (3), observation matrix (6), base parameters (7), least squares and covariance (8) to (11).
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._tools.threads import set_threads
from ._tools.version import __version__ as __version__
from .errors import DidimError

if TYPE_CHECKING:
    from . import formats, plot, report
    from .contrib.ekf import EKF
    from .contrib.maximum_likelihood import MaximumLikelihood
    from .diagnosis.check import check
    from .diagnosis.finding import Findings
    from .errors import (
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
    from .excitation import Capsule, ExcitationSettings, Workspace
    from .excitation.design import Excitation
    from .excitation.excite import excite
    from .experiment.experiment import Experiment
    from .experiment.experiment_file import load_experiment
    from .export import to_c, to_latex, to_mjcf, to_sdf, to_urdf
    from .log.recording import Recording
    from .loop import ControllerMemory, Digital, SimulationStatus, StepWarning
    from .loop.controller import Controller
    from .loop.reference import Reference
    from .loop.simulation import Simulation, simulate
    from .methods.cloe.cloe import CLOE
    from .methods.didim.didim import DIDIM
    from .methods.identify import identify
    from .methods.idim_iv import IDIMIV
    from .methods.idim_ls import IDIMLS
    from .model.dynamics import direct_dynamics, gravity, inertia_matrix, inverse_dynamics, regressor
    from .monte_carlo.results import StudyResults
    from .monte_carlo.study import study
    from .regression.recursive import Recursive
    from .result.contrast import Contrast, contrast
    from .result.finding import Finding
    from .result.identification import Identification
    from .result.iteration import Iteration
    from .result.status import Status
    from .result.verdict import Reason, Verdict
    from .robot import BaseParameters, Friction
    from .robot.friction import FrictionTerm
    from .robot.parameter_file import load_parameters
    from .robot.payload import Payload
    from .robot.robot import Robot
    from .robot.robot_file import load_robot
    from .signal.processing import SignalProcessing
    from .solvers import Bounds, Consistent, LeastSquaresSettings, Prior, RecursiveEstimate
    from .studies.compare import compare
    from .studies.comparison import Comparison
    from .studies.loads.payload import identify_payload
    from .studies.loads.residual import residual_torques
    from .studies.simulated_log import packaged_experiment, simulated_log
    from .studies.validation import Validation, validate

__all__ = [
    "CLOE",
    "DIDIM",
    "IDIMIV",
    "IDIMLS",
    "Comparison",
    "Controller",
    "DidimError",
    "Excitation",
    "Experiment",
    "FrictionTerm",
    "Identification",
    "Iteration",
    "Payload",
    "Reason",
    "Recording",
    "Recursive",
    "Reference",
    "Robot",
    "SignalProcessing",
    "Simulation",
    "Status",
    "StudyResults",
    "Validation",
    "Verdict",
    "check",
    "compare",
    "contrast",
    "direct_dynamics",
    "excite",
    "gravity",
    "identify",
    "identify_payload",
    "inertia_matrix",
    "inverse_dynamics",
    "load_experiment",
    "load_parameters",
    "load_robot",
    "packaged_experiment",
    "regressor",
    "residual_torques",
    "set_threads",
    "simulate",
    "simulated_log",
    "study",
    "validate",
]
if TYPE_CHECKING:  # modules, and the names of 0.2.0, which `__getattr__` loads
    __all__ += [
        "EKF",
        "BaseParameters",
        "Bounds",
        "Capsule",
        "Consistent",
        "Contrast",
        "ControllerMemory",
        "Digital",
        "ExcitationSettings",
        "ExperimentError",
        "Finding",
        "Findings",
        "FitError",
        "Friction",
        "IndefiniteError",
        "LeastSquaresSettings",
        "MaximumLikelihood",
        "Prior",
        "RankError",
        "RecordingError",
        "RecursiveEstimate",
        "RobotError",
        "RobotWarning",
        "ShapeError",
        "SignalError",
        "SimulationStatus",
        "StepWarning",
        "StudyError",
        "Workspace",
        "formats",
        "plot",
        "report",
        "to_c",
        "to_latex",
        "to_mjcf",
        "to_sdf",
        "to_urdf",
    ]


_LATER = {
    "CLOE": "methods.cloe.cloe",
    "DIDIM": "methods.didim.didim",
    "IDIMIV": "methods.idim_iv",
    "IDIMLS": "methods.idim_ls",
    "Recursive": "regression.recursive",
    "Comparison": "studies.comparison",
    "Controller": "loop.controller",
    "Excitation": "excitation.design",
    "Experiment": "experiment.experiment",
    "FrictionTerm": "robot.friction",
    "Identification": "result.identification",
    "Iteration": "result.iteration",
    "Payload": "robot.payload",
    "Reason": "result.verdict",
    "Recording": "log.recording",
    "Reference": "loop.reference",
    "Robot": "robot.robot",
    "SignalProcessing": "signal.processing",
    "Simulation": "loop.simulation",
    "Status": "result.status",
    "StudyResults": "monte_carlo.results",
    "Validation": "studies.validation",
    "Verdict": "result.verdict",
    "check": "diagnosis.check",
    "compare": "studies.compare",
    "contrast": "result.contrast",
    "direct_dynamics": "model.dynamics",
    "excite": "excitation.excite",
    "gravity": "model.dynamics",
    "identify": "methods.identify",
    "identify_payload": "studies.loads.payload",
    "inertia_matrix": "model.dynamics",
    "inverse_dynamics": "model.dynamics",
    "load_experiment": "experiment.experiment_file",
    "load_parameters": "robot.parameter_file",
    "load_robot": "robot.robot_file",
    "packaged_experiment": "studies.simulated_log",
    "regressor": "model.dynamics",
    "residual_torques": "studies.loads.residual",
    "simulate": "loop.simulation",
    "simulated_log": "studies.simulated_log",
    "study": "monte_carlo.study",
    "validate": "studies.validation",
}
"""Modules of the names that are imported on first use, so that a program waits only for the parts it uses."""
_MOVED = {
    "ExperimentError": "errors",
    "FitError": "errors",
    "IndefiniteError": "errors",
    "RankError": "errors",
    "RecordingError": "errors",
    "RobotError": "errors",
    "RobotWarning": "errors",
    "ShapeError": "errors",
    "SignalError": "errors",
    "StudyError": "errors",
    "Bounds": "solvers",
    "Consistent": "solvers",
    "LeastSquaresSettings": "solvers",
    "Prior": "solvers",
    "RecursiveEstimate": "solvers",
    "to_c": "export",
    "to_latex": "export",
    "to_mjcf": "export",
    "to_sdf": "export",
    "to_urdf": "export",
    "Capsule": "excitation",
    "ExcitationSettings": "excitation",
    "Workspace": "excitation",
    "ControllerMemory": "loop",
    "Digital": "loop",
    "SimulationStatus": "loop",
    "StepWarning": "loop",
    "BaseParameters": "robot",
    "Friction": "robot",
    "Contrast": "result.contrast",
    "Finding": "result.finding",
    "Findings": "diagnosis.finding",
    "EKF": "contrib.ekf",
    "MaximumLikelihood": "contrib.maximum_likelihood",
}
"""Modules of public names of 0.2.0 that are no longer public: they work in this version with a `DeprecationWarning`."""


if not TYPE_CHECKING:  # type checkers reject names that are not imported above

    def __getattr__(name: str) -> Any:
        """Load what is in `_LATER`, or a module of the package."""
        if name in _LATER:
            value = getattr(import_module(f".{_LATER[name]}", __name__), name)
            globals()[name] = value  # next time found without this function
            return value
        if name in _MOVED:
            place = f"{__name__}.{_MOVED[name]}"
            text = f"didim.{name} is {place}.{name} now; the short name goes with the next version"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            return getattr(import_module(place), name)
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
