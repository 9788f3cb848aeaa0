"""The program that takes outputs away: what it counts as lost, and a few of its cases."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.tools


@pytest.fixture(scope="module")
def benches(project: Path) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(project / "benches")
        yield


@pytest.fixture(scope="module")
def fuzz(benches: None) -> ModuleType:
    return importlib.import_module("fuzz_outputs")


@pytest.fixture(scope="module")
def material(benches: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        importlib.import_module("fuzz_material").make(folder)
    return folder


def test_what_is_lost(fuzz: ModuleType, tmp_path: Path) -> None:
    late = fuzz.Case("late", ("identify", "out.json"))
    early = fuzz.Case("early", ("identify", "out.json"), early=True)
    sentence = "didim: out.json: No space left on device; the content is in 'out-1.json' instead\n"
    assert "lost: refused after" in fuzz.complaint(late, fuzz.Ending(2, "", "didim: full\n"), tmp_path)
    assert fuzz.complaint(early, fuzz.Ending(2, "", "didim: full\n"), tmp_path) == ""
    assert "without one sentence" in fuzz.complaint(early, fuzz.Ending(2, "table", "didim: a\n"), tmp_path)
    assert "exit code 3" in fuzz.complaint(late, fuzz.Ending(3, "table", ""), tmp_path)
    assert "Traceback" in fuzz.complaint(late, fuzz.Ending(1, "table", "Traceback"), tmp_path)
    assert "neither printed nor written" in fuzz.complaint(late, fuzz.Ending(0, "", ""), tmp_path)
    assert "nothing is where" in fuzz.complaint(late, fuzz.Ending(1, "", sentence), tmp_path)
    (tmp_path / "out-1.json").write_text("{}", encoding="utf-8")
    assert fuzz.complaint(late, fuzz.Ending(1, "", sentence), tmp_path) == ""


def test_some_cases(fuzz: ModuleType, material: Path, tmp_path: Path) -> None:
    chosen = [case for case in fuzz.cases() if case.name.startswith(("identify --json", "check --json"))]
    assert len(chosen) >= 10
    assert fuzz.outputs(material, tmp_path / "case", chosen[:3] + chosen[-6:-1:2]) == 0


def test_an_output_that_is_an_input_must_be_refused(fuzz: ModuleType, material: Path, tmp_path: Path) -> None:
    chosen = [
        case
        for case in fuzz.cases()
        if case.name.startswith("identify --save-parameters .toml,") and case.source
    ]
    assert [case.way for case in chosen] == ["path", "symbolic link", "hard link"]
    assert fuzz.outputs(material, tmp_path / "case", chosen[1:2]) == 0
    folder = tmp_path / "spoilt"
    folder.mkdir()
    (folder / "log.toml").write_text("{}", encoding="utf-8")
    ending = fuzz.Ending(0, "table", "")
    assert "lost: log.toml was written over" in fuzz.complaint(chosen[0], ending, folder, material)
    (folder / "log.toml").write_bytes((material / "log.toml").read_bytes())
    assert "not refused" in fuzz.complaint(chosen[0], ending, folder, material)


def test_hostile_files_and_lost_ones(benches: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = importlib.import_module("fuzz_hostile")
    monkeypatch.chdir(tmp_path)
    for suffix in (".toml", ".json", ".npz", ".mat", ".mcap"):
        for name, write in made.kinds(suffix).items():
            path = Path(f"{name}{suffix}".replace(" ", "-"))
            write(path)
            if name not in made.SPECIAL:
                assert path.stat().st_size < made.MB, path
    before = {"log.csv": b"1\n", "rows.jsonl": b"{}\n{", "search.npz": b"1"}
    for name, content in before.items():
        Path(name).write_bytes(content)
    Path("search.npz").write_bytes(b"2")
    Path("rows.jsonl").write_bytes(b"{}\n{}\n")
    Path("alias.npz").symlink_to("search.npz")
    files = ("log.csv", "rows.jsonl", "search.npz")
    arguments = ["study", "study.toml", "-o", "rows.jsonl"]
    for checkpoint in ("search.npz", "alias.npz"):
        line = ["identify", "log.toml", "--checkpoint", checkpoint]
        assert made.losses(before, line, files) == "lost or changed: rows.jsonl"
    assert made.losses({"rows.jsonl": before["rows.jsonl"]}, arguments, files) == ""
    Path("log.csv").unlink()
    assert (
        made.losses(before, [*arguments, "--checkpoint", "search.npz"], files) == "lost or changed: log.csv"
    )
    written = ["identify", "log.toml", "--json", "log.csv"]
    assert made.losses({"log.csv": b"1\n"}, written, files) == "lost or changed: log.csv"
    assert made.losses({"log.csv": b"1\n"}, written, ("log.h5",)) == ""
    rng = importlib.import_module("random").Random(1)
    Path("log.csv").touch()
    for _ in range(20):
        changed = ["identify", "log.toml", "--json", "out.json"]
        assert made.alias(changed, ("log.csv",), rng).startswith("output over log.csv by its ")
        assert os.path.samefile(changed[3], "log.csv")


def test_notes_may_stand_before_the_sentence_of_a_refusal_and_warnings_may_not(benches: None) -> None:
    wrong = importlib.import_module("fuzz").wrong_refusal
    sentence = "didim: robot.toml: no such file\n"
    assert wrong("", sentence) == ""
    assert wrong("", f"didim: note: the log was resampled\n{sentence}") == ""
    assert "without one sentence" in wrong("", f"didim: warning: overflow\n{sentence}")
    assert "without one sentence" in wrong("", sentence * 2)
    assert "without one sentence" in wrong("", "didim: note: the log was resampled\n")


def test_a_tally_goes_on_where_it_was(
    benches: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = importlib.import_module("fuzz")
    monkeypatch.setattr(program, "REPORT_EVERY", 2)
    path = tmp_path / "seed-3.txt"
    first = program.Tally(path, 3, resume=True)
    for number, outcome in ((0, "result"), (7, "failed"), (2, "long")):
        first.count(number, outcome)
    assert capsys.readouterr().out == "2 cases, seed 3: 1 result, 0 refused, 0 long, 1 failed\n"
    second = program.Tally(path, 3, resume=True)
    assert second.outcomes == {0: "result", 7: "failed", 2: "long"}
    assert program.Tally(path, 3, resume=False).outcomes == {}
    assert path.read_text(encoding="ascii") == ""
