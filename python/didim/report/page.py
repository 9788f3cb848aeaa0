"""HTML of a report: one self-contained page without network access. All text is escaped here."""

from __future__ import annotations

import base64
import os
import re
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Literal

import numpy as np

from .._tools.version import __version__
from ..plot.style import svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Level = Literal["good", "caution", "bad"]


STYLE = """\
:root {
  color-scheme: light dark; --ink: #1f2630; --soft: #5b6470; --line: #dfe3e8; --good: #00734f; --caution: #8a5a00; --bad: #b3261e;
  --paper: #fff; --ground: #f4f5f7; --stripe: #f7f8fa; --link: #005a9c;
}
@media (prefers-color-scheme: dark) {
  :root {
    --ink: #e3e6ea; --soft: #a2aab4; --line: #3a4048; --good: #4cc9a0; --caution: #e0ac3d; --bad: #f28b82;
    --paper: #1c2026; --ground: #121519; --stripe: #22272e; --link: #7db8ea;
  }
  /* Pictures are drawn on white: lightness turns round, hues stay, and black becomes the colour of the paper. */
  .picture { filter: invert(1) hue-rotate(180deg); mix-blend-mode: screen; }
}
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: var(--ground);
  font: 15px/1.5 system-ui, "Segoe UI", "Liberation Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { margin: 0; font-size: 26px; line-height: 1.25; }
h2 { margin: 0 0 6px; font-size: 19px; }
header p { margin: 2px 0 16px; color: var(--soft); }
section { margin: 16px 0 0; padding: 18px 22px 20px; background: var(--paper); border: 1px solid var(--line); border-radius: 8px; }
section > p { max-width: 84ch; margin: 6px 0; }
.verdict { border-left: 8px solid; }
.verdict.good { border-left-color: var(--good); }
.verdict.caution { border-left-color: #e69f00; }
.verdict.bad { border-left-color: var(--bad); }
.verdict strong.badge { display: block; font-size: 19px; }
.good strong.badge { color: var(--good); }
.caution strong.badge { color: var(--caution); }
.bad strong.badge { color: var(--bad); }
.verdict > p { font-size: 17px; }
.tiles {
  display: grid; grid-template-columns: repeat(auto-fill, minmax(124px, 1fr)); gap: 10px;
  margin: 14px 0 4px; padding: 0; list-style: none;
}
.tiles li { padding: 8px 12px; background: var(--ground); border-radius: 6px; }
.tiles b { display: block; font-size: 20px; line-height: 1.3; white-space: nowrap; }
.tiles span { color: var(--soft); font-size: 13px; }
ul.findings { margin: 6px 0 4px; padding-left: 22px; }
figure { margin: 12px 0 0; overflow-x: auto; }
.scroll { overflow-x: auto; margin-top: 10px; }
table { border-collapse: collapse; font-size: 13.5px; }
.beside { display: flex; flex-wrap: wrap; column-gap: 36px; }
th, td { padding: 2px 12px 2px 0; text-align: left; white-space: nowrap; vertical-align: top; }
thead th { padding-bottom: 4px; white-space: normal; vertical-align: bottom; border-bottom: 1.5px solid var(--soft); }
thead tr:first-child th.group { padding-top: 2px; border-bottom: 1px solid var(--line); text-align: center; }
tbody tr:nth-child(even) td { background: var(--stripe); }
td.number, th.number { text-align: right; }
td.number, td.digest, pre {
  font-family: ui-monospace, "DejaVu Sans Mono", "Liberation Mono", Consolas, monospace; font-size: 12.5px;
}
td.number { white-space: pre; }
.dense th, .dense td { padding-right: 8px; font-size: 12.5px; }
.dense td.number { font-size: 11px; white-space: normal; }
.dense td:first-child { min-width: 9em; white-space: normal; }
td.first, th.first { padding-left: 26px; }
td.off { color: var(--bad); font-weight: 700; }
td.uncertain { color: var(--caution); }
td.wide, td.digest { white-space: normal; overflow-wrap: anywhere; }
pre { overflow-x: auto; margin: 8px 0 0; }
summary { cursor: pointer; margin-top: 10px; color: var(--soft); }
nav { margin: 14px 0 0; color: var(--soft); font-size: 14px; }
nav a { display: inline-block; margin: 0 14px 2px 0; color: var(--link); text-decoration: none; }
nav a:hover { text-decoration: underline; }
h2 { scroll-margin-top: 12px; }
@media (max-width: 640px) {
  main { padding: 14px 8px 40px; }
  header { padding: 0 6px; }
  h1 { font-size: 21px; overflow-wrap: anywhere; }
  section { padding: 14px 12px 16px; }
  .verdict > p { font-size: 15.5px; }
  .tiles { grid-template-columns: repeat(auto-fill, minmax(100px, 1fr)); }
  .tiles b { font-size: 17px; }
  th, td { padding-right: 8px; font-size: 12.5px; }
  td.number { font-size: 11.5px; }
  /* A table keeps its first column in sight; one of cards has a line for each number. */
  .scroll td:first-child, .scroll th:first-child { position: sticky; left: 0; background: var(--paper); }
  .cards thead { display: none; }
  .cards table, .cards tbody, .cards tr { display: block; }
  .cards td { display: flex; justify-content: space-between; padding: 1px 0; }
  .cards td::before { content: attr(data-head); color: var(--soft); font-family: system-ui, sans-serif; }
  .cards td:first-child { display: block; position: static; margin-top: 8px; font-weight: 700; }
}
@media print { nav { display: none; } section { border: 0; padding: 8px 0; break-inside: avoid-page; } }
"""

