"""Robots from MJCF against MuJoCo: orientations, defaults, inertias in all forms, anchors, reference positions and drives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import didim
from didim.errors import RobotError
from didim.experiment.specs import ControllerSpec, ReferenceSpec
from robots import random_motion, relative

MODEL = """
<mujoco model="little">
  <compiler angle="{angle}" eulerseq="{eulerseq}"/>
  <option gravity="1 -2 -9"/>
  <default>
    <joint damping="0.3" armature="0.02"/>
    <geom density="700"/>
    <default class="arm">
      <joint axis="0 1 0" frictionloss="0.4" range="{range}"/>
      <default class="slider"><joint type="slide" axis="0 0 2" range="-0.1 0.2"/></default>
    </default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <frame pos="0.1 0 0.2" euler="{euler}">
      <body name="trunk" pos="0 0 0.3" axisangle="0 1 0 {angle_value}" childclass="arm">
        <freejoint name="floating"/>
        <inertial pos="0 0.01 0" mass="5" diaginertia="0.1 0.1 0.1"/>
        <body name="left" pos="0.1 0.2 0" euler="{euler}">
          <joint name="left_1"/>
          <inertial pos="0.1 0 0.02" quat="0.9 0.1 -0.2 0.3" mass="1.5" diaginertia="0.02 0.03 0.04"/>
          <body name="left_end" pos="0.3 0 0" xyaxes="0 1 0 -1 0 0.1">
            <joint name="left_2" axis="1 0.2 0" pos="0.05 -0.02 0.01" ref="{ref}" armature="0.5"/>
            <inertial pos="0 0 0.1" mass="0.7" fullinertia="0.01 0.012 0.014 0.001 -0.002 0.0005"/>
          </body>
        </body>
        <body name="right" pos="0.1 -0.2 0" zaxis="0.3 0.2 -1">
          <joint name="right_1" class="slider"/>
          <joint name="right_2"/>
          <geom type="capsule" size="0.05 0.2" pos="0.1 0 0" euler="{euler}"/>
          <geom type="box" size="0.1 0.05 0.02" mass="0.4"/>
          <geom type="cylinder" fromto="0 0 0 0.1 0.2 0.3" size="0.03"/>
          <frame pos="0 0.1 0"><geom type="ellipsoid" size="0.05 0.04 0.03" density="900"/></frame>
          <body name="tip" pos="0 0 0.2"><geom size="0.04"/></body>
        </body>
      </body>
    </frame>
  </worldbody>
  <actuator>
    <motor joint="left_1" gear="10" ctrlrange="-3 3"/>
    <position joint="left_2" kp="50" kv="2" forcerange="-7 7"/>
  </actuator>
