"""The drives of a result: rotor inertia, friction, gains, limit and delay of each joint, as simulators take them.

A simulator with steps of h replaces accelerations and velocities by differences. Where it takes damping implicitly, the force of a
step from t to t + h has the velocity of its end. So it moves like a robot with ``Ia + h D / 2``, D the damping, and commands act
half a step early. `for_step` takes both off. Tested in ``tests/test_export_drives.py`` by MuJoCo.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .._tools.words import brief, columned, did_you_mean, series
from ..errors import FitError
from ..experiment.unknown import SOFT
from ..methods.positions.intervals import HALF
from ..result.identification import Identification
from ..result.samples import Samples
from ..robot.friction import Friction
from .bodies import WORDS, ExportModel, joint_friction, lost_friction

IMPLICIT = ("implicit", "implicitfast")
"""Integrators of MuJoCo that also treat the damping of actuators implicitly."""
MOST_SHIFT = 1.0
"""Largest shift of commands (rad or m): real servos have a hundredth of it, and beyond it gain or offset is false."""

FIELDS = {
    "Ia": "rotor",
    "Fv": "viscous",
    "Fc": "coulomb",
    "kp": "kp",
    "kv": "kv",
    "saturation": "effort",
    "delay_s": "delay_s",
}
"""Fields of a drive by the kind of an unknown."""
STUCK_CREEP_S = 5e-6
"""Creep (s) of MuJoCo's friction where that of a result sticks: joints of 0.03 kg.m^2 creep by 0.1 mrad/s under half of 1 N.m."""


@dataclass(frozen=True, kw_only=True)
class JointDrive:
    """The drive of one joint, joint side, SI units.

    Attributes
    ----------
    joint, kind : str
        Name, and ``revolute`` or ``prismatic``.
    rotor, viscous, coulomb : float
        ``Ia``, ``Fv`` and ``Fc``.
    kp, kv : float or None
        Gains of the position servo; None where the result has none.
    effort : float or None
        Largest torque or force of the servo; None without a limit.
    delay_s, lag_s : float
        Delay of commands, and time constant of a first-order lag after it (s).
    acceleration : float
        Largest acceleration (rad/s^2 or m/s^2) of the set-point that follows the commands.
    stiffness, rest : float
        Spring of the joint, ``Ks`` (N.m/rad or N/m), and the position (rad or m) at which it has no torque.
    offset : float
        ``Off`` (N.m or N), a constant torque on the joint; zero with a spring, whose `rest` contains it.
    bias_rad : float
        Encoder reading less joint position (rad or m).
    smoothing : float
        Velocity below which the result's friction is smooth (rad/s or m/s); zero where it is MuJoCo's.
    softness : (float, float) or None
        Creep and rest (s) of MuJoCo's friction, `didim.robot.transmission.softness`; None for another law.
    per_step : mapping of str to float
        Changes of these fields with the step of a simulator that takes kv implicitly, beyond that of the rotor (per second).
    """

    joint: str
    kind: str
    rotor: float
    viscous: float
    coulomb: float
    kp: float | None = None
    kv: float | None = None
    effort: float | None = None
    delay_s: float = 0.0
    lag_s: float = 0.0
    acceleration: float = math.inf
    stiffness: float = 0.0
    rest: float = 0.0
    offset: float = 0.0
    bias_rad: float = 0.0
    smoothing: float = 0.0
    softness: tuple[float, float] | None = None
    per_step: Mapping[str, float] = field(default_factory=dict)

    @property
    def shift(self) -> float:
        """Return the shift of commands (rad or m) that replaces offset and bias."""
        return self.bias_rad + (self.offset / self.kp if self.kp else 0.0)

    @property
    def overloaded(self) -> bool:
        """Whether the offset is beyond what commands can replace: it would turn the joint by more than `MOST_SHIFT`."""
        return abs(self.shift) > MOST_SHIFT