PICTURE_STYLE = """\
/* A narrow screen scrolls a picture, so that its letters keep their size. */
.picture { display: block; max-width: 100%; height: auto; print-color-adjust: exact; }
@media (max-width: 640px) { .picture { max-width: none; } }
"""
"""Style of pictures, which the gallery of the documentation shares."""

# Nothing may be fetched, even if a file name or a message contains HTML.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
DENSE = 10
"""Number of columns beyond which a table is set smaller, to fit a screen of 1280 pixels."""


@dataclass(frozen=True)
class Html:
    """Text that is HTML already; everything else is escaped. A section has a title, and a name for links."""

    text: str
    title: str = ""
    name: str = ""


Text = str | Html


def html(text: Text) -> str:
    """Return text as HTML."""
    return text.text if isinstance(text, Html) else escape(text)


def today() -> str:
    """Return the date of a page; ``SOURCE_DATE_EPOCH`` sets it for reproducible builds."""
    given = os.environ.get("SOURCE_DATE_EPOCH", "")
    now = time.gmtime(int(given)) if given.isdecimal() else time.localtime()
    return time.strftime("%Y-%m-%d", now)


def page(title: str, subtitle: str, sections: Iterable[Html]) -> str:
    """Return the whole page."""
    parts = list(sections)
    body = "\n".join(part.text for part in parts)
    places = [(part.name, part.title) for part in parts if part.name]
    links = "\n".join(f'<a href="#{name}">{escape(text)}</a>' for name, text in places)
    # The verdict is above the table of contents.
    first, _, rest = body.partition("</section>")
    body = f"{first}</section>\n<nav>\n{links}\n</nav>{rest}" if links and not parts[0].name else body
    return f"""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>
{STYLE}{PICTURE_STYLE}</style>
</head>
<body>
<main>
<header>
<h1>{escape(title)}</h1>
<p>{escape(subtitle)}. Written {today()} by didim {__version__}.</p>
</header>
{body}
</main>
</body>
</html>
"""


def section(title: str, *content: Html) -> Html:
    """Return a part of the page under a heading."""
    name = re.sub(r"\W+", "-", title.lower()).strip("-")
    head = f'<section>\n<h2 id="{escape(name)}">{escape(title)}</h2>'
    return Html("\n".join([head, *(part.text for part in content), "</section>"]), title, name)


