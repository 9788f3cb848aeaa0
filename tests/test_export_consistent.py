"""An export of base parameters writes the nearest bodies: the same torques within the noise, and every link a body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import FitError, RobotError
from didim.export.consistent import consistent_parameters
from didim.export.source import exported_parameters
from didim.result.identification import Identification
from didim.robot.rigid_body import INERTIAL, pseudo_inertia, why_no_body
from didim.robot.robot import Robot
from robots import random_motion
from simulated import experiment, log
from urdfs import GRIPPER_ARM

Array = np.ndarray


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A URDF, its robot file, and a result on a log of a robot that is heavier than it."""
    path = tmp_path_factory.mktemp("export")
    (path / "arm.urdf").write_text(GRIPPER_ARM)
    assert main(["robot", str(path / "arm.urdf"), "-o", str(path / "arm.toml")]) == 0
    robot = didim.load_robot(path / "arm.toml")
    fit = didim.identify(experiment(robot, log(robot, truth(robot), noise=0.05)), didim.IDIMLS())
    data = dict(fit.digests) | {f"robot {robot.path.name}": robot.digest}
    from dataclasses import replace

    replace(fit, digests=data).save(path / "fit.json")
    return path


def truth(robot: Robot) -> Array:
    x = robot.parameter_set("urdf").copy()
    for j, factor in enumerate((1.0, 1.2, 1.1)):
        first = robot.parameter_names.index(f"XX{j + 1}")
        x[first : first + 10] *= factor
        for key, value in (("Ia", 0.3), ("Fv", 1.0), ("Fc", 0.8)):
            x[robot.parameter_names.index(f"{key}{j + 1}")] = value
    return x


def bodies(robot: Robot, x: Array) -> list[Array]:
    values = dict(zip(robot.parameter_names, x, strict=True))
    return [
        pseudo_inertia(np.array([values[f"{key}{j + 1}"] for key in INERTIAL])) for j in range(robot.n_dof)
    ]


@pytest.mark.parametrize("prior", [None, "urdf", "generic"])
def test_the_nearest_bodies(folder: Path, prior: str | None) -> None:
    fit, robot = Identification.load(folder / "fit.json"), didim.load_robot(folder / "arm.toml")
    assert why_no_body(bodies(robot, fit.parameters)[0]) is not None
    found = consistent_parameters(fit, robot, prior)
    assert found.prior == (prior or "urdf")
    assert [why_no_body(body) for body in bodies(robot, found.x)] == [None] * 3
    assert all(
        found.x[robot.parameter_names.index(f"{key}{j + 1}")] >= 0.0
        for key in ("Ia", "Fv", "Fc")
        for j in range(3)
    )
    # Within the noise of the estimate, and so are the torques of another motion.
    assert found.sigmas < 1.0
    motion = random_motion(np.random.default_rng(1), 50, 3)
    written, true = (
        didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x) for x in (found.x, truth(robot))
    )
    assert np.linalg.norm(written - true) < 0.02 * np.linalg.norm(true)


def test_what_the_prior_alone_knows(folder: Path) -> None:
    fit, robot = Identification.load(folder / "fit.json"), didim.load_robot(folder / "arm.toml")
    found = consistent_parameters(fit, robot)
    # The mass of the first link and its moments along the axis of joint 1 have no effect on any torque.
    values = dict(zip(robot.parameter_names, found.x, strict=True))
    assert {"M1", "MZ1", "XX1"} <= set(found.from_prior[0])
    assert values["M1"] == pytest.approx(4.0, rel=0.2)
    # A standard parameter that is a base parameter by itself is the log's.
    alone = {name for name in robot.base_parameters.names if name in robot.parameter_names}
    assert alone & {"XZ3", "MY3", "YZ3"}
    assert not alone & set(found.from_prior[2])


def test_the_command_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf, out = folder / "arm.urdf", folder / "new.urdf"
    assert (
        main(["export", str(folder / "fit.json"), "--urdf", str(urdf), "-o", str(out), "--prior", "urdf"])
        == 0
    )
    printed, err = capsys.readouterr()
    assert "didim: note: physically consistent parameters near the prior 'urdf': " in err
    assert printed.splitlines()[2].endswith("from the prior")
    robot = didim.load_robot(folder / "arm.toml")
    x = exported_parameters(
        fit=folder / "fit.json", parameters=None, robot=None, urdf=urdf, prior="urdf"
    ).x.copy()
    x[[name.startswith(("Ia", "Off")) for name in robot.parameter_names]] = 0.0
    np.testing.assert_allclose(didim.load_robot(out).parameter_set("urdf"), x, rtol=1e-9, atol=1e-12)


def test_wrong_priors_and_results_without_covariance(folder: Path) -> None:
    from dataclasses import replace

    fit, robot = Identification.load(folder / "fit.json"), didim.load_robot(folder / "arm.toml")
    with pytest.raises(RobotError, match="no parameter set 'cad'"):
        consistent_parameters(fit, robot, "cad")
    with pytest.raises(FitError, match="the estimate has no standard deviations"):
        consistent_parameters(replace(fit, covariance=np.zeros_like(fit.covariance)), robot)


def test_a_consistent_result_is_written_as_it_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit, robot = Identification.load(folder / "fit.json"), didim.load_robot(folder / "arm.toml")
    near = fit.consistent("urdf", robot=robot)
    near.save(folder / "near.json")
    source = exported_parameters(
        fit=folder / "near.json", parameters=None, robot=None, urdf=folder / "arm.urdf"
    )
    np.testing.assert_array_equal(source.x, near.parameters)
    assert "M1" in source.from_prior[0]
    assert not any("near the prior" in note for note in source.notes)


@pytest.mark.parametrize("prior", ["urdf", "generic"])
def test_samples_are_bodies_near_the_estimate(folder: Path, tmp_path: Path, prior: str) -> None:
    """Each draw has positive definite links and no negative friction, and their torques are those of the covariance."""
    fit, robot = Identification.load(folder / "fit.json"), didim.load_robot(folder / "arm.toml")
    draws = tmp_path / "draws.npz"
    assert (
        main(["export", str(folder / "fit.json"), "--samples", "60", "--prior", prior, "-o", str(draws)]) == 0
    )
    arrays = np.load(draws)
    assert tuple(arrays["names"]) == robot.parameter_names
    assert {*arrays["origins"]} == {"log", "prior"}
    for x in arrays["values"]:
        assert [why_no_body(body) for body in bodies(robot, x)] == [None] * 3
    drives = np.isin(arrays["kinds"], ["Ia", "Fv", "Fc"])
    assert (arrays["values"][:, drives] >= 0.0).all()
    assert arrays["joints"][drives].tolist() == [name for name in robot.joint_names for _ in range(3)]
    told = fit.std > 0.0
    base = (arrays["values"] @ robot.base_parameters.matrix.T - fit.beta)[:, told] / fit.std[told]
    assert np.sqrt(np.mean(base.mean(axis=0) ** 2)) < 1.0
    assert 0.3 < np.median(base.std(axis=0)) < 1.3
