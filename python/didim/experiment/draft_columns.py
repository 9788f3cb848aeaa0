"""Columns of a log, classified by their names. Tested in ``tests/test_init.py``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os.path import commonprefix

from .._tools.words import series

WORDS = {
    "time": ("t", "time", "times", "timestamp", "timestamps", "stamp", "stamps", "clock"),
    "reference": ("ref", "reference", "des", "desired", "cmd", "command", "commanded", "target", "setpoint", "goal",
        "action", "qg"),
    "acceleration": ("ddq", "qdd", "acc", "acceleration", "accelerations", "qddot"),
    "velocity": ("dq", "qd", "vel", "velocity", "velocities", "speed", "speeds", "qdot", "omega"),
    "torque": ("tau", "torque", "torques", "trq", "effort", "efforts", "force", "moment", "gamma"),
    "current": ("i", "iq", "current", "currents", "cur", "amp", "amps"),
    "voltage": ("u", "v", "vir", "voltage", "voltages", "volt", "volts"),
    "position": ("q", "qm", "pos", "position", "positions", "ang", "angle", "angles", "theta", "enc", "encoder"),
}  # fmt: skip
"""Keywords of column names for each kind of signal. The first kind with a matching keyword is taken."""

PLACES = (
    "joint", "joints", "axis", "axes", "motor", "mot", "robot", "arm", "actual", "act", "measured",
    "meas", "state", "feedback", "present",
)  # fmt: skip
"""Words for the location of a signal: a name of only these words and a number is a position."""

FOREIGN = (
    "tcp", "pose", "temperature", "temp", "ext", "external", "filtered", "hat", "error", "digital",
    "tool",
)  # fmt: skip
"""Words that exclude a column from the joints' positions, velocities and torques, whatever its other words."""

UNITS = {
    "rad": "rad", "deg": "deg", "degree": "deg", "degrees": "deg", "mm": "mm", "m": "m", "count": "count", "counts": "count",
    "nm": "N.m", "n": "N", "a": "A", "ampere": "A", "s": "s", "sec": "s", "seconds": "s", "ms": "ms", "us": "us",
}  # fmt: skip
"""Unit by word in a column name."""

MAKERS: tuple[tuple[str, str, str | None], ...] = (
    # Universal Robots, RTDE: target_moment comes from the controller's model.
    (r"actual_q[_\[]?(\d+)\]?", "position", "rad"),
    (r"target_q[_\[]?(\d+)\]?", "reference", "rad"),
    (r"actual_qd[_\[]?(\d+)\]?", "velocity", None),
    (r"actual_current_as_torque[_\[]?(\d+)\]?", "torque", "N.m"),
    (r"actual_current[_\[]?(\d+)\]?", "current", "A"),
    (
        r"(?:target_(?:qd|qdd|current|moment)|joint_control_output|actual_joint_voltage)[_\[]?(\d+)\]?",
        "other",
        None,
    ),
    # Franka, libfranka: tau_J_d is without gravity, theta of the motors.
    (r"(?:.*[./])?q_d[_\[]?(\d+)\]?", "reference", "rad"),
    (r"(?:.*[./])?tau_J[_\[]?(\d+)\]?", "torque", "N.m"),
    (
        r"(?:.*[./])?(?:tau_J_d|dtau_J|tau_ext_hat_filtered|dq_d|ddq_d|theta|dtheta)[_\[]?(\d+)\]?",
        "other",
        None,
    ),
    # KUKA RSI: actual and set positions of the axes in degrees, motor currents.
    (r"(?:.*[./])?AIPos[._]A(\d+)", "position", "deg"),
    (r"(?:.*[./])?ASPos[._]A(\d+)", "reference", "deg"),
    (r"(?:.*[./])?MACur[._]A(\d+)", "current", "A"),
    (r"(?:.*[./])?(?:AxisTorque|GearTorque|Torque)[._]A(\d+)", "torque", "N.m"),
    (r"(?:.*[./])?(?:RIst|RSol|EIPos|ESPos|Delay)[._]\w+", "other", None),
    (r"IPOC", "time", "ms"),
    # ROS and PlotJuggler: the stamp of the header in s, and its two halves.
    (r"__time", "time", "s"),
    (r".*/header/stamp", "stamp", "s"),
    (r".*/stamp/(?:nano)?secs?", "other", None),
)
"""Column names in manufacturers' logs: pattern of the whole name with the joint's number, kind, unit."""


