"""A robot as the text of a robot file, which `load_robot` reads back as the same robot, digit by digit.

Tested in ``tests/test_urdf.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from .._tools.toml import quoted, toml_key
from .._tools.words import one_line
from .correspondence import Correspondence, Pose
from .friction import (
    CYLINDER,
    KEYS,
    OF_TEMPERATURE,
    REFERENCE_DEGC,
    SCALED,
    SPRINGS,
    Friction,
    FrictionTerm,
    scale_units,
)
from .placement import Mount
from .right_angles import RIGHT_ANGLE_ROUNDING, SNAP, nearest_right_angle
from .robot import LIMIT_KEYS, JointLimits, Robot
from .transmission import SOFTNESS, followers_text


def robot_text(robot: Robot) -> str:
    """Return the content of a robot file.

    Parameters
    ----------
    robot : Robot
        Any robot.
    """
    lines = [f"# {one_line(note)}" for note in robot.notes]
    lines += [
        "schema = 1",
        f"name = {quoted(robot.name)}",
        f"description = {quoted(robot.description)}",
        f'convention = "{"mdh" if robot.standard is None else "dh"}"',
        f"gravity_m_s2 = {_numbers(robot.geometry.gravity)}",
    ]
    if robot.cut:
        lines.append(f"cut = {quoted(list(robot.cut))} # closed loops that this tree does not have")
    if _snaps(robot):
        lines.append("snap_rad = 0.0 # angles are kept as they are")
    geometry = robot.geometry
    for j, kind in enumerate(geometry.kinds):
        lines += ["", "[[joint]]"]
        if robot.joint_names:
            lines.append(f"name = {quoted(robot.all_joint_names[j])}")
        lines.append(f"kind = {quoted(kind)}")
        if geometry.mounts:
            taken = any(any(mount.shift) for mount in geometry.mounts)
            lines += _mount(geometry.mounts[j], j, taken)
        if robot.standard is None:
            lines += [
                _angle("alpha", geometry.alpha[j]),
                f"d_m = {_number(geometry.d[j])}",
                _angle("theta", geometry.theta[j]),
                f"r_m = {_number(geometry.r[j])}",
            ]
        else:
            lines += [
                f"a_m = {_number(robot.standard.a[j])}",
                _angle("alpha", robot.standard.alpha[j]),
                f"d_m = {_number(geometry.r[j])}",
                _angle("theta", geometry.theta[j]),
            ]
        limits = _limits(robot.limits[j], kind) if j < robot.n_dof else []
        if limits:
            lines.append(f"limits = {{ {', '.join(limits)} }}")
        lines += _drive(robot, j, kind)
    lines += followers_text(geometry.followers, geometry.kinds) + _transmission(robot) + _friction(robot)
    for capsule in robot.collision:
        lines += [
            "",
            "[[collision]]",
            f"link = {capsule.link}",
            f"from_m = {_numbers(capsule.start)}",
            f"to_m = {_numbers(capsule.end)}",
            f"radius_m = {_number(capsule.radius)}",
        ]
    for name, values in robot._named.items():
        lines += ["", f"[parameters.{toml_key(name)}]"]
        if name in robot._own:
            lines.append('frames = "own"')
        lines += [f"{toml_key(parameter)} = {_number(value)}" for parameter, value in values.items()]
    if robot.correspondence is not None:
        lines += _urdf(robot.correspondence)
    return "\n".join(lines) + "\n"


def _snaps(robot: Robot) -> bool:
    """Whether reading the file with the default tolerance would snap angles that were left unsnapped in this robot."""
    geometry = robot.geometry
    alphas = geometry.alpha if robot.standard is None else robot.standard.alpha
    gammas = [mount.gamma for mount in geometry.mounts]
    fixed = [theta for theta, kind in zip(geometry.theta, geometry.kinds, strict=True) if kind == "prismatic"]
    return any(
        RIGHT_ANGLE_ROUNDING < abs(angle - nearest_right_angle(angle)) <= SNAP
        for angle in (*alphas, *fixed, *gammas)
    )


def _mount(mount: Mount, joint: int, taken: bool) -> list[str]:
    """Return the lines of a joint's mount, if it differs from a chain's."""
    lines = []
    if mount.parent != (joint - 1 if joint else None):
        lines.append(f"antecedent = {0 if mount.parent is None else mount.parent + 1}")
    if mount.gamma:
        lines.append(_angle("gamma", mount.gamma))
    if mount.b:
        lines.append(f"b_m = {_number(mount.b)}")
    if taken:  # copied placements all have a shift; it prevents their angles from being snapped
        lines.append(f"shift_m = {_numbers(mount.shift)}")
    return lines


def _transmission(robot: Robot) -> list[str]:
    n = robot.n_dof
    identity = tuple(tuple(float(i == j) for j in range(n)) for i in range(n))
    lines = []
    if robot.geometry.coupling != identity:
        lines.append(f"coupling = {_matrix(robot.geometry.coupling)}")
    if robot.reduction is not None:
        lines.append(f"reduction = {_matrix(robot.reduction.tolist())}")
    if robot.gains is not None:
        lines.append(f"drive_gains = {_numbers(robot.gains)}")
    return ["", "[transmission]", *lines] if lines else []


def _friction(robot: Robot) -> list[str]:
    friction = robot.friction
    lines = [
        f"{key} = {quoted(getattr(friction, key))}"
        for key in ("model", "coulomb", "coupling")
        if getattr(friction, key) != getattr(Friction, key)
    ]
    for key in ("smoothing", "dead_zone"):
        values = getattr(friction, key)
        for unit, kind in scale_units(key):
            if any(value for value, joint in zip(values, robot.joint_kinds, strict=True) if joint == kind):
                lines.append(f"{key}_{unit} = {_numbers(values)}")
    lines += _further_friction(robot)
    own = [line for term in robot.friction.terms if term.law == "table" for line in _own_law(robot, term)]
    return [*(["", "[friction]", *lines] if lines else []), *own, *_springs(robot)]


def _springs(robot: Robot) -> list[str]:
    terms = robot.friction.springs
    lines = []
    for key, laws in SPRINGS.items():
        joints = [term.joint + 1 for term in terms if term.law == laws[0]]
        lines += [f"{key} = {joints}"] if joints else []
    for term in (term for term in terms if term.law == CYLINDER[0]):
        a, b, phi, rest = term.values
        lines += [
            "",
            "[[springs.cylinder]]",
            f"joint = {term.joint + 1}",
            f"a_m = {_number(a)}",
            f"b_m = {_number(b)}",
            f"phi_deg = {_number(math.degrees(phi))}",
            f"rest_m = {_number(rest)}",
        ]
    return ["", "[springs]", *lines] if lines else []


def _own_law(robot: Robot, term: FrictionTerm) -> list[str]:
    """Lines of a user-defined law, as a table of values."""
    unit = "rad_s" if robot.joint_kinds[term.joint] == "revolute" else "m_s"
    return [
        "",
        "[[friction.law]]",
        f"name = {quoted(term.name)}",
        f"joints = [{term.joint + 1}]",
        f"first_{unit} = {term.first!r}",
        f"step_{unit} = {term.step!r}",
        f"values = {_numbers(term.values)}",
    ]


def _further_friction(robot: Robot) -> list[str]:
    """Further terms, law by law, with the joints that have them."""
    friction = robot.friction
    lines = ['terms = "auto"'] if friction.auto else []
    reference: dict[int, float] = {}
    for law, key in KEYS.items():
        terms = [term for term in friction.terms if term.law == law]
        if not terms:
            continue
        lines.append(f"{key} = {[term.joint + 1 for term in terms]}")
        if law in OF_TEMPERATURE:
            reference |= {term.joint: term.values[0] for term in terms}
        if law in SCALED and not any(term.estimated for term in terms):
            name, starts = SCALED[law]
            for unit, kind in scale_units(name):
                if any(robot.joint_kinds[term.joint] == kind for term in terms):
                    values = [starts[joint] for joint in robot.joint_kinds]
                    for term in terms:
                        values[term.joint] = term.velocity
                    lines.append(f"{key}_{name}_{unit} = {_numbers(values)}")
    if reference:
        values = [reference.get(joint, REFERENCE_DEGC) for joint in range(robot.n_dof)]
        lines.append(f"reference_degc = {_numbers(values)}")
    return lines


def _drive(robot: Robot, joint: int, kind: str) -> list[str]:
    """Return the lines of a joint's actuator and of the softness of its friction."""
    lines = []
    actuator = robot.actuators[joint] if joint < len(robot.actuators) else None
    if actuator is not None:
        values = {"kp": actuator.kp, "kv": actuator.kv, LIMIT_KEYS[kind][2]: actuator.effort}
        values["lag_s"] = actuator.lag_s or None
        own = [f"{key} = {_number(value)}" for key, value in values.items() if value is not None]
        lines.append(f"actuator = {{ {', '.join(own)} }}" if own else "actuator = {}")
    if joint < len(robot.softness) and robot.softness[joint] != SOFTNESS:
        lines.append(f"softness_s = {_numbers(robot.softness[joint])}")
    return lines


