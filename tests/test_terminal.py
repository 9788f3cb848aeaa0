"""What a terminal gets: tables in its width, colours, help in groups; a pipe gets neither colours nor breaks."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from contextlib import suppress

import pytest

import didim
from didim.cli.main import _parser, main
from didim.cli.options import shown
from didim.cli.terminal.color import GREEN, painted
from didim.cli.terminal.guide import COMMANDS
from didim.cli.terminal.width import WIDEST, columns, fitted, wrapped
from didim.result.table import parameter_lines
from scripts import commands_of
from test_identification import example

LONG = (
    "the residual is correlated in time: 4.1 % of the torque; white-noise sigmas would be 2.8 times too small"
)


def on_terminal(*arguments: str, width: int = 80, **environment: str) -> str:
    """Output of the command line on a terminal of so many columns."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
    variables = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "NO_COLOR")}
    variables |= {"TERM": "xterm", **environment}
    process = subprocess.Popen(
        [sys.executable, "-m", "didim", *arguments], stdout=slave, stderr=slave, stdin=slave, env=variables
    )
    os.close(slave)
    parts = []
    try:
        while part := os.read(master, 65536):
            parts.append(part)
    except OSError:  # the end of a terminal is an error of Linux
        pass
    process.wait()
    os.close(master)
    return b"".join(parts).decode().replace("\r\n", "\n")


def longest(text: str) -> int:
    return max(map(len, text.split("\n")))


@pytest.mark.parametrize("width", [80, 160])
@pytest.mark.parametrize(
    "arguments",
    [
        ["robots"], ["methods"], ["schema"], ["base", "tx40"], ["base", "ur10e"], ["robot", "tx40"], ["robot", "ur10e"], ["--help"],
        *([name, "--help"] for names in COMMANDS.values() for name in names if name != "example"), ["completion", "--help"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_every_command_fits(
    arguments: list[str], width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    with suppress(SystemExit):
        main(arguments)
    text = capsys.readouterr().out
    assert text
    assert longest(text) <= width
    assert "\033" not in text


def test_a_result_fits_with_its_units() -> None:
    log = didim.simulated_log(didim.packaged_experiment("tx40"), didim.load_robot("tx40").sets["didim"])
    fit = didim.identify(log)
    whole, narrow = str(fit), fitted(str(fit), 80)
    assert longest(whole) > 80 >= longest(narrow)
    # Only the ratio to white noise is left out; every name, unit, estimate and end of an interval is there.
    assert "/ white" in whole
    assert "/ white" not in narrow
    for row in fit.parameter_rows()[1:]:
        (line,) = (line for line in narrow.split("\n") if line.split()[:1] == [row[0]])
        assert line.split()[:7] == list(row[:7])
    assert fitted(whole, WIDEST).split("\n")[3:63] == whole.split("\n")[3:63]


def test_a_wide_table_continues_below_itself() -> None:
    head = "name  unit  " + "  ".join(f"{f'joint {k}':>12}" for k in range(9))
    rows = [f"row{k}  kg    " + "  ".join(f"{1000 * k + j:12}" for j in range(9)) for k in range(3)]
    text = fitted("\n".join([head, *rows]), 80)
    assert longest(text) <= 80
    for k in range(3):
        lines = [line.split() for line in text.split("\n") if line.startswith(f"row{k}")]
        assert all(line[1] == "kg" for line in lines)
        assert [cell for line in lines for cell in line[2:]] == [str(1000 * k + j) for j in range(9)]


def test_the_text_of_a_last_column_wraps_inside_it() -> None:
    text = fitted(f"a  1.0  {LONG}\nb  2.0  short", 60)
    assert longest(text) <= 60
    lines = text.split("\n")
    assert all(line.startswith(" " * 8) for line in lines[1:-1])
    assert " ".join(text.split()) == f"a 1.0 {LONG} b 2.0 short"


def test_sentences_wrap_between_words_and_keep_units() -> None:
    for width in range(30, 90):
        lines = wrapped(f"- {LONG}", width)
        assert max(map(len, lines)) <= width
        assert all(line.startswith("  ") for line in lines[1:])
        assert not any(line.lstrip().startswith("%") for line in lines)
        assert " ".join(" ".join(lines).split()) == f"- {LONG}"
    assert parameter_lines(example().parameter_rows()) == fitted(
        "\n".join(parameter_lines(example().parameter_rows())), 160
    ).split("\n")


def test_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    for given, expected in (("80", 80), ("5", 60), ("1000", 160), ("wide", None), ("0", None)):
        monkeypatch.setenv("COLUMNS", given)
        assert columns() == expected


def test_a_pipe_gets_lines_as_they_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    main(["base", "tx40"])
    assert longest(capsys.readouterr().out) > 100
    assert painted("x", GREEN) == "x"
    verdict = example().verdict
    assert shown("a\nVerdict: b", verdict) == "a\nVerdict: b"


@pytest.mark.slow
def test_a_terminal_has_width_and_colours() -> None:
    text = on_terminal("robots", width=70)
    assert longest(text) <= 70
    plain = on_terminal("identify", "none.toml", NO_COLOR="1")
    coloured = on_terminal("identify", "none.toml")
    assert "\033" not in plain
    assert coloured.startswith("\033[1;31mdidim:\033[0m ")
    assert re.sub(r"\033\[[\d;]*m", "", coloured) == plain
    assert "\033[1mexamples\033[0m:" in on_terminal("check", "--help")


def test_formats_for_programs_are_never_broken(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    main(["base", "tx40", "--format", "markdown"])
    text = capsys.readouterr().out
    assert all(line.startswith("|") for line in text.rstrip("\n").split("\n"))
    main(["schema", "robot", "--json"])
    assert longest(capsys.readouterr().out) > 100


def test_help_lists_each_command_once() -> None:
    text = _parser().format_help()
    commands = commands_of(_parser())
    for name in commands:
        assert len(re.findall(rf"^  {name} ", text, re.MULTILINE)) == 1, name
    for parser in commands.values():
        assert all(action.help for action in parser._actions)
