"""ROS bags: joint states, controller states and trajectories, with joints by name, in any order.

Needs the extra ``ros`` (`rosbags`, which needs no ROS): folders of ROS 2 (SQLite and MCAP), single .mcap and .db3 files, and
.bag files of ROS 1. Time is that of the header, not of the recorder. Tested in ``tests/test_ros_bag.py``.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .._tools.arrays import Array
from .._tools.inputs import check_expanded, check_input
from .._tools.plugins import optional
from .._tools.words import brief, counted, did_you_mean, listing
from ..errors import RecordingError
from .data_format import Column, DataFile

SIGNALS = {
    "time": "stamp",
    "position": "position",
    "velocity": "velocity",
    "torque": "effort",
    "reference": "reference",
}
"""Default signals of a bag for the tables of a recording without `variable`."""

JOINT_STATE = "sensor_msgs/msg/JointState"
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
"""Message type of a recorded trajectory: each point is a sample at its time from the start."""

CONTROLLER_DEFINITION = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""
"""Definition of the controller's message in ROS 2 from the time when bags did not contain definitions."""


EXPANDED = 5
"""Memory of a message as a multiple of its bytes in the bag: names become strings, values arrays."""

CHUNK = 6
"""Opcode of the MCAP record that contains messages, usually compressed."""


@dataclass(frozen=True)
class _Message:
    """One message: stamp of its header (ns), names of joints, and values by signal."""

    stamp: int
    names: tuple[str, ...]
    values: Mapping[str, Any]


