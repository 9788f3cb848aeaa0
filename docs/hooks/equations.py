r"""Hook of mkdocs: equations in TeX become MathML when the pages are built. No script and no network when they are read.

``$...$`` stands in a line, ``$$...$$`` in a line of its own, with the number of the paper as ``\tag{9}``. Code keeps its
dollars. Tested in ``tests/test_equations.py``.
"""

from __future__ import annotations

import re
from html import unescape
from typing import Any
from xml.etree.ElementTree import Element, tostring

from latex2mathml.converter import convert_to_element
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor

PATTERN = r"(?<![\\$])(\$\$?)(?!\s*\$)(.+?)(?<!\\)\1(?!\$)"
PRIORITY = 185
"""After code in a line (190), before backslashes (180)."""

_TAG = re.compile(r"\s*\\tag\{(.+?)\}\s*$")
_OPERATORS = frozenset("\N{PLUS-MINUS SIGN}\N{ELEMENT OF}\N{IDENTICAL TO}")
"""Characters that latex2mathml takes for identifiers, which have no space around them."""
_ACCENTS = frozenset("\N{DOT ABOVE}\N{DIAERESIS}\N{MACRON}^~")
"""Characters over a letter: without the attribute browsers draw them as small as exponents."""


def mathml(tex: str, *, display: bool = False) -> str:
    """Return an equation as MathML, with its number beside it where it has one."""
    found = _TAG.search(tex)
    body = tex[: found.start()] if found else tex
    math = convert_to_element(" ".join(body.split()), display="block" if display else "inline")
    for item in math.iter():
        # Its texts are references such as "&#x003B2;", which would be escaped again.
        item.text = unescape(item.text) if item.text else item.text
        if item.tag == "mi" and item.text in _OPERATORS:
            item.tag = "mo"
        if item.tag == "mover" and unescape(item[1].text or "") in _ACCENTS:
            item.set("accent", "true")
    for row in list(math.iter("mrow")):
        _frame_matrices(row)
    if not display:
        return tostring(math, encoding="unicode")
    line = Element("span", {"class": "equation"})
    line.append(math)
    if found:
        number = Element("span", {"class": "number"})
        number.text = f"({found[1]})"
        line.append(number)
    return tostring(line, encoding="unicode")


def _frame_matrices(row: Element) -> None:
    """Take the brackets of matrices away, which only stretch in fonts for mathematics; the style sheet draws them."""
    items = list(row)
    for before, table, after in zip(items, items[1:], items[2:], strict=False):
        if table.tag == "mtable" and (before.text, after.text) == ("[", "]"):
            table.set("class", "matrix")
            row.remove(before)
            row.remove(after)


class Equation(InlineProcessor):
    """``$...$`` and ``$$...$$`` of a page."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:
        """Return the MathML and the part of the text that it replaces."""
        assert self.md is not None
        html = mathml(m[2], display=m[1] == "$$")
        return self.md.htmlStash.store(html), m.start(0), m.end(0)


class Equations(Extension):
    """Extension of Python-Markdown."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Add the pattern."""
        md.inlinePatterns.register(Equation(PATTERN, md), "equations", PRIORITY)


def on_config(config: Any) -> Any:
    """Add the extension to those of mkdocs.yml."""
    config.markdown_extensions.append(Equations())
    return config
