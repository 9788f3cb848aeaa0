"""Figures of merit of studies: their numbers, their intervals, and what is made of them."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import PlotError, StudyError
from didim.monte_carlo.figures import Estimate, figures_of
from didim.monte_carlo.results import StudyResults
from didim.monte_carlo.rows import Rows
from didim.monte_carlo.text import estimate, number
from didim.plot.studies import cost, coverage, errors, varied_key
from didim.report import render

RNG = np.random.default_rng(5)
TRUTH = [1.0, -2.0, 0.5, 4.0]
STD = np.array([0.1, 0.2, 0.05, 0.4])


def rows_of(
    runs: int, rng: np.random.Generator, bias: float = 0.0, scale: float = 1.0, **changes: Any
) -> list[dict[str, Any]]:
    """Rows of a method whose errors are `scale` times as large as it says, with a bias in its standard deviations."""
    found = []
    for seed in range(runs):
        beta = np.array(TRUTH) + STD * (bias + scale * rng.standard_normal(4))
        found.append(
            {
                "id": f"{seed}-{rng.integers(1 << 60)}",
                "scenario": "s",
                "method": "m",
                "seed": seed,
                "status": "SOLVED",
                "sentence": "",
                "beta": beta.tolist(),
                "std": STD.tolist(),
                "factor": 1.96,
                "torque_error": float(rng.uniform(0.01, 0.03)),
                "simulations": 3,
                **changes,
            }
        )
    return found


def test_a_calibrated_method_has_no_bias_and_covers_95_percent() -> None:
    found = figures_of("s", "m", rows_of(400, np.random.default_rng(1)), TRUTH, [1.0, 3.0, 2.0])
    assert found.bias.low == 0.0
    assert found.bias.value < 0.1
    assert found.rms.low < 1.0 < found.rms.high
    assert found.rms.high - found.rms.low < 0.1
    assert found.coverage.low < 0.95 < found.coverage.high
    assert found.torque_error.low < 0.02 < found.torque_error.high
    assert found.torque_error_q95 == pytest.approx(0.029, abs=0.001)
    assert (found.runs, found.failed, found.not_converged, found.simulations, found.seconds) == (
        400,
        0,
        0,
        3,
        2,
    )


def test_bias_and_wrong_sigmas_are_told_apart() -> None:
    rng = np.random.default_rng(2)
    biased = figures_of("s", "m", rows_of(200, rng, bias=1.5), TRUTH, [])
    assert biased.bias.low < 1.5 < biased.bias.high
    assert biased.rms.value == pytest.approx(np.sqrt(1.0 + 1.5**2), abs=0.1)
    assert biased.coverage.high < 0.8
    wide = figures_of("s", "m", rows_of(200, rng, scale=3.0), TRUTH, [])
    assert wide.bias.low < 0.3
    assert wide.rms.low < 3.0 < wide.rms.high
    assert np.isnan(wide.seconds)
    # The mean estimate hides the scatter that every run has.
    assert wide.mean_error < 0.3 * wide.parameter_error.value


def test_intervals_hold_the_true_figure_in_95_percent_of_the_studies() -> None:
    rng = np.random.default_rng(3)
    studies = [figures_of("s", "m", rows_of(40, rng, bias=0.5), TRUTH, []) for _ in range(120)]
    truth = {"bias": 0.5, "rms": np.sqrt(1.25), "coverage": 0.9209, "torque_error": 0.02}
    for figure, true in truth.items():
        intervals = [getattr(study, figure) for study in studies]
        hits = sum(interval.low <= true <= interval.high for interval in intervals)
        assert 0.87 * 120 <= hits <= 120, (figure, hits)


def test_failures_are_counted_and_open_runs_judged() -> None:
    rng = np.random.default_rng(4)
    failed = [
        {"id": str(k), "scenario": "s", "method": "m", "seed": k, "status": status, "sentence": "x"}
        for k, status in enumerate(("FAILED", "ERROR", "LOST"))
    ]
    still = rows_of(2, rng, status="NOT_CONVERGED", std=[0.0] * 4)
    found = figures_of("s", "m", [*failed, *still, *rows_of(5, rng)], [*TRUTH[:3], None], [])
    assert (found.runs, found.failed, found.not_converged) == (10, 3, 2)
    assert np.isfinite(found.rms.value)
    none = figures_of("s", "m", failed, TRUTH, [])
    assert (none.runs, none.failed) == (3, 3)
    assert all(
        np.isnan(value)
        for value in (none.rms.value, none.coverage.value, none.torque_error.value, none.mean_error)
    )


def test_a_missing_sigma_is_neither_an_exact_estimate_nor_a_miss() -> None:
    rng = np.random.default_rng(8)
    runs = rows_of(300, rng, bias=1.0)
    whole = figures_of("s", "m", runs, TRUTH, [])
    # Half of the runs have no standard deviation of two of the parameters.
    gaps = [
        {**row, "std": [None, 0.0, *row["std"][2:]]} if number % 2 else row for number, row in enumerate(runs)
    ]
    found = figures_of("s", "m", gaps, TRUTH, [])
    for figure in ("bias", "rms", "coverage"):
        part, all_of_them = getattr(found, figure), getattr(whole, figure)
        assert part.low < all_of_them.value < part.high, figure
        assert part.value == pytest.approx(all_of_them.value, abs=0.06), figure
    # A parameter that no run has a standard deviation of does not count at all.
    never = figures_of("s", "m", [{**row, "std": [0.0, *row["std"][1:]]} for row in runs], TRUTH, [])
    assert never.rms.value == pytest.approx(whole.rms.value, abs=0.06)
    assert never.coverage.value == pytest.approx(whole.coverage.value, abs=0.04)


def test_one_run_has_no_intervals() -> None:
    found = figures_of("s", "m", rows_of(1, RNG), TRUTH, [])
    assert all(np.isnan(item.low) for item in (found.bias, found.rms, found.coverage, found.torque_error))
    assert estimate(found.rms) == number(found.rms.value)
    assert estimate(Estimate(0.5, 0.25, 1.0), 100.0, 1) == "50.0 [25.0, 100.0]"


def results(methods: int = 2) -> StudyResults:
    """Results on three noises, and on one scenario that has failures."""
    rng = np.random.default_rng(6)
    fits, truths, times = {}, {}, {}
    scenarios = [f"{noise} rad, fast" for noise in (1e-5, 1e-4, 1e-3)]
    for scenario, noise in zip(scenarios, (1e-5, 1e-4, 1e-3), strict=True):
        keys = {"measurement.position_noise_rad": noise, "simulation.rate_hz": 500}
        truths[scenario] = {
            "id": scenario,
            "keys": keys,
            "truth": TRUTH,
            "scenario": scenario,
            "status": "TRUTH",
        }
        for method in range(methods):
            for row in rows_of(8, rng):
                row.update(scenario=scenario, method=f"method {method}")
                fits[row["id"]] = row
                times[row["id"]] = {"id": row["id"], "seconds": 0.1 + method}
    lost = {
        "id": "x",
        "scenario": scenarios[0],
        "method": "method 0",
        "seed": 99,
        "status": "FAILED",
        "sentence": "no <robot>",
    }
    fits["x"] = lost
    return StudyResults(
        "noise",
        Rows(fits, truths, times=times),
        tuple(scenarios),
        tuple(f"method {k}" for k in range(methods)),
    )


def test_tables() -> None:
    study = results()
    text = str(study)
    assert text.startswith("noise: 49 runs, 1 failed\n\n1e-05 rad, fast\n")
    assert len([line for line in text.splitlines() if line.startswith(("  method 0", "  method 1"))]) == 6
    rows = list(csv.DictReader(io.StringIO(didim.formats.render(study, "csv"))))
    assert len(rows) == 6
    for row, item in zip(rows, study.figures, strict=True):
        assert (row["scenario"], row["method"], int(row["runs"])) == (item.scenario, item.method, item.runs)
        assert float(row["rms_low"]) == item.rms.low
    latex = didim.formats.render(study, "latex")
    assert latex.count(r"\\") == 7
    assert "1e-05 rad, fast & method 0 & $9$ & $1$" in latex
    markdown = didim.formats.render(study, "markdown")
    assert "| 1e-05 rad, fast | method 0 | 9 | 1 |" in markdown


@pytest.mark.slow
def test_chosen_columns_stand_in_every_table() -> None:
    study = results().with_columns("seconds", "torque error %", "rms")
    assert study.head == ("method", "seconds", "torque error %", "rms")
    assert next(line for line in str(study).splitlines() if "method" in line).split("  ")[1] == "method"
    assert r"\begin{tabular}{llrrr}" in didim.formats.render(study, "latex")
    page = render(study)
    assert "<th>method</th>" in page
    assert "coverage %" not in page.split("Figures of merit")[-1].split("</table>")[0]
    # All figures remain in the files for other programs.
    assert didim.formats.render(study, "csv") == didim.formats.render(results(), "csv")
    with pytest.raises(
        StudyError, match="there is no column 'coverag': there are 13 columns; did you mean 'coverage'"
    ):
        study.with_columns("coverag")


def test_parquet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = results()
    with monkeypatch.context() as patched:
        patched.setitem(__import__("sys").modules, "pyarrow", None)
        with pytest.raises(StudyError, match="pip install pyarrow"):
            study.write_parquet(tmp_path / "figures.parquet")
    parquet = pytest.importorskip("pyarrow.parquet")
    study.write_parquet(tmp_path / "figures.parquet")
    table = parquet.read_table(tmp_path / "figures.parquet")
    assert table.to_pydict() == study.columns()


def test_pictures_show_every_method() -> None:
    study = results(9)
    assert varied_key(study) == "measurement.position_noise_rad"
    for draw in (errors, coverage, cost):
        figure = draw(study)
        (legend,) = figure.legends
        assert [text.get_text() for text in legend.get_texts()] == list(study.methods)
    (panel,) = [ax for ax in errors(study).axes if ax.get_visible()]
    assert panel.get_title(loc="left") == "fast"
    assert panel.get_xlabel() == "measurement.position_noise_rad"
    points = np.asarray(panel.get_lines()[0].get_xydata(), dtype=np.float64)
    shown = [100.0 * f.torque_error.value for f in study.figures if f.method == "method 0"]
    np.testing.assert_allclose(points[:, 0], np.array([1e-5, 1e-4, 1e-3]))
    np.testing.assert_allclose(points[:, 1], np.array(shown))
    styles = {(line.get_color(), line.get_marker()) for line in cost(study).axes[0].get_lines()}
    assert len(styles) == 9


def test_logarithmic_axes_have_plain_numbers() -> None:
    """Mathematical text is not parsed in pictures: matplotlib's own labels would show their TeX."""
    study = results()
    for draw in (errors, cost):
        figure = draw(study)
        figure.draw_without_rendering()
        (panel,) = [ax for ax in figure.axes if ax.get_visible()]
        for axis in (panel.xaxis, panel.yaxis):
            labels = [label.get_text() for label in axis.get_ticklabels(which="both")]
            assert len([float(label) for label in labels if label]) >= 2


