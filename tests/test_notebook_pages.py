"""The notebooks of the documentation: they run, and their pages show what they hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from scripts import script

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST_BYTES = 200_000


def read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def test_there_are_two() -> None:
    assert len(NOTEBOOKS) == 2


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_its_last_answer_is_that_of_the_page(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    codes = ["".join(cell["source"]) for cell in read(path)["cells"] if cell["cell_type"] == "code"]
    for code in codes[:-1]:
        exec(compile(code, path.name, "exec"), names)
    *statements, answer = codes[-1].split("\n")
    exec(compile("\n".join(statements), path.name, "exec"), names)
    assert eval(answer, names) in path.with_suffix(".md").read_text(encoding="utf-8")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_page_is_that_of_its_notebook(path: Path) -> None:
    page = script(FOLDER.parents[1] / "benches" / "notebooks.py").page
    text, pictures = page(read(path), path.stem)
    assert path.with_suffix(".md").read_text(encoding="utf-8") == text
    assert pictures
    for name, data in pictures.items():
        assert (FOLDER / name).read_bytes() == data
    assert path.stat().st_size < LARGEST_BYTES
    for cell in read(path)["cells"]:
        assert cell["cell_type"] == "markdown" or cell["execution_count"] is not None
