"""Columns of a log, sorted by what their names say. Tested in ``tests/test_init.py``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import RecordingError
from ..log.csv_file import CsvFile
from ..log.data_file import open_data_file

WORDS = {
    "time": ("t", "time", "timestamp", "stamp", "clock"),
    "reference": ("ref", "reference", "des", "desired", "cmd", "command", "commanded", "target", "setpoint"),
    "acceleration": ("ddq", "qdd", "acc", "acceleration", "qddot"),
    "velocity": ("dq", "qd", "vel", "velocity", "speed", "qdot", "omega"),
    "torque": ("tau", "torque", "torques", "trq", "effort", "force", "moment", "gamma"),
    "current": ("i", "iq", "current", "cur", "amp", "amps"),
    "voltage": ("u", "v", "vir", "voltage", "volt", "volts"),
    "position": (
        "q",
        "qm",
        "pos",
        "position",
        "positions",
        "angle",
        "theta",
        "enc",
        "encoder",
        "joint",
        "axis",
    ),
}
"""Keywords of column names for each kind of signal. The first kind with a matching keyword is taken."""

UNITS = {
    "rad": "rad", "deg": "deg", "degree": "deg", "degrees": "deg", "mm": "mm", "m": "m", "count": "count", "counts": "count",
    "nm": "N.m", "n": "N", "a": "A", "ampere": "A", "s": "s", "sec": "s", "seconds": "s", "ms": "ms", "us": "us",
}  # fmt: skip
"""Units in names of columns."""


@dataclass(frozen=True)
class Column:
    """What the name of a column says."""

    name: str | int
    what: str
    number: int | None = None
    unit: str | None = None
    motor: bool = False


def column(name: str, joint_names: Sequence[str] = ()) -> Column:
    """Read the name of a column: ``q1``, ``motor_2_torque_Nm``, ``pos[3] (deg)``, ``elbow_joint effort``.

    Parameters
    ----------
    name : str
        Name of the column.
    joint_names : sequence of str
        Names of the robot's joints: a column with one of them is of that joint, whatever numbers the name has.

    Returns
    -------
    Column
        With kind ``other`` where no word is known.
    """
    named = _joint_of(name, joint_names)
    if named is None:
        return _column(name, name)
    joint, rest = named
    found = _column(name, rest)
    # A log of positions alone may name its columns after the joints and nothing else.
    what = "position" if not re.search(r"\w", rest) else found.what
    return replace(found, number=joint + 1, what=what)


def _joint_of(name: str, joint_names: Sequence[str]) -> tuple[int, str] | None:
    """Joint (from 0) that a name of a column has in it, the longest where there are several, and the name without it."""
    for affix in ("", r"[_\W]*joint[_\W]*"):  # shoulder_pan for shoulder_pan_joint
        short = {joint: re.sub(affix, "", key, flags=re.IGNORECASE) for joint, key in enumerate(joint_names)}
        for joint, key in sorted(short.items(), key=lambda item: -len(item[1])):
            if len(key) < 2:
                continue
            found = re.search(rf"(?<![A-Za-z0-9]){re.escape(key)}(?![A-Za-z0-9])", name, flags=re.IGNORECASE)
            if found:
                return joint, f"{name[: found.start()]} {name[found.end() :]}"
    return None


def _column(name: str, text: str) -> Column:
    """Read the text of a column called `name`."""
    # camelCase and digits are boundaries too.
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", text.strip())
    bracket = re.search(r"[\[(]\s*([A-Za-z.]+)\s*[\])]", text)
    tokens = [token for token in re.split(r"[^A-Za-z0-9]+", spaced) if token]
    words = [token.lower() for token in tokens if not token.isdigit()]
    numbers = [int(token) for token in tokens if token.isdigit()]
    unit = UNITS.get(bracket.group(1).lower().replace(".", "")) if bracket else None
    # A single word is a name, not a unit.
    if unit is None and len(words) > 1:
        unit = UNITS.get(words[-1])
    kind = "other"
    for what, known in WORDS.items():
        if any(word in known for word in (words if unit is None else words[:-1] or words)):
            kind = what
            break
    if kind == "reference" and any(
        word in (*WORDS["velocity"], *WORDS["acceleration"], *WORDS["torque"]) for word in words
    ):
        kind = "other"
    motor = any(word in ("motor", "mot") for word in words)
    if kind == "other" and motor and unit in ("rad", "deg", "count"):
        kind = "position"
    return Column(name, kind, numbers[-1] if numbers else None, unit, motor)


def first_line(log: Path) -> tuple[str, list[str] | None]:
    """Return the delimiter of a text file and the names in its first line, or None for numbers."""
    line = _text(log)
    delimiter = next((sign for sign in (",", ";", "\t") if sign in line), " " if " " in line.strip() else ",")
    file = open_data_file(log, log.name, delimiter=delimiter, header=None)
    return delimiter, file.names if isinstance(file, CsvFile) else None


def column_count(log: Path, delimiter: str) -> int:
    """Count the columns of the first line of a text file."""
    line = _text(log)
    return len(line.split() if delimiter == " " else line.split(delimiter))


def _text(log: Path) -> str:
    try:
        with log.open(encoding="utf-8-sig", errors="replace") as file:
            return file.readline().rstrip("\r\n")
    except FileNotFoundError:
        raise RecordingError(f"{log}: no such data file") from None
    except OSError as reason:
        raise RecordingError(f"{log}: cannot be read ({reason.strerror})") from None
