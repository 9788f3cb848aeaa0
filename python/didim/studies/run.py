"""``didim simulate``: a simulation of an experiment's closed loop, compared with its recording and written as CSV.

Tested in ``tests/test_simulate_command.py``.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._tools.arrays import Array, quotient, rms
from .._tools.files import write_atomically
from .._tools.notebook import Printed
from .._tools.words import columned, did_you_mean, series
from ..errors import ExperimentError
from ..experiment.experiment import Experiment
from ..experiment.loop import closed_loop, outside_limits
from ..experiment.specs import ReferenceSpec
from ..log.recording import Recording
from ..loop.closed_loop import ClosedLoop
from ..loop.outcome import Outcome
from ..loop.reference import Reference
from ..loop.simulation import too_large
from ..robot.parameter_file import is_file, load_parameters
from ..robot.robot import Robot
from ..signal.window import motion_of

Arrays = tuple[Array, Array, Array, Array]


@dataclass(frozen=True, eq=False, repr=False)
class SimulationReport(Printed):
    """A simulation and its errors against a recording.

    Attributes
    ----------
    experiment : Experiment
        Simulated experiment.
    recording : Recording or None
        Recording for the comparison.
    loop : ClosedLoop
        Robot, reference, controller and steps.
    arrays : four (n_records, n_dof) arrays
        Positions, velocities, accelerations and torques, joint side.
    outcome : Outcome
        How the run ended.
    errors : dict of (n_dof,) arrays
        Relative errors against the recording (`recording_errors`); empty without one.
    warnings : tuple of str
        Sentences on the reference and the step.
    """

    experiment: Experiment
    recording: Recording | None
    loop: ClosedLoop
    arrays: Arrays
    outcome: Outcome
    errors: dict[str, Array]
    warnings: tuple[str, ...]

    def write(self, path: Path) -> None:
        """Write ``t q dq ddq tau q_ref`` as CSV, joint side, SI units, which reads back as a recording.

        Positions and torques include the measurement noise, if the experiment has a ``[measurement]``.
        """
        q, dq, ddq, tau = self.arrays
        if self.experiment.measurement is not None:
            q, tau = self.experiment.measurement.measure(q, tau)
        n = self.loop.robot.n_dof
        groups = {"q": q, "dq": dq, "ddq": ddq, "tau": tau, "q_ref": self.loop.reference.at(self.loop.t)[0]}
        names = ["t", *(f"{name}{joint + 1}" for name in groups for joint in range(n))]
        text = io.BytesIO()
        text.write((",".join(names) + "\n").encode())  # bytes: text in memory takes four times as much
        np.savetxt(text, np.column_stack([self.loop.t, *groups.values()]), fmt="%.15g", delimiter=",")
        write_atomically(path, text.getvalue(), self.experiment.digests.values())

    def __str__(self) -> str:
        robot = self.loop.robot
        lines = [
            f"{self.experiment.name}: {self.loop.n_records} records in {self.loop.t[-1]:.6g} s, "
            f"{self.loop.n_steps} steps: {self.outcome}"
        ]
        if not self.outcome.completed:
            return "\n".join(lines)
        target = self.loop.reference.at(self.loop.t)[0]
        tracking = np.abs(self.arrays[0] - target).max(axis=0)
        columns = {"tracking error, largest": [f"{value:.3g}" for value in tracking]}
        columns["torque, rms"] = [f"{value:.4g}" for value in rms(self.arrays[3])]
        if self.recording is not None:
            lines.append(f"relative errors against recording '{self.recording.name}':")
        for name, values in self.errors.items():
            columns[f"{name} error"] = [f"{100.0 * value:.4g} %" for value in values]
        head = ["joint", *columns]
        rows = [
            [
                f"{joint + 1} ({'rad, N.m' if kind == 'revolute' else 'm, N'})",
                *(column[joint] for column in columns.values()),
            ]
            for joint, kind in enumerate(robot.joint_kinds)
        ]
        return "\n".join([*lines, *columned([head, *rows], left=0)])


def simulate_experiment(
    experiment: Experiment, parameters: str, recording: str | None = None
) -> SimulationReport:
    """Simulate an experiment with the parameters of a fit or of a set of the robot file.

    Parameters
    ----------
    experiment : Experiment
        With a reference and a controller.
    parameters : str
        Path of a result (.json) or of its parameters (.toml, .npz), or name of a parameter set.
    recording : str, optional
        Name of the recording that defines rate, length and, if its table says so, the reference; the first by default.

    Raises
    ------
    ExperimentError
        When the closed loop is not complete, or the recording unknown.
    FitError, RobotError
        When the parameters cannot be read.
    """
    chosen = _recording(experiment, recording)
    window = None if chosen is None else chosen.windows[0]
    loop = closed_loop(experiment, chosen, window)
    x = standard_parameters(loop.robot, parameters)
    trajectories, outcomes = loop.run(x[None])
    if chosen is None and outcomes[0].completed and loop.robot.friction.coulomb == "tanh":
        # The robot reverses later than its reference, so it is simulated again, with fine steps at its own reversals.
        motion = Reference.through(*(values[0] for values in trajectories[:3]), rate_hz=loop.rate_hz)
        del trajectories  # of an hour's log: hundreds of megabytes
        loop = loop.along(motion)
        trajectories, outcomes = loop.run(x[None])
    q, dq, ddq, tau = (values[0] for values in trajectories)
    sentences = outside_limits(loop.robot, loop.reference, float(loop.t[-1]))
    errors: dict[str, Array] = {}
    if outcomes[0].completed:
        error = loop.integration_error(x, q, tau)
        if error.large:
            sentences.append(too_large(error))
        if chosen is not None and window is not None:
            errors = recording_errors(experiment, chosen, window, (q, dq, ddq, tau))
    return SimulationReport(
        experiment, chosen, loop, (q, dq, ddq, tau), outcomes[0], errors, tuple(sentences)
    )


def standard_parameters(robot: Robot, source: str) -> Array:
    """Return the standard parameters of a file (`load_parameters`) or of a parameter set of the robot, (n_parameters,).

    Raises
    ------
    FitError
        When the file is of another robot.
    RobotError
        When there is no such set.
    """
    return load_parameters(robot, source) if is_file(source) else robot.parameter_set(source)


def recording_errors(
    experiment: Experiment, recording: Recording, window: tuple[int, int], arrays: Arrays
) -> dict[str, Array]:
    """Return the relative errors of a simulation against a window of a recording, per joint.

    Raw simulated signals are compared with raw positions and torques, and with velocities and accelerations of the filtered
    positions, without the trimmed samples: the definition of the EMPS benchmark.

    Returns
    -------
    dict of (n_dof,) arrays
        ``position``, ``velocity`` and ``acceleration`` if positions were measured and, with torques, ``torque``: norm of the
        difference over norm of the measured signal; NaN if the latter is zero.
    """
    start, stop = window
    signal = experiment.signal
    inside = slice(signal.trim_start, stop - start - signal.trim_end)
    simulated = dict(zip(("position", "velocity", "acceleration", "torque"), arrays, strict=True))
    measured = {}
    if recording.has_positions:
        _, dq, ddq = motion_of(recording, window, signal)
        measured = {"position": recording.q[start:stop], "velocity": dq, "acceleration": ddq}
    if recording.tau is not None:
        measured["torque"] = recording.tau[start:stop]
    errors = {}
    for name, values in measured.items():
        size = np.linalg.norm(values[inside], axis=0)
        error = np.linalg.norm(simulated[name][inside] - values[inside], axis=0)
        errors[name] = quotient(error, size, np.nan)
    return errors


def _recording(experiment: Experiment, name: str | None) -> Recording | None:
    names = [recording.name for recording in experiment.recordings]
    if name is not None:
        if name not in names:
            raise ExperimentError(
                f"{experiment.name}: no recording {name!r}{did_you_mean(name, names)} (there are: {series(names, 40) or 'none'})"
            )
        return experiment.recordings[names.index(name)]
    own_motion = isinstance(experiment.reference, ReferenceSpec) and experiment.reference.made is not None
    if not names or (own_motion and experiment.simulation.duration_s is not None):
        return None
    return experiment.recordings[0]
