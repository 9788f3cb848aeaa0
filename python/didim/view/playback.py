"""Motions for playback: of a log, of the simulated closed loop, of a designed motion. Tested in ``tests/test_view.py``."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.inputs import read_small_file
from ..errors import DidimError, ExcitationError
from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..model.dynamics import inverse_dynamics
from ..robot.robot import Robot
from ..signal.window import motion_of
from ..studies.run import simulate_experiment, standard_parameters


@dataclass(frozen=True, kw_only=True, eq=False)
class Playback:
    """A motion of the robot over time.

    Attributes
    ----------
    label : str
        Source of the motion.
    t : (n_samples,) array
        Times (s), increasing.
    q : (n_samples, n_dof) array
        Positions (rad or m), joint side.
    residual : (n_samples, n_dof) array or None
        Measured less modelled torque as a share of the joint's largest measured torque.
    """

    label: str
    t: Array
    q: Array
    residual: Array | None = None

    def at(self, time: float) -> Array:
        """Return the positions at a time (s), (n_dof,), constant beyond both ends."""
        return self._between(time, self.q)

    def residual_at(self, time: float) -> Array | None:
        """Return the shares of the residual at a time (s), (n_dof,)."""
        return None if self.residual is None else self._between(time, self.residual)

    def _between(self, time: float, values: Array) -> Array:
        return np.array([np.interp(time, self.t, column) for column in values.T])


def of_log(experiment: Experiment, parameters: str | None) -> tuple[list[Playback], list[str]]:
    """Return the first recording of an experiment and, with parameters, its simulation.

    Parameters
    ----------
    experiment : Experiment
        Experiment with robot, log and closed loop.
    parameters : str or None
        File of a result or of parameters, or name of a parameter set.

    Returns
    -------
    playbacks : list of Playback
        "measured" with the residual torques, and "simulated" if the experiment has a closed loop.
    notes : list of str
        Reasons for missing items.
    """
    playbacks: list[Playback] = []
    notes: list[str] = []
    for recording in experiment.recordings[:1]:
        if recording.has_positions:
            residual = None if parameters is None else _residual(experiment, recording, parameters)
            playbacks.append(Playback(label="measured", t=recording.t, q=recording.q, residual=residual))
        else:
            notes.append(f"recording '{recording.name}' has no positions, so there is no measured motion")
    if parameters is None:
        return playbacks, notes
    why: object = "the experiment has no [reference] or no [controller]"
    if experiment.reference is not None and experiment.controller is not None:
        try:
            report = simulate_experiment(experiment, parameters)
        except DidimError as reason:
            why = reason
        else:
            if report.outcome.completed:
                simulated = Playback(label="simulated", t=report.loop.t, q=report.arrays[0])
                return [*playbacks, simulated], notes
            why = report.outcome
    return playbacks, [*notes, f"no simulated motion: {why}"]


def _residual(experiment: Experiment, recording: Recording, parameters: str) -> Array | None:
    """Return measured less modelled torque along the filtered motion, as a share of each joint's largest torque."""
    if recording.tau is None:
        return None
    robot = experiment.robot
    x = standard_parameters(robot, parameters)
    q, dq, ddq = motion_of(recording, (0, len(recording.t)), experiment.signal)
    error = recording.tau - inverse_dynamics(robot, q, dq, ddq, x, temperature=recording.temperature)
    return np.asarray(error / np.maximum(np.abs(recording.tau).max(axis=0), np.finfo(float).tiny))


def of_file(path: Path, robot: Robot) -> Playback:
    """Read a motion from a CSV file with columns ``t`` and ``q1`` to ``qn``, as written by `didim excite` and `didim simulate`.

    Raises
    ------
    ExcitationError
        When a column or a number is missing, or times do not increase.
    """
    text = read_small_file(path, ExcitationError).decode("utf-8", "replace")
    names = [name.strip() for name in text.partition("\n")[0].split(",")]
    needed = ["t", *(f"q{joint + 1}" for joint in range(robot.n_dof))]
    missing = [name for name in needed if name not in names]
    if missing:
        raise ExcitationError(
            f"{path.name}: no column {missing[0]!r}; a motion has the columns t, q1 to q{robot.n_dof}"
        )
    try:
        rows = np.loadtxt(
            io.StringIO(text),
            delimiter=",",
            skiprows=1,
            ndmin=2,
            usecols=[names.index(name) for name in needed],
        )
    except ValueError as reason:
        raise ExcitationError(f"{path.name}: {reason}") from None
    if len(rows) < 2 or not np.isfinite(rows).all() or not (np.diff(rows[:, 0]) > 0.0).all():
        raise ExcitationError(
            f"{path.name}: a motion needs two samples or more, finite and with increasing times"
        )
    return Playback(label=path.name, t=rows[:, 0], q=rows[:, 1:])
