"""Descriptions for the tests: random URDFs, a small arm with a gripper, and what other engines make of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import didim
from didim import Robot

Array = NDArray[np.float64]


def numbers(values: Array | Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def inertial_text(rng: np.random.Generator, rotated: bool = True) -> str:
    """Inertia of four point masses, about their centre, in a frame that is turned."""
    mass = rng.uniform(0.2, 2.0, 4)
    places = rng.uniform(-0.15, 0.15, (4, 3))
    centre = mass @ places / mass.sum()
    second = np.einsum("k,ki,kj->ij", mass, places - centre, places - centre)
    inertia = np.trace(second) * np.eye(3) - second
    angles = rng.uniform(-1.0, 1.0, 3) if rotated else np.zeros(3)
    turn = pin.rpy.rpyToMatrix(angles)
    inertia = turn.T @ inertia @ turn
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    moments = " ".join(f'{key}="{float(inertia[at])!r}"' for key, at in entries.items())
    return (
        f'<inertial><origin xyz="{numbers(centre)}" rpy="{numbers(angles)}"/>'
        f'<mass value="{float(mass.sum())!r}"/><inertia {moments}/></inertial>'
    )


def joint_text(
    name: str, kind: str, parent: str, child: str, *, xyz: Sequence[float] | Array = (0.0, 0.0, 0.0),
    rpy: Sequence[float] | Array = (0.0, 0.0, 0.0), axis: Sequence[float] | Array = (0.0, 0.0, 1.0), inside: str = "",
) -> str:  # fmt: skip
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{numbers(xyz)}" rpy="{numbers(rpy)}"/><axis xyz="{numbers(axis)}"/>{inside}</joint>'
    )


def limit_text(rng: np.random.Generator) -> str:
    velocity, effort = rng.uniform(1.0, 9.0, 2)
    return f'<limit lower="-3.1" upper="3.2" velocity="{float(velocity)!r}" effort="{float(effort)!r}"/>'


def random_urdf(
    rng: np.random.Generator, joints: int, *, right_angles: bool = False
) -> tuple[str, list[str]]:
    """A chain of any joints with fixed branches that carry inertia; its text and the names of its moving joints.

    The links and joints stand in any order in the file. With `right_angles`, all rotations are those of a cube.
    """
    parts = [f'<link name="base">{inertial_text(rng)}</link>']
    names: list[str] = []
    link = "base"

    def place() -> tuple[Array, Array]:
        xyz = rng.uniform(-0.5, 0.5, 3) * (rng.random(3) < 0.7)
        if right_angles or rng.random() < 0.3:
            return xyz, rng.integers(-1, 3, 3) * math.pi / 2
        return xyz, rng.uniform(-3.0, 3.0, 3)

    for j in range(joints):
        for k in range(int(rng.integers(0, 2))):  # fixed joints between the moving ones
            xyz, rpy = place()
            child = f"between_{j}_{k}"
            parts.append(f'<link name="{child}">{inertial_text(rng)}</link>')
            parts.append(joint_text(f"fix_{child}", "fixed", link, child, xyz=xyz, rpy=rpy))
            link = child
        xyz, rpy = place()
        axis = np.zeros(3)
        axis[rng.integers(3)] = rng.choice([-1.0, 1.0])
        if not right_angles and rng.random() < 0.3:
            axis = rng.normal(size=3)
        kind = str(rng.choice(["revolute", "continuous", "prismatic"], p=[0.6, 0.2, 0.2]))
        child, name = f"link_{j}", f"joint_{j}"
        parts.append(f'<link name="{child}">{inertial_text(rng)}</link>')
        parts.append(joint_text(name, kind, link, child, xyz=xyz, rpy=rpy, axis=axis, inside=limit_text(rng)))
        names.append(name)
        link = child
        if rng.random() < 0.5:
            xyz, rpy = place()
            parts.append(f'<link name="branch_{j}">{inertial_text(rng)}</link>')
            parts.append(joint_text(f"fix_branch_{j}", "fixed", link, f"branch_{j}", xyz=xyz, rpy=rpy))
    order = rng.permutation(len(parts))
    return '<robot name="random">\n' + "\n".join(parts[k] for k in order) + "\n</robot>\n", names


def random_tree(rng: np.random.Generator, joints: int) -> str:
    """A tree of revolute and prismatic joints, each on a moving link before it or on the base, with damping; a few fixed links."""
    parts = [f'<link name="base">{inertial_text(rng)}</link>']
    links = ["base"]
    for j in range(joints):
        # Often the link before, so that there are long branches too.
        parent = links[-1] if rng.random() < 0.6 else str(rng.choice(links))
        xyz = rng.uniform(-0.4, 0.4, 3) * (rng.random(3) < 0.7)
        rpy = rng.integers(-1, 3, 3) * math.pi / 2 if rng.random() < 0.4 else rng.uniform(-3.0, 3.0, 3)
        axis = np.zeros(3)
        axis[rng.integers(3)] = rng.choice([-1.0, 1.0])
        if rng.random() < 0.4:
            axis = rng.normal(size=3)
        kind = "revolute" if rng.random() < 0.7 else "prismatic"
        parts.append(f'<link name="link_{j}">{inertial_text(rng)}</link>')
        parts.append(
            joint_text(
                f"joint_{j}",
                kind,
                parent,
                f"link_{j}",
                xyz=xyz,
                rpy=rpy,
                axis=axis,
                inside=limit_text(rng),
            )
        )
        links.append(f"link_{j}")
        if rng.random() < 0.2:
            parts.append(f'<link name="cover_{j}">{inertial_text(rng)}</link>')
            parts.append(
                joint_text(f"fix_{j}", "fixed", f"link_{j}", f"cover_{j}", xyz=rng.uniform(-0.2, 0.2, 3))
            )
    return '<robot name="tree">' + "\n".join(parts) + "</robot>"


NASTY_JOINTS = (
    '<limit effort="0" velocity="0"/>',
    '<limit lower="0" upper="0" velocity="1e20" effort="inf"/>',
    '<calibration rising="0.0"/><safety_controller k_velocity="10"/>',
    '<mimic joint="no_such_joint" multiplier="2" offset="0"/>',
    '<mimic joint="stand still"/>',
    "<dynamics/><!-- <limit/> --><drake:rotor_inertia value='0.1'/>",
)
"""Elements inside joints that have no effect; a leader that stands still holds its followers."""

NASTY_PARTS = (
    '<material name="grau"><color rgba="0.5 0.5 0.5 1"/></material>',
    '<xacro:property name="width" value="0.2"/>',
    '<gazebo reference="none"><plugin filename="libnone.so"/></gazebo>',
    '<transmission name="t"><type>SimpleTransmission</type></transmission>',
    "<!-- ${left} < & --> <drake:loop_joint/>",
    "<link name='loose'/><link name='loose leaf'/><joint name='loose joint' type='revolute'>"
    "<parent link='loose'/><child link='loose leaf'/></joint>",
)
"""Elements beside the links and joints of the robot; the last is a separate tree."""


def nasty_tree(rng: np.random.Generator, joints: int) -> tuple[str, str]:
    """A tree as exporters and people write them, and the same for Pinocchio, with joints fixed that no robot moves."""
    links, nasty, clean = ["Grundplatte über 1"], [], []
    nasty.append(f'<link name="{links[0]}"/>')
    clean.append(nasty[0])
    fixed = joint_text("stand still", "fixed", links[0], "Fuß", xyz=(0.0, 0.0, 0.1))
    for parts in (nasty, clean):
        parts += [f'<link name="Fuß">{inertial_text(np.random.default_rng(joints))}</link>', fixed]
    for j in range(joints):
        parent = links[-1] if rng.random() < 0.5 else str(rng.choice(links))
        name, child = f"Gelenk {j} ({'lr'[j % 2]})", f"link/{j} 'é'"
        kind = str(rng.choice(["revolute", "continuous", "prismatic", "floating", "planar", "fixed", "universal"],
                              p=[0.5, 0.15, 0.15, 0.05, 0.05, 0.05, 0.05]))  # fmt: skip
        kind = kind if j else "revolute"  # something must move
        axis = rng.normal(size=3)
        axis *= rng.choice([1e-3, 1.0, 1e3]) / np.linalg.norm(axis)
        inside = str(rng.choice(NASTY_JOINTS)) if rng.random() < 0.4 else ""
        inside = inside if j else ""
        none = j > 0 and kind in ("revolute", "prismatic") and rng.random() < 0.05
        stands = none or kind not in ("revolute", "continuous", "prismatic") or "mimic" in inside
        place = {"xyz": rng.uniform(-0.4, 0.4, 3), "rpy": rng.uniform(-3.0, 3.0, 3)}
        written = np.zeros(3) if none else axis
        nasty.append(joint_text(name, kind, parent, child, axis=written, inside=inside, **place))
        clean.append(
            joint_text(
                name, "fixed" if stands else kind, parent, child, axis=axis, inside=limit_text(rng), **place
            )
        )
        body, drawn = inertial_text(rng), rng.random()
        shape = '<visual><geometry><mesh filename="package://none/a b.STL"/></geometry></visual>'
        half = '<inertial><mass value="nan"/><inertia ixx="0" iyy="0" izz="0"/></inertial>'
        alone = '<inertial><origin xyz="0 0 0"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>'
        if drawn < 0.15:  # not a body, and taken as it is
            body = body.replace('ixx="', 'ixx="-')
        broken = {0: half, 1: alone, 2: ""}.get(int((drawn - 0.15) / 0.05)) if drawn > 0.15 else None
        # Something must weigh, or there is nothing to compare.
        broken = broken if j else None
        nasty.append(f'<link name="{child}">{body if broken is None else broken}{shape}</link>')
        clean.append(f'<link name="{child}">{body if broken is None else ""}</link>')
        links.append(child)
    more = [str(part) for part in rng.permutation(NASTY_PARTS)[:3]]
    nasty = [str(part) for part in rng.permutation([*nasty, *more])]
    head = "\n  <?xml version='1.0' encoding='utf-8'?>\n" if rng.random() < 0.5 else ""
    return (
        f"{head}<robot name='Übung'>{''.join(nasty)}</robot>",
        f"<robot name='clean'>{''.join(clean)}</robot>",
    )


def pinocchio_model(text: str, names: Sequence[str], held: Mapping[str, float] | None = None) -> pin.Model:
    """The description in Pinocchio, with all joints but the named ones locked, at zero or where they are held."""
    model = pin.buildModelFromXML(text)
    locked = [model.getJointId(name) for name in model.names[1:] if name not in set(names)]
    place = pin.neutral(model)
    for name, value in (held or {}).items():
        if value:
            place[model.joints[model.getJointId(name)].idx_q] = value
    return pin.buildReducedModel(model, locked, place) if locked else model


def pinocchio_torques(model: pin.Model, names: Sequence[str], q: Array, dq: Array, ddq: Array) -> Array:
    """Torques by Pinocchio, (n_samples, n_dof), joints in the order of `names`."""
    joints = [model.joints[model.getJointId(name)] for name in names]
    data = model.createData()
    model.armature[:] = 0.0
    tau = np.zeros(q.shape)
    for sample in range(q.shape[0]):
        position, speed, acceleration = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for k, joint in enumerate(joints):
            angle = q[sample, k]
            if joint.nq == 2:  # continuous joints are a point on the circle
                position[joint.idx_q : joint.idx_q + 2] = math.cos(angle), math.sin(angle)
            else:
                position[joint.idx_q] = angle
            speed[joint.idx_v], acceleration[joint.idx_v] = dq[sample, k], ddq[sample, k]
        torque = pin.rnea(model, data, position, speed, acceleration)
        tau[sample] = [torque[joint.idx_v] for joint in joints]
    return tau


GRIPPER_ARM = """<?xml version="1.0"?>
<!-- An arm of three joints with a gripper of two fingers: the second mimics the first. -->
<robot name="little_arm">
  <link name="world"/>
  <joint name="stand" type="fixed">
    <parent link="world"/>
    <child link="base"/>
    <origin xyz="0 0 0.5" rpy="0 0 0"/>
  </joint>
  <link name="base">
    <inertial><mass value="9"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper_arm"/>
    <origin xyz="0 0 0.2" rpy="0 1.5708 0"/> <!-- rounded -->
    <axis xyz="0 1 0"/>
    <limit lower="-2" upper="2.5" velocity="3" effort="80"/>
    <dynamics damping="1.5" friction="0.75"/>
  </joint>
  <link name="upper_arm">
    <!-- <inertial> in a comment is not one -->
    <inertial>
      <origin xyz="0 0 0.15" rpy="0 0 0"/>
      <mass value="4"/>
      <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.01"/>
    </inertial>
    <visual><geometry><box size="0.1 0.1 0.3"/></geometry></visual>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="upper_arm"/>
    <child link="forearm"/>
    <origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" velocity="4" effort="40"/>
  </joint>
  <link name="forearm">
    <inertial>
      <origin xyz="0.01 0 0.1"/>
      <mass value="2.5"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.006"/>
    </inertial>
  </link>
  <joint name="wrist" type="continuous">
    <parent link="forearm"/>
    <child link="hand"/>
    <origin xyz="0 0 0.25"/>
    <axis xyz="0 0 1"/>
    <limit velocity="6" effort="9"/>
  </joint>
  <link name="hand">
    <inertial>
      <origin xyz="0 0 0.05"/>
      <mass value="0.8"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.001"/>
    </inertial>
  </link>
  <joint name="camera_mount" type="fixed">
    <parent link="hand"/>
    <child link="camera"/>
    <origin xyz="0.05 0 0.02" rpy="0 0.3 0"/>
  </joint>
  <link name="camera">
    <inertial><mass value="0.3"/><inertia ixx="0.0002" ixy="0" ixz="0" iyy="0.0002" iyz="0" izz="0.0002"/></inertial>
  </link>
  <joint name="finger_joint" type="prismatic">
    <parent link="hand"/>
    <child link="finger"/>
    <origin xyz="0 0 0.1"/>
    <axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" velocity="0.2" effort="20"/>
  </joint>
  <link name="finger">
    <inertial><mass value="0.1"/><inertia ixx="0.0001" ixy="0" ixz="0" iyy="0.0001" iyz="0" izz="0.0001"/></inertial>
  </link>
  <joint name="other_finger_joint" type="prismatic">
    <parent link="hand"/>
    <child link="other_finger"/>
    <origin xyz="0 0 0.1"/>
    <axis xyz="-1 0 0"/>
    <limit lower="0" upper="0.04" velocity="0.2" effort="20"/>
    <mimic joint="finger_joint"/>
  </joint>
  <link name="other_finger">
    <inertial><mass value="0.1"/><inertia ixx="0.0001" ixy="0" ixz="0" iyy="0.0001" iyz="0" izz="0.0001"/></inertial>
  </link>
  <gazebo reference="hand"><material>Gazebo/Grey</material></gazebo>
