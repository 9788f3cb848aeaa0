"""Robots from MJCF: values of everything that is read, missing meshes, closed loops, robot files, and files that are refused.

``tests/test_mjcf_features.py`` compares one feature at a time with MuJoCo.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import RobotError
from didim.experiment.specs import ControllerSpec, ReferenceSpec
from didim.robot.robot_file import check_closed
from didim.robot.robot_text import robot_text
from didim.robot.transmission import SOFTNESS
from didim.robot.urdf.mjcf_compiler import DEEPEST, MOST_ELEMENTS, MOST_FILES, MOST_OF
from robots import random_motion
from scripts import one_line

MODEL = """
<mujoco model="little">
  <option gravity="1 -2 -9"><flag gravity="enable"/></option>
  <default>
    <joint damping="0.3" armature="0.02"/>
    <default class="arm"><joint axis="0 1 0" frictionloss="0.4" range="-90 45"/>
      <default class="slider"><joint type="slide" axis="0 0 2" range="-0.1 0.2"/></default></default>
  </default>
  <worldbody>
    <body name="trunk" pos="0 0 0.3" childclass="arm"><freejoint name="floating"/>
      <inertial pos="0 0.01 0" mass="5" diaginertia="0.1 0.1 0.1"/>
      <body name="left"><joint name="left_1"/><geom size="0.1" pos="0.1 0 0"/>
        <body name="left_end" pos="0.3 0 0"><joint name="left_2" armature="0.5"/><geom size="0.1" pos="0.1 0 0"/></body></body>
      <body name="right"><joint name="right_1" class="slider"/><joint name="right_2"/><geom size="0.1" pos="0.1 0 0"/>
        <body name="tip" pos="0 0 0.2"><geom size="0.04"/></body></body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="left_1" gear="10" ctrlrange="-3 3"/>
    <position joint="left_2" kp="50" kv="2" forcerange="-7 7" timeconst="0.04"/>
  </actuator>
