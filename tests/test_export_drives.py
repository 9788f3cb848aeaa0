"""Drives into simulators: a user's MJCF changes in the attributes named alone, and MuJoCo at its own step moves like the result."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import FitError
from didim.export.configuration import bam, isaac_lab, mjlab, ranges_of
from didim.export.drives import Drives, JointDrive, drives_of, for_step, samples_for_step
from didim.export.mjcf_edit import edit_mjcf
from didim.result.identification import Identification
from didim.result.iteration import Status
from didim.result.samples import Samples
from didim.robot.transmission import Actuator

mujoco = pytest.importorskip("mujoco", reason="needs mujoco, the group 'test'")

ARM = """<?xml version="1.0"?>
<!-- An arm of two joints: comments and white space stay. -->
<mujoco model="two">
  <option timestep="0.002" integrator="implicitfast" gravity="0 0 -9.81"/>
  <default>
    <joint damping="0.3"   armature='0.01' frictionloss="0.05"/>
    <position kp="20" kv="0.5"/>
  </default>
  <worldbody>
    <body name="upper"><joint name="pan"
          axis="0 0 1"/><inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.002 0.002"/>
      <body name="lower" pos="0.2 0 0"><joint name="lift" axis="0 1 0" damping = "0.2"/>
        <inertial pos="0.1 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/></body>
    </body>
  </worldbody>
  <actuator>
    <position name="p1" joint="pan" forcerange="-3 3"/>
    <general joint="lift" gear="2" biastype="affine" gainprm="10" biasprm="0 -10 -.2"/>
  </actuator>
