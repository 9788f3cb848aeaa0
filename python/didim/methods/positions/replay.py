"""A log again, simulated with the estimate of CLOE with known links. Tested in ``tests/test_positions.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...result.identification import Identification
from ...result.positions.record import PositionRecord
from .problem import build


@dataclass(frozen=True, eq=False)
class Replay:
    """One rollout of all joints.

    Attributes
    ----------
    name, role : str
        Recording, and its role.
    t : (n_samples,) array
        Time from the start of the rollout (s).
    commanded, measured, simulated : (n_samples, n_dof) array
        Positions (rad or m).
    first : int
        First sample that is compared: before it a guess of the initial velocity shows.
    """

    name: str
    role: str
    t: Array
    commanded: Array
    measured: Array
    simulated: Array
    first: int

    @property
    def errors(self) -> Array:
        """Errors of the samples that are compared, (n_compared, n_dof)."""
        return np.asarray((self.simulated - self.measured)[self.first :])


def position_errors(replays: Sequence[Replay]) -> dict[str, list[float]]:
    """Return the rms error of each joint (rad or m) by recording, its rollouts together."""
    parts: dict[str, list[Array]] = {}
    for item in replays:
        parts.setdefault(item.name, []).append(item.errors)
    return {
        name: np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)).tolist() for name, rows in parts.items()
    }


def error_lines(errors: dict[str, list[float]]) -> list[str]:
    """Return the errors as text, a line per recording."""
    found = ["rms errors of positions, simulated with the result (mrad or mm), joint by joint:"]
    for name, values in errors.items():
        found.append(f"recording '{name}'  " + "  ".join(f"{1e3 * value:.2f}" for value in values))
    return found


def replayed(fit: Identification, experiment: Experiment) -> list[Replay]:
    """Return the rollouts of an experiment, simulated with an estimate.

    Raises
    ------
    FitError
        For an experiment that has other unknowns than the result.
    """
    record = PositionRecord.of(fit.settings)
    soft = record is not None and record.soft
    problem = build(experiment, noise=None, threads=None, start=None, soft=soft)
    values = dict(zip(fit.names, fit.beta, strict=True))
    lacking = [column.name for column in problem.columns if column.name not in values]
    if lacking or fit.parameter_names != problem.robot.parameter_names:
        raise FitError(
            f"{experiment.name}: the result is of other unknowns; it has no {lacking[0] if lacking else 'such robot'}"
        )
    theta = np.array([values[column.name] for column in problem.columns])
    found: dict[tuple[int, int], Replay] = {}
    for item in problem.rollouts:
        recording = experiment.recordings[item.recording]
        shape = (len(item.q), experiment.robot.n_dof)
        key = item.recording, item.window
        if key not in found:
            t = np.arange(len(item.q)) / item.rate_hz
            parts = (np.empty(shape), np.empty(shape), np.empty(shape))
            found[key] = Replay(recording.name, recording.role, t, *parts, item.first)
        at = list(problem.limbs[item.limb].joints)
        simulated, _ = problem.positions(item, theta[None])
        found[key].commanded[:, at] = item.loop.held.values
        found[key].measured[:, at] = item.q
        found[key].simulated[:, at] = simulated[0]
    return list(found.values())
