"""The check of the wheel: which wheel it takes, what its environment lacks, and how it measures. `make wheel-check` runs it."""

from __future__ import annotations

import json
import os
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

from scripts import script

pytestmark = pytest.mark.tools


@pytest.fixture(scope="module")
def check(project: Path) -> ModuleType:
    return script(project / "benches" / "wheel_check.py")


def test_the_newest_wheel_is_taken(check: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"there is no wheel in .*: `make wheel` makes one"):
        check.newest_wheel(tmp_path)
    for name, seconds in (("didim-0.9-x.whl", 1), ("didim-0.10-x.whl", 2), ("other-1-x.whl", 3)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (seconds, seconds))
    assert check.newest_wheel(tmp_path).name == "didim-0.10-x.whl"


def test_the_environment_has_no_rust_and_no_paths_of_python(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("CARGO_HOME", "/cargo")
    monkeypatch.setenv("PATH", f"/cargo/bin{os.pathsep}{os.environ['PATH']}")
    bare = check.bare_environment(tmp_path)
    assert set(bare) <= {"HOME", "LANG", "TMPDIR", "PATH"}
    assert bare["PATH"].split(os.pathsep) == [str(tmp_path), "/usr/bin", "/bin"]


def test_sizes_are_those_of_files_without_what_python_compiles(check: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "a" / "__pycache__").mkdir(parents=True)
    (tmp_path / "a" / "one").write_bytes(bytes(300_000))
    (tmp_path / "two").write_bytes(bytes(200_000))
    (tmp_path / "a" / "__pycache__" / "c.pyc").write_bytes(bytes(900_000))
    assert check.megabytes(tmp_path) == pytest.approx(0.5)


def test_interpreters_of_other_systems_are_entered_by_chroot(check: ModuleType, tmp_path: Path) -> None:
    here = check.Place.named("/usr/bin/python3")
    assert here.command("python", "-m", "pip") == ["python", "-m", "pip"]
    assert here.here(Path("/tmp/a")) == Path("/tmp/a")
    there = check.Place.named(f"{tmp_path}:/opt/bin/python3")
    assert there.python == "/opt/bin/python3"
    program, *words = there.command("python", tmp_path)
    assert Path(program).name == "chroot"
    assert Path(program).is_absolute()
    assert words == [str(tmp_path), "python", str(tmp_path)]
    assert there.here(Path("/tmp/a")) == tmp_path / "tmp" / "a"


def test_the_core_must_not_need_more_than_the_wheel_promises(
    check: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wheel = tmp_path / "didim-1-cp311-abi3-manylinux_2_17_x86_64.manylinux2014_x86_64.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("didim/_core.abi3.so", b"..GLIBC_2.2.5..GLIBC_2.9..GLIBC_2.35..")
        archive.writestr("didim/notes.txt", b"GLIBC_2.99")
    assert check.glibc(wheel) == (35, 17)
    monkeypatch.setattr("sys.argv", ["wheel_check.py", str(wheel)])
    with pytest.raises(SystemExit, match=r"promises glibc 2\.17, and its core needs 2\.35"):
        check.main()
    other = wheel.rename(tmp_path / "didim-1-cp311-abi3-linux_x86_64.whl")
    assert check.glibc(other) == (35, None)


def test_a_command_runs_in_its_folder_and_must_end_well(check: ModuleType, tmp_path: Path) -> None:
    here, environment = check.Place.named("python3"), {"PATH": os.environ["PATH"]}
    assert check.succeed(here, tmp_path, environment, ["pwd", "-P"]).strip() == str(tmp_path.resolve())
    with pytest.raises(SystemExit, match="sh -c exit 3 ended with exit code 3"):
        check.succeed(here, tmp_path, environment, ["sh", "-c", "exit 3"])


@pytest.mark.parametrize("failure", ["", "no such thing\nno wheel of it for this processor"])
def test_examples_that_need_an_extra_come_last(
    check: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    failure: str,
) -> None:
    readmes = {"a_arm": "pip install 'didim[some]'", "b_arm": "nothing", "c_arm": "nothing"}
    done: list[str] = []

    def succeed(place: object, folder: Path, environment: object, words: list[str]) -> str:
        if words == ["didim", "example"]:
            return "".join(f"{name}  a title\n" for name in readmes)
        if words[:2] == ["didim", "example"]:
            (tmp_path / words[2]).mkdir()
            (tmp_path / words[2] / "README.md").write_text(readmes[words[2]])
            return f"files\n\ncd {words[2]}\none\ntwo\n"
        done.append(f"{folder.name} {words[-1]}")
        return ""

    def installation(place: object, python: Path, package: str) -> str:
        done.append(package)
        return failure

    monkeypatch.setattr(check, "succeed", succeed)
    monkeypatch.setattr(check, "installation", installation)
    check.run_examples(check.Place.named("python3"), tmp_path, {}, Path("python3"), Path("/didim.whl"))
    # The others run beside each other, each with its commands in their order.
    for name in ("b_arm", "c_arm"):
        assert [text for text in done[:4] if text.startswith(name)] == [f"{name} one", f"{name} two"]
    assert done[4] == "/didim.whl[some]"
    assert done[5:] == ([] if failure else ["a_arm one", "a_arm two"])
    printed = capsys.readouterr().out.splitlines()
    if failure:
        assert printed[-1] == (
            "  a_arm: NOT RUN, pip cannot install didim[some] here: no wheel of it for this processor"
        )
    else:
        assert printed[-1].startswith("  a_arm: 2 commands with didim[some], ")
    assert list(tmp_path.iterdir()) == []


def wheel_with(folder: Path, **files: str) -> Path:
    wheel = folder / "didim-1-x.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, text in files.items():
            archive.writestr(f"didim-1.dist-info/{name.replace('__', '/')}", text)
    return wheel


def test_licences_and_the_sbom_must_travel(check: ModuleType, project: Path, tmp_path: Path) -> None:
    text = (project / "THIRD_PARTY_LICENSES.txt").read_text(encoding="utf-8")
    sbom = json.dumps({"components": [{"name": "nalgebra", "version": "9.9.9"}]})
    licences = {"licenses__THIRD_PARTY_LICENSES.txt": text}
    with pytest.raises(SystemExit, match="has no SBOM"):
        check.unlicensed(wheel_with(tmp_path, **licences))
    with pytest.raises(SystemExit, match="has no licences of its Rust packages"):
        check.unlicensed(wheel_with(tmp_path, **{"sboms__a.json": sbom}))
    assert check.unlicensed(wheel_with(tmp_path, **licences, **{"sboms__a.json": sbom})) == ["nalgebra 9.9.9"]
    locked = tomllib.loads((project / "Cargo.lock").read_text(encoding="utf-8"))["package"]
    sbom = json.dumps({"components": locked})
    assert check.unlicensed(wheel_with(tmp_path, **licences, **{"sboms__a.json": sbom})) == []
    assert {item["name"] for item in locked} >= {*check.MUST_TRAVEL}
    assert "Apache License" in text
    assert "Redistribution and use in source and binary forms" in text


def test_the_file_of_licences_is_that_of_the_lock_file(project: Path) -> None:
    licences = script(project / "benches" / "licences.py")
    assert licences.FILE.read_text(encoding="utf-8") == licences.document()


def test_the_wheel_tells_no_folder_of_its_builder(
    check: ModuleType, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CARGO_HOME", "/home/who/.cargo")
    texts = {"a.json": f"path+file://{project}/rust", "core": "crates/faer/lib.rs", "METADATA": "/didim"}
    assert check.naming_folders(wheel_with(tmp_path, **texts)) == ["didim-1.dist-info/a.json"]
    assert check.naming_folders(wheel_with(tmp_path, core="/home/who/.cargo/registry/src/faer.rs")) == [
        "didim-1.dist-info/core"
    ]
