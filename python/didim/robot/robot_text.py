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
from .right_angles import RIGHT_ANGLE_ROUNDING, SNAP, nearest_right_angle
from .robot import LIMIT_KEYS, JointLimits, Robot
from .transmission import SOFTNESS, Follower


def robot_text(robot: Robot) -> str:
    """Return the content of a robot file.

    Parameters
    ----------
    robot : Robot
        Any robot.
    """
    geometry = robot.geometry
    lines = [f"# {one_line(note)}" for note in robot.notes]
    lines += ["schema = 1", *_keys(name=robot.name, description=robot.description)]
    lines += _keys(convention="mdh" if robot.standard is None else "dh", gravity_m_s2=geometry.gravity)
    if robot.cut:
        lines.append(f"cut = {quoted(list(robot.cut))} # closed loops that this tree does not have")
    if _snaps(robot):
        lines.append("snap_rad = 0.0 # angles are kept as they are")
    for j, kind in enumerate(geometry.kinds):
        name = robot.all_joint_names[j] if robot.joint_names else None
        lines += ["", "[[joint]]", *_keys(name=name, kind=kind), *_row(robot, j)]
        limits = _limits(robot.limits[j], kind) if j < robot.n_dof else []
        if limits:
            lines.append(f"limits = {{ {', '.join(limits)} }}")
        lines += _drive(robot, j, kind)
    lines += _couplings(geometry.followers, geometry.kinds) + _transmission(robot) + _friction(robot)
    for capsule in robot.collision:
        lines += ["", "[[collision]]", f"link = {capsule.link}"]
        lines += _keys(from_m=capsule.start, to_m=capsule.end, radius_m=capsule.radius)
    for name, values in robot._named.items():
        lines += ["", f"[parameters.{toml_key(name)}]"]
        lines += _keys(frames="own" if name in robot._own else None)
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


def _row(robot: Robot, joint: int) -> list[str]:
    """Return the lines of a joint's frame: its mount, if that differs from a chain's, and its row."""
    geometry, standard = robot.geometry, robot.standard
    lines = []
    if geometry.mounts:
        mount = geometry.mounts[joint]
        if mount.parent != (joint - 1 if joint else None):
            lines.append(f"antecedent = {0 if mount.parent is None else mount.parent + 1}")
        lines += [_angle("gamma", mount.gamma)] if mount.gamma else []
        # Copied placements all have a shift; it prevents their angles from being snapped.
        copied = any(any(other.shift) for other in geometry.mounts)
        lines += _keys(b_m=mount.b or None, shift_m=mount.shift if copied else None)
    theta = _angle("theta", geometry.theta[joint])
    if standard is None:
        alpha, d = _angle("alpha", geometry.alpha[joint]), geometry.d[joint]
        return [*lines, alpha, *_keys(d_m=d), theta, *_keys(r_m=geometry.r[joint])]
    alpha, a = _angle("alpha", standard.alpha[joint]), standard.a[joint]
    return [*lines, *_keys(a_m=a), alpha, *_keys(d_m=geometry.r[joint]), theta]


def _couplings(followers: Sequence[Follower], kinds: Sequence[str]) -> list[str]:
    """Return the lines of the tables ``[[coupling]]``."""
    lines: list[str] = []
    for joint, follower in enumerate(followers, start=len(kinds) - len(followers)):
        leaders, factors = zip(*follower.leaders, strict=True)
        lines += [
            "",
            "[[coupling]]",
            f"joint = {joint + 1}",
            f"follows = {[leader + 1 for leader in leaders]}",
        ]
        offset = "offset_rad" if kinds[joint] == "revolute" else "offset_m"
        lines += _keys(factors=factors, **{offset: follower.offset})
    return lines