</robot>
"""
"""Text of a URDF with what real ones have: a stand, a rounded angle, a camera, a gripper with a mimic joint."""


def with_rotors(
    rng: np.random.Generator, robot: Robot, model: pin.Model, names: Sequence[str]
) -> tuple[Array, list[int]]:
    """Parameters of a robot with random rotors, which its model gets too; and the places of the named joints in the model."""
    places = [model.joints[model.getJointId(name)].idx_v for name in names]
    x, rotors = robot.parameter_set("urdf").copy(), rng.uniform(0.05, 0.5, len(names))
    x[[robot.parameter_names.index(f"Ia{j + 1}") for j in range(len(names))]] = rotors
    model.armature[places] = rotors
    return x, places


def made(tmp_path: Path, text: str, **options: object) -> Robot:
    """The whole tree of a URDF, as it is read."""
    path = tmp_path / "tree.urdf"
    path.write_text(text)
    return didim.load_robot(path, tip="", snap=0.0, **options)  # type: ignore[arg-type]


def legs(count: int, joints: int, seed: int = 0) -> str:
    """A body on the ground with legs of a few joints each."""
    rng = np.random.default_rng(seed)
    parts = [f'<link name="trunk">{inertial_text(rng)}</link>']
    for leg in range(count):
        parent = "trunk"
        for j in range(joints):
            child = f"leg{leg}_{j}"
            axis = (1.0, 0.0, 0.0) if j == 0 else (0.0, 1.0, 0.0)
            xyz = (
                (0.2 - 0.4 * (leg // 2), 0.1 - 0.2 * (leg % 2), 0.0)
                if j == 0
                else (0.0, 0.05 if j == 1 else 0.0, -0.2 * (j > 1))
            )
            parts.append(f'<link name="{child}">{inertial_text(rng)}</link>')
            parts.append(joint_text(f"{child}_joint", "revolute", parent, child, xyz=xyz, axis=axis))
            parent = child
    return f'<robot name="legs">{"".join(parts)}</robot>'  # fmt: skip
