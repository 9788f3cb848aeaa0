"""ROS bags: joints by name, stamps of the headers, controller states with their reference, and a sentence for each fault."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from didim.errors import RecordingError
from plain import fake_robot
from test_containers import JOINTS, N, log, read, sources

pytest.importorskip("rosbags", reason="needs the extra 'ros'")
from bags import write_bag


def bag(folder: Path, **options: Any) -> dict[str, Any]:
    parts = log()
    write_bag(folder / "bag", JOINTS, parts["t"], parts["q"], parts["tau"], **options)
    return sources("bag", {}, {}, {})


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("mcap", [False, True])
def test_stamps_since_1970_keep_their_digits(tmp_path: Path, mcap: bool, version: int) -> None:
    """Also of bags without definitions of their messages (version 8); in a single file as well as in a folder."""
    content = bag(tmp_path, mcap=mcap, version=version, start_s=1_760_000_000)
    recording = read(tmp_path, content)
    np.testing.assert_array_equal(recording.t, log()["t"])
    np.testing.assert_array_equal(recording.tau, log()["tau"])
    (file,) = (path for path in (tmp_path / "bag").iterdir() if path.suffix in (".mcap", ".db3"))
    for key in content:
        content[key]["file"] = f"bag/{file.name}"
    np.testing.assert_array_equal(read(tmp_path, content).q, log()["q"])


def test_a_controller_state_has_the_reference(tmp_path: Path) -> None:
    reference = log()["q"] + 0.01
    content = bag(tmp_path, reference=reference)
    with pytest.raises(
        RecordingError, match=r"bag: topic must say which is meant; there are '/arm_contr.*, '/joint_states'"
    ):
        read(tmp_path, content)
    content["reference"] = {"file": "bag", "unit": "rad", "side": "joint"}
    for part in content.values():
        part["topic"] = "/arm_controller/state"
    recording = read(tmp_path, content)
    np.testing.assert_array_equal(recording.q_ref, reference)
    np.testing.assert_array_equal(recording.tau, log()["tau"])
    assert len(recording.q) == N


def test_joints_of_a_robot_without_names_are_listed(tmp_path: Path) -> None:
    content = bag(tmp_path)
    nameless = fake_robot()
    with pytest.raises(Exception, match="bag has joints by name, and the robot file has no names"):
        read(tmp_path, content, nameless)
    for key in ("position", "torque"):
        content[key]["columns"] = ["elbow", "shoulder"]
    np.testing.assert_array_equal(read(tmp_path, content, nameless).q, log()["q"][:, ::-1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"topic": "/joint_state"}, r"bag: there is no topic '/joint_state'.*did you mean '/joint_states'"),
        ({"topic": "/rosout"}, r"bag: topic /rosout has messages of type std_msgs/msg/String; read are sensor_msgs"),
        ({"columns": ["shoulder", "elbo"]}, r"bag: there is no joint 'elbo' in topic /joint_states.*did you mean 'elbow'"),
        ({"columns": [1, 2]}, r"bag: joints of a bag go by name, got column 1"),
        ({"variable": "torque"}, r"bag: variable must be one of 'stamp', .*, got 'torque'"),
        ({"delimiter": ";"}, r"bag: delimiter, header and decimal are for CSV files only"),
    ],
)  # fmt: skip
def test_wrong_keys(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    content = bag(tmp_path)
    content["position"] |= change
    with pytest.raises(RecordingError, match=message):
        read(tmp_path, content)


def test_missing_signals_are_named(tmp_path: Path) -> None:
    parts = log()
    effort = parts["tau"].copy()
    effort[7, 1] = np.nan
    write_bag(tmp_path / "bag", JOINTS, parts["t"], parts["q"], effort)
    with pytest.raises(
        RecordingError,
        match=r"message 8 of topic /joint_states: effort of joint 'elbow' is not a finite number",
    ):
        read(tmp_path, sources("bag", {}, {}, {}))
    content = sources("bag", {}, {}, {}) | {"reference": {"file": "bag", "unit": "rad", "side": "joint"}}
    with pytest.raises(
        RecordingError, match=r"message 1 of topic /joint_states has no reference for 2 joints"
    ):
        read(tmp_path, {key: content[key] for key in ("time", "position", "reference")})


def test_headers_without_time_and_files_of_another_kind(tmp_path: Path) -> None:
    parts = log()
    write_bag(tmp_path / "bag", JOINTS, 0.0 * parts["t"], parts["q"], parts["tau"])
    with pytest.raises(RecordingError, match=r"the headers of topic /joint_states have no time; leave"):
        read(tmp_path, sources("bag", {}, {}, {}))
    (tmp_path / "a.mcap").write_bytes(b"not a bag at all" * 100)
    with pytest.raises(RecordingError, match=r"a.mcap: this is not a readable ROS bag"):
        read(tmp_path, sources("a.mcap", {}, {}, {}))


def test_without_the_extra_there_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = bag(tmp_path)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(
        RecordingError, match=r"bag: ROS bags need the package rosbags: pip install 'didim\[ros\]'"
    ):
        read(tmp_path, content)
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(
        RecordingError,
        match=r"a.h5: HDF5 and MATLAB 7.3 files need the package h5py: pip install 'didim\[hdf5\]'",
    ):
        read(tmp_path, sources("a.h5", {}, {}, {}))
