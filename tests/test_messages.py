"""No message is longer than 200 characters: sentences are built from the sources, with texts of usual length in their places."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

import didim
from didim._tools.words import ROOM, joints_text, listing, series
from didim.result.finding import Finding
from didim.result.sentences import two_digits
from didim.result.words.causes import CAUSES

LONGEST = 200
"""Largest number of characters of a message; a finding has a sentence and a remedy, each of them one."""
USUAL = {"name": 20, "path": 30, "text": 40}
"""Number of characters of a place in a sentence, by its variable; 10 for any other."""
CAPTIONS = "report"
"""Package whose texts are captions of several sentences under pictures; each sentence counts."""
SOURCES = Path(didim.__file__).parent

Names = Mapping[str, Sequence[ast.expr]]


def longest(node: ast.expr, names: Names) -> str:
    """Return the longest text of an expression; `names` has the values of local names."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(longest(part, names) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return longest(node.value, names)
    if isinstance(node, ast.IfExp):
        return max(longest(node.body, names), longest(node.orelse, names), key=len)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return longest(node.left, names) + longest(node.right, names)
    if isinstance(node, ast.Name):
        others = {name: values for name, values in names.items() if name != node.id}
        return max(
            (longest(value, others) for value in names.get(node.id, ())),
            key=len,
            default="x" * USUAL.get(node.id, 10),
        )
    return "x" * 10


def assigned(scope: ast.AST) -> dict[str, list[ast.expr]]:
    """Return the values given to each name."""
    found: dict[str, list[ast.expr]] = {}
    for node in ast.walk(scope):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found.setdefault(node.targets[0].id, []).append(node.value)
    return found


def texts(node: ast.AST, names: Names) -> Iterator[tuple[int, str]]:
    """Yield line and longest text of each expression that is one; docstrings are none."""
    if isinstance(node, ast.FunctionDef):
        names = assigned(node)
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return
    if isinstance(node, (ast.JoinedStr, ast.BinOp, ast.Constant)):
        yield node.lineno, longest(node, names)
        if not isinstance(node, ast.BinOp):
            return
    for child in ast.iter_child_nodes(node):
        yield from texts(child, names)


def too_long(source: str, captions: bool = False) -> list[str]:
    """Return the messages of a module that are too long; a text of several lines is not a message."""
    found = [(line, text) for line, text in texts(ast.parse(source), {}) if "\n" not in text]
    parts = [(line, part) for line, text in found for part in (text.split(". ") if captions else [text])]
    return [f"line {line}, {len(text)} characters: {text}" for line, text in parts if len(text) > LONGEST]


def test_no_message_is_too_long() -> None:
    found = {
        str(path.relative_to(SOURCES)): long
        for path in sorted(SOURCES.rglob("*.py"))
        if (long := too_long(path.read_text(encoding="utf-8"), path.parent.name == CAPTIONS))
    }
    assert not found


@pytest.mark.parametrize("last", ["' and ends'", "more", "'' if a else more"])
def test_a_long_message_is_found(last: str) -> None:
    start = "x" * (LONGEST - 5)
    source = f"def say(a):\n    more = ' and ends'\n    raise ValueError(f'{start}' + ({last}))\n"
    assert len(too_long(source)) == 1
    assert not too_long(source.replace(start, start[:-5]))


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
