"""MuJoCo's `rollout` of the TX40 with Runge-Kutta steps: links, rotors, viscous friction and a position servo per joint.

Contacts and constraints are switched off, and nothing but the states is asked for. Coulomb friction is a constraint there
and stays out, ours has it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim

from .task import NATURAL_HZ, STEP_S, STEPS, Task, bodies
from .timing import Contestant, MissingError, per_unit

Array = NDArray[np.float64]

MANY = 8
"""Simulations of a batch."""
CHECKED = 50
"""States where the accelerations are compared."""
VISCOUS = 5.0
"""Damping of each joint (N.m.s/rad)."""


def versions() -> dict[str, str]:
    """MuJoCo's version."""
    import mujoco

    return {"mujoco": mujoco.__version__}


def contestants(task: Task, rounds: int) -> list[Contestant]:
    """A single simulation, and a batch on one thread and on two, after a check of the accelerations."""
    try:
        import mujoco
        from mujoco.rollout import Rollout
    except ImportError:
        raise MissingError("MuJoCo is not installed (pip install mujoco).") from None
    model = mujoco.MjModel.from_xml_string(mjcf(task))
    _check(mujoco, task, model)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    target = task.loop.reference.at(np.arange(STEPS) * STEP_S)[0]

    def rollouts(count: int, threads: int) -> Contestant:
        data = [mujoco.MjData(model) for _ in range(threads)]
        start = np.zeros((count, size))
        start[:, 1:7] = target[0]
        control = np.tile(target, (count, 1, 1))
        states = np.empty((count, STEPS, size))
        nothing = np.empty((count, STEPS, 0))
        pool = Rollout(nthread=threads if threads > 1 else 0)

        def run() -> None:
            pool.rollout(model, data, start, control, nstep=STEPS, state=states, sensordata=nothing)

        run()
        if not np.isfinite(states).all() or np.abs(states[:, :, 1:7] - target).max() > 1.0:
            raise SystemExit("MuJoCo's simulation does not follow its reference")
        words = "simulation" if count == 1 else "simulations"
        core = "1 thread" if threads == 1 else f"{threads} threads"
        name = f"MuJoCo RK4 step, {count} {words}, {core}"
        return Contestant(name=name, measure=per_unit(run, STEPS * count), unit="us", rounds=rounds)

    return [rollouts(1, 1), rollouts(MANY, 1), rollouts(MANY, 2)]


def mjcf(task: Task) -> str:
    """Return the model as MJCF: a body per link, placed by its MDH row."""
    geometry = task.plain.geometry
    if set(geometry.kinds) != {"revolute"}:
        raise MissingError("the MJCF is written for revolute joints alone.")
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="false")
    option = ElementTree.SubElement(
        root, "option", integrator="RK4", timestep=repr(STEP_S), gravity=_words(geometry.gravity)
    )
    ElementTree.SubElement(option, "flag", contact="disable", constraint="disable")
    parent = ElementTree.SubElement(root, "worldbody")
    actuators = ElementTree.SubElement(root, "actuator")
    weight = np.diagonal(didim.inertia_matrix(task.plain, task.q[:1], task.free)[0])
    for j, (mass, centre, about_origin) in enumerate(bodies(task)):
        alpha, theta = geometry.alpha[j], geometry.theta[j]
        # Quaternion of Rx(alpha) Rz(theta); the joint then turns about z.
        a, t = (np.array([np.cos(angle / 2.0), np.sin(angle / 2.0)]) for angle in (alpha, theta))
        quaternion = (a[0] * t[0], a[1] * t[0], -a[1] * t[1], a[0] * t[1])
        r = geometry.r[j]
        place = (geometry.d[j], -r * np.sin(alpha), r * np.cos(alpha))
        parent = ElementTree.SubElement(parent, "body", pos=_words(place), quat=_words(quaternion))
        about_centre = about_origin - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        order = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
        ElementTree.SubElement(
            parent,
            "inertial",
            mass=repr(mass),
            pos=_words(centre),
            fullinertia=_words([about_centre[place] for place in order]),
        )
        ElementTree.SubElement(
            parent,
            "joint",
            name=f"q{j + 1}",
            axis="0 0 1",
            armature=repr(float(task.rotors[j])),
            damping=repr(VISCOUS),
        )
        stiffness = float(weight[j]) * (2.0 * np.pi * NATURAL_HZ[j]) ** 2
        ElementTree.SubElement(actuators, "position", joint=f"q{j + 1}", kp=repr(float(stiffness)))
    return ElementTree.tostring(root, encoding="unicode")


def _check(mujoco: Any, task: Task, model: Any) -> None:
    """Compare accelerations of `mj_forward` with ours; servo and damping are part of the torque of the rigid robot."""
    data = mujoco.MjData(model)
    found, torques = np.empty((CHECKED, 6)), np.empty((CHECKED, 6))
    for k in range(CHECKED):
        data.qpos[:], data.qvel[:], data.ctrl[:] = task.q[k], task.dq[k], task.q[k]
        data.qfrc_applied[:] = task.tau[k]
        mujoco.mj_forward(model, data)
        found[k] = data.qacc
        torques[k] = data.qfrc_applied + data.qfrc_actuator + data.qfrc_passive
    ours = didim.direct_dynamics(task.plain, task.q[:CHECKED], task.dq[:CHECKED], torques, task.free)
    task.check("MuJoCo", "the forward dynamics", found, ours, tolerance=1e-8)


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
