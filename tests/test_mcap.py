"""MCAP files of JSON messages: topics as tables, joints by name, and the sentences on what cannot be read."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from didim.errors import RecordingError
from didim.log.data_file import open_data_file
from didim.log.ros_bag import RosBag
from test_ros_bag import bag

N = 30
TOPICS = ("/joint_states", "/command")


def signals() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    return rng.standard_normal((N, 2)), rng.standard_normal((N, 2))


def write(path: Path, *, chunks: bool = True, topics: tuple[str, ...] = TOPICS) -> Path:
    """Write states and commands at 100 Hz."""
    mcap = pytest.importorskip("mcap.writer", reason="tests of MCAP files with JSON need the package mcap")
    q, command = signals()
    with path.open("wb") as stream:
        writer = mcap.Writer(stream, use_chunking=chunks)
        writer.start()
        schema = writer.register_schema(name="state", encoding="jsonschema", data=b"{}")
        channels = {
            topic: writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)
            for topic in topics
        }
        for k in range(N):
            content: dict[str, Any] = {
                "/joint_states": {"name": ["hip", "knee"], "position": q[k].tolist(), "frame": "base"},
                "/command": {
                    "target": {"value": command[k, 0]},
                    "positions": command[k].tolist(),
                    "ok": True,
                },
            }
            for topic, channel in channels.items():
                data = json.dumps(content[topic]).encode()
                time = 10_000_000 * k
                writer.add_message(channel_id=channel, log_time=time, publish_time=time, data=data)
        writer.finish()
    return path


def opened(path: Path, topic: str | None = None) -> Any:
    return open_data_file(path, path.name, delimiter=None, header=None, topic=topic)


@pytest.mark.parametrize("chunks", [True, False])
def test_topics_are_tables(tmp_path: Path, chunks: bool) -> None:
    file = opened(write(tmp_path / "run.mcap", chunks=chunks))
    q, command = signals()
    assert file.names == [
        "joint_states/time", "joint_states/position", "command/time", "command/target.value", "command/positions"
    ]  # fmt: skip
    np.testing.assert_array_equal(file.get(None, "joint_states/position", 2), q)
    np.testing.assert_array_equal(file.get([2], "command/positions", 1), command[:, 1:])
    np.testing.assert_array_equal(file.get(["command/target.value"], None, 1), command[:, :1])
    np.testing.assert_allclose(file.get(["joint_states/time"], None, 1)[:, 0], np.arange(N) / 100.0)
    assert file.labels == {"joint_states/position": ["hip", "knee"]}


def test_a_single_topic_needs_no_name(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap")
    assert opened(tmp_path / "run.mcap", "/command").names == ["time", "target.value", "positions"]
    assert opened(write(tmp_path / "one.mcap", topics=TOPICS[:1])).names == ["time", "position"]


def test_messages_of_ros_are_bags(tmp_path: Path) -> None:
    bag(tmp_path, mcap=True)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    assert isinstance(opened(path), RosBag)


def test_what_cannot_be_read_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "run.mcap")
    with pytest.raises(
        RecordingError, match=r"there is no topic '/comand' of JSON; .* did you mean '/command'"
    ):
        opened(path, "/comand")
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    with pytest.raises(
        RecordingError, match=r"run.mcap: .* need the package mcap: pip install 'didim\[mcap\]'"
    ):
        opened(path)
