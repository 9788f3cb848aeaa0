"""Errors made on purpose: their places are where they say, and constants are found, changed and reached."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def constants(project: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(project / "benches"))
    return importlib.import_module("constants")


def test_every_place_is_there_once(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(project / "benches"))
    assert importlib.import_module("mutations").stale() == []


@pytest.mark.slow
def test_a_change_is_that_of_one_value(constants: ModuleType, project: Path) -> None:
    every = list(constants.constants(project))
    assert len(every) > 300
    for planted in every:
        text = (project / planted.file).read_text(encoding="utf-8")
        before, after = (part.splitlines() for part in (text, planted.apply(text)))
        first, rest = planted.line - 1, len(before) - planted.end[0]
        last = len(after) - rest
        assert after[:first] + after[last:] == before[:first] + before[len(before) - rest :]
        assert after[first:last] != before[first : len(before) - rest]
        (changed,) = ast.parse("\n".join(after[first:last])).body
        assert isinstance(changed, ast.Assign | ast.AnnAssign)
        (name,) = [node.id for node in ast.walk(changed) if isinstance(node, ast.Name) and node.id.isupper()]
        assert name == planted.name


def test_constants_come_by_their_seed_and_whole_ones_stay_whole(
    constants: ModuleType, tmp_path: Path
) -> None:
    folder = tmp_path / "python" / "didim" / "methods"
    folder.mkdir(parents=True)
    (folder / "a.py").write_text(
        'MOST = 3\n"""é"""; SHARE: float = -0.5\nONE = 1\nOFF = 0.0\nYES = True\nlow = 2\n',
        encoding="utf-8",
    )
    found = [(planted.name, planted.new) for planted in constants.constants(tmp_path)]
    assert found == [
        ("MOST", "3 * 2"),
        ("MOST", "3 // 2"),
        ("SHARE", "-0.5 * 2"),
        ("SHARE", "-0.5 / 2"),
        ("ONE", "1 * 2"),
    ]
    two = constants.drawn(tmp_path, 2, 5)
    assert two == constants.drawn(tmp_path, 2, 5)
    assert len(constants.drawn(tmp_path, 99, 5)) == 5


def test_lines_that_use_a_constant(constants: ModuleType, tmp_path: Path) -> None:
    folder = tmp_path / "python" / "didim" / "methods"
    folder.mkdir(parents=True)
    (folder / "a.py").write_text(
        "MOST = 3\nTWICE = 2 * MOST\n\ndef f(x, most=MOST):\n    x += 1\n    return x\n"
        "\ndef g(x):\n    return (\n        TWICE\n    )\n",
        encoding="utf-8",
    )
    (folder / "b.py").write_text(
        "from .a import MOST\n\ndef h():\n    if MOST:\n        return 1\n    return 2\n", encoding="utf-8"
    )
    (folder / "c.py").write_text("MOST = 4\n\ndef h():\n    return MOST\n", encoding="utf-8")
    (folder / "d.py").write_text("class D:\n    FAR = 3\n\nNEAR = 1\n", encoding="utf-8")
    by_name = {
        planted.name: planted for planted in constants.constants(tmp_path) if "c.py" not in planted.file
    }
    lines = {path.name: found for path, found in constants.lines_using(by_name["MOST"], tmp_path).items()}
    assert lines == {"a.py": {6, 9, 10}, "b.py": {4}}
    nowhere = constants.lines_using(by_name["NEAR"], tmp_path)
    assert {path.name: found for path, found in nowhere.items()} == {"d.py": {1, 2, 3, 4}}


@pytest.mark.tools
def test_a_changed_constant_is_noticed_or_not(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(project / "benches"))
    mutations = importlib.import_module("mutations")
    (tmp_path / "test_a.py").write_text("def test_a(): assert True\n", encoding="utf-8")
    (tmp_path / "test_b.py").write_text("def test_b(): assert False\n", encoding="utf-8")
    (tmp_path / "test_c.py").write_text("def test_c():\n    while True: pass\n", encoding="utf-8")
    assert mutations.run_in_turn(tmp_path, ["test_a.py"], 60.0) == (True, "1 tests")
    assert mutations.run_in_turn(tmp_path, ["test_a.py", "test_b.py"], 60.0) == (False, "test_b.py::test_b")
    assert mutations.run_in_turn(tmp_path, ["test_c.py", "test_b.py"], 2.0) == (True, "out of time")
    assert mutations.run_in_turn(tmp_path, [], 60.0) == (True, "no test reaches it")
