"""Studies: rows that do not depend on who makes them, failures that are rows, and studies that go on."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import StudyError
from didim.monte_carlo import worker
from didim.monte_carlo.logs import truth_of
from didim.monte_carlo.rows import RowFile, read_rows, times_path
from didim.monte_carlo.spec import read_study
from didim.monte_carlo.study import Progress, study
from didim.monte_carlo.tasks import tasks
from didim.monte_carlo.worker import run_task
from small_study import PLACE, small_study

SPEC = read_study(small_study(), PLACE)


def sorted_lines(path: Path) -> list[str]:
    return sorted(path.read_text().splitlines())


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rows of the small study."""
    path = tmp_path_factory.mktemp("study") / "rows.jsonl"
    study(SPEC, path, executor="serial")
    return path


def test_every_task_has_one_row(finished: Path) -> None:
    lines = [json.loads(line) for line in finished.read_text().splitlines()]
    assert [row["id"] for row in lines] == [task["id"] for task in tasks(SPEC)]
    assert {row["status"] for row in lines} == {"SOLVED", "TRUTH"}
    times = [json.loads(line) for line in times_path(finished).read_text().splitlines()]
    assert {row["id"] for row in times} == {row["id"] for row in lines}
    assert all(0.0 < row["seconds"] <= row["task_seconds"] for row in times if row["seconds"])


def test_a_row_is_what_identify_gives(finished: Path) -> None:
    rows = read_rows(finished)
    truth = rows.truths[SPEC.scenarios[0].name]
    (row,) = (
        item
        for item in rows.fits.values()
        if (item["scenario"], item["method"], item["seed"]) == (truth["scenario"], "filtered", 2)
    )
    robot = didim.load_robot("planar2")
    np.testing.assert_allclose(truth["truth"], robot.set_base("reference"), rtol=1e-11)
    assert truth["names"] == list(robot.base_parameters.names)
    off = (np.array(row["beta"]) - truth["truth"]) / row["std"]
    assert row["error_sigmas"] == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)
    assert row["coverage"] == pytest.approx(np.mean(np.abs(off) <= row["factor"]), rel=1e-9)
    assert row["rows"] == 2 * (401 - 3)
    assert 0.0 < row["torque_error"] < 0.05
    # The noise of the log has the size that the file says.
    np.testing.assert_allclose(truth["torque_noise"], [0.1, 0.05], rtol=0.15)
    assert truth["samples"] == 401


def test_scenarios_that_only_process_a_log_share_it_and_seeds_differ(finished: Path) -> None:
    keys = SPEC.scenarios[0].keys
    logs = [
        truth_of(SPEC.shared(), changes).noisy(seed).recordings[0].tau
        for changes, seed in (
            (keys, 0),
            ({**keys, "signal.cutoff_hz": 5, "model.controller.kv": 1}, 0),
            (keys, 1),
        )
    ]
    np.testing.assert_array_equal(logs[0], logs[1])
    assert np.all(logs[0] != logs[2])
    found = [row["beta"] for row in read_rows(finished).fits.values() if row["method"] == "idim-ls"]
    assert len({tuple(beta) for beta in found}) == len(found) == 6


