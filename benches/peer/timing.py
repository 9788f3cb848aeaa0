"""Alternating rounds: each round measures each contestant once, so that a machine that slows down slows all of them."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass


class MissingError(Exception):
    """A program, a compiler or data are absent; the message is one sentence."""


class DisagreementError(Exception):
    """A peer computes something else than ours, so that its time would mean nothing."""


@dataclass(frozen=True, kw_only=True)
class Contestant:
    """What is measured.

    Attributes
    ----------
    name : str
        As in the table.
    measure : callable
        Does the work once and returns what it took, in `unit`.
    unit : str
        ``us``, ``s`` or ``MB``.
    rounds : int
        It takes part in so many rounds.
    """

    name: str
    measure: Callable[[], float]
    unit: str
    rounds: int


@dataclass(frozen=True)
class Figures:
    """What the rounds gave."""

    unit: str
    rounds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Middle of the rounds."""
        return statistics.median(self.rounds)

    @property
    def smallest(self) -> float:
        """What the work takes when nothing else runs."""
        return min(self.rounds)

    @property
    def spread(self) -> tuple[float, float]:
        """First and third quartile."""
        if len(self.rounds) < 2:
            return self.rounds[0], self.rounds[0]
        first, _, third = statistics.quantiles(self.rounds, n=4, method="inclusive")
        return first, third


def per_unit(run: Callable[[], object], units: int) -> Callable[[], float]:
    """Microseconds per unit of a call that does `units` of them."""

    def measure() -> float:
        start = time.perf_counter()
        run()
        return 1e6 * (time.perf_counter() - start) / units

    return measure


def seconds(run: Callable[[], object]) -> Callable[[], float]:
    """Seconds of a call."""

    def measure() -> float:
        start = time.perf_counter()
        run()
        return time.perf_counter() - start

    return measure


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process, and those that it starts, on one core, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        raise MissingError("this system cannot keep a process on one core.")
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def alternate(contestants: Sequence[Contestant]) -> dict[str, Figures]:
    """Measure all contestants round by round, after a round that warms up what takes less than a second."""
    times: dict[str, list[float]] = {contestant.name: [] for contestant in contestants}
    for contestant in contestants:
        if contestant.unit == "us":
            contestant.measure()
    for round_ in range(max((contestant.rounds for contestant in contestants), default=0)):
        for contestant in contestants:
            if round_ < contestant.rounds:
                times[contestant.name].append(contestant.measure())
    return {
        contestant.name: Figures(contestant.unit, tuple(times[contestant.name])) for contestant in contestants
    }
