"""The commands of docs/ur10e.md run in their order on a simulated UR10e and print what the page says."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim._tools.arrays import Array
from didim.cli.lists import example_commands
from didim.cli.main import main
from scripts import script
from test_tutorials import commands, run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("example") / "ur10e"
    run(f"didim example ur10e -o {path}")
    script(path / "make_logs.py").write_logs(path)
    return path


@pytest.fixture
def text(project: Path) -> str:
    page = (project / "docs" / "ur10e.md").read_text(encoding="utf-8")
    return page.split("## A real log")[0]  # which tests/test_init_logs.py tries


def number(pattern: str, text: str) -> float:
    found = re.search(pattern, " ".join(text.split()))
    assert found, pattern
    return float(found.group(1))


def gravity_error(robot: didim.Robot, truth: didim.Robot, parameters: Array) -> tuple[float, float]:
    """Relative and largest error (N.m) of the torque that holds the arm, beside that of the robot which made the log."""
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 6))
    rest = np.zeros_like(q)
    bodies = [not name.startswith(("Ia", "F", "Off")) for name in truth.parameter_names]
    expected = didim.inverse_dynamics(truth, q, rest, rest, parameters * bodies)
    tau = didim.inverse_dynamics(robot, q, rest, rest, robot.parameter_set("urdf") * bodies)
    return float(np.linalg.norm(tau - expected) / np.linalg.norm(expected)), float(
        np.abs(tau - expected).max()
    )


def test_ten_commands(
    folder: Path, text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    example, logs, *ten = commands(text)
    assert len(ten) == 10
    assert example_commands("ur10e") == [logs, *ten]
    assert example == "didim example ur10e"
    robot, base, init, check, identify, init_other, validate, urdf, mjcf, again = ten
    run(robot)
    assert number(r"links by (\S+) of the largest", capsys.readouterr().out) < 1e-12
    run(base)
    printed = capsys.readouterr().out
    assert printed.startswith("ur10e: 58 base parameters")
    without = printed.rsplit("Without effect on the torques: ", 1)[1].split("\n\n")[0].split(", ")
    assert len(without) == 11
    assert {"M1", "M2"} <= {name.strip() for name in without}
    head = (folder / "log.csv").read_text().splitlines()[0]
    assert head.startswith(re.search(r"^    (time,.*)\.\.\.$", text, flags=re.MULTILINE).group(1))  # type: ignore[union-attr]
    run(init)
    columns = tomllib.loads((folder / "log.toml").read_text())["recording"][0]["torque"]["columns"]
    assert [name.removesuffix("_effort") for name in columns] == list(
        didim.load_robot("ur10e.toml").joint_names
    )
    capsys.readouterr()
    run(check)
    assert capsys.readouterr().out == "log: nothing found.\n"
    run(identify)
    fit = didim.Identification.load("fit.json")
    assert fit.verdict.sound
    assert fit.uncertainty is not None
    assert fit.uncertainty.friction is not None
    # The simulated friction is a tanh and that of the model a sign, which leaves open how friction turns.
    assert fit.uncertainty.friction.p_value.min() > 0.1
    assert 100.0 * fit.overall_relative_error == pytest.approx(
        number(r"relative error is (\S+) %", text), abs=0.01
    )
    assert 100.0 * fit.relative_error.max() == pytest.approx(
        number(r"at most (\S+) % at a wrist", text), abs=0.06
    )
    run(init_other)
    capsys.readouterr()
    run(validate)
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("torque, predicted"))
    second, third = re.search(r"motion as well: (\S+) % and (\S+) %", text).groups()  # type: ignore[union-attr]
    assert [float(value) for value in line.split()[3:5]] == pytest.approx(
        [float(second), float(third)], abs=0.006
    )
    run(urdf)
    printed, err = capsys.readouterr()
    assert number(r": (\S+) standard deviations rms", err) == pytest.approx(
        number(r"here (\S+) standard deviations", text), abs=0.02
    )
    rows = re.findall(r"^    (\w+_link .*)$", text, flags=re.MULTILINE)
    assert len(rows) == 6
    for row in rows:
        shown = next(line for line in printed.splitlines() if line.startswith(row.split()[0])).split()
        # Marks near the border of what the log tells may differ with rounding: most must be those of the page.
        assert len({*shown[5:]} ^ {*row.split()[5:]}) <= 2
        assert [float(value) for value in shown[1:3]] == pytest.approx(
            [float(v) for v in row.split()[1:3]], rel=0.01
        )
    masses = np.array([float(row.split()[1]) for row in rows])
    old, new = didim.load_robot("ur10e.urdf"), didim.load_robot("ur10e_new.urdf")
    parameters = script(folder / "make_logs.py").true_parameters(old)
    truth = parameters[9::14][:6]
    assert number(r"last link has (\S+) kg", text) == masses[5].round(2)
    assert number(r"and the truth is (\S+) kg", text) == truth[5].round(2)
    assert number(r"last links share (\S+) kg", text) == masses[4:].sum().round(2)
    assert number(r"\((\S+) in truth\)", text) == truth[4:].sum().round(2)
    others = np.abs(masses / truth - 1.0)[:4]
    assert (others < 0.01 * number(r"within (\S+) % of the truth", text)).all()
    run(mjcf)
    run(again)
    share, worst = gravity_error(old, old, parameters)
    assert 100.0 * share == pytest.approx(number(r"old URDF is off by (\S+) %", text), abs=0.1)
    assert worst == pytest.approx(number(r"\((\S+) N\.m at the worst", text), abs=0.5)
    assert 100.0 * gravity_error(new, old, parameters)[0] < number(r"the new one by (\S+) %", text)
    engines(text)


def engines(text: str) -> None:
    """Run the block of the page that asks three engines for the same torques."""
    for name in ("mujoco", "pinocchio"):
        pytest.importorskip(name, reason="needs the group 'test'")
    (block,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    names: dict[str, Any] = {}
    exec(block, names)
    expected = names["by_didim"]
    for engine in ("by_pinocchio", "by_mujoco"):
        assert np.abs(names[engine] - expected).max() < 1e-9 * np.abs(expected).max(), engine


def test_a_reversed_joint_is_found(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What `check` would name: the torque of the elbow with the other sign."""
    lines = (folder / "log.csv").read_text().splitlines()
    names = lines[0].split(",")
    values = np.loadtxt(lines[1:], delimiter=",")
    values[:, names.index("elbow_joint_effort")] *= -1.0
    np.savetxt(tmp_path / "log.csv", values, fmt="%.9g", delimiter=",", header=lines[0], comments="")
    (tmp_path / "ur10e.urdf").write_bytes((folder / "ur10e.urdf").read_bytes())
    monkeypatch.chdir(tmp_path)
    run("didim init ur10e.urdf log.csv")
    capsys.readouterr()
    assert main(["check", "log.toml"]) == 1
    found = capsys.readouterr().out
    assert "elbow_joint" in found
