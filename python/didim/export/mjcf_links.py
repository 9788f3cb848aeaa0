"""Links of a result in the bodies of the user's MJCF: where they fit, and ``<inertial>``.

A link is placed by the axis of its joint at position zero, so that robot and file may have other frames. Tested in
``tests/test_export_links.py`` by ``mj_inverse``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from .._tools.arrays import Array
from .._tools.words import series
from ..errors import FitError
from ..robot.rigid_body import central, inverse, why_no_body
from ..robot.urdf.chain import Chain, Member
from ..robot.urdf.mjcf_elements import MjcfElements
from ..robot.urdf.reading import LARGEST_DIFFERENCE, own_gravity
from ..robot.urdf.tendons import Shares
from ..robot.urdf.xml_spans import Edit, Element, attribute_edit, attributes_out, first_child
from .bodies import ExportModel
from .numbers import inertial, numbers, xml

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
    edits = _compiler_edits(elements, pseudos)
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
    if not lost and _same(pseudo, np.sum([member.pseudo for member in group], axis=0)):
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


def _same(one: Array, other: Array) -> bool:
    return bool(np.linalg.norm(one - other) <= SAME * np.linalg.norm(other))


def _compiler_edits(elements: MjcfElements, pseudos: Mapping[str, Array]) -> list[Edit]:
    """Return the changes that keep MuJoCo's compiler from changing new inertias, or from taking those of geoms."""
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
    return edits


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
