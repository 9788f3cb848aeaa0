"""Changes by an export, link by link: mass, centre of mass and inertia beside those of the description.

Tested in ``tests/test_export.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..robot.rigid_body import central
from .bodies import ExportModel


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
