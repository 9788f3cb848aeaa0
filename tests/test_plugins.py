"""A method, a solver and a friction law of a stranger, each one file outside the package, by "module:name"."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import didim
from didim._tools.plugins import places, source_digest
from didim.cli.main import main
from didim.errors import FitError, RobotError, StudyError
from didim.methods.table import METHODS, title_of
from didim.monte_carlo.spec import load_study
from didim.monte_carlo.study import study
from didim.monte_carlo.tasks import tasks
from didim.monte_carlo.worker import run_task
from didim.robot.robot_text import robot_text
from small_study import EXAMPLES
from test_cli import arm as arm_fixture
from test_cli import identify_arm

arm = arm_fixture

STUDY = """
schema = 1
experiment = "planar.toml"
parameters = "reference"
refinement = 1
method = ["idim-ls", "stranger_method:Ordinary"]

[grid]
"simulation.duration_s" = [2.0]
"simulation.rate_hz" = [200]
"simulation.step_s" = [0.002]
"simulation.fine_step_s" = [0.002]

[repeat]
seeds = 2
"""
LAW = """
[[friction.law]]
name = "Fq"
joints = [2]
function = "stranger_law:quadratic"
fastest_rad_s = 8.0
"""


@pytest.fixture
def stranger(tmp_path: Path, project: Path) -> Iterator[Path]:
    """Folder with the method of CONTRIBUTING.md, a friction law, a solver, and a study of an arm with the law."""
    text = (project / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    (tmp_path / "stranger_method.py").write_text(code, encoding="utf-8")
    law = "import numpy as np\n\n\ndef quadratic(dq):\n    return dq * np.abs(dq)\n"
    (tmp_path / "stranger_law.py").write_text(law, encoding="utf-8")
    solver = (project / "examples" / "least_absolute.py").read_text(encoding="utf-8")
    (tmp_path / "stranger_solver.py").write_text(solver, encoding="utf-8")
    experiment = (EXAMPLES / "planar2_simulation.toml").read_text(encoding="utf-8")
    assert "\n[friction" not in experiment
    experiment = re.sub(r"^robot = .*$", 'robot = "arm_with_law.toml"', experiment, flags=re.MULTILINE)
    (tmp_path / "planar.toml").write_text(experiment, encoding="utf-8")
    robot = robot_text(didim.load_robot("planar2")).replace("Off2 =", "Fq2 = 0.3\nOff2 =") + LAW
    (tmp_path / "arm_with_law.toml").write_text(robot, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    path, modules = list(sys.path), set(sys.modules)
    yield tmp_path
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        if name.startswith("stranger"):
            del sys.modules[name]


def test_the_method_of_contributing_is_a_method(
    stranger: Path, arm: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(stranger)
    log = didim.load_experiment(arm, data=arm.parent / "data")
    fit, plain = didim.identify(log, "stranger_method:Ordinary"), didim.identify(log, didim.IDIMLS)
    # Sums of products are rounded as the places of their arrays in memory have it.
    np.testing.assert_allclose(fit.beta, plain.beta, rtol=1e-12)
    np.testing.assert_allclose(fit.covariance, plain.covariance, rtol=1e-11)
    assert identify_arm(arm, "--method", "stranger_method:Ordinary") == 0
    assert capsys.readouterr().out == f"{fit}\n"
    assert identify_arm(arm, "--solver", "stranger_solver:LeastAbsolute") == 0
    assert "Fv1" in capsys.readouterr().out


def test_the_hypothesis_of_contributing_runs(project: Path) -> None:
    text = (project / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (block,) = re.findall(r'^    """Two motors that share.*?(?=^\S)', text, flags=re.DOTALL | re.MULTILINE)
    code = dedent(block).replace("from ..products", "from didim.evidence.products")
    code = code.replace("from .hypothesis", "from didim.evidence.hypotheses.hypothesis")
    names: dict[str, Any] = {}
    exec(compile(code, "CONTRIBUTING.md", "exec"), names)
    found = list(names["halved"](SimpleNamespace(n=3)))
    assert [(item.code, item.joints) for item in found] == [
        ("shared-drive", (1, 2)),
        ("shared-drive", (2, 3)),
    ]
    assert found[1].factors.tolist() == [1.0, 0.5, 0.5]


