"""The command ``didim export``, where it finds robot and parameters, and its report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import FitError
from didim.export.bodies import export_model, joint_friction
from didim.export.source import exported_parameters
from didim.export.write import compare_links, export
from didim.robot.friction import FrictionTerm
from robots import random_parameters
from test_export_urdf import arm_parameters
from test_identification import example
from urdfs import GRIPPER_ARM


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(GRIPPER_ARM)
    return path


def saved_fit(robot: didim.Robot, x: np.ndarray, path: Path) -> Path:
    """A result of a robot with these standard parameters, as `Identification.save` writes it."""
    data = example().to_dict()
    data["robot"] = robot.name
    data["standard_parameters"] = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    data["digests"] = {f"robot {robot.path.name}": robot.digest}
    data["settings"] = {
        "robot": {"friction": {"model": robot.friction.model, "coulomb": "tanh", "coupling": "shaft"}}
    }
    path.write_text(json.dumps(data))
    return path


def test_a_set_into_the_urdf_itself(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = arm.with_name("new.urdf")
    assert main(["export", "--parameters", "urdf", "--urdf", str(arm), "-o", str(out)]) == 0
    text = capsys.readouterr().out
    assert text.startswith(
        f"{out}: written\n\nlink         mass kg     before  centre moved mm  inertia changed %\n"
    )
    assert text.splitlines()[3].split() == ["upper_arm", "4", "4", "0", "0"]
    again = didim.load_robot(out)
    np.testing.assert_allclose(
        again.parameter_set("urdf"), didim.load_robot(arm).parameter_set("urdf"), atol=1e-12
    )
    assert main(["export", "--parameters", "urdf", "--urdf", str(arm), "-o", str(out)]) == 2
    assert "--force overwrites it" in capsys.readouterr().err


def test_a_result_with_its_robot_file(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toml, out = arm.with_name("arm.toml"), arm.with_name("new.urdf")
    assert main(["robot", str(arm), "-o", str(toml)]) == 0
    robot = didim.load_robot(toml)
    x = arm_parameters(robot, 1)
    fit = saved_fit(robot, x, arm.with_name("fit.json"))
    assert main(["export", str(fit), "--urdf", str(arm), "-o", str(out)]) == 0
    again = didim.load_robot(out)
    for name, value in zip(robot.parameter_names, x, strict=True):
        if not name.startswith("Ia"):
            assert again.parameter_set("urdf")[robot.parameter_names.index(name)] == pytest.approx(
                value, rel=1e-11, abs=1e-13
            )
    assert main(["export", str(fit), "--mjcf", "-o", str(arm.with_name("arm.xml"))]) == 0
    assert arm.with_name("arm.xml").read_text() == didim.export.to_mjcf(robot, x)
    capsys.readouterr()
    assert main(["export", str(fit), "--sdf"]) == 0
    out_text, err = capsys.readouterr()
    assert out_text == didim.export.to_sdf(robot, x)
    assert "SDF has no place for rotor inertias (kg.m^2 or kg): shoulder" in err
    toml.write_text(toml.read_text() + "\n# edited\n")
    assert main(["export", str(fit), "--mjcf"]) == 2
    assert "arm.toml has changed since fit.json was made with it" in capsys.readouterr().err
    assert main(["export", str(fit), "--mjcf", "--robot", str(toml)]) == 0
    toml.unlink()
    capsys.readouterr()
    assert main(["export", str(fit), "--mjcf"]) == 2
    assert (
        "its robot file 'arm.toml' is not beside it; say where it is: --robot ROBOT"
        in capsys.readouterr().err
    )


def test_a_result_of_a_packaged_robot(tmp_path: Path) -> None:
    robot = didim.load_robot("planar2")
    x = random_parameters(np.random.default_rng(0), robot)
    source = exported_parameters(
        fit=saved_fit(robot, x, tmp_path / "fit.json"), parameters=None, robot=None, urdf=None
    )
    assert source.robot.name == "planar2"
    assert (source.x == x).all()


def test_a_result_with_friction_per_direction(tmp_path: Path) -> None:
    robot = didim.load_robot("planar2").with_friction(model="asymmetric")
    x = random_parameters(np.random.default_rng(0), robot)
    source = exported_parameters(
        fit=saved_fit(robot, x, tmp_path / "fit.json"), parameters=None, robot=None, urdf=None
    )
    assert source.robot.parameter_names == robot.parameter_names
    model = export_model(source.robot, source.x)
    values = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    assert model.links[0].viscous == 0.5 * (values["Fv1+"] + values["Fv1-"])
    assert model.links[1].coulomb == 0.5 * (values["Fc2+"] + values["Fc2-"])
    assert "friction is the mean of both directions: no format has one per direction" in model.left_out


def test_a_result_of_another_robot(arm: Path) -> None:
    robot = didim.load_robot(arm)
    fit = saved_fit(robot, arm_parameters(robot, 1), arm.with_name("fit.json"))
    with pytest.raises(FitError, match=r"fit\.json: it has parameter 'XX3', which robot 'planar2' has not"):
        exported_parameters(fit=fit, parameters=None, robot="planar2", urdf=None)


def test_base_parameters_alone_are_no_bodies(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = didim.load_robot(arm)
    beta = robot.base_parameters.project(robot.parameter_set("urdf"))
    fit = saved_fit(robot, robot.base_parameters.lift(beta), arm.with_name("fit.json"))
    assert main(["export", str(fit), "--urdf", str(arm)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    # The nearest bodies need the covariance of the same base parameters, which this result has not.
    assert "its base parameters are not those of robot 'little_arm'" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--mjcf"], "export takes either a result, FIT.json, or --parameters"),
        (["fit.json", "--parameters", "urdf", "--mjcf"], "export takes either a result, FIT.json, or --parameters"),
        (["--parameters", "urdf", "--mjcf"], "which robot has these parameters? Say --robot ROBOT"),
        (["--parameters", "urdf", "--mjcf", "--keep-lumped"], "--keep-lumped is for --urdf"),
        (["--parameters", "urdf", "--mjcf", "--robot", "tx40"], "no parameter set 'urdf'"),
        (["--parameters", "no.toml", "--mjcf", "--robot", "tx40"], "no.toml"),
        (["no.json", "--mjcf"], "no.json"),
    ],
)  # fmt: skip
def test_wrong_calls(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1


def test_what_a_report_says(arm: Path) -> None:
    robot = didim.load_robot(arm)
    x = robot.parameter_set("urdf").copy()
    at = robot.parameter_names.index
    # Ten per cent more mass at the same place, and the centre of the forearm 5 mm farther.
    first = at("XX1")
    x[first : first + 10] *= 1.1
    x[at("MX2")] += 0.005 * x[at("M2")]
    x[at("Off3")] = 0.2
    x[at("Ia2")] = 0.4
    _, report = export(robot, x, "urdf", urdf=arm, from_prior={2: ("M3", "XX3")})
    upper, forearm, hand = report.links
    assert upper.mass == pytest.approx(4.4)
    assert upper.mass_before == pytest.approx(4.0)
    assert upper.centre_moved == pytest.approx(0.0, abs=1e-12)
    assert upper.inertia_changed == pytest.approx(0.1)
    assert forearm.centre_moved == pytest.approx(0.005)
    assert hand.from_prior == ("M3", "XX3")
    text = str(report)
    assert text.splitlines()[0].endswith("from the prior")
    assert text.splitlines()[3].endswith("M3 XX3")
    assert "the torque offsets of wrist are left out: no format can represent them" in text
    assert "a URDF has no place for rotor inertias (kg.m^2 or kg): elbow 0.4" in text


def test_a_report_without_a_description() -> None:
    robot = didim.load_robot("tx40")
    rng = np.random.default_rng(0)
    x = random_parameters(rng, robot)
    report = compare_links(export_model(robot, x), [None] * 6)
    lines = str(report).splitlines()
    assert lines[0].split() == ["link", "mass", "kg"]
    assert len(lines) == 7


def test_laws_of_speed_and_path_become_a_line_and_its_error_is_told() -> None:
    terms = [
        FrictionTerm(law="dahl", joint=0, velocity=1e-3),
        FrictionTerm(law="atan", joint=1, velocity=0.3),
        FrictionTerm(law="load", joint=1),
    ]
    robot = didim.load_robot("planar2").with_terms(terms)
    x = np.array([*didim.load_robot("planar2").sets["reference"], 1.5, 0.5, 0.1])
    model = export_model(robot, x)
    values = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    first, second = model.links
    # Memory that has built up is Coulomb friction; an arctangent is not a line.
    assert (first.viscous, first.coulomb) == pytest.approx((values["Fv1"], values["Fc1"] + 1.5))
    speed = np.linspace(0.01, 2.0, 200)
    torque = values["Fv2"] * speed + values["Fc2"] + 0.5 * np.arctan(speed / 0.3)
    slope, height = np.polyfit(speed, torque, 1)
    assert (second.viscous, second.coulomb) == pytest.approx((slope, height))
    worst = np.abs(slope * speed + height - torque).max()
    line, left = (
        sentence for sentence in model.left_out if "Off" not in sentence and "offset" not in sentence
    )
    assert line.startswith("Fz1, Fa2 are viscous and Coulomb friction in the file, off by (N.m, N) ")
    assert f"joint2 {worst:.2g} below 2 rad/s" in line
    assert left.startswith("Fl2 are left out")
    assert joint_friction({**values, "Fa2": -9.0}, 1, terms)[:2] == (0.0, 0.0)


def test_further_friction_terms_are_named(tmp_path: Path) -> None:
    robot = didim.load_robot("planar2")
    x = random_parameters(np.random.default_rng(0), robot)
    path = saved_fit(robot, x, tmp_path / "fit.json")
    data = json.loads(path.read_text())
    data["standard_parameters"] |= {"Fs1": 0.5, "Fl2": 0.0}
    path.write_text(json.dumps(data))
    source = exported_parameters(fit=path, parameters=None, robot=None, urdf=None)
    assert (source.x == x).all()
    doubt = "fit.json: Verdict: doubtful, for 1 reason: Fc2 = -1 N.m is negative, by 3.0 sigma."
    assert source.notes == (doubt, "further friction terms are left out: Fs1")
    path.write_text(json.dumps(data | {"warnings": [], "verdict": {**data["verdict"], "reasons": []}}))
    sound = exported_parameters(fit=path, parameters=None, robot=None, urdf=None)
    assert sound.notes == ("further friction terms are left out: Fs1",)
    del data["standard_parameters"]["ZZ2"]
    path.write_text(json.dumps(data))
    with pytest.raises(FitError, match="it has no parameter 'ZZ2' of robot 'planar2'"):
        exported_parameters(fit=path, parameters=None, robot=None, urdf=None)