</mujoco>
"""


def written(folder: Path, text: str, name: str = "little.xml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def refusal(path: Path, **options: object) -> str:
    with pytest.raises(RobotError) as error:
        didim.load_robot(path, **options)  # type: ignore[arg-type]
    message = str(error.value)
    assert len(message) <= 250
    assert "\n" not in message
    return message


def test_values_and_names_of_everything_that_is_read(tmp_path: Path) -> None:
    robot = didim.load_robot(written(tmp_path, MODEL))
    assert robot.name == "little"
    assert robot.joint_names == ("left_1", "left_2", "right_1", "right_2")
    assert robot.geometry.parents == (None, 0, None, 2)
    values = dict(zip(robot.parameter_names, robot.parameter_set("mjcf"), strict=True))
    assert [values[f"Ia{j}"] for j in (1, 2, 3, 4)] == [0.02, 0.5, 0.02, 0.02]
    assert [values[f"Fv{j}"] for j in (1, 2, 3, 4)] == [0.3] * 4
    assert [values[f"Fc{j}"] for j in (1, 2, 3, 4)] == [0.4] * 4
    assert [limits.effort for limits in robot.limits] == [30.0, 7.0, None, None]
    np.testing.assert_allclose(robot.limits[0].position or (), [-np.pi / 2, np.pi / 4], rtol=1e-15)
    assert robot.limits[2].position == (-0.1, 0.2)
    assert robot.actuators == (
        didim.robot.transmission.Actuator(effort=30.0),
        didim.robot.transmission.Actuator(kp=50.0, kv=2.0, effort=7.0, lag_s=0.04),
        None,
        None,
    )
    (note,) = robot.notes
    assert "held at the pose of the file" in note
    assert "floating (floating)" in note


def test_disabled_gravity_is_zero_and_named(tmp_path: Path) -> None:
    robot = didim.load_robot(written(tmp_path, MODEL.replace('"enable"', '"disable"')))
    assert robot.geometry.gravity == (0.0, 0.0, 0.0)
    assert any("gravity is disabled" in note for note in robot.notes)


SPRUNG = """
<mujoco><default><joint stiffness="3" axis="0 1 0"/></default><worldbody>
<body name="a"><joint name="j1" springref="20" ref="30"/><geom size="0.1" pos="0.2 0 0"/>
<body name="b" pos="0.3 0 0"><joint name="j2" type="slide" axis="1 0 0" stiffness="5" springref="0.1"/><geom size="0.1"/>
<body name="c" pos="0.2 0.1 0"><joint name="j3" stiffness="0"/><geom size="0.1" pos="0.1 0 0"/></body></body></body></worldbody>
</mujoco>
"""


def test_springs_are_read_back_from_an_export(tmp_path: Path) -> None:
    path = written(tmp_path, SPRUNG)
    robot = didim.load_robot(path)
    x = robot.parameter_set("mjcf")
    assert robot.parameter_names[-2:] == ("Ks1", "Ks2")
    motion = random_motion(np.random.default_rng(0), 10, 3)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    path.write_text(didim.export.to_mjcf(robot, x))
    np.testing.assert_allclose(didim.load_robot(path).parameter_set("mjcf"), x, rtol=1e-12, atol=1e-12)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    for k in range(10):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.q[k], motion.dq[k], motion.ddq[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse, tau[k], rtol=1e-9, atol=1e-9)


def test_the_coupled_wrist_of_an_export_is_read_back(tmp_path: Path) -> None:
    """Tendons are motors of the coupling matrix again, with their rotor and friction."""
    robot = didim.load_robot("tx40")
    x = robot.parameter_set("didim_physical")
    again = didim.load_robot(written(tmp_path, didim.export.to_mjcf(robot, x)))
    assert again.geometry.coupling == robot.geometry.coupling
    read = again.parameter_set("mjcf")
    motion = random_motion(np.random.default_rng(0), 10, 6)
    offset = np.where([name.startswith("Off") for name in robot.parameter_names], 0.0, x)
    np.testing.assert_allclose(
        didim.inverse_dynamics(again, motion.q, motion.dq, motion.ddq, read),
        didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, offset),
        rtol=1e-9,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        didim.inertia_matrix(again, motion.q, read), didim.inertia_matrix(robot, motion.q, x), atol=1e-12
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
    """Slopes and rates of the constraints that MuJoCo assembles, from the file and from the robot file made of it."""
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings in the current folder
    text = f"""<mujoco><compiler angle="radian"/>
    <default><joint frictionloss="0.3" armature="0.01"/><default class="soft"><joint {default}/></default></default>
    <worldbody><body><inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
    <joint name="a" axis="0 1 0" class="soft" {attributes}/>
    <body pos="0 0 0.3"><inertial pos="0.05 0 0.1" mass="0.5" diaginertia="0.002 0.002 0.002"/>
    <joint name="b" axis="0 1 0"/></body></body></worldbody></mujoco>"""
    path = written(tmp_path, text)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    robot = didim.load_robot(path)
    m = didim.inertia_matrix(robot, np.zeros((1, 2)), robot.parameter_set("mjcf"))[0]
    creep, rest = np.transpose(robot.softness or [SOFTNESS] * 2)
    np.testing.assert_allclose(1.0 / rest, data.efc_KBIP[:2, 1], rtol=1e-9)
    np.testing.assert_allclose(rest / (creep * np.diag(np.linalg.inv(m))), 1.0 / data.efc_R[:2], rtol=1e-6)
    assert didim.load_robot(written(tmp_path, robot_text(robot), "little.toml")).softness == robot.softness


def test_an_included_file_stands_in_its_place(tmp_path: Path) -> None:
    whole = MODEL
    start, end = whole.index("<default>"), whole.index("<worldbody>")
    (tmp_path / "defaults.xml").write_text(f"<mujocoinclude>{whole[start:end]}</mujocoinclude>")
    first, last = whole.index('<body name="left"'), whole.index('<body name="right"')
    (tmp_path / "bodies").mkdir()
    (tmp_path / "bodies" / "arm.xml").write_text(
        '<mujocoinclude><include file="bodies/links.xml"/></mujocoinclude>'
    )
    (tmp_path / "bodies" / "links.xml").write_text(f"<mujocoinclude>{whole[first:last]}</mujocoinclude>")
    text = (
        whole[:start]
        + '<include file="defaults.xml"/>'
        + whole[end:first]
        + '<include file="bodies/arm.xml"/>'
        + whole[last:]
    )
    parts = written(tmp_path, text, "parts.xml")
    one, other = didim.load_robot(written(tmp_path, whole)), didim.load_robot(parts)
    np.testing.assert_array_equal(one.parameter_set("mjcf"), other.parameter_set("mjcf"))
    parts.write_text(text.replace("</worldbody>", '<include file="bodies/arm.xml"/></worldbody>'))
    assert refusal(parts).endswith("arm.xml is included twice, which MuJoCo refuses")
    parts.write_text(text)
    (tmp_path / "bodies" / "links.xml").write_text(
        '<mujocoinclude><include file="bodies/arm.xml"/></mujocoinclude>'
    )
    assert refusal(parts) == "links.xml: line 1: arm.xml includes itself"
    (tmp_path / "bodies" / "links.xml").unlink()
    assert refusal(parts).startswith("arm.xml: line 1: ")


def test_an_attached_model_is_read(tmp_path: Path) -> None:
    written(tmp_path, SPRUNG, "part.xml")
    text = (
        '<mujoco><asset><model name="part" file="part.xml"/></asset><worldbody><body name="base"><geom size="0.1"/>'
        '<joint name="turn" axis="0 0 1"/><frame pos="0 0 0.5"><attach model="part" body="a" prefix="p_"/></frame></body>'
        "</worldbody></mujoco>"
    )
    robot = didim.load_robot(written(tmp_path, text))
    assert robot.joint_names == ("turn", "p_j1", "p_j2", "p_j3")
    written(tmp_path, text.replace('"part.xml"', '"loop.xml"'), "loop.xml")
    assert refusal(tmp_path / "loop.xml") == "loop.xml: line 1: loop.xml includes itself"


def test_bombs_of_includes_and_models_are_refused(tmp_path: Path) -> None:
    """A row of includes, deeper than MuJoCo's stack would bear, and models of which each attaches the next one twice."""
    body = '<body name="a"><joint/><geom size="0.1"/></body>'
    for k in range(2 * DEEPEST):
        written(tmp_path, f'<mujocoinclude><include file="row{k + 1}.xml"/></mujocoinclude>', f"row{k}.xml")
    for k in range(30):
        models = "".join(f'<model name="m{i}" file="twice{k + 1}.xml"/>' for i in (1, 2))
        text = f"<mujoco><asset>{models}</asset><worldbody>{body}</worldbody></mujoco>"
        written(
            tmp_path, text if k < 29 else f"<mujoco><worldbody>{body}</worldbody></mujoco>", f"twice{k}.xml"
        )
    row = written(tmp_path, '<mujoco><include file="row0.xml"/></mujoco>')
    assert refusal(row).endswith(f"an MJCF has at most {MOST_FILES} parts, {DEEPEST} deep, and this has more")
    assert refusal(tmp_path / "twice0.xml").endswith(
        f"more than {MOST_OF['body']} elements <body>; cut the robot out of it"
    )


