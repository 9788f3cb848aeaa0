"""A result goes into the user's MJCF with its inertias: ``mj_inverse`` has its torques, and no other byte changes."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.cli.main import main
from didim.errors import FitError
from didim.export.consistent import consistent_parameters, inertial_of, links_between, without_links_between
from didim.export.drives import Drives, JointDrive
from didim.export.mjcf_edit import edit_mjcf
from didim.export.source import Source
from didim.export.write import into_mjcf
from didim.robot.robot import Robot
from engines import mujoco_torques, sdf_torques
from robots import changed, random_motion
from scripts import script
from simulated import experiment, log
from test_couplings import gripper
from test_export_mjcf import wrist_parameters
from test_export_urdf import only
from urdfs import made

Array = NDArray[np.float64]

SEVERAL = """<mujoco model="several">
  <compiler angle="radian"/>
  <!-- Two joints on one body, three on the next, and a lamp that is fixed to the first. -->
  <default><joint damping="0.4"/><default class="light"><joint armature="0.02"/></default></default>
  <worldbody>
    <body name="fork" pos="0 0 1">
      <joint name="x" class="light" axis="1 0 0" pos="0.1 0 0"/>
      <joint name="y" axis="0 1 0" pos="0 0.1 0" ref="0.3"/>
      <inertial pos="0.1 0 0" quat="1 0.1 0 0" mass="1"   diaginertia="0.01 0.02 0.025"/>
      <body name="lamp" pos="0 0 .1"><inertial mass="0.1" pos="0 0 0" diaginertia="1e-3 1e-3 1e-3"/></body>
      <body name="hand" pos="0 0 .3">
        <joint name="z"/>
        <joint name="u" pos="0 0.1 0.05" axis="1 1 0"/>
        <joint name="v" type="slide" axis="0 1 1"/>
        <geom type="box" size=".1 .05 .03"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="x"/></actuator>
