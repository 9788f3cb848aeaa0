"""Checks of settings: what they take, and the one wording of each fault."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from didim._tools.keys import Keys
from didim._tools.settings import check_declared, one_of, positive, share, whole
from didim.errors import FitError
from tables import row


def test_what_is_taken() -> None:
    assert whole("n", np.int64(3), FitError, least=0, most=3) == 3
    assert type(whole("n", np.int64(3), FitError)) is int
    assert share("s", 1, FitError) == 1.0
    assert share("s", np.float64(0.5), FitError, inside=True) == 0.5
    assert positive("f", np.float32(2.0), FitError) == 2.0
    one_of("b", True, (True, False), FitError)
    one_of("k", "two", ("one", "two"), FitError)
    one_of("k", None, ("one", None), FitError)


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: whole("n", 4.0, FitError), "n must be a whole number, got 4.0"),
        (lambda: whole("n", True, FitError, least=0), "n must be a whole number of at least 0, got True"),
        (lambda: whole("n", -1, FitError, least=0), "n must be a whole number of at least 0, got -1"),
        (lambda: whole("n", 11, FitError, least=1, most=10), "n must be a whole number from 1 to 10, got 11"),
        (lambda: share("s", 1.01, FitError), "s must be between 0 and 1, got 1.01"),
        (lambda: share("s", 0.0, FitError, inside=True), "s must be between 0 and 1, got 0.0"),
        (lambda: share("s", float("nan"), FitError), "s must be between 0 and 1, got nan"),
        (lambda: share("s", True, FitError), "s must be between 0 and 1, got True"),
        (lambda: share("s", 10**400, FitError), f"s must be between 0 and 1, got 1{'0' * 56}..."),
        (lambda: positive("s", 10**400, FitError), f"s must be a positive number, got 1{'0' * 56}..."),
        (lambda: share("s", 0.1, FitError, most=0.025), "s must be between 0 and 0.025, got 0.1"),
        (lambda: positive("f", 0.0, FitError, "frequency"), "f must be a positive frequency, got 0.0"),
        (lambda: positive("f", float("inf"), FitError), "f must be a positive number, got inf"),
        (lambda: one_of("k", "x", ("a", "b", "c"), FitError), "k must be 'a', 'b' or 'c', got 'x'"),
        (lambda: one_of("b", 1, (True, False), FitError), "b must be True or False, got 1"),
        (lambda: one_of("k", [], ("a",), FitError), "k must be 'a', got []"),
    ],
)  # fmt: skip
def test_what_is_refused(check: Callable[[], Any], message: str) -> None:
    with pytest.raises(FitError, match=rf"^{re.escape(message)}$"):
        check()


DECLARED = Keys(
    {
        "file": {
            "n": row("n", "integer", minimum=1, maximum=9),
            "cutoff_hz": row("cutoff_hz", "number", above=0.0),
            "kind": row("kind", "text", choices=["a", "b"]),
        }
    }
)


@dataclass(frozen=True)
class Settings:
    n: Any = 1
    cutoff_hz: Any = None
    kind: Any = "a"
    other: Any = None

    def __post_init__(self) -> None:
        check_declared(self, DECLARED, FitError)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n": 10}, "n must be a whole number from 1 to 9, got 10"),
        ({"n": None}, "n must be a whole number from 1 to 9, got None"),
        ({"cutoff_hz": 0.0}, "cutoff_hz must be a positive frequency, got 0.0"),
        ({"kind": None}, "kind must be 'a' or 'b', got None"),
    ],
)
def test_fields_have_the_bounds_of_their_keys(settings: dict[str, Any], message: str) -> None:
    assert type(Settings(n=np.int64(3)).n) is int
    assert Settings(other=-1).cutoff_hz is None
    with pytest.raises(FitError, match=rf"^{re.escape(message)}$"):
        Settings(**settings)