@dataclass(frozen=True)
class Drives:
    """The drives of a result, and sentences on omitted properties.

    Attributes
    ----------
    joints : tuple of JointDrive
        In the order of the robot's joints.
    sentences : tuple of str
        Sentences on parameters that the format cannot represent, on values that the log does not identify, and on steps.
    followers : tuple of JointDrive
        Coupled joints: their own rotor inertia and friction. Their springs are part of those of their leaders.
    """

    joints: tuple[JointDrive, ...]
    sentences: tuple[str, ...] = ()
    followers: tuple[JointDrive, ...] = ()

    @property
    def every(self) -> tuple[JointDrive, ...]:
        """All drives, those of coupled joints last."""
        return (*self.joints, *self.followers)

    def check_joints(self, known: Collection[str], where: str) -> None:
        """Refuse drives of joints that a file has not."""
        for drive in self.every:
            if drive.joint not in known:
                hint = did_you_mean(drive.joint, known)
                raise FitError(f"{where}: there is no joint {drive.joint!r}{hint}")

    def plain_servos(self) -> Drives:
        """Return the same drives for a format without springs and filters of commands, with sentences on those left out."""
        springs = [f"{drive.joint} {drive.stiffness:.4g}" for drive in self.joints if drive.stiffness]
        lags = [f"{drive.joint} {1e3 * drive.lag_s:.4g}" for drive in self.joints if drive.lag_s]
        told = [
            f"the format has no place for {what}: {series(names)}"
            for what, names in (("springs (N.m/rad or N/m)", springs), ("lags of commands (ms)", lags))
            if names
        ]
        return replace(self, sentences=(*self.sentences, *told)) if told else self

    def __str__(self) -> str:
        rows: list[tuple[str, ...]] = [
            ("joint", "armature", "damping", "frictionloss", "kp", "kv", "limit", "add to command")
        ]
        for drive in self.joints:
            shift = 0.0 - 1e3 * drive.shift if drive.kp and not drive.overloaded else None
            numbers = (drive.rotor, drive.viscous, drive.coulomb, drive.kp, drive.kv, drive.effort, shift)
            rows.append((drive.joint, *("-" if value is None else f"{value:.4g}" for value in numbers)))
        if not any(drive.shift and drive.kp and not drive.overloaded for drive in self.joints):
            rows = [row[:-1] for row in rows]
        return "\n".join([*columned(rows), *([""] if self.sentences else []), *self.sentences])


def drives_of(fit: Identification, where: str) -> Drives:
    """Return the drives of a result.

    Parameters
    ----------
    fit : Identification
        The result; one on positions also has gains, limit and delay.
    where : str
        Name of its file, the prefix of messages.

    Raises
    ------
    FitError
        When the robot's joints have no names, or a rotor inertia or friction is negative.
    """
    robot = fit.robot_record
    names = tuple(robot.get("joint_names") or ())
    n = len(names)
    if not names:
        raise FitError(f"{where}: its robot has no names of joints, by which other files have them")
    values = dict(zip(fit.parameter_names, fit.parameters.tolist(), strict=True))
    positions = fit.settings.get("positions") or {}
    servo: Mapping[str, Sequence[float | None]] = positions.get("drive", {})
    friction = robot.get("friction", {})
    smoothing = () if positions.get("soft") else friction.get("smoothing") or ()
    terms = Friction.terms_of(friction.get("terms", ()))
    drives, missed = [], {}
    names += tuple(follower["name"] for follower in robot["geometry"].get("followers", ()))
    for j, (name, kind) in enumerate(zip(names, robot["geometry"]["kinds"], strict=True)):
        viscous, coulomb, missed[name] = joint_friction(values, j, terms, kind)
        rotor, offset = values[f"Ia{j + 1}"], values.get(f"Off{j + 1}", 0.0)
        stiffness = values.get(f"Ks{j + 1}", 0.0)
        for word, value in zip(WORDS.values(), (rotor, viscous, coulomb, stiffness), strict=True):
            if value < 0.0:
                raise FitError(
                    f"{where}: the {word} of joint {name!r} is negative ({value:.4g}): no drive has that"
                )
        given = {key: column[j] for key, column in servo.items() if j < n}
        soft = bool(positions.get("soft") or positions.get("sticks"))
        creep, rest = given.get(SOFT[0]), given.get(SOFT[1])
        creep = STUCK_CREEP_S if positions.get("sticks") else creep
        drives.append(
            JointDrive(
                joint=name,
                kind=kind,
                rotor=rotor,
                viscous=viscous,
                coulomb=coulomb,
                kp=given.get("kp"),
                kv=given.get("kv"),
                effort=given.get("saturation"),
                delay_s=given.get("delay_s") or 0.0,
                lag_s=given.get("lag_s") or 0.0,
                acceleration=given.get("acceleration") or math.inf,
                stiffness=stiffness,
                rest=-offset / stiffness if stiffness else 0.0,
                offset=0.0 if stiffness else offset,
                bias_rad=given.get("bias_rad") or 0.0,
                smoothing=float(smoothing[j]) if j < len(smoothing) else 0.0,
                softness=(creep, rest) if creep and rest and soft else None,
                per_step={
                    FIELDS[row["kind"]]: row["per_step"]
                    for row in positions.get("rows", ())
                    if row["kind"] in FIELDS and j + 1 in row["joints"] and row.get("per_step")
                },
            )
        )
    driven, followers = tuple(drives[:n]), tuple(drives[n:])
    return Drives(driven, (*lost_friction(values, terms, missed), *_sentences(driven)), followers)


