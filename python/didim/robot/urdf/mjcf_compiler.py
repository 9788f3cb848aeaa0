"""MuJoCo's compiler on an MJCF: what it would not survive is refused before, and what a description does not need is left out.

Inertias come from the compiled model. Visual and collision geometry, textures, key frames and sensors are deleted first, so that
a file without its meshes is read too; bodies whose mass comes from a missing mesh are named. Tested in ``tests/test_mjcf.py``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..._tools.inputs import read_small_file
from ..._tools.plugins import optional
from ..._tools.words import brief
from ...errors import RobotError
from .xml_spans import Element, parse_xml

DEEPEST = 50
"""Largest depth of includes and attached models: MuJoCo recurses through them without a limit."""
MOST_FILES = 1000
"""Largest number of files that one MJCF is made of; the largest public ones have about a hundred."""
MOST_ELEMENTS = 20_000
"""Largest number of elements, generated ones included."""
MOST_OF = {"body": 2000, "geom": 8000, "mesh": 1000, "skin": 1000, "texture": 1000}
"""Largest numbers of elements for which MuJoCo's time grows with the square: about 1 s each."""
MOST_HEIGHTS = 1_000_000
"""Largest number of points of a height field, which MuJoCo allocates as it reads the file."""
FEW = 1000
"""Largest number of sensors, pairs and the like that are deleted: MuJoCo's time grows with the square."""
GENERATORS = ("replicate", "composite", "flexcomp")
"""Elements whose ``count`` multiplies what they contain."""
NO_SIZES = ("nuserdata", "nkey")
"""Sizes of simulations that MuJoCo allocates while it compiles."""
AUTOMATIC = (
    "memory",
    "njmax",
    "nconmax",
    "nstack",
    "nuser_body",
    "nuser_jnt",
    "nuser_geom",
    "nuser_site",
    "nuser_cam",
)
"""Sizes that MuJoCo computes itself where they are -1."""


@dataclass(frozen=True, eq=False)
class Compiled:
    """An MJCF as MuJoCo compiles it.

    Attributes
    ----------
    model, mujoco : MjModel, module
        The model, without the geometry that has no part in inertias.
    lost : frozenset of int
        Bodies whose mass comes from meshes that cannot be read. The model has a made-up inertia for them.
    ratios : frozenset of int
        Actuators whose velocity gain MuJoCo computes of a damping ratio.
    degrees : bool
        Whether angles of the file are in degrees.
    """

    model: Any
    mujoco: Any
    lost: frozenset[int]
    ratios: frozenset[int]
    degrees: bool


def compile_mjcf(outermost: Element, path: Path) -> Compiled:
    """Compile an MJCF.

    Parameters
    ----------
    outermost : Element
        Content of the file.
    path : Path
        The file; what it includes is relative to its folder.

    Raises
    ------
    RobotError
        Without the package mujoco, for a file that MuJoCo refuses, and for one that generates or includes too much.
    """
    where = path.name
    needed = f"{where}: an MJCF needs MuJoCo's compiler: pip install 'didim[mujoco]', or use a URDF"
    mujoco = optional("mujoco", RobotError, needed)
    _check_parts(outermost, path)
    try:
        with _quiet(mujoco):
            spec = mujoco.MjSpec.from_file(str(path))
            heavy = _stripped(mujoco, spec)
            ratios = frozenset(k for k, each in enumerate(spec.actuators) if each.biasprm[2] > 0.0)
            filed = [geom for geom in heavy if (mesh := spec.mesh(geom.meshname)) is not None and mesh.file]
            missing = [geom for geom in filed if not _has_file(spec, geom, path.parent)]
            others = [geom for geom in filed if geom not in missing]
            light = _without(mujoco, spec, missing)
            try:
                model = spec.compile()
            except ValueError:
                if not others:
                    raise
                light += _without(mujoco, spec, others)  # their files may be what MuJoCo refuses
                model = spec.compile()
            lost = frozenset(body.id for body in light)
    except (ValueError, mujoco.FatalError, mujoco.UnexpectedError) as reason:
        text = " ".join(str(reason).replace("XML Error: ", "").replace("Error: ", "").split())
        raise RobotError(f"{where}: MuJoCo refuses it: {brief(text, 120)}") from None
    return Compiled(model, mujoco, lost, ratios, bool(spec.compiler.degree))