</mujoco>
"""
PAN = JointDrive(
    joint="pan", kind="revolute", rotor=0.03, viscous=0.3, coulomb=0.07, kp=18.0, kv=0.5, effort=2.5
)
LIFT = JointDrive(joint="lift", kind="revolute", rotor=0.02, viscous=0.25, coulomb=0.05, kp=36.0, kv=1.0)
BOTH = Drives((PAN, LIFT))


def written(folder: Path, text: str = ARM) -> Path:
    path = folder / "two.xml"
    path.write_text(text)
    return path


def test_only_the_attributes_named_change(tmp_path: Path) -> None:
    content, _ = edit_mjcf(BOTH, written(tmp_path))
    changed = [
        ('<joint name="pan"', '<joint armature="0.03" frictionloss="0.07" name="pan"'),
        ('<joint name="lift" axis="0 1 0" damping = "0.2"/>', '<joint armature="0.02" name="lift" axis="0 1 0" damping="0.25"/>'),
        ('<position name="p1" joint="pan" forcerange="-3 3"', '<position kp="18.0" name="p1" joint="pan" forcerange="-2.5 2.5"'),
        ('gainprm="10" biasprm="0 -10 -.2"', 'gainprm="9.0" biasprm="0.0 -9.0 -0.25"'),
    ]  # fmt: skip
    expected = ARM
    for old, new in changed:
        assert expected.count(old) == 1
        expected = expected.replace(old, new)
    assert content.decode() == expected


def test_mujoco_reads_the_drives_back(tmp_path: Path) -> None:
    content, _ = edit_mjcf(BOTH, written(tmp_path))
    model = mujoco.MjModel.from_xml_string(content.decode())
    np.testing.assert_allclose(model.dof_armature, [0.03, 0.02])
    np.testing.assert_allclose(model.dof_damping, [0.3, 0.25])
    np.testing.assert_allclose(model.dof_frictionloss, [0.07, 0.05])
    gear = model.actuator_gear[:, 0]
    np.testing.assert_allclose(gear**2 * model.actuator_gainprm[:, 0], [18.0, 36.0])
    np.testing.assert_allclose(-(gear**2) * model.actuator_biasprm[:, 2], [0.5, 1.0])
    np.testing.assert_allclose(model.actuator_forcerange[0], [-2.5, 2.5])


def test_what_the_file_has_already_is_left_alone(tmp_path: Path) -> None:
    path = written(tmp_path)
    robot = didim.load_robot(path)
    values = dict(zip(robot.parameter_names, robot.parameter_set("mjcf"), strict=True))
    same = [
        JointDrive(
            joint=name, kind="revolute", rotor=values[f"Ia{j}"], viscous=values[f"Fv{j}"], coulomb=values[f"Fc{j}"],
            kp=actuator.kp, kv=actuator.kv, effort=actuator.effort,
        )
        for j, (name, actuator) in enumerate(zip(robot.joint_names, robot.actuators, strict=True), start=1)
        if actuator is not None
    ]  # fmt: skip
    assert edit_mjcf(Drives(tuple(same)), path)[0] == path.read_bytes()


@pytest.mark.parametrize("angle", ["degree", "radian"])
def test_springs_go_into_the_file_and_other_formats_report_them(tmp_path: Path, angle: str) -> None:
    text = ARM.replace("  <option", f'  <compiler angle="{angle}"/>\n  <option', 1)
    path = written(tmp_path, text)
    drives = Drives((replace(PAN, stiffness=4.0, rest=-0.3), LIFT))
    model = mujoco.MjModel.from_xml_string(edit_mjcf(drives, path)[0].decode())
    np.testing.assert_allclose(model.jnt_stiffness, [4.0, 0.0])
    np.testing.assert_allclose(model.qpos_spring[0], -0.3)
    assert "springs (N.m/rad or N/m): pan 4" in drives.plain_servos().sentences[-1]
    assert BOTH.plain_servos() == BOTH


def test_joints_that_cannot_be_edited_are_named(tmp_path: Path) -> None:
    path = written(tmp_path)
    with pytest.raises(FitError, match=r"two.xml: there is no joint 'plan'; did you mean 'pan'"):
        edit_mjcf(Drives((replace(PAN, joint="plan"),)), path)
    start, end = ARM.index('    <body name="upper">'), ARM.index("  </worldbody>")
    twice = f'<replicate count="2" sep="_">{ARM[start:end]}</replicate>'
    path.write_text(ARM[:start] + twice + ARM[end:].replace('"pan"', '"pan_0"').replace('"lift"', '"lift_0"'))
    with pytest.raises(FitError, match=r"two.xml: joint 'pan_0' has no element of its own, as a <replicate>"):
        edit_mjcf(Drives((replace(PAN, joint="pan_0"),)), path)


def test_an_included_file_that_changes_stands_in_its_place(tmp_path: Path) -> None:
    path = written(tmp_path)
    whole, _ = edit_mjcf(BOTH, path)
    start, end = ARM.index("<worldbody>"), ARM.index("  <actuator>")
    (tmp_path / "bodies.xml").write_text(f"<mujocoinclude>\n{ARM[start:end]}</mujocoinclude>\n")
    (tmp_path / "default.xml").write_text("<mujoco><default/></mujoco>")
    others = '<include file="default.xml"/>\n'
    path.write_text(ARM[:start] + '<include file="bodies.xml"/>\n' + others + ARM[end:])
    content, _ = edit_mjcf(BOTH, path)
    assert content.decode().replace(others, "") == whole.decode()
    assert others in content.decode()


def test_a_servo_of_tied_joints_keeps_what_its_command_means(tmp_path: Path) -> None:
    """A hand whose fingers share a servo on the mean of their positions, in bits."""
    body = '<body><joint name="{}" type="slide" axis="0 {} 0" armature=".1"/><geom size=".02"/></body>'
    text = (
        f"<mujoco><worldbody>{body.format('right', 1)}{body.format('left', -1)}</worldbody>"
        '<equality><joint joint1="left" joint2="right" polycoef=".1 2 0 0 0"/></equality>'
        '<tendon><fixed name="mean"><joint joint="right" coef=".5"/><joint joint="left" coef=".5"/></fixed></tendon>'
        '<actuator><general name="grip" tendon="mean" biastype="affine" gainprm=".4" biasprm="3 -100 -10" forcerange="-6 6"/>'
        "</actuator></mujoco>"
    )
    path = written(tmp_path, text)
    before = didim.load_robot(path, tip="")
    # The tendon is 1.5 of the right finger's position, plus 0.05.
    assert before.actuators == (Actuator(kp=225.0, kv=22.5, effort=9.0),)
    means = "commands that are not the position of a joint, or its speed: right = 0.00266667 grip -0.0133333"
    assert means in before.notes
    drive = JointDrive(
        joint="right", kind="prismatic", rotor=0.0, viscous=0.0, coulomb=0.0, kp=90.0, kv=9.0, effort=4.5
    )
    content, _ = edit_mjcf(Drives((drive,)), path)
    assert 'gainprm="0.16" biasprm="1.2 -40.0 -4.0" forcerange="-3.0 3.0"' in content.decode()
    path.write_bytes(content)
    after = didim.load_robot(path, tip="")
    assert after.actuators == (Actuator(kp=90.0, kv=9.0, effort=4.5),)
    assert means in after.notes


def test_a_damping_ratio_gives_way_to_the_gain(tmp_path: Path) -> None:
    ratio = '<position name="p1" joint="pan" dampratio="1"'
    text = ARM.replace('<position name="p1" joint="pan"', ratio).replace('kp="20" kv="0.5"', 'kp="20"')
    content, _ = edit_mjcf(BOTH, written(tmp_path, text))
    assert b"dampratio" not in content
    model = mujoco.MjModel.from_xml_string(content.decode())
    assert -model.actuator_biasprm[0, 2] == pytest.approx(0.5)
    # One that the new armatures happen not to change is replaced too, as it would follow the next ones.
    compiled = mujoco.MjModel.from_xml_string(text)
    same = replace(PAN, rotor=0.01, kp=20.0, kv=-float(compiled.actuator_biasprm[0, 2]))
    assert b"dampratio" not in edit_mjcf(Drives((same, replace(LIFT, rotor=0.01))), tmp_path / "two.xml")[0]


# Steps.

MOVING = """<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody><body>
<joint name="j" armature="{rotor}" damping="{viscous}"/><inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/></body>
</worldbody><actuator><position joint="j" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""
SERVO = JointDrive(joint="j", kind="revolute", rotor=0.03, viscous=0.2, coulomb=0.0, kp=20.0, kv=0.5)


