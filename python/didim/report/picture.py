"""Pictures of a report: a figure as one embedded image, which a narrow screen scrolls. Tested in ``tests/test_report.py``."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

from ..plot.style import svg
from .page import Html

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def picture(figure: Figure, description: str) -> Html:
    """Return a figure, embedded; the description is for screen readers."""
    width, height = (round(96.0 * inches) for inches in figure.get_size_inches())
    data = base64.b64encode(svg(figure).encode()).decode("ascii")
    return Html(
        f'<figure><img class="picture" alt="{escape(description)}" width="{width}" height="{height}" '
        f'src="data:image/svg+xml;base64,{data}"></figure>'
    )