def verdict(
    level: Level, badge: str, sentence: str, tiles: Sequence[tuple[str, str]], findings: Sequence[str]
) -> Html:
    """Return the summary on top: a word, a sentence, a few numbers (value, label), and remarks."""
    lines = [
        f'<section class="verdict {level}">',
        f'<strong class="badge">{escape(badge)}</strong>',
        f"<p>{escape(sentence)}</p>",
        '<ul class="tiles">',
        *(f"<li><b>{escape(value)}</b><span>{escape(label)}</span></li>" for value, label in tiles),
        "</ul>",
    ]
    if findings:
        lines += ['<ul class="findings">', *(f"<li>{escape(text)}</li>" for text in findings), "</ul>"]
    return Html("\n".join([*lines, "</section>"]))


def paragraph(text: str) -> Html:
    """Return a paragraph."""
    return Html(f"<p>{escape(text)}</p>")


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[Text]],
    *,
    numbers: Iterable[int] = (),
    groups: Sequence[tuple[str, int]] = (),
    classes: dict[tuple[int, int], str] | None = None,
    cards: bool = False,
) -> Html:
    """Return a table.

    Parameters
    ----------
    head : sequence of str
        Headings.
    rows : sequence of sequence of str
        Cells.
    numbers : iterable of int
        Columns of numbers, which are right-aligned.
    groups : sequence of (str, int)
        Headings over groups of columns, with the number of columns.
    classes : dict of (row, column) to str, optional
        Classes of single cells.
    cards : bool
        On a phone, each row is a list of its cells with their headings.
    """
    right = set(numbers)
    ends = np.cumsum([span for _, span in groups])
    first = {int(end) for end in ends[:-1]}
    dense = ' class="dense"' if len(head) > DENSE else ""
    lines = [f'<div class="scroll{" cards" if cards else ""}"><table{dense}>', "<thead>"]
    if groups:
        cells = (f'<th class="group" colspan="{span}">{escape(text)}</th>' for text, span in groups)
        lines.append(f"<tr>{''.join(cells)}</tr>")
    cells = (_cell("th", text, _classes(column, right, first)) for column, text in enumerate(head))
    lines += [f"<tr>{''.join(cells)}</tr>", "</thead>", "<tbody>"]
    for row, texts in enumerate(rows):
        line = ""
        for column, text in enumerate(texts):
            extra = (classes or {}).get((row, column))
            named = head[column] if cards and column else ""
            line += _cell("td", text, [*_classes(column, right, first), *([extra] if extra else [])], named)
        lines.append(f"<tr>{line}</tr>")
    return Html("\n".join([*lines, "</tbody>", "</table></div>"]))


def _classes(column: int, right: set[int], first: set[int]) -> list[str]:
    return (["number"] if column in right else []) + (["first"] if column in first else [])


def _cell(tag: str, text: Text, classes: Sequence[str], heading: str = "") -> str:
    attribute = f' class="{" ".join(classes)}"' if classes else ""
    attribute += f' data-head="{escape(heading)}"' if heading else ""
    return f"<{tag}{attribute}>{html(text)}</{tag}>"


def beside(*content: Html) -> Html:
    """Return parts side by side if the page is wide enough."""
    inner = "\n".join(part.text for part in content)
    return Html(f'<div class="beside">\n{inner}\n</div>')


def details(summary: str, *content: Html) -> Html:
    """Return content that unfolds on a click."""
    inner = "\n".join(part.text for part in content)
    return Html(f"<details><summary>{escape(summary)}</summary>\n{inner}\n</details>")


def code(text: str) -> Html:
    """Return preformatted text."""
    return Html(f"<pre>{escape(text)}</pre>")


def picture(figure: Figure, description: str) -> Html:
    """Return a figure, embedded; the description is for screen readers."""
    width, height = (round(96.0 * inches) for inches in figure.get_size_inches())
    data = base64.b64encode(svg(figure).encode()).decode("ascii")
    return Html(
        f'<figure><img class="picture" alt="{escape(description)}" width="{width}" height="{height}" '
        f'src="data:image/svg+xml;base64,{data}"></figure>'
    )
