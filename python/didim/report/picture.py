"""Pictures of a report: a figure as one embedded image, cut into panels that a phone can stack.

Tested in ``tests/test_report.py``.
"""

from __future__ import annotations

import base64
import itertools
import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from ..plot.style import svg
from .page import Html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

WIDE_PX = 700
"""Width of a picture with one column of panels (pixels) from which a phone gets a picture of its own."""
EMPTY = ' class="empty"'
"""Attribute of a part without a panel, which a phone leaves out."""
TOUCH_PX = 3.0
"""Overlap of the boxes around two panels (pixels) that touch: the empty borders of their labels."""
PHONE_IN = 4.0
"""Width of a picture drawn for a phone (inches): its letters keep their size on a screen of 400 pixels."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom as shares of a figure's size, from its upper left corner."""
Panels: TypeAlias = "Sequence[tuple[Axes, Bbox]]"
"""Panels of a drawn figure with the boxes around them (pixels from below left)."""


def picture(figure: Figure, description: str) -> Html:
    """Return a figure, embedded; the description is for screen readers."""
    image, size, dpi = _image(figure), _pixels(figure), figure.dpi
    figure.dpi = 72.0  # that of the SVG, by which the legend was laid out
    try:
        panels = panels_of(figure)
        across = column_edges(figure, panels)
        kind = _kind(figure, size[0], len(across) - 1)
        legend = _legend_columns(figure, panels) if kind != "aside" else []
        top = legend[0][3] if legend else 0.0
        rows = [edge for edge in row_edges(figure, panels) if edge > top] if len(across) > 2 else []
        parts = [_legend(legend, size)] if legend else []
        for upper, lower in itertools.pairwise([top, *rows, 1.0]):
            boxes = [(left, upper, right, lower) for left, right in itertools.pairwise(across)]
            cells = (
                f'<span{"" if _has_panel(figure, panels, box) else EMPTY} style="{_cut(box, size)}"></span>'
                for box in boxes
            )
            parts.append(f'<div class="columns">{"".join(cells)}</div>')
    finally:
        figure.dpi = dpi
    if kind == "wide":
        parts.append(_for_a_phone(figure, with_legend=not legend))
    return Html(
        f'<figure><div class="picture {kind}" role="img" aria-label="{escape(description)}" '
        f'style="width:{size[0]}px;{image}">{"".join(parts)}</div></figure>'
    )


def _kind(figure: Figure, width: int, columns: int) -> str:
    """Return "stacked", "wide" for panels that are drawn anew for a phone, or "aside" for some that a phone pushes aside.

    A map with its colour bar has too many names for a phone, and panels whose labels overlap have no place for a cut.
    """
    if columns > 1 or width <= WIDE_PX:
        return "stacked"
    starts = {round(axes.get_position().x0, 3) for axes in figure.axes}
    return "wide" if len(starts) == 1 else "aside"


def _image(figure: Figure) -> str:
    """Return the style that gives an element a figure as its image; this draws the figure."""
    data = base64.b64encode(svg(figure).encode()).decode("ascii")
    return f"--image:url(data:image/svg+xml;base64,{data})"


def _pixels(figure: Figure) -> tuple[int, int]:
    width, height = (round(96.0 * inches) for inches in figure.get_size_inches())
    return width, height


def _cut(box: Box, size: tuple[int, int], within: float = 1.0) -> str:
    """Return the style of an element that shows a part of an image of `size` pixels, in a share `within` of its width."""
    left, top, right, bottom = box
    across, down = right - left, bottom - top
    x, y = (start / (1.0 - share) if share < 1.0 else 0.0 for start, share in ((left, across), (top, down)))
    return (
        f"width:{100 * across / within:.3f}%;aspect-ratio:{across * size[0]:.2f}/{down * size[1]:.2f};"
        f"background-size:{100 / across:.3f}% {100 / down:.3f}%;background-position:{100 * x:.3f}% {100 * y:.3f}%"
    )


def _legend(columns: Sequence[Box], size: tuple[int, int]) -> str:
    """Return the columns of a legend side by side; `--own` is the width (pixels) that each keeps on a phone."""
    left, right = columns[0][0], columns[-1][2]
    entries = "".join(
        f'<span style="--own:{(box[2] - box[0]) * size[0]:.0f};{_cut(box, size, right - left)}"></span>'
        for box in columns
    )
    margin = f"margin:0 {100 * (1 - right):.3f}% 0 {100 * left:.3f}%"
    return f'<div class="legend" style="{margin}">{entries}</div>'