@dataclass(frozen=True)
class Column:
    """A column with the properties in its name.

    Attributes
    ----------
    name : str or int
        Name, or number from 1.
    what : str
        Kind of signal.
    number : int or None
        Number of the joint in the name.
    unit : str or None
        Unit in the name.
    motor : bool
        Whether the name indicates the motor side.
    variable : str or None
        Array of a file of arrays that the column belongs to.
    stem : str
        The name without numbers, common to the columns of one signal.
    placed : bool
        Whether the name only gives a location (``Joint_1``); the name of the file may then give the kind.
    file : int
        Number of the file, from 0, in a log of several files.
    """

    name: str | int
    what: str
    number: int | None = None
    unit: str | None = None
    motor: bool = False
    variable: str | None = None
    stem: str = ""
    placed: bool = False
    file: int = 0


def read_column(name: str, joint_names: Sequence[str] = ()) -> Column:
    """Read the name of a column: ``q1``, ``motor_2_torque_Nm``, ``pos[3] (deg)``, ``elbow_joint effort``, ``actual_q_0``.

    Parameters
    ----------
    name : str
        Name of the column.
    joint_names : sequence of str
        Names of the robot's joints; they take precedence over numbers in the column's name.

    Returns
    -------
    Column
        Column; its kind is ``other`` if no word is known.
    """
    for pattern, what, unit in MAKERS:
        match = re.fullmatch(pattern, name.strip(), flags=re.IGNORECASE)
        if match:
            # The header's time of the measurement is better than the time of arrival.
            number = int(match.group(1)) if match.groups() and match.group(1) else None
            return Column(name, "time" if what == "stamp" else what, number, unit, stem=_stem(name))
    named = _joint_of(name, joint_names)
    if named is None:
        return _column(name, name)
    joint, rest = named
    column_found = _column(name, rest)
    # A log of only positions may use the joint names as column names.
    bare = not re.search(r"\w", rest)
    return replace(
        column_found,
        number=joint + 1,
        what="position" if bare else column_found.what,
        placed=bare or column_found.placed,
    )


def _joint_of(name: str, joint_names: Sequence[str]) -> tuple[int, str] | None:
    """Return the joint (from 0) in a column's name, the longest match, and the name without it."""
    for affix in ("", r"[_\W]*joint[_\W]*"):  # shoulder_pan for shoulder_pan_joint
        short = {joint: re.sub(affix, "", key, flags=re.IGNORECASE) for joint, key in enumerate(joint_names)}
        for joint, key in sorted(short.items(), key=lambda pair: -len(pair[1])):
            if len(key) < 2:
                continue
            match = re.search(rf"(?<![A-Za-z0-9]){re.escape(key)}(?![A-Za-z0-9])", name, flags=re.IGNORECASE)
            if match:
                return joint, f"{name[: match.start()]} {name[match.end() :]}"
    return None


def _stem(text: str) -> str:
    return re.sub(r"\d+", "", text).strip().lower()


