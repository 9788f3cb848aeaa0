"""A real SO-101 from commands and positions, ours beside least squares of MuJoCo over its own rollouts, on the same two logs.

The peer has what recipes of MuJoCo's toolbox for this arm have: armature, damping, friction loss and gain of each servo, from the
values of the file, links known. It has neither a delay nor a limit of the set-points. Both are asked for what the other motions of
the folder were, simulated from their starts by the steps of the fit, in the samples that ours compares: contacts are left out.
"""

from __future__ import annotations

import contextlib
import copy
import io
import tempfile
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim
from didim.cli.main import main as command
from didim.methods.positions.problem import left_out
from didim.methods.positions.replay import position_errors, replayed

from .timing import MissingError

Array = NDArray[np.float64]

FITTED = ("chirp_sweep", "large_amplitude")
"""Motions that are fitted; those beside them are held out."""
FILE = "so101_new_calib.xml"
KP, LIMIT = 17.8, 3.35
"""Gain (N.m/rad) and torque limit (N.m) of the servos that the logs were taken with."""
STEPS = 4
"""Steps of the peer in a sample of 20 ms."""
MOST = (0.2, 5.0, 2.0, 60.0)
"""Upper bounds of its armatures, dampings, friction losses and gains; lower ones are zero, of gains 5."""
ITERATIONS = 30
"""Upper bound of its iterations."""


def tell(folder: Path) -> None:
    """Print errors held out (mrad) and processor seconds of both."""
    try:
        import mujoco
        from mujoco import minimize, rollout
    except ImportError:
        raise MissingError("MuJoCo is not installed (pip install mujoco).") from None
    with tempfile.TemporaryDirectory() as name:
        fitted = experiment(folder, Path(name), *FITTED)
        others = [
            experiment(folder, Path(name), motion.name)
            for motion in sorted(folder.iterdir())
            if motion.is_dir() and motion.name not in FITTED
        ]
        clock = process_time()
        fit = didim.identify(fitted, verbose=False)
        ours = process_time() - clock
        replays = [replayed(fit, other) for other in others]
    arm = Rollouts(mujoco, rollout, folder / FILE)
    file = arm.model.dof_armature, arm.model.dof_damping, arm.model.dof_frictionloss, np.full(6, KP)
    start = np.concatenate([values[:5] for values in file])
    low, high = np.repeat([0.0, 0.0, 0.0, 5.0], 5), np.repeat(MOST, 5)
    clock = process_time()
    found, _ = minimize.least_squares(
        start,
        lambda thetas: arm.errors(fitted, thetas),
        bounds=[low, high],
        eps=1e-4,
        max_iter=ITERATIONS,
        verbose=minimize.Verbosity.SILENT,
    )
    theirs, runs = process_time() - clock, arm.runs
    own: list[list[float]] = []
    peer: list[list[float]] = []
    for other, some in zip(others, replays, strict=True):
        positions = arm.simulated(other, found.reshape(-1, 1))
        own += position_errors(some).values()
        peer += position_errors(
            [replace(replay, simulated=q[0]) for replay, q in zip(some, positions, strict=True)]
        ).values()
    for title, errors, seconds in (("didim", own, ours), ("mujoco.minimize.least_squares", peer, theirs)):
        print(
            f"{title}: held out over {len(others)} motions {1e3 * np.median(errors):.1f} mrad in the median, 90 % below "
            f"{1e3 * np.percentile(errors, 90):.1f}; {seconds:.0f} processor seconds"
        )
    print(
        f"{runs} simulations of the peer, {fit.n_simulations} of ours; didim / MuJoCo: {ours / theirs:.2f} of the time"
    )


def experiment(folder: Path, place: Path, *motions: str) -> didim.Experiment:
    """Return the experiment that `didim init` writes for motions."""
    logs = [str(folder / motion / name) for motion in motions for name in ("state_motor.csv", "control.csv")]
    written = place / f"{motions[0]}.toml"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        command(
            ["init", str(folder / FILE), *logs, "--kp", str(KP), "--lock", "gripper=0", "-o", str(written)]
        )
    return didim.load_experiment(written)


class Rollouts:
    """The arm in MuJoCo, without contacts and limits, its gripper held at zero."""

    def __init__(self, mujoco: Any, rollout: Any, file: Path) -> None:
        spec = mujoco.MjSpec.from_file(str(file))
        for element in [*spec.geoms, *spec.meshes]:
            spec.delete(element)
        self.model, self.mujoco, self.rollout, self.runs = spec.compile(), mujoco, rollout, 0
        m = self.model
        m.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        m.actuator_ctrllimited[:], m.actuator_forcerange[:] = 0, [-LIMIT, LIMIT]

    def simulated(self, experiment: didim.Experiment, thetas: Array) -> list[Array]:
        """Return positions of candidates (rad), (n_candidates, n_samples, 5), of each window of an experiment."""
        windows = []
        for recording in experiment.recordings:
            assert recording.q_ref is not None
            self.model.opt.timestep = 1.0 / (recording.rate_hz * STEPS)
            models = [self._with(theta) for theta in thetas.T]
            for first, last in recording.windows:
                q, r = recording.measured_positions()[first:last], recording.q_ref[first:last]
                control = np.zeros((len(models), (len(q) - 1) * STEPS, 6))
                control[:, :, :5] = np.repeat(r[:-1], STEPS, axis=0)
                state = np.zeros((len(models), 13))
                state[:, 1:6], state[:, 7:12] = q[0], (q[1] - q[0]) * recording.rate_hz
                out, _ = self.rollout.rollout(models, [self.mujoco.MjData(self.model)], state, control)
                self.runs += len(models)
                windows.append(np.concatenate([state[:, None, 1:6], out[:, STEPS - 1 :: STEPS, 1:6]], axis=1))
        return windows

    def errors(self, experiment: didim.Experiment, thetas: Array) -> Array:
        """Return errors of candidates (rad), (n_rows, n_candidates)."""
        windows = [
            (recording.measured_positions()[first:last], left_out(last - first, recording.rate_hz))
            for recording in experiment.recordings
            for first, last in recording.windows
        ]
        return np.concatenate(
            [
                (simulated - q)[:, begin:].reshape(len(simulated), -1).T
                for simulated, (q, begin) in zip(self.simulated(experiment, thetas), windows, strict=True)
            ]
        )

    def _with(self, theta: Array) -> Any:
        m = copy.copy(self.model)
        m.dof_armature[:5], m.dof_damping[:5], m.dof_frictionloss[:5] = theta[:15].reshape(3, 5)
        m.actuator_gainprm[:5, 0], m.actuator_biasprm[:5, 1] = theta[15:], -theta[15:]
        m.actuator_biasprm[:, 2] = 0.0
        return m
