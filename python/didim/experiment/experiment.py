"""An experiment: a robot, its recordings, and the settings that process them. Tested in ``tests/test_experiment.py``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from .._tools.arrays import Array
from .._tools.notebook import page
from ..errors import ExperimentError
from ..log.recording import Recording
from ..loop.controller import Controller
from ..loop.reference import Reference
from ..regression.selection import dropped_names
from ..regression.settings import LeastSquaresSettings
from ..robot.payload import Payload, Pose
from ..robot.robot import Robot
from ..signal.align import DelaySettings
from ..signal.processing import SignalProcessing
from .specs import ControllerSpec, Measurement, ReferenceSpec, SimulationSettings


@dataclass(frozen=True, kw_only=True, repr=False)
class Experiment:
    """What an experiment file says; equally well made in Python, from a robot and recordings.

    Attributes
    ----------
    name
        Name in tables.
    path
        Experiment file, or None for an experiment made in Python.
    robot
        Robot, with the friction model of the experiment.
    recordings
        One or more, joint side.
    signal, least_squares, delay
        Settings.
    fixed
        Parameters kept at a value.
    dropped
        Parameters taken as zero.
    digests
        SHA-256 of each file read, by role and file name: ``experiment emps.toml``, ``robot emps.toml``,
        ``data DATA_EMPS.mat``.
    reference, controller
        What the robot followed, and what made it: as the file describes them, or as made in Python; None without.
    simulation
        How the closed loop is simulated.
    payloads
        What is known of the payloads that recordings name.
    flange
        Pose of the flange (3 x 4), as `didim.robot.payload.flange_in_last_frame` takes it; None for that of the last link.
    measurement
        What a simulated measurement adds to a simulation, or None.
    remarks
        What reading the file found to say: defaults that have changed since it was written.

    Raises
    ------
    ExperimentError
        When a recording has another number of joints than the robot.
    """

    name: str
    robot: Robot
    recordings: tuple[Recording, ...]
    path: Path | None = None
    signal: SignalProcessing = field(default_factory=lambda: SignalProcessing(cutoff_hz=None))
    least_squares: LeastSquaresSettings = field(default_factory=LeastSquaresSettings)
    delay: DelaySettings = field(default_factory=DelaySettings)
    fixed: Mapping[str, float] = field(default_factory=dict)
    dropped: tuple[str, ...] = ()
    digests: Mapping[str, str] = field(default_factory=dict)
    reference: ReferenceSpec | Reference | None = None
    controller: ControllerSpec | Controller | None = None
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    measurement: Measurement | None = None
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    flange: Pose | None = None
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        named = ", ".join(f"{item.name!r} {item.t[-1] - item.t[0]:g} s" for item in self.recordings)
        return f"<Experiment {self.name!r}: robot {self.robot.name!r}, {named or 'no recording'}>"

    def _repr_html_(self) -> str:
        head = ("recording", "role", "samples", "rate (Hz)", "length (s)", "torques", "windows")
        rows = [
            (
                item.name,
                item.role,
                str(len(item.t)),
                f"{item.rate_hz:g}",
                f"{item.t[-1] - item.t[0]:g}",
                "no" if item.tau is None else "yes",
                str(len(item.windows)),
            )
            for item in self.recordings
        ]
        return page(
            f"{self.name}: robot {self.robot.name}", [head, *rows] if rows else "", "\n".join(self.notes)
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what reading the file, the robot and the recordings changed."""
        of_recordings = (note for recording in self.recordings for note in recording.notes)
        return (*self.remarks, *self.robot.notes, *of_recordings)

    def with_gains(self, gains: Array) -> Experiment:
        """Return the experiment with torques in place of currents, by drive gains (n_dof,)."""
        return replace(self, recordings=tuple(item.with_gains(gains) for item in self.recordings))

    def __post_init__(self) -> None:
        object.__setattr__(self, "recordings", tuple(self.recordings))
        object.__setattr__(self, "dropped", dropped_names(self.dropped))
        for key in ("fixed", "digests", "payloads"):
            object.__setattr__(self, key, dict(getattr(self, key)))
        n_dof = self.robot.n_dof
        for recording in self.recordings:
            shape = recording.q.shape
            if shape[1] != n_dof:
                raise ExperimentError(
                    f"{recording.name}: q must have shape (n_samples, {n_dof}) for robot "
                    f"{self.robot.name!r}, got {shape}{'; transpose it?' if shape[0] == n_dof else ''}"
                )
