"""A log again, simulated with the estimate of CLOE with known links. Tested in ``tests/test_positions.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, quotient
from ..._tools.words import columned
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...experiment.unknown import DRIVE, Shared, Unknown
from ...result.identification import Identification
from ...result.positions.record import PositionRecord
from ...result.positions.table import milli
from ...signal.noise import white_noise
from ..builder import digests
from .columns import file_values
from .intervals import LASTING, LEAST_NOISE
from .problem import Problem
from .stops import Stop

HORIZONS_S = (0.1, 0.5, 2.0)
"""Durations (s) from a measured state to the predictions that are compared: those of a reflex, a step and a move. States are as far
apart as the first of them."""


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
        Positions (rad or m); simulated ones are NaN where something holds a joint of the limb.
    compared : (n_samples, n_dof) array of bool
        Positions that are compared: a guess of the initial velocity shows at the start of each stretch.
    """

    name: str
    role: str
    t: Array
    commanded: Array
    measured: Array
    simulated: Array
    compared: NDArray[np.bool_]

    def errors(self, joint: int) -> Array:
        """Errors of the positions of a joint that are compared, (n_compared,)."""
        return np.asarray((self.simulated - self.measured)[self.compared[:, joint], joint])


def position_errors(replays: Sequence[Replay]) -> dict[str, list[float]]:
    """Return the rms error of each joint (rad or m) by recording, its rollouts together."""
    parts: dict[str, list[Replay]] = {}
    for replay in replays:
        parts.setdefault(replay.name, []).append(replay)
    return {
        name: [rms_error(values, joint) for joint in range(values[0].measured.shape[1])]
        for name, values in parts.items()
    }


def rms_error(replays: Sequence[Replay], joint: int) -> float:
    """Return the rms error of a joint (rad or m) over rollouts; NaN where none of it is compared."""
    errors = np.concatenate([replay.errors(joint) for replay in replays])
    return float(np.sqrt(np.mean(errors**2))) if errors.size else float("nan")


def horizon_errors(fit: Identification, experiment: Experiment) -> dict[str, dict[str, list[float]]]:
    """Return the rms errors of predictions (rad or m), joint by joint, by recording and time ahead (s): see `HORIZONS_S`.

    A prediction begins with a state whose velocity is measured: see `Problem.ahead`. Errors are NaN where a log has none, or is too
    short; others as of `replayed`.
    """
    problem, theta = _problem(fit, experiment)
    n, squares = problem.robot.n_dof, dict[str, Array]()
    for rollout in (*problem.rollouts, *problem.held_out):
        found = squares.setdefault(
            experiment.recordings[rollout.recording].name, np.zeros((2, len(HORIZONS_S), n))
        )
        noise = LASTING * np.maximum(white_noise(rollout.q), LEAST_NOISE)
        predicted, at = problem.ahead(rollout, theta, (HORIZONS_S[-1], HORIZONS_S[0]), noise)
        for row, seconds in enumerate(HORIZONS_S):
            steps = round(seconds * rollout.rate_hz)
            inside = at + steps < len(rollout.q)
            if inside.any():
                errors = predicted[inside, steps] - rollout.q[at[inside] + steps]
                found[0, row, rollout.joints] += np.sum(errors**2, axis=0)
                found[1, row, rollout.joints] += len(errors)
    return {
        name: {
            f"{seconds:g}": row.tolist()
            for seconds, row in zip(HORIZONS_S, np.sqrt(quotient(found[0], found[1], np.nan)), strict=True)
        }
        for name, found in squares.items()
    }


def error_lines(errors: dict[str, list[float]], ahead: dict[str, dict[str, list[float]]]) -> list[str]:
    """Return the errors as text: a line per recording, then one for each time after a measured state."""
    rows: list[tuple[str, ...]] = []
    for name, values in errors.items():
        rows.append((f"recording '{name}'", "from the start", *map(milli, values)))
        rows += [("", f"{seconds} s ahead", *map(milli, row)) for seconds, row in ahead[name].items()]
    return [
        "rms errors of positions, simulated with the result (mrad or mm), joint by joint:",
        *columned(rows, 2),
    ]


