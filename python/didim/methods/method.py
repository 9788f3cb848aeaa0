"""Interface and common settings of methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, Protocol, Self

from ..errors import FitError
from ..experiment.experiment import Experiment
from ..regression.settings import LeastSquaresSettings, UncertaintyKind, Variance, Weights
from ..regression.solver import SolverChoice, knows_logs, loaded_solver, needs_robot, solver_of
from ..result.identification import Identification
from ..result.iteration import Reporter
from ..robot.robot import Robot
from ..signal.processing import SignalProcessing
from ..signal.window import DelaySettings
from ..terms.base import dropped_names
from ..terms.build import model_of
from ..terms.model import Model
from .job import Delay, Job

Motion = Literal["measured", "simulated"]
"""Motion along which torques are predicted: the filtered measured motion or that of the simulated closed loop."""


class Described(Protocol):
    """Description of a method in a result."""

    @property
    def name(self) -> str:
        """Name on the command line and in results."""

    @property
    def motion(self) -> Motion:
        """Motion along which the method predicts torques."""

    @property
    def raw(self) -> bool:
        """Whether the method compares simulated torques sample by sample, without the filters of (6)."""


class Method(Described, Protocol):
    """Interface of a method; a new one only needs this and a row in `table.METHODS`, or is named "module:Class"."""

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        """Identify the parameters of an experiment's robot.

        Parameters
        ----------
        experiment : Experiment
            Robot, recordings and settings.
        reporter : Reporter
            Receiver of iterations and of sentences on the progress; it can stop the run.

        Returns
        -------
        Identification
            Result, with ``elapsed`` still zero.

        Raises
        ------
        DidimError
            Any of its subclasses, for a log or settings without an estimate: for a simulated loop without reference or
            controller, or for a start that cannot be simulated.
        """


@dataclass(frozen=True, kw_only=True)
class MethodSettings:
    """Settings of all methods; None stands for the setting of the experiment.

    Parameters
    ----------
    variance : {"r-b", "r-1"}, optional
        Divisor of (9), as in `LeastSquaresSettings`.
    uncertainty : {"jackknife", "decimated", "white"}, optional
        Source of the standard deviations, as in `LeastSquaresSettings`.
    blocks : int, optional
        Number of time blocks of the jackknife.
    signal : SignalProcessing, optional
        Filters, trimming and decimation.
    compensate_samples : float, sequence of float, "hold", "estimate" or Delay, optional
        Compensation of the torque delay, as in `DelaySettings`; or the delay of another run.
    fixed : mapping of str to float, optional
        Known base parameters.
    dropped : sequence of str, optional
        Base parameters taken as zero.
    friction : {"auto"}, optional
        Choose friction terms by their error on held-out blocks, beside those of the experiment (docs/friction.md).
    """

    motion: ClassVar[Motion] = "measured"
    raw: ClassVar[bool] = False
    estimates_gains: ClassVar[bool] = False

    variance: Variance | None = None
    uncertainty: UncertaintyKind | None = None
    blocks: int | None = None
    signal: SignalProcessing | None = None
    compensate_samples: float | Sequence[float] | Literal["hold", "estimate"] | Delay | None = None
    fixed: Mapping[str, float] | None = None
    dropped: Sequence[str] | None = None
    friction: Literal["auto"] | None = None

    def __post_init__(self) -> None:
        if self.friction not in (None, "auto"):
            raise FitError(f"friction must be 'auto' or None, got {self.friction!r}")
        # Wrong values are reported at once, not after reading large files.
        self.least_squares(LeastSquaresSettings())
        if self.compensate_samples is not None and not isinstance(self.compensate_samples, Delay):
            setting = DelaySettings(compensate_samples=self.compensate_samples).compensate_samples
            object.__setattr__(self, "compensate_samples", setting)
        if self.dropped is not None:
            object.__setattr__(self, "dropped", dropped_names(self.dropped))

    @property
    def shared(self) -> dict[str, Any]:
        """Settings of all methods by name, but the choice of friction terms, which a run makes once."""
        names = {setting.name for setting in fields(MethodSettings)} - {"friction"}
        return {name: getattr(self, name) for name in names}

    def least_squares(self, default: LeastSquaresSettings) -> LeastSquaresSettings:
        """Return the settings of least squares, with those of an experiment as defaults."""
        given = {key: getattr(self, key, None) for key in LeastSquaresSettings.__dataclass_fields__}
        return replace(default, **{key: value for key, value in given.items() if value is not None})

    def chosen_solver(self) -> SolverChoice:
        """Return the solver of (7)."""
        return "least-squares"

    def job(self, experiment: Experiment, robot: Robot | None = None) -> Job:
        """Return the experiment with the settings of this run; `robot` for other friction than the experiment's."""
        fixed = dict(experiment.fixed if self.fixed is None else self.fixed)
        dropped = experiment.dropped if self.dropped is None else dropped_names(self.dropped)
        robot = robot or experiment.robot
        # In a simulation smooth friction holds a joint at rest, so a standstill torque has no column.
        resting = robot.friction.of("rest")
        silent = [term.parameter for term in resting if robot.friction.dead_zone[term.joint] == 0.0]
        dropped = (*dropped, *(name for name in silent if name not in dropped and name not in fixed))
        delay = experiment.delay.compensate_samples
        model = self.model(experiment, robot).choosing(fixed, dropped)
        return Job(
            experiment=experiment,
            model=model,
            signal=experiment.signal if self.signal is None else self.signal,
            settings=self.least_squares(experiment.least_squares),
            delay_setting=delay if self.compensate_samples is None else self.compensate_samples,
            solver_choice=self.chosen_solver(),
            solver=solver_of(self.chosen_solver(), model),
        )

    def model(self, experiment: Experiment, robot: Robot) -> Model:
        """Return the model of the robot in the logs of an experiment.

        Raises
        ------
        FitError
            For logs that the method, its solver or the friction does not support.
        """
        model = model_of(robot, experiment.recordings, experiment.payloads, experiment.flange)
        if model.n_gains and not self.estimates_gains:
            raise FitError(
                f"experiment '{experiment.name}' has currents whose drive gains are unknown: identify them by idim-ls, "
                "idim-iv or didim, and write them into the file as gain = [...]"
            )
        if model.simple:
            return model
        choice = self.chosen_solver()
        if model.n_gains and needs_robot(loaded_solver(choice)):
            raise FitError(
                "a physically consistent solution needs torques, and recordings have currents whose drive gains are unknown: "
                "identify without it, then take fit.consistent()"
            )
        if not knows_logs(choice):
            raise FitError(
                "this solver only supports robots, and recordings have payloads, own offsets or own friction: identify without "
                "it, or write its `for_model`"
            )
        friction = robot.friction
        if model.n_gains and (friction.has_load or friction.open or self.friction == "auto"):
            raise FitError(
                "load friction, velocities of laws and the choice of terms need torques, and recordings have currents whose "
                "drive gains are unknown: identify the laws with known gains"
            )
        return model