def test_it_is_compared_with_the_others(
    stranger: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(stranger)
    command = ["compare", "--experiment", "planar.toml", "--parameters", "reference", "--json", "out.json"]
    assert main([*command, "--method", "idim-ls", "--method", "stranger_method:Ordinary"]) == 0
    assert "ordinary" in capsys.readouterr().out
    saved = json.loads(Path("out.json").read_text())["methods"]
    assert list(saved) == ["idim-ls", "ordinary"]
    (first, second) = ([item["value"] for item in fit["parameters"]] for fit in saved.values())
    assert first == second


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["process", "dask"])
def test_a_study_runs_method_and_law_in_other_processes(stranger: Path, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed")
    spec = load_study(stranger / "study.toml")
    found: dict[str, list[str]] = {}
    for name in ("serial", executor):
        study(spec, stranger / f"{name}.jsonl", executor=name, workers=2, verbose=False)
        found[name] = sorted((stranger / f"{name}.jsonl").read_text().splitlines())
    assert found["serial"] == found[executor]
    rows = [json.loads(line) for line in found[executor]]
    fits = [row for row in rows if row["method"] is not None]
    assert {row["method"] for row in fits} == {"idim-ls", "stranger_method:Ordinary"}
    assert all(row["status"] == "SOLVED" for row in fits)
    (truth,) = {tuple(row["names"]) for row in rows if row["method"] is None}
    assert "Fq2" in truth


def test_rows_depend_on_the_source_of_the_method(stranger: Path) -> None:
    source = stranger / "stranger_method.py"
    source.write_text(source.read_text() + "# seen by no worker yet\n")
    before = {task["id"] for task in tasks(load_study(stranger / "study.toml"))}
    first = next(iter(tasks(load_study(stranger / "study.toml"))))
    source.write_text(source.read_text() + "# another one\n")
    assert not before & {task["id"] for task in tasks(load_study(stranger / "study.toml"))}
    with pytest.raises(StudyError, match="stranger_method:Ordinary is another one on the worker"):
        run_task(first)


def test_a_law_of_ones_own_is_in_the_robot_and_its_file(stranger: Path) -> None:
    robot = didim.load_robot(stranger / "arm_with_law.toml")
    made = didim.FrictionTerm.from_function("Fq", 1, lambda dq: dq * np.abs(dq), fastest=8.0)
    assert robot.friction.terms == (made,)
    x = robot.parameter_set("reference")
    assert x[robot.parameter_names.index("Fq2")] == 0.3
    copy = stranger / "copy.toml"
    copy.write_text(robot_text(robot), encoding="utf-8")
    assert tomllib.loads(copy.read_text())["friction"]["law"][0]["values"] == list(made.values)
    assert didim.load_robot(copy).friction == robot.friction


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('function = "stranger_law:quadratic"', ""), "a law needs either function"),
        (('function = "stranger_law:quadratic"', 'function = "stranger_law:cubic"'), "has no 'cubic'"),
        (('function = "stranger_law:quadratic"', 'function = "nowhere:law"'), "no module 'nowhere'"),
        (("fastest_rad_s = 8.0", ""), "joint 2 needs fastest"),
        (('name = "Fq"', 'name = "Fv"'), "needs a name of its own"),
        (('name = "Fq"', 'name = "Fq"\nfirts = 1'), "unknown key 'firts'"),
    ],
)
def test_wrong_laws_are_one_sentence(stranger: Path, change: tuple[str, str], message: str) -> None:
    path = stranger / "arm_with_law.toml"
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(RobotError, match=message):
        didim.load_robot(path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("didmi", "there is no method 'didmi'; did you mean 'didim'"),
        ("stranger_method:Ordinry", "has no 'Ordinry'; did you mean 'Ordinary'"),
        ("nowhere:Method", "there is no module 'nowhere' in Python's path, nor in this folder"),
        ("stranger_law:quadratic", "must be a class of settings with `name` and `run`"),
        ("broken_method:Method", "cannot be loaded .SyntaxError"),
        ("needing_method:Method", "its module needs no_such_package, which is not installed"),
        (3, "a method is settings such as"),
    ],
)
def test_wrong_methods_are_one_sentence(
    stranger: Path, arm: Path, name: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(stranger)
    (stranger / "broken_method.py").write_text("class Method(:\n")
    (stranger / "needing_method.py").write_text("import no_such_package\n")
    log = didim.load_experiment(arm, data=arm.parent / "data")
    with pytest.raises(FitError, match=message):
        didim.identify(log, name)


def test_titles_and_places() -> None:
    assert [title_of(name) for name in METHODS] == ["IDIM-LS", "IDIM-IV", "DIDIM", "CLOE"]
    assert title_of("didim-plain") == "DIDIM, plain"
    assert title_of("cloe-nelder-mead-literal") == "CLOE, literal"
    assert title_of("ordinary") == "ordinary"
    assert list(places({"a": ["m.n:C", "two words: no", 3], "b": "x:y"})) == ["m.n:C", "x:y"]
    assert source_digest("nowhere.at_all:thing") == source_digest("sys:path") == ""
