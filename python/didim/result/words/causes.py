"""What looks wrong where a hypothesis names a cause, the edit, and the experiment that would decide.

Tested in ``tests/test_verdict.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..._tools.words import joints_text


def _gain(joints: tuple[int, ...], value: float, facts: Any) -> str:
    name = joints_text(joint - 1 for joint in joints)
    return (
        f"the torque of {name} looks {value:.3g} times too large"
        if value > 1.0
        else f"the torque of {name} looks too small: {value:.3g} times what it is"
    )


def _convention(facts: Any, *, file: bool) -> str:
    one, other = ("dh", "mdh") if facts.get("standard") else ("mdh", "dh")
    if file:
        return f'Write convention = "{other}" in the robot file'
    names = {"dh": "standard (Denavit-Hartenberg)", "mdh": "modified (Khalil-Kleinfinger)"}
    return f"the rows of the robot file look as if they were of the {names[other]} convention, not the {names[one]} one"


def _vector(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:.3g}' for value in values)}]"


Cause = tuple[
    Callable[[tuple[int, ...], Any, Any], str],
    Callable[[tuple[int, ...], Any, Any], str],
    str,
]
"""Functions of joints, value and facts that write the suspected fault and its fix, and the experiment that would decide."""
CAUSES: dict[str, Cause] = {
    "torque-sign": (
        lambda j, v, f: (
            f"the torque of joint {j[0]} looks as if its sign were wrong"
            if len(j) == 1
            else f"the torques of {joints_text(k - 1 for k in j)} look as if their signs were wrong"
        ),
        lambda j, v, f: "Turn the sign of the gain or of the column under [recording.torque]",
        "push the joint by hand: torque and motion must have the same sign",
    ),
    "position-sign": (
        lambda j, v, f: f"the position of joint {j[0]} looks as if its sign were wrong",
        lambda j, v, f: "Turn the sign of its column, or of its axis in the robot file",
        "move that joint alone and compare its axis with the robot file",
    ),
    "joint-sign": (
        lambda j, v, f: f"joint {j[0]} looks as if it turned the other way",
        lambda j, v, f: "Turn the sign of its row under [transmission], or of its axis in the robot file",
        "move that joint alone and compare its axis with the robot file",
    ),
    "swapped-torques": (
        lambda j, v, f: f"the torques of joints {j[0]} and {j[1]} look as if they were exchanged",
        lambda j, v, f: "Exchange their columns under [recording.torque]",
        "load one of the joints by hand and see which column answers",
    ),
    "drive-gain": (
        _gain,
        lambda j, v, f: (
            f"Divide gain under [recording.torque] by {v:.3g} for this joint, or look at its gear ratio"
        ),
        "weigh it: log a payload of known mass",
    ),
    "swapped-positions": (
        lambda j, v, f: f"the positions of joints {j[0]} and {j[1]} look as if they were exchanged",
        lambda j, v, f: "Exchange their columns under [recording.position]",
        "move one of the joints alone and see which column answers",
    ),
    "swapped-joints": (
        lambda j, v, f: f"positions and torques of joints {j[0]} and {j[1]} look as if they were exchanged",
        lambda j, v, f: "Exchange their columns under [recording.position] and [recording.torque]",
        "move one of the joints alone and see which columns answer",
    ),
    "gear-ratio": (
        lambda j, v, f: (
            f"position and torque of joint {j[0]} fit the others with {v:.3g} times the gear ratio"
        ),
        lambda j, v, f: f"Look at the row of motor {j[0]} of reduction under [transmission]",
        "turn the motor once and measure the joint",
    ),
    "position-scale": (
        lambda j, v, f: f"the position of joint {j[0]} fits the others when it is multiplied by {v:.3g}",
        lambda j, v, f: "Look at unit and counts_per_rev under [recording.position], and at the gear ratio",
        "turn the joint by a known angle",
    ),
    "rate": (
        lambda j, v, f: f"motion and torques fit together at {v:.3g} times the declared rate_hz",
        lambda j, v, f: "Look at rate_hz, or log time stamps",
        "log time stamps",
    ),
    "unit": (
        lambda j, v, f: f"the positions look as if they were in {f['unit']}, not in {f['declared']}",
        lambda j, v, f: f'Write unit = "{f["unit"]}" under [recording.position]',
        "turn a joint by a known angle",
    ),
    "side": (
        lambda j, v, f: (
            f"the {' and '.join(f'{key}s' for key in f['keys'])} look as if they were those of the {f['side']}s, not of the "
            f"{f['declared']}s"
        ),
        lambda j, v, f: (
            f'Write side = "{f["side"]}" under {" and ".join(f"[recording.{key}]" for key in f["keys"])}'
        ),
        "turn a joint by a known angle",
    ),
    "gravity": (
        lambda j, v, f: (
            f"gravity looks as if it were {_vector(f['vector'])} m/s^2 in frame 0, not {_vector(f['declared'])}"
        ),
        lambda j, v, f: (
            f"Write gravity_m_s2 = {_vector(f['vector'])} in the robot file, or look at how the robot is mounted"
        ),
        "look at how the robot is mounted",
    ),
    "dh-convention": (
        lambda j, v, f: _convention(f, file=False),
        lambda j, v, f: _convention(f, file=True),
        "compare the frames that didim robot prints with the arm",
    ),
    "a-and-d": (
        lambda j, v, f: "the lengths a and d of the robot file look exchanged",
        lambda j, v, f: "Exchange them, row by row",
        "compare the frames that didim robot prints with the arm",
    ),
    "twist-sign": (
        lambda j, v, f: f"the twist alpha of row {f['row']} looks as if its sign were wrong",
        lambda j, v, f: "Turn its sign in the robot file",
        "move the joint and compare its axis with the robot file",
    ),
    "link-length": (
        lambda j, v, f: (
            f"the length {f['symbol']} of row {f['row']} looks as if it were {v:.4g} m, not {f['declared']:.4g} m"
        ),
        lambda j, v, f: "Measure it, or look at the data sheet",
        "measure it",
    ),
}
"""Sentences of the hypotheses that name a cause."""