def _column(name: str, text: str) -> Column:
    """Read the text of a column called `name`."""
    bracket = re.search(r"[\[(]\s*([A-Za-z.]+)\s*[\])]", text)
    tokens = _tokens(text.strip())
    words = [token.lower() for token in tokens if not token.isdigit()]
    numbers = [int(token) for token in tokens if token.isdigit()]
    unit = UNITS.get(bracket.group(1).lower().replace(".", "")) if bracket else None
    # A single word is a name, not a unit.
    if unit is None and len(words) > 1:
        unit = UNITS.get(words[-1])
    signal = words if unit is None else words[:-1] or words
    kind = next((what for what, known in WORDS.items() if any(word in known for word in signal)), "other")
    motor = any(word in ("motor", "mot", "motors") for word in words)
    placed = False
    if kind == "reference" and any(
        word in known
        for what, known in WORDS.items()
        if what not in ("reference", "position", "time")
        for word in signal
    ):
        kind = "other"
    if (
        kind == "other"
        and signal
        and all(word in PLACES for word in signal)
        and unit in (None, "rad", "deg", "m", "mm", "count")
    ):
        # A name such as motor_3 does not define the kind without a unit.
        kind = "position" if unit is not None or not motor else "other"
        placed = True
    if any(word in FOREIGN for word in words):
        kind = "other"
    return Column(name, kind, numbers[-1] if numbers else None, unit, motor, stem=_stem(text), placed=placed)


def name_without_signal(name: str) -> tuple[str, ...]:
    """Return the words of a file name without those of a signal, the common part of one log's files.

    Parameters
    ----------
    name : str
        Name without suffix: ``motor_position_run2`` gives ``motor``, ``run`` and ``2``.
    """
    signals = {word for known in WORDS.values() for word in known}
    return tuple(word for word in map(str.lower, _tokens(name)) if word not in signals)


def _tokens(text: str) -> list[str]:
    """Return the words and numbers of a name; camelCase and digits are boundaries too."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", text)
    return [token for token in re.split(r"[^A-Za-z0-9]+", spaced) if token]


def joints_by_name(labels: Sequence[str], joint_names: Sequence[str], n_dof: int) -> tuple[list[str], str]:
    """Return the joints of a log in the order of the robot's, with a sentence if names were matched approximately.

    Parameters
    ----------
    labels : sequence of str
        Names in the log.
    joint_names : sequence of str
        Names of the robot's joints, or none.
    n_dof : int
        Number of the robot's joints.

    Returns
    -------
    list of str, str
        Names in the log, none if the match is ambiguous, and a sentence, empty if the names are the robot's.
    """
    if joint_names and set(joint_names) <= set(labels):
        return list(joint_names), ""
    # Names are texts, not paths: their common letters are meant.
    common = commonprefix(list(joint_names)) if len(joint_names) > 1 else ""  # noqa: RUF071
    ends = [name.removeprefix(common) for name in joint_names]
    begins = {name.removesuffix(ends[0]) for name in labels if ends and name.endswith(ends[0])}
    fitting = [begin for begin in begins if all(begin + end in labels for end in ends)]
    if len(fitting) == 1:
        names = [fitting[0] + end for end in ends]
        return names, f"joints {names[0]} to {names[-1]} of the log are {joint_names[0]} to {joint_names[-1]}"
    numbers = [re.findall(r"\d+", name)[-1:] for name in labels]
    if len(labels) == n_dof and all(numbers) and not fitting:
        ordered = sorted(zip((int(number[0]) for number in numbers), labels, strict=True))
        if [number for number, _ in ordered] == list(range(ordered[0][0], ordered[0][0] + n_dof)):
            names = [name for _, name in ordered]
            return names, f"joints {names[0]} to {names[-1]} of the log are joints 1 to {n_dof} of the robot"
    return [], ""


def listed(columns: Sequence[Column]) -> str:
    """Return the names of columns as a text, for a matrix its name."""
    variable = columns[0].variable
    if variable is not None and isinstance(columns[0].name, int):
        return f"{variable!r}"
    if all(isinstance(each.name, int) for each in columns) and len(columns) > 1:
        numbers = [int(each.name) for each in columns]
        if numbers == list(range(numbers[0], numbers[0] + len(numbers))):
            return f"{numbers[0]} to {numbers[-1]}"
    return series(str(each.name) for each in columns)
