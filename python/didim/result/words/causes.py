"""Sentences of hypotheses: the suspected cause, the edit, and the experiment that would decide.

Tested in ``tests/test_verdict.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..._tools.words import joints_text

Words = str | Callable[[tuple[int, ...], Any, Any], str]
"""A sentence with places for joints ``j``, value ``v`` and facts ``f``, or the function that makes one of them."""


def _signs(j: tuple[int, ...], v: Any, f: Any) -> str:
    if len(j) == 1:
        return f"the torque of joint {j[0]} looks as if its sign were wrong"
    return f"the torques of {joints_text(k - 1 for k in j)} look as if their signs were wrong"


def _gain(j: tuple[int, ...], v: Any, f: Any) -> str:
    name = joints_text(joint - 1 for joint in j)
    if v > 1.0:
        return f"the torque of {name} looks {v:.3g} times too large"
    return f"the torque of {name} looks too small: {v:.3g} times what it is"


def _side(j: tuple[int, ...], v: Any, f: Any) -> str:
    keys = " and ".join(f"{key}s" for key in f["keys"])
    more = (
        f", behind gears of about {f['ratio']:.3g}"
        if "ratio" in f
        else f", in {f['unit']}"
        if "unit" in f
        else ""
    )
    return f"the {keys} look like those of the {f['side']}s{more}, not of the {f['declared']}s"


def _side_edit(j: tuple[int, ...], v: Any, f: Any) -> str:
    text = f'Write side = "{f["side"]}" under {" and ".join(f"[recording.{key}]" for key in f["keys"])}'
    if "ratios" in f:
        ratios = ", ".join(f"{ratio:.3g}" for ratio in f["ratios"])
        return (
            f"{text}, and the gear ratios as reduction under [transmission] of the robot file: about {ratios}"
        )
    if "ratio" in f:
        return f'{text} with unit = "rad", and the gear ratios under [transmission]; the torques are probably of the motors too'
    return f'{text}, and unit = "{f["unit"]}" for the positions' if "unit" in f else text


def _torque_unit(j: tuple[int, ...], v: Any, f: Any) -> str:
    if "unit" in f:
        return f"the torques look as if they were in {f['unit']}"
    return f"all torques look {v:.3g} times as large as they are"


def _unit_edit(j: tuple[int, ...], v: Any, f: Any) -> str:
    if f["unit"] == "mrad":
        return 'Write unit = "rad" and scale = 0.001 under [recording.position]'
    return f'Write unit = "{f["unit"]}" under [recording.position]'


def _reversed(j: tuple[int, ...], v: Any, f: Any) -> str:
    keys = " and ".join(f"{key}s" for key in f["keys"])
    return f"the {keys} look reversed, the last joint first"


def _reversed_edit(j: tuple[int, ...], v: Any, f: Any) -> str:
    return f"Reverse columns under {' and '.join(f'[recording.{key}]' for key in f['keys'])}"


def _gravity(j: tuple[int, ...], v: Any, f: Any) -> str:
    return (
        f"gravity looks as if it were {_vector(f['vector'])} m/s^2 in frame 0, not {_vector(f['declared'])}"
    )


def _gravity_edit(j: tuple[int, ...], v: Any, f: Any) -> str:
    return (
        f"Write gravity_m_s2 = {_vector(f['vector'])} in the robot file, or look at how the robot is mounted"
    )


def _vector(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:.3g}' for value in values)}]"


def _convention(j: tuple[int, ...], v: Any, f: Any) -> str:
    names = ["modified (Khalil-Kleinfinger)", "standard (DH)"]
    one, other = names[::-1] if f.get("standard") else names
    return f"the rows of the robot file look {other}, not {one}"


def _convention_edit(j: tuple[int, ...], v: Any, f: Any) -> str:
    return f'Write convention = "{"mdh" if f.get("standard") else "dh"}" in the robot file'


def _twist_edit(j: tuple[int, ...], v: Any, f: Any) -> str:
    return _in_urdf(j) if f.get("urdf") else f"Turn the sign of alpha_deg in row {f['row']}, {_row(f)}"


def _length_edit(j: tuple[int, ...], v: Any, f: Any) -> str:
    if f.get("urdf"):
        return _in_urdf(j)
    return f"Measure it, and write {f['symbol']} = {v:.4g} in row {f['row']}, {_row(f)}"


def _row(f: Any) -> str:
    return f"table {f['row']} of [[joint]] in the robot file"


def _in_urdf(j: tuple[int, ...]) -> str:
    return f"Compare origin and axis of joint {j[0]} in the URDF with the arm"


CAUSES: dict[str, tuple[Words, Words, str]] = {
    "torque-sign": (
        _signs,
        "Turn its sign under [recording.torque]: sign = -1, or 1 if it is -1",
        "push the joint by hand: torque and motion must have the same sign",
    ),
    "position-sign": (
        "the position of joint {j[0]} looks as if its sign were wrong",
        "Turn its sign under [recording.position]: sign = -1, or 1 if it is -1; or turn its axis in the URDF",
        "move that joint alone and compare its axis with the robot file",
    ),
    "joint-sign": (
        "joint {j[0]} looks as if it turned the other way",
        "Turn its sign under [recording.position] and [recording.torque], or in its row under [transmission]",
        "move that joint alone and compare its axis with the robot file",
    ),
    "swapped-torques": (
        "the torques of joints {j[0]} and {j[1]} look as if they were exchanged",
        "Exchange their columns under [recording.torque]",
        "load one of the joints by hand and see which column answers",
    ),
    "drive-gain": (
        _gain,
        "Divide scale under [recording.torque] by {v:.3g} for this joint (1 where it is not written), or look at its gear ratio",
        "weigh it: log a payload of known mass",
    ),
    "torque-unit": (
        _torque_unit,
        "Divide scale under [recording.torque] by {v:.4g}: scale is 1 where it is not written",
        "weigh it: log a payload of known mass",
    ),
    "swapped-positions": (
        "the positions of joints {j[0]} and {j[1]} look as if they were exchanged",
        "Exchange their columns under [recording.position]",
        "move one of the joints alone and see which column answers",
    ),
    "swapped-joints": (
        "positions and torques of joints {j[0]} and {j[1]} look as if they were exchanged",
        "Exchange their columns under [recording.position] and [recording.torque]",
        "move one of the joints alone and see which columns answer",
    ),
    "gear-ratio": (
        "position and torque of joint {j[0]} fit the others with {v:.3g} times the gear ratio",
        "Look at the row of motor {j[0]} of reduction under [transmission]",
        "turn the motor once and measure the joint",
    ),
    "position-scale": (
        "the position of joint {j[0]} fits the others when it is multiplied by {v:.3g}",
        "Look at unit and counts_per_rev under [recording.position], and at the gear ratio",
        "turn the joint by a known angle",
    ),
    "rate": (
        "motion and torques fit together at {v:.3g} times the declared rate_hz",
        "Look at rate_hz, or log time stamps",
        "log time stamps",
    ),
    "unit": (
        "the positions look as if they were in {f[unit]}, not in {f[declared]}",
        _unit_edit,
        "turn a joint by a known angle",
    ),
    "side": (_side, _side_edit, "turn a joint by a known angle"),
    "reversed-order": (
        _reversed,
        _reversed_edit,
        "move one of the joints alone and see which column answers",
    ),
    "another-robot": (
        "the log fits the included robot '{f[robot]}' better than '{f[declared]}'",
        'Write robot = "{f[robot]}" if it is one, or compare the lengths of the robot file with the arm',
        "the plate on the arm, or a ruler",
    ),
    "gravity": (_gravity, _gravity_edit, "look at how the robot is mounted"),
    "dh-convention": (
        _convention,
        _convention_edit,
        "compare the frames that didim robot prints with the arm",
    ),
    "a-and-d": (
        "the lengths a and d of the robot file look exchanged",
        "Exchange them, row by row",
        "compare the frames that didim robot prints with the arm",
    ),
    "twist-sign": (
        "the twist alpha of row {f[row]} looks as if its sign were wrong",
        _twist_edit,
        "move the joint and compare its axis with the robot file",
    ),
    "link-length": (
        "the length {f[symbol]} of row {f[row]} looks as if it were {v:.4g} m, not {f[declared]:.4g} m",
        _length_edit,
        "the data sheet, or a ruler",
    ),
}
"""Symptom, remedy, and the experiment that would decide, of each hypothesis that names a cause."""


def looks(code: str, j: tuple[int, ...], v: Any, f: Any) -> str:
    """Return what looks wrong, of joints, value and facts of a cause."""
    return _filled(CAUSES[code][0], j, v, f)


def edit(code: str, j: tuple[int, ...], v: Any, f: Any) -> str:
    """Return what to change, likewise."""
    return _filled(CAUSES[code][1], j, v, f)


def _filled(words: Words, j: tuple[int, ...], v: Any, f: Any) -> str:
    return words.format(j=j, v=v, f=f) if isinstance(words, str) else words(j, v, f)
