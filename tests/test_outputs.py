"""Outputs: checked before the work, never lost after it; damaged inputs, control characters, numbers of threads, Ctrl-C."""

from __future__ import annotations

import io
import json
import os
import resource
import signal
import stat
import subprocess
import sys
import threading
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from arm import arm_file, arm_log
from didim import CLOE, IDIMLS, identify
from didim._tools.files import check_output, write_atomically, write_elsewhere
from didim._tools.words import printable
from didim.cli.main import main
from didim.errors import DidimError, FitError, OutputError
from didim.report import write
from didim.robot.parameter_file import load_parameters


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Experiment file with its log beside it."""
    return arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")


OUTPUTS = ("--json", "--save-parameters")


@pytest.mark.parametrize("option", OUTPUTS)
@pytest.mark.parametrize("place", ["absent/fit.toml", "folder.toml"])
def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    file: Path, option: str, place: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(file.parent)
    Path("folder.toml").mkdir()
    monkeypatch.setattr(IDIMLS, "run", None)  # called, it would be an error of another kind
    assert main(["identify", str(file), option, place]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"didim: cannot write '{place}': ")
    assert err.count("\n") == 1


@pytest.mark.parametrize("command", ["simulate", "validate"])
def test_other_commands_look_ahead_too(
    file: Path, command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["identify", str(file), "--quiet", "--json", str(tmp_path / "fit.json")]) == 0
    arguments = {
        "simulate": ["simulate", str(file), "--parameters", "reference", "-o", "absent/run.csv"],
        "validate": ["validate", str(tmp_path / "fit.json"), str(file), "--json", "absent/fit.json"],
    }
    assert main(arguments[command]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "there is no folder" in err


def test_two_outputs_of_one_path_are_refused(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same = str(file.with_name("out.toml"))
    assert main(["identify", str(file), "--json", same, "--save-parameters", same]) == 2
    assert "two outputs have the same path" in capsys.readouterr().err


def limited(arguments: list[str], folder: Path, size: int) -> subprocess.CompletedProcess[str]:
    """Run a command line that can write files of at most `size` bytes, as on a full disk."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    # Without -B the limit cuts the compiled modules short that this process writes, and every later one fails.
    command = [sys.executable, "-B", "-m", "didim", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, preexec_fn=limit, check=False)


@pytest.mark.slow
def test_a_full_disk_costs_no_result(file: Path, tmp_path: Path) -> None:
    """Not even the folder for temporary files takes the file: the table is printed, even with --quiet."""
    run = limited(["identify", str(file), "--quiet", "--json", "fit.json"], tmp_path, 512)
    assert run.returncode == 1
    assert run.stdout.startswith("arm: 13 base parameters of robot planar2 by idim-ls\n")
    assert run.stderr.startswith("didim: fit.json: File too large; it could not be written elsewhere either")
    assert run.stderr.count("\n") == 1
    assert not (tmp_path / "fit.json").exists()
    assert not list(tmp_path.glob(".*tmp"))


