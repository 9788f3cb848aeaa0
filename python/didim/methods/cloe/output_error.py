"""The closed-loop output error of candidates, minimised by CLOE (19) and CLIE.

Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import copy
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, quotient
from ...errors import FitError
from ...evidence.loop.simulated import Piece, compare_motions
from ...experiment.loop import recordings_of, windows
from ...model.dynamics import regressor
from ...model.limbs import Directions
from ...model.safe_step import safe_step, thinned
from ...result.identification import Identification
from ...result.iteration import Iteration, Reporter, Status
from ...signal.window import Window
from ...terms.rows import Block
from ..builder import Run, TorqueErrors, identification, record
from ..idim_ls import direct_estimate
from ..job import Delay, Job
from ..start import extended_start
from ..uncertainty import Spread
from .checkpoint import Checkpoint
from .jacobian import Jacobian
from .settings import CLOESettings, Output

CHECKED_POSITIONS = 200
"""Number of positions at which M(q) must stay positive definite."""
TOGETHER = 64
"""Largest number of candidates whose trajectories are held in memory at once."""
COMPARED = {"position": ("q",), "torque": ("tau",), "both": ("q", "tau")}
"""Signals of a simulation that each setting of the output compares."""
MEASURED = {"q": "measured", "tau": "logged"}
"""The same signals of a window."""
DERIVATIVE_STEP = 1e-4
"""Parameter step of a finite difference, as the share of the torques that it changes."""


class OutputError:
    """Cost of candidates, their errors, and derivatives of these.

    Attributes
    ----------
    start : (n,) array
        Estimated base parameters at the start.
    scale : (n,) array
        Change of each parameter that changes the torques along the reference by their own size.
    directions : Directions
        Parameters whose derivatives share a simulation.
    weights : dict of str to (n_dof,) array
        Weights of the squared errors of the compared outputs, "q" and "tau".
    n_simulations : int
        Simulations so far.
    """

    def __init__(self, method: CLOESettings, job: Job, reporter: Reporter) -> None:
        self.method, self.job, self.reporter = method, job, reporter
        self.robot, self.base = job.robot, job.model
        self.estimated = job.model.unknowns.estimated
        self.windows = _windows(job, method.output)
        self.checked = thinned(
            np.concatenate([window.measured for window in self.windows]), CHECKED_POSITIONS
        )
        self.n_simulations = 0
        self.start = self._start()
        self.scale, acts = self._scale()
        self.directions = Directions.of(self.robot, acts)
        self.weights = {name: np.ones(self.robot.n_dof) for name in COMPARED[method.output]}

    def standard(self, points: Array) -> Array:
        """Return standard parameters of (m, n) points, (m, n_parameters), followed by the further ones of the logs."""
        return np.ascontiguousarray([self.job.lift(point) for point in points])

    def costs(self, points: Array) -> Array:
        """Return sums of weighted squared errors, (m,); infinite if a run ends early or a point is not finite."""
        total, unused = np.zeros(len(points)), np.zeros(self.robot.n_dof)
        good = np.isfinite(points).all(axis=1)
        total[~good] = np.inf
        if good.any():
            x = self.standard(points[good])
            for window in self.windows:
                costs, _ = window.loop.costs(
                    self.base.standard(x, window.recording),
                    window.measured,
                    window.logged,
                    weight_q=self.weights.get("q", unused),
                    weight_tau=self.weights.get("tau", unused),
                    threads=self.method.threads,
                )
                total[good] += np.where(np.isnan(costs), np.inf, costs)
        self.n_simulations += len(points)
        return total

    def errors(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return weighted errors of points, (m, n_rows), in the order of `blocks`, and which runs completed."""
        parts = [self._errors(points[k : k + TOGETHER]) for k in range(0, len(points), TOGETHER)]
        self.n_simulations += len(points)
        return np.concatenate([rows for rows, _ in parts]), np.concatenate([ended for _, ended in parts])

    def _errors(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        x = self.standard(points)
        rows, completed = [], np.ones(len(points), dtype=bool)
        for window in self.windows:
            own = self.base.standard(x, window.recording)
            simulated, outcomes = window.loop.run(own, threads=self.method.threads, signals=self.weights)
            completed &= np.array([outcome.completed for outcome in outcomes])
            for errors, (name, weight) in zip(simulated, self.weights.items(), strict=True):
                errors -= getattr(window, MEASURED[name])
                errors *= np.sqrt(weight)
                rows.append(errors.reshape(len(points), -1))
        return np.concatenate(rows, axis=1) if len(rows) > 1 else rows[0], completed

    def blocks(self) -> list[Block]:
        """Return the blocks of the rows: by output, window, sample and joint."""
        blocks, start, n = [], 0, self.robot.n_dof
        for window in self.windows:
            for _ in self.weights:
                stop = start + window.measured.size
                blocks += [
                    Block(
                        slice(start + joint, stop, n),
                        joint,
                        window.recording,
                        window.number,
                        window.loop.rate_hz,
                    )
                    for joint in range(n)
                ]
                start = stop
        return blocks

    def derivatives(self, point: Array, errors: Array) -> Jacobian:
        """Return derivatives of the weighted errors, by differences of parallel simulations."""
        steps, directions = DERIVATIVE_STEP * self.scale, self.directions
        moved, completed = self.errors(point + directions.changes(steps))
        moved -= errors
        jacobian = Jacobian.of(moved, directions, steps)
        if not completed.all():
            # At the boundary of the feasible set the step to the other side is inside.
            back = np.flatnonzero(np.logical_not(completed[directions.number]))
            other, inside = self.errors(point - np.diag(steps)[back])
            slopes = np.where(inside[:, None], (errors - other) / steps[back, None], 0.0)
            jacobian.replace_rows(back, slopes, directions)
        return jacobian

    def safe_share(self, point: Array, target: Array) -> float:
        """Return the share of the step to a target for which M(q) stays positive definite."""
        x, y = self.standard(np.stack([point, target]))
        recordings = sorted({window.recording for window in self.windows})
        return min(
            safe_step(self.robot, self.checked, self.base.standard(x, number), self.base.standard(y, number))
            for number in (recordings[:1] if self.base.simple else recordings)
        )

    def begun_at(self, point: Array) -> OutputError:
        """Return the same problem with another start, and no simulations yet."""
        other = copy.copy(self)
        other.start, other.n_simulations = point, 0
        return other

    def divided(self, parts: int) -> OutputError:
        """Return the same problem with every step of its simulations divided into `parts`."""
        other = copy.copy(self)
        other.windows = [replace(window, closed_loop=window.loop.divided(parts)) for window in self.windows]
        return other

    def no_start(self) -> FitError:
        """Return the error for a start that cannot be simulated, with the outcome of its run."""
        x = self.standard(self.start[None])
        outcomes = [window.loop.run(self.base.standard(x, window.recording))[1][0] for window in self.windows]
        ended = next((outcome for outcome in outcomes if not outcome.completed), "gives no number")
        return FitError(
            f"{self.job.experiment.name}: CLOE cannot start from these parameters: the robot cannot be simulated with "
            f"them, the run {ended}"
        )

    @cached_property
    def checkpoint(self) -> Checkpoint:
        """Checkpoint of the search, tied to this problem."""
        path = self.method.checkpoint
        return Checkpoint(None, "") if path is None else Checkpoint(Path(path), self.fingerprint())

    def fingerprint(self) -> str:
        """Return the digest that identifies a problem: the log, the closed loop, the estimated parameters, the settings."""
        settings = self.settings()
        for key in ("max_iterations", "max_evaluations", "threads", "checkpoint", "tolerance", "starts"):
            settings.pop(key)
        asked_of_job = {key: value for key, value in record(self.job).items() if key != "versions"}
        asked = json.dumps([settings, asked_of_job], sort_keys=True, default=str)
        digest = hashlib.sha256(asked.encode())
        for window in self.windows:
            loop = window.loop
            law = loop.controller
            numbers = (
                loop.rate_hz,
                loop.n_records,
                loop.steps,
                loop.start,
                loop.divergence,
                loop.integrator,
                law.digital,
            )
            digest.update(repr((*numbers, loop.memory.core)).encode())
            motion = loop.reference.at(loop.t)
            signals = [part for part in (loop.external, law.feedforward) if part is not None]
            push = [np.append(values, rate) for rate, values in signals]
            for array in (
                *(window.measured, window.logged, *motion, *push, law.laws, law.gain, law.saturation),
                *(self.start, self.job.model.unknowns.values),
            ):
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def _start(self) -> Array:
        def direct() -> Identification:
            return direct_estimate(self.method, self.job.experiment, self.reporter)

        return self.job.estimated(extended_start(self.job, self.method.chosen_start, direct, self.job.delay))

    def _scale(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the scale, and whether each parameter acts on the torque of a joint along the references, (n_dof, n)."""
        base = list(self.robot.base_parameters.indices)
        squares = np.zeros((self.robot.n_dof, len(self.estimated)))
        sizes = np.zeros(self.robot.n_dof)
        for window in self.windows:
            t = window.loop.t[:: max(1, window.loop.n_records // 2000)]
            x = self.standard(self.start[None])[0]  # load friction depends on them
            own = self.base.standard(x, window.recording)
            w = regressor(self.robot, *window.loop.reference.at(t), x=own)[:, :, base]
            w = w @ self.base.directions(window.recording)[:, self.estimated]
            squares += np.mean(w**2, axis=0)
            sizes += np.mean(window.logged**2, axis=0)
        share = np.sqrt(np.sum(squares / np.where(sizes > 0.0, sizes, 1.0)[:, None], axis=0))
        return quotient(np.ones(len(share)), share, 1.0), squares > 0.0

    def result(
        self,
        point: Array,
        *,
        status: Status,
        history: Sequence[Iteration],
        spread: Spread,
        condition_number: float,
        settings: dict[str, Any],
    ) -> Identification:
        """Build the result at a point, with the errors of its simulated torques."""
        x = self.standard(point[None])[0]
        errors, sizes = np.zeros(self.robot.n_dof), np.zeros(self.robot.n_dof)
        positions, n_rows, cost = [], 0, 0.0
        pieces: list[Piece] = []
        torques = all(recording.tau is not None for recording in self.job.experiment.recordings)
        delay = self.job.delay() if torques else Delay()
        for window in self.windows:
            own = self.base.standard(x, window.recording)
            (q, _, _, tau), _ = window.loop.run(own[None], threads=self.method.threads)
            # The delay of the measured torque is compensated, and it is trimmed, as in the other methods.
            beside = window.moved_back(delay.samples, self.job.signal)
            simulated = tau[0][beside.kept]
            errors += np.sum((simulated - beside.tau) ** 2, axis=0)
            sizes += np.sum(beside.tau**2, axis=0)
            n_rows += beside.tau.size
            cost += float(np.sum((q[0] - window.measured) ** 2))
            positions.append(q[0])
            pieces.append((window.measured, q[0], beside.tau, simulated))
        self.n_simulations += len(self.windows)
        run = Run(
            job=self.job,
            method=self.method,
            status=status,
            history=history,
            delay=delay,
            q=thinned(np.concatenate(positions), 2000),
            settings={
                "cloe": {**self.settings(), **settings, "position_error_norm": math.sqrt(cost)},
                **({"simulated": compare_motions(self.job.signal, pieces).record()} if torques else {}),
            },
            remarks=(
                *spread.remarks,
                *self.checkpoint.remarks,
                *(() if torques else ("the log has no torques, so there are no torque errors",)),
            ),
        )
        result = identification(
            run,
            beta=self.base.project(x),
            spread=spread,
            errors=TorqueErrors(np.sqrt(errors), np.sqrt(sizes), n_rows),
            condition_number=condition_number,
            held_out=torques,
        )
        return replace(result, n_simulations=self.n_simulations)

    def settings(self) -> dict[str, Any]:
        """Return the settings."""
        asked = asdict(replace(self.method, start="unit", executor=None))
        del asked["executor"]
        start = self.method.chosen_start
        asked["start"] = start if isinstance(start, str) else "given"
        asked["checkpoint"] = None if self.method.checkpoint is None else str(self.method.checkpoint)
        return asked


def _windows(job: Job, output: Output) -> list[Window]:
    if output != "position" and job.delay_setting not in ("hold", 0.0):
        raise FitError(
            f"output {output!r} takes no delay of the torque back, and compensate_samples is {job.delay_setting!r}: use output "
            "'position', or DIDIM"
        )
    for _, recording in recordings_of(job.experiment):
        if recording.tau is None and output != "position":
            raise FitError(f"recording '{recording.name}' has no torques, which output {output!r} needs")
    made = windows(job.experiment, job.signal, along="outputs")
    for window in made:
        with np.errstate(over="ignore"):
            sizes = np.linalg.norm(window.logged, axis=0)
        if not np.isfinite(sizes).all():
            joint = int(np.argmin(np.isfinite(sizes))) + 1
            raise FitError(
                f"recording '{window.name}': the torques of joint {joint} are too large to be squared; check their unit"
            )
    return made
