"""``didim example``: the list, the copy, its refusals, and that the examples' own files are whole."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import didim
from didim.cli.lists import FOLDER, example_commands, packaged_examples
from didim.cli.main import main

NAMES = sorted(path.name for path in FOLDER.iterdir() if path.is_dir())
LISTED = ", ".join(NAMES)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_list_names_every_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert NAMES == ["hobby_arm", "payload", "quadruped", "study", "tx40", "ur10e"]
    assert main(["example"]) == 0
    rows = [line.split(maxsplit=1) for line in capsys.readouterr().out.partition("\n\n")[0].splitlines()]
    assert [name for name, _ in rows] == NAMES
    assert {title for _, title in rows} == set(packaged_examples().values())


@pytest.mark.parametrize("name", NAMES)
def test_an_example_is_copied_with_its_commands(
    name: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["example", name]) == 0
    printed = capsys.readouterr().out
    assert {path.name for path in (here / name).iterdir()} == {
        path.name for path in (FOLDER / name).iterdir() if path.is_file()
    }
    for path in (here / name).iterdir():
        assert path.read_bytes() == (FOLDER / name / path.name).read_bytes()
    commands = printed.split(f"\n\ncd {name}\n")[1].splitlines()
    assert commands == example_commands(name)
    assert len(commands) >= 7
    # Each command is one that there is, and names files of the example or files that an earlier command writes.
    there = {path.name for path in (here / name).iterdir()}
    for command in commands:
        program, *arguments = command.split()
        if program == "python":
            assert arguments[0] in there
            text = (here / name / arguments[0]).read_text(encoding="utf-8")
            there |= set(re.findall(r"\w+\.csv", text))
            continue
        written = {arguments[k + 1] for k, word in enumerate(arguments) if word in ("-o", "--json")}
        if arguments[0] == "init":
            written |= {f"{Path(arguments[2]).stem}.toml"}
        assert {word for word in arguments if re.search(r"\.[a-z]", word)} <= there | written, command
        there |= written


def test_nothing_is_overwritten_unasked(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "mine").mkdir()
    mine = here / "mine" / "tx40_simulation.toml"
    mine.write_text("my work")
    (here / "mine" / "notes.txt").write_text("stays")
    assert main(["example", "tx40", "-o", "mine"]) == 2
    assert capsys.readouterr().err == (
        "didim: mine: it has 'tx40_simulation.toml' already; --force overwrites, -o takes another folder\n"
    )
    assert sorted(path.name for path in (here / "mine").iterdir()) == ["notes.txt", mine.name]
    assert mine.read_text() == "my work"
    assert main(["example", "tx40", "-o", "mine", "--force"]) == 0
    assert mine.read_bytes() == (FOLDER / "tx40" / mine.name).read_bytes()
    assert (here / "mine" / "notes.txt").read_text() == "stays"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tx4"], f"there is no example 'tx4'; did you mean 'tx40'? (there are: {LISTED})"),
        (["../robots"], f"there is no example '../robots' (there are: {LISTED})"),
        (["-o", "x"], "-o needs the name of an example: didim example tx40 -o FOLDER"),
    ],
)
def test_refusals(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str], here: Path) -> None:
    assert main(["example", *arguments]) == 2
    assert capsys.readouterr().err == f"didim: {message}\n"
    assert not list(here.iterdir())


def test_a_folder_that_cannot_be_made_is_said(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "tx40").write_text("a file")
    assert main(["example", "tx40"]) == 2
    assert "tx40" in capsys.readouterr().err


def test_the_file_of_a_packaged_robot_is_copied(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "planar2", "-o", "arm.toml"]) == 0
    assert capsys.readouterr().out.startswith("arm.toml: written\n")
    assert didim.load_robot("arm.toml").parameter_names == didim.load_robot("planar2").parameter_names
    assert (here / "arm.toml").read_bytes() == (FOLDER.parent / "robots" / "planar2.toml").read_bytes()
    assert main(["robot", "planar2", "-o", "arm.toml"]) == 2
    assert "--force overwrites it" in capsys.readouterr().err
    assert main(["robot", "planar2", "-o", "arm.txt"]) == 2
    assert "ends in .toml" in capsys.readouterr().err
    shutil.copy("arm.toml", "other.toml")
    assert main(["robot", "other.toml", "-o", "third.toml"]) == 2
    assert "other.toml is a file already" in capsys.readouterr().err
