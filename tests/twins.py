"""Robots in Pinocchio, for tests and benchmarks."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from didim.robot.robot import Robot

Array = NDArray[np.float64]
INERTIAL = 10
# Pinocchio's order m, mc, Ixx Ixy Iyy Ixz Iyz Izz, as places in XX XY XZ YY YZ ZZ MX MY MZ M.
PINOCCHIO_ORDER = [9, 6, 7, 8, 0, 1, 3, 2, 4, 5]


def pinocchio_model(robot: Robot, x: Array) -> pin.Model:
    """Build the same links in Pinocchio; rotors and friction are left out."""
    model = pin.Model()
    model.gravity.linear = np.array(robot.geometry.gravity)
    geometry = robot.geometry
    parent = 0
    for j, kind in enumerate(geometry.kinds):
        placement = pin.SE3(pin.utils.rotate("x", geometry.alpha[j]), np.array([geometry.d[j], 0.0, 0.0]))
        placement *= pin.SE3(pin.utils.rotate("z", geometry.theta[j]), np.array([0.0, 0.0, geometry.r[j]]))
        joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        parent = model.addJoint(parent, joint, placement, f"joint{j + 1}")
        first = robot.parameter_names.index(f"XX{j + 1}")
        xx, xy, xz, yy, yz, zz, mx, my, mz, m = x[first : first + INERTIAL]
        c = np.array([mx, my, mz]) / m
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about_centre = about_origin - m * (c @ c * np.eye(3) - np.outer(c, c))
        model.appendBodyToJoint(parent, pin.Inertia(m, c, about_centre), pin.SE3.Identity())
    return model
