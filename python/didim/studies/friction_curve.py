"""Friction over speed: the friction torque of a result, beside the friction in a log.

Tested in ``tests/test_friction_curve.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..model.dynamics import friction_places, inverse_dynamics, rigid_torque
from ..model.memory import sliding
from ..result.identification import Identification
from ..robot.robot import Robot
from ..signal.filters import row_values
from ..signal.window import windows_of
from .loaded import same_parameters, standard_in, with_friction_of, with_gains_of
from .prediction import fitted_experiment

SPEEDS = 401
"""Number of speeds of a curve, from the largest negative to the largest positive one."""
LOADS = (5.0, 50.0, 95.0)
"""Percentiles of the torque of links and rotors: light, median and heavy load."""


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction of one joint, joint side.

    Attributes
    ----------
    speed : (n,) array
        Speeds (rad/s or m/s).
    torque : (n,) array
        Torque of friction and offset (N.m or N) at the median load, the other joints at rest.
    low, high : (n,) arrays
        The same at a light and at a heavy load; equal to `torque` without load friction.
    measured_speed, measured : (n_rows,) arrays
        Rows of the log: the joint's speed, and the measured torque less all other terms of the model: links, rotors, the
        friction of coupled motors due to the other joints, and the payload, own offsets and own friction of the recording (N.m
        or N).
    """

    speed: Array
    torque: Array
    low: Array
    high: Array
    measured_speed: Array
    measured: Array


def friction_curves(fit: Identification, experiment: Experiment) -> list[FrictionCurve]:
    """Return the friction of each joint over its speed.

    Parameters
    ----------
    fit : Identification
        Any result.
    experiment : Experiment
        The log; its filtered measured motion gives the torque of links and rotors.

    Returns
    -------
    list of FrictionCurve
        One per joint.

    Raises
    ------
    FitError
        For another robot, a payload that neither the result nor the experiment knows, or without a recording of role "fit" that has
        positions and torques.
    """
    experiment, delay = fitted_experiment(fit, with_gains_of(fit, with_friction_of(fit, experiment)))
    robot = experiment.robot
    same_parameters(fit, robot)
    recordings = [
        (log, standard)
        for log, standard in zip(experiment.recordings, standard_in(fit, experiment, robot), strict=True)
        if log.role == "fit" and log.tau is not None and log.has_positions
    ]
    if not recordings:
        raise FitError(
            f"experiment '{experiment.name}' has no recording with role 'fit' that has positions and torques"
        )
    x = fit.parameters
    friction_only = np.zeros(len(x))
    places = list(friction_places(robot))
    friction_only[places] = x[places]
    speeds: list[Array] = []
    rests: list[Array] = []
    loads: list[Array] = []
    for recording, standard in recordings:
        for part in windows_of(recording, experiment.signal, delay=delay.samples, hold_s=delay.hold_s):
            rigid = rigid_torque(robot, part.q, part.dq, part.ddq, standard)
            rest = part.tau - inverse_dynamics(
                robot, part.q, part.dq, part.ddq, standard, temperature=part.temperature
            )
            for joint in range(robot.n_dof):
                own, share = _alone(robot, joint, part.dq[:, joint], friction_only)
                rest[:, joint] += own + share * np.abs(rigid[:, joint])
            for pieces, values in zip((speeds, rests, loads), (part.dq, rest, rigid), strict=True):
                pieces.append(row_values(values, experiment.signal))
    speed, rest, load = (np.concatenate(pieces) for pieces in (speeds, rests, loads))
    curves = []
    for joint in range(robot.n_dof):
        fastest = float(np.abs(speed[:, joint]).max())
        grid = np.linspace(-fastest, fastest, SPEEDS)
        torque, share = _alone(robot, joint, grid, friction_only)
        size = np.abs(load[:, joint])
        light, median, heavy = np.percentile(size, LOADS)
        curves.append(
            FrictionCurve(
                speed=grid,
                torque=torque + share * median,
                low=torque + share * light,
                high=torque + share * heavy,
                measured_speed=speed[:, joint],
                measured=rest[:, joint],
            )
        )
    return curves


def _alone(robot: Robot, joint: int, speed: Array, friction_only: Array) -> tuple[Array, Array]:
    """Return the friction of a joint that moves alone, without load, and its load friction per unit of ``|tau_r|``."""
    robot, friction_only = sliding(robot, friction_only)  # memory has no curve over speed
    dq = np.zeros((len(speed), robot.n_dof))
    dq[:, joint] = speed
    still = np.zeros_like(dq)
    unit = np.zeros(len(friction_only))
    names = robot.parameter_names
    # The torque of unit Coulomb friction is the sign, with the smoothing of the model.
    for name in (f"Fc{joint + 1}", f"Fc{joint + 1}+", f"Fc{joint + 1}-"):
        if name in names:
            unit[names.index(name)] = 1.0
    load = f"Fl{joint + 1}"
    coefficient = float(friction_only[names.index(load)]) if load in names else 0.0
    sign, torque = (inverse_dynamics(robot, still, dq, still, x)[:, joint] for x in (unit, friction_only))
    return torque, coefficient * sign
