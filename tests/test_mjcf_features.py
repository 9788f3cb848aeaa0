"""One feature of MJCF a file, compared with MuJoCo by ``benches/mjcf_corpus.py``: what is left out is named."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

import didim
from scripts import script

BODY = '<inertial pos=".02 .01 .12" mass="1.1" diaginertia=".03 .02 .015"/>'
"""The inertia of both links."""

NEWER = pytest.mark.skipif(
    not hasattr(mujoco.MjModel, "actuator_armature"), reason="this MuJoCo has no such attribute"
)


def arm(
    *sections: str, one: str = "", two: str = "", first: str = BODY, second: str = BODY, at: str = ""
) -> str:
    """Two links: attributes of their joints, their inertias, the pose of the second one, and further sections."""
    return (
        f'<mujoco>{"".join(sections)}<worldbody><body name="a" pos="0 .1 .3">{first}<joint name="j1" axis="0 1 0" {one}/>'
        f'<body name="b" pos=".1 0 .25" {at}>{second}<joint name="j2" axis="1 .2 0" {two}/></body></body></worldbody></mujoco>'
    )


def drive(*actuators: str) -> str:
    """The section of actuators."""
    return f"<actuator>{''.join(actuators)}</actuator>"


def tendon(attributes: str, *more: str) -> str:
    """A fixed tendon over both joints."""
    joints = '<joint joint="j1" coef="1"/><joint joint="j2" coef="-2"/>'
    return f'<tendon><fixed name="t" {attributes}>{joints}</fixed>{"".join(more)}</tendon>'


SAME = {
    "plain": arm(),
    "orientations": arm('<compiler eulerseq="zXy"/>', at='euler="10 -20 30"'),
    "axes": arm(at='xyaxes="1 .5 0 0 1 .3"'),
    "z axis": arm(at='zaxis="0 .3 -1"'),
    "anchors and references": arm(one='pos=".1 0 .05" ref="25"', two='pos="0 .1 0" ref="-10" type="slide"'),
    "ranges": arm('<compiler angle="radian"/>', one='range="-1 .5"', two='limited="false" range="-1 1"'),
    "springs": arm(one='stiffness="4" springref="20" ref="5"', two='springdamper=".2 .7" armature=".1"'),
    "friction": arm(one='frictionloss=".4" damping=".2"', two='armature=".05"'),
    "classes": arm(
        '<default><joint damping="1"/><default class="c"><joint armature=".2"/><default class="d"><joint damping="3"/></default>'
        "</default></default>",
        one='class="d"',
        at='childclass="c"',
    ),
    "several joints": '<mujoco><worldbody><body name="a">' + BODY + '<joint name="x" type="slide" axis="1 0 0"/>'
    '<frame pos=".1 0 0" euler="0 0 30"><joint name="y" pos="0 .1 .1"/></frame><joint name="z" axis="0 0 1"/>'
    "</body></worldbody></mujoco>",
    "no names": "<mujoco><worldbody><body>" + BODY + "<joint/><body>" + BODY + '<joint axis="1 0 0"/>'
    "</body></body></worldbody></mujoco>",
    "solids": arm(
        '<default><geom density="600"/></default>',
        first='<geom type="box" size=".1 .05 .02" euler="0 20 0"/><geom type="capsule" fromto="0 0 0 0 .1 .3" size=".03"/>',
        second='<geom type="cylinder" size=".05 .1" mass="2"/><geom type="ellipsoid" size=".1 .05 .02" pos=".1 0 0"/>',
    ),
    "shells": arm(first='<geom type="box" size=".1 .05 .02" shellinertia="true"/>'),
    "groups": arm('<compiler inertiagrouprange="1 2"/>', first='<geom size=".1" group="2"/><geom size=".2"/>'),
    "bounds": arm('<compiler boundmass="2" boundinertia=".025"/>'),
    "balance": arm('<compiler balanceinertia="true"/>', second=BODY.replace(".03 .02 .015", ".01 .01 .05")),
    "total mass": arm('<compiler settotalmass="9"/>'),
    "inertia of solids": arm('<compiler inertiafromgeom="true"/>', first=BODY + '<geom size=".1"/>'),
    "full inertia": arm(
        second='<inertial pos="0 0 .1" mass="1" fullinertia=".02 .03 .025 .001 -.002 .003"/>'
    ),
    "mesh": arm('<asset><mesh name="m" vertex="0 0 0 .1 0 0 0 .2 0 0 0 .3"/></asset>', first='<geom type="mesh" mesh="m"/>'),
    "mesh of an explicit body": arm(
        '<asset><mesh name="m" file="gone.stl"/></asset>', first=BODY + '<geom type="mesh" mesh="m"/>'
    ),
    "replicate": arm(first='<geom size=".1"/><replicate count="3" offset="0 0 .1"><geom size=".03"/></replicate>'),
    "gravity": arm('<option gravity="1 2 -9"/>'),
    "tie": arm('<equality><joint joint1="j2" joint2="j1" polycoef=".1 .5 0 0 0"/></equality>', one='ref="20"', two='ref="5"'),
    "constant tie": arm('<equality><joint joint1="j2" polycoef=".3 0 0 0 0"/></equality>'),
    "ties that do not act": arm(
        '<default><equality active="false"/></default><equality><joint joint1="j2" joint2="j1"/><connect body1="b" anchor="0 0 0"/>'
        "</equality>"
    ),
    "tendon with a rotor": arm(tendon('armature=".3" damping=".2"'), one='armature=".1" damping=".3"'),
    "tendon of one joint": arm(
        '<tendon><fixed stiffness="3" springlength=".2" armature=".1" damping=".3"><joint joint="j2" coef="-2"/></fixed></tendon>'
    ),
    "tendon of a tie": arm(
        tendon('armature=".2" stiffness="2" springlength=".1"'),
        '<equality><joint joint1="j2" joint2="j1" polycoef=".1 .25 0 0 0"/></equality>',
    ),
    "position servo": arm(drive('<position joint="j1" kp="20" kv="2" gear="-4" forcerange="-3 2"/>')),
    "damping ratio": arm(drive('<position joint="j1" kp="20" dampratio=".8"/>'), one='armature=".1"'),
    "filtered servo": arm(drive('<position joint="j2" kp="20" timeconst=".03"/>')),
    "general servo": arm(
        '<default><general biastype="affine" gainprm="30" biasprm="0 -30 -2"/></default>', drive('<general joint="j1"/>')
    ),
    "velocity servo": arm(drive('<velocity joint="j1" kv="3" gear="2"/>')),
    "motor": arm(drive('<motor joint="j1" gear="5" ctrlrange="-2 3"/>'), two='actuatorfrcrange="-6 4"'),
    "motor with two limits": arm(drive('<motor joint="j1" gear="5" ctrlrange="-2 2" forcerange="-9 9"/>')),
    "two actuators": arm(
        drive('<position joint="j1" kp="9" forcerange="-5 5"/>', '<velocity joint="j1" kv="2" forcerange="-4 4"/>')
    ),
    "servo of a follower": arm(
        '<equality><joint joint1="j2" joint2="j1" polycoef="0 -.5 0 0 0"/></equality>',
        drive('<position joint="j1" kp="3" forcerange="-8 8"/>', '<velocity joint="j2" kv="4" gear="-2" forcerange="-5 5"/>'),
        two='actuatorfrcrange="-6 6"',
    ),
    "jointinparent": arm(drive('<position jointinparent="j2" kp="8"/>')),
    "classes of actuators": arm(
        '<default><default class="q"><position kp="7" kv=".5"/></default></default>', drive('<position joint="j1" class="q"/>')
    ),
}  # fmt: skip
"""Files that a robot has as they are."""

OTHER = {
    "gravcomp": ("told", "gravcomp", arm(at='gravcomp="1"')),
    "fluid": ("told", "fluid", arm('<option density="900"/>')),
    "spring of two joints": ("told", "tendons are left out: t", arm(tendon('stiffness="3"'))),
    "spring with slack": (
        "told",
        "along a path or within a range are left out: t",
        arm('<tendon><fixed name="t" stiffness="3" springlength=".1 .2"><joint joint="j1" coef="1"/></fixed></tendon>'),
    ),
    "muscle": (
        "agree",
        "servos of one joint are left out: m",
        arm(drive('<muscle name="m" joint="j1" lengthrange="0 1"/>')),
    ),
    "negative gain": (
        "drives told",
        "servos of one joint are left out: s",
        arm(drive('<general name="s" joint="j1" biastype="affine" gainprm="30" biasprm="0 20 0"/>')),
    ),
    "constant force": (
        "drives told",
        "servos of one joint are left out: s",
        arm(drive('<general name="s" joint="j1" biastype="affine" biasprm="5 0 0"/>')),
    ),
    "scaled servo": (
        "agree",
        "or its speed: j1 = 0.75 s +0.2, j2 = -2 t",
        arm(drive('<general name="s" joint="j1" gear="2" biastype="affine" gainprm="30" biasprm="8 -20 -3"/>',
                  '<general name="t" joint="j2" gear="-1" biastype="affine" gainprm="4" biasprm="0 0 -2"/>')),
    ),
    "servo beside an integrator": (
        "agree",
        "the command of actuator i is integrated before it is a position",
        arm(drive('<intvelocity name="i" joint="j1" kp="3" actrange="-1 1"/>', '<velocity name="v" joint="j1"/>')),
    ),
    "commands of a follower": (
        "agree",
        "or its speed: j1 = 2 s -0.2",
        arm('<equality><joint joint1="j2" joint2="j1" polycoef=".1 .5 0 0 0"/></equality>',
            drive('<position name="s" joint="j2" kp="5" kv=".2" forcerange="-3 4"/>', '<motor joint="j1" ctrlrange="-1 2"/>')),
    ),
    "servo of tied joints": (
        "agree",
        "or its speed: j1 = -0.666667 s",
        arm('<equality><joint joint1="j2" joint2="j1" polycoef="0 1.25 0 0 0"/></equality>', tendon(""),
            drive('<position name="s" tendon="t" kp="4" timeconst=".1" forcerange="-3 3"/>'),
            one='actuatorfrcrange="-2 2"', two='actuatorfrcrange="-5 5"'),
    ),
    "weights of both": ("agree", "so gravity is 0.25 of its own", arm().replace("<body ", '<body gravcomp=".75" ')),
    "weights that drives carry": (
        "drives told",
        "drives carry weights (actuatorgravcomp) beside their commands, which is left out: a, b",
        arm(drive('<motor joint="j1"/>'), one='actuatorgravcomp="true"', two='actuatorgravcomp="true"').replace(
            "<body ", '<body gravcomp="1" '),
    ),
    "servo of a tendon": ("drives told", "left out: s", arm(tendon(""), drive('<position name="s" tendon="t" kp="4"/>'))),
    "motor of a tendon": ("agree", "left out: s", arm(tendon(""), drive('<motor name="s" tendon="t" ctrlrange="-2 2"/>'))),
    "curved tie": (
        "agree, loops named",
        "closed loops are cut, and what they hold moves freely: joint (j2, j1)",
        arm('<equality><joint joint1="j2" joint2="j1" polycoef="0 1 .5 0 0"/></equality>'),
    ),
    "connect": (
        "agree, loops named",
        "freely: connect of b and world",
        arm('<equality><connect body1="b" anchor="0 0 .1"/></equality>'),
    ),
    "weld": ("agree, loops named", "freely: w", arm('<equality><weld name="w" body1="b"/></equality>')),
    "tie of tendons": (
        "agree, loops named",
        "freely: tendon",
        arm(tendon(""), '<equality><tendon tendon1="t"/></equality>'),
    ),
    "mocap": (
        "agree, loops named",
        "mocap bodies is left out: w",
        arm('<worldbody><body name="m" mocap="true"/></worldbody><equality><weld name="w" body1="m" body2="b"/></equality>'),
    ),
    "path": (
        "told",
        "along a path or within a range are left out: t",
        arm(
            '<tendon><spatial name="t" stiffness="30" springlength="0"><site site="s"/><site site="e"/></spatial></tendon>',
            first=BODY + '<site name="s" pos=".3 0 0"/>',
            second=BODY + '<site name="e" pos=".3 0 0"/>',
        ),
    ),
    "switched off": ("told", "switches off what the robot has", arm(
        '<option><flag spring="disable"/></option>' if hasattr(mujoco.mjtDisableBit, "mjDSBL_SPRING") else
        '<option><flag passive="disable"/></option>', one='stiffness="3"')),
    "ball": (
        "agree",
        "held at the pose of the file, because joints of this type are not supported: ball (spherical)",
        arm(first=BODY + '<body name="c"><joint name="ball" type="ball"/>' + BODY + "</body>"),
    ),
    "nailed": ("agree", "j2 (revolute with a damping of 1e+11)", arm(two='damping="1e11"')),
    "limits of tendons": ("agree", "limits of tendons are left out: t", arm(tendon('range="-1 1"'))),
}  # fmt: skip
"""Class by the bench, words of a note, and file of what a robot has not."""


@pytest.fixture(scope="module")
def bench(project: Path) -> ModuleType:
    return script(project / "benches" / "mjcf_corpus.py")


@pytest.mark.parametrize("feature", SAME)
def test_a_feature_is_read_as_mujoco_compiles_it(tmp_path: Path, bench: ModuleType, feature: str) -> None:
    path = tmp_path / "feature.xml"
    path.write_text(SAME[feature])
    assert bench.verdict(path) == ("agree", [])


@pytest.mark.parametrize("feature", OTHER)
def test_what_a_robot_has_not_is_named(tmp_path: Path, bench: ModuleType, feature: str) -> None:
    kind, words, text = OTHER[feature]
    path = tmp_path / "feature.xml"
    path.write_text(text)
    found, why = bench.verdict(path)
    assert found == kind, why
    assert any(words in note for note in didim.load_robot(path, tip="").notes)


def random_drives(rng: np.random.Generator) -> str:
    """A chain whose joints are tied at random, with actuators of all kinds on joints and on fixed tendons."""

    def number(low: float, high: float) -> str:
        return f"{rng.uniform(low, high):.4g}"

    def maybe(share: float, text: str) -> str:
        return text * (rng.random() < share)

    def ends(key: str) -> str:
        return maybe(0.4, f'{key}="-{number(0.5, 5)} {number(0.5, 5)}"')

    n, bodies, ties, tendons, drives = int(rng.integers(2, 6)), "", "", "", ""
    for j in range(n):
        own = (
            maybe(0.5, f'damping="{number(0, 0.2)}"')
            + maybe(0.2, f' ref="{number(-30, 30)}"')
            + maybe(0.2, ' type="slide"')
        )
        bodies += f'<body pos=".1 0 .2">{BODY}<joint name="j{j}" axis="{number(-1, 1)} 1 0" {own} {ends("actuatorfrcrange")}/>'
        if j and rng.random() < 0.4:
            factor = f"{number(-0.3, 0.3)} {number(-2, 2)}"
            ties += f'<joint joint1="j{j}" joint2="j{rng.integers(j)}" polycoef="{factor} 0 0 0"/>'
    for t in range(2):
        over = "".join(
            f'<joint joint="j{j}" coef="{number(-2, 2)}"/>' for j in rng.choice(n, 2, replace=False)
        )
        tendons += f'<fixed name="t{t}">{over}</fixed>'
    for kind in rng.choice(["motor", "position", "velocity", "intvelocity", "general", "damper"], 4):
        on = f'tendon="t{rng.integers(2)}"' if rng.random() < 0.4 else f'joint="j{rng.integers(n)}"'
        gains = {
            "motor": ends("ctrlrange"),
            "position": f'kp="{number(1, 30)}" kv="{number(0, 3)}" {maybe(0.3, f"""timeconst="{number(0.01, 0.1)}" """)}',
            "velocity": f'kv="{number(0, 3)}"',
            "intvelocity": f'kp="{number(1, 30)}" actrange="-1 1"',
            "general": f'biastype="affine" gainprm="{number(-3, 30)}" biasprm="{number(-3, 3)} {number(-30, 3)} {number(-3, 0.3)}"',
            "damper": f'kv="{number(0, 3)}" ctrlrange="0 1"',
        }
        drives += (
            f'<{kind} {on} {maybe(0.4, f"""gear="{number(-5, 5)}" """)} {ends("forcerange")} {gains[kind]}/>'
        )
    sections = f"<tendon>{tendons}</tendon><equality>{ties}</equality><actuator>{drives}</actuator>"
    return f"<mujoco><worldbody>{bodies}{'</body>' * n}</worldbody>{sections}</mujoco>"


@pytest.mark.parametrize("seed", range(40))
def test_random_drives_of_tied_joints(tmp_path: Path, bench: ModuleType, seed: int) -> None:
    path = tmp_path / "drives.xml"
    path.write_text(random_drives(np.random.default_rng(seed)))
    found, why = bench.verdict(path)
    left_out = any("are left out" in each for each in why)
    assert found == "agree" or (found == "drives told" and left_out), why


@NEWER
@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("agree", arm(drive('<motor joint="j1" gear="4" armature=".02" damping=".3"/>'))),
        ("told", arm(one='stiffness="3 1" damping="1 2"')),
    ],
)
def test_features_of_newer_versions(tmp_path: Path, bench: ModuleType, kind: str, text: str) -> None:
    path = tmp_path / "feature.xml"
    path.write_text(text)
    assert bench.verdict(path)[0] == kind


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("body_mass", "torques"),
        ("dof_armature", "inertia matrix"),
        ("dof_damping", "torques"),
        ("jnt_stiffness", "torques"),
        ("actuator_biasprm", "gains"),
        ("actuator_forcerange", "effort"),
        ("actuator_dynprm", "lag"),
        ("jnt_range", "range"),
        ("dof_frictionloss", "frictionloss"),
    ],
)
def test_the_bench_sees_each_difference(tmp_path: Path, bench: ModuleType, change: str, what: str) -> None:
    """With one number of MuJoCo's model changed by a thousandth."""
    path = tmp_path / "feature.xml"
    servo = drive('<position joint="j1" kp="20" kv="2" timeconst=".1" forcerange="-3 3"/>')
    path.write_text(arm(servo, one='armature=".1" damping=".2" stiffness="2" frictionloss=".3" range="-9 9"'))
    model = mujoco.MjModel.from_xml_path(str(path))
    robot = didim.load_robot(path)
    assert not bench.File(robot, model).differences()
    getattr(model, change)[...] *= 1.001
    assert what in " ".join(bench.File(robot, model).differences())