def drives_of_links(model: ExportModel) -> Drives:
    """Return the drives of a robot arranged for a file, without what motors of several joints add to those of each, (24)."""
    own = zip(*(model.own_share(key).tolist() for key in ("rotor", "viscous", "coulomb")), strict=True)
    drives = [
        JointDrive(
            joint=link.joint,
            kind=link.kind,
            rotor=rotor,
            viscous=viscous,
            coulomb=coulomb,
            stiffness=link.stiffness,
            rest=link.rest,
        )
        for link, (rotor, viscous, coulomb) in zip(model.links, own, strict=True)
    ]
    n = sum(link.follower is None for link in model.links)
    return Drives(tuple(drives[:n]), model.left_out, tuple(drives[n:]))


def _sentences(joints: Sequence[JointDrive]) -> list[str]:
    sentences = []
    offsets = [drive for drive in joints if drive.offset or drive.bias_rad]
    if false := [drive.joint for drive in joints if drive.overloaded]:
        sentences.append(
            f"offsets of {brief(series(false), 60)} are larger than any command can replace: gain or offset is false"
        )
    if offsets and all(drive.kp for drive in offsets):
        sentences.append(
            "offsets have no place in the file: add the last column (mrad or mm) to the commands"
        )
    elif offsets:
        names = series(drive.joint for drive in offsets)
        sentences.append(f"torque offsets of {names} are left out: no format can represent them")
    if (delay := max(drive.delay_s for drive in joints)) > 0.0:
        sentences.append(
            f"commands act {1e3 * delay:.4g} ms late: hold them back by as much in the simulation"
        )
    elif delay < 0.0:
        sentences.append(f"positions are read {-1e3 * delay:.4g} ms after commands act, which no file has")
    if limits := [drive.acceleration for drive in joints if drive.acceleration < math.inf]:
        least, most = min(limits), max(limits)
        text = f"{most:.4g}" if least == most else f"{least:.4g} to {most:.4g}"
        sentences.append(
            f"set-points accelerate by at most {text} rad/s^2: no file has this, so plan the commands of fast motions"
        )
    return sentences