</mujoco>
"""


def text(degrees: bool, eulerseq: str = "xyz") -> str:
    values = {"euler": "20 -30 50", "angle_value": "25", "range": "-90 45", "ref": "40"}
    if not degrees:
        values = {
            key: " ".join(repr(float(np.radians(float(word)))) for word in value.split())
            for key, value in values.items()
        }
    return MODEL.format(angle="degree" if degrees else "radian", eulerseq=eulerseq, **values)


def compare(robot: didim.Robot, model: mujoco.MjModel) -> None:
    """Torques without friction and M(q) at random states, joints by name, everything else held where the file draws it."""
    n = robot.n_dof
    x = robot.parameter_set("mjcf").copy()
    x[[name.startswith("F") for name in robot.parameter_names]] = 0.0
    motion = random_motion(np.random.default_rng(0), 10, n)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    M = didim.inertia_matrix(robot, motion.q, x)
    data = mujoco.MjData(model)
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in robot.joint_names]
    speeds = [model.jnt_dofadr[index] for index in ids]
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    for k in range(len(motion.q)):
        mujoco.mj_resetData(model, data)
        for joint, index in enumerate(ids):
            data.qpos[model.jnt_qposadr[index]] = motion.q[k, joint]
        data.qvel[speeds] = motion.dq[k]
        data.qacc[speeds] = motion.ddq[k]
        mujoco.mj_inverse(model, data)
        expected = data.qfrc_inverse[speeds]
        assert relative(tau[k] - expected, expected) < 1e-9
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        expected = matrix[np.ix_(speeds, speeds)]
        assert relative(M[k] - expected, expected) < 1e-9


@pytest.mark.parametrize(
    ("degrees", "eulerseq"), [(True, "xyz"), (False, "zyx"), (True, "XYZ"), (False, "zXy")]
)
def test_everything_is_read_as_mujoco_reads_it(tmp_path: Path, degrees: bool, eulerseq: str) -> None:
    path = tmp_path / "little.xml"
    path.write_text(text(degrees, eulerseq))
    robot = didim.load_robot(path, snap=0.0)
    assert robot.joint_names == ("left_1", "left_2", "right_1", "right_2")
    assert robot.geometry.parents == (None, 0, None, 2)
    compare(robot, mujoco.MjModel.from_xml_path(str(path)))
    values = dict(zip(robot.parameter_names, robot.parameter_set("mjcf"), strict=True))
    assert [values[f"Ia{j}"] for j in (1, 2, 3, 4)] == [0.02, 0.5, 0.02, 0.02]
    assert [values[f"Fv{j}"] for j in (1, 2, 3, 4)] == [0.3] * 4
    assert [values[f"Fc{j}"] for j in (1, 2, 3, 4)] == [0.4] * 4
    assert [limits.effort for limits in robot.limits] == [30.0, 7.0, None, None]
    np.testing.assert_allclose(robot.limits[0].position or (), [-np.pi / 2, np.pi / 4], rtol=1e-15)
    assert robot.limits[2].position == (-0.1, 0.2)
    assert any(
        "held at the pose of the file" in note and "floating (floating)" in note for note in robot.notes
    )


SPRUNG = """
<mujoco><compiler angle="{angle}"/><default><joint stiffness="3" axis="0 1 0"/></default>
<worldbody><body name="a"><joint name="j1" springref="{angles[0]}" ref="{angles[1]}"/><geom size="0.1" pos="0.2 0 0"/>
<body name="b" pos="0.3 0 0"><joint name="j2" type="slide" axis="1 0 0" stiffness="5" springref="0.1"/><geom size="0.1"/>
<body name="c" pos="0.2 0.1 0"><joint name="j3" stiffness="0"/><geom size="0.1" pos="0.1 0 0"/></body></body></body></worldbody>
{tied}</mujoco>
"""
TIED = '<equality><joint joint1="j2" joint2="j1" polycoef="0.1 0.5 0 0 0"/></equality>'


def sprung(path: Path, angle: str = "degree", tied: str = "") -> mujoco.MjModel:
    """Write a file with springs; MuJoCo's model of it, without contacts."""
    angles = (20.0, 30.0) if angle == "degree" else np.radians([20.0, 30.0]).tolist()
    path.write_text(SPRUNG.format(angle=angle, angles=angles, tied=tied))
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return model


def by_mujoco(model: mujoco.MjModel, states: list[np.ndarray]) -> np.ndarray:
    data, found = mujoco.MjData(model), []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(*states, strict=True):
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse.copy())
    return np.array(found)


@pytest.mark.parametrize("angle", ["degree", "radian"])
def test_springs_are_read_and_written_as_mujoco_has_them(tmp_path: Path, angle: str) -> None:
    path = tmp_path / "sprung.xml"
    model = sprung(path, angle)
    robot = didim.load_robot(path)
    x = robot.parameter_set("mjcf")
    assert robot.parameter_names[-2:] == ("Ks1", "Ks2")
    motion = random_motion(np.random.default_rng(0), 10, 3)
    states = [motion.q, motion.dq, motion.ddq]
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    np.testing.assert_allclose(tau, by_mujoco(model, states), rtol=1e-9, atol=1e-9)
    # Out, and in again.
    path.write_text(didim.export.to_mjcf(robot, x))
    again = didim.load_robot(path)
    np.testing.assert_allclose(again.parameter_set("mjcf"), x, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        by_mujoco(mujoco.MjModel.from_xml_path(str(path)), states), tau, rtol=1e-9, atol=1e-9
    )


