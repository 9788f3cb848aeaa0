"""Summary of a robot read from a description: one line per joint, and the self-test of a URDF.

Tested in ``tests/test_urdf.py`` and ``tests/test_standard_dh.py``.
"""

from __future__ import annotations

import math

import numpy as np

from ..._tools.words import counted
from ..rigid_body import angle_of
from ..robot import Robot
from ..standard_dh import correspondence_lines
from .reading import UrdfReading
from .summation import STATES


def summary(reading: UrdfReading) -> str:
    """Return one line per joint of a URDF, and the self-test, as ``didim robot`` prints them."""
    robot = reading.robot
    places = robot.correspondence
    assert places is not None
    width = max(len(name) for name in (*robot.all_joint_names, "joint"))
    extent = f"from {places.base} to {places.tip}" if places.tip else f"in the tree on {places.base}"
    lines = [
        f"{robot.name}: {counted(robot.n_dof, 'joint')} {extent}, "
        f"{len(robot.base_parameters.names)} base parameters",
        "",
        f"   {'joint':{width}}  {'kind':9}  {'alpha deg':>9}  {'d m':>8}  {'theta deg':>9}  {'r m':>8}  {'offset mm':>9}  "
        f"{'turn deg':>8}  link",
    ]
    for j, (row, transform) in enumerate(zip(reading.table.rows, places.links, strict=True)):
        matrix = transform.matrix
        link = " + ".join((transform.link, *transform.lumped, *transform.locked))
        lines.append(
            f"{j + 1:2} {transform.joint:{width}}  {robot.geometry.kinds[j]:9}  {math.degrees(row.alpha):9.6g}  {row.d:8.5g}  "
            f"{math.degrees(row.theta):9.6g}  {row.r:8.5g}  {1e3 * float(np.linalg.norm(matrix[:3, 3])):9.4g}  "
            f"{math.degrees(angle_of(matrix[:3, :3])):8.4g}  {link}"
        )
    what = "made-up inertias, as the file has none" if reading.made_up else "the inertias of the file"
    lines += [
        "",
        f"Self-test, {counted(STATES, 'random state')}, {what}: torques differ from direct summation over the "
        f"links by {reading.exact:.1e} of the largest"
        + (f" ({reading.as_written:.1e} before snapping)." if places.snapped_rad else "."),
    ]
    return "\n".join(lines)


def rows_and_frames(robot: Robot) -> str:
    """Return the modified rows of a robot and the poses of its own table's frames, as ``didim robot`` prints them."""
    names = robot.all_joint_names or tuple(f"joint {j + 1}" for j in range(robot.n_joints))
    width = max(len(name) for name in (*names, "joint"))
    gravity = " ".join(f"{value:g}" for value in robot.geometry.gravity)
    lines = [
        f"{robot.name}: {robot.description}" if robot.description else robot.name,
        f"{counted(robot.n_dof, 'joint')}, {len(robot.base_parameters.names)} base parameters, "
        f"gravity in frame 0 {gravity} m/s^2",
        "",
        "Rows of the model (modified Denavit-Hartenberg: frame j has its z axis along joint axis j):",
        f"   {'joint':{width}}  {'kind':9}  {'alpha deg':>9}  {'d m':>8}  {'theta deg':>9}  {'r m':>8}"
        + ("  antecedent  gamma deg       b m  shift m" if robot.geometry.mounts else ""),
    ]
    geometry = robot.geometry
    for j, name in enumerate(names):
        line = (
            f"{j + 1:2} {name:{width}}  {geometry.kinds[j]:9}  {math.degrees(geometry.alpha[j]):9.6g}  {geometry.d[j]:8.5g}  "
            f"{math.degrees(geometry.theta[j]):9.6g}  {geometry.r[j]:8.5g}"
        )
        if geometry.mounts:
            mount = geometry.mounts[j]
            shift = " ".join(f"{length:.5g}" for length in mount.shift)
            on = "base" if mount.parent is None else str(mount.parent + 1)
            line += f"  {on:>10}  {math.degrees(mount.gamma):9.6g}  {mount.b:8.5g}  {shift}"
        lines.append(line)
    if robot.standard is None and robot.correspondence is None:
        return "\n".join(lines)
    whose = (
        "links of the URDF" if robot.standard is None else "the maker's table (standard Denavit-Hartenberg)"
    )
    lines += ["", f"Frames of {whose}, each in frame j of the model, where it does not move:"]
    lines += correspondence_lines(robot.own_frames, names)
    lines += [
        "",
        "robot.to_own_frames(x) and robot.from_own_frames(x) convert standard parameters"
        + ("; 'frames = \"own\"' in a parameter set takes them so." if robot.standard is not None else "."),
    ]
    return "\n".join(line.rstrip() for line in lines)
