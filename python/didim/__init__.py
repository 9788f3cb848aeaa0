"""Identification of the dynamic parameters of robots from logged motion and torque.

The paper's equation numbers are used throughout: inverse dynamic model (1), regressor (2), standard
parameters (3), observation matrix (6), base parameters (7), least squares and covariance (8) to (11).
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._tools.threads import set_threads as set_threads
from ._tools.version import __version__ as __version__
from .errors import DidimError as DidimError

if TYPE_CHECKING:  # for type checkers, the names that `__getattr__` loads
    from . import diagnosis as diagnosis
    from . import errors as errors
    from . import excitation as excitation
    from . import export as export
    from . import formats as formats
    from . import loop as loop
    from . import plot as plot
    from . import report as report
    from . import robot as robot
    from . import solvers as solvers
    from .diagnosis.check import check as check
    from .excitation.design import Excitation as Excitation
    from .excitation.excite import excite as excite
    from .experiment.experiment import Experiment as Experiment
    from .experiment.experiment_file import load_experiment as load_experiment
    from .experiment.loop import windows as windows
    from .log.recording import Recording as Recording
    from .loop.controller import Controller as Controller
    from .loop.reference import Reference as Reference
    from .loop.simulation import Simulation as Simulation
    from .loop.simulation import simulate as simulate
    from .methods.cloe.cloe import CLOE as CLOE
    from .methods.didim.didim import DIDIM as DIDIM
    from .methods.identify import identify as identify
    from .methods.identify import rows as rows
    from .methods.idim_iv import IDIMIV as IDIMIV
    from .methods.idim_ls import IDIMLS as IDIMLS
    from .model.dynamics import direct_dynamics as direct_dynamics
    from .model.dynamics import gravity as gravity
    from .model.dynamics import inertia_matrix as inertia_matrix
    from .model.dynamics import inverse_dynamics as inverse_dynamics
    from .model.dynamics import regressor as regressor
    from .monte_carlo.results import StudyResults as StudyResults
    from .monte_carlo.study import study as study
    from .regression.recursive import Recursive as Recursive
    from .result.contrast import contrast as contrast
    from .result.identification import Identification as Identification
    from .result.iteration import Iteration as Iteration
    from .result.iteration import Status as Status
    from .result.verdict import Reason as Reason
    from .result.verdict import Verdict as Verdict
    from .robot.friction import FrictionTerm as FrictionTerm
    from .robot.parameter_file import load_parameters as load_parameters
    from .robot.payload import Payload as Payload
    from .robot.robot import Robot as Robot
    from .robot.robot_file import load_robot as load_robot
    from .signal.processing import SignalProcessing as SignalProcessing
    from .studies.compare import compare as compare
    from .studies.comparison import Comparison as Comparison
    from .studies.loads.payload import identify_payload as identify_payload
    from .studies.loads.residual import residual_torques as residual_torques
    from .studies.simulated_log import packaged_experiment as packaged_experiment
    from .studies.simulated_log import simulated_log as simulated_log
    from .studies.validation import Validation as Validation
    from .studies.validation import validate as validate


def _by_name(places: dict[str, str]) -> dict[str, str]:
    """Return the module of each name, given the names of each module."""
    return {name: module for module, names in places.items() for name in names.split()}


_LATER = _by_name(
    {
        "diagnosis.check": "check",
        "excitation.design": "Excitation",
        "excitation.excite": "excite",
        "experiment.experiment": "Experiment",
        "experiment.experiment_file": "load_experiment",
        "experiment.loop": "windows",
        "log.recording": "Recording",
        "loop.controller": "Controller",
        "loop.reference": "Reference",
        "loop.simulation": "Simulation simulate",
        "methods.cloe.cloe": "CLOE",
        "methods.didim.didim": "DIDIM",
        "methods.identify": "identify rows",
        "methods.idim_iv": "IDIMIV",
        "methods.idim_ls": "IDIMLS",
        "model.dynamics": "direct_dynamics gravity inertia_matrix inverse_dynamics regressor",
        "monte_carlo.results": "StudyResults",
        "monte_carlo.study": "study",
        "regression.recursive": "Recursive",
        "result.contrast": "contrast",
        "result.identification": "Identification",
        "result.iteration": "Iteration Status",
        "result.verdict": "Reason Verdict",
        "robot.friction": "FrictionTerm",
        "robot.parameter_file": "load_parameters",
        "robot.payload": "Payload",
        "robot.robot": "Robot",
        "robot.robot_file": "load_robot",
        "signal.processing": "SignalProcessing",
        "studies.compare": "compare",
        "studies.comparison": "Comparison",
        "studies.loads.payload": "identify_payload",
        "studies.loads.residual": "residual_torques",
        "studies.simulated_log": "packaged_experiment simulated_log",
        "studies.validation": "Validation validate",
    }
)
"""Modules of the names that are imported on first use, so that a program waits only for the parts it uses."""
_MOVED = _by_name(
    {
        "diagnosis.finding": "Findings",
        "errors": "ExperimentError FitError IndefiniteError RankError RecordingError RobotError "
        "RobotWarning ShapeError SignalError StudyError",
        "excitation": "Capsule ExcitationSettings Workspace",
        "export": "to_c to_latex to_mjcf to_sdf to_urdf",
        "loop": "ControllerMemory Digital SimulationStatus StepWarning",
        "result.contrast": "Contrast",
        "result.finding": "Finding",
        "robot": "BaseParameters Friction",
        "solvers": "Bounds Consistent LeastSquaresSettings Prior RecursiveEstimate",
    }
)
"""Modules of public names of 0.2.0 that are no longer public: they work in this version with a `DeprecationWarning`."""
__all__ = ["DidimError", "set_threads", *_LATER]


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
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