def moved(drive: JointDrive, step: float, integrator: str, late: float) -> np.ndarray:
    """Positions every 5 ms under commands that jump every 0.1 s, `late` seconds late."""
    model = mujoco.MjModel.from_xml_string(
        MOVING.format(
            step=step,
            integrator=integrator,
            rotor=drive.rotor,
            viscous=drive.viscous,
            kp=drive.kp,
            kv=drive.kv,
        )
    )
    data, found = mujoco.MjData(model), []
    every, jump, shift = round(0.005 / step), round(0.1 / step), round(late / step)
    for k in range(round(1.0 / step)):
        if k % every == 0:
            found.append(data.qpos[0])
        data.ctrl[0] = 0.5 * ((max(k - shift, 0) // jump) % 2)
        mujoco.mj_step(model, data)
    return np.array(found)


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
@pytest.mark.parametrize("step", [0.0025, 0.005])
def test_mujoco_at_its_own_step_moves_like_the_result(integrator: str, step: float) -> None:
    # Half a step of delay, which the export makes a whole one.
    truth = moved(SERVO, 2.5e-5, "RK4", 0.5 * step)
    (drive,) = for_step(Drives((replace(SERVO, delay_s=0.5 * step),)), step, integrator).joints
    assert drive.delay_s == pytest.approx(step)
    shifted = np.std(moved(drive, step, integrator, drive.delay_s) - truth)
    as_it_is = np.std(moved(SERVO, step, integrator, step) - truth)
    sign = 1.0 if integrator == "implicitfast" else -1.0
    assert drive.rotor == pytest.approx(0.03 - 0.5 * step * (0.2 + sign * 0.5))
    assert shifted < 0.2 * as_it_is
    assert shifted < 2e-3 * np.ptp(truth)


def test_steps_that_are_too_long_are_refused_and_rk4_shifts_nothing() -> None:
    with pytest.raises(
        FitError, match=r"joint 'j': a step of 0.1 s adds 0.035 to its rotor inertia of 0.03; take a shorter"
    ):
        for_step(Drives((SERVO,)), 0.1, "implicitfast")
    assert for_step(Drives((SERVO,)), 0.1, "RK4").joints == (SERVO,)


def test_a_step_is_taken_with_the_integrator_of_the_file(tmp_path: Path) -> None:
    path = written(tmp_path)
    for integrator, sign in (("implicitfast", 1.0), ("Euler", -1.0)):
        path.write_text(ARM.replace("implicitfast", integrator))
        content, drives = edit_mjcf(BOTH, path, step_s=0.004)
        model = mujoco.MjModel.from_xml_string(content.decode())
        np.testing.assert_allclose(
            model.dof_armature, [0.03 - 0.002 * (0.3 + sign * 0.5), 0.02 - 0.002 * (0.25 + sign)]
        )
        assert any(f"for steps of 4 ms with {integrator}" in sentence for sentence in drives.sentences)


def test_the_softness_of_mujocos_friction_is_told(tmp_path: Path) -> None:
    _, drives = edit_mjcf(Drives((PAN, replace(LIFT, smoothing=0.01))), written(tmp_path))
    (sentence,) = (text for text in drives.sentences if "frictionloss is viscous" in text)
    low, high = (float(word) for word in re.findall(r"below ([\d.]+) to ([\d.]+) rad/s", sentence)[0])
    # By MuJoCo itself: half the friction needs a little less than half of that speed.
    content, _ = edit_mjcf(BOTH, written(tmp_path))
    model = mujoco.MjModel.from_xml_string(content.decode())
    model.opt.gravity[:] = 0.0
    speeds = []
    for dof, loss in enumerate((0.07, 0.05)):
        data = mujoco.MjData(model)
        data.qvel[dof] = 1e-6
        mujoco.mj_inverse(model, data)
        speeds.append(loss / (-data.qfrc_constraint[dof] / 1e-6))
    np.testing.assert_allclose(sorted(speeds), [low, high], rtol=0.25)
    assert sentence.endswith("the result's is smooth below 0.01")


# Other simulators.


def configured(text: str, module: str) -> list[tuple[str, dict[str, Any]]]:
    """Run the lines of a configuration with stand-ins for its classes; return their names and arguments."""
    made: list[tuple[str, dict[str, Any]]] = []
    (names,) = re.findall(rf"from {module} import (.+)", text)

    def stand_in(name: str) -> Any:
        return lambda **options: made.append((name, options))

    exec(
        text.replace(f"from {module} import {names}", ""),
        {name: stand_in(name) for name in names.split(", ")},
    )
    return made


def test_isaac_lab_has_a_group_for_each_delay() -> None:
    slide = replace(LIFT, joint="slide.1", viscous=0.4, coulomb=0.6)
    late = Drives(
        (replace(PAN, delay_s=0.011), replace(LIFT, delay_s=0.014), replace(slide, delay_s=0.009)),
        ("a note",),
    )
    text = isaac_lab(late, 0.005)
    assert "# a note" in text
    (first, two), (second, three) = configured(text, "isaaclab.actuators")
    assert first == second == "DelayedPDActuatorCfg"
    assert two["joint_names_expr"] == ["pan", r"slide\.1"]  # patterns of whole names
    assert three["joint_names_expr"] == ["lift"]
    assert (two["min_delay"], two["max_delay"], three["min_delay"], three["max_delay"]) == (2, 2, 3, 3)
    assert two["stiffness"] == {"pan": 18.0, r"slide\.1": 36.0}
    assert two["damping"] == {"pan": 0.5, r"slide\.1": 1.0}
    assert two["armature"] == {"pan": 0.03, r"slide\.1": 0.02}
    # The limit of an explicit actuator's own law; effort_limit and effort_limit_sim are deprecated in Isaac Lab 3.
    assert two["actuator_effort_limit"] == {"pan": 2.5}
    assert not {"effort_limit", "effort_limit_sim", "actuator_effort_limit"} & set(three)
    # Friction of both kinds is Coulomb's; the coefficient of the speed is another number of another unit.
    for group, coulomb, viscous in (
        (two, {"pan": 0.07, r"slide\.1": 0.6}, {"pan": 0.3, r"slide\.1": 0.4}),
        (three, {"lift": 0.05}, {"lift": 0.25}),
    ):
        assert group["friction"] == coulomb
        assert group["dynamic_friction"] == coulomb
        assert group["viscous_friction"] == viscous
    # Commands that are not late need no buffer.
    mixed = isaac_lab(Drives((PAN, replace(LIFT, delay_s=0.011))), 0.005)
    names = [name for name, _ in configured(mixed, "isaaclab.actuators")]
    assert names == ["IdealPDActuatorCfg", "DelayedPDActuatorCfg"]
    assert set(re.findall(r'"(servos\w*)"', mixed)) == {"servos_0_steps_late", "servos_2_steps_late"}
    ((name, options),) = configured(isaac_lab(BOTH), "isaaclab.actuators")
    assert (name, "min_delay" in options) == ("IdealPDActuatorCfg", False)


def test_mjlab_takes_the_drives_as_mujoco_does() -> None:
    late = Drives((replace(PAN, delay_s=0.011), LIFT), ("a note",))
    text = mjlab(late, 0.005)
    assert "# a note" in text
    made = configured(text, "mjlab.actuator")
    assert [name for name, _ in made] == ["BuiltinPositionActuatorCfg"] * 2
    assert made[0][1] == {
        "target_names_expr": ("pan",), "stiffness": 18.0, "damping": 0.5, "effort_limit": 2.5, "armature": 0.03,
        "frictionloss": 0.07, "viscous_damping": 0.3, "delay_min_lag": 2, "delay_max_lag": 2,
    }  # fmt: skip
    assert not {"effort_limit", "delay_max_lag"} & set(made[1][1])
    with pytest.raises(FitError, match="no gains of joint 'pan'"):
        mjlab(Drives((replace(PAN, kp=None),)))


def events(text: str) -> dict[str, dict[str, Any]]:
    """Run the events of a configuration with stand-ins for what they import; functions are their names."""
    lines = text.partition("# In your ")[2].partition("\n")[2]
    assert re.findall(r"^from (\S+)", lines, flags=re.MULTILINE)[0] in ("mjlab.envs.mdp", "isaaclab.envs")

    class Named:
        def __getattr__(self, name: str) -> str:
            return name

    scope: dict[str, Any] = {
        **dict.fromkeys(("dr", "mdp"), Named()),
        "EventTermCfg": dict,
        "SceneEntityCfg": lambda name, **options: {"name": name, **options},
    }
    exec(re.sub(r"^from .*$", "", lines, flags=re.MULTILINE), scope)
    found: dict[str, dict[str, Any]] = scope["EVENTS"]
    return found


def test_ranges_of_what_was_estimated_are_events_of_the_simulators() -> None:
    """Kinds of one joint and of both, with a gain; what no log tells has none, and a step moves a range as it moves the drive."""
    kinds, values = ("Ia", "Fc", "kp", "kp", "Fv", "delay_s"), np.array([0.03, 0.07, 18.0, 36.0, 0.25, 0.01])
    spread = np.array([0.1, 0.2, 0.05, 0.0, 0.3, 0.5]) * values
    samples = Samples(
        names=kinds, kinds=kinds, units=("",) * 6, joints=(("pan",), ("pan",), ("pan",), ("lift",), ("lift",), ("pan", "lift")),
        origins=("log",) * 6, texts=("",) * 6, estimate=values, values=values + spread * np.linspace(-1.0, 1.0, 21)[:, None],
        runs=np.zeros(6), seed=0,
    )  # fmt: skip
    both = Drives((replace(PAN, delay_s=0.01), replace(LIFT, delay_s=0.01)))
    ranges = ranges_of(both, samples)
    assert ranges["kp"] == {"pan": pytest.approx((17.19, 18.81))}  # the other gain has no range
    assert {*ranges["delay_s"]} == {"pan", "lift"}
    moved = ranges_of(for_step(both, 0.004, "implicitfast"), samples)
    np.testing.assert_allclose(moved["rotor"]["pan"], np.array(ranges["rotor"]["pan"]) - 0.002 * (0.3 + 0.5))

    late = samples_for_step(samples, both, 0.004)
    for drive in for_step(both, 0.004, "implicitfast").joints:
        if drive.joint == "pan":
            assert late.estimate[0] == pytest.approx(drive.rotor)
        assert late.estimate[-1] == pytest.approx(drive.delay_s)
    np.testing.assert_allclose(late.values[:, 0] - samples.values[:, 0], -0.002 * (0.3 + 0.5))
    damped = replace(samples, joints=(("pan",),) * 6)  # the damping of this joint is drawn too
    change = (samples_for_step(damped, both, 0.004).values - samples.values)[:, 0]
    np.testing.assert_allclose(change, -0.002 * (samples.values[:, 4] + 0.5))
    assert (samples_for_step(samples, both, 0.2).values[:, 0] == 0.0).all()

    text = mjlab(both, 0.005, ranges)
    found = events(text)
    assert {name: term["func"] for name, term in found.items()} == {
        "joint_armature": "joint_armature", "joint_damping": "joint_damping", "joint_friction": "joint_friction",
        "gains_pan": "pd_gains",
    }  # fmt: skip
    assert found["joint_armature"]["params"] == {
        "ranges": {"pan": pytest.approx((0.0273, 0.0327))},
        "operation": "abs",
    }
    gains = found["gains_pan"]["params"]
    assert gains["asset_cfg"] == {"name": "robot", "actuator_ids": [0]}
    assert (gains["kp_range"], gains["kd_range"]) == (pytest.approx((17.19, 18.81)), (0.5, 0.5))
    lags = [
        (options["delay_min_lag"], options["delay_max_lag"])
        for _, options in configured(text.partition("# In")[0], "mjlab.actuator")
    ]
    assert lags == [(1, 3)] * 2
    assert "each by itself: didim export --samples has the same draws with their correlations" in text

    text = isaac_lab(both, 0.005, ranges)
    found = events(text)
    joint = found["joint_pan"]["params"]
    assert found["joint_pan"]["func"] == "randomize_joint_parameters"
    assert joint["operation"] == "scale"
    assert joint["asset_cfg"] == {"name": "robot", "joint_names": ["pan"]}
    assert joint["armature_distribution_params"] == pytest.approx((0.91, 1.09))
    assert joint["friction_distribution_params"] == pytest.approx((0.82, 1.18))
    assert {*found} == {"joint_pan", "gains_pan"}  # Isaac Lab has no range of viscous friction alone
    assert found["gains_pan"]["func"] == "randomize_actuator_gains"
    assert found["gains_pan"]["params"]["stiffness_distribution_params"] == pytest.approx((0.955, 1.045))
    assert "damping_distribution_params" not in found["gains_pan"]["params"]
    ((_, options),) = configured(text.partition("# In your EventCfg")[0], "isaaclab.actuators")
    assert (options["min_delay"], options["max_delay"]) == (1, 3)


def test_parameters_of_bam() -> None:
    keys = {"model": "m1", "armature": 0.03, "friction_base": 0.07, "friction_viscous": 0.3}
    assert json.loads(bam(PAN)) == keys
    assert json.loads(bam(PAN, "sts3215")) == {**keys, "actuator": "sts3215"}


def test_bam_reads_its_parameters(tmp_path: Path) -> None:
    models = pytest.importorskip("bam.model", reason="needs better-actuator-models")
    (tmp_path / "pan.json").write_text(bam(PAN, "sts3215"))
    found = models.load_model(str(tmp_path / "pan.json")).get_parameters()
    assert [found[key].value for key in ("armature", "friction_base", "friction_viscous")] == [
        0.03,
        0.07,
        0.3,
    ]


def test_bam_gets_a_file_for_each_joint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    result(didim.load_robot(written(tmp_path))).save("fit.json")
    assert main(["export", "fit.json", "--bam"]) == 2
    assert "--bam writes 2 files, one for each joint: -o NAME.json" in capsys.readouterr().err
    assert main(["export", "--bam", "fit.json", "-o", "arm.json"]) == 0
    assert json.loads(Path("arm_lift.json").read_text())["friction_base"] == 0.05
    assert main(["export", "fit.json", "--bam", "mx64", "-o", "arm.json"]) == 2
    assert "arm_pan.json: the file is there already; --force overwrites it" in capsys.readouterr().err
    assert main(["export", "fit.json", "--bam", "mx64", "-o", "arm.json", "--force"]) == 0
    assert "arm_pan.json: written" in capsys.readouterr().out
    assert json.loads(Path("arm_pan.json").read_text()) == json.loads(bam(PAN, "mx64"))
    assert not Path("arm.json").exists()


# Results.


def result(robot: didim.Robot, **drive: Any) -> Identification:
    """A result on positions: the drives of `BOTH` and an offset."""
    values = dict(zip(robot.parameter_names, robot.parameter_set("mjcf").tolist(), strict=True))
    for j, one in enumerate((PAN, LIFT), start=1):
        values |= {f"Ia{j}": one.rotor, f"Fv{j}": one.viscous, f"Fc{j}": one.coulomb}
    values["Off2"] = 0.02
    names = ("Ia1", "Fv1")
    return Identification(
        name="two", robot=robot.name, method="cloe", status=Status.CONVERGED, names=names, units=("kg.m^2", "N.m.s/rad"),
        roles=("estimated", "estimated"), beta=np.array([values[name] for name in names]), covariance=np.zeros((2, 2)),
        parameter_names=robot.parameter_names, parameters=np.array([values[name] for name in robot.parameter_names]),
        relative_error=np.zeros(2), overall_relative_error=0.0, error_norm=0.0, error_std=0.0, condition_number=1.0, n_rows=10,
        settings={
            "robot": {
                "joint_names": list(robot.joint_names), "geometry": {"kinds": ["revolute", "revolute"]},
                "friction": {"smoothing": [0.01, 0.01]},
            },
            "positions": {
                "drive": {**drive, "kp": [18.0, 36.0], "kv": [0.5, 1.0], "saturation": [2.5, None], "delay_s": [0.012] * 2}
            },
        },
    )  # fmt: skip


def test_drives_of_a_result(tmp_path: Path) -> None:
    robot = didim.load_robot(written(tmp_path))
    found = drives_of(result(robot, lag_s=[0.003, 0.003]), "fit.json")
    late: dict[str, Any] = {"delay_s": 0.012, "lag_s": 0.003, "smoothing": 0.01}
    assert found.joints == (replace(PAN, **late), replace(LIFT, offset=0.02, **late))
    sprung = result(robot)
    sprung = replace(
        sprung, parameter_names=(*robot.parameter_names, "Ks2"), parameters=np.append(sprung.parameters, 4.0)
    )
    spring = drives_of(sprung, "fit.json").joints[1]
    assert (spring.stiffness, spring.rest, spring.offset) == (4.0, -0.02 / 4.0, 0.0)
    assert any("add the last column (mrad or mm) to the commands" in sentence for sentence in found.sentences)
    head, pan, lift, *_ = str(found).splitlines()
    assert head.endswith("add to command")
    assert (pan.split()[-1], lift.split()[-1]) == ("0", "-0.5556")
    assert any("commands act 12 ms late" in sentence for sentence in found.sentences)
    assert "lags of commands (ms): pan 3, lift 3" in found.plain_servos().sentences[-1]
    false = Drives((replace(PAN, kp=1e-3, offset=0.02),))
    assert "add to command" not in str(false)
    far = result(robot)
    far.settings["positions"]["drive"]["kp"][1] = 1e-3
    assert any(
        sentence.startswith("offsets of lift are larger than any command can replace")
        for sentence in drives_of(far, "fit.json").sentences
    )
    negative = result(robot)
    parameters = np.array(negative.parameters)
    parameters[robot.parameter_names.index("Fc2")] = -0.1
    with pytest.raises(
        FitError, match=r"fit.json: the Coulomb friction of joint 'lift' is negative \(-0.1\)"
    ):
        drives_of(replace(negative, parameters=parameters), "fit.json")


@pytest.mark.parametrize(
    ("options", "inside"),
    [
        (("--mjcf", "two.xml"), 'armature="0.03"'),
        (("--mjcf", "two.xml", "--for-step", "0.002"), 'armature="0.0292"'),
        (("--isaac-lab", "--for-step", "0.005"), "min_delay=2"),
        (("--mjlab", "--for-step", "0.005"), "delay_max_lag=3"),
        (("--urdf", "two.urdf"), '<dynamics damping="0.3" friction="0.07"/>'),
    ],
)
def test_the_command(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    inside: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    result(didim.load_robot(written(tmp_path))).save("fit.json")
    joints = "".join(
        f'<joint name="{name}" type="continuous"><parent link="{above}"/><child link="{below}"/></joint>'
        for name, above, below in (("pan", "a", "b"), ("lift", "b", "c"))
    )
    (tmp_path / "two.urdf").write_text(
        f'<robot name="two"><link name="a"/><link name="b"/><link name="c"/>{joints}</robot>'
    )
    assert main(["export", "fit.json", *options, "-o", "new.txt"]) == 0
    assert inside in Path("new.txt").read_text()
    told = capsys.readouterr().out
    assert "joint  armature" in told
    assert "commands act" in told


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--bam", "--for-step", "0.002"), "--for-step takes a step of up to 1 s, and is for"),
        (("--mjcf", "two.xml", "--for-step", "-1"), "--for-step takes a step of up to 1 s, and is for"),
        (("--mjcf", "two.xml", "-o", "two.xml", "--force"), "is read by the same command"),
    ],
)
def test_wrong_options(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    result(didim.load_robot(written(tmp_path))).save("fit.json")
    assert main(["export", "fit.json", *options]) == 2
    assert message in capsys.readouterr().err
    assert Path("two.xml").read_text() == ARM
