"""Files that are read: regular, of a size that memory has, of a depth and width that logs have; one sentence for all others."""

from __future__ import annotations

import io
import json
import os
import resource
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from arm import arm_file, arm_log
from didim._tools import inputs
from didim._tools.inputs import check_expanded, free_memory, read_file
from didim._tools.toml import DEEP_KEY, read_toml
from didim.cli.main import main
from didim.errors import DidimError, ExperimentError, RecordingError
from didim.log.csv_file import CsvFile
from didim.log.data_file import open_data_file
from didim.log.data_format import LONGEST_LINE, MOST_COLUMNS

MEMORY_GB = 1
"""Address space of a process that reads a hostile file of less than 1 MB, beside what the modules take."""


def opened(path: Path) -> Any:
    return open_data_file(path, path.name, delimiter=None, header=None)


def text(file: CsvFile) -> np.ndarray:
    return file.get([1], None, 1)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Sentence of a command that refuses its input."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    return err.removeprefix("didim: ").rstrip("\n")


# Regular files only.


def make_pipe(path: Path) -> None:
    os.mkfifo(path)


def make_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def make_folder(path: Path) -> None:
    path.mkdir()


def make_loop(path: Path) -> None:
    path.symlink_to(path.name)


KINDS: dict[Callable[[Path], None], str] = {
    make_pipe: "it is a pipe; save its content as a file",
    make_device: "it is a device; save its content as a file",
    make_folder: "Is a directory",
    make_loop: "Too many levels of symbolic links",
}


