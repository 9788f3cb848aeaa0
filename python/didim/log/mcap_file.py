"""MCAP files with JSON messages, as written by Foxglove and by loggers without ROS. Needs the extra ``mcap``.

Messages of ROS 2 (CDR) in MCAP are bags, `didim.log.ros_bag`. A topic is a table: each number in its messages is a column, each
list of numbers a matrix, and ``time`` the time at which it was logged (s). Tested in ``tests/test_mcap.py``.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.inputs import check_expanded, read_file
from .._tools.plugins import optional
from .._tools.words import did_you_mean, listing
from ..errors import RecordingError
from .array_file import ArrayFile
from .ros_bag import EXPANDED, mcap_content, mcap_records

CHANNEL = 4
"""Opcode of the MCAP record that describes a topic."""


class McapJsonFile(ArrayFile):
    """Numbers of JSON messages by ``topic/field``; of a single topic by the name of the field alone.

    Columns of a matrix have names if the messages have a list of names of the same length.
    """

    kind = "MCAP"

    def __init__(self, raw: bytes, name: str, topic: str | None = None) -> None:
        self._topic = topic
        super().__init__(raw, name)

    def variables(self) -> list[str]:
        """Names of the numbers that all messages of a topic have."""
        needed = "MCAP files with JSON messages need the package mcap: pip install 'didim[mcap]'"
        mcap = optional("mcap.reader", RecordingError, f"{self.name}: {needed}")
        rows: dict[str, list[Mapping[str, Any]]] = {}
        for _, channel, message in mcap.make_reader(io.BytesIO(self.raw)).iter_messages():
            if channel.message_encoding == "json":
                content = {"time": message.log_time / 1e9, **_flat(json.loads(message.data))}
                rows.setdefault(channel.topic, []).append(content)
        if self._topic is not None and self._topic not in rows:
            self.fail(
                f"there is no topic {self._topic!r} of JSON; topics are {listing(sorted(rows), 60)}"
                f"{did_you_mean(self._topic, rows)}"
            )
        chosen = {self._topic: rows[self._topic]} if self._topic is not None else rows
        self._values: dict[str, Any] = {}
        labels = {}
        for topic, messages in chosen.items():
            prefix = f"{topic.strip('/')}/" if len(chosen) > 1 else ""
            names = _names(messages[0])
            for key in messages[0]:
                values = _column([message.get(key) for message in messages])
                if values is None:
                    continue
                self._values[prefix + key] = values
                if values.ndim == 2 and values.shape[1] == len(names):
                    labels[prefix + key] = names
        self.labels = labels
        if not self._values:
            self.fail("its messages hold no numbers")
        return list(self._values)

    def array(self, name: str) -> Any:
        """Values of a name, a row for each message."""
        return self._values[name]


def _flat(content: Any, path: str = "") -> dict[str, Any]:
    """Fields of nested objects by their paths, such as ``header.stamp.sec``."""
    if not isinstance(content, dict):
        return {path or "value": content}
    flat: dict[str, Any] = {}
    for key, value in content.items():
        flat.update(_flat(value, f"{path}.{key}" if path else str(key)))
    return flat


def _names(message: Mapping[str, Any]) -> list[str]:
    """Names of the joints of a message, as in joint states."""
    named = next((message[key] for key in ("name", "names", "joint_names") if key in message), None)
    return named if isinstance(named, list) and all(isinstance(name, str) for name in named) else []


def _column(values: Sequence[Any]) -> Any:
    """Values of one field as a vector or a matrix; None unless they are numbers, or lists of equal length."""
    if any(value is None or isinstance(value, bool | str | dict) for value in values):
        return None
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):  # texts, or lists of several lengths
        return None
    return array if array.ndim in (1, 2) and array.size else None


def has_json(path: Path) -> bool:
    """Whether an MCAP file has a JSON topic; only records outside its chunks are read, where writers repeat all topics."""
    return any(
        kind == CHANNEL and _encoding(stream.read(min(length, 1 << 16))) == b"json"
        for kind, length, stream in mcap_records(path)
    )


def _encoding(record: bytes) -> bytes:
    """Return the encoding of a channel's messages, which follows two numbers and the topic; the length precedes each text."""
    at = 4
    text = b""
    for _ in range(2):
        if at + 4 > len(record):
            return b""
        (size,) = struct.unpack_from("<I", record, at)
        text = record[at + 4 : at + 4 + size]
        at += 4 + size
    return text


def open_mcap_json(path: Path, name: str, topic: str | None) -> McapJsonFile:
    """Open an MCAP file with JSON messages.

    Raises
    ------
    RecordingError
        Without the package mcap, for a file that cannot be read, and for a topic that it does not contain.
    """
    raw = read_file(path, RecordingError, "no such data file", copies=2)
    check_expanded(EXPANDED * mcap_content(path), len(raw), name, RecordingError)
    return McapJsonFile(raw, name, topic)
