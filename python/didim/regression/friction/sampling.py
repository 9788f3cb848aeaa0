"""Errors that a log has where its model is right, and which look like friction.

Central differences, `h` s apart, lose ``h^2 / 6`` of the second derivative of a velocity and, taken twice, ``h^2 / 3`` of that of
an acceleration. Where a joint reverses, its acceleration jumps with Coulomb friction, so the velocity is wrong just where
friction depends on it, at the jump by a quarter of its second difference. Slow motion has its loss back, so what is left of a
jump has the form of fourth and sixth differences. A torque that a digital controller holds between
samples, or that is recorded a part of a sample beside the positions, differs by shares of its first and second differences, here
of links and rotors, since those of Coulomb friction would hide other laws at reversals. Friction of a ``sign`` turns within a
small velocity that its model leaves open. Each error is known but for its amount at each joint, so the test for missing friction
frees its scores of them.

They are differences of the motion, so noise of the positions is in them as it is in the residual, and looks like friction; low
passes of them have hardly any of it. Tested in ``tests/test_friction_alarm.py``, the turn in ``tests/test_ur10e_page.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ...errors import SignalError
from ...model.dynamics import inverse_dynamics
from ...model.memory import instantaneous
from ...robot.robot import Robot
from ...signal.filters import SLOW, low_pass
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from .tested_laws import joint_scales

TURN = 0.01
"""Velocity (rad/s, times `PRISMATIC` for m/s) within which friction of a ``sign`` may turn smoothly: a fifth of the smallest
Stribeck velocity that is tested, so the laws remain visible. Chosen on the UR10e example, whose friction is a tanh of it."""


def sampling_errors(
    robot: Robot, parts: Sequence[Window], parameters: Sequence[Array], load: Sequence[Array]
) -> list[list[Array]]:
    """Return the errors of the torques along each part.

    Parameters
    ----------
    robot : Robot
        The model.
    parts : sequence of Window
        Motion with derivatives by central differences.
    parameters : sequence of ndarray, shape (n_parameters,)
        Standard parameters along each of the parts.
    load : sequence of ndarray, shape (n_samples, n_dof)
        Torques of links and rotors along each of the parts (N.m or N, joint side).

    Returns
    -------
    list of list of ndarray, shape (n_samples, n_dof)
        By error and part (N.m or N, joint side): of velocities, of accelerations and velocities at a jump, twice of fast
        velocities, of time, of holding, and, without a unit, of the turn of a ``sign``.
    """
    errors = [_errors(robot, *along) for along in zip(parts, parameters, load, strict=True)]
    return [list(error) for error in zip(*errors, strict=True)]


def slow_errors(
    errors: Sequence[Sequence[Array]], parts: Sequence[Window], signal: SignalProcessing
) -> list[list[Array]]:
    """Return the errors of `sampling_errors` through a low pass; none without a cut-off, or where they cannot be filtered."""
    if not errors or signal.cutoff_hz is None:
        return []
    slow = replace(signal, cutoff_hz=signal.cutoff_hz / SLOW, form="sections")
    try:
        passed = [
            low_pass(np.hstack([error[k] for error in errors]), part.rate_hz, slow)
            for k, part in enumerate(parts)
        ]
    except SignalError:  # the record is too short for so low a filter, or rounding spoils it
        return []
    return [list(error) for error in zip(*(np.split(one, len(errors), 1) for one in passed), strict=True)]


def _errors(robot: Robot, part: Window, x: Array, rigid: Array) -> list[Array]:
    """Return the errors along one part."""
    q, dq, ddq = part.q, part.dq, part.ddq
    torque, bend = inverse_dynamics(robot, q, dq, ddq, x), _curvature(dq)
    sharper = _curvature(bend)
    errors = [
        inverse_dynamics(robot, q, dq - bend / 6.0, ddq, x) - torque,
        inverse_dynamics(robot, q, dq - bend / 4.0, ddq - _curvature(ddq) / 3.0, x) - torque,
        *(
            inverse_dynamics(robot, q, dq - faster / 6.0, ddq, x) - torque
            for faster in (sharper, _curvature(sharper))
        ),
        np.gradient(rigid, axis=0),
        _curvature(rigid),
    ]
    if robot.friction.coulomb == "sign":
        errors.append(np.tanh(dq / (TURN * joint_scales(robot))) - instantaneous(robot, dq))
    return errors


def _curvature(values: Array) -> Array:
    """Return the second differences of signals, zero at both ends."""
    curvature = np.zeros_like(values)
    curvature[1:-1] = values[2:] - 2.0 * values[1:-1] + values[:-2]
    return curvature