</mujoco>
"""
"""Bodies with several joints, one of which gets its inertia of a geom."""


def loaded(folder: Path, text: str, **options: object) -> Robot:
    (folder / "own.xml").write_text(text)
    return didim.load_robot(folder / "own.xml", snap=0.0, **options)  # type: ignore[arg-type]


def written(robot: Robot, x: Array, path: Path) -> str:
    return into_mjcf(path, Source(robot, x), None)[0].decode()


def difference(robot: Robot, x: Array, text: str) -> float:
    """Largest difference of ``mj_inverse``, without Coulomb friction (a constraint to MuJoCo), over the largest torque."""
    motion = random_motion(np.random.default_rng(0), 50, robot.n_dof)
    state = motion.q, motion.dq, motion.ddq
    tau = didim.inverse_dynamics(robot, *state, only(robot, x, "Ia", "Fv"))
    names = robot.joint_names or [f"joint{j + 1}" for j in range(robot.n_dof)]
    return float(np.abs(mujoco_torques(text, names, *state) - tau).max() / np.abs(tau).max())


def without(text: str, *names: str) -> str:
    """A file without these attributes and without white space between attributes."""
    for name in names:
        text = re.sub(rf'\s+{name}="[^"]*"', "", text)
    return text


DRIVE = ("armature", "damping", "frictionloss")
INERTIAL = ("pos", "mass", "diaginertia", "fullinertia", "quat")


def test_bodies_with_several_joints_and_inertias_of_geoms(tmp_path: Path) -> None:
    robot = loaded(tmp_path, SEVERAL)
    assert robot.joint_names == ("x", "y", "z", "u", "v")
    x = changed(robot)
    assert difference(robot, robot.parameter_set("mjcf"), SEVERAL) < 1e-12
    content, told, _ = into_mjcf(tmp_path / "own.xml", Source(robot, x), None)
    assert "MuJoCo made the inertia of hand: an <inertial> replaces it" in told
    text = content.decode()
    assert difference(robot, x, text) < 1e-12
    losses = [x[robot.parameter_names.index(f"Fc{j}")] for j in range(1, 6)]
    np.testing.assert_allclose(mujoco.MjModel.from_xml_string(text).dof_frictionloss, losses)
    # But for the new element of the hand the text differs in attributes alone, those of the lamp not among them.
    made_new = re.search(r"\n {8}<inertial [^>]*/>", text)
    assert made_new is not None
    text = text.replace(made_new[0], "")
    assert text.count('<inertial mass="0.1" pos="0 0 0" diaginertia="1e-3 1e-3 1e-3"/>') == 1
    assert without(text, *DRIVE, *INERTIAL) == without(SEVERAL, *DRIVE, *INERTIAL)


def test_new_files_of_bodies_with_several_joints(tmp_path: Path) -> None:
    robot = loaded(tmp_path, SEVERAL)
    x = changed(robot)
    text = didim.export.to_mjcf(robot, x)
    assert difference(robot, x, text) < 1e-12
    model = mujoco.MjModel.from_xml_string(text)
    assert [int(count) for count in model.body_jntnum[1:]] == [2, 3]
    # SDF has no links without mass, and gets nearly none.
    motion = random_motion(np.random.default_rng(0), 30, robot.n_dof)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, only(robot, x))
    found = sdf_torques(didim.export.to_sdf(robot, x), (0.0, 0.0, -9.81), motion.q, motion.dq, motion.ddq)
    assert np.abs(found - tau).max() < 1e-8 * np.abs(tau).max()


def test_another_gravity_is_said(tmp_path: Path) -> None:
    robot = loaded(tmp_path, SEVERAL, gravity=[0.0, 0.0, -3.7])
    _, told, _ = into_mjcf(tmp_path / "own.xml", Source(robot, changed(robot)), None)
    assert (
        "gravity of the file stays 0.0 0.0 -9.81 in its base, and that of the result is 0.0 0.0 -3.7" in told
    )


def test_a_file_that_compensates_weights_keeps_its_gravity(tmp_path: Path) -> None:
    text = SEVERAL.replace("<body ", '<body gravcomp="0.75" ')
    robot = loaded(tmp_path, text)
    assert np.linalg.norm(robot.geometry.gravity) == pytest.approx(0.25 * 9.81)
    x = changed(robot)
    content, told, _ = into_mjcf(tmp_path / "own.xml", Source(robot, x), None)
    assert difference(robot, x, content.decode()) < 1e-12
    assert "gravity" not in told
    # The robot without compensation goes into the same file, which keeps it.
    whole = loaded(tmp_path, text, gravity=[0.0, 0.0, -9.81])
    assert any("and the robot has them: fork, lamp, hand" in note for note in whole.notes)
    _, told, _ = into_mjcf(tmp_path / "own.xml", Source(whole, x), None)
    assert (
        "gravity of the file stays 0.0 0.0 -2.4525 in its base, and that of the result is 0.0 0.0 -9.81"
        in told
    )


def test_parameters_of_the_file_itself_change_nothing(tmp_path: Path) -> None:
    robot = loaded(tmp_path, SEVERAL)
    assert written(robot, robot.parameter_set("mjcf"), tmp_path / "own.xml") == SEVERAL


def test_the_tx40_with_its_wrist(tmp_path: Path) -> None:
    packaged = didim.load_robot("tx40")
    file = didim.export.to_mjcf(packaged, packaged.parameter_set("didim_physical"))
    own = loaded(tmp_path, file)
    # Of the packaged robot with frames of its own, and of the one that is read from the file.
    for robot, seed in ((packaged, 0), (own, 1)):
        x = wrist_parameters(robot, seed)
        text = written(robot, x, tmp_path / "own.xml")
        assert difference(robot, x, text) < 1e-12
        loss = mujoco.MjModel.from_xml_string(text).tendon_frictionloss
        np.testing.assert_allclose(loss, [x[robot.parameter_names.index("Fcm6")]])
        assert without(text, *DRIVE, *INERTIAL) == without(file, *DRIVE, *INERTIAL)


def test_the_go2(shared: Path, tmp_path: Path) -> None:
    source = shared / "data" / "go2" / "go2.xml"
    file = source.read_text()
    robot = loaded(tmp_path, file)
    assert robot.n_dof == 12
    x = changed(robot)
    text = written(robot, x, tmp_path / "own.xml")
    assert without(text, *DRIVE, *INERTIAL) == without(file, *DRIVE, *INERTIAL)
    bare = re.sub(r'<mesh file[^>]*/>|<geom [^>]*mesh="[^>]*/>|<freejoint[^>]*/>|<key [^>]*/>', "", text)
    assert difference(robot, x, bare) < 1e-12


def test_defaults_and_an_included_file(tmp_path: Path) -> None:
    start, end = SEVERAL.index('<body name="hand"'), SEVERAL.index("    </body>\n  </worldbody>")
    (tmp_path / "hand.xml").write_text(f"<mujocoinclude>{SEVERAL[start:end]}</mujocoinclude>")
    (tmp_path / "kept.xml").write_text("<mujoco><asset/></mujoco>")
    kept = '<include file="kept.xml"/>'
    text = SEVERAL[:start] + '<include file="hand.xml"/>' + SEVERAL[end:]
    robot = loaded(tmp_path, text.replace("<worldbody>", f"{kept}<worldbody>"))
    x = changed(robot)
    found = written(robot, x, tmp_path / "own.xml")
    assert kept in found
    assert "hand.xml" not in found
    (tmp_path / "own.xml").write_text(SEVERAL)
    whole = written(loaded(tmp_path, SEVERAL), x, tmp_path / "own.xml")
    assert re.sub(r"\s", "", found.replace(kept, "")) == re.sub(r"\s", "", whole)


def test_a_compiler_that_takes_all_inertias_of_geoms(tmp_path: Path) -> None:
    geom = '<geom type="box" size=".1 .05 .03"/>'
    text = SEVERAL.replace('<compiler angle', '<compiler inertiafromgeom="true" angle').replace(
        'axis="0 1 0" pos="0 0.1 0" ref="0.3"/>', 'axis="0 1 0" pos="0 0.1 0" ref="0.3"/>' + geom
    ).replace('diaginertia="1e-3 1e-3 1e-3"/>', f'diaginertia="1e-3 1e-3 1e-3"/>{geom}')  # fmt: skip
    robot = loaded(tmp_path, text)
    x = changed(robot)
    content, told, _ = into_mjcf(tmp_path / "own.xml", Source(robot, x), None)
    found = content.decode()
    assert difference(robot, x, found) < 1e-12
    assert 'inertiafromgeom="auto"' in found
    assert "MuJoCo made the inertia of fork, lamp, hand: an <inertial> replaces it" in told
    # The lamp, whose own element did not count, has what its geom made.
    np.testing.assert_allclose(mujoco.MjModel.from_xml_string(found).body("lamp").mass, 1.2)


@pytest.mark.parametrize(
    ("key", "value", "off"),
    [("settotalmass", "3", "-1"), ("boundmass", "0.9", "0"), ("boundinertia", "0.5", "0")],
)
def test_a_compiler_that_would_change_the_new_inertias(
    tmp_path: Path, key: str, value: str, off: str
) -> None:
    stand = '<body name="stand"><geom size="0.1"/></body>'
    text = SEVERAL.replace("<compiler", f'<compiler {key}="{value}"').replace(
        "<worldbody>", f"<worldbody>{stand}"
    )
    before = mujoco.MjModel.from_xml_string(text)
    robot = loaded(tmp_path, text)
    assert written(robot, robot.parameter_set("mjcf"), tmp_path / "own.xml") == text
    x = robot.parameter_set("mjcf") * 0.9
    found = written(robot, x, tmp_path / "own.xml")
    assert f'{key}="{off}"' in found
    assert difference(robot, x, found) < 1e-12
    after = mujoco.MjModel.from_xml_string(found)
    for name in ("lamp", "stand"):
        assert after.body(name).mass == pytest.approx(before.body(name).mass, rel=1e-12)
        np.testing.assert_allclose(after.body(name).inertia, before.body(name).inertia, rtol=1e-9)


def test_a_body_that_is_none_without_those_fixed_to_it_takes_theirs(tmp_path: Path) -> None:
    text = SEVERAL.replace('mass="0.1"', 'mass="0.7"').replace('"1e-3 1e-3 1e-3"', '"1e-2 1e-2 1e-2"')
    robot = loaded(tmp_path, text)
    x = robot.parameter_set("mjcf").copy()
    first = robot.parameter_names.index("XX2")
    x[first : first + 10] *= 0.4
    found = written(robot, x, tmp_path / "own.xml")
    assert difference(robot, x, found) < 1e-12
    assert mujoco.MjModel.from_xml_string(found).body("lamp").mass == 0.0
    # A locked joint between them: the lamp moves in the user's simulation, and keeps what it has.
    hinged = text.replace(
        '<body name="lamp" pos="0 0 .1">', '<body name="lamp" pos="0 0 .1"><joint name="l"/>'
    )
    robot = loaded(tmp_path, hinged, lock={"l": 0.4})
    with pytest.raises(FitError, match="body 'fork' is no body without lamp: its"):
        written(robot, x, tmp_path / "own.xml")
    x = robot.parameter_set("mjcf") * 1.2
    found = written(robot, x, tmp_path / "own.xml")
    (tmp_path / "own.xml").write_text(found)
    again = didim.load_robot(tmp_path / "own.xml", snap=0.0, lock={"l": 0.4})
    np.testing.assert_allclose(again.parameter_set("mjcf"), x, rtol=1e-9, atol=1e-12)


def test_joints_that_follow_others_and_tendons_of_one_joint(tmp_path: Path) -> None:
    plain = made(tmp_path, gripper())
    file = didim.export.to_mjcf(plain, plain.parameter_set("urdf"))
    tendon = '<tendon><fixed name="t" armature="0.1" damping="0.2" stiffness="3" springlength="0.1">'
    tendon += '<joint joint="bend" coef="0.5"/>'
    file = file.replace("  <equality>", tendon + "</fixed></tendon><equality>")
    file = file.replace('name="bend"', 'name="bend" stiffness="2" springref="0.2"')
    robot = loaded(tmp_path, file, tip="")
    x = changed(robot)
    x[[robot.parameter_names.index(name) for name in ("Ks2", "Off2")]] *= 1.5
    (tmp_path / "own.xml").write_text(written(robot, x, tmp_path / "own.xml"))
    again = didim.load_robot(tmp_path / "own.xml", snap=0.0, tip="")
    np.testing.assert_allclose(again.parameter_set("mjcf"), x, rtol=1e-9, atol=1e-12)
    assert tendon in (tmp_path / "own.xml").read_text()
    x[robot.parameter_names.index("Ia2")] = 0.02
    with pytest.raises(
        FitError, match=r"rotor inertia of joint 'bend' without that of its tendons is -0\.005"
    ):
        written(robot, x, tmp_path / "own.xml")
    x[[robot.parameter_names.index(name) for name in ("Ia2", "Ks2")]] = 0.5
    with pytest.raises(FitError, match=r"stiffness of the spring of joint 'bend' without .* is -0\.25"):
        written(robot, x, tmp_path / "own.xml")


def test_drives_alone_leave_the_tendon_of_a_wrist_its_share(tmp_path: Path) -> None:
    packaged = didim.load_robot("tx40")
    coupling = [list(row) for row in packaged.geometry.coupling]
    coupling[5][4] = 2.0
    geometry = replace(packaged.geometry, coupling=tuple(map(tuple, coupling)))
    packaged = replace(packaged, geometry=geometry)
    robot = loaded(tmp_path, didim.export.to_mjcf(packaged, wrist_parameters(packaged, 0)))
    x = dict(zip(robot.parameter_names, robot.parameter_set("mjcf").tolist(), strict=True))
    assert x["Fcm6"] > 0.0
    drives = [
        JointDrive(joint=name, kind="revolute", rotor=x[f"Ia{j}"], viscous=x[f"Fv{j}"], coulomb=x[f"Fc{j}"])
        for j, name in enumerate(robot.joint_names, start=1)
    ]
    file = (tmp_path / "own.xml").read_text()
    assert edit_mjcf(Drives(tuple(drives)), tmp_path / "own.xml")[0].decode() == file
    more = Drives((*drives[:4], replace(drives[4], coulomb=drives[4].coulomb + 1.0), drives[5]))
    model = mujoco.MjModel.from_xml_string(edit_mjcf(more, tmp_path / "own.xml")[0].decode())
    np.testing.assert_allclose(model.dof_frictionloss[4], x["Fc5"] + 1.0)


OTHERS = [
    (
        'axis="1 0 0" pos="0.1 0 0"',
        'axis="1 0.01 0" pos="0.1 0 0"',
        "joint 'x' has another axis at position zero",
    ),
    (
        'axis="0 1 0" pos="0 0.1 0"',
        'axis="0 1 0" pos="0.01 0.1 0"',
        "joint 'y' has another axis at position zero",
    ),
    (
        '<joint name="v" type="slide"',
        '<joint name="v" type="hinge"',
        "joint 'v' has another axis at position zero",
    ),
    ('name="z"', 'name="zz"', "the file has no moving joint 'z'"),
    (
        "<actuator>",
        '<equality><joint joint1="u" joint2="z"/></equality><actuator>',
        "joint 'u' follows others in another way",
    ),
    (
        "<actuator>",
        '<tendon><fixed armature="1"><joint joint="u" coef="1"/><joint joint="z" coef="1"/></fixed></tendon><actuator>',
        "its motors are coupled in another way",
    ),
]


@pytest.mark.parametrize(("old", "new", "reason"), OTHERS)
def test_links_go_into_the_same_mechanism_alone(tmp_path: Path, old: str, new: str, reason: str) -> None:
    robot = loaded(tmp_path, SEVERAL)
    x = changed(robot)
    (tmp_path / "own.xml").write_text(SEVERAL.replace(old, new))
    with pytest.raises(FitError) as error:
        written(robot, x, tmp_path / "own.xml")
    assert str(error.value) == f"own.xml is not of robot 'several': {reason}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file and a result on torques."""
    folder = tmp_path_factory.mktemp("links")
    robot = loaded(folder, SEVERAL)
    x = changed(robot)
    didim.identify(experiment(robot, log(robot, x, noise=0.01)), didim.IDIMLS()).save(folder / "fit.json")
    return folder