def _limits(limits: JointLimits, kind: str) -> list[str]:
    given = zip(LIMIT_KEYS[kind], (limits.position, limits.velocity, limits.effort), strict=True)
    return [
        f"{key} = {_numbers(value) if isinstance(value, tuple) else _number(value)}"
        for key, value in given
        if value is not None
    ]


def _urdf(places: Correspondence) -> list[str]:
    lines = [
        "",
        "# How frames and names go back to the URDF; `didim export` reads it.",
        "[urdf]",
        *(f"{key} = {quoted(getattr(places, key))}" for key in ("file", "sha256", "base", "tip")),
    ]
    if places.lock:
        pairs = ", ".join(f"{toml_key(name)} = {_number(value)}" for name, value in places.lock)
        lines.append(f"lock = {{ {pairs} }}")
    if places.snapped_rad:
        lines.append(f"snapped_rad = {_number(places.snapped_rad)}")
    lines.append(f"frame_0 = {_pose(places.frame_0)} # frame 0 in the base link, m")
    for link in places.links:
        lines += ["", "[[urdf.link]]", f"joint = {quoted(link.joint)}", f"link = {quoted(link.link)}"]
        lines.append(f"pose = {_pose(link.pose)} # of the link in frame j, m")
        others = {"lumped": list(link.lumped), "locked": list(link.locked)}
        lines += [f"{key} = {quoted(names)}" for key, names in others.items() if names]
    return lines


def _angle(name: str, angle: float) -> str:
    """Right angles in degrees, which read back exactly, others in radians."""
    degrees = math.degrees(angle)
    if degrees % 90.0 == 0.0 and math.radians(degrees) == angle:
        return f"{name}_deg = {_number(degrees)}"
    return f"{name}_rad = {_number(angle)}"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _numbers(values: Iterable[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _matrix(rows: Sequence[Sequence[float]]) -> str:
    return "[\n" + "".join(f"    {_numbers(row)},\n" for row in rows) + "]"


def _pose(rows: Pose) -> str:
    return f"[{', '.join(map(_numbers, rows))}]"
