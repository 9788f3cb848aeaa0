"""One call for every format: the content of the file, and a report on its links beside those of the description.

Tested in ``tests/test_export.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..errors import FitError
from ..model.consistency import pseudo_inertias
from ..robot.rigid_body import central, inverse
from ..robot.robot import Robot
from ..robot.urdf.reading import file_set
from .bodies import ExportModel, export_model
from .drives import read_drives
from .mjcf import mjcf_text
from .mjcf_edit import edit_mjcf, why_other
from .sdf import no_drives, sdf_text
from .source import Source
from .urdf import edited_urdf, urdf_bytes


@dataclass(frozen=True)
class LinkChange:
    """One link before and after.

    Attributes
    ----------
    link : str
        Its name.
    mass : float
        New mass (kg), fixed links included.
    mass_before : float or None
        Mass in the description; None without one, as the next two.
    centre_moved : float or None
        Distance between the old and the new centre of mass (m).
    inertia_changed : float or None
        Norm of the change of the inertia about the centre of mass, over that of the old one.
    from_prior : tuple of str
        Standard parameters of the link that come from the prior, because the log does not identify them.
    """

    link: str
    mass: float
    mass_before: float | None
    centre_moved: float | None
    inertia_changed: float | None
    from_prior: tuple[str, ...] = ()


@dataclass(frozen=True)
class ExportReport:
    """Report on an export.

    Attributes
    ----------
    links : tuple of LinkChange
        From the base outwards.
    sentences : tuple of str
        Sentences on parameters that the format cannot represent.
    """

    links: tuple[LinkChange, ...]
    sentences: tuple[str, ...]

    def __str__(self) -> str:
        width = max(len("link"), *(len(change.link) for change in self.links))
        known = any(change.mass_before is not None for change in self.links)
        head = f"{'link':{width}}  {'mass kg':>9}"
        if known:
            head += f"  {'before':>9}  {'centre moved mm':>15}  {'inertia changed %':>17}"
        prior = any(change.from_prior for change in self.links)
        lines = [head + ("  from the prior" if prior else "")]
        for change in self.links:
            line = f"{change.link:{width}}  {change.mass:9.4g}"
            if known:
                line += (
                    f"  {_cell(change.mass_before, 1.0):>9}  {_cell(change.centre_moved, 1e3):>15}"
                    f"  {_cell(change.inertia_changed, 1e2):>17}"
                )
            lines.append(line + (f"  {' '.join(change.from_prior)}" if change.from_prior else ""))
        return "\n".join([*lines, *([""] if self.sentences else []), *self.sentences])


def compare_links(
    model: ExportModel,
    before: Sequence[Array | None],
    sentences: Iterable[str] = (),
    from_prior: Mapping[int, Sequence[str]] | None = None,
) -> ExportReport:
    """Compare the links of an export with those of the description.

    Parameters
    ----------
    model : ExportModel
        Exported robot.
    before : sequence of (4, 4) array or None
        Pseudo-inertias of the description in the frames of the links; None where it has none.
    sentences : iterable of str
        Sentences on omissions.
    from_prior : mapping of int to sequence of str, optional
        For each link (from 0), its standard parameters that come from the prior.
    """
    changes = []
    for number, (link, old) in enumerate(zip(model.links, before, strict=True)):
        prior = tuple((from_prior or {}).get(number, ()))
        if old is None or not (old[3, 3] > 0.0 and link.pseudo[3, 3] > 0.0):
            changes.append(LinkChange(link.link, float(link.pseudo[3, 3]), None, None, None, prior))
            continue
        mass, centre, inertia = central(link.pseudo)
        mass_before, centre_before, inertia_before = central(old)
        size = float(np.linalg.norm(inertia_before))
        change = float(np.linalg.norm(inertia - inertia_before)) / size if size > 0.0 else math.inf
        moved = float(np.linalg.norm(centre - centre_before))
        changes.append(LinkChange(link.link, mass, mass_before, moved, change, prior))
    return ExportReport(tuple(changes), tuple(sentences))


def _cell(value: float | None, scale: float) -> str:
    if value is None:
        return "-"
    scaled = value * scale
    return "0" if abs(scaled) < 1e-6 else f"{scaled:.4g}"


Format = Literal["urdf", "mjcf", "sdf"]

FORMATS: tuple[Format, ...] = ("urdf", "mjcf", "sdf")
"""Formats of robot descriptions that can be written."""


def export(
    robot: Robot,
    x: ArrayLike,
    form: Format,
    *,
    urdf: str | Path | None = None,
    keep_lumped: bool = False,
    from_prior: Mapping[int, Sequence[str]] | None = None,
) -> tuple[bytes, ExportReport]:
    """Write parameters in a format, and report on each link.

    Parameters
    ----------
    robot : Robot
        The robot.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``, SI units, joint side: those of real bodies.
    form : {"urdf", "mjcf", "sdf"}
        Format.
    urdf : str or Path, optional
        The URDF that is edited; needed for "urdf".
    keep_lumped : bool
        In a URDF, leave the inertia of fixed links and write the difference.
    from_prior : mapping of int to sequence of str, optional
        For each link (from 0), its standard parameters that come from a prior, for the report.

    Raises
    ------
    FitError
        When a link is not a body, a drive has negative parameters, or the URDF is not that of the robot.
    OSError
        When the URDF cannot be read.
    """
    model = export_model(robot, x)
    before = _of_description(robot)
    if form == "urdf":
        path = Path(urdf or "")
        content = edited_urdf(robot, model, urdf_bytes(robot, path), path.name, keep_lumped)
        sentences = [*model.left_out, *no_drives(model, "a URDF")]
    elif form == "mjcf":
        content, sentences = mjcf_text(model).encode(), list(model.left_out)
    else:
        content, sentences = sdf_text(model).encode(), [*model.left_out, *no_drives(model, "SDF")]
    return content, compare_links(model, before, sentences, from_prior)


def into_mjcf(
    path: Path, source: Source | None, fit: Path | None, step_s: float | None = None
) -> tuple[bytes, str, tuple[str, ...]]:
    """Write links and drives into the MJCF of a robot, or the drives of a result into any that has its joints.

    Parameters
    ----------
    path : Path
        The MJCF.
    source : Source or None
        Robot and parameters; None for drives alone.
    fit : Path or None
        The result, whose drives are written where the file is not of the robot.
    step_s : float, optional
        Step of a simulator, see `edit_mjcf`.

    Returns
    -------
    bytes, str, tuple of str
        Content of the file, report, and sentences.

    Raises
    ------
    FitError
        As of `edit_mjcf`, and for parameters without a result when the file is not of the robot.
    """
    notes: tuple[str, ...] = ()
    if source is not None:
        model = export_model(source.robot, source.x)
        reason = why_other(path, model)
        if reason is None:
            content, drives = edit_mjcf(model, path, step_s=step_s)
            report = compare_links(model, _of_description(source.robot), (), source.from_prior)
            return content, f"{report}\n\n{drives}", source.notes
        if fit is None:
            raise FitError(f"{path.name} is not of robot {model.name!r}: {reason}")
        notes = (
            f"links of {path.name} stay as they are, because it is not of robot {model.name!r}: {reason}",
        )
    assert fit is not None
    content, drives = edit_mjcf(read_drives(fit), path, step_s=step_s)
    return content, f"{drives}", notes


def _of_description(robot: Robot) -> list[Array | None]:
    """Return the pseudo-inertias in the original description of a robot, in the frames of its links."""
    places = robot.correspondence
    own = file_set(robot)
    if places is None or own is None:
        return [None] * robot.n_joints
    pseudos = pseudo_inertias(robot, robot.sets[own])
    backs = [inverse(link.matrix) for link in places.links]
    return [back @ pseudo @ back.T for back, pseudo in zip(backs, pseudos, strict=True)]
