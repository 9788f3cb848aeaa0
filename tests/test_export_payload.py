"""What an export makes of a fitted payload and of masses that a log leaves open: it is what was fitted, and says what is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import didim
from didim import Robot
from didim.cli.main import main
from didim.robot.payload import Payload, payload_columns
from simulated import experiment, log
from test_export_c import Compiled

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]

URDF = Path(didim.__file__).parent / "packaged" / "examples" / "ur10e" / "ur10e.urdf"
TOOL = np.array([0.041, 0.001, -0.007, 0.043, 0.004, 0.012, 0.05, -0.03, 0.25, 2.0])
"""Second moments about the flange (kg.m^2), first moments (kg.m) and mass (kg) of a tool."""
DRIVES = {"Ia": 1.5, "Fv": 5.0, "Fc": 4.0, "Off": 0.1}


def truth_of(robot: Robot) -> Array:
    """The parameters of the URDF, with drives."""
    x = robot.parameter_set("urdf").copy()
    for kind, value in DRIVES.items():
        for joint in range(robot.n_dof):
            x[robot.parameter_names.index(f"{kind}{joint + 1}")] = value
    return x


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A URDF, and the results of a log without a tool, and of that log and one with it."""
    folder = tmp_path_factory.mktemp("tool")
    (folder / "arm.urdf").write_bytes(URDF.read_bytes())
    robot = didim.load_robot(folder / "arm.urdf").with_friction(coulomb="tanh", smoothing_rad_s=0.02)
    x, payload = truth_of(robot), Payload(name="tool")
    free = log(robot, x, seed=1, noise=0.05, name="free")
    loaded = log(robot, x + payload_columns(robot, payload) @ TOOL, seed=2, noise=0.05, name="loaded")
    both = replace(experiment(robot, free, replace(loaded, payload="tool")), payloads={"tool": payload})
    didim.identify(both).save(folder / "fit.json")
    didim.identify(experiment(robot, free)).save(folder / "free.json")
    didim.identify(experiment(robot, free), didim.IDIMLS(physical=True)).save(folder / "physical.json")
    return folder


def exported(folder: Path, name: str, *options: str, fit: str = "fit.json") -> Path:
    out, robot = folder / name, str(folder / "arm.urdf")
    assert main(["export", str(folder / fit), "--robot", robot, *options, "-o", str(out), "--force"]) == 0
    return out


@pytest.mark.parametrize(("payload", "there"), [("tool", True), ("none", False)])
def test_urdf_mjcf_and_c_hold_the_tool(folder: Path, tmp_path: Path, payload: str, *, there: bool) -> None:
    robot = didim.load_robot(folder / "arm.urdf")
    x = robot.parameter_set("urdf")
    x = x + payload_columns(robot, Payload(name="tool")) @ TOOL * there
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (30, 6))
    truth = didim.gravity(robot, q, x)
    own = ["--payload", payload]
    urdf = exported(folder, "new.urdf", "--urdf", str(folder / "arm.urdf"), *own)
    mjcf = exported(folder, "new.xml", *own, "--mjcf")
    header = exported(folder, "arm.h", *own, "--c", "--prefix", "tip")
    model = pin.buildModelFromUrdf(str(urdf))
    data = model.createData()
    by_urdf = np.array([pin.computeGeneralizedGravity(model, data, each) for each in q])
    world = mujoco.MjModel.from_xml_path(str(mjcf))
    state = mujoco.MjData(world)
    by_mjcf = np.empty_like(q)
    for row, each in enumerate(q):
        state.qpos[:], state.qvel[:] = each, 0.0
        mujoco.mj_forward(world, state)
        by_mjcf[row] = state.qfrc_bias
    by_c = Compiled(tmp_path, robot, None, "tip", header.read_text()).call("gravity", 6, q)
    for found in (by_urdf, by_mjcf, by_c):
        assert np.linalg.norm(found - truth) < 0.005 * np.linalg.norm(truth)


def test_a_payload_that_is_left_out_is_said_and_another_name_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exported(folder, "plain.xml", "--mjcf")
    assert (
        "payload 'tool' (2 kg) is left out; --payload tool makes it a part of its link"
        in capsys.readouterr().err
    )
    exported(folder, "tool.xml", "--mjcf", "--payload", "tool")
    assert "payload 'tool' (2 kg) is a part of " in capsys.readouterr().err
    assert (
        main(
            [
                "export",
                str(folder / "fit.json"),
                "--robot",
                str(folder / "arm.urdf"),
                "--c",
                "--payload",
                "tol",
            ]
        )
        == 2
    )
    assert capsys.readouterr().err == (
        "didim: the result has no payload 'tol': it has tool; did you mean 'tool'?\n"
    )


@pytest.mark.parametrize("fit", ["free.json", "physical.json"])
def test_masses_stay_those_of_the_urdf_where_the_log_is_silent(folder: Path, fit: str) -> None:
    out = exported(folder, "own.urdf", "--urdf", str(folder / "arm.urdf"), fit=fit)
    before, after = didim.load_robot(folder / "arm.urdf"), didim.load_robot(out)
    x, y = before.parameter_set("urdf"), after.parameter_set("urdf")
    masses = [before.parameter_names.index(f"M{j}") for j in range(1, 7)]
    np.testing.assert_allclose(y[masses], x[masses], rtol=0.02)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (100, 6))
    torque = didim.gravity(before, q, x)
    assert np.linalg.norm(didim.gravity(after, q, y) - torque) < 0.004 * np.linalg.norm(torque)