def test_rows_do_not_depend_on_the_executor(finished: Path, tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    study(SPEC, path, executor="thread", workers=3)
    assert sorted_lines(path) == sorted_lines(finished)


def test_a_study_goes_on_where_it_was_interrupted(finished: Path, tmp_path: Path) -> None:
    lines = finished.read_text().splitlines()
    path = tmp_path / "rows.jsonl"
    path.write_text("\n".join([*lines[:5], lines[6][:40]]))
    seen: list[Progress] = []
    study(SPEC, path, executor="serial", progress=lambda state: seen.append(Progress(**vars(state))))
    assert sorted_lines(path) == sorted_lines(finished)
    assert (seen[0].earlier, seen[0].done, seen[-1].done, seen[-1].total) == (5, 6, 14, 14)
    before = path.read_bytes()
    study(SPEC, path, executor="serial", progress=seen.clear)  # type: ignore[arg-type]
    assert path.read_bytes() == before


def test_a_study_makes_damaged_and_edited_rows_again(finished: Path, tmp_path: Path) -> None:
    """The first line is the truth of a scenario, on which half of the table rests."""
    lines = finished.read_text().splitlines()
    edited = lines[4].replace('"status":"SOLVED"', '"status":"STOPPED"')
    assert edited != lines[4]
    path = tmp_path / "rows.jsonl"
    path.write_text("\n".join([lines[0][:-20], *lines[1:4], edited, *lines[5:]]) + "\n")
    results = study(SPEC, path, executor="serial")
    assert len(results.figures) == 4
    assert not results.missing()
    assert sorted(line for line in sorted_lines(path) if line in lines) == sorted(lines)
    assert results.rows.remarks == (
        "rows.jsonl: line 1 is no row (unfinished or damaged), dropped",
        "rows.jsonl: line 5 is not as written (digests differ), dropped",
    )


@pytest.mark.parametrize("name", ["study.toml", "notes.txt", "other.jsonl"])
def test_a_study_goes_on_with_its_own_file_only(
    name: str, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "study.toml"
    file.write_text(STUDY.format(experiment=small_study()["experiment"]), encoding="utf-8")
    (tmp_path / "notes.txt").write_text("notes of mine\nwithout an end", encoding="utf-8")
    (tmp_path / "other.jsonl").write_text(finished.read_text(), encoding="utf-8")
    before = (tmp_path / name).read_bytes()
    assert main(["study", str(file), "-o", str(tmp_path / name), "--executor", "serial", "--quiet"]) == 2
    out, err = capsys.readouterr()
    sentences = {
        "study.toml": "is read by the same command",
        "notes.txt": "this file holds no rows of a study",
        "other.jsonl": "its rows are of another study",
    }
    assert (out, err.count("\n")) == ("", 1)
    assert sentences[name] in err
    assert (tmp_path / name).read_bytes() == before


STUDY = """
schema = 1
experiment = {experiment!r}
parameters = "reference"
method = ["idim-ls"]
[repeat]
seeds = 1
"""


def test_a_larger_study_keeps_the_rows_that_it_has(finished: Path, tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text(finished.read_text())
    larger = read_study(small_study(seeds=4), PLACE)
    results = study(larger, path, executor="serial")
    assert len(path.read_text().splitlines()) == 14 + 4
    assert len(results.rows.fits) == 16


def test_failures_are_rows_with_their_sentence(tmp_path: Path) -> None:
    spec = read_study(
        small_study(
            seeds=1,
            method=[
                {"name": "idim-ls", "signal.trim_start": 100_000},
                {"name": "didim", "simulation.divergence": 1e-9},
            ],
        ),
        PLACE,
    )
    states: list[int] = []
    results = study(spec, executor="serial", progress=lambda state: states.append(state.failed))
    rows = [row for row in results.rows.fits.values() if row["method"].startswith("idim-ls")]
    assert [row["status"] for row in rows] == ["FAILED", "FAILED"]
    assert all("Error: " in row["sentence"] for row in rows)
    assert states[-1] >= 2


def test_an_unexpected_error_is_a_row_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **settings: object) -> None:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr(worker, "identify", broken)
    task = next(task for task in tasks(SPEC) if task["method"] is not None)
    result = run_task(task)
    row = {
        "id": task["id"],
        "scenario": task["scenario"]["name"],
        "method": "idim-ls",
        "seed": 0,
        "status": "ERROR",
        "sentence": "ZeroDivisionError: float division by zero",
    }
    assert json.loads(result["row"]) == worker.sealed(row)


def test_a_worker_of_another_version_ends_the_study() -> None:
    task = {**next(tasks(SPEC)), "version": "0.0.1"}
    with pytest.raises(StudyError, match=r"the study was made by didim 0\.0\.1"):
        run_task(task)


def test_wrong_models_are_judged_beside_the_truth() -> None:
    spec = read_study(
        small_study(
            seeds=2,
            grid={
                **small_study()["grid"],
                "measurement.torque_noise_n_m": [[0.01, 0.01]],
                "model.robot.joint.2.d_m": [0.5, 0.4],
            },
            method=["idim-ls"],
        ),
        PLACE,
    )
    results = study(spec, executor="serial")
    right, wrong = (
        [row["torque_error"] for row in results.of_pair(scenario, "idim-ls")]
        for scenario in results.scenarios
    )
    assert 1.5 * max(right) < min(wrong)


def test_starts_are_drawn_around_the_truth_and_settings_of_scenarios_reach_all_methods() -> None:
    spec = read_study(
        small_study(
            seeds=2,
            grid={**small_study()["grid"], "method.max_iterations": [1]},
            method=[{"name": "didim", "start": {"spread": 0.15}}],
        ),
        PLACE,
    )
    rows = list(study(spec, executor="serial").rows.fits.values())
    assert {(row["status"], row["iterations"]) for row in rows} == {("NOT_CONVERGED", 1)}
    assert len({tuple(row["beta"]) for row in rows}) == 4


def test_noise_in_the_loop_reaches_the_torque_as_the_controller_amplifies_it(tmp_path: Path) -> None:
    kp, kv = np.array([800.0, 300.0]), np.array([60.0, 10.0])
    (tmp_path / "arm.toml").write_text(
        """
schema = 1
robot = "planar2"
[reference]
kind = "fourier"
harmonics = 8
period_s = 2
max_position_rad = [1.5, 1.0]
max_velocity_rad_s = [3, 5]
max_acceleration_rad_s2 = [12, 20]
[controller]
kind = "pd"
kp = [800, 300]
kv = [60, 10]
[simulation]
rate_hz = 200
smoothing_rad_s = 0.05
[measurement]
position_noise_rad = 1e-5
"""
    )
    content = {
        "experiment": "arm.toml",
        "parameters": "reference",
        "method": "idim-ls",
        "repeat": {"seeds": 1},
    }
    spec = read_study({**content, "noise_in_loop_hz": 1000}, tmp_path / "study.toml")
    truth = truth_of(spec.shared(), spec.scenarios[0].keys)
    noisy, clean = truth.noisy(0).recordings[0], truth.clean.recordings[0]
    assert noisy.tau is not None
    assert clean.tau is not None
    # kv times the backward difference of white noise at 1 kHz, and kp times the noise itself, correlated with it.
    d, p = kv * 1000.0 * 1e-5, kp * 1e-5
    expected = np.sqrt((p + d) ** 2 + d**2)
    found = np.std(noisy.tau - clean.tau, axis=0)
    np.testing.assert_allclose(found, expected, rtol=0.12)
    np.testing.assert_allclose(np.std(noisy.q - clean.q, axis=0), 1e-5, rtol=0.12)
    assert not np.array_equal(truth.noisy(1).recordings[0].q, noisy.q)
    np.testing.assert_array_equal(truth.noisy(0).recordings[0].q, noisy.q)
    with pytest.raises(StudyError, match="must be a multiple of the 200 Hz of the log, got 300"):
        replace(truth, shared={**truth.shared, "noise_in_loop_hz": 300.0}).noisy(0)


def test_noise_in_the_loop_is_for_a_plain_pd() -> None:
    results = study(read_study(small_study(seeds=1, noise_in_loop_hz=1000), PLACE), executor="serial")
    rows = [*results.rows.fits.values()]
    assert {row["status"] for row in rows} == {"FAILED"}
    assert "needs position_noise in [measurement]" in rows[0]["sentence"]
    # Without a truth there are no figures, and the text says why.
    assert results.figures == ()
    assert "2 scenarios without the row of the truth" in str(results)
    assert "needs position_noise in [measurement]" in str(results)
    assert len(results.rows.done) == 6
    grid = {**small_study()["grid"], "measurement.position_noise_rad": [1e-5]}
    results = study(
        read_study(small_study(seeds=1, noise_in_loop_hz=1000, grid=grid), PLACE), executor="serial"
    )
    assert all("is for a continuous PD" in row["sentence"] for row in results.rows.fits.values())


def test_another_process_that_writes_is_noticed(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    path = tmp_path / "rows.jsonl"
    with closing(RowFile(path)), pytest.raises(StudyError, match="another process"):
        study(SPEC, path, executor="serial")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = small_study(seeds=1)
    lines = [f"{key} = {json.dumps(content[key])}" for key in ("experiment", "parameters", "refinement")]
    grid = [f"{json.dumps(key)} = {json.dumps(values)}" for key, values in content["grid"].items()]
    path = tmp_path / "arm.toml"
    path.write_text("\n".join([*lines, 'method = "idim-ls"', "[repeat]", "seeds = 2", "[grid]", *grid]))
    assert main(["study", str(path), "--executor", "serial"]) == 0
    captured = capsys.readouterr()
    assert "6 of 6 rows (4 runs), 0 failed" in captured.err
    rows = tmp_path / "arm.jsonl"
    before = rows.read_bytes()
    assert main(["study", str(path), "--executor", "serial", "--quiet"]) == 0
    again = capsys.readouterr()
    assert (again.out, again.err) == (captured.out, "")
    assert rows.read_bytes() == before
    assert main(["study", str(rows)]) == 0
    assert main(["study", str(path), str(path)]) == 2
    assert "give one study file" in capsys.readouterr().err
