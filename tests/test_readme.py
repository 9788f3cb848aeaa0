"""The README: its commands exist, its files exist, and its Python example runs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def python_block() -> str:
    """Return the only Python block of the README."""
    (block,) = re.findall(r"^```python\n(.*?)^```$", README, flags=re.DOTALL | re.MULTILINE)
    return str(block)


def test_the_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(python_block(), "README.md", "exec"), names)

    fit = names["fit"]
    assert isinstance(fit, didim.Identification)
    printed = capsys.readouterr().out
    assert all(name in printed for name in fit.names)
    assert "ZZ1R = ZZ1 + " in printed

    truth = didim.load_robot("tx40").set_base("didim_physical")
    assert np.mean(np.abs(fit.beta - truth) <= 3.0 * fit.std) >= 0.97
    saved = didim.Identification.load("fit.json")
    np.testing.assert_array_equal(saved.beta, fit.beta)
    robot, q = didim.load_robot("tx40"), names["q"]
    found = didim.load_parameters(robot, "found.toml")
    np.testing.assert_array_equal(found, fit.parameters)
    rest = np.zeros((100, 6))
    assert isinstance(q, np.ndarray)
    expected = didim.inverse_dynamics(robot, q, rest, rest, fit.parameters)
    np.testing.assert_allclose(np.asarray(names["gravity"]), expected)


def test_the_example_is_short() -> None:
    assert len([line for line in python_block().splitlines() if line]) <= 15


def test_its_commands_exist(capsys: pytest.CaptureFixture[str]) -> None:
    commands = re.findall(r"^    didim (\w+) (.*)$", README, flags=re.MULTILINE)
    assert {"base", "compare", "identify", "simulate", "validate"} <= {command for command, _ in commands}
    for command, arguments in commands:
        with pytest.raises(SystemExit) as ended:
            main([command, "--help"])
        assert ended.value.code == 0
        shown = capsys.readouterr().out
        assert all(option in shown for option in re.findall(r"--\w+", arguments))


def test_every_file_it_links_to_exists() -> None:
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", README)
    assert len(targets) >= 8
    for target in targets:
        assert (ROOT / target).is_file(), target


def test_its_make_targets_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^    make (\w+)$", README, flags=re.MULTILINE)
    assert targets == ["demo", "test"]
    for target in targets:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
