"""The pages on robots and exports: their options are those of the commands, the example of a table is read."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from didim._tools.keys import declared
from didim._tools.toml import Table
from didim.cli.main import main
from didim.errors import RobotError
from didim.robot.correspondence import read_correspondence


@pytest.fixture
def page(project: Path) -> str:
    return (project / "docs" / "robots.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("command", "file", "heading"),
    [("robot", "robots", "## Which joints"), ("export", "export", "## Options")],
)
def test_options(
    project: Path, command: str, file: str, heading: str, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (project / "docs" / f"{file}.md").read_text(encoding="utf-8")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    known = set(re.findall(r"^  (?:-o, |-\w FILE, )?(--[\w-]+)", capsys.readouterr().out, flags=re.MULTILINE))
    section = page[page.index(heading) :]
    rows = set(re.findall(r"^\| `(--[\w-]+)", section[: section.index("\n## ")], flags=re.MULTILINE))
    assert rows <= known
    # What every command that writes a file has needs no row.
    assert known - rows <= {"--help", "--output", "--force"}


def example(page: str) -> dict[str, object]:
    block = next(
        block for block in re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL) if "[urdf]" in block
    )
    return dict(tomllib.loads(block)["urdf"])


def read(content: dict[str, object], joints: int = 1) -> object:
    return read_correspondence(
        Table({"urdf": content}, "arm.toml", RobotError, keys=declared("robot")).table("urdf"), joints
    )


def test_the_table_is_read(page: str) -> None:
    found = read(example(page))
    assert getattr(found, "base", None) == "base_link"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("frame_0", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 2, 0]], "frame_0 must be the pose of a frame: its first three columns"),
        ("frame_0", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]], "frame_0 must be the pose of a frame"),
        ("frame_0", [[1, 0, 0, 0]], "frame_0 must be a matrix of 3 rows and 4 columns"),
        ("bass", "x", "unknown key 'bass'; did you mean 'base'?"),
        ("lock", {"finger": "open"}, "finger must be a finite number"),
        ("link", [], "a robot of 1 joint needs as many [[urdf.link]], got 0"),
    ],
)  # fmt: skip
def test_wrong_tables(page: str, key: str, value: object, message: str) -> None:
    with pytest.raises(RobotError) as error:
        read(example(page) | {key: value})
    assert str(error.value).startswith("arm.toml: [urdf")
    assert message in str(error.value)
