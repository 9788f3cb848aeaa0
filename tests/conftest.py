"""Shared by all tests: where the measured data are, and one line on what their absence skips."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

# Test processes share the cores already: the threads of a matrix product would wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# pytest-xdist tells its processes the width of the terminal, and the commands under test would follow it.
os.environ.pop("COLUMNS", None)

import pytest
from hypothesis import HealthCheck, settings

# No test times anything, those of hypothesis neither: a loaded machine is slow.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

PROJECT = Path(__file__).resolve().parent.parent
SHARED = PROJECT.parent / "shared"
SKIP_REASON = "needs ../shared"


@pytest.fixture(scope="session")
def project() -> Path:
    """Root of the project: examples, docs."""
    return PROJECT


@pytest.fixture(scope="session")
def shared() -> Path:
    """Measured data and reference tables, beside the project; the test is skipped where they are absent."""
    if not SHARED.is_dir():
        pytest.skip(SKIP_REASON)
    return SHARED


@pytest.fixture(scope="module")
def without_causes() -> Iterator[None]:
    """Look for no causes of a residual that lasts, which takes longer than the fit; for tests that read no verdict."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("didim.evidence.judge.explained", lambda rows, measured, fit: [])
        yield


def _unjudged() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("didim.methods.identify.judged", lambda fit, *arguments, **options: fit)
        for name in ("measured_along", "law_along"):
            patch.setattr(f"didim.methods.identify.{name}", lambda fit, experiment, method, *rows: None)
        yield


@pytest.fixture(scope="module")
def without_verdict() -> Iterator[None]:
    """Judge no result of a module, which takes as long as the fit; for tests that read neither evidence nor verdict."""
    yield from _unjudged()


@pytest.fixture
def unjudged() -> Iterator[None]:
    """Judge no result in one test, as `without_verdict` in a module."""
    yield from _unjudged()


@pytest.fixture
def without_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Test no residual for missing friction, which takes twice as long as least squares; for tests of parameters and of noise."""
    monkeypatch.setattr(
        "didim.methods.builder._with_model_errors", lambda run, system, fit, parts, spread: spread
    )


@pytest.fixture
def without_laws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Try no friction laws for a draft of `didim init`, which takes longer than reading the log; for tests of what is read."""

    from didim.errors import FitError

    def untried(*_: object) -> None:
        raise FitError("not in this test")

    monkeypatch.setattr("didim.experiment.draft.fitted_friction", untried)


@pytest.fixture
def without_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the figures and embed an empty picture of each: their layout takes most of the time, for tests that read the text."""
    monkeypatch.setattr("didim.report.page.svg", lambda figure: "<svg/>")


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Hear Ctrl-C: a shell that runs tests in the background may have it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in one line how many tests were skipped for want of ../shared, so that none goes unnoticed."""
    skipped = [
        report for report in terminalreporter.stats.get("skipped", []) if SKIP_REASON in str(report.longrepr)
    ]
    if skipped:
        what = "1 test was" if len(skipped) == 1 else f"{len(skipped)} tests were"
        terminalreporter.write_line(f"{what} skipped because ../shared is absent")