def _transmission(robot: Robot) -> list[str]:
    n = robot.n_dof
    identity = tuple(tuple(float(i == j) for j in range(n)) for i in range(n))
    coupling = robot.geometry.coupling
    matrices = {"coupling": None if coupling == identity else coupling, "reduction": robot.reduction}
    lines = [f"{key} = {_matrix(rows)}" for key, rows in matrices.items() if rows is not None]
    lines += _keys(drive_gains=robot.gains)
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
                lines += _keys(**{f"{key}_{unit}": values})
    lines += _further_friction(robot)
    own = [line for term in friction.of("table") for line in _own_law(robot, term)]
    return [*(["", "[friction]", *lines] if lines else []), *own, *_springs(robot)]


def _springs(robot: Robot) -> list[str]:
    lines = []
    for key, laws in SPRINGS.items():
        joints = [term.joint + 1 for term in robot.friction.of(laws[0])]
        lines += [f"{key} = {joints}"] if joints else []
    for term in robot.friction.of(CYLINDER[0]):
        a, b, phi, rest = term.values
        lines += ["", "[[springs.cylinder]]", f"joint = {term.joint + 1}"]
        lines += _keys(a_m=a, b_m=b, phi_deg=math.degrees(phi), rest_m=rest)
    return ["", "[springs]", *lines] if lines else []


def _own_law(robot: Robot, term: FrictionTerm) -> list[str]:
    """Lines of a user-defined law, as a table of values."""
    unit = "rad_s" if robot.joint_kinds[term.joint] == "revolute" else "m_s"
    speeds = {f"first_{unit}": term.first, f"step_{unit}": term.step}
    head = ["", "[[friction.law]]", *_keys(name=term.name), f"joints = [{term.joint + 1}]"]
    return [*head, *_keys(**speeds, values=term.values)]


def _further_friction(robot: Robot) -> list[str]:
    """Further terms, law by law, with the joints that have them."""
    friction = robot.friction
    lines = ['terms = "auto"'] if friction.auto else []
    reference: dict[int, float] = {}
    for law, key in KEYS.items():
        terms = friction.of(law)
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
        effort = {LIMIT_KEYS[kind][2]: actuator.effort}
        own = _keys(kp=actuator.kp, kv=actuator.kv, **effort, lag_s=actuator.lag_s or None)
        lines.append(f"actuator = {{ {', '.join(own)} }}" if own else "actuator = {}")
    if joint < len(robot.softness) and robot.softness[joint] != SOFTNESS:
        lines += _keys(softness_s=robot.softness[joint])
    return lines


def _limits(limits: JointLimits, kind: str) -> list[str]:
    given = (limits.position, limits.velocity, limits.effort)
    return _keys(**dict(zip(LIMIT_KEYS[kind], given, strict=True)))


def _urdf(places: Correspondence) -> list[str]:
    lines = ["", "# How frames and names go back to the URDF; `didim export` reads it.", "[urdf]"]
    lines += _keys(**{key: getattr(places, key) for key in ("file", "sha256", "base", "tip")})
    if places.lock:
        pairs = ", ".join(f"{toml_key(name)} = {_number(value)}" for name, value in places.lock)
        lines.append(f"lock = {{ {pairs} }}")
    lines += _keys(snapped_rad=places.snapped_rad or None)
    lines.append(f"frame_0 = {_pose(places.frame_0)} # frame 0 in the base link, m")
    for link in places.links:
        lines += ["", "[[urdf.link]]", *_keys(joint=link.joint, link=link.link)]
        lines.append(f"pose = {_pose(link.pose)} # of the link in frame j, m")
        others = {"lumped": list(link.lumped), "locked": list(link.locked)}
        lines += [f"{key} = {quoted(names)}" for key, names in others.items() if names]
    return lines


def _keys(**values: str | float | Sequence[float] | None) -> list[str]:
    """Return a line per key with a value."""
    return [f"{key} = {_value(value)}" for key, value in values.items() if value is not None]


def _value(value: str | float | Sequence[float]) -> str:
    if isinstance(value, str):
        return quoted(value)
    return _number(value) if isinstance(value, float | int) else _numbers(value)


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


def _matrix(rows: Iterable[Iterable[float]]) -> str:
    return "[\n" + "".join(f"    {_numbers(row)},\n" for row in rows) + "]"


def _pose(rows: Pose) -> str:
    return f"[{', '.join(map(_numbers, rows))}]"
