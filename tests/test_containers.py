"""One log in many containers gives identical bits; what is missing or wrong in one is a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray

import didim
from didim.errors import ExperimentError, RecordingError
from didim.log.data_folder import DataFolder, expanded
from didim.log.recording import Recording
from didim.log.recording_file import read_recording
from plain import fake_robot
from tables import experiment_table

Array = NDArray[np.float64]
JOINTS = ("shoulder", "elbow")
ROBOT = fake_robot(joint_names=JOINTS)
N = 400


def log() -> dict[str, Array]:
    """Time stamps of whole microseconds, positions and torques with all their digits."""
    rng = np.random.default_rng(5)
    t = np.array([1000 * k / 1e6 for k in range(N)])
    return {"t": t, "q": rng.standard_normal((N, 2)), "tau": rng.standard_normal((N, 2))}


def table() -> Array:
    parts = log()
    return np.column_stack([parts["t"], parts["q"], parts["tau"]])


def rows() -> list[str]:
    return [",".join(repr(value) for value in row) for row in table().tolist()]


def csv_with_header(folder: Path) -> dict[str, Any]:
    (folder / "a.csv").write_text("\n".join(["t,q1,q2,u1,u2", *rows()]) + "\n")
    return sources("a.csv", {"columns": ["t"]}, {"columns": ["q1", "q2"]}, {"columns": ["u1", "u2"]})


def csv_without_header(folder: Path) -> dict[str, Any]:
    (folder / "a.csv").write_text("\n".join(rows()) + "\n")
    return sources("a.csv", {"columns": [1]}, {"columns": [2, 3]}, {"columns": [4, 5]})


def one_value_a_line(folder: Path) -> dict[str, Any]:
    (folder / "a.txt").write_text("\n".join(",".join(rows()).split(",")) + "\n")
    width = {"values_per_sample": 5}
    return sources(
        "a.txt", {"columns": [1], **width}, {"columns": [2, 3], **width}, {"columns": [4, 5], **width}
    )


def one_column_a_file(folder: Path) -> dict[str, Any]:
    for k, values in enumerate(table().T.tolist()):
        (folder / f"{k}.txt").write_text("\n".join(map(repr, values)) + "\n")
    content = sources("", {}, {}, {})
    for key, files in (("time", "0.txt"), ("position", ["1.txt", "2.txt"]), ("torque", ["3.txt", "4.txt"])):
        content[key]["file"] = files
    return content


def npz(folder: Path) -> dict[str, Any]:
    np.savez(folder / "a.npz", **log())  # type: ignore[arg-type]
    return sources("a.npz", {"variable": "t"}, {"variable": "q"}, {"variable": "tau"})


def mat_5(folder: Path) -> dict[str, Any]:
    scipy.io.savemat(folder / "a.mat", log(), format="5")
    return sources("a.mat", {"variable": "t"}, {"variable": "q"}, {"variable": "tau"})


def mat_73(folder: Path) -> dict[str, Any]:
    """What MATLAB writes: a block of its own before the HDF5 file, whose arrays stand column by column."""
    h5py = pytest.importorskip("h5py", reason="needs the extra 'hdf5'")
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        for name, values in log().items():
            file[name] = np.atleast_2d(values.T)
        file["#refs#/a"] = np.zeros(3)
    with (folder / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: ...".ljust(124) + b"\x00\x02IM")
    return sources("a.mat", {"variable": "t"}, {"variable": "q"}, {"variable": "tau"})


def hdf5(folder: Path) -> dict[str, Any]:
    h5py = pytest.importorskip("h5py", reason="needs the extra 'hdf5'")
    with h5py.File(folder / "a.h5", "w") as file:
        for name, values in log().items():
            file[f"run/{name}"] = values
    return sources("a.h5", {"variable": "run/t"}, {"variable": "run/q"}, {"variable": "run/tau"})


def ros_2_bag(folder: Path, **options: Any) -> dict[str, Any]:
    pytest.importorskip("rosbags", reason="needs the extra 'ros'")
    from bags import write_bag

    parts = log()
    write_bag(folder / "bag", JOINTS, parts["t"], parts["q"], parts["tau"], **options)
    return sources("bag", {}, {}, {})


def mcap(folder: Path) -> dict[str, Any]:
    return ros_2_bag(folder, mcap=True)


CONTAINERS = [
    csv_with_header,
    csv_without_header,
    one_value_a_line,
    one_column_a_file,
    npz,
    mat_5,
    mat_73,
    hdf5,
    ros_2_bag,
    mcap,
]


def sources(
    file: str, time: dict[str, Any], position: dict[str, Any], torque: dict[str, Any]
) -> dict[str, Any]:
    return {
        "time": {"file": file, **time},
        "position": {"file": file, "unit": "rad", "side": "joint", **position},
        "torque": {"file": file, "unit": "N.m", "side": "joint", **torque},
    }


def read(folder: Path, content: dict[str, Any], robot: Any = ROBOT) -> Recording:
    part = experiment_table("recording", content)
    return read_recording(part, "run", robot, None, DataFolder(folder))


@pytest.mark.parametrize("write", CONTAINERS, ids=lambda write: write.__name__)
def test_all_containers_give_the_same_bits(tmp_path: Path, write: Any) -> None:
    recording = read(tmp_path, write(tmp_path))
    parts = log()
    assert recording.rate_hz == (N - 1) / (parts["t"][-1] - parts["t"][0])
    np.testing.assert_array_equal(recording.t, parts["t"])
    np.testing.assert_array_equal(recording.q, parts["q"])
    np.testing.assert_array_equal(recording.tau, parts["tau"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values_per_sample": 7}, r"a.txt: 2000 lines are not a whole number of samples of 7 values"),
        ({"columns": [2, 6]}, r"a.txt: there is no column 6; values_per_sample says 1 to 5"),
        ({"columns": ["q1", "q2"]}, r"a.txt: values with one per line have no names"),
        ({"columns": None}, r"a.txt: columns must say which 2 of the 5 values of a sample are meant"),
    ],
)
def test_values_that_do_not_make_samples(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    content = one_value_a_line(tmp_path)
    content["position"] |= change
    content["position"] = {key: value for key, value in content["position"].items() if value is not None}
    with pytest.raises(RecordingError, match=message):
        read(tmp_path, content)


def test_files_of_other_number_and_length(tmp_path: Path) -> None:
    content = one_column_a_file(tmp_path)
    content["position"]["file"] = ["1.txt"]
    with pytest.raises(RecordingError, match=r"file must name 2 files of one column each, got 1"):
        read(tmp_path, content)
    content = one_column_a_file(tmp_path)
    (tmp_path / "2.txt").write_text("1\n2\n")
    with pytest.raises(RecordingError, match=r"2.txt has 2 samples, 1.txt has 400"):
        read(tmp_path, content)


def test_a_star_stands_for_several_recordings(tmp_path: Path) -> None:
    """One table for all logs of a session, in the order of their names; wrong patterns are named."""
    for k in (1, 2, 10):
        (tmp_path / f"run_{k}.csv").write_text("\n".join(["t,q1,q2,u1,u2", *rows()]) + "\n")
    source = {"file": "run_*.csv", "side": "joint"}
    text = (
        'schema = 1\nrobot = "planar2"\n[[recording]]\nrate_hz = 1000\n'
        + "[recording.position]\n"
        + 'file = "run_*.csv"\ncolumns = ["q1", "q2"]\nunit = "rad"\nside = "joint"\n'
        + '[recording.torque]\nfile = "run_*.csv"\ncolumns = ["u1", "u2"]\nunit = "N.m"\nside = "joint"\n'
    )
    (tmp_path / "log.toml").write_text(text)
    found = didim.load_experiment(tmp_path / "log.toml").recordings
    assert [recording.name for recording in found] == ["1", "10", "2"]
    assert all(len(recording.q) == N for recording in found)
    (tmp_path / "log.toml").write_text(text.replace("rate_hz", 'name = "session"\nrate_hz'))
    assert didim.load_experiment(tmp_path / "log.toml").recordings[1].name == "session 10"

    def refused(**content: Any) -> str:
        part = experiment_table("recording", content)
        with pytest.raises(ExperimentError) as caught:
            expanded(part, "recording 1", tmp_path)
        return str(caught.value)

    assert "no file in" in refused(position={**source, "file": "walk_*.csv"})
    assert "may have one *" in refused(position={**source, "file": "*_*.csv"})