MESHED = """<mujoco><asset><mesh name="m" file="{mesh}"/><texture name="t" type="2d" file="gone.png"/>
<material name="c" texture="t"/></asset><worldbody><body name="fixed"><geom type="mesh" mesh="m" material="c"/></body>
<body name="a"><joint name="j1" axis="0 1 0" armature="0.1"/><geom type="{kind}" mesh="m"/>{explicit}<body name="b" pos="0 0 0.3">
<joint name="j2" axis="0 1 0"/><geom size="0.1" pos="0.1 0 0"/></body></body></worldbody>
<actuator><position joint="j2" kp="5" dampratio="1"/></actuator></mujoco>"""
TETRAHEDRON = "v 0 0 0\nv 0.2 0 0\nv 0 0.3 0\nv 0 0 0.4\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize("kind", ["mesh", "box"])
def test_a_missing_mesh_that_a_mass_comes_from_takes_the_set_away(tmp_path: Path, kind: str) -> None:
    (tmp_path / "solid.obj").write_text(TETRAHEDRON)
    there = didim.load_robot(written(tmp_path, MESHED.format(mesh="solid.obj", kind=kind, explicit="")))
    model = mujoco.MjModel.from_xml_string(
        MESHED.format(mesh="solid.obj", kind=kind, explicit="").replace(
            'file="gone.png"', 'builtin="flat" width="1" height="1"'
        ),
        {"solid.obj": TETRAHEDRON.encode()},
    )
    mass = dict(zip(there.parameter_names, there.parameter_set("mjcf"), strict=True))["M1"]
    assert mass == pytest.approx(model.body("a").mass[0], rel=1e-12)
    path = written(tmp_path, MESHED.format(mesh="gone.stl", kind=kind, explicit=""))
    without = didim.load_robot(path)
    assert not without.sets
    assert "these bodies lack mass: a; there is no parameter set 'mjcf'" in " ".join(without.notes)
    assert without.joint_names == there.joint_names
    # Its gains are read, but not the one that needs the inertia.
    assert without.actuators[1] == didim.robot.transmission.Actuator(kp=5.0)
    assert "kv of j2 is not known" in " ".join(without.notes)
    explicit = '<inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/>'
    path.write_text(MESHED.format(mesh="gone.stl", kind=kind, explicit=explicit))
    assert list(didim.load_robot(path).sets) == ["mjcf"]


