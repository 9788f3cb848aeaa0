"""Parameter sets of packaged robots that were identified from public logs."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import RobotError
from didim.robot.robot_file import PACKAGED, packaged_robots

IDENTIFIED = {name: robot for name, robot in packaged_robots().items() if robot.origins}


@pytest.mark.parametrize("name", IDENTIFIED)
def test_every_origin_has_its_set_its_log_and_its_commands(name: str) -> None:
    robot = IDENTIFIED[name]
    for key, origin in robot.origins.items():
        x = robot.sets[key]
        assert np.linalg.norm(x) > 0.0
        assert origin.licence in ("BSD-3-Clause", "MIT", "Apache-2.0")
        assert len(origin.sha256) == 64
        assert 0.0 < origin.missed_percent < 10.0
        first, second = origin.commands
        assert first.startswith(f"didim init {name} {origin.file} ")
        assert second.startswith("didim identify log.toml ")
    assert set(IDENTIFIED) == {"go2", "panda", "ur10"}


def test_robots_are_listed_with_their_origins(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    printed = capsys.readouterr().out
    for name, robot in IDENTIFIED.items():
        for key, origin in robot.origins.items():
            assert f"{name}, set {key!r}, identified from {origin.data} ({origin.licence})" in printed


@pytest.mark.slow
@pytest.mark.parametrize(("name", "folder"), [("panda", "unisa"), ("go2", "go2")])
def test_the_commands_give_the_set_again(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, folder: str
) -> None:
    (origin,) = IDENTIFIED[name].origins.values()
    log = shared / "data" / folder / origin.file
    if not log.is_file():
        pytest.skip(f"{origin.file} is not there")
    assert hashlib.sha256(log.read_bytes()).hexdigest() == origin.sha256
    (tmp_path / origin.file).symlink_to(log)
    monkeypatch.chdir(tmp_path)
    for command in origin.commands:
        main(command.split()[1:])
    robot = IDENTIFIED[name]
    (key,) = robot.origins
    wanted, again = (
        robot.base_parameters.project(x) for x in (robot.sets[key], didim.load_parameters(robot, "set.toml"))
    )
    np.testing.assert_allclose(again, wanted, rtol=1e-3, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('verdict = "sound"', 'verdict = "fine"', "verdict must be"),
        ("licence =", "license =", "licence"),
        ("missed_percent = ", "missed_percent = -", "missed_percent must be"),
    ],
)
def test_a_wrong_origin_is_one_sentence(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = (PACKAGED / "panda.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "panda.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(RobotError, match=message) as caught:
        didim.load_robot(path)
    assert "\n" not in str(caught.value)