@pytest.mark.parametrize("make", KINDS, ids=lambda make: make.__name__)
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("in.toml", ["identify", "in.toml"]),
        ("in.toml", ["base", "in.toml"]),
        ("in.urdf", ["robot", "in.urdf"]),
        ("in.json", ["payload", "in.json", "log.toml"]),
        ("in.csv", ["init", "planar2", "in.csv"]),
        ("in.npz", ["init", "planar2", "in.npz"]),
        ("in.npz", ["simulate", "arm.toml", "--parameters", "in.npz"]),
        ("in.jsonl", ["study", "in.jsonl"]),
        ("in.toml", ["study", "in.toml"]),
        ("in.mcap", ["init", "planar2", "in.mcap"]),
    ],
    ids=lambda value: value if isinstance(value, str) else "-".join(value),
)
def test_only_regular_files_are_read(
    make: Callable[[Path], None],
    name: str,
    arguments: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A pipe is not opened: nobody writes to it, and the test would not end."""
    monkeypatch.chdir(tmp_path)
    arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")
    make(tmp_path / name)
    if name == "in.mcap" and make is make_folder:
        pytest.skip("a folder is a bag")
    assert refused(arguments, capsys) == f"{name}: cannot be read ({KINDS[make]})"


def test_a_device_among_the_data_of_an_experiment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")
    log = next(path for path in tmp_path.iterdir() if path.suffix != ".toml")
    log.unlink()
    log.symlink_to("/dev/zero")
    assert "it is a device" in refused(["identify", str(file)], capsys)


def test_a_sparse_file_larger_than_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    with path.open("wb") as file:
        file.truncate(10**9)
    monkeypatch.setattr(inputs, "free_memory", lambda: 1_500_000_000)
    with pytest.raises(
        RecordingError, match=r"log\.csv: reading it takes 2 GB of memory, and 1\.5 GB are free"
    ):
        opened(path)


def test_descriptions_are_small(tmp_path: Path) -> None:
    path = tmp_path / "log.toml"
    with path.open("wb") as file:
        file.truncate(inputs.LARGEST_DESCRIPTION + 1)
    with pytest.raises(ExperimentError, match=r"it has 10 MB, and descriptions have at most 10; is it a log"):
        read_toml(path, ExperimentError)


def test_free_memory_knows_the_limit_of_the_process() -> None:
    free = free_memory()
    assert free is None or free > 0
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))\n"
        "from didim._tools.inputs import free_memory; print(free_memory())"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert 0 < int(done.stdout) < 2 << 30


# Logs.


def test_a_line_of_a_log_has_an_end(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"log: line 1 has 2 MB; is the file binary"):
        CsvFile(b"1," * 1_000_000, "log", ",", None)
    body = b"1,2\n" + b"3," * (LONGEST_LINE // 2) + b"4\n"
    with pytest.raises(RecordingError, match=r"log: line 2 has 1 MB"):
        text(CsvFile(body, "log", ",", None))


def test_a_log_has_a_number_of_columns_that_logs_have() -> None:
    header = ",".join(f"c{k}" for k in range(MOST_COLUMNS))
    row = ",".join(["1"] * MOST_COLUMNS)
    file = CsvFile(f"{header}\n{row}\n{row}\n".encode(), "log", ",", None)
    assert file.get(["c9999"], None, 1).tolist() == [[1.0], [1.0]]
    with pytest.raises(
        RecordingError, match=r"the first line has 10001 columns, and a log has at most 10000"
    ):
        CsvFile(f"{header},more\n{row},1\n".encode(), "log", ",", None)


def test_faults_are_found_line_by_line() -> None:
    with pytest.raises(RecordingError, match=r"row 3 \(line 4\) is blank"):
        text(CsvFile(b"a,b\n1,2\n3,4\n\n5,6\n", "log", ",", None))
    with pytest.raises(RecordingError, match=r"row 2 has 1 column where the first line has 2"):
        text(CsvFile(b"1,2\n3\n", "log", ",", None))


# Archives.


def npz(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def mat(**arrays: np.ndarray) -> bytes:
    from scipy.io import savemat

    stream: Any = io.BytesIO()
    savemat(stream, arrays, do_compression=True)
    return bytes(stream.getvalue())


def hdf5(**arrays: np.ndarray) -> bytes:
    h5py = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values, compression="gzip")
    return stream.getvalue()


def declared_npz(count: int) -> bytes:
    """An archive whose array declares more than its entry holds."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        head = io.BytesIO()
        shape: Any = {"descr": "<f8", "fortran_order": False, "shape": (count,)}
        np.lib.format.write_array_header_1_0(head, shape)
        archive.writestr("q.npy", head.getvalue() + bytes(80))
    return stream.getvalue()


def declared_hdf5(count: int) -> bytes:
    """A file whose dataset declares a shape and holds nothing of it."""
    h5py = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.create_dataset("q", shape=(count,), chunks=(1000,), dtype="f8")
    return stream.getvalue()


def inflated_mat(size: int) -> bytes:
    """A file of version 5 with one compressed element that is nothing but zeros."""
    packed = zlib.compress(bytes(size), 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    return head + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed


SIZE = 10 << 20
"""Zeros: 80 MB of 64-bit numbers in 80 kB."""


@pytest.mark.parametrize(
    ("suffix", "make"),
    [
        ("npz", lambda: npz(q=np.zeros(SIZE), t=np.zeros(3))),
        ("npz", lambda: npz(q=np.zeros(SIZE, dtype=np.int8))),
        ("npz", lambda: declared_npz(10**10)),
        ("mat", lambda: mat(q=np.zeros(SIZE))),
        ("mat", lambda: mat(q=np.zeros(SIZE, dtype=np.int8))),
        ("mat", lambda: inflated_mat(8 * SIZE)),
        ("h5", lambda: hdf5(q=np.zeros(SIZE))),
        ("h5", lambda: declared_hdf5(10**12)),
    ],
    ids=["zeros", "bytes", "declared", "mat", "mat-bytes", "mat-element", "hdf5", "hdf5-declared"],
)
def test_an_archive_does_not_expand_beyond_measure(
    suffix: str, make: Callable[[], bytes], tmp_path: Path
) -> None:
    path = tmp_path / f"log.{suffix}"
    path.write_bytes(make())
    assert path.stat().st_size < 1_000_000
    with pytest.raises(
        RecordingError, match=r"log[.]\w+: its \d+ bytes declare a content of .* bytes, more than 200"
    ):
        opened(path)


@pytest.mark.parametrize(("suffix", "make"), [("npz", npz), ("mat", mat), ("h5", hdf5)])
def test_compressed_logs_are_read(suffix: str, make: Callable[..., bytes], tmp_path: Path) -> None:
    """Counts of an encoder that stands still half of the time."""
    steps = np.random.default_rng(1).integers(0, 2, 50_000)
    steps[25_000:] = 0
    counts = np.cumsum(steps[:, None] * np.ones(2), axis=0)
    path = tmp_path / f"log.{suffix}"
    path.write_bytes(make(q=counts))
    np.testing.assert_array_equal(opened(path).get([1, 2], "q", 2), counts)


def test_an_hour_of_a_log_is_within_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten million rows of seven joints: three signals of 64-bit numbers, compressed to a tenth, on a computer of 8 GB."""
    size = 10_000_000 * 7 * 3 * 8
    monkeypatch.setattr(inputs, "free_memory", lambda: 8 << 30)
    check_expanded(size, size // 10, "log.npz", RecordingError)
    inputs.check_memory(2 * 2_500_000_000, "log.csv", RecordingError)
    with pytest.raises(
        RecordingError, match=r"log\.csv: reading it takes 10 GB of memory, and 8\.59 GB are free"
    ):
        inputs.check_memory(10_000_000_000, "log.csv", RecordingError)


def test_numbers_of_other_files_are_not_read(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("q", shape=(100,), dtype="f8", external=[("/dev/zero", 0, 800)])
    with pytest.raises(
        RecordingError, match=r"variable 'q' cannot be read \(its numbers are in other files\)"
    ):
        opened(path).get(["q"], None, 1)


def test_a_bag_does_not_expand_beyond_measure(tmp_path: Path) -> None:
    chunk = (0).to_bytes(16, "little") + (1 << 40).to_bytes(8, "little") + bytes(20)
    path = tmp_path / "run.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + b"\x06" + len(chunk).to_bytes(8, "little") + chunk)
    with pytest.raises(RecordingError, match=r"declare a content of"):
        opened(path)


# Depth.


@pytest.mark.parametrize("key", ["a.{} = 1", "[a.{}]", "'a'.{} = 1", '"a" . {} = 1', "x = {{ a.{} = 1 }}"])
def test_keys_of_toml_are_not_deep(key: str, tmp_path: Path) -> None:
    path = tmp_path / "log.toml"
    many = "\n".join(f"k{k}{'.b' * 90} = 1" for k in range(60))
    for content in (key.format(".".join(["b"] * 50_000)), f"{many}\n{key.format('c')}"):
        path.write_text(f"{content}\n", encoding="utf-8")
        with pytest.raises(ExperimentError, match=r"log\.toml: its keys have more than 5000 dots"):
            read_toml(path, ExperimentError)
    path.write_text(key.format(".".join(["b"] * 20)) + "\n", encoding="utf-8")
    assert read_toml(path, ExperimentError)


def test_numbers_of_toml_have_points() -> None:
    for content in ("x = [" + "0.5, " * 10_000 + "]", "# 1.2.3 " * 5_000, "a" * 1_000_000, '"' * 10_000):
        assert DEEP_KEY.search(content) is None


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a":' * 100_000], ids=["lists", "tables"])
def test_results_are_not_deep(content: str, tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(DidimError, match=r"fit\.json: not a JSON file"):
        didim.Identification.load(path)


# What no reader has foreseen.


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (MemoryError("Unable to allocate 8 EiB"), "there is not enough memory for this (Unable to allocate 8 EiB)"),
        (MemoryError(), "there is not enough memory for this"),
        (RecursionError("maximum recursion depth exceeded"), "this is nested too deeply (maximum recursion"),
        (np.linalg.LinAlgError("SVD did not converge"), "its numbers have no solution (SVD did not converge)"),
        (UnicodeEncodeError("utf-8", "\udcff", 0, 1, "surrogates"), "a text is not UTF-8 ("),
    ],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_errors_beyond_the_readers_are_a_sentence_with_the_last_file(
    error: Exception,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")

    def broken(*_: object) -> None:
        raise error

    monkeypatch.setattr(didim.IDIMLS, "run", broken)
    log = next(path for path in tmp_path.iterdir() if path.suffix != ".toml")
    assert refused(["identify", str(file)], capsys).startswith(f"{log}: {sentence}")


def test_other_errors_are_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")

    def broken(*_: object) -> None:
        raise ValueError("a defect of the program")

    monkeypatch.setattr(didim.IDIMLS, "run", broken)
    with pytest.raises(ValueError, match=r"a defect of the program"):
        main(["identify", str(file)])


@pytest.mark.slow
def test_reading_beyond_the_memory_of_the_process_is_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(["x" * 1000] * 300_000), encoding="utf-8")

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_GB << 30,) * 2)

    done = subprocess.run(
        [sys.executable, "-m", "didim", "payload", str(path), "log.toml"],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "fit.json: " in done.stderr
    assert "memory" in done.stderr


def test_read_file_names_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(DidimError, match=r"nothing: no such log$"):
        read_file(tmp_path / "nothing", DidimError, "no such log")
    with pytest.raises(DidimError, match=r"is not a file name"):
        read_file(Path("a\0b"), DidimError)
