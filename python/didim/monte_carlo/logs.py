"""The simulated robot of a scenario, its logs, and the model of the methods. Tested in ``tests/test_study.py``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array
from ..errors import StudyError
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import read_experiment
from ..experiment.specs import ReferenceSpec
from ..methods.job import ratio, ratios
from ..model.dynamics import inverse_dynamics
from ..robot.robot import Robot
from ..robot.robot_file import read_robot
from ..studies.simulated_log import measured, simulated_log
from .keys import Keys, changed, parts_of
from .noise_in_loop import measured_in_loop
from .spec import canonical, digest
from .tasks import random_numbers

NOISE, STARTS = 0, 1
"""Purposes of random numbers."""
OTHER_SAMPLES = 1000
"""Number of samples of the other motion."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The simulated robot of a scenario.

    Attributes
    ----------
    key : str
        Key of everything that the log depends on.
    experiment : Experiment
        Without a recording.
    x : (n_parameters,) array
        Standard parameters.
    refinement, noise_in_loop_hz, root, keys
        Settings of the log's steps, of a controller that reads the noise, and of the random numbers.
    other : tuple of (n_samples, n_dof) arrays, or None
        Position, velocity, acceleration and true torque of the other motion.
    """

    key: str
    experiment: Experiment
    x: Array
    refinement: int
    noise_in_loop_hz: float | None
    root: int
    keys: Keys
    other: tuple[Array, Array, Array, Array] | None

    @cached_property
    def clean(self) -> Experiment:
        """The experiment with the noise-free log.

        Raises
        ------
        ExperimentError
            When the log cannot be simulated.
        """
        return simulated_log(self.experiment, self.x, noise=False, refinement=self.refinement)

    def noisy(self, seed: int) -> Experiment:
        """Return the log of a seed."""
        numbers = random_numbers(self.root, self.keys, seed, NOISE)
        if self.noise_in_loop_hz is not None:
            return measured_in_loop(self.experiment, self.x, _integer(numbers), self.noise_in_loop_hz)
        return measured(self.clean, _integer(numbers))

    def starts(self, seed: int, model: Model) -> Callable[[float], Array]:
        """Return a function that draws a start: the true base parameters, each times a random factor within 1 -+ spread."""

        def draw(spread: float) -> Array:
            rng = np.random.default_rng(random_numbers(self.root, self.keys, seed, STARTS))
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
    names, units : tuple of str
        Base parameters of its robot.
    beta : (b,) array
        Their true values; NaN for parameters that the simulated robot does not have.
    method : dict
        Settings of all methods.
    other : tuple or None
        As in `Truth`.
    """

    experiment: Experiment
    names: tuple[str, ...]
    units: tuple[str, ...]
    beta: Array
    method: Mapping[str, Any]
    other: tuple[Array, Array, Array, Array] | None

    def torque_errors(self, x: Array) -> tuple[float, Array]:
        """Return the relative torque error on the other motion, of all joints and per joint (n_dof,); NaN without such a motion."""
        n = self.experiment.robot.n_dof
        if self.other is None:
            return float("nan"), np.full(n, np.nan)
        q, dq, ddq, tau = self.other
        error = inverse_dynamics(self.experiment.robot, q, dq, ddq, x) - tau
        sizes = (np.linalg.norm(values, axis=0) for values in (error, tau))
        return ratio(np.linalg.norm(error), np.linalg.norm(tau)), ratios(*sizes)


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
        refinement=shared["refinement"],
        noise_in_loop_hz=shared["noise_in_loop_hz"],
        root=shared["root"],
        keys=keys,
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
    mine = parts_of({f"model.{key}": value for key, value in own.items()})
    robot = _robot(shared, {**parts.model_robot, **mine.model_robot})
    experiment = _experiment(shared, {**parts.model, **mine.model}, robot)
    experiment = replace(experiment, robot=experiment.simulated_robot)
    base = experiment.robot.base_parameters
    return Model(
        experiment=experiment,
        names=tuple(base.names),
        units=tuple(base.units),
        beta=_true_values(experiment.robot, truth),
        method=parts.method,
        other=truth.other,
    )


def _true_values(robot: Robot, truth: Truth) -> Array:
    """Return the true base parameters for the model of the methods; terms that the simulated robot lacks are zero."""
    values = dict(zip(truth.experiment.robot.parameter_names, truth.x.tolist(), strict=True))
    x = np.array([values.get(name, 0.0) for name in robot.parameter_names])
    return robot.base_parameters.project(x)


def _robot(shared: Mapping[str, Any], keys: Keys) -> Robot:
    content = changed(shared["robot"], keys, shared["files"][1])
    return read_robot(content, Path(shared["files"][1]), digest=digest(canonical(content)))


def _experiment(shared: Mapping[str, Any], keys: Keys, robot: Robot) -> Experiment:
    content = changed(shared["experiment"], keys, shared["files"][0])
    return read_experiment(content, Path(shared["files"][0]), robot=robot)


def _other_motion(
    shared: Mapping[str, Any], keys: Keys, robot: Robot, x: Array
) -> tuple[Array, Array, Array, Array] | None:
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


def _integer(numbers: np.random.SeedSequence) -> int:
    """Return the seed for `Measurement`."""
    high, low = numbers.generate_state(2, np.uint64).tolist()
    return int((high << 64) | low)
