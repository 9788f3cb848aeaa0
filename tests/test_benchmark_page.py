"""The page of the benchmark has the tables of its figures, and one of its runs comes out as it says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from didim.monte_carlo.logs import truth_of
from didim.monte_carlo.spec import load_study
from didim.monte_carlo.tasks import tasks
from didim.monte_carlo.worker import run_task
from scripts import script


def test_the_tables_are_those_of_the_figures(project: Path) -> None:
    page = (project / "docs" / "choose.md").read_text(encoding="utf-8")
    bench = script(project / "benches" / "benchmark_page.py")
    made = bench.tables(bench.read(project / "docs" / "benchmark.csv"))
    assert len(made) == 2
    for table in made:
        assert table in page
    spec = load_study(project / "examples" / "study_tx40.toml")
    rows = bench.read(project / "docs" / "benchmark.csv")
    assert {row["scenario"] for row in rows} == {item.name for item in spec.scenarios}
    assert {row["method"] for row in rows} == {item.label for item in spec.methods}
    assert min(int(row["runs"]) for row in rows) >= 5


def test_the_noise_of_the_torque_is_as_the_page_says(project: Path) -> None:
    spec = load_study(project / "examples" / "study_tx40.toml")
    page = (project / "docs" / "choose.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| (1e-\d) \| ([^|]+) \| ([^|]+) \|$", page, flags=re.M)
    assert len(table) == 3
    for level, noise, ratio in table:
        (scenario,) = (item for item in spec.scenarios if item.name == f"{level} deg, 0.05 N.m, 500 Hz")
        truth = truth_of(spec.shared(), scenario.keys)
        clean, noisy = truth.clean.recordings[0].tau, truth.noisy(0).recordings[0].tau
        assert clean is not None
        assert noisy is not None
        found = np.sqrt(np.mean((noisy - clean) ** 2, axis=0))
        np.testing.assert_allclose(found, [float(text) for text in noise.split(",")], rtol=0.06)
        size = np.sqrt(np.mean(clean**2, axis=0))
        np.testing.assert_allclose(size / found, [float(text) for text in ratio.split(",")], rtol=0.06)


@pytest.mark.slow
def test_cloe_is_far_more_accurate_until_the_gains_are_wrong(project: Path) -> None:
    spec = load_study(project / "examples" / "study_tx40.toml")
    names = (
        "1e-3 deg, 0.05 N.m, 500 Hz, decimated by 4",
        "1e-3 deg, 0.05 N.m, 500 Hz, decimated by 4, gains 10 % low",
    )
    found = {}
    for task in tasks(spec):
        if (
            task["seed"] == 0
            and task["scenario"]["name"] in names
            and task["method"]["label"] in ("DIDIM", "CLOE")
        ):
            row = json.loads(run_task(task)["row"])
            found[row["method"], names.index(row["scenario"])] = (row["torque_error"], row["coverage"])
    assert found["CLOE", 0][0] < found["DIDIM", 0][0] / 20.0
    assert found["CLOE", 0][1] > 0.9
    assert found["CLOE", 1][0] == pytest.approx(0.10, abs=0.01)
    assert found["CLOE", 1][1] < 0.3
    assert found["DIDIM", 1][0] == pytest.approx(found["DIDIM", 0][0], rel=0.1)
    assert min(found["DIDIM", 0][1], found["DIDIM", 1][1]) > 0.9
