"""No message is longer than 200 characters, with the names, lists and numbers of a robot with many joints in it (`longest`)."""

from __future__ import annotations

import pytest

from didim._tools.words import ROOM, joints_text, listing, series
from didim.result.finding import Finding
from didim.result.sentences import two_digits
from didim.result.words.causes import CAUSES
from longest import ENTRIES, LENGTHS, SOURCES, Module, modules

LONGEST = 200
"""Largest number of characters of a message; a finding has a sentence and a remedy, each of them one."""
CAPTIONS = "report"
"""Package whose texts are captions of several sentences under pictures; each sentence counts."""


def too_long(module: Module) -> list[str]:
    """Return the messages of a module that are too long; of captions, the sentences."""
    captions = module.path.parent.name == CAPTIONS
    return [
        f"line {line}, {length} characters: {text}"
        for line, length, text in module.texts
        if length > LONGEST and not (captions and max(map(len, text.split(". "))) <= LONGEST)
    ]


def test_no_message_is_too_long() -> None:
    long = {str(path.relative_to(SOURCES)): too_long(module) for path, module in modules().items()}
    assert not {path: lines for path, lines in long.items() if lines}


@pytest.mark.parametrize("last", ["' and ends'", "more", "'' if a else more", "series(a, 1)", "', '.join(a)"])
def test_a_long_message_is_found(last: str) -> None:
    start = "x" * (LONGEST - 5)
    source = f"def say(a):\n    more = ' and ends'\n    raise ValueError(f'{start}' + ({last}))\n"
    assert len(too_long(Module(SOURCES / "errors.py", source))) == 1
    assert not too_long(
        Module(SOURCES / "errors.py", source.replace(last, "more[:5]").replace(start, start[5:]))
    )


def test_lists_names_and_functions_have_their_longest_text() -> None:
    source = (
        "def said(names: list[str], path: str) -> str:\n"
        "    return f\"{path}: {', '.join(names)}\" if names else 'none'\n"
        "def shown(value: float) -> str:\n"
        "    return f'{said([], value):.3g} {said(value)!r}'\n"
    )
    module = Module(SOURCES / "errors.py", source)
    list_of_names = ENTRIES * (LENGTHS["name"] + len(", "))
    assert {length for _, length, _ in module.texts} == {LENGTHS["path"] + 2 + list_of_names, 4, 9 + 1 + 12}


def test_lists_in_messages_are_short() -> None:
    names = [f"shoulder_pan_joint_{k}" for k in range(40)]
    assert series(names[:2]) == "shoulder_pan_joint_0, shoulder_pan_joint_1"
    assert series(names).endswith(" and 35 more")
    assert max(len(series(names)), len(listing(names))) <= ROOM + len(" and 35 more")
    assert series(["x" * 300, "y"]) == "x" * 300 + " and 1 more"
    assert joints_text([0, 1, 5]) == "joints 1, 2 and 6"
    assert joints_text(range(12)) == "joints 1 to 12"
    assert joints_text([*range(9), 11]) == "joints 1 to 9 and 12"


@pytest.mark.parametrize("code", CAUSES)
@pytest.mark.parametrize("n_ties", [0, 2])
def test_sentences_of_causes_are_short(code: str, n_ties: int) -> None:
    declared = {"gravity": [0.0, 0.0, -9.81], "link-length": 0.4567, "unit": "rad"}
    facts: dict[str, object] = {
        "left": 0.0123,
        "blocks": 10,
        "keys": ["position", "torque"],
        "side": "joint",
        "declared": declared.get(code, "motor"),
        "unit": "deg",
        "row": 6,
        "symbol": "r",
        "robot": "planar2",
        "vector": [-1.23, 4.56, -7.89],
    }
    joints = (1, 2) if "swapped" in code else (6,)
    tie = {"code": code, "joints": list(joints), "value": 1.234, "facts": facts}
    item = Finding(
        code=code, grade="doubtful", joints=joints, value=1.234, facts={**facts, "ties": [tie] * n_ties}
    )
    assert len(item.sentence) <= LONGEST
    assert all(len(part) <= LONGEST for part in item.advice.split(". "))


def test_numbers_have_two_digits_and_no_powers_of_ten() -> None:
    assert [two_digits(value) for value in (0.0123, 9.87, 93.2, 99.7, 1234.5)] == [
        "0.012",
        "9.9",
        "93",
        "100",
        "1234",
    ]
