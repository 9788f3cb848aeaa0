"""The scripts of `didim completion`, run by the shells themselves."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from didim.cli.main import _parser, main
from didim.methods.table import METHODS
from scripts import commands_of

CASES = {
    "didim id": {"identify"},
    "didim identify --me": {"--method"},
    "didim identify --method ": set(METHODS),
    "didim compare --nelder-mead s": {"short"},
    "didim base ur1": {"ur10", "ur10e", "ur16e"},
    "didim completion f": {"fish"},
}
"""Lines, and what completes them."""


def script(shell: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["completion", shell]) == 0
    return capsys.readouterr().out


def need(shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")


def run(shell: str, text: str, folder: Path) -> list[str]:
    done = subprocess.run([shell, "-c", text], capture_output=True, text=True, check=True, cwd=folder)
    assert not done.stderr
    return done.stdout.splitlines()


def test_bash(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    need("bash")
    lines = [script("bash", capsys)]
    for line in CASES:
        words = [f'"{word}"' for word in line.split(" ")]
        lines.append(f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; _didim")
        lines.append('echo "${COMPREPLY[*]}"')
    found = run("bash", "\n".join(lines), tmp_path)
    assert [set(line.split()) for line in found] == list(CASES.values())


def test_fish(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    need("fish")
    text = script("fish", capsys)
    for line, expected in CASES.items():
        found = run("fish", f"{text}\ncomplete -C '{line}'", tmp_path)
        assert {entry.split("\t")[0] for entry in found} == expected


def test_zsh_reads_its_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    need("zsh")
    text = script("zsh", capsys)
    run("zsh", f"compdef() {{ echo $*; }}\n{text}", tmp_path)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_option_is_in_it(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = script(shell, capsys)
    commands = commands_of(_parser())
    for name, parser in commands.items():
        assert name in text
        for action in parser._actions:
            for option in action.option_strings:
                assert written(option, shell) in text


def written(option: str, shell: str) -> str:
    """Option as the script of a shell has it."""
    if shell != "fish":
        return option
    return f"-l {option[2:]}" if option.startswith("--") else f"-s {option[1:]}"
