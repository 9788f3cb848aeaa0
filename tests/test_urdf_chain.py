"""Which joints of a URDF become the robot, which links move with them, and which descriptions are refused."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from didim import load_robot
from didim.errors import RobotError
from didim.robot.urdf.chain import WHOLE, Chain, choose_chain
from didim.robot.urdf.description import read_description
from urdfs import GRIPPER_ARM, inertial_text, joint_text


def chain_of(text: str, **options: object) -> Chain:
    return choose_chain(read_description(text.encode(), "arm.urdf"), **options)  # type: ignore[arg-type]


def tree(*edges: tuple[str, str, str], inside: str = "") -> str:
    """A URDF of (parent, child, type); joints are named after their child."""
    links = dict.fromkeys(link for parent, child, _ in edges for link in (parent, child))
    body = inertial_text(np.random.default_rng(0))
    parts = [f'<link name="{link}">{body}</link>' for link in links]
    parts += [joint_text(f"to_{child}", kind, parent, child, inside=inside) for parent, child, kind in edges]
    return f"<robot>{''.join(parts)}</robot>"


def arm(root: str, prefix: str, joints: int) -> list[tuple[str, str, str]]:
    links = [root, *(f"{prefix}{k + 1}" for k in range(joints))]
    return [(a, b, "revolute") for a, b in pairwise(links)]


def joints_of(chain: Chain) -> list[str]:
    return [joint.name for joint in chain.joints]


def test_an_arm_ends_before_its_fingers() -> None:
    chain = chain_of(GRIPPER_ARM)
    assert joints_of(chain) == ["shoulder", "elbow", "wrist"]
    assert (chain.base, chain.tip) == ("world", "hand")
    assert dict(chain.locked) == {"finger_joint": 0.0, "other_finger_joint": 0.0}
    hand = {member.link: member.locked for member in chain.groups[2]}
    assert hand == {"hand": False, "camera": False, "finger": True, "other_finger": True}


def test_a_single_finger_counts_unless_the_tip_is_given() -> None:
    text = tree(*arm("base", "l", 3), ("l3", "finger", "prismatic"))
    assert joints_of(chain_of(text))[-1] == "to_finger"
    chain = chain_of(text, tip="l3")
    assert joints_of(chain) == ["to_l1", "to_l2", "to_l3"]
    assert dict(chain.locked) == {"to_finger": 0.0}


@pytest.mark.parametrize(("joints", "whole"), [(1, True), (2, True), (3, False)])
def test_what_branches_off_an_arm_is_a_gripper_and_off_a_wrist_a_hand(
    tmp_path: Path, joints: int, whole: bool
) -> None:
    """A palm with fingers of two joints: locked on an arm, which is said, and a whole robot on less."""
    path = tmp_path / "hand.urdf"
    fingers = [edge for name in "abc" for edge in arm(f"l{joints}", name, 2)]
    path.write_text(tree(*arm("base", "l", joints), *fingers))
    robot = load_robot(path)
    assert robot.n_dof == joints + 6 * whole
    assert ("and 6 locked" in repr(robot)) is not whole
    assert any("the chain ends at link l3; locked at 0" in note for note in robot.notes) is not whole
    assert load_robot(path, tip="").n_dof == joints + 6


def test_a_link_world_need_not_have_an_element() -> None:
    text = tree(*arm("world", "l", 2))
    bare = re.sub(r'<link name="world">.*?</link>', "", text)
    assert bare != text
    assert chain_of(bare).base == "world"
    assert joints_of(chain_of(bare)) == joints_of(chain_of(text))
    with pytest.raises(RobotError, match="there is no link 'base'"):
        chain_of(bare.replace('link="world"', 'link="base"'))


def test_macros_that_were_not_expanded_are_left_out_of_a_complete_tree() -> None:
    macro = '<xacro:include filename="a.xacro"/><xacro:finger side="left"/>'
    text = tree(*arm("base", "l", 2)).replace("<robot>", f"<robot>{macro}")
    description = read_description(text.encode(), "arm.urdf")
    assert description.notes == (
        "xacro macros that were not expanded are left out: xacro:include, xacro:finger",
    )
    # Without the joint to the base two trees are left, which a macro may connect.
    for wrong in (
        text.replace('<parent link="base"/>', '<parent link="lost"/>'),
        re.sub("<joint.*</joint>", "", text),
        text.replace("</robot>", '<link name="another"/></robot>'),
    ):
        with pytest.raises(RobotError, match=r"xacro macros \(xacro:include\); expand it first"):
            read_description(wrong.encode(), "arm.urdf")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<mass ", "<xacro:mass/><mass "),
        ("<inertial>.*?</inertial>", "<xacro:inertia/>"),
        ("(<inertial>.*?</inertial>)", r"<xacro:if>\1</xacro:if>"),
        ("<axis ", "<xacro:axis/><axis "),
    ],
)
def test_macros_in_the_place_of_values_are_refused(old: str, new: str) -> None:
    text = re.sub(old, new, tree(*arm("base", "l", 2)), count=1)
    with pytest.raises(RobotError, match=r"xacro macros \(xacro:\w+\); expand it first"):
        read_description(text.encode(), "arm.urdf")


def test_macros_beside_the_inertia_of_a_link_are_left_out_and_those_in_its_shape_ignored() -> None:
    text = tree(*arm("base", "l", 2))
    beside = text.replace("<inertial>", "<xacro:sensor/><inertial>")
    note = "xacro macros that were not expanded are left out: xacro:sensor"
    assert read_description(beside.encode(), "arm.urdf").notes == (note,)
    shape = text.replace("<inertial>", "<visual><xacro:look/></visual><inertial>")
    assert shape != text
    assert not read_description(shape.encode(), "arm.urdf").notes


def test_fixed_branches_do_not_stop_the_chain() -> None:
    text = tree(
        ("base", "stand", "fixed"), *arm("stand", "l", 2), ("l1", "cover", "fixed"), ("l2", "tool", "fixed")
    )
    chain = chain_of(text)
    assert joints_of(chain) == ["to_l1", "to_l2"]
    assert [member.link for member in chain.groups[0]] == ["l1", "cover"]
    assert [member.link for member in chain.groups[1]] == ["l2", "tool"]


def test_two_arms_are_a_tree() -> None:
    text = tree(*arm("torso", "left_", 7), *arm("torso", "right_", 6), ("torso", "head", "revolute"))
    whole = chain_of(text)
    assert whole.tip == WHOLE
    assert joints_of(whole)[:7] == [f"to_left_{k + 1}" for k in range(7)]
    assert whole.parents == (None, *range(6), None, *range(7, 12), None)
    assert len(chain_of(text, tip="left_7").joints) == 7
    # An arm behind a waist is no finger either.
    both = chain_of(tree(*arm("base", "waist", 1), *arm("waist1", "left_", 4), *arm("waist1", "right_", 4)))
    assert both.parents == (None, 0, 1, 2, 3, 0, 5, 6, 7)
    # Locking one of them leaves one.
    locked = {f"to_right_{k + 1}": 0.1 for k in range(6)} | {"to_head": 0.0}
    assert len(chain_of(text, lock=locked).joints) == 7


def test_locked_joints_move_the_links_behind_them() -> None:
    text = tree(*arm("base", "l", 2), ("l2", "slide", "prismatic")).replace(
        "</robot>",
        '<link name="knob"/>'
        + joint_text("knob_joint", "fixed", "slide", "knob", xyz=(1, 0, 0))
        + "</robot>",
    )
    chain = chain_of(text, lock={"to_l2": math.pi / 2, "to_slide": 0.25})
    assert joints_of(chain) == ["to_l1"]
    places = {member.link: member for member in chain.groups[0]}
    np.testing.assert_allclose(places["knob"].pose[:3, 3], [0.0, 1.0, 0.25], atol=1e-15)
    assert places["knob"].locked
    assert not places["l1"].locked


def test_the_base_may_be_turned() -> None:
    text = tree(("world", "wall", "fixed"), *arm("wall", "l", 2)).replace(
        'rpy="0.0 0.0 0.0"', f'rpy="{math.pi / 2!r} 0 0"', 1
    )
    chain = chain_of(text, base="wall")
    np.testing.assert_allclose(chain.base_pose[:3, :3].T @ [0.0, 0.0, -9.81], [0.0, -9.81, 0.0], atol=1e-14)
    assert chain.base == "wall"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (GRIPPER_ARM, {"tip": "hund"}, "there is no link 'hund' (tip); did you mean 'hand'?"),
        (GRIPPER_ARM, {"base": "floor"}, "there is no link 'floor' (base)"),
        (GRIPPER_ARM, {"base": "hand", "tip": "base"}, "link 'hand' (base) does not carry link 'base' (tip)"),
        (GRIPPER_ARM, {"tip": "base"}, "no joint moves between base and tip"),
        (GRIPPER_ARM, {"lock": {"elbo": 1.0}}, "there is no moving joint 'elbo' to lock; did you mean 'elbow'?"),
        (GRIPPER_ARM, {"lock": {"stand": 0.0}}, "there is no moving joint 'stand' to lock"),
        (GRIPPER_ARM, {"lock": {"elbow": math.nan}}, "joint 'elbow' of type revolute cannot be locked at nan"),
        (tree(*arm("base", "l", 129)), {}, "at most 128 joints, not 129 (to_l1, to_l2,"),
        (tree(("a", "b", "fixed")), {}, "no joint moves between base and tip"),
        (tree(("a", "b", "floating")), {}, "base and tip; joints of this type are held: to_b (floating)"),
    ],
)  # fmt: skip
def test_what_is_refused(text: str, options: dict[str, object], message: str) -> None:
    with pytest.raises(RobotError) as error:
        chain_of(text, **options)
    assert str(error.value).startswith("arm.urdf: ")
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("kind", ["floating", "planar", "spherical"])
def test_joints_of_other_types_are_held(kind: str) -> None:
    text = tree(("world", "base", kind), *arm("base", "l", 3))
    assert len(chain_of(text, base="base").joints) == 3
    whole = chain_of(text)
    assert joints_of(whole) == ["to_l1", "to_l2", "to_l3"]
    assert dict(whole.locked) == {"to_base": 0.0}
    again = chain_of(text, lock=whole.locked)
    assert joints_of(again) == joints_of(whole)


def test_joints_that_follow_others_do_so_in_a_tree() -> None:
    text = tree(*arm("base", "left_", 3), *arm("base", "right_", 3), ("right_3", "finger", "prismatic"))
    text = text.replace(
        '<joint name="to_finger" type="prismatic">',
        '<joint name="to_finger" type="prismatic"><mimic joint="to_left_1"/>',
    )
    whole = chain_of(text)
    assert len(whole.joints) == 7
    assert dict(whole.mimics) == {"to_finger": ("to_left_1", 1.0, 0.0)}
    assert not whole.locked
    # On the way to one tip the leader stands still, and so does the finger.
    right = chain_of(text, tip="finger")
    assert len(right.joints) == 3
    assert dict(right.locked) == {"to_finger": 0.0}


def test_a_leader_and_its_followers_move_or_are_locked_together() -> None:
    """Also in the largest robots: those with more joints are refused, and none is dropped."""
    mimic = ("</joint>", '<mimic joint="to_left_1" multiplier="0.5" offset="0.1"/></joint>')
    hands = [*arm("base", "left_", 80), *arm("base", "right_", 48)]
    text = tree(*hands)
    head, *followers = text.rsplit('<joint name="to_right_', 20)
    text = '<joint name="to_right_'.join([head, *(part.replace(*mimic) for part in followers)])
    chain = chain_of(text)
    assert len(chain.joints) == 128
    assert len(chain.mimics) == 20
    assert not chain.locked
    locked = chain_of(text, lock={"to_left_1": 0.4})
    assert len(locked.joints) == 107
    assert not locked.mimics
    assert dict(locked.locked) == {"to_left_1": 0.4} | {
        name: pytest.approx(0.3, abs=1e-15) for name in chain.mimics
    }
    with pytest.raises(RobotError, match="at most 128 joints, not 129"):
        chain_of(tree(*hands, ("right_48", "finger", "revolute")))


def test_a_long_row_of_fixed_links_is_read() -> None:
    edges = [(f"f{k}", f"f{k + 1}", "fixed") for k in range(3000)]
    chain = chain_of(tree(*arm("base", "l", 1), ("l1", "f0", "fixed"), *edges))
    assert len(chain.groups[0]) == 3002


def test_what_xacro_has_left_is_refused_with_the_command_that_expands_it() -> None:
    text = tree(*arm("base", "l", 2)).replace("<robot>", '<robot><xacro:property name="m" value="1"/>')
    text = text.replace('<mass value="', '<mass value="${m} ', 1)
    assert "${m}" in text
    with pytest.raises(
        RobotError, match=r"value of <mass> is '\$\{m\}.*; expand the file first: xacro arm.urdf > arm.urdf"
    ):
        chain_of(text)


def test_a_joint_that_mimics_nothing_says_why_it_is_held(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(
        tree(*arm("base", "l", 3)).replace("</joint>", '<mimic joint="none"/></joint>', 1)
    )
    robot = load_robot(tmp_path / "arm.urdf")
    assert robot.n_dof == 2
    assert "fixed, because they follow joints that are locked or do not exist: to_l1 (of none)" in robot.notes