LOOPED = MODEL.replace(
    "<actuator>",
    '<equality><connect name="rod" body1="left_end" body2="tip" anchor="0 0 0"/></equality><actuator>',
)


def test_a_cut_loop_is_named_and_refused_for_a_fit_without_consent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, LOOPED)
    log = tmp_path / "log.csv"
    header = ",".join(
        [
            "t",
            *(
                f"{name}_{kind}"
                for kind in ("position", "command")
                for name in ("left_1", "left_2", "right_1", "right_2")
            ),
        ]
    )
    np.savetxt(
        log,
        np.column_stack([np.arange(500) * 0.01, np.random.default_rng(0).normal(size=(500, 8))]),
        delimiter=",",
        header=header,
        comments="",
    )
    robot = didim.load_robot(path)
    assert robot.cut == ("rod",)
    assert any(
        note.endswith("closed loops are cut, and what they hold moves freely: rod") for note in robot.notes
    )
    with pytest.raises(RobotError, match=r"closed loops, and a tree has none: rod; --open"):
        check_closed(robot)
    assert main(["init", str(path), str(log), "--kp", "5", "--kv", "1"]) == 2
    assert "it has closed loops" in one_line(capsys)
    q = np.zeros((50, 4))
    experiment = didim.Experiment.from_arrays(robot, q, q, rate_hz=100.0)
    with pytest.raises(RobotError, match="it has closed loops"):
        didim.identify(experiment)
    # A robot file remembers them, or the consent.
    text = tmp_path / "little.toml"
    assert main(["robot", str(path), "-o", str(text)]) == 0
    assert didim.load_robot(text).cut == ("rod",)
    assert main(["robot", str(path), "--open", "-o", str(text), "--force"]) == 0
    assert didim.load_robot(text).cut == didim.load_robot(path, open=True).cut == ()
    assert "closed loops are cut" in capsys.readouterr().err
    # Bodies that do not move against each other stay tied.
    path.write_text(LOOPED.replace('body1="left_end"', 'body1="right"'))
    assert didim.load_robot(path).cut == ()


