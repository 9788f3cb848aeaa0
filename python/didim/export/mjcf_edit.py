"""A result in the user's MJCF: attributes of joints, tendons and actuators, and ``<inertial>``; no other byte changes.

A joint gets ``armature``, ``damping``, ``frictionloss``, ``stiffness`` and ``springref``, and ``solreffriction`` and
``solimpfriction`` where a result on positions has another softness than the file. Its position actuator gets ``kp``, ``kv``,
``forcerange`` and, where the result has another lag, ``timeconst``; a general one ``gainprm`` and ``biasprm``. Values already in
the file, also by a default class, do not change. The spring of a coupled joint is part of its leader's, so its own element loses
it. What tendons of one joint add stays theirs. A body gets mass, centre and inertia of all that moves with it, less those of the
bodies fixed to it, which keep theirs if they can. A link is placed by the axis of its joint at position zero, so that robot and
file may have other frames. An included file that changes stands in the place of its include. Tested in
``tests/test_export_drives.py``, ``tests/test_export_links.py``, ``tests/test_softness.py`` and ``tests/test_couplings.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.words import listing, series
from ..errors import FitError
from ..model.dynamics import inertia_matrix
from ..robot.rigid_body import central, inverse, why_no_body
from ..robot.robot import Robot
from ..robot.robot_file import load_robot
from ..robot.transmission import LARGEST_IMPEDANCE, Actuator
from ..robot.urdf.chain import WHOLE, Chain, Member, choose_chain
from ..robot.urdf.mechanism import MOVING
from ..robot.urdf.mjcf import LEAST_IMPEDANCE
from ..robot.urdf.mjcf_elements import MjcfElements, Setting, mjcf_elements
from ..robot.urdf.reading import LARGEST_DIFFERENCE, MJCF_SET, own_gravity
from ..robot.urdf.tendons import POWERS, Shares, shares_of
from ..robot.urdf.xml_spans import Edit, Element, attribute_edit, attributes_out, edited, first_child
from .bodies import WORDS, CoupledMotor, ExportModel
from .drives import Drives, JointDrive, drives_of_links, for_step
from .numbers import inertial, number, numbers, xml

DRIVE = ("rotor", "viscous", "coulomb")
"""Fields of a drive that tendons have too."""


def why_other(path: Path, links: ExportModel) -> str | None:
    """Return why a robot is another mechanism than that of an MJCF, as the end of a sentence, or None if it is the same."""
    return misfit(*_chain(mjcf_elements(path, FitError), [link.joint for link in links.links], links), links)


def edit_mjcf(
    result: Drives | ExportModel, path: Path, *, step_s: float | None = None
) -> tuple[bytes, Drives]:
    """Write drives, or links with their drives, into an MJCF.

    Parameters
    ----------
    result : Drives or ExportModel
        Drives of a result, or the robot of the file, see `why_other`, with links and drives.
    path : Path
        The MJCF; joints are matched by name.
    step_s : float, optional
        Step of the simulation, for which the values are compensated.

    Returns
    -------
    bytes, Drives
        Content of the new file, and its drives with sentences on compensation and omissions.

    Raises
    ------
    FitError
        When a joint or body is not in the file or has no element of its own, a drive is less than the share of tendons in it, or
        a link is not a body.
    RobotError
        When the file cannot be read.
    """
    elements = mjcf_elements(path, FitError)
    links = result if isinstance(result, ExportModel) else None
    drives = drives_of_links(result) if isinstance(result, ExportModel) else result
    drives.check_joints(elements.joints, path.name)
    chain, shares = _chain(elements, [drive.joint for drive in drives.every], links)
    settings = elements.settings(chain, shares)
    old = dict(zip([joint.name for joint in chain.driven], shares.actuators, strict=True))
    where = elements.description.where
    for drive in drives.every:
        if drive.joint not in elements.elements:
            raise FitError(
                f"{where}: joint {drive.joint!r} has no element of its own, as a <replicate> or <attach> made it"
            )
    motors = [
        drive.joint
        for drive in drives.joints
        if drive.kp is not None and (drive.joint not in settings or not settings[drive.joint][1].is_position)
    ]
    if step_s is not None:
        drives = for_step(drives, step_s, elements.integrator, explicit_kv=bool(motors))
    sentences = list(drives.sentences)
    if motors:
        sentences.append(
            f"{listing(motors, 60)} of {path.name} have no position actuator: compute kp (command - q) - kv dq in your own code"
        )
        if lag := max(drive.lag_s for drive in drives.joints):
            sentences.append(
                f"their commands act behind a lag of {1e3 * lag:.3g} ms: filter them in your own code too"
            )
    sentences += softness(drives, path, elements, step_s or 0.0)
    edits: list[Edit] = []
    if links is not None:
        edits, told = link_edits(elements, chain, links)
        sentences += told
        for motor in links.motors:
            edits += _tendon_edits(elements, shares, motor)
    for drive in drives.every:
        edits += _joint_edits(elements, _alone(drive, elements, chain, motors=links is None))
        if drive.joint in settings and drive.kp is not None:
            edits += _actuator_edits(*settings[drive.joint], old[drive.joint], drive)
    content = edited(elements.outermost, edits)
    return content, replace(drives, sentences=tuple(sentences))


def _chain(
    elements: MjcfElements, joints: Collection[str], links: ExportModel | None
) -> tuple[Chain, Shares]:
    """Return the chain of a file with these joints and its shares; others are locked where those of the links were.

    Without links, joints that follow others do so.
    """
    description, lock = elements.description, {} if links is None else links.lock
    base = None if links is None or links.base not in description.links else links.base
    others = {
        joint.name: lock.get(joint.name, 0.0)
        for joint in description.joints.values()
        if joint.kind in MOVING and joint.name not in joints and (links is not None or joint.mimic is None)
    }
    chain = choose_chain(description, base=base, tip=WHOLE, lock=others).numbered()
    return chain, shares_of(chain, description.tendons)


def _alone(drive: JointDrive, elements: MjcfElements, chain: Chain, *, motors: bool) -> JointDrive:
    """Return a drive without what tendons of the file add to it: those of one joint, and with `motors` those of several."""
    names = [joint.name for joint in chain.driven]
    if drive.joint not in names:
        return drive
    tendons = elements.description.tendons
    j, shares, own = names.index(drive.joint), shares_of(chain, tendons), shares_of(chain, ()).springs
    taken = shares.drives[:, j].copy()
    for motor, share in shares.motors.items() if motors else ():
        taken[:2] += share[:2] * shares.coupling[motor, j] ** 2
        taken[2] += share[2] * (motor == j)
    stiffness, torque = np.subtract(shares.springs.get(j, (0.0, 0.0)), own.get(j, (0.0, 0.0))).tolist()
    less = dict(zip(DRIVE, taken.tolist(), strict=True)) | (
        {"stiffness": stiffness} if drive.stiffness else {}
    )
    left = {key: getattr(drive, key) - share for key, share in less.items()}
    for key, value in left.items():
        if value < -SAME * getattr(drive, key):
            raise FitError(
                f"{WORDS[key]} of joint {drive.joint!r} without that of its tendons is {value:.4g}; make theirs smaller"
            )
    drive = replace(drive, **{key: max(value, 0.0) for key, value in left.items()})
    if not drive.stiffness:
        return drive
    return replace(drive, rest=((drive.stiffness + stiffness) * drive.rest + torque) / drive.stiffness)


def _tendon_edits(elements: MjcfElements, shares: Shares, motor: CoupledMotor) -> list[Edit]:
    """Return the changes of the tendon that is a motor of several joints."""
    name, arm = shares.sources[motor.number]
    tendons = elements.named("tendon")
    if name not in tendons:
        raise FitError(
            f"{elements.description.where}: {name!r} turns several joints, and is no tendon with an element of its own"
        )
    values = dict(
        zip(("armature", "damping", "frictionloss"), (getattr(motor, key) for key in DRIVE), strict=True)
    )
    old = dict(zip(values, shares.motors[motor.number], strict=True))
    return [
        attribute_edit(tendons[name], key, number(value / arm**power))
        for (key, value), power in zip(values.items(), POWERS, strict=True)
        if not _same(old[key], value)
    ]


def _joint_edits(elements: MjcfElements, drive: JointDrive) -> list[Edit]:
    old = elements.joints[drive.joint]
    values = {"armature": (old.armature, drive.rotor), "damping": (old.damping, drive.viscous)}
    values |= {"frictionloss": (old.friction, drive.coulomb), "stiffness": (old.stiffness, drive.stiffness)}
    if drive.stiffness:
        turns = old.kind == "revolute"
        values["springref"] = (elements.written(old.rest, turns), elements.written(drive.rest, turns))
    element = elements.elements[drive.joint]
    edits = [
        attribute_edit(element, key, number(new))
        for key, (before, new) in values.items()
        if not _same(before, new)
    ]
    new = drive.softness
    if new is not None and not (_same(old.softness[0], new[0]) and _same(old.softness[1], new[1])):
        creep, rest = new
        least = min(max(rest / (rest + creep), LEAST_IMPEDANCE), 1.0 - LEAST_IMPEDANCE)
        edits += [
            attribute_edit(element, "solreffriction", numbers([2.0 * rest / LARGEST_IMPEDANCE, 1.0])),
            attribute_edit(element, "solimpfriction", numbers([least, LARGEST_IMPEDANCE])),
        ]
    return edits


def _actuator_edits(
    element: Element, setting: Setting, old: Actuator | None, drive: JointDrive
) -> list[Edit]:
    if not setting.is_position or drive.kp is None or old is None:
        return []
    kp, kv = drive.kp / setting.gear**2, (drive.kv or 0.0) / setting.gear**2
    edits = []
    same_kp = _same(old.kp or 0.0, drive.kp)
    # MuJoCo would compute the gain anew of a damping ratio and the new inertias.
    same_kv = _same(old.kv or 0.0, drive.kv or 0.0) and not setting.ratio
    if setting.tag == "position":
        edits += [] if same_kp else [attribute_edit(element, "kp", number(kp))]
        edits += [] if same_kv else [attribute_edit(element, "kv", number(kv), "dampratio")]
    elif not (same_kp and same_kv):
        edits += [
            attribute_edit(element, "gainprm", number(kp * setting.servo.slope)),
            attribute_edit(element, "biasprm", numbers([kp * setting.servo.offset, -kp, -kv])),
        ]
    if not _same(old.lag_s, drive.lag_s):
        lag = {"timeconst": number(drive.lag_s)}
        if setting.tag != "position":
            lag = (
                {"dyntype": "filterexact", "dynprm": number(drive.lag_s)}
                if drive.lag_s
                else {"dyntype": "none"}
            )
        edits += [attribute_edit(element, key, value) for key, value in lag.items()]
    if drive.effort is not None and not _same(old.effort or 0.0, drive.effort):
        force = drive.effort / setting.gear
        edits.append(attribute_edit(element, "forcerange", numbers([-force, force])))
    return edits


def _same(before: float, new: float) -> bool:
    return abs(before - new) <= SAME * max(abs(before), abs(new))


def softness(drives: Drives, path: Path, elements: MjcfElements, step_s: float) -> list[str]:
    """Return a sentence that compares the speed below which MuJoCo's friction loss is viscous with the result's smoothing.

    ``frictionloss`` is a soft constraint: below ``Fc A (1 - d) / d dmax timeconst / 2``, A the joint's own entry of the inverse
    inertia matrix, its force is proportional to the speed. The time constant is at least two steps.
    """
    robot = load_robot(path)
    if MJCF_SET not in robot.sets:
        return []
    inverse = _inverse_inertia(robot, drives)
    speeds = []
    for drive in drives.joints:
        creep, rest = drive.softness or elements.joints[drive.joint].softness
        creep *= max(1.0, LARGEST_IMPEDANCE * step_s / rest)
        speeds.append(drive.coulomb * inverse.get(drive.joint, 0.0) * creep)
    if not any(speeds):
        return []
    own = max(drive.smoothing for drive in drives.joints)
    beside = f"; the result's is smooth below {own:.2g}" if own else ""
    return [
        f"MuJoCo's frictionloss is viscous below {min(speeds):.2g} to {max(speeds):.2g} rad/s (m/s){beside}"
    ]


def _inverse_inertia(robot: Robot, drives: Drives) -> Mapping[str, float]:
    """Diagonal of the inverse inertia matrix at position zero with the new armatures, by name of the joint."""
    rotors = {drive.joint: drive.rotor for drive in drives.joints}
    x: Array = robot.parameter_set(MJCF_SET).copy()
    for j, name in enumerate(robot.joint_names):
        x[robot.parameter_names.index(f"Ia{j + 1}")] = rotors.get(name, 0.0)
    matrix = inertia_matrix(robot, np.zeros((1, robot.n_dof)), x)[0]
    return dict(zip(robot.joint_names, np.diag(np.linalg.inv(matrix)).tolist(), strict=True))


SAME = 1e-10
"""Largest relative difference of two equal values, whose digits the file then keeps: frames that are far away cost some."""
TURNED = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
"""Attributes of the orientation of an inertial frame, which ``fullinertia`` does without."""


def misfit(chain: Chain, shares: Shares, links: ExportModel) -> str | None:
    """Return why links are not those of a file's mechanism, as the end of a sentence, or None if they are.

    At position zero, all axes of joints must be the same lines in the base, and coupled joints and motors be coupled alike.
    """
    names = [link.joint for link in links.links]
    missing = sorted(set(names) - set(chain.frames))
    if missing:
        return f"the file has no moving joint {missing[0]!r}"
    theirs, parents = chain.frames, dict(zip((j.name for j in chain.joints), chain.parents, strict=True))
    joints = {joint.name: joint for joint in chain.joints}
    for j, link in enumerate(links.links):
        joint, own, their = joints[link.joint], links.frames[j], theirs[link.joint]
        parent = parents[link.joint]
        above = None if parent is None else chain.joints[parent].name
        if above != (None if link.parent is None else names[link.parent]):
            return f"joint {link.joint!r} stands on another link"
        axis = own[:3, :3] @ link.axis
        apart = np.cross(their[:3, 3] - own[:3, 3], axis) * (link.kind == "revolute")
        turned = their[:3, :3] @ joint.axis - axis
        if (joint.kind == "prismatic") != (link.kind == "prismatic") or not (
            np.abs([apart, turned]).max() <= LARGEST_DIFFERENCE
        ):
            return f"joint {link.joint!r} has another axis at position zero"
        ties = [] if link.follower is None else [(names[at], factor) for at, factor in link.follower.leaders]
        tied = chain.mimics.get(link.joint)
        if [leader for leader, _ in ties] != ([tied[0]] if tied else []) or (
            tied
            and link.follower is not None
            and not np.allclose(tied[1:], (ties[0][1], link.follower.offset), atol=LARGEST_DIFFERENCE)
        ):
            return f"joint {link.joint!r} follows others in another way"
    order = [names.index(joint.name) for joint in chain.driven]
    coupling = np.eye(len(order))
    for motor in links.motors:
        coupling[motor.number] = motor.coefficients
    if not np.allclose(coupling[np.ix_(order, order)], shares.coupling, atol=LARGEST_DIFFERENCE):
        return "its motors are coupled in another way"
    return None


def link_edits(elements: MjcfElements, chain: Chain, links: ExportModel) -> tuple[list[Edit], list[str]]:
    """Return the changes of inertias, unsorted, and sentences on them.

    Raises
    ------
    FitError
        When a body is none without those fixed to it, or has no element.
    """
    groups = {joint.name: group for joint, group in zip(chain.joints, chain.groups, strict=True)}
    pseudos: dict[str, Array] = {}
    for j, link in enumerate(links.links):
        back = inverse(chain.frames[link.joint]) @ links.frames[j]
        pseudos |= _shared(elements, link.joint, groups[link.joint], back @ link.pseudo @ back.T)
    # MuJoCo's compiler is kept from changing the new inertias, or from taking those of geoms.
    heavy = [pseudo for pseudo in pseudos.values() if pseudo.any()]
    lightest = min((pseudo[3, 3] for pseudo in heavy), default=np.inf)
    flattest = min((np.linalg.eigvalsh(central(pseudo)[2])[0] for pseudo in heavy), default=np.inf)
    edits = []
    for compiler in elements.outermost.all("compiler") if heavy else ():
        old = compiler.attributes
        changes = {
            "inertiafromgeom": ("auto", old.get("inertiafromgeom") == "true"),
            "settotalmass": ("-1", float(old.get("settotalmass", "-1")) > 0.0),
            "boundmass": ("0", float(old.get("boundmass", "0")) > lightest),
            "boundinertia": ("0", float(old.get("boundinertia", "0")) > flattest),
        }
        edits += [attribute_edit(compiler, key, value) for key, (value, needed) in changes.items() if needed]
    changed = bool(edits)
    if changed:  # what the compiler made of other bodies stays
        others = {
            name: inertial.pseudo
            for name in elements.bodies
            if (inertial := elements.description.links[name])
        }
        pseudos = others | pseudos
    for name, pseudo in pseudos.items():
        if name not in elements.bodies:
            raise FitError(
                f"{elements.description.where}: body {name!r} has no element of its own, as a <replicate> or <attach> made it"
            )
        edits += _inertial(elements.bodies[name], pseudo)
    made = [
        name
        for name in pseudos
        if changed or (name in elements.bodies and not elements.bodies[name].find("inertial"))
    ]
    told = [f"MuJoCo made the inertia of {series(made, 60)}: an <inertial> replaces it"] if made else []
    down = own_gravity(elements.description, chain)
    if not np.allclose(down, links.gravity, atol=LARGEST_DIFFERENCE * np.abs(down).max()):
        told.append(
            f"gravity of the file stays {numbers(down)} in its base, and that of the result is {numbers(links.gravity)}"
        )
    return edits, told


def _shared(
    elements: MjcfElements, joint: str, group: Sequence[Member], pseudo: Array
) -> Iterator[tuple[str, Array]]:
    """Yield the bodies that change, with their pseudo-inertias, of those that move with a joint."""
    where = elements.description.where
    lost = {member.link for member in group if member.link in elements.description.incomplete}
    other = np.sum([member.pseudo for member in group], axis=0)
    if not lost and bool(np.linalg.norm(pseudo - other) <= SAME * np.linalg.norm(other)):
        return
    bodies = [member for member in group if member.link in elements.reader.bodies]
    if not bodies:
        raise FitError(
            f"{where}: the link behind joint {joint!r} is none of its bodies, and has a mass of {pseudo[3, 3]:.4g} kg"
        )
    first, *others = bodies
    held = [member for member in others if member.link not in lost]
    reason: str | None = None
    # Bodies that are fixed to the first keep their inertia, unless that leaves none for it.
    for kept in (held, [member for member in held if member.locked]):
        rest = pseudo - np.sum([np.zeros((4, 4)), *(member.pseudo for member in kept)], axis=0)
        reason = why_no_body(rest)
        if reason is None:
            back = inverse(first.pose)
            yield first.link, back @ rest @ back.T
            emptied = [member for member in others if member not in kept]
            yield from (
                (each.link, np.zeros((4, 4))) for each in emptied if each.inertial or each.link in lost
            )
            return
    names = series((member.link for member in held if member.locked), 30)
    raise FitError(f"body {first.link!r} is no body without {names or 'others'}: {reason}")


def _inertial(body: Element, pseudo: Array) -> list[Edit]:
    """Return the changes that give a body an inertia; a body without one is empty."""
    values, old = inertial(pseudo), body.find("inertial")
    if old is None:
        return [first_child(body, xml("inertial", **values))]
    (*_, shape), shapes = values, {"fullinertia", "diaginertia"} & set(old.attributes)
    edits = [
        attribute_edit(old, key, value, *(shapes if key == shape else ())) for key, value in values.items()
    ]
    return edits + attributes_out(old, TURNED)
