"""The line of progress: on terminals and in notebooks after a moment, replaced, and gone at the end."""

from __future__ import annotations

import io
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import didim
from contract import noisy
from didim._tools import progress
from didim._tools.progress import WIDEST, ProgressLine, in_notebook
from didim.excitation.search import share_done
from test_study import SPEC


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "DELAY_S", 0.0)
    monkeypatch.setattr(progress, "EVERY_S", 0.0)


def test_a_terminal_shows_one_line(at_once: None, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    line = ProgressLine()
    line.show("one\ntwo")
    line.show("x" * 200)
    line.close()
    _, first, second, end = terminal.getvalue().split("\r\033[K")
    assert first == "one two"
    assert second == "x" * (WIDEST - 3) + "..."
    assert end == ""
    assert "\n" not in terminal.getvalue()


def test_short_work_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    line = ProgressLine()
    line.show("one")
    line.close()
    assert terminal.getvalue() == ""


def test_a_pipe_shows_nothing(at_once: None, capsys: pytest.CaptureFixture[str]) -> None:
    line = ProgressLine()
    line.show("one")
    line.close()
    assert capsys.readouterr() == ("", "")


def test_a_notebook_updates_one_output(at_once: None, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Any] = []
    handle = SimpleNamespace(update=shown.append)

    def display(item: Any, *, display_id: bool) -> Any:
        assert display_id
        shown.append(item)
        return handle

    module, inner = ModuleType("IPython"), ModuleType("IPython.display")
    shell = type("ZMQInteractiveShell", (), {})()
    module.get_ipython = lambda: shell  # type: ignore[attr-defined]
    inner.Pretty, inner.display = str, display  # type: ignore[attr-defined]
    assert not in_notebook() or "IPython" in sys.modules
    monkeypatch.setitem(sys.modules, "IPython", module)
    monkeypatch.setitem(sys.modules, "IPython.display", inner)
    assert in_notebook()
    line = ProgressLine()
    line.show("one")
    line.show("two")
    line.close()
    assert shown == ["one", "two", ""]


@pytest.mark.parametrize(("verbose", "expected"), [(None, True), (False, False)])
def test_identify_says_how_long_it_takes_at_most(
    at_once: None, monkeypatch: pytest.MonkeyPatch, *, verbose: bool | None, expected: bool
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    didim.identify(noisy(0), didim.DIDIM(physical=False), verbose=verbose)
    text = terminal.getvalue()
    assert ("iteration 1: relative error" in text) is expected
    assert (" s left" in text) is expected
    assert text.endswith("\r\033[K") is expected


@pytest.mark.parametrize(("verbose", "expected"), [(None, True), (False, False)])
def test_a_design_says_how_long_it_takes(
    at_once: None, monkeypatch: pytest.MonkeyPatch, *, verbose: bool | None, expected: bool
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    settings = didim.excitation.ExcitationSettings(duration_s=4.0, harmonics=4, iterations=10, starts=2)
    told: list[int] = []
    didim.excite("planar2", settings, progress=lambda start, *_: told.append(start), verbose=verbose)
    assert {*told} == {1, 2}
    text = terminal.getvalue()
    assert ("excite: 100 %, criterion " in text) is expected
    assert ("about 0 s left" in text) is expected
    assert text.endswith("\r\033[K") is expected


def test_the_share_of_a_design_grows_to_one() -> None:
    shares = [share_done(evaluations, 100) for evaluations in range(0, 600, 10)]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert 0.7 < share_done(356, 100) < 0.9  # before the last descent, which takes longer for each evaluation
    assert share_done(386, 100) == shares[-1] == 1.0


@pytest.mark.parametrize(("verbose", "expected"), [(None, True), (False, False)])
def test_a_study_says_how_long_it_takes(
    at_once: None, monkeypatch: pytest.MonkeyPatch, *, verbose: bool | None, expected: bool
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    results = didim.study(SPEC, executor="serial", verbose=verbose)
    assert results.rows
    text = terminal.getvalue()
    assert ("study: 1 of " in text) is expected
    assert text.endswith("\r\033[K") is expected


def test_verbose_lines_fit_100_columns(capsys: pytest.CaptureFixture[str]) -> None:
    """The conclusion of DIDIM is longer than a line: it wraps, and no word is lost."""
    fit = didim.identify(noisy(0), didim.DIDIM(physical=False), verbose=True)
    text = capsys.readouterr().err
    assert max(map(len, text.splitlines())) <= 100
    assert fit.conclusion in " ".join(text.split())