@contextmanager
def _quiet(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo from printing its warnings, and from writing them to a file in the current folder."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(before)


def _check_parts(outermost: Element, main: Path) -> None:
    """Refuse a file that includes itself, or that holds or generates more than MuJoCo compiles in a moment."""
    files: set[Path] = set()
    waiting: list[tuple[Element, Path, tuple[Path, ...], float]] = [(outermost, main, (main.resolve(),), 1.0)]
    counts: dict[str, float] = {}
    while waiting:
        element, file, above, times = waiting.pop()
        line = f"{file.name}: line {element.line}"
        for part in parts_of(element, file, main):
            whole = (*above, part.resolve())
            if part.resolve() in above:
                raise RobotError(f"{line}: {part.name} includes itself")
            if len(whole) > DEEPEST or len(files) >= MOST_FILES:
                raise RobotError(
                    f"{line}: an MJCF has at most {MOST_FILES} parts, {DEEPEST} deep, and this has more"
                )
            if part.resolve() in files and element.tag == "include":
                raise RobotError(f"{line}: {part.name} is included twice, which MuJoCo refuses")
            files.add(part.resolve())
            try:
                data = read_small_file(part, RobotError)
            except RobotError as reason:
                raise RobotError(f"{line}: {reason}") from None
            waiting.append((parse_xml(data, part.name), part, whole, times))
        if element.tag in GENERATORS:
            times *= _product(element, "count")
        for tag, most in {"": MOST_ELEMENTS, **MOST_OF}.items():
            if tag in ("", "body" if element.tag in GENERATORS[1:] else element.tag):
                counts[tag] = counts.get(tag, 0.0) + times
            if not counts.get(tag, 0.0) <= most:
                what = f"elements <{tag}>" if tag else "elements"
                raise RobotError(f"{line}: it has more than {most} {what}; cut the robot out of it")
        if element.tag == "hfield" and not _product(element, "nrow", "ncol") <= MOST_HEIGHTS:
            raise RobotError(
                f"{line}: a height field of more than {MOST_HEIGHTS:g} points is no part of a robot"
            )
        waiting += [(child, file, above, times) for child in element.children]


def _product(element: Element, *keys: str) -> float:
    """Return the product of the numbers of attributes; 1 for other texts, about which MuJoCo complains."""
    words = [word for key in keys for word in element.attributes.get(key, "").split()]
    try:
        return math.prod(max(float(word), 1.0) for word in words)
    except ValueError:
        return 1.0


def parts_of(element: Element, file: Path, main: Path) -> list[Path]:
    """Return the file that an element names, which MuJoCo looks up beside the main one or beside its own."""
    name = element.attributes.get("file", "")
    if element.tag not in ("include", "model") or not name:
        return []
    places = [main.parent / name, file.parent / name]
    there = [place for place in dict.fromkeys(places) if place.is_file()]
    return there or (places[:1] if element.tag == "include" else [])


def _stripped(mujoco: Any, spec: Any) -> list[Any]:
    """Take out what has no part in inertias; return the geoms whose inertia is that of a mesh."""
    for name in NO_SIZES:
        setattr(spec, name, 0)
    for name in AUTOMATIC:
        setattr(spec, name, -1)
    spec.compiler.fusestatic = False  # links keep their names
    for kind in ("keys", "sensors", "pairs", "skins"):
        elements = list(getattr(spec, kind))
        for element in elements if len(elements) <= FEW else ():
            spec.delete(element)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):
        spec.delete(texture)
    formless = (mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
    heavy = []
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0  # or MuJoCo computes convex hulls
        if not (geom.meshname or geom.type in formless):
            continue
        if geom.type not in formless and _counts(mujoco, spec, geom):
            heavy.append(geom)
        else:
            _lighten(mujoco, geom)
    used = {geom.meshname for geom in heavy}
    unused = [mesh for mesh in spec.meshes if mesh.name not in used]
    for element in [*unused, *spec.hfields]:
        spec.delete(element)
    return heavy


def _lighten(mujoco: Any, geom: Any) -> None:
    """Make a geom a small ball without mass, to which others may refer."""
    geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [1e-3, 0.0, 0.0]
    geom.meshname, geom.hfieldname, geom.plugin.active = "", "", False
    geom.mass = geom.density = 0.0


def _counts(mujoco: Any, spec: Any, geom: Any) -> bool:
    """Whether the inertia of a body comes from this geom."""
    body, compiler = geom.parent, getattr(geom, "compiler", spec.compiler)
    rule = mujoco.mjtInertiaFromGeom
    inferred = compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_TRUE or (
        compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_AUTO and not body.explicitinertial
    )
    first, last = compiler.inertiagrouprange
    weight = geom.density if math.isnan(geom.mass) else geom.mass
    return bool(inferred and first <= geom.group <= last and weight != 0.0 and body.name != "world")


def _has_file(spec: Any, geom: Any, folder: Path) -> bool:
    mesh = spec.mesh(geom.meshname)
    below = getattr(mesh, "compiler", spec.compiler).meshdir
    names = (Path(mesh.file), Path(mesh.file).name)  # strippath
    places = (folder, folder / below, Path(spec.modelfiledir or ".") / below)
    return any((place / name).is_file() for place in places for name in names)


def _without(mujoco: Any, spec: Any, geoms: list[Any]) -> list[Any]:
    """Take geoms and their meshes out; their bodies, which are returned, get an inertia with which MuJoCo compiles."""
    bodies = [geom.parent for geom in geoms]
    meshes = {geom.meshname for geom in geoms}
    for geom, body in zip(geoms, bodies, strict=True):
        body.mass, body.inertia, body.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
        body.ipos = [0.0, 0.0, 0.0]
        _lighten(mujoco, geom)
    for mesh in [mesh for mesh in spec.meshes if mesh.name in meshes]:
        spec.delete(mesh)
    return bodies
