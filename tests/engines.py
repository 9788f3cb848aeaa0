"""Torques of written files by other engines: MuJoCo for URDF and MJCF, and a reader of SDF for Pinocchio."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]


def mujoco_model(text: str) -> Any:
    """Compile MJCF or a URDF, whose meshes are absent; constraints (limits, Coulomb friction) are switched off."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco, the group 'test'")
    if "<robot" in text:
        text = re.sub(
            r"<(visual|collision)\b[^>]*/>|<(visual|collision)\b.*?</\2>", "", text, flags=re.DOTALL
        )
        options = (
            '<compiler discardvisual="true" balanceinertia="false" fusestatic="true" strippath="false"/>'
        )
        text = re.sub(r"(<robot\b[^>]*>)", rf"\1<mujoco>{options}</mujoco>", text, count=1)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return model


def mujoco_torques(
    text: str,
    names: Sequence[str],
    q: Array,
    dq: Array,
    ddq: Array,
    gravity: Sequence[float] | Array | None = None,
) -> Array:
    """Torques by ``mj_inverse``, (n_samples, n_dof): rigid bodies, armature and damping."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco, the group 'test'")
    model = mujoco_model(text)
    if gravity is not None:
        model.opt.gravity[:] = gravity
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in names]
    places, speeds = ([int(joint.qposadr[0]) for joint in joints], [int(joint.dofadr[0]) for joint in joints])
    tau = np.zeros(q.shape)
    for sample in range(q.shape[0]):
        data.qpos[:], data.qvel[:], data.qacc[:] = 0.0, 0.0, 0.0
        data.qpos[places], data.qvel[speeds], data.qacc[speeds] = q[sample], dq[sample], ddq[sample]
        mujoco.mj_inverse(model, data)
        tau[sample] = data.qfrc_inverse[speeds]
    return tau


def sdf_torques(text: str, gravity: Sequence[float] | Array, q: Array, dq: Array, ddq: Array) -> Array:
    """Torques of the only model of an SDF by Pinocchio, (n_samples, n_dof), read by this function alone."""
    root = ET.fromstring(text).find("model")
    assert root is not None
    frames = {"world": pin.SE3.Identity()}
    links = {}
    for link in root.findall("link"):
        links[link.get("name", "")] = link
        frames[link.get("name", "")] = placement(link.findtext("pose") or "0 0 0 0 0 0")
    model = pin.Model()
    model.gravity.linear = np.array(gravity)
    joint_of = {"world": 0}
    for joint in root.findall("joint"):
        parent, child = joint.findtext("parent") or "", joint.findtext("child") or ""
        if joint.get("type") == "fixed":
            joint_of[child] = joint_of[parent]
            continue
        axis = np.array([float(word) for word in (joint.findtext("axis/xyz") or "").split()])
        kinds = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
        at = frames[parent].actInv(frames[child]) if joint_of[parent] else frames[child]
        number = model.addJoint(
            joint_of[parent], kinds[joint.get("type", "")](axis), at, joint.get("name", "")
        )
        joint_of[child] = number
        inertial = links[child].find("inertial")
        assert inertial is not None
        numbers = {
            key: float(inertial.findtext(f"inertia/{key}") or "nan")
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        }
        moments = np.array([[numbers[f"i{min(a, b)}{max(a, b)}"] for b in "xyz"] for a in "xyz"])
        centre = placement(inertial.findtext("pose") or "")
        model.appendBodyToJoint(
            number, pin.Inertia(float(inertial.findtext("mass") or "nan"), np.zeros(3), moments), centre
        )
    data = model.createData()
    return np.array([pin.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])


def placement(text: str) -> pin.SE3:
    numbers = np.array([float(word) for word in text.split()])
    return pin.SE3(pin.rpy.rpyToMatrix(numbers[3:]), numbers[:3])
