"""An experiment: a robot, its recordings, and the settings that process them. Tested in ``tests/test_experiment.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from numpy.typing import ArrayLike

from .._tools.arrays import Array
from .._tools.notebook import page
from .._tools.words import series
from ..errors import ExperimentError
from ..log.recording import Recording
from ..loop.controller import Controller
from ..loop.reference import Reference
from ..regression.settings import LeastSquaresSettings
from ..robot.correspondence import Pose
from ..robot.payload import Payload
from ..robot.robot import Robot
from ..robot.robot_file import load_robot
from ..signal.processing import SignalProcessing
from ..signal.window import DelaySettings
from ..terms.base import dropped_names
from .specs import ControllerSpec, Measurement, ReferenceSpec, SimulationSettings
from .unknown import Unknown


@dataclass(frozen=True, kw_only=True, repr=False)
class Experiment:
    """Content of an experiment file, or the same made in Python.

    Tested in ``tests/test_experiment.py``.

    Attributes
    ----------
    name : str
        Name in tables.
    path : Path or None
        Experiment file, or None for an experiment made in Python.
    robot : Robot
        Robot, with the friction model of the experiment.
    recordings : tuple of Recording
        One or more, joint side.
    signal, least_squares, delay
        Settings.
    fixed : mapping of str to float
        Values of fixed parameters (SI units, joint side), by name.
    dropped : tuple of str
        Parameters taken as zero.
    digests : mapping of str to str
        SHA-256 of each file read, by role and file name: ``experiment emps.toml``, ``robot emps.toml``,
        ``data DATA_EMPS.mat``.
    reference, controller
        Reference motion and controller, described by the file or made in Python, or None.
    simulation : SimulationSettings
        Settings of the simulation of the closed loop.
    payloads : mapping of str to Payload
        Known properties of the payloads that recordings name.
    flange
        Pose of the flange (3 x 4), see `didim.robot.payload.flange_in_last_frame`; None for that of the last link.
    measurement : Measurement or None
        Noise and quantisation of simulated measurements, or None.
    links : {"estimated", "fixed"}
        "estimated", or "fixed": masses and inertias of the links are those of the robot file.
    unknown
        Prior knowledge of the unknowns of the drives, by kind (`didim.experiment.unknown`).
    remarks : tuple of str
        Sentences on reading the file: defaults that have changed since it was written.

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
    links: Literal["estimated", "fixed"] = "estimated"
    unknown: Mapping[str, Unknown] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @classmethod
    def from_arrays(
        cls,
        robot: Robot | str | Path,
        q: ArrayLike | None,
        tau: ArrayLike | None = None,
        *,
        rate_hz: float,
        reference: ArrayLike | Reference | Literal["measured"] | None = None,
        controller: Controller | None = None,
        **settings: Any,
    ) -> Experiment:
        """Make an experiment from arrays, with filters chosen as by ``didim init``.

        Parameters
        ----------
        robot : Robot, str or Path
            Robot, its file, or the name of an included one.
        q, tau : array, shape (n_samples, n_dof)
            Positions (rad or m) and torques (N.m or N), joint side; `tau` may be None for CLOE.
        rate_hz : float
            Samples per second.
        reference : array, Reference or "measured", optional
            Reference: positions of every sample, a motion, or the measured motion.
        controller : Controller, optional
            Controller; DIDIM, IDIM-IV and CLOE need reference and controller.
        **settings
            Other attributes of the experiment, such as ``name`` or ``signal``, which replaces the chosen filters.

        Returns
        -------
        Experiment
            Experiment whose `notes` give the chosen filters and the reason.

        Raises
        ------
        DidimError
            Any of its subclasses, for arrays of the wrong shape, or a robot that cannot be read.

        Notes
        -----
        ``test_from_arrays.py`` compares the result with that of the file that ``didim init`` writes for the same log.
        """
        sampled: ArrayLike | None = None
        made: ReferenceSpec | Reference | None = None
        if isinstance(reference, Reference):
            made = reference
        elif isinstance(reference, str):
            made = ReferenceSpec("measured", None, {"kind": "measured"})
            if reference != "measured":
                raise ExperimentError(
                    f'reference must be an array of positions, a didim.Reference or "measured", got {reference!r}'
                )
        else:
            sampled = reference
        recording = Recording.from_arrays(q, tau, rate_hz=rate_hz, q_ref=sampled)
        return cls.from_recordings(robot, [recording], reference=made, controller=controller, **settings)

    @classmethod
    def from_recordings(
        cls, robot: Robot | str | Path, recordings: Sequence[Recording], **settings: Any
    ) -> Experiment:
        """Make an experiment from recordings, with filters chosen as by `from_arrays`."""
        from .draft_filters import choose_filters, sentence_of

        robot = robot if isinstance(robot, Robot) else load_robot(robot)
        if settings.get("reference") is None and all(recording.q_ref is not None for recording in recordings):
            settings["reference"] = ReferenceSpec("recorded", None, {"kind": "recorded"})
        made = cls(
            **{"name": recordings[0].name, **settings, "robot": robot, "recordings": tuple(recordings)}
        )
        if "signal" in settings or not all(recording.has_positions for recording in recordings):
            return made
        comparable = all(recording.tau is not None and recording.drives is None for recording in recordings)
        filters = choose_filters(robot, recordings, comparable=comparable)
        note = f"filters were chosen, {sentence_of(filters)}; signal=didim.SignalProcessing(...) sets others"
        return replace(made, signal=filters.signal, remarks=(*made.remarks, note))

    def __repr__(self) -> str:
        named = series(
            (f"{recording.name!r} {recording.t[-1] - recording.t[0]:g} s" for recording in self.recordings),
            90,
        )
        return f"<Experiment {self.name!r}: robot {self.robot.name!r}, {named or 'no recording'}>"

    def _repr_html_(self) -> str:
        head = ("recording", "role", "samples", "rate (Hz)", "length (s)", "torques", "windows")
        rows = [
            (
                recording.name,
                recording.role,
                str(len(recording.t)),
                f"{recording.rate_hz:g}",
                f"{recording.t[-1] - recording.t[0]:g}",
                "no" if recording.tau is None else "yes",
                str(len(recording.windows)),
            )
            for recording in self.recordings
        ]
        return page(
            f"{self.name}: robot {self.robot.name}", [head, *rows] if rows else "", "\n".join(self.notes)
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on changes made while reading the file, the robot and the recordings."""
        of_recordings = (note for recording in self.recordings for note in recording.notes)
        return (*self.remarks, *self.robot.notes, *of_recordings)

    @property
    def simulated_robot(self) -> Robot:
        """Robot of the simulation: with smooth friction, if its settings say so."""
        return self.simulation.robot(self.robot)

    def with_gains(self, gains: Array) -> Experiment:
        """Return the experiment with torques in place of currents, by gains (n_dof,)."""
        return replace(self, recordings=tuple(recording.with_gains(gains) for recording in self.recordings))

    def __post_init__(self) -> None:
        object.__setattr__(self, "recordings", tuple(self.recordings))
        object.__setattr__(self, "dropped", dropped_names(self.dropped))
        for key in ("fixed", "digests", "payloads", "unknown"):
            object.__setattr__(self, key, dict(getattr(self, key)))
        n_dof = self.robot.n_dof
        for recording in self.recordings:
            shape = recording.q.shape
            if shape[1] != n_dof:
                raise ExperimentError(
                    f"{recording.name}: q must have shape (n_samples, {n_dof}) for robot "
                    f"{self.robot.name!r}, got {shape}{'; transpose it?' if shape[0] == n_dof else ''}"
                )
