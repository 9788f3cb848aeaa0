"""Settings of a design. Tested in ``tests/test_excitation.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from .._tools.keys import declared
from .._tools.settings import check_declared, positive
from ..errors import ExcitationError
from ..experiment.experiment import Experiment
from ..result.identification import Identification
from ..robot.collision import Capsule
from .clearance import Workspace
from .criterion import Name

Values = float | Sequence[float] | None
"""A limit or a noise: of all joints, or of each."""
Prior = Identification | Experiment | str | Path
"""Earlier information: a result (its covariance), or an experiment (its recordings); as objects or as files."""

MOST_SAMPLES = 2_000_000
"""Largest number of samples of a designed motion: an hour at 500 Hz. Tables of more do not fit memory."""
MOST_SMOOTHING = 100.0
"""Largest smoothing velocity of friction (rad/s or m/s): beyond it friction, and with it its base parameters, is lost in
rounding."""


@dataclass(frozen=True, kw_only=True)
class ExcitationSettings:
    """Settings of a design, joint side, SI units.

    For None the robot file gives the value, or there is no limit.

    Tested in ``tests/test_excitation.py``.

    Attributes
    ----------
    kind : {"fourier", "point-to-point"}
        Fourier series, or moves from point to point with trapezoidal velocity.
    duration_s : float
        Period of the series (s). Moves from point to point are compared as if repeated for this time.
    harmonics : int
        Harmonics of the series, at least 4.
    points : int
        Points of a motion from point to point.
    dwell_s : float
        Rest at each point (s).
    seed, starts : int
        Number of searches, and the seed of their random motions and perturbations.
    iterations : int
        Length of a start, which evaluates about four times as many motions, most of them on a coarse grid.
    threads : int, optional
        Number of threads for the starts; by default that of the machine. The result does not depend on it.
    criterion : {"information", "condition"}
        Log determinant of the information (D-optimality), or condition number of W.
    wanted : sequence of str
        Base parameters of interest (D_s-optimality); all by default.
    start : (n_dof,) sequence or None
        Position at the start and the end (rad or m); chosen by the optimiser by default.
    home : (n_dof,) sequence or None
        Position of the robot before and after: the motion gets ramps from there and back.
    periods : int
        Repetitions of the series.
    rate_hz : float
        Samples per second of the exported motion: the controller's.
    log_rate_hz : float, optional
        Samples per second of the log; `rate_hz` by default.
    torque_noise : float or sequence of float, optional
        Standard deviation of the torques' noise at each logged sample (N.m or N).
    noise_of : Experiment or path, optional
        Earlier experiment whose residuals determine the noise instead.
    margin : float
        Share of every limit that the motion may use.
    position : sequence of (float, float), optional
        Lowest and highest positions.
    velocity, acceleration, jerk, torque : float or sequence of float, optional
        Largest absolute values.
    parameters : array, str, Identification or None
        Standard parameters for the torques: a vector, a set of the robot, a file. By default the set ``urdf``, if there is one.
    prior : sequence
        Earlier information.
    friction : mapping
        Keys of a table ``[friction]``: the model whose parameters are to be identified; that of the robot by default.
    smoothing : float
        Velocity of the tanh that replaces the sign of the velocity during the optimisation (rad/s or m/s).
    capsules : sequence of Capsule
        Links as capsules, in addition to those of the robot file.
    workspace : Workspace
        Walls, floor and clearance.

    Raises
    ------
    ExcitationError
        For a value that is out of range.
    """

    kind: str = "fourier"
    duration_s: float = 10.0
    harmonics: int = 20
    points: int = 20
    dwell_s: float = 0.2
    seed: int = 0
    starts: int = 2
    iterations: int = 500
    threads: int | None = None
    criterion: Name = "information"
    wanted: Sequence[str] = ()
    start: Sequence[float] | None = None
    home: Sequence[float] | None = None
    periods: int = 1
    rate_hz: float = 500.0
    log_rate_hz: float | None = None
    torque_noise: Values = None
    noise_of: Experiment | str | Path | None = None
    margin: float = 0.9
    position: Sequence[Sequence[float]] | None = None
    velocity: Values = None
    acceleration: Values = None
    jerk: Values = None
    torque: Values = None
    parameters: ArrayLike | str | Identification | None = None
    prior: Sequence[Prior] = ()
    friction: Mapping[str, Any] = field(default_factory=dict)
    smoothing: float = 0.05
    capsules: Sequence[Capsule] = ()
    workspace: Workspace = field(default_factory=Workspace)

    def __post_init__(self) -> None:
        check_declared(self, declared("excitation", "excitation"), ExcitationError)
        positive("smoothing", self.smoothing, ExcitationError)
        if self.smoothing > MOST_SMOOTHING:
            raise ExcitationError(
                f"smoothing must be at most {MOST_SMOOTHING:g} rad/s or m/s, or friction vanishes, got {self.smoothing!r}"
            )
        if self.kind == "fourier":
            sample_count(self.duration_s * self.periods, max(self.rate_hz, self.log_rate_hz or 0.0))
        if not 0.0 <= self.dwell_s < float("inf"):
            raise ExcitationError(f"dwell_s must not be negative, got {self.dwell_s!r}")
        if self.wanted and self.criterion == "condition":
            raise ExcitationError(
                "the condition number is one of all parameters: leave out the names of wanted ones"
            )


def sample_count(seconds: float, rate_hz: float) -> int:
    """Return how many samples a motion has, rounded.

    Raises
    ------
    ExcitationError
        For more than `MOST_SAMPLES` (``test_excitation.py``).
    """
    if seconds * rate_hz > MOST_SAMPLES:
        raise ExcitationError(
            f"{seconds:g} s at {rate_hz:g} Hz are {seconds * rate_hz:.3g} samples, where at most {MOST_SAMPLES:g} are designed: "
            "shorten the motion, or lower rate_hz"
        )
    return round(seconds * rate_hz)
