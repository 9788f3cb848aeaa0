"""Study files: keys, grids, methods, and the message for a wrong one."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from didim.errors import DidimError, FitError, StudyError
from didim.methods.didim.didim import DIDIM
from didim.methods.idim_ls import IDIMLS
from didim.monte_carlo.keys import changed, parts_of
from didim.monte_carlo.logs import Truth
from didim.monte_carlo.spec import canonical, load_study, read_study
from didim.monte_carlo.study import check_study
from didim.monte_carlo.tasks import count, tasks
from didim.monte_carlo.text import HEAD
from didim.monte_carlo.worker import method_of
from plain import stub
from small_study import small_study


def test_a_grid_is_cartesian_and_times_named_scenarios() -> None:
    spec = read_study(
        small_study(
            grid={"signal.cutoff_hz": [20, 40], "controller.kp": [1, 2, 3], "simulation.rate_hz": [200]},
            scenario=[{"name": "a", "measurement.seed": 1}, {"name": "b", "robot.name": "x"}],
        )
    )
    assert len(spec.scenarios) == 12
    assert spec.scenarios[0].name == "a, signal.cutoff_hz = 20, controller.kp = 1"
    assert spec.scenarios[-1].keys == {
        "robot.name": "x",
        "signal.cutoff_hz": 40,
        "controller.kp": 3,
        "simulation.rate_hz": 200,
    }
    assert count(spec) == len(list(tasks(spec))) == 12 * (1 + 3 * 2)
    assert len({task["id"] for task in tasks(spec)}) == count(spec)


def test_keys_are_sorted_by_what_they_change() -> None:
    parts = parts_of(
        {
            "controller.kp": 1,
            "model.controller.gain": 0.7,
            "truth.robot.friction.coulomb": "sign",
            "signal.cutoff_hz": 20,
            "robot.joint.2.d_m": 0.4,
            "method.weights": "none",
        }
    )
    assert parts.truth == {"controller.kp": 1}
    assert parts.model == {"controller.kp": 1, "controller.gain": 0.7, "signal.cutoff_hz": 20}
    assert parts.truth_robot == {"friction.coulomb": "sign", "joint.2.d_m": 0.4}
    assert parts.model_robot == {"joint.2.d_m": 0.4}
    assert parts.method == {"weights": "none"}


def test_content_is_changed_in_a_copy() -> None:
    content = {"joint": [{"d_m": 1.0}, {"d_m": 0.5}], "controller": {"kp": [10, 20]}}
    made = changed(
        content,
        {
            "joint.2.d_m": 0.4,
            "controller.kp": {"times": 0.5},
            "friction.coulomb": "sign",
            "controller.kv": [1],
        },
        "arm.toml",
    )
    assert made == {
        "joint": [{"d_m": 1.0}, {"d_m": 0.4}],
        "controller": {"kp": [5.0, 10.0], "kv": [1]},
        "friction": {"coulomb": "sign"},
    }
    assert content == {"joint": [{"d_m": 1.0}, {"d_m": 0.5}], "controller": {"kp": [10, 20]}}
    assert changed(content, {"controller.kp": {"times": [2, 3]}}, "arm.toml")["controller"]["kp"] == [20, 60]


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"joint.3.d_m": 1}, "'3' must be a place from 1 to 2 in a list of arm.toml"),
        ({"name.x": 1}, "'name' is a value in arm.toml, and not a table"),
        ({"controller.kd": {"times": 2}}, "arm.toml has no 'controller.kd' to multiply"),
        ({"name": {"times": 2}}, "times multiplies a number of arm.toml by a number, not 'arm' by 2"),
        ({"controller.kp": {"times": [1, 2, 3]}}, "3 factors for 2 numbers"),
    ],
)
def test_wrong_keys_of_content(keys: dict[str, Any], sentence: str) -> None:
    content = {"name": "arm", "joint": [{}, {}], "controller": {"kp": [1, 2]}}
    with pytest.raises(StudyError) as caught:
        changed(content, keys, "arm.toml")
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"schema": 2}, "schema 2 is unknown"),
        ({"grids": {}}, "unknown key 'grids'; did you mean 'grid'?"),
        ({"grid": {"signal.cutoff_hz": 20}}, "[grid] signal.cutoff_hz must be a list of values, got 20"),
        ({"grid": {"signal.cutoff_hz": []}}, "must be a list of values"),
        ({"grid": {"signal.cutoff_hz": [20, 20]}}, "two entries of 'scenario' have the same name"),
        ({"scenario": [{"name": "a"}, {"name": "b"}]}, "two entries of 'scenario' have the same content"),
        ({"scenario": [{"signal.cutoff_hz": 3}]}, "a scenario needs a name"),
        (
            {"grid": {"signal.cutoff_hz": [20]}, "scenario": [{"name": "a", "signal.cutoff_hz": 3}]},
            "key 'signal.cutoff_hz' stands in [grid] and in scenario 'a'",
        ),
        ({"method": []}, "method must be a list of methods"),
        ({"method": ["didim", "didim"]}, "two entries of 'method' have the same name: 'didim'"),
        ({"method": [{"label": "x"}]}, "a method must be a name, or a table with a name"),
        ({"method": [{"name": "didim", "seeds": 0}]}, "seeds of method 'didim' must be a whole number from 1 to 10000000, got 0"),
        ({"repeat": {"seeds": 0}}, "[repeat] seeds must be at least 1"),
        ({"experiment": "emps.toml"}, "needs a [reference] of its own"),
        ({"grid": {"cutoff": [20]}}, "key 'cutoff' names no table"),
        ({"grid": {"truth.signal.cutoff_hz": [20]}}, "[signal] does not change a simulated log"),
        ({"grid": {"model.measurement.seed": [20]}}, "methods do not use the noise of a log"),
        ({"grid": {"truth.method.weights": ["none"]}}, "methods have settings on their own side only"),
        ({"grid": {"signal.cutof_hz": [20]}}, "scenario 'as the files are': planar2_simulation.toml: [signal] unknown key"),
        ({"grid": {"robot.joint.1.d_mm": [1]}}, "unknown key 'd_mm'; did you mean 'd_m'?"),
        ({"method": ["dodim"]}, "there is no method 'dodim'"),
        ({"method": [{"name": "didim", "wieghts": "none"}]}, "method 'didim' has no setting 'wieghts'; did you mean 'weights'?"),
        ({"method": [{"name": "didim", "signal": {}}]}, "signal cannot be set in a study"),
        ({"method": [{"name": "cloe", "start": {"spread": 2}}]}, "start.spread must be between 0 and 1, got 2"),
        ({"parameters": "none"}, "no parameter set 'none'"),
        ({"repeat": {"seeds": 1, "root": float("inf")}}, "holds a value that is not a text, a number or a table"),
    ],
)  # fmt: skip
def test_a_wrong_study_is_refused_before_the_work(change: dict[str, Any], sentence: str) -> None:
    place = Path(__file__).resolve().parents[1] / "examples" / "study.toml"
    with pytest.raises(DidimError) as caught:
        check_study(read_study(small_study(**change), place))
    assert sentence in str(caught.value)


def test_a_study_file_finds_its_experiment_beside_it(tmp_path: Path, project: Path) -> None:
    text = (project / "examples" / "planar2_simulation.toml").read_text()
    (tmp_path / "arm.toml").write_text(text)
    (tmp_path / "study.toml").write_text(
        'experiment = "arm.toml"\nparameters = "reference"\nmethod = "idim-ls"\n[repeat]\nseeds = 4\n'
    )
    spec = load_study(tmp_path / "study.toml")
    assert (spec.name, spec.files, spec.seeds, spec.root) == ("study", ("arm.toml", "planar2.toml"), 4, 0)
    assert [item.name for item in spec.scenarios] == ["as the files are"]
    with pytest.raises(StudyError, match="no such file"):
        load_study(tmp_path / "other.toml")


def test_methods_come_from_plain_data() -> None:
    method = method_of("didim", {"max_iterations": 5, "start": [1.0, 2.0]})
    assert isinstance(method, DIDIM)
    assert method.max_iterations == 5
    assert isinstance(method_of("idim-ls", {}), IDIMLS)
    drawn = method_of("didim", {"start": {"spread": 0.15}}, lambda spread: [spread])  # type: ignore[arg-type, return-value]
    assert isinstance(drawn, DIDIM)
    assert drawn.start == [0.15]
    with pytest.raises(FitError):
        method_of("didim", {"max_iterations": 0})


def test_logs_are_shared_by_scenarios_that_only_process_them() -> None:
    def drawn(keys: dict[str, Any], seed: int = 0, purpose: int = 0) -> list[int]:
        parts = parts_of(keys)
        truth: Any = stub(key=canonical([parts.truth, parts.truth_robot]), shared={"root": 7})
        return Truth.random_numbers(truth, seed, purpose).generate_state(2).tolist()  # type: ignore[no-any-return]

    log = drawn({"controller.kp": 1})
    assert log == drawn(
        {"controller.kp": 1, "signal.cutoff_hz": 20, "model.controller.kv": 2, "method.weights": "none"}
    )
    assert log != drawn({"controller.kp": 2})
    assert log != drawn({"controller.kp": 1}, seed=1)
    assert log != drawn({"controller.kp": 1}, purpose=1)
    assert drawn({"controller.kp": 1, "simulation.rate_hz": 2}) == drawn(
        {"simulation.rate_hz": 2, "controller.kp": 1}
    )


def test_the_example_of_the_page_is_a_study(project: Path) -> None:
    page = (project / "docs" / "studies.md").read_text(encoding="utf-8")
    text = page.partition("```toml\n")[2].partition("```")[0]
    spec = read_study(tomllib.loads(text))
    check_study(spec)
    assert len(spec.scenarios) == 6
    assert [(item.label, item.seeds) for item in spec.methods] == [
        ("idim-ls", None),
        ("DIDIM, 5 iterations", 20),
    ]


def test_the_page_explains_every_column(project: Path) -> None:
    page = (project / "docs" / "studies.md").read_text(encoding="utf-8")
    table = page.partition("## Figures of merit")[2]
    explained = {
        name.strip() for line in re.findall(r"^\| ([^|]+) \|", table, flags=re.M) for name in line.split(",")
    }
    assert explained >= set(HEAD) - {"method"}


@pytest.mark.slow
def test_the_benchmark_has_the_15_scenarios_and_one_more(project: Path) -> None:
    spec = load_study(project / "examples" / "study_tx40.toml")
    check_study(spec)
    assert len(spec.scenarios) == 16
    sampling = {
        (item.keys["simulation.rate_hz"], str(item.keys.get("signal.decimation"))) for item in spec.scenarios
    }
    assert sampling == {(500, "None"), (500, "[4]"), (100, "None")}
    noises = {
        (item.keys["measurement.position_noise_deg"], item.keys["measurement.torque_noise_n_m"])
        for item in spec.scenarios
    }
    assert noises == {(1e-4, 0.05), (1e-3, 0.05), (1e-3, 0.1), (1e-2, 0.05), (1e-2, 0.1)}
