"""Tasks of a study: plain data for any process, each with an id that identifies its row.

Tested in ``tests/test_study.py``.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Any

from .._tools.version import __version__
from .spec import MethodSpec, Scenario, StudySpec, canonical, digest

Task = dict[str, Any]
"""Keys: ``id``, ``version``, ``scenario``, ``method``, ``seed``; ``shared`` is common to all tasks and has a ``digest``;
``folders`` are searched for the user's own modules."""


CHUNK = 10
"""Number of consecutive seeds of one scenario before those of the next."""


def tasks(spec: StudySpec) -> Iterator[Task]:
    """Return the tasks of a study: one for the truth of each scenario, and one for each scenario, seed and method.

    The first seeds of all scenarios precede later seeds, so an interrupted study has rows of every scenario. The methods of one
    seed are consecutive, because they share its log.
    """
    text = canonical(spec.shared())
    common = {
        "version": __version__,
        "digest": digest(text),
        "folders": list(spec.folders),
        "shared": zlib.compress(text.encode(), 9),
    }
    for scenario in spec.scenarios:
        yield _task(common, scenario, None, None)
    for first in range(0, spec.seeds, CHUNK):
        for scenario in spec.scenarios:
            for seed in range(first, min(first + CHUNK, spec.seeds)):
                for method in spec.methods:
                    if seed < (method.seeds or spec.seeds):
                        yield _task(common, scenario, method, seed)


def _task(common: Task, scenario: Scenario, method: MethodSpec | None, seed: int | None) -> Task:
    what = None if method is None else [method.name, method.settings, method.keys]
    # Everything that determines a row; names and labels do not.
    determined = [common["version"], common["digest"], scenario.keys, what, seed]
    return {
        **common,
        "id": digest(canonical(determined)),
        "scenario": vars(scenario),
        "method": None if method is None else vars(method),
        "seed": seed,
    }


def count(spec: StudySpec) -> int:
    """Count the tasks of a study."""
    per_scenario = sum(min(spec.seeds, method.seeds or spec.seeds) for method in spec.methods)
    return len(spec.scenarios) * (1 + per_scenario)