@pytest.mark.usefixtures("without_verdict")
def test_the_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit, own, out = str(folder / "fit.json"), str(folder / "own.xml"), folder / "new.xml"
    assert main(["export", fit, "--robot", own, "--mjcf", own, "-o", str(out), "--force"]) == 0
    told = capsys.readouterr()
    assert "physically consistent parameters near the prior 'mjcf'" in told.out + told.err
    robot = didim.load_robot(own, snap=0.0)
    # Within the noise, and exactly those of the new file.
    assert difference(robot, changed(robot), out.read_text()) < 0.03
    assert "gravity" not in told.out + told.err
    again = didim.load_robot(out, snap=0.0)
    assert difference(again, again.parameter_set("mjcf"), out.read_text()) < 1e-12
    as_it_is = mujoco.MjModel.from_xml_path(str(out))
    assert (
        main(["export", fit, "--robot", own, "--mjcf", own, "--for-step", "0.004", "-o", str(out), "--force"])
        == 0
    )
    capsys.readouterr()
    step = mujoco.MjModel.from_xml_path(str(out))
    damping = np.ravel(as_it_is.dof_damping)[: as_it_is.nv]
    np.testing.assert_allclose(step.dof_armature, as_it_is.dof_armature - 0.002 * damping)
    np.testing.assert_array_equal(step.body_inertia, as_it_is.body_inertia)
    # Another mechanism with these joints gets the drives.
    other = folder / "other.xml"
    other.write_text(SEVERAL.replace('axis="1 0 0" pos', 'axis="1 0.01 0" pos'))
    assert main(["export", fit, "--robot", own, "--mjcf", str(other), "-o", str(out), "--force"]) == 0
    told = capsys.readouterr()
    assert (
        "links of other.xml stay as they are, because it is not of robot 'several': joint 'x'"
        in told.out + told.err
    )
    assert without(out.read_text(), *DRIVE) == without(other.read_text(), *DRIVE)


