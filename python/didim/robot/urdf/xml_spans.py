"""XML as a tree of elements with their byte ranges: a part of a file can be replaced without changing any other byte.

Namespaces are ignored: real descriptions use undeclared prefixes, at which other parsers stop.
Tested in ``tests/test_urdf_xml.py``.
"""

from __future__ import annotations

import re
import xml.parsers.expat
from collections.abc import Collection, Iterable, Iterator, Mapping
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
    data : bytes
        Content of its file.
    part : Element or None
        Outermost element of the file that stands in the place of this one.
    """

    tag: str
    attributes: Mapping[str, str]
    start: int
    opened: int
    line: int
    end: int = -1
    children: list[Element] = field(default_factory=list)
    comments: list[Comment] = field(default_factory=list)
    data: bytes = field(default=b"", repr=False)
    part: Element | None = None

    def all(self, tag: str) -> Iterator[Element]:
        """Children of one name."""
        return (child for child in self.inside() if child.tag == tag)

    def inside(self, *through: str) -> Iterator[Element]:
        """Children, with those of included files and of elements of these names in their places."""
        for child in self.children:
            if child.part is not None or child.tag in through:
                yield from (child.part or child).inside(*through)
            else:
                yield child

    def walk(self) -> Iterator[Element]:
        """All elements inside, those of included files too."""
        for child in self.children:
            yield child
            yield from (child.part or child).walk()

    @property
    def indent(self) -> bytes:
        """Indentation of an element that is the first on its line."""
        before = self.data[self.data.rfind(b"\n", 0, self.start) + 1 : self.start]
        return before[: len(before) - len(before.lstrip(b" \t"))]

    @property
    def newline(self) -> bytes:
        """What ends the lines of its file."""
        return b"\r\n" if b"\r\n" in self.data else b"\n"

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
    content = data
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
        element = Element(tag, attributes, first, opened, parser.CurrentLineNumber, data=content)
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


@dataclass(frozen=True, eq=False)
class Edit:
    """New bytes for the span from `start` to `end` of a file with the content `data`."""

    data: bytes
    start: int
    end: int
    text: bytes


def edited(outermost: Element, changes: Collection[Edit], *, whole: bool = False) -> bytes:
    """Return a file with changes that do not overlap; an included file that changes stands in the place of its include.

    If `whole`, all included files do, and the outermost element has neither its opening nor its closing tag.
    """
    data = outermost.data
    own = [change for change in changes if change.data is data]
    files = {id(change.data) for change in changes}
    for include in outermost.walk():
        part = include.part
        if part is None or include.data is not data:
            continue
        if whole or files & {id(part.data), *(id(element.data) for element in part.walk())}:
            text = edited(part, changes, whole=True).strip()
            own.append(Edit(data, include.start, include.end, text))
    if whole:
        closing = outermost.end if outermost.opened == outermost.end else data.rindex(b"</", 0, outermost.end)
        own += [Edit(data, 0, outermost.opened, b""), Edit(data, closing, len(data), b"")]
    parts, start = [], 0
    for change in sorted(own, key=lambda change: (change.start, change.end)):
        parts += [data[start : change.start], change.text]
        start = change.end
    return b"".join([*parts, data[start:]])


def attribute_edit(element: Element, key: str, value: str, old: str = "") -> Edit:
    """Return a new value of an attribute of an opening tag, in the place of another one if that is there."""
    text = f'{key}="{value}"'.encode()
    match = _attribute(element, key) or (_attribute(element, old) if old else None)
    if match:
        return Edit(element.data, match.start(1), match.end(), text)
    at = element.start + len(f"<{element.tag}")
    return Edit(element.data, at, at, b" " + text)


def attributes_out(element: Element, keys: Collection[str]) -> list[Edit]:
    """Return the changes that take attributes out of an opening tag."""
    found = [match for key in keys if (match := _attribute(element, key))]
    return [Edit(element.data, match.start(), match.end(), b"") for match in found]


def _attribute(element: Element, key: str) -> re.Match[bytes] | None:
    pattern = re.compile(rb"\s+(%s\s*=\s*(?:\"[^\"]*\"|'[^']*'))" % key.encode())
    return pattern.search(element.data, element.start, element.opened)


def first_child(element: Element, lines: Iterable[str]) -> Edit:
    """Return the change that adds lines of text as the first child of an element."""
    data, newline = element.data, element.newline
    text = b"".join(newline + element.indent + b"  " + line.encode() for line in lines)
    if element.opened == element.end:  # <link name="x"/>
        slash = data.rindex(b"/", element.start, element.end)
        closing = newline + element.indent + f"</{element.tag}>".encode()
        return Edit(data, slash, element.end, b">" + text + closing)
    return Edit(data, element.opened, element.opened, text)