def pushed_of(fit: Identification, experiment: Experiment) -> list[Stop]:
    """Return the stretches in which the fit found a joint pushed; none for another log."""
    record = PositionRecord.of(fit.settings)
    data = [key for key in fit.digests if key.startswith("data ")]
    same = all(fit.digests[key] == digests(experiment).get(key) for key in data)
    if record is None or not same:
        return []
    return [Stop(joint, number, begin, end, None, True) for joint, number, begin, end in record.pushed]


def other_gains(fit: Identification, experiment: Experiment) -> list[str]:
    """Return which of "kp", "kv" and "saturation" an experiment has otherwise than a result that did not estimate them.

    Those of the experiment are simulated, for gains may differ from log to log. Tested in ``tests/test_positions.py``.
    """
    record = PositionRecord.of(fit.settings)
    if record is None:
        return []
    values = file_values(experiment).drive
    return [
        kind
        for kind in ("kp", "kv", "saturation")
        if kind not in {row["kind"] for row in record.rows}
        and not np.allclose(values[kind], [np.inf if one is None else one for one in record.drive[kind]])
    ]


def replayed(fit: Identification, experiment: Experiment) -> list[Replay]:
    """Return the rollouts of an experiment, simulated with an estimate.

    Raises
    ------
    FitError
        For an experiment that has other unknowns than the result.
    """
    problem, theta = _problem(fit, experiment)
    replays: dict[tuple[int, int], Replay] = {}
    rollouts = [*problem.rollouts, *problem.held_out]
    for rollout in sorted(rollouts, key=lambda rollout: (rollout.recording, rollout.window.number)):
        recording = experiment.recordings[rollout.recording]
        first, last = recording.windows[rollout.window.number]
        key = rollout.recording, rollout.window.number
        if key not in replays:
            assert recording.q_ref is not None
            both = recording.q_ref[first:last], recording.measured_positions()[first:last]
            t = np.arange(last - first) / rollout.rate_hz
            empty = np.full(both[0].shape, np.nan), np.zeros(both[0].shape, dtype=bool)
            replays[key] = Replay(recording.name, recording.role, t, *both, *empty)
        simulated, _ = problem.positions(rollout, theta[None])
        begin, end = rollout.window.begin - first, rollout.window.begin - first + len(rollout.q)
        replays[key].simulated[begin:end, rollout.joints] = simulated[0]
        replays[key].compared[begin + rollout.first : end, rollout.joints] = True
    return list(replays.values())


def _problem(fit: Identification, experiment: Experiment) -> tuple[Problem, Array]:
    """Return the problem of an experiment with the laws and the unknowns of a result, and its estimate.

    Unknowns of drives that the experiment does not ask for would else have the values of its file.
    """
    record = PositionRecord.of(fit.settings)
    soft, sticks = (record.soft, record.sticks) if record is not None else (False, False)
    pushed = pushed_of(fit, experiment)
    values = dict(zip(fit.names, fit.beta, strict=True))
    unknown, drive = dict(experiment.unknown), file_values(experiment).drive
    for row in record.rows if record is not None else ():
        kind = row["kind"]
        if kind not in DRIVE or row["recording"] is not None:
            continue
        shared: Shared = "robot" if row["name"] == kind else "limb"
        if row["name"] == f"{kind}{row['joints'][0]}":
            shared = "joint"
        # Stretches in which something holds a joint are those of starts, as in the fit.
        start = None if np.isfinite(drive.get(kind, np.inf)).all() else row["before"]
        unknown[kind] = replace(unknown.get(kind, Unknown(start=start)), shared=shared)
    experiment = replace(experiment, unknown=unknown)
    problem = Problem(experiment, soft=soft, sticks=sticks, pushed=pushed)
    lacking = [column.name for column in problem.columns if column.name not in values]
    if lacking or fit.parameter_names != problem.robot.parameter_names:
        raise FitError(
            f"{experiment.name}: the result is of other unknowns; it has no {lacking[0] if lacking else 'such robot'}"
        )
    return problem, np.array([values[column.name] for column in problem.columns])