def test_the_spring_of_a_coupled_joint_acts_on_its_leader(tmp_path: Path) -> None:
    """The torque of the leader is its own plus the slope of the equality times the force of the coupled joint."""
    path = tmp_path / "tied.xml"
    model = sprung(path, tied=TIED)
    robot = didim.load_robot(path)
    values = dict(zip(robot.parameter_names, robot.parameter_set("mjcf"), strict=True))
    assert values["Ks1"] == pytest.approx(3.0 + 0.5**2 * 5.0)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (10, 2))
    zero = np.zeros_like(q)
    # Positions of an equality are relative to the pose in which the file draws the joints.
    slide = 0.1 + 0.5 * (q[:, 0] - np.radians(30.0))
    whole = np.column_stack([q[:, 0], slide, q[:, 1]])
    theirs = by_mujoco(model, [whole, np.zeros_like(whole), np.zeros_like(whole)])
    want = np.column_stack([theirs[:, 0] + 0.5 * theirs[:, 1], theirs[:, 2]])
    np.testing.assert_allclose(
        didim.inverse_dynamics(robot, q, zero, zero, robot.parameter_set("mjcf")), want, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize(
    ("attributes", "default"),
    [
        ("", ""),
        ('solreffriction="0.005 1"', ""),
        ('solreffriction="0.005"', 'solimpfriction="0.8"'),
        ("", 'solreffriction="0.03 1" solimpfriction="0.99 0.999 0.001"'),
        ('solreffriction="-100 -40"', 'solimpfriction="0.5 0.7"'),
        ('solreffriction="0.01 -40"', ""),
        ('solimpfriction="0 1.5"', ""),
    ],
)
def test_the_softness_of_friction_is_that_of_mujoco(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attributes: str, default: str
) -> None:
    """Slopes and rates of the constraints that MuJoCo assembles, with the classes of the file."""
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings in the current folder
    text = f"""<mujoco><compiler angle="radian"/>
    <default><joint frictionloss="0.3" armature="0.01"/><default class="soft"><joint {default}/></default></default>
    <worldbody><body><inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
    <joint name="a" axis="0 1 0" class="soft" {attributes}/>
    <body pos="0 0 0.3"><inertial pos="0.05 0 0.1" mass="0.5" diaginertia="0.002 0.002 0.002"/>
    <joint name="b" axis="0 1 0"/></body></body></worldbody></mujoco>"""
    path = tmp_path / "soft.xml"
    path.write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    robot = didim.load_robot(path)
    m = didim.inertia_matrix(robot, np.zeros((1, 2)), robot.parameter_set("mjcf"))[0]
    creep, rest = np.transpose(robot.softness)
    assert not any("friction" in note for note in robot.notes)
    np.testing.assert_allclose(1.0 / rest, data.efc_KBIP[:2, 1], rtol=1e-9)
    np.testing.assert_allclose(rest / (creep * np.diag(np.linalg.inv(m))), 1.0 / data.efc_R[:2], rtol=1e-6)


def test_nonlinear_springs_springs_of_tendons_and_joints_nailed_down_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "sprung.xml"
    tendon = '<tendon><fixed name="rope" stiffness="2"><joint joint="j1" coef="1"/></fixed></tendon>'
    text = SPRUNG.format(angle="degree", angles=(20, 30), tied=tendon)
    path.write_text(text.replace('stiffness="5"', 'stiffness="5 1 0"').replace('"0"', '"0" damping="1e11"'))
    robot = didim.load_robot(path)
    assert robot.joint_names == ("j1", "j2")
    notes = " ".join(robot.notes)
    assert "j3 (revolute with a damping of 1e11)" in notes
    assert "nonlinear parts are left out: stiffness of j2" in notes
    assert "springs of tendons are left out: rope" in notes
    path.write_text(text.replace('"0"', '"0" damping="nan"'))
    with pytest.raises(RobotError, match="damping of <joint> must be 1 number"):
        didim.load_robot(path)


def test_masses_by_group_and_in_total_and_the_world_are_read_as_mujoco_reads_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its warnings
    path = tmp_path / "little.xml"
    given = text(True).replace('eulerseq="xyz"', 'eulerseq="xyz" inertiagrouprange="1 2" settotalmass="20"')
    given = given.replace('density="700"', 'density="700" group="2"').replace(
        'mass="0.4"', 'mass="0.4" group="3"'
    )
    path.write_text(given.replace('-9"/>', '-9" viscosity="0.1"><flag gravity="disable"/></option>'))
    robot = didim.load_robot(path, snap=0.0)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.viscosity = 0.0
    compare(robot, model)
    assert model.body_mass.sum() == pytest.approx(20.0)
    notes = " ".join(robot.notes)
    assert "gravity is disabled" in notes
    assert "forces of the fluid are left out" in notes


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'name="right_1" class="slider"',
            'name="right_1" class="slide"',
            "there is no default class 'slide'",
        ),
        ('mass="5"', 'mass="five"', "mass of <inertial> must be 1 number of at most 1e+09, got 'five'"),
        ('eulerseq="xyz"', 'eulerseq="xyw"', "eulerseq must be three letters of x, y and z, got 'xyw'"),
        ('eulerseq="xyz"', 'inertiagrouprange="1"', "must be two integers"),
        ('<frame pos="0 0.1 0">', '<replicate count="2"/><frame pos="0 0.1 0">', "<replicate> is not read"),
        ('name="tip"', 'name="left"', "there are two bodies 'left'"),
        ('<geom size="0.04"/>', '<geom size="0"/>', "the size of a sphere must be 1 positive numbers"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "little.xml"
    path.write_text(text(True).replace(old, new))
    with pytest.raises(RobotError) as error:
        didim.load_robot(path)
    assert str(error.value).startswith("little.xml: ")
    assert message in str(error.value)
    assert len(str(error.value)) <= 200


def test_an_included_file_stands_in_its_place(tmp_path: Path) -> None:
    whole = text(True)
    start, end = whole.index("<default>"), whole.index("<worldbody>")
    (tmp_path / "defaults.xml").write_text(f"<mujocoinclude>{whole[start:end]}</mujocoinclude>")
    path, parts = tmp_path / "whole.xml", tmp_path / "parts.xml"
    path.write_text(whole)
    parts.write_text(whole[:start] + '<include file="defaults.xml"/>' + whole[end:])
    one, other = didim.load_robot(path, snap=0.0), didim.load_robot(parts, snap=0.0)
    np.testing.assert_array_equal(one.parameter_set("mjcf"), other.parameter_set("mjcf"))
    # Bodies of a file of their own, inside <worldbody>, and files in a folder, relative to the main file.
    first, last = whole.index('<body name="left"'), whole.index('<body name="right"')
    (tmp_path / "bodies").mkdir()
    (tmp_path / "bodies" / "arm.xml").write_text('<mujoco><include file="bodies/links.xml"/></mujoco>')
    (tmp_path / "bodies" / "links.xml").write_text(f"<mujocoinclude>{whole[first:last]}</mujocoinclude>")
    parts.write_text(whole[:first] + '<include file="bodies/arm.xml"/>' + whole[last:])
    other = didim.load_robot(parts, snap=0.0)
    np.testing.assert_array_equal(one.parameter_set("mjcf"), other.parameter_set("mjcf"))
    (tmp_path / "bodies" / "links.xml").write_text('<mujoco><include file="bodies/arm.xml"/></mujoco>')
    with pytest.raises(RobotError, match=r"links.xml: line 1: arm.xml includes itself"):
        didim.load_robot(parts)
    (tmp_path / "bodies" / "links.xml").unlink()
    with pytest.raises(RobotError, match=r"arm.xml: line 1: .*links.xml: no such file"):
        didim.load_robot(parts)


def test_the_go2_of_mujoco(shared: Path) -> None:
    path = shared / "data" / "go2" / "go2.xml"
    robot = didim.load_robot(path)
    assert robot.n_dof == 12
    assert robot.joint_names[:3] == ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint")
    assert [limits.effort for limits in robot.limits[:3]] == [23.7, 23.7, 45.43]
    values = dict(zip(robot.parameter_names, robot.parameter_set("mjcf"), strict=True))
    assert (values["Ia1"], values["Fv1"], values["Fc1"]) == (0.01, 0.6, 0.2)
    assert any("floating" in note for note in robot.notes)


ACTUATED = """
<mujoco>
  <compiler autolimits="{auto}"/>
  <default>
    <position kp="40" kv="0.5" forcerange="-9 8"/>
    <default class="big"><general gear="3"/></default>
    <default class="torque"><motor ctrlrange="-6 5"/></default>
    <default class="saved"><general biastype="affine" gainprm="70" biasprm="0 -70 -2"/></default>
  </default>
  <worldbody>
    <body name="a"><joint name="j1"/><geom size="0.1"/>
    <body name="b" pos="0.1 0 0"><joint name="j2" actuatorfrcrange="-4 4"/><geom size="0.1"/>
    <body name="c" pos="0.1 0 0"><joint name="j3"/><geom size="0.1"/>
    <body name="d" pos="0.1 0 0"><joint name="j4"/><geom size="0.1"/>
    <body name="e" pos="0.1 0 0"><joint name="j5"/><geom size="0.1"/></body></body></body></body></body>
  </worldbody>
  <actuator>
    <position joint="j1" class="big"/>
    <position joint="j2" kp="30" kv="1.5" timeconst="0.02" forcelimited="true"/>
    <motor joint="j3" class="torque" gear="-2" ctrllimited="true"/>
    <general joint="j4" class="saved" forcerange="-3 3" forcelimited="false"/>
    {last}
  </actuator>
</mujoco>
"""


def compiled_gains(model: mujoco.MjModel) -> list[tuple[float | None, float | None, float | None, float]]:
    """Gains, limit and filter of each joint as MuJoCo has compiled them, behind the gear."""
    found = []
    for k in range(model.nu):
        gear = abs(model.actuator_gear[k, 0])
        gain, bias = model.actuator_gainprm[k, 0], model.actuator_biasprm[k]
        position = bool(model.actuator_biastype[k]) and bias[1] == -gain
        limits = []
        if model.actuator_forcelimited[k]:
            limits.append(gear * np.abs(model.actuator_forcerange[k]).max())
        elif not model.actuator_biastype[k] and model.actuator_ctrllimited[k]:
            limits.append(gear * gain * np.abs(model.actuator_ctrlrange[k]).max())
        joint = model.actuator_trnid[k, 0]
        if model.jnt_actfrclimited[joint]:
            limits.append(np.abs(model.jnt_actfrcrange[joint]).max())
        found.append(
            (
                gear**2 * gain if position else None,
                -(gear**2) * bias[2] if position else None,
                min(limits, default=None),
                model.actuator_dynprm[k, 0] if model.actuator_dyntype[k] else 0.0,
            )
        )
    return found


@pytest.mark.parametrize("auto", ["true", "false"])
@pytest.mark.parametrize(
    "last", ['<velocity joint="j5" kv="3"/>', '<position joint="j5" gear="0.5" forcelimited="true"/>']
)
@pytest.mark.parametrize("saved", [False, True])
def test_actuators_are_read_as_mujoco_reads_them(tmp_path: Path, auto: str, last: str, saved: bool) -> None:
    path = tmp_path / "driven.xml"
    driven = ACTUATED.format(auto=auto, last=last)
    if auto == "false":
        for limits, switch in (("actuatorfrcrange", "actuatorfrclimited"), ("forcerange", "forcelimited")):
            driven = driven.replace(f' {limits}="', f' {switch}="true" {limits}="', 1)
        driven = driven.replace('"-6 5"', '"-6 5" ctrllimited="false"')
    path.write_text(driven)
    model = mujoco.MjModel.from_xml_path(str(path))
    if saved:
        mujoco.mj_saveLastXML(str(path), model)
    robot = didim.load_robot(path)
    read = [(a.kp, a.kv, a.effort, a.lag_s) for a in robot.actuators if a is not None]
    for ours, theirs in zip(read, compiled_gains(model), strict=True):
        assert [value is None for value in ours] == [value is None for value in theirs]
        np.testing.assert_allclose(
            [value or 0.0 for value in ours], [value or 0.0 for value in theirs], rtol=1e-5
        )
    assert [limits.effort for limits in robot.limits] == [a.effort for a in robot.actuators if a is not None]


def controller_of(path: Path) -> didim.Controller:
    experiment = didim.load_experiment(path)
    assert isinstance(experiment.controller, ControllerSpec)
    assert isinstance(experiment.reference, ReferenceSpec)
    assert experiment.reference.made is not None
    return experiment.controller.build(experiment.reference.made)


def test_gains_of_actuators_are_those_of_a_controller_without_its_own(tmp_path: Path) -> None:
    last = '<position joint="j5" kp="11"/>'
    text = ACTUATED.format(auto="true", last=last).replace(
        '<motor joint="j3" class="torque" gear="-2" ctrllimited="true"/>', '<position joint="j3"/>'
    )
    (tmp_path / "driven.xml").write_text(text.replace('forcerange="-9 8"', "", 1))
    path = tmp_path / "run.toml"
    loop = (
        "schema = 1\nrobot = 'driven.xml'\n[reference]\nkind = 'fourier'\nperiod_s = 5.0\n"
        "sine_rad = [[0.1, 0.1, 0.1, 0.1, 0.1]]\ncosine_rad = [[0, 0, 0, 0, 0]]\n[controller]\nkind = 'pd'\n"
    )
    path.write_text(loop)
    controller = controller_of(path)
    kp, kv = [360.0, 30.0, 40.0, 70.0, 11.0], [4.5, 1.5, 0.5, 2.0, 0.5]
    np.testing.assert_allclose(controller.laws[:, 0], kp)
    np.testing.assert_allclose(controller.laws[:, 1], kv)
    np.testing.assert_allclose(controller.laws[:, 4], 0.0)  # they damp the motion itself
    np.testing.assert_allclose(controller.saturation, [np.inf, 4.0, np.inf, np.inf, np.inf])
    path.write_text(f"{loop}kp = 5\nkv = 1\nsaturation_n_m = 2\n")
    own = controller_of(path)
    np.testing.assert_allclose([own.laws[0, 0], own.laws[0, 4], own.saturation[0]], [5.0, 1.0, 2.0])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kp="30"', 'kp="stiff"', "kp of <position> must be numbers, got 'stiff'"),
        ('class="saved" f', 'class="lost" f', "there is no default class 'lost'"),
        ('gear="-2"', 'gear="two"', "ranges and gear of the actuator of 'j3' must be numbers"),
    ],
)
def test_wrong_actuators_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "driven.xml"
    path.write_text(ACTUATED.format(auto="true", last="").replace(old, new))
    with pytest.raises(RobotError, match=message):
        didim.load_robot(path)


def test_a_damping_ratio_is_left_to_mujoco(tmp_path: Path) -> None:
    path = tmp_path / "driven.xml"
    path.write_text(
        ACTUATED.format(auto="true", last='<position joint="j5" dampratio="1"/><dcmotor joint="j4"/>')
    )
    robot = didim.load_robot(path)
    assert robot.actuators[4] is not None
    assert (robot.actuators[4].kp, robot.actuators[4].kv) == (40.0, None)
    assert any("kv of the actuator of j5" in note and "<dcmotor> of j4" in note for note in robot.notes)
