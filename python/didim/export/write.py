"""One call for every format: the content of the file, and the report on it. Tested in ``tests/test_export.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..errors import FitError
from ..model.consistency import pseudo_inertias
from ..robot.rigid_body import inverse
from ..robot.robot import Robot
from ..robot.urdf.reading import file_set
from .bodies import export_model
from .drives import read_drives
from .mjcf import mjcf_text
from .mjcf_edit import edit_mjcf, why_other
from .report import ExportReport, compare_links
from .sdf import no_drives, sdf_text
from .source import Source
from .urdf import edited_urdf, urdf_bytes

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
