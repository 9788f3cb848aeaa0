"""The simulated robot of a scenario, its logs, and the model of the methods. Tested in ``tests/test_study.py``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array, quotient, ratio
from ..errors import StudyError
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import read_experiment
from ..experiment.loop import closed_loop
from ..experiment.specs import ReferenceSpec
from ..log.recording import Recording
from ..model.dynamics import inverse_dynamics
from ..robot.robot import Robot
from ..robot.robot_file import read_robot
from ..studies.simulated_log import measured, simulated_log
from .keys import Keys, changed, parts_of
from .spec import canonical, digest

NOISE, STARTS = 0, 1
"""Purposes of random numbers."""


Motion = tuple[Array, Array, Array, Array]
"""Position, velocity, acceleration and true torque of a motion, (n_samples, n_dof) each."""
OTHER_SAMPLES = 1000
"""Number of samples of the other motion."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The simulated robot of a scenario.

    Attributes
    ----------
    key : str
        Keys that change the simulated log, and everything that it depends on.
    experiment : Experiment
        Without a recording.
    x : (n_parameters,) array
        Standard parameters.
    shared
        What the tasks of the study share.
    other : Motion or None
        The other motion.
    """

    key: str
    experiment: Experiment
    x: Array
    shared: Mapping[str, Any]
    other: Motion | None

    @cached_property
    def clean(self) -> Experiment:
        """The experiment with the noise-free log.

        Raises
        ------
        ExperimentError
            When the log cannot be simulated.
        """
        return simulated_log(self.experiment, self.x, noise=False, refinement=self.shared["refinement"])

    def random_numbers(self, seed: int, purpose: int) -> np.random.SeedSequence:
        """Return the random numbers of one log, or of another purpose.

        They follow from the root, from the keys that change the simulated log, and from the number of the seed. Methods, and
        scenarios that only process the log differently, therefore share their logs, and extending a grid does not change
        existing ones.
        """
        return np.random.SeedSequence([self.shared["root"], int(digest(self.key), 16), seed, purpose])

    def noisy(self, seed: int) -> Experiment:
        """Return the log of a seed."""
        # The seed of `Measurement` is an integer.
        numbers = self.random_numbers(seed, NOISE)
        high, low = numbers.generate_state(2, np.uint64).tolist()
        number, in_loop_hz = int((high << 64) | low), self.shared["noise_in_loop_hz"]
        if in_loop_hz is not None:
            return measured_in_loop(self.experiment, self.x, number, in_loop_hz)
        return measured(self.clean, number)

    def starts(self, seed: int, model: Model) -> Callable[[float], Array]:
        """Return a function that draws a start: the true base parameters, each times a random factor within 1 -+ spread."""

        def draw(spread: float) -> Array:
            rng = np.random.default_rng(self.random_numbers(seed, STARTS))
            factors = 1.0 + spread * rng.uniform(-1.0, 1.0, len(model.beta))
            return np.asarray(np.nan_to_num(model.beta) * factors)

        return draw


@dataclass(frozen=True, eq=False)
class Model:
    """Robot model and settings of the methods of a scenario.

    Attributes
    ----------
    experiment : Experiment
        Without a recording.
    beta : (b,) array
        True values of the base parameters of its robot; NaN for parameters that the simulated robot does not have.
    method : dict
        Settings of all methods.
    other : Motion or None
        As in `Truth`.
    """

    experiment: Experiment
    beta: Array
    method: Mapping[str, Any]
    other: Motion | None

    def torque_errors(self, x: Array) -> tuple[float, Array]:
        """Return the relative torque error on the other motion, of all joints and per joint (n_dof,); NaN without such a motion."""
        n = self.experiment.robot.n_dof
        if self.other is None:
            return float("nan"), np.full(n, np.nan)
        q, dq, ddq, tau = self.other
        error = inverse_dynamics(self.experiment.robot, q, dq, ddq, x) - tau
        by_joint = quotient(np.linalg.norm(error, axis=0), np.linalg.norm(tau, axis=0), np.nan)
        return ratio(np.linalg.norm(error), np.linalg.norm(tau)), by_joint


def truth_of(shared: Mapping[str, Any], keys: Keys) -> Truth:
    """Return the simulated robot of a scenario; its log is simulated on first use.

    Raises
    ------
    DidimError
        When the files are not consistent with the scenario.
    """
    parts = parts_of(keys)
    robot = _robot(shared, parts.truth_robot)
    experiment = _experiment(shared, parts.truth, robot)
    x = experiment.robot.parameter_set(shared["parameters"])
    return Truth(
        key=canonical([parts.truth, parts.truth_robot]),
        experiment=experiment,
        x=x,
        shared=shared,
        other=_other_motion(shared, parts.truth, robot, x),
    )


def model_of(shared: Mapping[str, Any], keys: Keys, own: Keys, truth: Truth) -> Model:
    """Return the model for the methods of a scenario; `own` are the keys of one method.

    Raises
    ------
    DidimError
        When the files are not consistent with the scenario.
    """
    parts = parts_of(keys)
    model_parts = parts_of({f"model.{key}": value for key, value in own.items()})
    robot = _robot(shared, {**parts.model_robot, **model_parts.model_robot})
    experiment = _experiment(shared, {**parts.model, **model_parts.model}, robot)
    experiment = replace(experiment, robot=experiment.simulated_robot)
    # Base parameters for the model of the methods: terms that the simulated robot lacks are zero.
    values = dict(zip(truth.experiment.robot.parameter_names, truth.x.tolist(), strict=True))
    x = np.array([values.get(name, 0.0) for name in experiment.robot.parameter_names])
    return Model(
        experiment=experiment,
        beta=experiment.robot.base_parameters.project(x),
        method=parts.method,
        other=truth.other,
    )


def _robot(shared: Mapping[str, Any], keys: Keys) -> Robot:
    content = changed(shared["robot"], keys, shared["files"][1])
    return read_robot(content, Path(shared["files"][1]), digest=digest(canonical(content)))


def _experiment(shared: Mapping[str, Any], keys: Keys, robot: Robot) -> Experiment:
    content = changed(shared["experiment"], keys, shared["files"][0])
    return read_experiment(content, Path(shared["files"][0]), robot=robot)


def _other_motion(shared: Mapping[str, Any], keys: Keys, robot: Robot, x: Array) -> Motion | None:
    """Return the motion for the torque errors: by default a random Fourier series of the next seed."""
    other = dict(shared["other_motion"])
    reference = changed(shared["experiment"], keys, shared["files"][0])["reference"]
    if not other:
        if reference.get("kind") != "fourier" or "harmonics" not in reference:
            return None
        other = {"reference.seed": reference.get("seed", 0) + 1}
    experiment = _experiment(shared, {**keys, **other}, robot)
    spec = experiment.reference
    if not isinstance(spec, ReferenceSpec) or spec.made is None:
        raise StudyError("[other_motion] needs a reference of its own, and not that of a recording")
    q, dq, ddq = spec.made.at(np.linspace(0.0, spec.made.duration, OTHER_SAMPLES))
    simulated = experiment.simulated_robot
    return q, dq, ddq, inverse_dynamics(simulated, q, dq, ddq, x)


def measured_in_loop(experiment: Experiment, x: Array, seed: int, rate_hz: float) -> Experiment:
    """Simulate a log whose controller reads the noisy encoders.

    The law is linear: a controller that reads ``q + n`` gives the torque of one that reads ``q``, less ``kp n + kv dn/dt``, with
    the backward difference of the noise. That torque is fed forward, with straight lines between the controller's samples, and
    the closed loop is simulated with steps of one sample. Tested in ``tests/test_study.py``.

    Parameters
    ----------
    experiment : Experiment
        Without a recording; its ``[measurement]`` has the noise.
    x : (n_parameters,) array
        Standard parameters: the truth.
    seed : int
        Seed of the noise.
    rate_hz : float
        Samples of the controller per second, a multiple of the rate of the log.

    Returns
    -------
    Experiment
        Experiment with one recording, joint side.

    Raises
    ------
    StudyError
        For a controller that is not a plain PD, encoders with a resolution, or a rate that is not a multiple.
    ExperimentError
        When the run does not reach its end.
    """
    loop = closed_loop(experiment)
    controller, measurement = loop.controller, experiment.measurement
    if measurement is None or not measurement.position_noise:
        raise StudyError("noise_in_loop_hz needs position_noise in [measurement]")
    plain = controller.digital is None and controller.feedforward is None and not controller.laws[:, 2].any()
    if not plain or np.isfinite(controller.saturation).any() or measurement.encoder_resolution:
        raise StudyError(
            "noise_in_loop_hz is for a continuous PD without saturation and feed-forward, and encoders without a resolution: for "
            "others the noise in the loop is not a torque of its own"
        )
    per_record = round(rate_hz / loop.rate_hz)
    if per_record < 1 or abs(per_record * loop.rate_hz - rate_hz) > 1e-9 * rate_hz:
        raise StudyError(
            f"noise_in_loop_hz must be a multiple of the {loop.rate_hz:g} Hz of the log, got {rate_hz:g}"
        )
    rng = np.random.default_rng(seed)
    shape = ((loop.n_records - 1) * per_record + 1, experiment.robot.n_dof)
    noise = rng.standard_normal(shape) * np.asarray(measurement.position_noise)
    speed = np.diff(noise, axis=0, prepend=noise[:1]) * rate_hz
    torque = -(controller.laws[:, 0] * noise + controller.laws[:, 1] * speed) * controller.gain
    driven = replace(loop, controller=controller.with_feedforward(torque, rate_hz=rate_hz)).even(
        1.0 / rate_hz
    )
    arrays, outcomes = driven.run(x[None])
    if not outcomes[0].completed:
        raise StudyError(f"{experiment.name}: the log cannot be simulated: the run {outcomes[0]}")
    q, tau = arrays[0][0] + noise[::per_record], arrays[3][0]
    if measurement.torque_noise:
        tau = tau + rng.standard_normal(tau.shape) * np.asarray(measurement.torque_noise)
    recording = Recording.from_arrays(q, tau, rate_hz=loop.rate_hz, name="simulated log")
    robot = experiment.simulated_robot
    return replace(experiment, robot=robot, recordings=(recording,))