def for_step(drives: Drives, step_s: float, integrator: str, *, explicit_kv: bool = False) -> Drives:
    """Return drives that compensate for a simulator's integration step.

    Parameters
    ----------
    drives : Drives
        Drives of the result, a continuous model.
    step_s : float
        Step of the simulator (s).
    integrator : {"Euler", "implicit", "implicitfast", "RK4"}
        Integrator of MuJoCo. Euler treats the damping of joints implicitly and that of actuators explicitly; RK4 needs no
        compensation.
    explicit_kv : bool
        Whether the velocity gain is applied outside the integrator, as torque of a motor.

    Returns
    -------
    Drives
        Rotor inertias less ``h (Fv + kv) / 2``, or ``h (Fv - kv) / 2`` for an explicit kv, and delays longer by h / 2.

    Raises
    ------
    FitError
        When a rotor inertia would be negative: the step is too long for the damping.
    """
    if integrator == "RK4":
        return drives
    sign = 1.0 if integrator in IMPLICIT and not explicit_kv else -1.0
    shifted, largest = [], 0.0
    for drive in drives.joints:
        shift = HALF * step_s * (drive.viscous + sign * (drive.kv or 0.0))
        changed = {
            name: getattr(drive, name) + sign * step_s * change
            for name, change in drive.per_step.items()
            if getattr(drive, name) is not None
        }
        drive = replace(drive, **changed)
        if drive.rotor < shift:
            raise FitError(
                f"joint {drive.joint!r}: a step of {step_s:g} s adds {shift:.4g} to its rotor inertia of {drive.rotor:.4g}; "
                "take a shorter step"
            )
        largest = max(largest, abs(shift) / drive.rotor if drive.rotor else 0.0)
        shifted.append(replace(drive, rotor=drive.rotor - shift, delay_s=drive.delay_s + HALF * step_s))
    damping = "(Fv + kv)" if sign > 0.0 else "(Fv - kv)"
    sentence = (
        f"for steps of {1e3 * step_s:g} ms with {integrator}: armature less h {damping} / 2, by {100.0 * largest:.2g} % at most; "
        f"commands act {1e3 * HALF * step_s:g} ms early, so hold them back by {1e3 * shifted[0].delay_s:.4g} ms in all"
    )
    if shifted[0].kp is not None:
        extra = max((drive.kp or 0.0) * HALF * step_s for drive in shifted)
        sentence += f" (or add h kp / 2, up to {extra:.3g}, to kv for slow motion)"
    if any(drive.per_step for drive in drives.joints):
        sentence += "; other values change too, as the armature does not while servos saturate"
    return Drives(tuple(shifted), (*drives.sentences, sentence), drives.followers)


def samples_for_step(samples: Samples, drives: Drives, step_s: float) -> Samples:
    """Return samples that compensate for a step (s) of the integrator ``implicitfast``, draw by draw as `for_step` does for drives.

    `drives` are those of the result: what was not estimated. An armature is zero where a step takes more than it off.
    """
    places = {(kind, joint): k for k, kind in enumerate(samples.kinds) for joint in samples.joints[k]}
    x = np.vstack([samples.estimate, samples.values])
    moved = x.copy()
    for drive in drives.joints:
        damping = sum(
            x[:, places[kind, drive.joint]]
            if (kind, drive.joint) in places
            else getattr(drive, FIELDS[kind]) or 0.0
            for kind in ("Fv", "kv")
        )
        if (k := places.get(("Ia", drive.joint))) is not None:
            moved[:, k] = np.maximum(x[:, k] - HALF * step_s * damping, 0.0)
    for k, kind in enumerate(samples.kinds):
        own = [
            drive.per_step.get(FIELDS.get(kind, ""), 0.0)
            for drive in drives.joints
            if drive.joint in samples.joints[k]
        ]
        change = own[0] if own else 0.0
        moved[:, k] += step_s * (HALF if kind == "delay_s" else change)
    return replace(samples, estimate=moved[0], values=moved[1:])


def read_drives(path: Path) -> Drives:
    """Return the drives of a result's file, with sentences of its verdict; errors as of `drives_of`."""
    fit = Identification.load(path)
    drives = drives_of(fit, path.name)
    if fit.verdict.sound:
        return drives
    return replace(drives, sentences=(f"{path.name}: {fit.verdict.sentence}", *drives.sentences))