def test_a_robot_file_keeps_all_that_was_read(tmp_path: Path) -> None:
    tied = MODEL.replace(
        "<actuator>",
        '<equality><joint joint1="right_2" joint2="left_2" polycoef="0.1 0.5 0 0 0"/></equality><actuator>',
    ).replace('name="left_1"', 'name="left_1" solreffriction="0.005 1" stiffness="2"')
    path = written(tmp_path, tied)
    robot = didim.load_robot(path)
    assert main(["robot", str(path), "-o", str(tmp_path / "little.toml")]) == 0
    again = didim.load_robot(tmp_path / "little.toml")
    for name in ("geometry", "friction", "limits", "joint_names", "actuators", "softness", "cut"):
        assert getattr(again, name) == getattr(robot, name)
    np.testing.assert_array_equal(again.parameter_set("mjcf"), robot.parameter_set("mjcf"))
    assert robot.softness[0] != SOFTNESS
    text = robot_text(robot)
    assert robot_text(again).partition("schema = 1")[2] == text.partition("schema = 1")[2]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("softness_s = [0.0, 1.0]", "softness_s must be two positive times"),
        ("actuator = { kp = -1.0 }", "kp must be"),
        ("actuator = { gain = 1.0 }", "gain"),
        ("actuator = { force_n = 1.0 }", "force_n"),
    ],
)
def test_wrong_drives_of_a_robot_file_are_refused(tmp_path: Path, line: str, message: str) -> None:
    path = written(tmp_path, f'schema = 1\n[[joint]]\nkind = "revolute"\n{line}\n', "wrong.toml")
    assert message in refusal(path)


SERVOS = MODEL.replace(
    '<motor joint="left_1" gear="10" ctrlrange="-3 3"/>',
    '<position joint="left_1" kp="40" kv="1" gear="3"/><position joint="right_1" kp="9"/>'
    '<position joint="right_2" kp="8" forcerange="-3 3"/>',
)
LOOP = """schema = 1
robot = '{robot}'
[reference]
kind = 'fourier'
period_s = 5.0
sine_si = [[0.1, 0.1, 0.1, 0.1]]
cosine_si = [[0, 0, 0, 0]]
[controller]
kind = 'pd'
"""


def controller_of(path: Path) -> didim.Controller:
    experiment = didim.load_experiment(path)
    assert isinstance(experiment.controller, ControllerSpec)
    assert isinstance(experiment.reference, ReferenceSpec)
    assert experiment.reference.made is not None
    return experiment.controller.build(experiment.reference.made)


@pytest.mark.parametrize("robot", ["little.xml", "little.toml"])
def test_gains_of_actuators_are_those_of_a_controller_without_its_own(tmp_path: Path, robot: str) -> None:
    path = written(tmp_path, SERVOS)
    (tmp_path / "little.toml").write_text(robot_text(didim.load_robot(path)))
    loop = LOOP.format(robot=robot)
    run = written(tmp_path, loop, "run.toml")
    controller = controller_of(run)
    np.testing.assert_allclose(controller.laws[:, 0], [360.0, 50.0, 9.0, 8.0])
    np.testing.assert_allclose(controller.laws[:, 1], [9.0, 2.0, 0.0, 0.0])
    np.testing.assert_allclose(controller.laws[:, 4], 0.0)  # they damp the motion itself
    np.testing.assert_allclose(controller.saturation, [np.inf, 7.0, np.inf, 3.0])
    run.write_text(f"{loop}kp = 5\nkv = 1\nsaturation_n_m = 2\n")
    own = controller_of(run)
    np.testing.assert_allclose([own.laws[0, 0], own.laws[0, 4], own.saturation[0]], [5.0, 1.0, 2.0])


def test_an_experiment_of_a_part_refers_to_gains_that_its_robot_file_has(tmp_path: Path) -> None:
    path = written(tmp_path, SERVOS)
    log = tmp_path / "run.csv"
    t = 0.01 * np.arange(800)
    q = 0.3 * np.sin(np.outer(t, [1.0, 1.7]))
    names = [f"{joint}_{kind}" for kind in ("command", "position") for joint in ("left_1", "left_2")]
    table = np.column_stack([t, q, np.roll(q, 2, axis=0)])
    np.savetxt(log, table, delimiter=",", header=",".join(["t", *names]), comments="")
    command = ["init", str(path), str(log), "--lock", "right_1=0", "--lock", "right_2=0"]
    assert main(command) in (0, 1)
    text = (tmp_path / "run.toml").read_text()
    assert "# kp: those of the actuators of the robot file" in text
    robot = tomllib.loads((tmp_path / "run_robot.toml").read_text())
    assert [joint["actuator"]["kp"] for joint in robot["joint"]] == [360.0, 50.0]
    assert didim.load_robot(tmp_path / "run_robot.toml").actuators[1] == didim.load_robot(path).actuators[1]