def test_an_output_that_fails_late_is_written_elsewhere(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    target = tmp_path / "away" / "fit.json"
    target.parent.mkdir()
    run = IDIMLS.run

    def remove_folder(self: IDIMLS, *arguments: Any) -> Any:
        target.parent.rmdir()
        return run(self, *arguments)

    monkeypatch.setattr(IDIMLS, "run", remove_folder)
    assert main(["identify", str(file), "--quiet", "--json", str(target)]) == 1
    out, err = capsys.readouterr()
    assert "parameter" in out
    assert err.endswith(f"the content is in '{tmp_path / 'fit-1.json'}' instead\n")
    assert didim.Identification.load(tmp_path / "fit-1.json").method == "idim-ls"


@pytest.mark.slow
def test_a_result_that_cannot_be_printed_is_saved(file: Path, tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        run = subprocess.run(
            [sys.executable, "-m", "didim", "identify", str(file)],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert run.returncode == 1
    assert run.stderr == (
        f"didim: the output: No space left on device; the content is in '{tmp_path / 'didim-result-1.txt'}' instead\n"
    )
    assert "parameter" in (tmp_path / "didim-result-1.txt").read_text(encoding="utf-8")


def test_a_full_disk_under_a_checkpoint_does_not_end_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("didim.methods.cloe.checkpoint.write_atomically", full)
    fit = identify(arm_log(1), CLOE(start="reference", checkpoint=tmp_path / "search.npz", max_iterations=3))
    assert any("could not be written" in text and "No space left on device" in text for text in fit.remarks)


# Files: modes, threads, places.


def test_modes_are_kept_and_new_files_follow_the_mask(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    write_atomically(path, "{}")
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    path.chmod(0o600)
    write_atomically(path, "{ }")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert path.read_text(encoding="utf-8") == "{ }"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_check_prints_its_findings_when_they_cannot_be_saved(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(file.parent)
    assert main(["check", str(file), "--json", "absent/out.json"]) == 2
    assert capsys.readouterr().out == ""
    assert main(["check", str(file), "--json", "/dev/full"]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("arm: ")
    assert "No space left on device; the content is in '" in err
    assert json.loads(Path("full-1").read_text(encoding="utf-8"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_init_checks_its_file_first_and_never_loses_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    t = np.arange(200) / 100.0
    columns = np.column_stack([t, np.sin(t), np.cos(t), np.sin(2.0 * t), np.cos(2.0 * t)])
    np.savetxt("log.csv", columns, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    # Before the log is read: this one could not be.
    Path("wrong.csv").write_text("t,q1\n0,a\n", encoding="utf-8")
    assert main(["init", "planar2", "wrong.csv", "-o", "absent/log.toml"]) == 2
    assert "absent" in capsys.readouterr().err
    code = main(["init", "planar2", "log.csv", "-o", "/dev/full", "--force"])
    assert code == 1
    out, err = capsys.readouterr()
    assert "time stamps" in out
    assert "No space left on device; the content is in '" in err
    assert "schema = 1" in Path("full-1").read_text(encoding="utf-8")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_checkpoint_is_not_read_from_a_device(file: Path) -> None:
    experiment = didim.load_experiment(file)
    with pytest.raises(FitError, match="/dev/full: a checkpoint must be a file"):
        identify(experiment, CLOE(checkpoint="/dev/full", start="reference"))


def test_write_elsewhere_where_nothing_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere() -> str:
        raise FileNotFoundError("no usable temporary directory found")

    def full(path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.gettempdir", nowhere)
    assert write_elsewhere(Path("fit.json"), full) is None


@pytest.mark.slow
def test_threads_save_to_one_path(tmp_path: Path) -> None:
    fit = identify(arm_log(1), IDIMLS())
    path, failures = tmp_path / "fit.json", []

    def save() -> None:
        for _ in range(40):
            try:
                fit.save(path)
            except OSError as error:  # pragma: no cover - what the test looks for
                failures.append(error)

    threads = [threading.Thread(target=save) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    np.testing.assert_array_equal(didim.Identification.load(path).beta, fit.beta)
    assert [item.name for item in tmp_path.iterdir()] == ["fit.json"]


def test_check_output_leaves_nothing(tmp_path: Path) -> None:
    check_output(tmp_path / "new.json")
    assert not list(tmp_path.iterdir())
    check_output(Path(os.devnull))
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        check_output(tmp_path)


def test_write_elsewhere_takes_no_name_that_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("out-1.csv").write_text("old", encoding="utf-8")

    def write(path: Path) -> None:
        path.write_text("new", encoding="utf-8")

    place = write_elsewhere(Path("absent/out.csv"), write)
    assert place == tmp_path / "out-2.csv"
    assert Path("out-1.csv").read_text(encoding="utf-8") == "old"


# Outputs that are inputs.


@pytest.fixture
def inputs(file: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with an experiment, its robot, its log, a result and a link of each kind to the log."""
    folder = file.parent
    monkeypatch.chdir(folder)
    robot = Path(didim.__file__).parent / "packaged" / "robots" / "planar2.toml"
    (folder / "robot.toml").write_bytes(robot.read_bytes())
    text = file.read_text(encoding="utf-8").replace('robot = "planar2"', 'robot = "robot.toml"')
    file.write_text(text, encoding="utf-8")
    assert "robot.toml" in text
    identify(didim.load_experiment(file), IDIMLS()).save(folder / "fit.json")
    (folder / "alias").symlink_to(LOG)
    (folder / "twin").hardlink_to(LOG)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


LOG = "log.npz"
WRITING = {
    "identify": ("identify", "arm.toml", "--json"),
    "parameters": ("identify", "arm.toml", "--save-parameters"),
    "report": ("identify", "arm.toml", "--report"),
    "checkpoint": ("identify", "arm.toml", "--method", "cloe", "--start", "reference", "--checkpoint"),
    "validate": ("validate", "fit.json", "arm.toml", "--json"),
    "validate-report": ("validate", "fit.json", "arm.toml", "--report"),
    "check": ("check", "arm.toml", "--json"),
    "payload": ("payload", "fit.json", "arm.toml", "--json"),
    "residual": ("residual", "fit.json", "arm.toml", "-o"),
    "simulate": ("simulate", "arm.toml", "--parameters", "fit.json", "-o"),
    "init": ("init", "robot.toml", LOG, "--force", "-o"),
    "export": ("export", "fit.json", "--robot", "robot.toml", "--mjcf", "--force", "-o"),
}
READ_BY = {
    "export": ("robot.toml", "fit.json"),
    "init": ("robot.toml", LOG, "alias", "twin"),
    **dict.fromkeys(("validate", "validate-report", "payload", "residual", "simulate"), (LOG, "fit.json")),
}
"""Files that a command reads, where it is not the experiment alone."""


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (command, name)
        for command in WRITING
        for name in READ_BY.get(command, ("arm.toml", "robot.toml", LOG, "alias", "twin"))
    ],
)
def test_no_output_is_written_over_an_input(
    command: str,
    name: str,
    inputs: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(IDIMLS, "run", None)  # called, it would be an error of another kind
    before = contents(inputs)
    arguments = [*WRITING[command], name]
    if command == "parameters" and not arguments[-1].endswith((".toml", ".npz")):
        pytest.skip("no name of a file of parameters")
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"didim: cannot write '{arguments[-1]}': it is ")
    assert "is read by the same command and would be lost" in err
    assert contents(inputs) == before


def test_results_are_not_saved_over_what_they_were_made_of(inputs: Path) -> None:
    """Files and reports saved from Python, and under a name that nobody has read: the content decides."""
    experiment = didim.load_experiment("arm.toml")
    fit = identify(experiment, IDIMLS())
    before = contents(inputs)
    for name in ("arm.toml", "robot.toml", LOG, "alias", "twin"):
        with pytest.raises(OutputError, match="the result was computed from this file"):
            fit.save(name)
        with pytest.raises(OutputError, match="the result was computed from this file"):
            didim.check(experiment).save(name)
    with pytest.raises(OutputError, match="the result was computed from this file"):
        fit.save_parameters("arm.toml")
    with pytest.raises(OutputError, match="the result was computed from this file"):
        write(Path(LOG), fit, experiment)
    assert contents(inputs) == before
    fit.save("fit.json")  # a result may be replaced by another
    didim.Identification.load("fit.json").save("fit.json")


@pytest.mark.parametrize("option", ["--json", "--report", "--save-parameters"])
def test_links_that_lead_in_a_circle_are_refused(
    option: str, file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(file.parent)
    monkeypatch.setattr(IDIMLS, "run", None)
    Path("loop.toml").symlink_to("loop.toml")
    assert main(["identify", str(file), option, "loop.toml"]) == 2
    assert capsys.readouterr().err == ("didim: cannot write 'loop.toml': Too many levels of symbolic links\n")
    assert Path("loop.toml").is_symlink()


def test_names_of_files_need_not_be_utf_8(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(file.parent)
    odd = Path(os.fsdecode(b"\xffarm.toml"))
    file.rename(odd)
    out = Path(os.fsdecode(b"\xfe.json"))
    assert main(["identify", str(odd), "--json", str(out)]) == 0
    assert main(["identify", str(odd), "--quiet", "--save-parameters", "found.toml"]) == 0
    assert main(["simulate", str(odd), "--parameters", "found.toml", "-o", os.fsdecode(b"\xfd.csv")]) in (
        0,
        1,
    )
    assert didim.Identification.load(out).name == didim.load_experiment(odd).name
    capsys.readouterr()


def test_init_does_not_name_a_log_that_toml_cannot_name(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(file.parent)
    log = Path(os.fsdecode(b"\xff.csv"))
    log.write_text("t,q1,q2,tau1,tau2\n" + "0,0,0,0,0\n" * 20, encoding="utf-8")
    assert main(["init", "planar2", str(log), "-o", "new.toml"]) == 2
    assert "is not UTF-8" in capsys.readouterr().err
    assert not Path("new.toml").exists()


def test_whatever_fails_in_an_output_the_result_is_printed(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(didim.Identification, "save", broken)
    assert main(["identify", str(file), "--quiet", "--json", str(tmp_path / "fit.json")]) == 1
    out, err = capsys.readouterr()
    assert "parameter" in out
    assert err.endswith("fit.json: ZeroDivisionError; it could not be written elsewhere either\n")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(didim.Identification, "save", interrupted)
    assert main(["identify", str(file), "--quiet", "--json", str(tmp_path / "fit.json")]) == 130
    out, err = capsys.readouterr()
    assert "parameter" in out
    assert err.endswith("fit.json: interrupted, not written\n")


@pytest.mark.slow
def test_text_that_stdout_cannot_encode_is_escaped(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace('name = "arm"', 'name = "bras d\u2019essai"', 1), encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "didim", "identify", str(file)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        check=False,
    )
    assert run.returncode in (0, 1)
    assert run.stdout.startswith("bras d\\u2019essai: ")


def test_export_says_what_it_assumed_beside_what_it_wrote(
    inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    arguments = ["export", "fit.json", "--robot", "robot.toml", "--c", "-o", "arm.h"]
    assert main(arguments) == 0
    assert "didim: note: " in capsys.readouterr().err
    monkeypatch.setattr("didim._tools.files.write_atomically", full)
    assert main([*arguments, "--force"]) == 1
    out, err = capsys.readouterr()
    assert "didim: note: " not in err
    assert "it could not be written elsewhere either" in err
    assert "#include" in out


# Damaged inputs.


def huge(shape: str) -> bytes:
    """An npz archive whose arrays declare a shape."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in ("parameter_names", "parameters"):
            archive.writestr(f"{name}.npy", content)
    return buffer.getvalue()


def damaged(data: bytes, offset: int, value: int) -> bytes:
    """Set two bytes of each local header and each entry of the directory of an archive."""
    changed = bytearray(data)
    for mark, place in ((b"PK\x03\x04", offset), (b"PK\x01\x02", offset + 2)):
        at = changed.find(mark)
        while at >= 0:
            changed[at + place : at + place + 2] = value.to_bytes(2, "little")
            at = changed.find(mark, at + 4)
    return bytes(changed)


@pytest.mark.parametrize("kind", ["huge", "compression", "encrypted", "cut"])
def test_damaged_parameter_files_are_one_sentence(
    kind: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fit.npz"
    identify(arm_log(1), IDIMLS()).save_parameters(path)
    sound = path.read_bytes()
    content = {
        "huge": huge(f"({2**60},)"),
        "compression": damaged(sound, 8, 99),
        "encrypted": damaged(sound, 6, 1),
        "cut": sound[: len(sound) // 2],
    }[kind]
    path.write_bytes(content)
    sentence = "declare a content of" if kind == "huge" else "not an npz file of parameters"
    with pytest.raises(FitError, match=sentence):
        load_parameters(didim.load_robot("planar2"), path)
    assert main(["simulate", str(file), "--parameters", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("covariance", float("nan"), "the variance of .* is nan"),
        ("covariance", -1.0, "the variance of .* is -1"),
        ("value", float("nan"), "the value of .* is nan"),
    ],
)
def test_results_with_impossible_numbers_are_refused(
    key: str, value: float, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "fit.json"
    identify(arm_log(1), IDIMLS()).save(path)
    data = json.loads(path.read_text(encoding="utf-8"))
    if key == "covariance":
        data["covariance"][2][2] = value
    else:
        data["parameters"][2]["value"] = value
    path.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(FitError, match=message):
        didim.Identification.load(path)


def test_control_characters_do_not_reach_the_terminal(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert printable("a\x1b[31mb\x07\nc\td") == "a\\x1b[31mb\\x07\nc\td"
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace('name = "arm"', 'name = "a\\u001b[31mrm"', 1), encoding="utf-8")
    assert main(["identify", str(file)]) == 0
    assert main(["identify", str(file), "--method", "cloe", "--start", "\x1b[2Jnone"]) == 2
    out, err = capsys.readouterr()
    assert "\x1b" not in out + err
    assert "a\\x1b[31mrm" in out


@pytest.mark.parametrize("threads", ["2", 1.5, 2**70, 0, -1, True])
def test_wrong_numbers_of_threads_are_one_sentence(threads: Any) -> None:
    with pytest.raises(FitError, match="threads must be a whole number"):
        CLOE(threads=threads)
    robot = didim.load_robot("planar2")
    reference = didim.Reference.point_to_point([[0, 0], [1, 1]], max_velocity=[1, 1], max_acceleration=[1, 1])
    controller = didim.Controller.pd([100.0, 20.0], [10.0, 2.0])
    with pytest.raises(DidimError, match="threads"):
        didim.simulate(robot, robot.parameter_set("reference"), reference, controller, threads=threads)


def test_ctrl_c_while_modules_are_loaded_is_one_line(tmp_path: Path) -> None:
    """A module that is loaded late says that it is being loaded, and waits; a shell may have Ctrl-C ignored."""
    folder = tmp_path / "numpy"
    folder.mkdir()
    (folder / "__init__.py").write_text(
        "import signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "print('loading', file=sys.stderr, flush=True)\nsignal.pause()\n",
        encoding="utf-8",
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    process = subprocess.Popen(
        [sys.executable, "-m", "didim", "base", "tx40"],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    with process:
        assert process.stderr is not None
        assert process.stderr.readline() == "loading\n"
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == "didim: interrupted\n"
    assert process.returncode == 130


def test_a_pipe_without_a_reader_is_told_and_one_with_a_reader_is_written(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    check_output(pipe)
    with pytest.raises(OSError, match="it is a pipe that nobody reads") as error:
        write_atomically(pipe, "lost")
    assert error.value.filename == str(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    text = "x" * 200_000  # more than the pipe holds
    while not read:
        try:
            write_atomically(pipe, text)
        except OSError:  # the reader has not opened it yet
            continue
        reader.join()
    assert read == [text]


def test_a_file_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    sync, replace = os.fsync, Path.replace

    def synced(handle: int) -> None:
        done.append("fsync")
        sync(handle)

    def replaced(path: Path, target: Path) -> Path:
        done.append("replace")
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    write_atomically(tmp_path / "fit.json", "{}")
    assert done == ["fsync", "replace", "fsync"]
