"""XML as a tree of elements with their byte ranges: a part of a file can be replaced without changing any other byte.

Namespaces are ignored: real descriptions use undeclared prefixes, at which other parsers stop.
Tested in ``tests/test_urdf_xml.py``.
"""

from __future__ import annotations

import re
import xml.parsers.expat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from ...errors import RobotError

_TAG = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""")
"""Opening tag, to the first ``>`` outside quotes."""


@dataclass(eq=False)
class Comment:
    """A comment: its text and its first and past-the-last byte."""

    text: str
    start: int
    end: int


@dataclass(eq=False)
class Element:
    """An element of an XML file.

    Attributes
    ----------
    tag : str
        Name, with its prefix where there is one.
    attributes : mapping of str to str
        Attributes in the order of the file.
    start, opened, end : int
        First byte, the byte past the opening tag, and the byte past the whole element.
    line : int
        Line of its first byte, counted from 1.
    children : list of Element
        Elements inside.
    comments : list of Comment
        Comments directly inside.
    """

    tag: str
    attributes: Mapping[str, str]
    start: int
    opened: int
    line: int
    end: int = -1
    children: list[Element] = field(default_factory=list)
    comments: list[Comment] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Children of one name."""
        return (child for child in self.children if child.tag == tag)

    def find(self, tag: str) -> Element | None:
        """First child of one name."""
        return next(self.all(tag), None)


def parse_xml(data: bytes, where: str) -> Element:
    """Parse a file.

    Parameters
    ----------
    data : bytes
        Content.
    where : str
        Name of the file, which opens each message.

    Returns
    -------
    Element
        The outermost element.

    Raises
    ------
    RobotError
        When it is not well-formed XML, with line and column, or declares entities.
    """
    if b"\0" in data[:400]:
        raise RobotError(f"{where}: neither UTF-8 nor Latin-1; save it as UTF-8")
    blank = len(data) - len(data.lstrip())
    if blank and data[blank:].startswith(b"<?xml"):
        # Other parsers accept blank lines before the declaration. Replacing them by spaces preserves the byte positions.
        behind = data.find(b"?>", blank) + 2
        data = data[blank:behind] + data[:blank] + data[behind:]
    parser = xml.parsers.expat.ParserCreate()
    parser.buffer_text = True
    open_elements: list[Element] = []
    outermost: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        first = parser.CurrentByteIndex
        opening = _TAG.match(data, first)
        opened = opening.end() if opening else len(data)
        element = Element(tag, attributes, first, opened, parser.CurrentLineNumber)
        (open_elements[-1].children if open_elements else outermost).append(element)
        open_elements.append(element)

    def end(_: str) -> None:
        element = open_elements.pop()
        empty = data[element.opened - 2 : element.opened] == b"/>"
        element.end = element.opened if empty else data.index(b">", parser.CurrentByteIndex) + 1

    def comment(text: str) -> None:
        first = parser.CurrentByteIndex
        if open_elements:
            open_elements[-1].comments.append(Comment(text, first, data.index(b"-->", first) + 3))

    def entity(*_: object) -> None:
        raise RobotError(f"{where}: it declares XML entities, which a robot description does not need")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CommentHandler = comment
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        raise RobotError(
            f"{where}: not well-formed XML, {reason} (line {error.lineno}, column {error.offset + 1})"
        ) from None
    except RobotError:
        raise
    except (ValueError, LookupError) as error:  # unknown encoding
        raise RobotError(f"{where}: not readable as XML ({error})") from None
    return outermost[0]
