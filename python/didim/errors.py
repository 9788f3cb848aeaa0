"""Named errors: each message is one sentence that says which file, column, joint, sample or key is meant."""

from __future__ import annotations


class DidimError(ValueError):
    """Base of every error that a wrong call or a wrong file raises."""


class RobotError(DidimError):
    """A robot file or description that is not a robot."""


class RecordingError(DidimError):
    """A data file that cannot be read as the experiment describes it."""


class ExperimentError(DidimError):
    """An experiment file with a wrong key, value or combination."""


class ShapeError(DidimError):
    """An array of the wrong shape, type or content."""


class SignalError(DidimError):
    """Signal processing that the record does not allow."""


class RankError(DidimError):
    """A log that does not identify some parameters; the message names them.

    Attributes
    ----------
    columns : tuple of int
        Columns of the observation matrix that depend on others, from 0.
    """

    def __init__(self, message: str, columns: tuple[int, ...] = ()) -> None:
        super().__init__(message)
        self.columns = columns


class IndefiniteError(DidimError):
    """Parameters with which M(q) is not positive definite, as for no real robot."""


class FitError(DidimError):
    """A request on a fit that cannot be met, such as an unknown parameter name."""


class ReferenceError(DidimError):
    """A reference motion that cannot be followed."""


class ExcitationError(DidimError):
    """A motion that cannot be designed: limits without room, or settings that contradict each other."""


class ControllerError(DidimError):
    """Invalid controller."""


class SimulationError(DidimError):
    """A simulation whose parts do not fit together."""


class StudyError(DidimError):
    """A study that cannot be run: a wrong key, other rows, or failing workers."""


class ExampleError(DidimError):
    """An example that does not exist, or a folder that already has its files."""


class OutputError(DidimError):
    """An output that is also an input: writing it would destroy the input."""


class ThreadsError(DidimError):
    """Invalid number of threads."""


class InstructionSetError(DidimError):
    """A set of instructions that the processor does not have, or an unknown name of one."""


class PlotError(DidimError):
    """A picture that cannot be drawn: matplotlib is missing, or there is nothing to draw."""


class RobotWarning(UserWarning):
    """A robot file that is probably not as intended."""


class CoreErrorsAs:
    """Context in which a wrong argument of the numerical core is an error of this package, with the core's sentence.

    Parameters
    ----------
    error : type of DidimError
        Class of the error to raise.
    """

    def __init__(self, error: type[DidimError]) -> None:
        self._error = error

    def __enter__(self) -> None:
        """Begin the context."""

    def __exit__(self, kind: object, reason: object, traceback: object) -> None:
        """Raise the core's `ValueError` as the error of this package."""
        if isinstance(reason, ValueError):
            raise self._error(str(reason)) from None
