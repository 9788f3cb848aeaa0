"""Errors that a slowly sampled log has where the model is right, and which look like friction.

Central differences, `h` s apart, lose ``h^2 / 6`` of the second derivative of a velocity and, taken twice, ``h^2 / 3`` of that of
an acceleration. A torque that a digital controller holds between samples, or that is recorded a part of a sample beside the
positions, differs by shares of its first and second differences, here of links and rotors, since those of Coulomb friction would
hide other laws at reversals. At 100 Hz they exceed a noise of 1 % of the torque. Each is
known but for its amount, so the test for missing friction frees its scores of them. Tested in ``tests/test_friction_alarm.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._tools.arrays import Array
from ...model.dynamics import rigid_torque
from ...robot.robot import Robot
from ...signal.segments import Segment

FELT = 0.002
"""Error of accelerations, as a share of the torques of links and rotors, below which the sampling is fine enough: it is 0.4 % at
100 Hz, where right logs (`planar2`, a UR5e-like arm) raised the alarm, and 0.14 % at 250 Hz, where they did not."""


def sampling_errors(robot: Robot, parts: Sequence[Segment], parameters: Sequence[Array]) -> list[list[Array]]:
    """Return the four errors of the torques along each part; none where the sampling is fine enough.

    Parameters
    ----------
    robot : Robot
        The model.
    parts : sequence of Segment
        Motion with derivatives by central differences.
    parameters : sequence of ndarray, shape (n_parameters,)
        Standard parameters along each of the parts.

    Returns
    -------
    list of list of ndarray, shape (n_samples, n_dof)
        By error and part (N.m or N, joint side): of velocities, of accelerations, of time, and of holding.
    """
    errors: list[list[Array]] = [[], [], [], []]
    squares = np.zeros(2)
    for part, x in zip(parts, parameters, strict=True):
        q, dq, ddq = part.q, part.dq, part.ddq
        rigid = rigid_torque(robot, q, dq, ddq, x)
        errors[0].append(rigid_torque(robot, q, dq - _curvature(dq) / 6.0, ddq, x) - rigid)
        errors[1].append(rigid_torque(robot, q, dq, ddq - _curvature(ddq) / 3.0, x) - rigid)
        errors[2].append(np.gradient(rigid, axis=0))
        errors[3].append(_curvature(rigid))
        squares += np.sum(np.square(errors[1][-1])), np.sum(np.square(rigid))
    return errors if squares[0] > FELT**2 * squares[1] else []


def _curvature(values: Array) -> Array:
    """Return the second differences of signals, zero at both ends."""
    found = np.zeros_like(values)
    found[1:-1] = values[2:] - 2.0 * values[1:-1] + values[:-2]
    return found
