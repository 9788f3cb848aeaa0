"""`didim view`: shapes at their places, motions over time, and a page that shows them."""

from __future__ import annotations

import argparse
import contextlib
import re
import socket
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import didim
from didim._tools.arrays import Array
from didim.cli.main import main
from didim.cli.view import contents
from didim.errors import DidimError
from didim.model.kinematics import frames
from didim.view import playback, shapes
from didim.view.page import box_of, floor_axes
from didim.view.visuals import find_mesh, visuals
from test_compare import ARM

URDF = """<robot name="arm">
  <link name="world"/><link name="cover"><visual><geometry><sphere radius="0.05"/></geometry></visual></link>
  <link name="upper"><inertial><mass value="2"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>
    </inertial><visual><origin xyz="0.2 0 0.1" rpy="0.3 0.2 0.1"/><geometry><box size="0.4 0.1 0.1"/></geometry></visual></link>
  <link name="fore"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arm_description/meshes/fore.stl" scale="2 2 2"/></geometry></visual></link>
  <link name="cap"><visual><origin xyz="0 0 0.02"/><geometry><cylinder radius="0.03" length="0.1"/></geometry></visual></link>
  <joint name="lid" type="fixed"><parent link="world"/><child link="cover"/><origin xyz="0 0 0.5"/></joint>
  <joint name="one" type="revolute"><parent link="world"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0.1 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="9" velocity="3"/></joint>
  <joint name="two" type="prismatic"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0" rpy="0 0.7 0.2"/>
    <axis xyz="1 0 0"/>
    <limit lower="0" upper="0.5" effort="9" velocity="3"/></joint>
  <joint name="glue" type="fixed"><parent link="fore"/><child link="cap"/><origin xyz="0.1 0.2 0" rpy="0 0 1"/></joint>
</robot>
"""
STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"


def ends(shape: shapes.Shape) -> Array:
    """Return both ends of a cylinder in its link, (2, 3)."""
    half = 0.5 * shape.size[1] * shape.pose[:3, 2]
    return np.stack([shape.pose[:3, 3] - half, shape.pose[:3, 3] + half])


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["planar2", "tx40", "ur5e", "iiwa14", "go2"])
def test_the_skeleton_joins_the_frames_in_every_pose(name: str) -> None:
    robot = didim.load_robot(name)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, robot.n_dof)
    found = frames(robot, q[None])[0]
    drawn = [
        shape for shape in shapes.skeleton(robot) if shape.layer == "skeleton" and shape.kind == "cylinder"
    ]
    points = [found[0, :3, 3]]
    for shape in drawn:
        matrix = found[shape.link]
        start, end = (matrix[:3, :3] @ point + matrix[:3, 3] for point in ends(shape))
        # Each segment begins where one before it ends.
        assert min(np.linalg.norm(start - point) for point in points) < 1e-12
        points.append(end)
    for origin in found[:, :3, 3]:
        assert min(np.linalg.norm(origin - point) for point in points) < 1e-12


def test_a_ball_is_drawn_as_itself() -> None:
    """A homogeneous ball has the moments of its own ellipsoid: radius r, (2/5) m r^2 about its centre."""
    robot = didim.load_robot("planar2")
    mass, radius, centre = 3.0, 0.2, np.array([0.1, -0.3, 0.05])
    inertia = 0.4 * mass * radius**2 * np.eye(3) + mass * (
        centre @ centre * np.eye(3) - np.outer(centre, centre)
    )
    keys = dict(zip(("XX", "XY", "XZ", "YY", "YZ", "ZZ"), inertia[np.triu_indices(3)], strict=True))
    keys |= dict(zip(("MX", "MY", "MZ", "M"), [*(mass * centre), mass], strict=True))
    x = np.array(
        [
            keys.get(name.removesuffix("1"), 0.0) if name.endswith("1") else 0.0
            for name in robot.parameter_names
        ]
    )
    found, refused = shapes.bodies(robot, x, "estimate", shapes.ESTIMATE)
    assert refused == []
    ellipsoid, dot = found
    assert (ellipsoid.link, ellipsoid.kind, dot.kind) == (1, "ellipsoid", "sphere")
    np.testing.assert_allclose(ellipsoid.size, 3 * [radius], rtol=1e-12)
    np.testing.assert_allclose(ellipsoid.pose[:3, 3], centre, atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(ellipsoid.pose[:3, :3]), 1.0)
    for wrong, words in (
        (-x, "has a mass of -3 kg"),
        (x * (np.array(robot.parameter_names) != "XX1"), "no body has"),
    ):
        _, (sentence,) = shapes.bodies(robot, wrong, "estimate", shapes.ESTIMATE)
        assert sentence.startswith("estimate: link 1 ")
        assert words in sentence


