"""Common style of all pictures: colours for colour-blind readers, sizes, and the optional import of matplotlib."""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from .._tools.arrays import Array
from .._tools.plugins import optional
from ..errors import PlotError

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis as Axis
    from matplotlib.figure import Figure as Figure
else:  # matplotlib is optional, and slow to load
    Axes = Axis = Figure = Any


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

# From the palette of Okabe and Ito, and grey for measurements.
MEASURED, MODEL, RESIDUAL, GOOD, FAINT = "#9aa1ab", "#0072b2", "#d55e00", "#009e73", "#d9dce1"
CYCLE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Colours of the curves, in order (palette of Okabe and Ito)."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""Markers of the methods, in order."""

WIDTH_IN = 11.0
"""Width of a figure (inches)."""
MOST_POINTS = 1200
"""Largest number of points of a line; longer ones are drawn by lowest and highest values, which look the same."""

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5b6470",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ebee",
    "grid.linewidth": 0.6,
    "xtick.color": "#3a424d",
    "ytick.color": "#3a424d",
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.1,
    "figure.facecolor": "white",
    # Dollar signs in names are not mathematics.
    "text.parse_math": False,
    "svg.hashsalt": "didim",
    "svg.fonttype": "path",
}


PanelPair = tuple[int, Axes, Axes]
"""A joint, from 0, with its upper and its lower panel."""

_PATH = re.compile(r' d="[^"]*"')
_INDENT = re.compile(r" *\n *")
_DIGITS = re.compile(r"(\.\d\d)\d+")
NOTEBOOK_DPI = 80
"""Resolution of a figure in a notebook (dots per inch)."""


def require() -> None:
    """Check that matplotlib is available.

    Raises
    ------
    PlotError
        When matplotlib is missing; the message says how to install it.
    """
    needed = "pictures and reports need matplotlib: pip install didim[plot]"
    optional("matplotlib.figure", PlotError, needed)


def styled(draw: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Apply the style of the package within a function, without changing that of the caller."""

    @functools.wraps(draw)
    def inner(*arguments: _Arguments.args, **options: _Arguments.kwargs) -> _Result:
        require()
        import matplotlib

        with matplotlib.rc_context(STYLE):
            return draw(*arguments, **options)

    return inner


def new_figure(height_in: float, width_in: float = WIDTH_IN, gap_in: float = 0.02) -> Figure:
    """Return an empty figure outside pyplot; the gap is above and below every panel."""
    figure = _shown_figure()(figsize=(width_in, height_in), layout="constrained")
    figure.set_layout_engine("constrained", h_pad=gap_in)
    return figure


def plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis with numbers such as 4 and 0.02; a short axis also between powers of ten."""
    from matplotlib.ticker import LogLocator

    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    subs = (1.0,) if decades > 3.0 else (1.0, 2.0, 5.0) if decades > 0.7 else tuple(range(1, 10))
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    plain_numbers(axis)


def plain_numbers(axis: Axis) -> None:
    """Label the major ticks of an axis with numbers such as 100, and leave out the minor ones."""
    from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def legend_above(figure: Figure, axes: Axes) -> None:
    """Draw the legend of one panel in a row above all panels."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))


def shade_rows(axes: Axes, count: int) -> None:
    """Shade every other of `count` rows, which are one unit high, so that the eye can follow them."""
    for row in range(1, count, 2):
        axes.axhspan(row - 0.5, row + 0.5, color="#000000", alpha=0.035, linewidth=0.0, zorder=0.6)


def panel_pairs(figure: Figure, count: int, most: int, heights: tuple[float, float]) -> Iterator[PanelPair]:
    """Give an upper and a lower panel over common time for each of `count` joints, at most `most` pairs in a row.

    The layout of a pair is finished when the next one is asked for: content may be drawn until then.
    """
    rows, columns = per_row(count, most)
    # One grid for all panels aligns their time axes.
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=heights * rows)
    for joint in range(count):
        row, column = divmod(joint, columns)
        upper = figure.add_subplot(grid[2 * row, column])
        lower = figure.add_subplot(grid[2 * row + 1, column], sharex=upper)
        upper.set_title(f"joint {joint + 1}")
        upper.tick_params(labelbottom=False)
        yield joint, upper, lower
        lower.margins(x=0.01)
        lower.set_xlim(left=0.0)
        lower.set_xlabel("time (s)")
    figure.align_ylabels()


@styled
def svg(figure: Figure) -> str:
    """Return a figure as SVG text: the same figure gives the same text, without date and without references.

    Raises
    ------
    PlotError
        Without matplotlib.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    text = io.StringIO()
    canvas, dpi = figure.canvas, figure.dpi
    try:
        # `savefig` would draw the figure twice, first for the layout, which drawing computes anyway.
        FigureCanvasSVG(figure).print_svg(  # type: ignore[no-untyped-call]
            text, metadata={"Date": None, "Creator": None, "Type": None, "Format": None}
        )
    finally:
        figure.set_canvas(canvas)
        figure.dpi = dpi
    # Coordinates are rounded: they are most of the text and need no millionth of a pixel.
    short = _PATH.sub(lambda match: _DIGITS.sub(r"\1", match.group()), text.getvalue())
    return _INDENT.sub("\n", short)


@functools.cache
def _shown_figure() -> type[Figure]:
    """Return a `Figure` that notebooks display without pyplot or a magic command."""
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """Figure with a representation for notebooks."""

        def _repr_png_(self) -> bytes:
            data = io.BytesIO()
            self.savefig(data, format="png", dpi=NOTEBOOK_DPI)
            return data.getvalue()

        def __reduce__(self) -> Any:
            return (_unpickled, (), self.__getstate__())

    return ShownFigure


def _unpickled() -> Figure:
    return _shown_figure().__new__(_shown_figure())


def per_row(count: int, most: int) -> tuple[int, int]:
    """Return rows and columns of small multiples, with a last row as full as possible."""
    rows = -(-count // most)
    return rows, -(-count // rows)


def thin(t: Array, y: Array) -> tuple[Array, Array]:
    """Return a line thinned to `MOST_POINTS` points: the lowest and the highest value of each piece."""
    pieces = MOST_POINTS // 2
    length = len(t) // pieces
    if length < 3:
        return t, y
    n = len(t) // length * length
    blocks = y[:n].reshape(-1, length)
    both = np.sort(np.stack([blocks.argmin(axis=1), blocks.argmax(axis=1)]), axis=0)
    index = (both + length * np.arange(len(blocks))).T.ravel()
    index = np.union1d(index, np.arange(n, len(t)))
    return t[index], y[index]


def line(axes: Axes, pieces: list[tuple[Array, Array]], **options: Any) -> None:
    """Draw the pieces of a line, with gaps between them."""
    thinned = [thin(*piece) for piece in pieces]
    gap = np.array([np.nan])
    x, y = (np.concatenate([part for stretch in thinned for part in (stretch[k], gap)][:-1]) for k in (0, 1))
    axes.plot(x, y, **options)


def units(kind: str) -> tuple[str, str]:
    """Return the units of position and torque of a joint."""
    return ("rad", "N.m") if kind == "revolute" else ("m", "N")


def percent(share: float) -> str:
    """Return 0.0712 as "7.1 %", and NaN as "-"."""
    if not np.isfinite(share):
        return "-"
    value = 100.0 * share
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %" if value < 1e4 else f"{value:.1e} %"
