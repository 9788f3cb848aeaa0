"""Recordings: files of each format come out the same, and each fault of a file is named by row and column."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from didim.errors import DidimError, ExperimentError, RecordingError
from didim.log.data_folder import DataFolder
from didim.log.data_format import LOST_SAMPLE
from didim.log.recording import Recording
from didim.log.recording_file import read_recording, read_reduction
from didim.log.sampling import check_time
from plain import fake_robot
from tables import experiment_table

Array = NDArray[np.float64]
N = 50
RATE = 1000.0


def motion() -> tuple[Array, Array, Array]:
    """Time, positions and torques of two joints."""
    t = np.arange(N) / RATE
    q = np.column_stack([np.sin(30 * t), np.cos(20 * t)])
    return t, q, 3.0 * q + 1.0


def write_csv(path: Path, names: str | None, *columns: Array, delimiter: str = ",") -> None:
    rows = np.column_stack(columns)
    lines = [delimiter.join(f"{value!r}" for value in row) for row in rows.tolist()]
    path.write_text("\n".join([*([names] if names else []), *lines]) + "\n", encoding="utf-8")


def read(
    folder: Path,
    content: dict[str, Any],
    robot: Any = None,
    reduction: Array | None = None,
) -> Recording:
    table = experiment_table("recording", content)
    return read_recording(table, "run 1", robot or fake_robot(), reduction, DataFolder(folder))


def described(file: str, **keys: Any) -> dict[str, Any]:
    """Tables for a CSV file with the columns t, q1, q2, u1, u2."""
    content: dict[str, Any] = {
        "time": {"file": file, "columns": ["t"]},
        "position": {"file": file, "columns": ["q1", "q2"], "unit": "rad", "side": "joint"},
        "torque": {"file": file, "columns": ["u1", "u2"], "unit": "N.m", "side": "joint"},
    }
    content.update(keys)
    return content


@pytest.fixture
def csv_file(tmp_path: Path) -> Path:
    path = tmp_path / "a.csv"
    write_csv(path, "t,q1,q2,u1,u2", *motion())
    return path


def message(folder: Path, content: dict[str, Any], **keys: Any) -> str:
    with pytest.raises(DidimError) as caught:
        read(folder, content, **keys)
    return str(caught.value)


# --- what comes out


def test_csv_npz_and_mat_give_the_same_recording(tmp_path: Path, csv_file: Path) -> None:
    import scipy.io

    t, q, u = motion()
    np.savez(tmp_path / "a.npz", t=t, q=q, u=u)
    scipy.io.savemat(tmp_path / "a.mat", {"t": t, "q": q, "u": u})
    recordings = [read(tmp_path, described("a.csv"))]
    for file in ("a.npz", "a.mat"):
        content = {
            "time": {"file": file, "variable": "t"},
            "position": {"file": file, "variable": "q", "unit": "rad", "side": "joint"},
            "torque": {"file": file, "variable": "u", "unit": "N.m", "side": "joint"},
        }
        recordings.append(read(tmp_path, content))
    for recording in recordings:
        np.testing.assert_array_equal(recording.t, t)
        np.testing.assert_array_equal(recording.q, q)
        assert recording.tau is not None
        np.testing.assert_array_equal(recording.tau, u)
        assert recording.rate_hz == pytest.approx(RATE, rel=1e-12)
        assert recording.windows == ((0, N),)
        assert recording.role == "fit"
        assert recording.q.flags.c_contiguous
        assert not recording.q.flags.writeable
    assert recordings[0].digests == {"a.csv": hashlib.sha256(csv_file.read_bytes()).hexdigest()}


@pytest.mark.parametrize(("delimiter", "key"), [(";", ";"), ("\t", "\t"), ("  ", " ")])
@pytest.mark.parametrize("header", [True, False])
def test_delimiters_headers_and_line_ends(tmp_path: Path, delimiter: str, key: str, header: bool) -> None:
    _, q, _ = motion()
    path = tmp_path / "a.csv"
    write_csv(path, delimiter.join(["q1", "q2"]) if header else None, q, delimiter=delimiter)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n") + b"\r\n\r\n")
    position = {"file": "a.csv", "delimiter": key, "unit": "rad", "side": "joint"}
    np.testing.assert_array_equal(read(tmp_path, {"rate_hz": RATE, "position": position}).q, q)


def test_columns_by_number_beside_a_column_of_text_and_quotes(tmp_path: Path) -> None:
    lines = ["mode,q1,q2"] + [f'"run, {i}",{i}.5,"{i * 2}"' for i in range(N)]
    (tmp_path / "a.csv").write_text("\n".join(lines), encoding="utf-8")
    position = {"file": "a.csv", "columns": [3, 2], "unit": "rad", "side": "joint"}
    q = read(tmp_path, {"rate_hz": RATE, "position": position}).q
    np.testing.assert_array_equal(q, np.column_stack([np.arange(N) * 2, np.arange(N) + 0.5]))


def test_columns_of_vectors_and_of_a_matrix(tmp_path: Path) -> None:
    import scipy.io

    _, q, _ = motion()
    scipy.io.savemat(tmp_path / "a.mat", {"q1": q[:, 0], "q2": q[:, 1:], "all": np.column_stack([q, q, q])})
    position: dict[str, Any] = {"file": "a.mat", "columns": ["q1", "q2"], "unit": "rad", "side": "joint"}
    np.testing.assert_array_equal(read(tmp_path, {"rate_hz": RATE, "position": position}).q, q)
    position = {"file": "a.mat", "variable": "all", "columns": [5, 6], "unit": "rad", "side": "joint"}
    np.testing.assert_array_equal(read(tmp_path, {"rate_hz": RATE, "position": position}).q, q)


def test_units_and_motor_side(tmp_path: Path) -> None:
    t, q, u = motion()
    reduction = np.array([[100.0, 0.0], [50.0, -80.0]])
    q_motor, tau_motor = q @ reduction.T, np.linalg.solve(reduction.T, u.T).T
    write_csv(tmp_path / "t.csv", "t", t * 1e3)
    write_csv(tmp_path / "q.csv", "a,b", q_motor * 4096 / (2 * math.pi))
    write_csv(tmp_path / "u.csv", "a,b", tau_motor / [2.0, -0.5])
    content: dict[str, Any] = {
        "time": {"file": "t.csv", "unit": "ms"},
        "position": {"file": "q.csv", "unit": "count", "counts_per_rev": 4096, "side": "motor"},
        "torque": {"file": "u.csv", "unit": "A", "gain": [2.0, -0.5], "side": "motor"},
        "reference": {"file": "q.csv", "unit": "count", "counts_per_rev": 4096, "side": "motor"},
    }
    recording = read(tmp_path, content, reduction=reduction)
    np.testing.assert_allclose(recording.t, t, atol=1e-15)
    np.testing.assert_allclose(recording.q, q, atol=1e-12)
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, u, atol=1e-10)
    np.testing.assert_array_equal(recording.q_ref, recording.q)
    # The gains of the robot stand in for those of the table.
    del content["torque"]["gain"]
    again = read(tmp_path, content, fake_robot(gains=(2.0, -0.5)), reduction)
    np.testing.assert_array_equal(again.tau, recording.tau)
    # They are the motors': a current given as joint side, behind a reduction, has to say its own.
    content["torque"]["side"] = "joint"
    expected = "log.toml: [recording.torque] unit 'A' needs the drive gain: gain = number or list of 2"
    assert message(tmp_path, content, robot=fake_robot(gains=(2.0, -0.5)), reduction=reduction) == expected


@pytest.mark.parametrize(("unit", "factor"), [("deg", math.pi / 180), (["rad", "deg"], [1, math.pi / 180])])
def test_angles(tmp_path: Path, csv_file: Path, unit: Any, factor: Any) -> None:
    content = described("a.csv")
    content["position"]["unit"] = unit
    np.testing.assert_allclose(read(tmp_path, content).q, motion()[1] * factor, rtol=1e-15)


def test_windows_are_half_open_slices_in_order(tmp_path: Path, csv_file: Path) -> None:
    content = described("a.csv", windows_s=[[0.03, 0.05], [0.0, 0.01], [0.01, 0.02]], role="held-out")
    recording = read(tmp_path, content)
    assert recording.windows == ((0, 10), (10, 20), (30, 50))
    assert recording.role == "held-out"


def test_rounded_time_stamps_are_even_and_the_declared_rate_counts(tmp_path: Path) -> None:
    t, q, u = motion()
    write_csv(tmp_path / "a.csv", "t,q1,q2,u1,u2", t.astype(np.float32).astype(float), q, u)
    assert read(tmp_path, described("a.csv", rate_hz=RATE)).rate_hz == RATE


# --- faults of the content


def edit(path: Path, line: int, text: str) -> None:
    lines = path.read_text(encoding="utf-8").split("\n")
    lines[line - 1] = text
    path.write_text("\n".join(lines), encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.041,1,nan,1,1", f"column 'q2', is nan{LOST_SAMPLE}"),
        ("0.041,1,inf,1,1", f"column 'q2', is inf{LOST_SAMPLE}"),
        ("0.041,1,abc,1,1", "column 'q2', is 'abc', not a number"),
        ("0.041,1,,1,1", f"column 'q2', is empty{LOST_SAMPLE}"),
        ("0.041,1,1_0,1,1", "column 'q2', is '1_0', not a number"),
        ("", "is blank; samples must not be missing"),
        ("1,2,3,4", "has 4 columns where the first line has 5"),
        ("1,2,3,4,5,6", "has 6 columns where the first line has 5"),
    ],
)
def test_bad_cells_and_rows_are_named(tmp_path: Path, csv_file: Path, text: str, expected: str) -> None:
    edit(csv_file, 43, text)
    comma = "," if expected.startswith("column") else ""
    assert message(tmp_path, described("a.csv")) == f"a.csv: row 42 (line 43){comma} {expected}"


def test_rows_of_a_file_without_header_are_its_lines(tmp_path: Path) -> None:
    q = motion()[1].copy()
    q[7, 1] = np.nan
    write_csv(tmp_path / "a.csv", None, q)
    content = {"rate_hz": RATE, "position": {"file": "a.csv", "unit": "rad", "side": "joint"}}
    assert message(tmp_path, content) == f"a.csv: row 8, column 2, is nan{LOST_SAMPLE}"


def test_two_ragged_rows_that_make_up_for_each_other(tmp_path: Path) -> None:
    """The count of separators is right then, but a wanted cell is missing."""
    path = tmp_path / "a.csv"
    write_csv(path, "q1,q2", motion()[1])
    edit(path, 5, "1")
    edit(path, 6, "1,2,3")
    content = {"rate_hz": RATE, "position": {"file": "a.csv", "unit": "rad", "side": "joint"}}
    assert message(tmp_path, content) == "a.csv: row 4 (line 5) has 1 column where the first line has 2"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "a.csv: the file is empty"),
        (b"\n \n", "a.csv: the file is empty"),
        (b"\xef\xbb\xbf", "a.csv: the first line is blank"),
        (b"\n1,2\n", "a.csv: the first line is blank"),
        (b"t,q1,q2,u1,u2\n", "a.csv: there are no rows below the header"),
        (b"0,0,0,0,0\n1,0,0,0,0", "a.csv: there is no column 't': the file has no header, so columns go by number"),
        (
            b"t,1,q2,u1,u2\n",
            "a.csv: the first line is neither names nor numbers ('t' is not a number); "
            "say header = true or header = false",
        ),
        (b"t,q1,q2,u1,u2\n0,0,0,0,0\n0.001,0,0,0,0", "a.csv: at least 3 samples are needed, got 2"),
        (b"t,q1,q1,q2,u1,u2\n", "a.csv: column 'q1' occurs twice in the header"),
    ],
)  # fmt: skip
def test_files_without_a_table_of_numbers(tmp_path: Path, content: bytes, expected: str) -> None:
    (tmp_path / "a.csv").write_bytes(content)
    assert message(tmp_path, described("a.csv")) == expected


POSITION_ONLY = {"file": "a.csv", "unit": "rad", "side": "joint"}


@pytest.mark.parametrize(
    ("content", "keys", "expected"),
    [
        ("q1;q2\n1;2\n", {}, 'the file has 1 column where 2 are wanted; is delimiter = ";" meant?'),
        ("q1\tq2\n1\t2\n", {}, 'the file has 1 column where 2 are wanted; is delimiter = "\\t" meant?'),
        ("q1,q2\n1,2\n", {"delimiter": ";"}, 'the file has 1 column where 2 are wanted; is delimiter = "," meant?'),
        ("q\n1\n", {}, "the file has 1 column where 2 are wanted"),
        ("q\n1\n", {"columns": [1, 2]}, "there is no column 2; there is one"),
        (
            "q1;q2\n1;2\n",
            {"columns": ["q1", "q2"]},
            "there is no column 'q1'; the only one is 'q1;q2'; is delimiter = \";\" meant?",
        ),
        (
            "0,1;0,2\n0,3;0,4\n",
            {},
            "the first line is neither names nor numbers ('1;0' is not a number); is delimiter = \";\" meant?",
        ),
        (
            "q1;q2\n0,5;-1,5e-3\n",
            {"delimiter": ";"},
            "row 1 (line 2), column 'q1', is '0,5', not a number; for decimal commas, decimal = \",\"",
        ),
        ("q1,q2\n0,5,1,5\n", {}, "row 1 (line 2) has 4 columns where the first line has 2; are there decimal commas?"),
        ("q1,q2\r1,2\r3,4\r", {}, "lines end with a carriage return alone; save the file with LF or CR LF line ends"),
        ("q1,q2\n1,2\r3,4\n", {}, "lines end with a carriage return alone; save the file with LF or CR LF line ends"),
        ("x" * 200_000, {}, "this is not a CSV file (field larger than field limit (131072))"),
        ("q1,q2\n1,2\n".encode("utf-16"), {}, "the file is UTF-16 text; save it as UTF-8"),
        ("q1,q2\n1,2\n".encode("utf-16-le"), {}, "this is not a text file in UTF-8, byte 1 is zero (is it binary, or UTF-16?)"),
        (b"\x7fELF\x02\x01\x00\r\xff\n", {}, "this is not a text file in UTF-8, byte 6 is zero (is it binary, or UTF-16?)"),
    ],
)  # fmt: skip
def test_csv_files_of_another_make(
    tmp_path: Path, content: str | bytes, keys: dict[str, Any], expected: str
) -> None:
    (tmp_path / "a.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    assert message(tmp_path, {"rate_hz": RATE, "position": POSITION_ONLY | keys}) == f"a.csv: {expected}"


@given(content=st.binary(min_size=1, max_size=60), suffix=st.sampled_from(["csv", "npz", "mat"]))
def test_any_bytes_are_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str
) -> None:
    """Whatever the file holds: an error of ours, or (it happens to be a short table) a recording."""
    folder = tmp_path_factory.mktemp("bytes")
    (folder / f"a.{suffix}").write_bytes(content)
    position = {"file": f"a.{suffix}", "unit": "rad", "side": "joint"}
    assert "\n" not in outcome(folder, {"rate_hz": RATE, "position": position})


def outcome(folder: Path, content: dict[str, Any]) -> str:
    """Error of reading a recording, empty when it can be read."""
    try:
        read(folder, content)
    except DidimError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_damaged_array_files_are_a_sentence(tmp_path: Path, suffix: str) -> None:
    import scipy.io

    q = motion()[1]
    path = tmp_path / f"a.{suffix}"
    if suffix == "npz":
        np.savez_compressed(path, q=q)
    else:
        scipy.io.savemat(path, {"q": q}, do_compression=True)
    whole = path.read_bytes()
    content = {
        "rate_hz": RATE,
        "position": {"file": path.name, "variable": "q", "unit": "rad", "side": "joint"},
    }
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(whole[: rng.integers(1, len(whole) + 1)])
        damaged[rng.integers(len(damaged))] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        assert "\n" not in outcome(tmp_path, content)


def test_missing_and_unknown_files(tmp_path: Path) -> None:
    assert message(tmp_path, described("b.csv")) == f"{tmp_path / 'b.csv'}: no such data file"
    (tmp_path / "b.xlsx").write_bytes(b"x")
    assert message(tmp_path, described("b.xlsx")).startswith(
        "b.xlsx: the format '.xlsx' is unknown; known are"
    )


def test_wrong_columns(tmp_path: Path, csv_file: Path) -> None:
    content = described("a.csv")
    content["position"]["columns"] = ["q1", "pos2"]
    there = "the columns are 't', 'q1', 'q2', 'u1', 'u2'"
    assert message(tmp_path, content) == f"a.csv: there is no column 'pos2'; {there}"
    content["position"]["columns"] = ["q1", "Q2"]
    assert message(tmp_path, content) == f"a.csv: there is no column 'Q2'; {there}; did you mean 'q2'?"
    content["position"]["columns"] = [2, 6]
    assert message(tmp_path, content) == "a.csv: there is no column 6; the columns are 1 to 5"
    content["position"]["columns"] = ["q1"]
    start = "log.toml: [recording.position] columns"
    assert (
        message(tmp_path, content) == f"{start} must name 2 columns, one for each joint of the robot, got 1"
    )
    content["position"]["columns"] = ["q1", "q1"]
    assert message(tmp_path, content) == f"{start} names a column twice: ['q1', 'q1']"
    content["position"]["columns"] = "q1"
    assert message(tmp_path, content) == f"{start} must be a list of names, or of numbers from 1, got 'q1'"
    del content["position"]["columns"]
    expected = "a.csv: the file has 5 columns where 2 are wanted, so columns must say which"
    assert message(tmp_path, content) == expected


def test_a_transposed_csv(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", None, motion()[1].T)
    content = {"rate_hz": RATE, "position": {"file": "a.csv", "unit": "rad", "side": "joint"}}
    expected = f"a.csv: the file has {N} columns where 2 are wanted; transpose it?"
    assert message(tmp_path, content) == expected


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_faults_of_arrays(tmp_path: Path, suffix: str) -> None:
    import scipy.io

    _, q, _ = motion()
    bad = q.copy()
    bad[4, 1] = np.nan
    words = np.array(["a", "b"])
    cube = np.zeros((3, 3, 3))
    arrays = {
        "q": q,
        "flat": q.T,
        "bad": bad,
        "words": words,
        "cube": cube,
        "short": q[:-1, 0],
        "one": q[:, 0],
    }
    file = f"a.{suffix}"
    if suffix == "npz":
        np.savez(tmp_path / file, **arrays)  # type: ignore[arg-type]
    else:
        scipy.io.savemat(tmp_path / file, arrays)

    def said(**keys: Any) -> str:
        position = {"file": file, "unit": "rad", "side": "joint", **keys}
        return message(tmp_path, {"rate_hz": RATE, "position": position})

    wanted = "must have shape (n_samples, 2)"
    assert said(variable="flat") == f"{file}: variable 'flat' {wanted}, got (2, {N}); transpose it?"
    assert said(variable="cube").startswith(f"{file}: variable 'cube' must be a vector or a matrix")
    assert said(variable="bad") == f"{file}: variable 'bad', row 5, column 2, is nan{LOST_SAMPLE}"
    assert said(variable="words") == f"{file}: variable 'words' is not an array of real numbers"
    names = "'q', 'flat', 'bad', 'words', 'cube', 'short', 'one'"
    first = "'q', 'flat', 'bad', 'words' and 3 more"
    expected = f"{file}: there is no variable 'Flat'; the variables are {first}; did you mean 'flat'?"
    assert said(variable="Flat") == expected
    assert said() == f"{file}: variable must say which array is meant; there are {names}"
    assert said(columns=[1, 2]) == f"{file}: columns by number need variable = the matrix they belong to"
    assert said(variable="q", columns=["a", "b"]) == f"{file}: columns of the matrix 'q' go by number, from 1"
    assert said(variable="q", columns=[1, 3]) == f"{file}: variable 'q' has no column 3; it has 1 to 2"
    expected = f"{file}: variables 'one' and 'short' differ in length: {N} and {N - 1}"
    assert said(columns=["one", "short"]) == expected
    assert said(columns=["one", "q"]) == f"{file}: variable 'q' must be a vector, its shape is ({N}, 2)"
    assert said(variable="q", header=True) == f"{file}: delimiter, header and decimal are for CSV files only"


def test_a_damaged_matlab_file_of_version_73(tmp_path: Path) -> None:
    pytest.importorskip("h5py", reason="needs the extra 'hdf5'")
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n"
    (tmp_path / "a.mat").write_bytes(header)
    assert message(tmp_path, described("a.mat")) == "a.mat: this is not a readable MATLAB version 7.3 file"


def test_files_that_are_not_what_their_suffix_says(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(b"no such thing" * 50)
    assert message(tmp_path, described("a.mat")) == "a.mat: this is not a readable MATLAB version 5 file"
    (tmp_path / "a.npz").write_bytes(b"no such thing" * 50)
    assert message(tmp_path, described("a.npz")) == "a.npz: this is not a readable npz file"


def test_torque_and_position_of_different_length(tmp_path: Path) -> None:
    t, q, u = motion()
    write_csv(tmp_path / "q.csv", "t,q1,q2", t, q)
    write_csv(tmp_path / "u.csv", "u1,u2", u[:-1])
    content = described("q.csv")
    content["torque"]["file"] = "u.csv"
    expected = f"run 1: torque has {N - 1} samples (u.csv), position has {N} (q.csv)"
    assert message(tmp_path, content) == expected


# --- faults of the time stamps


def with_time(tmp_path: Path, t: Array, **keys: Any) -> str:
    _, q, u = motion()
    write_csv(tmp_path / "a.csv", "t,q1,q2,u1,u2", t, q, u)
    return message(tmp_path, described("a.csv", **keys))


def test_a_missing_sample_is_named(tmp_path: Path) -> None:
    t = motion()[0].copy()
    t[30:] += 1 / RATE
    place = "after row 30 (t = 0.029 s), where the time step is"
    fault, offer = with_time(tmp_path, t).split("; resample = true")
    assert fault == f"a.csv: 1 sample is missing {place} 0.002 s instead of 0.001 s"
    assert "at 1000 Hz" in offer
    t[30:] += 1 / RATE
    fault = f"a.csv: 2 samples are missing {place} 0.003 s instead of 0.001 s"
    assert with_time(tmp_path, t).startswith(f"{fault}; resample = true")


def test_uneven_time_is_named(tmp_path: Path) -> None:
    t = motion()[0].copy()
    t[30] += 0.3 / RATE
    expected = (
        "a.csv: sampling is uneven after row 30 (t = 0.029 s), "
        "where the time step is 0.0013 s instead of 0.001 s"
    )
    assert with_time(tmp_path, t).startswith(f"{expected}; resample = true under [recording.time]")
    t[30] = t[29]
    assert with_time(tmp_path, t) == "a.csv: time does not grow from row 30 (0.029 s) to row 31"


def test_a_clock_that_drifts_is_uneven() -> None:
    """Each step is within the tolerance of its neighbours there, but not of the median."""
    with pytest.raises(RecordingError, match="sampling is uneven after row 1 "):
        check_time(np.cumsum(np.linspace(0.9, 1.1, 2000)), None, "a.csv")


def test_a_rate_that_contradicts_the_time_stamps(tmp_path: Path) -> None:
    expected = "a.csv: the time stamps give a sampling rate of 1000 Hz, rate_hz says 500 Hz"
    assert with_time(tmp_path, motion()[0], rate_hz=500) == expected
    # Milliseconds taken for seconds.
    expected = "a.csv: the time stamps give a sampling rate of 1 Hz, rate_hz says 1000 Hz"
    assert with_time(tmp_path, motion()[0] * 1e3, rate_hz=1000) == expected


# --- faults of the description


@pytest.mark.parametrize(
    ("table", "change", "expected"),
    [
        (
            "position",
            {"unit": "grad"},
            "unit 'grad' is unknown here; known are 'rad', 'deg', 'm', 'mm', 'percent', 'signed-percent', 'count'",
        ),
        ("torque", {"unit": "Nm"}, "unit 'Nm' is unknown here; known are 'N.m', 'N', 'A', 'V'"),
        ("time", {"unit": "min"}, "unit must be one of 's', 'ms', 'us', got 'min'"),
        ("position", {"unit": "mm"}, "unit 'mm' does not suit joint 1, which is revolute"),
        ("position", {"unit": ["rad"]}, "unit must be one text or a list of 2, got 1"),
        ("position", {"unit": "count"}, "key 'counts_per_rev' is missing"),
        ("position", {"unit": "count", "counts_per_rev": 0}, "counts_per_rev must not be zero"),
        ("torque", {"unit": "N"}, "unit 'N' does not suit joint 1, which is revolute"),
        ("torque", {"unit": "A"}, "unit 'A' needs the drive gain: gain = number or list of 2"),
        ("torque", {"unit": "V", "gain": [1, 0]}, "gain must not be zero"),
        ("torque", {"gain": 2}, "gain is for torques logged in A or V, and the unit is 'N.m'; scale and sign are for any unit"),
        (
            "position",
            {"side": "motor"},
            "side 'motor' needs a reduction matrix: [transmission] reduction, here or in the robot file",
        ),
        ("position", {"side": "load"}, "side must be one of 'motor', 'joint', got 'load'"),
        ("position", {"collums": 1}, "unknown key 'collums'; did you mean 'columns'?"),
        ("position", {"delimiter": "|"}, "delimiter must be one of ',', ';', '\\t', ' ', got '|'"),
    ],
)  # fmt: skip
def test_wrong_keys(
    tmp_path: Path, csv_file: Path, table: str, change: dict[str, Any], expected: str
) -> None:
    content = described("a.csv")
    content[table].update(change)
    assert message(tmp_path, content) == f"log.toml: [recording.{table}] {expected}"


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"windows_s": [[0.0, 0.06]]}, "the window [0.0, 0.06] s leaves the record, which lasts 0.05 s"),
        ({"windows_s": [[-0.01, 0.02]]}, "the window [-0.01, 0.02] s leaves the record, which lasts 0.05 s"),
        ({"windows_s": [[0.01, 0.012]]}, "the window [0.01, 0.012] s has 2 samples, at least 3 are needed"),
        ({"windows_s": [[0, 0.02], [0.01, 0.03]]}, "the windows [[0, 0.02], [0.01, 0.03]] overlap"),
        ({"windows_s": [0.0, 1.0]}, "windows_s must be a list of [start, stop] in seconds with start < stop, got 0.0"),
        (
            {"windows_s": [[0.0, 10**400]]},
            f"windows_s must be a list of [start, stop] in seconds with start < stop, got [0.0, 1{50 * '0'}...",
        ),
        ({"role": "test"}, "role must be one of 'fit', 'held-out', got 'test'"),
        (
            {"acceleration": {}},
            "unknown key 'acceleration'; known here are 'name', 'role', 'rate_hz', 'windows_s', 'rollouts', "
            "'payload', 'kp', 'offsets', 'friction', 'time' and 6 more",
        ),
    ],
)  # fmt: skip
def test_wrong_keys_of_the_recording(
    tmp_path: Path, csv_file: Path, change: dict[str, Any], expected: str
) -> None:
    assert message(tmp_path, described("a.csv", **change)) == f"log.toml: [recording] {expected}"


def test_a_recording_needs_positions_and_a_rate(tmp_path: Path, csv_file: Path) -> None:
    content = described("a.csv")
    del content["time"]
    expected = "log.toml: [recording] give rate_hz or the table [recording.time]"
    assert message(tmp_path, content) == expected
    content = described("a.csv")
    del content["position"]
    assert message(tmp_path, content) == "log.toml: [recording] the table [recording.position] is missing"


@pytest.mark.parametrize(
    ("reduction", "expected"),
    [
        ([[1, 2], [2, 4]], "the row of motor 2 is a combination of the rows before it"),
        ([[0, 0], [1, 0]], "the row of motor 1 is zero"),
    ],
)
def test_a_singular_reduction(reduction: list[list[float]], expected: str) -> None:
    table = experiment_table("transmission", {"reduction": reduction})
    with pytest.raises(ExperimentError) as caught:
        read_reduction(table, None, 2)
    assert str(caught.value) == f"log.toml: [transmission] reduction is singular: {expected}"


def test_the_reduction_of_the_robot_is_the_default() -> None:
    reduction = np.diag([100.0, -50.0])
    assert read_reduction(None, reduction, 2) is reduction


# --- recordings made in Python


def test_arrays_are_copied_and_checked() -> None:
    _, q, u = motion()
    recording = Recording.from_arrays(q, u, rate_hz=RATE)
    q[0, 0] = 7.0
    assert recording.q[0, 0] == 0.0
    with pytest.raises(RecordingError, match=r"got \(2, 50\); transpose it\?$"):
        Recording.from_arrays(q.T, rate_hz=RATE)
    with pytest.raises(RecordingError, match=r"tau and q differ in shape, \(49, 2\) and \(50, 2\)$"):
        Recording.from_arrays(q, u[:-1], rate_hz=RATE)
    with pytest.raises(
        RecordingError, match=r"^recording: q must have shape \(n_samples, n_dof\), got \(50,\)$"
    ):
        Recording.from_arrays(q[:, 0], rate_hz=RATE)
    with pytest.raises(RecordingError, match="at least 3 samples are needed, got 2"):
        Recording.from_arrays(q[:2], rate_hz=RATE)
    u[3, 1] = np.inf
    with pytest.raises(RecordingError, match=r"tau of joint 2 is inf at sample 3$"):
        Recording.from_arrays(q, u, rate_hz=RATE)
    with pytest.raises(RecordingError, match="window of samples 40 to 60 is empty, overlaps"):
        Recording(t=np.arange(N) / RATE, q=q, rate_hz=RATE, windows=((40, 60),))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rate_hz": 0.0}, "rate_hz must be a positive number, got 0.0"),
        ({"rate_hz": math.nan}, "rate_hz must be a positive number, got nan"),
        ({"rate_hz": math.inf}, "rate_hz must be a positive number, got inf"),
        ({"rate_hz": "1000"}, "rate_hz must be a positive number, got '1000'"),
        ({"rate_hz": True}, "rate_hz must be a positive number, got True"),
        ({"rate_hz": 500.0}, "the time stamps give a sampling rate of 1000 Hz, rate_hz says 500 Hz"),
        ({"t": [0.0, math.nan, 0.002]}, "t is nan at sample 1"),
        ({"t": [0.0, 0.0, 0.001]}, "time does not grow from row 1 (0 s) to row 2"),
        ({"t": [0.0, 0.001, 0.003]}, "sampling is uneven after row 1 (t = 0 s), where the time step is"),
        ({"windows": ((0, 1.5),)}, "windows must be pairs of sample numbers (start, stop), got ((0, 1.5),)"),
        ({"windows": (0, 3)}, "windows must be pairs of sample numbers (start, stop), got (0, 3)"),
    ],
)
def test_rates_and_times_of_arrays_are_checked(options: dict[str, Any], message: str) -> None:
    q = motion()[1][:3]
    arrays: dict[str, Any] = {"t": np.arange(3) / RATE, "q": q, "rate_hz": RATE}
    with pytest.raises(RecordingError) as caught:
        Recording(**(arrays | options))
    assert str(caught.value).startswith(f"recording: {message}")


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan, "1000", None])
def test_a_wrong_rate_of_arrays_is_a_sentence(rate: Any) -> None:
    with pytest.raises(RecordingError) as caught:
        Recording.from_arrays(motion()[1], rate_hz=rate)
    assert str(caught.value) == f"recording: rate_hz must be a positive number, got {rate!r}"


def test_a_rate_whose_time_stamps_overflow_is_a_sentence() -> None:
    with pytest.raises(RecordingError, match=r"^recording: t is inf at sample 1$"):
        Recording.from_arrays(motion()[1], rate_hz=1e-310)


def test_an_infinite_window_leaves_the_record(tmp_path: Path, csv_file: Path) -> None:
    said = message(tmp_path, described("a.csv", windows_s=[[0.0, 1e308]]))
    assert said == "log.toml: [recording] the window [0.0, 1e+308] s leaves the record, which lasts 0.05 s"


# --- measured data


def test_the_logs_of_the_tx40_and_the_emps(shared: Path) -> None:
    position = {"file": "motor_position.csv", "unit": "rad", "side": "motor"}
    reduction = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    reduction[5, 4] = 32.0
    robot = fake_robot("tx40", ("revolute",) * 6)
    recording = read(shared / "data" / "tx40", {"rate_hz": 5000, "position": position}, robot, reduction)
    assert recording.q.shape == (45000, 6)
    expected = [0.0, math.pi / 2, -math.pi / 2, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(recording.q[0], expected, atol=1e-3)

    file = "DATA_EMPS.mat"
    emps = read(
        shared / "data" / "emps",
        {
            "rate_hz": 1000,
            "time": {"file": file, "variable": "t"},
            "position": {"file": file, "variable": "qm", "unit": "m", "side": "joint"},
            "torque": {"file": file, "variable": "vir", "unit": "V", "gain": 35.15, "side": "joint"},
        },
        fake_robot("emps", ("prismatic",)),
    )
    assert emps.q.shape == (24841, 1)
    assert emps.tau is not None
    assert np.abs(emps.tau).max() < 4.4 * 35.15


NAMED = fake_robot(joint_names=("shoulder", "elbow"))


def test_columns_by_name_of_joint(tmp_path: Path, csv_file: Path) -> None:
    content = described("a.csv")
    content["position"]["columns"] = {"elbow": "q2", "shoulder": "q1"}
    content["torque"]["columns"] = {"elbow": 5, "shoulder": 4}
    recording = read(tmp_path, content, NAMED)
    _, q, tau = motion()
    np.testing.assert_array_equal(recording.q, q)
    np.testing.assert_array_equal(recording.tau, tau)


@pytest.mark.parametrize(
    ("robot", "columns", "message"),
    [
        (NAMED, {"elbow": "q2", "sholder": "q1"}, "joint 'sholder', which the robot has not; did you mean 'shoulder'?"),
        (NAMED, {"elbow": "q2"}, "columns has none for joint 'shoulder'"),
        (NAMED, {"elbow": "q2", "shoulder": "q2"}, "columns names a column twice"),
        (NAMED, {"elbow": "q2", "shoulder": 1.5}, "columns must be a list of names, or of numbers from 1"),
        (fake_robot(), {"elbow": "q2", "shoulder": "q1"}, "columns by name of joint need a robot whose joints have names"),
    ],
)  # fmt: skip
def test_wrong_columns_by_name_of_joint(
    tmp_path: Path, csv_file: Path, robot: Any, columns: dict[str, Any], message: str
) -> None:
    content = described("a.csv")
    content["position"]["columns"] = columns
    with pytest.raises(ExperimentError) as error:
        read(tmp_path, content, robot)
    assert message in str(error.value)