def planar() -> str:
    """A runner in a plane: three joints on its torso, and two legs of three joints each."""
    capsule = '<geom type="capsule" fromto="{}" size=".046"/>'
    legs = ""
    for name, start in (("back", "-.5 0 0"), ("front", ".5 0 0")):
        for part, pos in enumerate((start, "0 0 -.2", "0 0 -.2")):
            joint = f'<joint name="{name}{part}" axis="0 1 0"/>'
            legs += f'<body name="{name}{part}" pos="{pos}">{joint}{capsule.format("0 0 0 0 0 -.2")}'
        legs += "</body>" * 3
    slides = '<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>'
    own = f'{slides}<joint name="turn" axis="0 1 0"/>{capsule.format("-.5 0 0 .5 0 0")}'
    return f'<mujoco model="runner"><worldbody><body name="torso" pos="0 0 1">{own}{legs}</body></worldbody></mujoco>'


def test_links_between_joints_have_nearly_no_mass_before_others_take_it_over(tmp_path: Path) -> None:
    robot = loaded(tmp_path, planar())
    truth = changed(robot)
    fit = didim.identify(experiment(robot, log(robot, truth, n_samples=1500, noise=0.01)), didim.IDIMLS())
    assert links_between(robot) == (0, 1)
    nearest = consistent_parameters(fit, robot, empty=links_between(robot))
    assert nearest.sigmas < 1.0
    assert not nearest.x[inertial_of(robot, (0, 1))].any()
    assert difference(robot, nearest.x, written(robot, nearest.x, tmp_path / "own.xml")) < 1e-12
    # Bodies that may take what they like leave the torso none.
    any_mass = consistent_parameters(fit, robot).x
    with pytest.raises(FitError, match="link 'torso' is not a body"):
        written(robot, without_links_between(fit, robot, any_mass, (0, 1)), tmp_path / "own.xml")