def _for_a_phone(figure: Figure, *, with_legend: bool) -> str:
    """Return a figure drawn once more, in the width of a phone; the figure stays as it is."""
    width, height = figure.get_size_inches()
    legends = figure.legends
    try:
        figure.legends = legends if with_legend else []
        figure.set_size_inches(PHONE_IN, height)
        image, size = _image(figure), _pixels(figure)
    finally:
        figure.legends = legends
        figure.set_size_inches(width, height)
    whole = f'<span style="{_cut((0.0, 0.0, 1.0, 1.0), size)}"></span>'
    return f'<div class="phone" style="width:{size[0]}px;{image}">{whole}</div>'


def _legend_columns(figure: Figure, panels: Panels) -> list[Box]:
    """Return where a drawn figure has the columns of its legend; none where it does not stand alone above all panels."""
    boxes = [box for _, box in panels]
    if len(figure.legends) != 1 or figure.get_suptitle() or not boxes:
        return []
    (legend,) = figure.legends
    around, whole = legend.get_window_extent(), figure.bbox
    below = max(box.y1 for box in boxes)
    # The layout lets titles reach into the empty border of the legend.
    if below > around.y0 + 0.25 * around.height:
        return []
    top, bottom = (
        float(np.clip(1.0 - y / whole.height, 0.0, 1.0)) for y in (around.y1, max(below, around.y0))
    )
    texts = sorted((text.get_window_extent() for text in legend.get_texts()), key=lambda text: text.x0)
    columns = [list(column) for _, column in itertools.groupby(texts, key=lambda text: round(text.x0))]
    # Half the space between columns lies on either side of a cut.
    space = 0.5 * legend.columnspacing * float(legend.get_texts()[0].get_fontsize()) * figure.dpi / 72.0
    ends = [max(text.x1 for text in column) + space for column in columns[:-1]]
    cuts = [float(np.clip(x / whole.width, 0.0, 1.0)) for x in (around.x0, *ends, around.x1)]
    return [(left, top, right, bottom) for left, right in itertools.pairwise(cuts)]


def panels_of(figure: Figure) -> Panels:
    """Return the panels of a drawn figure, colour bars left out; matplotlib takes as long for the boxes as for drawing."""
    return [
        (axes, box)
        for axes in figure.axes
        if axes.get_label() != "<colorbar>" and (box := axes.get_tightbbox()) is not None
    ]


def _has_panel(figure: Figure, panels: Panels, box: Box) -> bool:
    """Return whether the middle of a panel lies within a part of the figure."""
    left, top, right, bottom = box
    whole = figure.bbox
    return any(
        left <= 0.5 * (panel.x0 + panel.x1) / whole.width <= right
        and top <= 1.0 - 0.5 * (panel.y0 + panel.y1) / whole.height <= bottom
        for _, panel in panels
    )


def column_edges(figure: Figure, panels: Panels) -> list[float]:
    """Return where the columns of panels of a drawn figure begin and end, as shares of its width, from 0 to 1."""
    gaps = _gaps((box.x0, box.x1, True) for _, box in panels)
    return [0.0, *(gap / figure.bbox.width for gap in gaps), 1.0]


def row_edges(figure: Figure, panels: Panels) -> list[float]:
    """Return where rows of panels of a drawn figure begin, as shares of its height, without the first one.

    A row begins with a title: panels without one belong to the panel above.
    """
    height = figure.bbox.height
    gaps = _gaps(
        (height - box.y1, height - box.y0, bool(axes.get_title("left") or axes.get_title()))
        for axes, box in panels
    )
    return [gap / height for gap in gaps]


def _gaps(spans: Iterable[tuple[float, float, bool]]) -> list[float]:
    """Return the middles of the gaps (pixels) between spans: start, end, and whether a gap may be before the span."""
    gaps, reached = [], -math.inf
    for start, end, cut in sorted(spans):
        if cut and start > reached - TOUCH_PX > -math.inf:
            gaps.append(0.5 * (start + reached))
        reached = max(reached, end)
    return gaps