def test_scenarios_of_rows_alone_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    names = [f"signal.cutoff_hz = {value}" for value in ("1e-05", "0.002", "60", "200", "1e+3")]
    own: dict[str, Any] = {"method": None, "seed": None, "status": "TRUTH", "keys": {}, "truth": []}
    rows = [{"id": name, "scenario": name, **own} for name in names[::-1]]
    path = tmp_path / "rows.jsonl"
    path.write_text("".join(f"{json.dumps(row)}\n" for row in rows), encoding="utf-8")
    assert StudyResults.read(path).scenarios == tuple(names)


def test_pictures_of_nothing_are_refused() -> None:
    empty = StudyResults("empty", Rows(), (), ())
    for draw in (errors, coverage, cost):
        with pytest.raises(PlotError):
            draw(empty)
    with pytest.raises(PlotError, match=r"signal\.cutoff_hz has several values"):
        errors(results(), "signal.cutoff_hz")


@pytest.mark.slow
def test_the_report_has_tables_pictures_and_failures() -> None:
    page = render(results())
    assert page == render(results())
    assert page.count('<img class="picture"') == 3
    assert "no &lt;robot&gt;" in page
    assert "method 1" in page


def test_the_command_writes_reports_and_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    study = results()
    path = tmp_path / "rows.jsonl"
    lines = [
        *study.rows.fits.values(),
        *({**row, "method": None, "seed": None} for row in study.rows.truths.values()),
    ]
    path.write_text("".join(json.dumps(row) + "\n" for row in lines))
    (tmp_path / "rows.times.jsonl").write_text(
        "".join(json.dumps(row) + "\n" for row in study.rows.times.values())
    )
    assert main(["study", str(path), "--report", str(tmp_path / "study.html"), "--format", "csv"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 7
    assert main(["study", str(path), "--columns", "rms,seconds"]) == 0
    assert capsys.readouterr().out.splitlines()[3].split() == ["method", "rms", "seconds"]
    assert main(["study", "none.toml", "--columns", "rm"]) == 2
    assert "there is no column 'rm'" in capsys.readouterr().err
    assert "Calibration" in (tmp_path / "study.html").read_text()