PACKAGED = Path(didim.__file__).parent / "packaged" / "examples"
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
WHEELS = ("gymnasium_robotics", "gymnasium")
"""Packages with descriptions of robots; those that are not installed have none to offer."""
DESCRIPTIONS = [
    PACKAGED / "quadruped" / "quadruped.xml",
    PACKAGED / "hobby_arm" / "arm.xml",
    PACKAGED / "ur10e" / "ur10e.urdf",
    *(DATA / name for name in ("go2/go2.xml", "so101/so101_new_calib.xml", "urdf/iiwa14.urdf", "urdf/kr16.urdf", "urdf/gen3.urdf")),
    *(
        path
        for wheel in WHEELS
        if (found := importlib.util.find_spec(wheel)) is not None and found.origin is not None
        for path in sorted(Path(found.origin).parent.rglob("*.xml"))
        if path.name in ("reacher.xml", "half_cheetah.xml", "hopper.xml", "inverted_pendulum.xml")
    ),
]  # fmt: skip


@pytest.fixture(scope="module")
def bench(project: Path) -> ModuleType:
    return script(project / "benches" / "round_trips.py")


@pytest.mark.slow
@pytest.mark.usefixtures("without_verdict")
@pytest.mark.parametrize("path", DESCRIPTIONS, ids=lambda path: path.name)
def test_an_identified_robot_goes_back_into_its_own_file(
    tmp_path: Path, bench: ModuleType, path: Path
) -> None:
    if not path.exists():
        pytest.skip("needs the shared data")
    trip = bench.round_trip(path, tmp_path)
    assert trip.difference < 1e-10
    assert trip.elsewhere == ""


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ('damping="0.4"', 'damping="0.5"', ""),
        ('<inertial pos="0.1 0 0"', '<inertial pos="0.2 0 0"', ""),
        ('<geom type="box" size=".1 .05 .03"/>', '<inertial mass="1"/><geom type="box" size=".1 .05 .03"/>', ""),
        ('axis="1 1 0"', 'axis="1 1 1"', 'axis="1 1 0"'),
        ('pos="0 0 .3"', 'pos="0 0 .4"', 'pos="0 0 .3"'),
        ('<motor joint="x"/>', "", '<motor joint="x" />'),
        ("Two joints on one body", "Two joints of one body", "Two joints on one body"),
        ("</mujoco>", "<size/></mujoco>", "nothing / <size />"),
    ],
)  # fmt: skip
def test_the_bench_sees_what_differs_elsewhere(bench: ModuleType, old: str, new: str, found: str) -> None:
    assert old in SEVERAL
    assert found in bench.elsewhere(SEVERAL, SEVERAL.replace(old, new))
    assert bool(found) == bool(bench.elsewhere(SEVERAL, SEVERAL.replace(old, new)))


def test_a_parameter_set_goes_in_too(tmp_path: Path) -> None:
    robot = loaded(tmp_path, SEVERAL)
    x = changed(robot)
    own, out = str(tmp_path / "own.xml"), tmp_path / "new.xml"
    lines = [f"{name} = {value!r}" for name, value in zip(robot.parameter_names, x.tolist(), strict=True)]
    (tmp_path / "x.toml").write_text("\n".join(["[parameters.x]", *lines]))
    assert main(["export", "--parameters", str(tmp_path / "x.toml"), "--mjcf", own, "-o", str(out)]) == 0
    assert difference(robot, x, out.read_text()) < 1e-12
