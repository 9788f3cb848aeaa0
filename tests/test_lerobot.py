"""LeRobot datasets of version 2 and 3: the frames of all episodes, motors by name, grippers in percent, episodes as rollouts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from didim.errors import ExperimentError, RecordingError
from didim.log.data_file import open_data_file
from didim.log.data_folder import DataFolder
from didim.log.recording import Recording
from didim.log.recording_file import read_recording
from didim.robot.robot import JointLimits
from plain import fake_robot
from tables import experiment_table

FPS = 30
EPISODES = (40, 25, 60)
MOTORS = ["shoulder_pan.pos", "gripper.pos"]


ARM = fake_robot(
    joint_names=("shoulder_pan", "gripper"),
    limits=(JointLimits(position=(-2.0, 2.0)), JointLimits(position=(-0.2, 1.8))),
)
"""A joint and a gripper."""


def frames() -> dict[str, np.ndarray]:
    """Columns of a dataset as numbers: degrees of a joint, percent of a gripper."""
    rng = np.random.default_rng(3)
    n = sum(EPISODES)
    index = np.repeat(np.arange(len(EPISODES)), EPISODES)
    frame = np.concatenate([np.arange(count) for count in EPISODES])
    values = {
        key: np.column_stack([rng.uniform(-100, 100, n), rng.uniform(0, 100, n)]).astype(np.float32)
        for key in ("action", "observation.state")
    }
    times = (frame / FPS).astype(np.float32)
    return {**values, "timestamp": times, "frame_index": frame, "episode_index": index, "index": np.arange(n)}


def dataset(
    folder: Path, version: str, names: Any = MOTORS, columns: dict[str, np.ndarray] | None = None
) -> Path:
    """Write a dataset as LeRobot lays it out."""
    pa = pytest.importorskip("pyarrow", reason="tests of LeRobot datasets need the package pyarrow")
    from pyarrow import parquet

    columns = frames() if columns is None else columns
    fixed = version.startswith("v3")

    def table(rows: np.ndarray) -> Any:
        arrays = {}
        for key, value in columns.items():
            kind = None
            if value.ndim == 2:
                kind = pa.list_(pa.float32(), value.shape[1]) if fixed else pa.list_(pa.float32())
            arrays[key] = pa.array(list(value[rows]) if value.ndim == 2 else value[rows], type=kind)
        return pa.table({**arrays, "task": pa.array(["wave"] * int(rows.sum()))})

    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    features = {
        key: {"dtype": "float32", "shape": [value.shape[1]], "names": names}
        for key, value in columns.items()
        if value.ndim == 2
    }
    info = {"codebase_version": version, "fps": FPS, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    numbers = np.unique(columns["episode_index"]).tolist()
    each = {f"episode_{k:06d}": [k] for k in numbers}
    parts = {"file-000": numbers[:2], "file-001": numbers[2:]} if fixed else each
    for name, episodes in parts.items():
        rows = np.isin(columns["episode_index"], episodes)
        parquet.write_table(table(rows), folder / "data" / "chunk-000" / f"{name}.parquet")
    return folder


def sources(**more: Any) -> dict[str, Any]:
    unit = {"unit": ["deg", "percent"], "side": "joint"}
    return {
        "rollouts": "episode_index",
        "time": {"file": "arm", "columns": ["timestamp"]},
        "position": {"file": "arm", "variable": "observation.state", **unit},
        "reference": {"file": "arm", "variable": "action", **unit},
        **more,
    }


def read(folder: Path, content: dict[str, Any]) -> Recording:
    table = experiment_table("recording", content, "arm.toml")
    return read_recording(table, "recording 1", ARM, None, DataFolder(folder))


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_all_episodes_in_si_units(tmp_path: Path, version: str) -> None:
    dataset(tmp_path / "arm", version)
    found, columns = read(tmp_path, sources()), frames()
    for ours, key in ((found.q, "observation.state"), (found.q_ref, "action")):
        values = columns[key].astype(float)
        assert ours is not None
        np.testing.assert_allclose(ours[:, 0], np.radians(values[:, 0]), rtol=1e-14)
        np.testing.assert_allclose(ours[:, 1], -0.2 + 2.0 * values[:, 1] / 100.0, rtol=1e-12)
    assert found.windows == ((0, 40), (40, 65), (65, 125))
    assert found.rate_hz == pytest.approx(FPS, rel=1e-6)


def test_gaps_end_rollouts_too(tmp_path: Path) -> None:
    dataset(tmp_path / "arm", "v2.1")
    assert read(tmp_path, sources(rollouts="gaps")).windows == ((0, 40), (40, 65), (65, 125))


@pytest.mark.parametrize("names", [MOTORS, {"motors": MOTORS}])
def test_motors_have_names(tmp_path: Path, names: Any) -> None:
    dataset(tmp_path / "arm", "v3.0", names)
    for path in (tmp_path / "arm", tmp_path / "arm" / "data" / "chunk-000" / "file-001.parquet"):
        file: Any = open_data_file(path, path.name, delimiter=None, header=None)
        assert file.labels == {"action": MOTORS, "observation.state": MOTORS}
        assert "task" not in file.names


def test_signed_percent_and_its_sign(tmp_path: Path) -> None:
    dataset(tmp_path / "arm", "v3.0")
    position: dict[str, Any] = {"file": "arm", "variable": "observation.state", "side": "joint"}
    position |= {"unit": ["signed-percent", "percent"], "sign": [-1, -1]}
    found = read(tmp_path, sources(position=position))
    values = frames()["observation.state"].astype(float)
    np.testing.assert_allclose(found.q[:, 0], -2.0 * values[:, 0] / 100.0, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.q[:, 1], 1.8 - 2.0 * values[:, 1] / 100.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rollouts": "episode"}, "arm: there is no variable 'episode'; "),
        ({"windows_s": [[0, 1]]}, r"give rollouts or windows_s, not both"),
        ({"rollouts": None}, "arm: time does not grow from row 40"),
    ],
)
def test_wrong_rollouts_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    dataset(tmp_path / "arm", "v2.1")
    content = {key: value for key, value in sources(**change).items() if value is not None}
    with pytest.raises((ExperimentError, RecordingError), match=message):
        read(tmp_path, content)


def test_percent_needs_limits(tmp_path: Path) -> None:
    dataset(tmp_path / "arm", "v2.1")
    table = experiment_table("recording", sources(), "arm.toml")
    robot = fake_robot(joint_names=("shoulder_pan", "gripper"))
    with pytest.raises(ExperimentError, match="unit 'percent' needs the limits of joint 2"):
        read_recording(table, "recording 1", robot, None, DataFolder(tmp_path))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("version", "LeRobot datasets of version 2 and 3 are read, got 'v1.6'"),
        ("json", "meta/info.json is not JSON"),
        ("cut", "this is not a readable Parquet file"),
        ("empty", r"the dataset has no data/\*/\*.parquet"),
    ],
)
def test_damaged_datasets_are_refused(tmp_path: Path, damage: str, message: str) -> None:
    folder = dataset(tmp_path / "arm", "v3.0")
    info, files = folder / "meta" / "info.json", sorted((folder / "data" / "chunk-000").iterdir())
    if damage == "version":
        info.write_text(info.read_text().replace("v3.0", "v1.6"))
    elif damage == "json":
        info.write_text("{")
    elif damage == "cut":
        files[1].write_bytes(files[1].read_bytes()[:-100])
    else:
        for file in files:
            file.unlink()
    with pytest.raises(RecordingError, match=message):
        open_data_file(folder, "arm", delimiter=None, header=None)


def test_without_pyarrow_a_sentence_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = tmp_path / "log.parquet"
    path.write_bytes(b"PAR1" + bytes(40))
    with pytest.raises(RecordingError, match=r"log.parquet: Parquet files .* pip install 'didim\[lerobot\]'"):
        open_data_file(path, path.name, delimiter=None, header=None)