class RosBag(DataFile):
    """One topic of a bag.

    Parameters
    ----------
    path
        Folder or file.
    name
        Its name in messages.
    topic
        Topic to read; without one, the only topic of a known type.

    Raises
    ------
    RecordingError
        Without `rosbags`, for an unreadable bag, and for a missing or unknown `topic`.
    """

    signals: Mapping[str, str] = SIGNALS

    def __init__(self, path: Path, name: str, topic: str | None) -> None:
        self.name = name
        for file in _files(path):
            check_input(file, RecordingError, "no such data file")
            if file.suffix == ".mcap":
                check_expanded(EXPANDED * mcap_content(file), file.stat().st_size, name, RecordingError)
        # Of a folder, with the names of its files.
        digest = hashlib.sha256()
        for file in _files(path):
            if path.is_dir():
                digest.update(file.name.encode() + b"\0")
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
        self.sha256 = digest.hexdigest()
        self._wanted: dict[str, None] = {}
        self._messages = self._read(path, topic)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all joints of the topic, in the order of their first message."""
        return tuple(dict.fromkeys(name for message in self._messages for name in message.names))

    def has(self, signal: str) -> bool:
        """Whether messages of the wanted joints have a signal."""
        return any(len(message.values.get(signal, ())) for message in self._messages)

    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Request joints; messages without all of them, such as those of a gripper on the same topic, are ignored."""
        if variable not in SIGNALS.values():
            self.fail(f"variable must be one of {listing(SIGNALS.values())}, got {variable!r}")
        if variable == "stamp":
            return
        known = self.joints
        for column in columns or ():
            if not isinstance(column, str):
                self.fail(f"joints of a bag go by name, got column {column}")
            if column not in known:
                self.fail(
                    f"there is no joint {column!r} in topic {self.topic}; it has {listing(known, 40)}{did_you_mean(column, known)}"
                )
            self._wanted[column] = None

    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count); the time in s from the first message."""
        messages = [each for each in self._messages if self._wanted.keys() <= set(each.names)]
        if not messages:
            self.fail(f"no message of topic {self.topic} has all of {listing(self._wanted)}")
        if variable == "stamp":
            first = messages[0].stamp
            if messages[-1].stamp == 0:
                self.fail(
                    f"the headers of topic {self.topic} have no time; leave [recording.time] out and give rate_hz"
                )
            # Integer nanoseconds are subtracted, because seconds since 1970 only resolve 0.2 us.
            return np.array([(message.stamp - first) / 1e9 for message in messages])[:, None]
        assert variable is not None
        names = [str(column) for column in columns or ()]
        return np.array([self._row(message, variable, names, k) for k, message in enumerate(messages)])

    def _row(self, message: _Message, variable: str, names: Sequence[str], number: int) -> list[float]:
        values = message.values.get(variable, ())
        if len(values) != len(message.names):
            what = f"no {variable}" if not len(values) else f"{counted(len(values), 'value')} of {variable}"
            self.fail(
                f"message {number + 1} of topic {self.topic} has {what} for {counted(len(message.names), 'joint')}"
            )
        row = [float(values[message.names.index(name)]) for name in names]
        if not np.isfinite(row).all():
            joint = names[int(np.argmin(np.isfinite(row)))]
            self.fail(
                f"message {number + 1} of topic {self.topic}: {variable} of joint {joint!r} is not a finite number"
            )
        return row

    def _read(self, path: Path, topic: str | None) -> list[_Message]:
        needed = f"{self.name}: ROS bags need the package rosbags: pip install 'didim[ros]'"
        reading, types = (
            optional(f"rosbags.{part}", RecordingError, needed) for part in ("highlevel", "typesys")
        )
        store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        store.register(types.get_types_from_msg(CONTROLLER_DEFINITION, CONTROLLER_STATE))
        # A .db3 file is one part of the folder that describes it.
        inside = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").is_file() else path
        try:
            with reading.AnyReader([inside], default_typestore=store) as reader:
                self.topic = self._topic({c.topic: c.msgtype for c in reader.connections}, topic)
                chosen = [c for c in reader.connections if c.topic == self.topic]
                channels = [
                    content
                    for connection, _, raw in reader.messages(connections=chosen)
                    for content in _contents(reader.deserialize(raw, connection.msgtype))
                ]
        except RecordingError:
            raise
        except Exception as reason:  # a foreign parser may raise anything on bytes of another kind
            self.fail(
                f"this is not a readable ROS bag ({brief(' '.join(str(reason).split())) or type(reason).__name__})"
            )
        if not channels:
            self.fail(f"topic {self.topic} has no messages")
        # The recorder stores the time of arrival; the header has the time of the measurement.
        return sorted(channels, key=lambda message: message.stamp)

    def _topic(self, types: Mapping[str, str], topic: str | None) -> str:
        states = [name for name, kind in types.items() if kind in (JOINT_STATE, CONTROLLER_STATE)]
        # A trajectory is often a command, so it is read only if the bag has no other topic.
        known = states or [name for name, kind in types.items() if kind == TRAJECTORY]
        self.ambiguous = len(known) > 1
        if topic is None:
            if len(known) == 1:
                return known[0]
            if not known:
                self.fail(
                    f"no topic has joint states or states of a trajectory controller; topics are {listing(sorted(types))}"
                )
            self.fail(f"topic must say which is meant; there are {listing(sorted(known))}")
        if topic not in types:
            self.fail(
                f"there is no topic {topic!r}; topics are {listing(sorted(types), 60)}{did_you_mean(topic, types)}"
            )
        if topic not in known and types[topic] != TRAJECTORY:
            self.fail(
                f"topic {topic} has messages of type {types[topic]}; read are {JOINT_STATE} and {CONTROLLER_STATE}"
            )
        return topic


def _contents(message: Any) -> list[_Message]:
    """Return the samples of a message: one, or the points of a trajectory."""
    if not hasattr(message, "points"):
        return [_content(message)]
    start, names = _nanoseconds(message.header.stamp), tuple(message.joint_names)
    return [
        _Message(
            start + _nanoseconds(point.time_from_start),
            names,
            {"position": point.positions, "velocity": point.velocities, "effort": point.effort},
        )
        for point in message.points
    ]


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _content(message: Any) -> _Message:
    stamp = message.header.stamp
    time = _nanoseconds(stamp)
    if hasattr(message, "name"):
        values = {key: getattr(message, key) for key in ("position", "velocity", "effort")}
        return _Message(time, tuple(message.name), values)
    # The fields were called desired and actual before ROS 2 Iron.
    reference = getattr(message, "reference", None) or message.desired
    feedback = getattr(message, "feedback", None) or message.actual
    output = getattr(message, "output", None)
    effort = feedback.effort if len(feedback.effort) or output is None else output.effort
    values = {
        "position": feedback.positions,
        "velocity": feedback.velocities,
        "effort": effort,
        "reference": reference.positions,
    }
    return _Message(time, tuple(message.joint_names), values)


def _files(path: Path) -> list[Path]:
    """Files of a bag: itself, or those of its folder."""
    return [file for file in sorted(path.iterdir()) if not file.is_dir()] if path.is_dir() else [path]


def mcap_content(path: Path) -> int:
    """Return the bytes of the messages of an .mcap file, as its chunks declare them."""
    chunks = (stream.read(24) for kind, _, stream in mcap_records(path) if kind == CHUNK)
    return sum(struct.unpack("<QQQ", head)[2] for head in chunks if len(head) == 24)


def mcap_records(path: Path) -> Iterator[tuple[int, int, BinaryIO]]:
    """Return opcode, length and content of each record of an .mcap file outside its chunks."""
    at, end = 8, path.stat().st_size  # after the magic bytes
    with path.open("rb") as stream:
        while at + 9 <= end:
            stream.seek(at)
            kind, length = struct.unpack("<BQ", stream.read(9))
            yield kind, length, stream
            at += 9 + length