def test_the_go2_of_mujoco(shared: Path) -> None:
    path = shared / "data" / "go2" / "go2.xml"
    robot = didim.load_robot(path)
    assert robot.n_dof == 12
    assert robot.joint_names[:3] == ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint")
    assert [limits.effort for limits in robot.limits[:3]] == [23.7, 23.7, 45.43]
    values = dict(zip(robot.parameter_names, robot.parameter_set("mjcf"), strict=True))
    assert (values["Ia1"], values["Fv1"], values["Fc1"]) == (0.01, 0.6, 0.2)
    assert any("floating" in note for note in robot.notes)


def test_without_mujoco_a_sentence_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, MODEL)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert refusal(path) == (
        "little.xml: an MJCF needs MuJoCo's compiler: pip install 'didim[mujoco]', or use a URDF"
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('class="slider"', 'class="slide"', "MuJoCo refuses it: unknown default"),
        ('mass="5"', 'mass="five"', "MuJoCo refuses it: bad format in attribute 'mass' Element 'inertial', line 10"),
        ('size="0.04"', 'size="0.04" mass="x"', "MuJoCo refuses it: bad format in attribute 'mass' Element 'geom'"),
        ('size="0.04"', 'size="0.04" density="x"', "MuJoCo refuses it: bad format in attribute 'density'"),
        ('size="0.04"', 'size="0"', "MuJoCo refuses it: size 0 must be positive in geom"),
        ('kp="50"', 'kp="stiff"', "MuJoCo refuses it: bad format in attribute 'kp'"),
        ('mass="5"', 'mass="1e12"', "mass of trunk must be at most 1e+09 in size"),
        ('armature="0.5"', 'armature="1e200"', "friction, armature and spring of left_2 must be at most 1e+09"),
        ('gear="10"', 'gear="1e200"', "gear must be at most 1e+09"),
        ('kp="50"', 'kp="1e200"', "gains of left_2 must be at most 1e+09"),
        ("<worldbody>", '<size nuserdata="1000000000" memory="1000G"/><worldbody>', ""),
        ('gear="10"', 'gear=""', ""),
        ("<worldbody>", '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset><worldbody>',
         "a height field of more than 1e+06 points is no part of a robot"),
        ('<geom size="0.04"/>', '<replicate count="300"><replicate count="300"><geom size="0.04"/></replicate></replicate>',
         f"it has more than {MOST_ELEMENTS} elements; cut the robot out of it"),
        ('<geom size="0.04"/>', '<composite type="cable" count="1000000 1 1"><geom size="0.04"/></composite>',
         f"it has more than {MOST_ELEMENTS} elements"),
        ('<geom size="0.04"/>', f"<geom size='0.04'/>{'<body/>' * MOST_OF['body']}",
         f"more than {MOST_OF['body']} elements <body>"),
        ("<mujoco", '<?xml version="1.0" encoding="klingon"?><mujoco', "not readable as XML (unknown encoding: klingon)"),
        ("<mujoco", '<!DOCTYPE a [<!ENTITY b "c">]><mujoco', "it declares XML entities"),
        ("<worldbody>", "<worldbody><body name='\xe9'/>", ""),
    ],
)  # fmt: skip
def test_hostile_files_end_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, message: str
) -> None:
    """Or are read, where there is no message; MuJoCo leaves no file behind."""
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, MODEL.replace(old, new, 1).lstrip())
    if message:
        assert refusal(path).startswith("little.xml: ")
        assert message in refusal(path)
    else:
        assert didim.load_robot(path).n_dof == 4
    assert [file.name for file in tmp_path.iterdir()] == ["little.xml"]


def test_a_robot_without_torques_has_no_numbers_made_of_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A point mass on a vertical axis: the self-test has no torque to compare with."""
    text = (
        '<robot name="a"><link name="base"/><link name="b"><inertial><mass value="1"/><inertia ixx="0" iyy="0" izz="0" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous"><parent link="base"/><child link="b"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    assert main(["robot", str(written(tmp_path, text, "point.urdf"))]) == 0
    assert "nan" not in capsys.readouterr().out
