"""Interface of the regressions: a solver maps a linear system (7) to a `Fit`. Tested in ``tests/test_solver.py``.

A solver is a function or a callable object: ``solve(system, settings, progress=None) -> Fit``. A method accepts its name in
`SOLVERS`, "module:object", or the solver itself: ``IDIMLS(solver=...)``, ``DIDIM(solver=...)``. A solver with settings is a
frozen dataclass with ``__call__``, which can be pickled and compared.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeGuard, runtime_checkable

from .._tools.plugins import named
from ..errors import FitError
from ..robot.robot import Robot
from ..terms.model import Model
from ..terms.rows import LinearSystem
from ..terms.unknown import Unknowns
from .fit import Fit, Progress
from .settings import LeastSquaresSettings


class Solver(Protocol):
    """Solution of (7): called with a system, the settings of least squares and a callback for each solution."""

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        """Solve a system."""


@runtime_checkable
class RobotSolver(Protocol):
    """A solver that needs the robot, such as one with physical constraints."""

    def for_robot(self, robot: Robot, selection: Unknowns) -> Solver:
        """Return the solver for the systems of a robot, whose columns are the estimated base parameters of `selection`."""


@runtime_checkable
class ModelSolver(Protocol):
    """A solver that also supports what only some logs have: payloads, own offsets and friction."""

    def for_model(self, model: Model) -> Solver:
        """Return the solver for the systems of a model."""


SolverChoice = str | Solver | RobotSolver | ModelSolver

SOLVERS: dict[str, SolverChoice] = {
    "least-squares": "didim.regression.least_squares:solve",
    "huber": "didim.regression.classical.solvers:Huber",
    "bisquare": "didim.regression.classical.solvers:Bisquare",
    "consistent": "didim.regression.consistent.solver:CONSISTENT",
}
"""Solvers by name, or their location "module:object", imported when they are used. A class has its default settings."""


def loaded_solver(choice: object) -> Solver | RobotSolver | ModelSolver:
    """Return a solver, given by name, as "module:object" or as an object.

    Raises
    ------
    FitError
        For an object that is none of these. The sentence lists the known names.
    """
    solver: Any = choice
    if isinstance(choice, str):
        solver = named(choice, SOLVERS, "solver", FitError)
        # A class means an instance with default settings.
        solver = solver() if isinstance(solver, type) else solver
    if isinstance(solver, type) or not (callable(solver) or needs_robot(solver)):
        raise FitError(f"solver must be a name or a function of a system and settings, got {choice!r}")
    made: Solver | RobotSolver | ModelSolver = solver
    return made


def needs_robot(solver: object) -> TypeGuard[RobotSolver | ModelSolver]:
    """Whether a solver must know whose parameters the columns are, as one with physical constraints does."""
    return isinstance(solver, RobotSolver | ModelSolver)


def solver_of(choice: SolverChoice, model: Model) -> Solver:
    """Return a solver, given by name or as an object, for the systems of a model.

    Raises
    ------
    FitError
        For an unknown name.
    """
    solver = loaded_solver(choice)
    if isinstance(solver, ModelSolver):
        return solver.for_model(model)
    return solver.for_robot(model.own, model.unknowns) if isinstance(solver, RobotSolver) else solver


def knows_logs(choice: SolverChoice) -> bool:
    """Whether a solver supports further parameters of logs, by its interface or because it is independent of parameters."""
    solver = loaded_solver(choice)
    return isinstance(solver, ModelSolver) or not isinstance(solver, RobotSolver)


def solver_name(choice: SolverChoice) -> str:
    """Name of a solver for the record of a result."""
    if isinstance(choice, str):
        return choice
    spec = f"{getattr(choice, '__module__', '')}:{getattr(choice, '__qualname__', '')}"
    for name, known in SOLVERS.items():
        if known is choice or known == spec:
            return name
    own = getattr(choice, "name", None)
    return own if isinstance(own, str) else getattr(choice, "__name__", type(choice).__name__)