@dataclass(frozen=True, kw_only=True)
class FitSettings(MethodSettings):
    """Settings of the methods that solve (7), in addition to those of `MethodSettings`.

    Parameters
    ----------
    solver : str or solver, optional
        Solver of (7): a name of `didim.regression.solver.SOLVERS`, or a function ``solve(system, settings, progress)``; by
        default according to `physical`.
    physical : bool, optional
        Solve (7) with physical constraints: the solver "consistent" with its default settings. False for plain least squares.
        The default is the better choice for the method: True for DIDIM and False for IDIM-LS and IDIM-IV.
    weights, reweightings : optional
        As in `LeastSquaresSettings`.
    """

    physical_by_default: ClassVar[bool] = False

    solver: SolverChoice | None = None
    physical: bool | None = None
    weights: Weights | None = None
    reweightings: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.solver is not None:
            loaded_solver(self.solver)
        if not isinstance(self.physical, bool | None):
            raise FitError(f"physical must be True or False, got {self.physical!r}")
        if self.physical is not None and self.solver is not None:
            raise FitError(
                "physical=True is the solver 'consistent' and physical=False the solver 'least-squares': give physical or "
                "solver, not both"
            )

    def chosen_solver(self) -> SolverChoice:
        """Return the solver of (7)."""
        if self.solver is not None:
            return self.solver
        physical = self.physical_by_default if self.physical is None else self.physical
        return "consistent" if physical else "least-squares"

    def for_logs(self, experiment: Experiment) -> Self:
        """Return the settings with the solver of (7) that the logs ask for, where none is given.

        Laws that are chosen from a log are chosen under the conditions of a robot: without these, laws and links explain
        each other's torque. Unknown drive gains are estimated by plain least squares.
        """
        if self.solver is not None or self.physical is not None:
            return self
        physical = experiment.least_squares.physical
        if physical is None:
            chosen = self.friction == "auto" or experiment.robot.friction.auto
            known = all(recording.drives is None for recording in experiment.recordings)
            physical = known and (self.physical_by_default or chosen)
        return self if physical == self.physical_by_default else replace(self, physical=physical)
