"""Words of messages: counts, lists, and the most similar known name.

Suggestions for all misspelt names (commands, options, methods, columns, keys, robots) come from here:
``tests/test_mistakes.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import accumulate

ROOM = 110
"""Largest number of characters of a list inside a message, which has at most 200."""
MOST_JOINTS = 6
"""Largest number of joints that a message lists one by one."""
MOST_RUNS = 3
"""Largest number of runs of joints, such as 1 to 6, that a message lists."""
FEW_NAMES = 12
"""Largest number of names that a message lists in full; otherwise it shows the most similar ones."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a sentence that suggests the most similar known word, or an empty text."""
    near = nearest(word, known)
    return f"; did you mean {near!r}?" if near else ""


def nearest(word: str, known: Iterable[str]) -> str | None:
    near = _near(word, known, 1)
    return near[0] if near else None


def known_names(word: str, known: Sequence[str], noun: str) -> str:
    """Return the end of a sentence on an unknown name: all known ones if few, else the most similar, and their number.

    Parameters
    ----------
    word
        The unknown name.
    known
        Known names.
    noun
        Noun for them, in the singular.
    """
    if len(known) <= FEW_NAMES:
        there = f"the {noun}s are" if len(known) > 1 else "the only one is"
        return f"{there} {listing(known, 36)}{did_you_mean(word, known)}"
    near = _near(word, known, 3)
    hint = f"; the nearest are {listing(near, 36)}" if len(near) > 1 else did_you_mean(word, known)
    return f"there are {len(known)} {noun}s{hint or f', such as {listing(known[:3], 36)}'}"


def _near(word: str, known: Iterable[str], count: int) -> list[str]:
    import difflib

    # Wrong upper or lower case is the commonest slip, so only suggestions ignore case.
    folded = {name.lower(): name for name in known}
    return [folded[name] for name in difflib.get_close_matches(word.lower(), folded, n=count, cutoff=0.6)]


def listing(names: Iterable[object], room: int = ROOM) -> str:
    """Return names as quoted text for a message: ``'a', 'b', 3``; of a long list the first, as `series`."""
    return series((repr(name) for name in names), room)


def brief(text: str, room: int = 60) -> str:
    """Return a text, cut where it is longer than `room`."""
    return text if len(text) <= room else f"{text[: room - 3]}..."


def series(texts: Iterable[str], room: int = ROOM) -> str:
    """Return texts as a list for a message, ``a, b, c``; beyond `room` characters the rest is counted: ``a, b and 4 more``."""
    parts = list(texts)
    ends = accumulate(len(part) + 2 for part in parts)
    fit = max(1, sum(end <= room for end in ends))
    more = len(parts) - fit
    return ", ".join(parts) if more <= 0 else f"{', '.join(parts[:fit])} and {more} more"


def columned(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Return the lines of a table: the first `left` columns flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def number_of(text: str) -> float | None:
    """Return a text as a number; None for any other, and for digits grouped by underscores, which Python takes."""
    try:
        return None if "_" in text else float(text)
    except ValueError:
        return None


def counted(number: int, noun: str) -> str:
    """Return a count with its noun: ``1 column``, ``2 columns``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def joints_text(joints: Iterable[int]) -> str:
    """Return joints, numbered from 0, as text: ``joint 3``, ``joints 1, 2 and 6``; many as runs, ``joints 1 to 9 and 12``."""
    numbers = [int(joint) + 1 for joint in joints]
    names = [str(number) for number in numbers]
    if len(numbers) > MOST_JOINTS:
        starts = [k for k, number in enumerate(numbers) if k == 0 or number != numbers[k - 1] + 1]
        runs = [numbers[k:end] for k, end in zip(starts, [*starts[1:], None], strict=True)]
        names = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
        if len(names) == 1:
            return f"joints {names[0]}"
        if len(names) > MOST_RUNS:
            return f"joints {', '.join(names[:MOST_RUNS])} and {len(numbers) - sum(map(len, runs[:MOST_RUNS]))} more"
    return f"joint {names[0]}" if len(names) == 1 else f"joints {', '.join(names[:-1])} and {names[-1]}"


def one_line(text: str) -> str:
    """Return a text in one line, without the control characters that TOML forbids in comments."""
    return "".join(character if character.isprintable() else " " for character in " ".join(text.split()))


def printable(text: str) -> str:
    """Return a text without control characters, which a terminal would execute; line breaks and tabs stay."""
    return "".join(
        character
        if character.isprintable() or character in "\n\t"
        else character.encode("unicode_escape").decode()
        for character in text
    )


def percent_text(percent: float) -> str:
    """Return a percentage, with fewer decimals the larger it is."""
    if not math.isfinite(percent):
        return "-"
    size = abs(percent)
    return f"{percent:.{4 if size < 10.0 else 2 if size < 100.0 else 0}f}"
