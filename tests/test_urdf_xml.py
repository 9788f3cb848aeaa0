"""XML with its bytes: spans, comments, and what is refused."""

from __future__ import annotations

import pytest

from didim.errors import RobotError
from didim.robot.urdf.chain import choose_chain
from didim.robot.urdf.description import read_description
from didim.robot.urdf.xml_spans import Element, parse_xml
from urdfs import GRIPPER_ARM

TEXT = b"""<?xml version="1.0"?>
<!-- before -->
<robot name='a "b" > c'>
  <link name="x"/><!--one--><link   name="\xc3\xa9" note="1 > 0"  >text<inertial ></inertial
  ></link>
  <controller:gain drake:value="3"/>
</robot>
"""


def walk(element: Element) -> list[Element]:
    return [element, *(inner for child in element.children for inner in walk(child))]


def test_spans_are_those_of_the_file() -> None:
    robot = parse_xml(TEXT, "a.urdf")
    spans = [TEXT[element.start : element.end] for element in walk(robot)]
    assert spans[0].startswith(b"<robot")
    assert spans[0].endswith(b"</robot>")
    assert spans[1] == b'<link name="x"/>'
    assert spans[2].startswith(b"<link   name")
    assert spans[2].endswith(b"></link>")
    assert spans[3] == b"<inertial ></inertial\n  >"
    assert spans[4] == b'<controller:gain drake:value="3"/>'
    second = robot.children[1]
    assert TEXT[second.start : second.opened].endswith(b'note="1 > 0"  >')
    assert second.attributes == {"name": "é", "note": "1 > 0"}
    assert [TEXT[c.start : c.end] for c in robot.comments] == [b"<!--one-->"]
    assert robot.find("gain") is None


def test_every_element_of_an_arm_opens_and_closes() -> None:
    data = GRIPPER_ARM.encode()
    for element in walk(parse_xml(data, "arm.urdf")):
        whole = data[element.start : element.end]
        assert whole.startswith(f"<{element.tag}".encode())
        assert whole.endswith(b"/>") or whole.endswith(f"</{element.tag}>".encode())
        assert data.count(b"\n", 0, element.start) + 1 == element.line


LINK = '<link name="a"/>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed XML"),
        ("<robot><link></robot>", "not well-formed XML, mismatched tag (line 1, column 16)"),
        ('<!DOCTYPE r [<!ENTITY e "x">]><robot>&e;</robot>', "declares XML entities"),
        ("<sdf/>", "this is SDF, a URDF has <robot> outermost"),
        ("<mujoco/>", "this is MJCF"),
        ("<html/>", "this is <html>"),
        ("<robot><xacro:macro/></robot>", "xacro macros (xacro:macro); expand it first: xacro arm.urdf > arm.urdf"),
        ("<robot/>", "it has no <link>"),
        ("<robot><link/></robot>", "line 1: <link> has no name"),
        (f"<robot>{LINK}{LINK}</robot>", "there are two links 'a'"),
    ],
)  # fmt: skip
def test_what_is_no_urdf(text: str, message: str) -> None:
    with pytest.raises(RobotError) as error:
        read_description(text.encode(), "arm.urdf")
    assert str(error.value).startswith("arm.urdf: ")
    assert message in str(error.value)


def one_joint(joint: str = "", *, kind: str = "revolute", link: str = '<link name="b"/>') -> bytes:
    return (
        f'<robot>{LINK}{link}<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{joint}</joint></robot>'
    ).encode()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (one_joint('<axis xyz="0 0"/>'), "xyz of <axis> must be 3 numbers of at most 1e+09, got '0 0'"),
        (one_joint('<axis xyz="0,,1 0"/>'), "xyz of <axis> must be 3 numbers of at most 1e+09, got '0,,1 0'"),
        (one_joint('<origin rpy="$(arg rpy)"/>'), "rpy of <origin> is '$(arg rpy)'; expand the file first: xacro"),
        (one_joint('<origin rpy="0 nan 0"/>'), "rpy of <origin> must be 3 numbers"),
        (one_joint('<limit velocity="fast"/>'), "velocity of <limit> must be a number, got 'fast'"),
        (one_joint(kind="screws"), "its type must be revolute, continuous, prismatic or fixed, got 'screws'"),
        (one_joint().replace(b'<parent link="a"/>', b""), "joint 'j': it has no <parent link=...>"),
        (one_joint().replace(b'<child link="b"/>', b'<child link="c"/>'), "joint 'j': there is no link 'c'"),
        (one_joint().replace(b'link="a"/><child', b'link="b"/><child'), "link 'b' is its own ancestor"),
        (
            one_joint().replace(b"</robot>", b'<joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint></robot>'),
            "link 'b' is the child of two joints, 'j' and 'k'",
        ),
        (
            one_joint(link='<link name="b"><inertial><mass value="x"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'),
            "link 'b': value of <mass> must be a number of at most 1e+09, got 'x'",
        ),
    ],
)  # fmt: skip
def test_links_and_joints_that_lack_something(data: bytes, message: str) -> None:
    with pytest.raises(RobotError) as error:
        read_description(data, "arm.urdf")
    assert message in str(error.value)


