"""A measured log of a UR10e with planted faults: the verdict names them; as it is: ``test_init_friction.py``."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.robot.robot_file import PACKAGED

GAINS = [14.87, 13.26, 11.13, 10.62, 11.03, 11.47]
"""N.m/A, of ../shared/data/README.md."""
Edit = Callable[[str], str]


@pytest.fixture(scope="module")
def files(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the log, its experiment file and a robot file that may be damaged."""
    folder = tmp_path_factory.mktemp("ur10e")
    (folder / "free.csv").symlink_to(shared / "data" / "ur10e" / "free.csv")
    (folder / "arm.toml").write_text((PACKAGED / "ur10e.toml").read_text(encoding="utf-8"), encoding="utf-8")
    gains = [str(gain) for gain in GAINS]
    arguments = [str(folder / "arm.toml"), str(folder / "free.csv"), "--columns", "current=14-19"]
    assert main(["init", *arguments, "--plain", "--gain", *gains]) == 0
    return folder


def gravity(vector: str) -> Edit:
    return lambda text: re.sub(r"gravity_m_s2 = .*", f"gravity_m_s2 = {vector}", text, count=1)


def gain(joint: int, factor: float) -> Edit:
    gains = [value * (factor if j == joint - 1 else 1.0) for j, value in enumerate(GAINS)]
    return lambda text: re.sub(r"gain = \[.*\]", f"gain = {gains}", text, count=1)


def exchanged(one: int, other: int) -> Edit:
    columns = list(range(14, 20))
    columns[one - 1], columns[other - 1] = columns[other - 1], columns[one - 1]
    return lambda text: text.replace(f"columns = {list(range(14, 20))}", f"columns = {columns}")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "edit", "code", "joints"),
    [
        ("arm.toml", gravity("[0, 0, 9.81]"), "gravity", ()),
        ("arm.toml", gravity("[0, -9.81, 0]"), "gravity", ()),
        ("free.toml", exchanged(2, 3), "swapped-torques", (2, 3)),
        ("free.toml", exchanged(4, 5), "swapped-torques", (4, 5)),
        ("arm.toml", gravity("[9.81, 0, 0]"), "gravity", ()),
        ("free.toml", gain(1, 2.0), "drive-gain", (1,)),
        ("free.toml", gain(2, 2.0), "drive-gain", (2,)),
        ("free.toml", gain(3, 2.0), "drive-gain", (3,)),
        ("free.toml", gain(4, 2.0), "drive-gain", (4,)),
        ("free.toml", gain(6, -1.0), "torque-sign", (6,)),
    ],
)
def test_a_planted_fault_is_named(
    files: Path, tmp_path: Path, file: str, edit: Edit, code: str, joints: tuple[int, ...]
) -> None:
    for name in ("arm.toml", "free.toml"):
        text = (files / name).read_text(encoding="utf-8")
        changed = edit(text) if name == file else text
        assert (changed != text) == (name == file)
        (tmp_path / name).write_text(changed, encoding="utf-8")
    (tmp_path / "free.csv").symlink_to((files / "free.csv").resolve())
    verdict = didim.identify(didim.load_experiment(tmp_path / "free.toml"), didim.IDIMLS()).verdict
    assert verdict.state != "sound"
    (first,) = [item for item in verdict.grave if "ties" in item.facts]
    named = [
        (first.code, first.joints),
        *((tie["code"], tuple(tie["joints"])) for tie in first.facts["ties"]),
    ]
    assert (code, joints) in named
    if first.code == "gravity":
        np.testing.assert_allclose(first.facts["vector"], [0.0, 0.0, -9.81])