def test_visuals_stand_where_another_reader_of_urdfs_puts_them(urdf: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = didim.load_robot(urdf)
    places = robot.correspondence
    assert places is not None
    found, missing = visuals(robot, urdf)
    (sentence,) = missing
    assert "the mesh package://arm_description/meshes/fore.stl was not found" in sentence
    meshes = urdf.parent / "elsewhere" / "arm_description" / "meshes"
    meshes.mkdir(parents=True)
    (meshes / "fore.stl").write_text(STL, encoding="utf-8")
    found, missing = visuals(robot, urdf, (urdf.parent / "elsewhere",))
    assert missing == []
    assert [(shape.kind, shape.link) for shape in found] == [
        ("sphere", 0),
        ("box", 1),
        ("mesh", 2),
        ("cylinder", 2),
    ]
    other = yourdfpy.URDF.load(str(urdf), load_meshes=False, build_scene_graph=True)
    q = np.array([0.4, 0.2])
    other.update_cfg(q)
    base = np.array([*places.frame_0, (0.0, 0.0, 0.0, 1.0)])
    own = frames(robot, q[None])[0]
    for shape, link in zip(found, ("cover", "upper", "fore", "cap"), strict=True):
        (visual,) = other.link_map[link].visuals
        expected = other.get_transform(link) @ (np.eye(4) if visual.origin is None else visual.origin)
        np.testing.assert_allclose(base @ own[shape.link] @ shape.pose, expected, atol=1e-12)
    assert found[2].size == (2.0, 2.0, 2.0)


def test_links_of_a_tree_that_the_robot_is_not_on_are_not_drawn(urdf: Path) -> None:
    table = """<link name="table"><visual><geometry><box size="1 1 1"/></geometry></visual></link><link name="leg"/>
      <joint name="screw" type="fixed"><parent link="table"/><child link="leg"/></joint></robot>"""
    robot, (alone, _) = didim.load_robot(urdf), visuals(didim.load_robot(urdf), urdf)
    urdf.write_text(URDF.replace("</robot>", table), encoding="utf-8")
    beside, _ = visuals(robot, urdf)
    assert [(shape.kind, shape.link) for shape in beside] == [(shape.kind, shape.link) for shape in alone]


def test_meshes_are_found_beside_the_file_and_above_it(tmp_path: Path) -> None:
    path = tmp_path / "arm_description" / "urdf" / "arm.urdf"
    mesh = tmp_path / "arm_description" / "meshes" / "a.stl"
    for file in (path, mesh):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("", encoding="utf-8")
    assert find_mesh("package://arm_description/meshes/a.stl", path) == mesh
    assert find_mesh("package://other_name/meshes/a.stl", path) == mesh
    assert find_mesh("../meshes/a.stl", path) is not None
    assert find_mesh("package://arm_description/meshes/b.stl", path) is None
    assert find_mesh("../meshes/a.txt", path) is None


def test_a_motion_from_a_file(tmp_path: Path) -> None:
    robot = didim.load_robot("planar2")
    path = tmp_path / "motion.csv"
    path.write_text("t,q1,q2,dq1,dq2\n1,0,1,0,0\n2,1,3,0,0\n4,1,-3,0,0\n", encoding="utf-8")
    motion = playback.of_file(path, robot)
    np.testing.assert_array_equal(motion.at(1.5), [0.5, 2.0])
    np.testing.assert_array_equal(motion.at(9.0), [1.0, -3.0])
    for text, words in (
        ("t,q1\n0,0\n1,1\n", "no column 'q2'"),
        ("t,q1,q2\n0,0,0\n", "two samples or more"),
        ("t,q1,q2\n0,0,0\n0,1,1\n", "increasing times"),
        ("t,q1,q2\n0,0,0\n1,nan,1\n", "finite"),
        ("t,q1,q2\n0,0,0\n1,x,1\n", "motion.csv: "),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(DidimError, match=words):
            playback.of_file(path, robot)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An experiment file with a simulated log of the planar arm."""
    folder = tmp_path_factory.mktemp("view")
    (folder / "arm.toml").write_text(ARM, encoding="utf-8")
    assert (
        main(
            ["simulate", str(folder / "arm.toml"), "--parameters", "reference", "-o", str(folder / "log.csv")]
        )
        == 0
    )
    block = '[[recording]]\ntime = { file = "log.csv", columns = ["t"], unit = "s" }\n'
    for kind, column, unit in (("position", "q", "rad"), ("torque", "tau", "N.m")):
        block += f'{kind} = {{ file = "log.csv", columns = ["{column}1", "{column}2"], unit = "{unit}", side = "joint" }}\n'
    (folder / "log.toml").write_text(ARM + block, encoding="utf-8")
    return folder / "log.toml"


def options(what: str, **more: object) -> argparse.Namespace:
    return argparse.Namespace(
        **{
            "what": what,
            "data": None,
            "robot": None,
            "parameters": None,
            "motion": None,
            "meshes": [],
            **more,
        }
    )


def test_a_log_is_played_beside_its_simulation(log: Path) -> None:
    robot, drawn, (measured, simulated), notes = contents(options(str(log), parameters="reference"))
    assert notes == []
    assert (measured.label, simulated.label) == ("measured", "simulated")
    np.testing.assert_allclose(measured.at(2.0), simulated.at(2.0), atol=1e-3)
    assert measured.residual is not None
    # The right parameters leave noise and what the filter takes at its ends.
    assert np.median(np.abs(measured.residual)) < 0.02
    assert {shape.layer for shape in drawn} == {
        "skeleton",
        "joint axes",
        "estimate",
        "estimate: centres of mass",
    }
    _, drawn, (alone,), _ = contents(options(str(log)))
    assert alone.residual is None
    assert {shape.layer for shape in drawn} == {"skeleton", "joint axes"}
    assert robot.name == "planar2"


def test_a_result_and_a_motion_are_shown_by_themselves(log: Path) -> None:
    result = log.with_name("fit.json")
    didim.identify(log, didim.IDIMLS()).save(result)
    robot, drawn, motions, _ = contents(options(str(result)))
    assert (robot.name, motions) == ("planar2", [])
    _, beside, _, _ = contents(options(str(log), parameters=str(result)))
    estimates = [[shape for shape in shown if shape.layer == "estimate"] for shown in (drawn, beside)]
    assert [shape.size for shape in estimates[0]] == [shape.size for shape in estimates[1]] != []
    motion = str(log.with_name("log.csv"))
    robot, _, (played,), _ = contents(options(motion, robot="planar2"))
    assert (robot.name, played.label) == ("planar2", "log.csv")
    with pytest.raises(DidimError, match="which robot moves like this"):
        contents(options(motion))
    for what, useless in (("tx40", "robot"), (str(result), "parameters"), (motion, "motion")):
        given = {"robot": "planar2"} if what == motion else {}
        with pytest.raises(DidimError, match=f"--{useless} planar2 has no place beside"):
            contents(options(what, **given, **{useless: "planar2"}))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_the_page_is_served_and_moves(log: Path) -> None:
    pytest.importorskip("viser")
    from didim.view.page import Page

    robot, drawn, motions, _ = contents(options(str(log), parameters="reference"))
    page = Page(robot, drawn, motions, port=free_port())
    try:
        with urllib.request.urlopen(page.url, timeout=60) as answer:
            assert b"<html" in answer.read().lower()
        assert page.duration == pytest.approx(4.0)
        page.show(2.0)
        for nodes, motion in zip(page._nodes, motions, strict=True):
            expected = frames(robot, motion.at(motion.t[0] + 2.0)[None])[0]
            np.testing.assert_allclose([node.position for node in nodes], expected[:, :3, 3], atol=1e-6)
        # A second page takes the next free port.
        other = Page(robot, drawn, [], port=int(page.url.rpartition(":")[2]))
        try:
            assert other.url != page.url
            assert other.duration == 0.0
        finally:
            other.close()
    finally:
        page.close()


@pytest.mark.parametrize(
    "gravity", [(0, 0, -9.81), (0, -9.81, 0), (9.81, 0, 0), (3, -4, 5), (0, 0, 9.81), (0, 0, 0)]
)
def test_the_floor_is_level(gravity: tuple[float, ...]) -> None:
    axes = floor_axes(np.array(gravity, dtype=float))
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    expected = np.array([0.0, 0.0, 1.0]) if not any(gravity) else -np.array(gravity) / np.linalg.norm(gravity)
    np.testing.assert_allclose(axes[:, 2], expected, atol=1e-12)


class Browser:
    """A browser that has opened the page, with the camera that viser starts with."""

    def __init__(self, aspect: float) -> None:
        self.camera = argparse.Namespace(fov=np.deg2rad(75.0), aspect=aspect)

    def atomic(self) -> contextlib.nullcontext[None]:
        return contextlib.nullcontext()


@pytest.mark.parametrize("aspect", [1280 / 900, 400 / 900])
@pytest.mark.parametrize("name", ["emps", "planar2", "ur10e", "tx40", "go2"])
def test_the_camera_sees_the_whole_robot_in_every_pose(name: str, aspect: float) -> None:
    """Every corner of every shape is within the picture, which the robot fills to half or more; so is gravity's arrow."""
    pytest.importorskip("viser")
    from didim.view.page import Page

    robot = didim.load_robot(name)
    t = np.linspace(0.0, 1.0, 40)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (40, robot.n_dof))
    drawn = shapes.skeleton(robot)
    page = Page(robot, drawn, [playback.Playback(label="random", t=t, q=q)], port=free_port())
    try:
        browser = Browser(aspect)
        page._look_at_robot(browser)
    finally:
        page.close()
    camera, up = browser.camera, -np.array(robot.geometry.gravity)
    forward = camera.look_at - camera.position
    right = np.cross(forward, up if np.any(up) else (0.0, 0.0, 1.0))
    rows = np.stack([right, np.cross(right, forward), forward])
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    corners = [
        corner @ matrix[shape.link, :3, :3].T + matrix[shape.link, :3, 3]
        for matrix in frames(robot, q)
        for shape in drawn
        for corner in box_of(shape)
    ]
    x, y, depth = rows @ (np.array(corners) - camera.position).T
    assert depth.min() > 0.0
    half = depth * np.tan(0.5 * camera.fov)
    shares = max(np.abs(x / (aspect * half)).max(), np.abs(y / half).max())
    assert 0.5 < shares < 1.0


def test_the_address_is_printed_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Shown:
        """A page that is shown and closed at once."""

        url = "http://127.0.0.1:8080"

        def __init__(self, *parts: object) -> None: ...

        def play(self) -> None: ...

    monkeypatch.setattr("didim.view.page.Page", Shown)
    assert main(["view", "planar2"]) == 0
    assert (
        capsys.readouterr().err
        == "didim: note: planar2: open http://127.0.0.1:8080 in a browser; Ctrl-C ends\n"
    )


def test_what_cannot_be_shown_is_one_sentence(
    urdf: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", "nothing_like_it"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(urdf)]) == 2
    assert re.search(r"didim view needs viser: pip install 'didim\[view\]'", capsys.readouterr().err)