INERTIA = '<inertia ixx="1" iyy="1" izz="1"/>'


@pytest.mark.parametrize(
    ("inertial", "reason"),
    [
        ('<mass value="1"/>', "it has no <inertia ixx=...>"),
        (INERTIA, "it has no <mass value=...>"),
        (f'<mass value="NaN"/>{INERTIA}', "value of <mass> is NaN"),
        ('<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixz="-nan(ind)"/>', "ixz of <inertia> is -nan(ind)"),
    ],
)  # fmt: skip
def test_half_an_inertial_is_left_out(inertial: str, reason: str) -> None:
    link = f'<link name="b"><inertial>{inertial}</inertial></link>'
    description = read_description(one_joint(link=link), "arm.urdf")
    assert description.links["b"] is None
    assert description.notes == (f"the <inertial> of link b is left out: {reason}",)


def test_numbers_may_be_separated_by_commas() -> None:
    joint = read_description(
        one_joint('<axis xyz="0,0, 1"/><origin xyz=" 0.1, 0.2 ,0.3 "/>'), "arm.urdf"
    ).joints["b"]
    assert joint.origin[:3, 3].tolist() == [0.1, 0.2, 0.3]
    assert joint.axis.tolist() == [0.0, 0.0, 1.0]


def test_a_joint_without_an_axis_is_held() -> None:
    chain = choose_chain(read_description(TWO_TREES.encode(), "arm.urdf"))
    assert [joint.name for joint in chain.joints] == ["k"]
    assert dict(chain.locked) == {"l": 0.0}


TWO_TREES = (
    '<robot><link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
    '<link name="c"/><link name="d"/><joint name="k" type="revolute"><parent link="c"/><child link="d"/></joint>'
    '<link name="e"/><joint name="l" type="revolute"><parent link="d"/><child link="e"/><axis xyz="0 0 0"/></joint></robot>'
)
"""Two trees, of which the second has the joint that moves; its last joint has no axis."""


def test_the_tree_that_moves_is_taken_of_several() -> None:
    description = read_description(TWO_TREES.encode(), "arm.urdf")
    assert description.root == "c"
    assert description.notes == (
        "the robot stands on link c; no joint holds a, left out (--base takes another)",
    )
    chain = choose_chain(
        read_description(TWO_TREES.replace("fixed", "revolute").encode(), "arm.urdf"), base="a"
    )
    assert [joint.name for joint in chain.joints] == ["j"]


def test_blank_lines_before_the_declaration_move_no_byte() -> None:
    data = b"\n \n" + GRIPPER_ARM.encode()
    outermost = parse_xml(data, "arm.urdf")
    assert data[outermost.start :].startswith(b'<robot name="little_arm">')
    assert data[: outermost.end].endswith(b"</robot>")


def test_what_an_expanded_file_keeps_of_xacro_is_ignored() -> None:
    text = TWO_TREES.replace("<robot>", '<robot><xacro:property name="w" value="1"/><xacro:arg name="x"/>')
    assert read_description(text.encode(), "arm.urdf").root == "c"


def test_another_encoding_is_named() -> None:
    with pytest.raises(RobotError, match="save it as UTF-8"):
        read_description(GRIPPER_ARM.encode("utf-16"), "arm.urdf")
    latin = GRIPPER_ARM.replace('version="1.0"', 'version="1.0" encoding="latin-1"').replace("hand", "händ")
    assert "händ" in read_description(latin.encode("latin-1"), "arm.urdf").links


@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        ('lower="-1" upper="2" velocity="3" effort="4"', (-1.0, 2.0, 3.0, 4.0)),
        ('lower="0" upper="0" velocity="0" effort="0"', (None, None, None, None)),
        ('lower="-1e16" upper="1e16" velocity="1e10" effort="inf"', (None, None, None, None)),
        ('upper="2"', (None, None, None, None)),
    ],
)
def test_limits_that_stand_for_none(limit: str, expected: tuple[float | None, ...]) -> None:
    joint = read_description(one_joint(f"<limit {limit}/>"), "arm.urdf").joints["b"]
    limits = joint.limits
    assert (*(limits.position or (None, None)), limits.velocity, limits.effort) == expected
