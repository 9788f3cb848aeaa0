"""Mistakes of a first hour: each is answered by what to do, in one line, and misspelt names by the nearest known one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import didim
from didim._tools.words import FEW_NAMES, known_names
from didim.cli.main import main
from didim.experiment.draft import initialise
from didim.experiment.experiment_file import load_experiment

T = np.arange(1000) / 500.0
Q = np.column_stack([np.sin(3.0 * T), np.cos(2.0 * T)])
TAU = np.column_stack([20.0 * np.cos(3.0 * T), 5.0 * np.sin(5.0 * T)])
NAMES = ["t", "q1", "q2", "tau1", "tau2"]


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with rec.csv and its experiment rec.toml."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rec.csv"
    np.savetxt(path, np.column_stack([T, Q, TAU]), "%.9g", ",", header=",".join(NAMES), comments="")
    initialise("planar2", path)
    (tmp_path / "fit.json").write_text('{"schema": 1}', encoding="utf-8")
    (tmp_path / "arm.toml").write_text('schema = 1\n[[joint]]\nkind = "revolute"\n', encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("identify rec.csv", "rec.csv: this is a log, not an experiment; `didim init ROBOT rec.csv` writes an experiment file"),
        ("check rec.csv", "rec.csv: this is a log, not an experiment; `didim init ROBOT rec.csv` writes"),
        ("identify fit.json", "fit.json: this is a result, not an experiment: `didim validate fit.json EXPERIMENT.toml`"),
        ("identify arm.toml", "arm.toml: this is a robot file, not an experiment; `didim init arm.toml LOG` writes"),
        ("identify arm.urdf", "arm.urdf: this is a robot, not an experiment; `didim init arm.urdf LOG` writes"),
        ("init rec.csv ur5e", "rec.csv: this is a log, and the robot comes first: didim init ur5e rec.csv"),
        ("init rec.csv arm.toml", "the robot comes first: didim init arm.toml rec.csv"),
        ("init rec.csv other.csv", "the robot comes first: didim init ROBOT rec.csv"),
        ("init planer2 rec.csv -o x.toml", "no packaged robot 'planer2'; did you mean 'planar2'?"),
        ("identify rec.toml --metod didim", "there is no option --metod; did you mean '--method'?; see `didim identify --help`"),
        ("identify rec.toml --jsn=x.json", "there is no option --jsn; did you mean '--json'?"),
        ("--versoin", "there is no option --versoin; did you mean '--version'?"),
        ("identfy rec.toml", "there is no command 'identfy'; did you mean 'identify'? (there are: robot, excite, init"),
        ("identify rec.toml --method idimls", "there is no method 'idimls'; did you mean 'idim-ls'? (there are: idim-ls"),
        ("identify rec.toml --optimizer nelder", "invalid choice: 'nelder'; did you mean 'nelder-mead'?"),
        ("identify rec.toml --solver hubr", "there is no solver 'hubr'; did you mean 'huber'?"),
        ("identify rec.toml --method didim", "rec: a simulation needs the table [reference]: which positions the robot was to "
         "follow, and [controller]; without them --method idim-ls identifies from the measured motion"),
        ("validate rec.toml fit.json", "the result (FIT.json) comes first, then the experiment"),
    ],
)  # fmt: skip
def test_what_to_do(log: Path, capsys: pytest.CaptureFixture[str], words: str, expected: str) -> None:
    try:
        code = main(words.split())
    except SystemExit as end:
        code = int(str(end.code))
    assert code == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1


def test_a_prefix_of_an_option_and_values_that_look_like_options_work(log: Path) -> None:
    assert main(["identify", "rec.toml", "--qui"]) in (0, 1)
    with pytest.raises(SystemExit):
        main(["identify", "rec.toml", "--he"])


def test_a_robot_of_seven_joints_for_a_log_of_two(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", "panda", "rec.csv", "-o", "x.toml"]) == 1
    assert (
        "which columns hold the positions of the 7 joints; the log has 2 positions: is it of another robot?"
        in capsys.readouterr().err
    )
    text = Path("rec.toml").read_text(encoding="utf-8").replace('"planar2"', '"panda"')
    Path("panda.toml").write_text(text, encoding="utf-8")
    assert main(["identify", "panda.toml"]) == 2
    assert "must name 7 columns, one for each joint of the robot, got 2" in capsys.readouterr().err


def test_a_misspelt_column_of_forty(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The nearest ones, and how many there are, not all forty."""
    names = [*NAMES, *(f"extra_{k}" for k in range(35))]
    table = np.column_stack([T, Q, TAU, np.ones((len(T), 35))])
    np.savetxt(log, table, "%.9g", ",", header=",".join(names), comments="")
    text = Path("rec.toml").read_text(encoding="utf-8").replace('"tau2"', '"tau_2"')
    Path("rec.toml").write_text(text, encoding="utf-8")
    assert main(["identify", "rec.toml"]) == 2
    error = capsys.readouterr().err
    assert (
        "rec.csv: there is no column 'tau_2'; there are 40 columns; the nearest are 'tau2', 'tau1'" in error
    )
    assert error.count("extra_") < 2


def test_known_names() -> None:
    few = [f"a{k}" for k in range(FEW_NAMES)]
    assert known_names("b", few, "column").startswith("the columns are 'a0', 'a1'")
    assert known_names("xyz", [*few, "c"], "column") == "there are 13 columns, such as 'a0', 'a1', 'a2'"
    assert known_names("b", ["a"], "variable") == "the only one is 'a'"


def test_a_missing_value_says_how_to_leave_it_out(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And the way that it names works."""
    lines = log.read_text(encoding="utf-8").splitlines()
    lines[500] = lines[500].rpartition(",")[0] + ",nan"
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert main(["identify", "rec.toml"]) == 2
    expected = "row 500 (line 501), column 'tau2', is nan; delete this row, which resample = true under [recording.time] bridges"
    assert expected in capsys.readouterr().err
    log.write_text("\n".join(lines[:500] + lines[501:]) + "\n", encoding="utf-8")
    text = (
        Path("rec.toml")
        .read_text(encoding="utf-8")
        .replace('columns = ["t"]', 'columns = ["t"]\nresample = true')
    )
    Path("rec.toml").write_text(text, encoding="utf-8")
    (recording,) = load_experiment("rec.toml").recordings
    np.testing.assert_allclose(recording.q, Q, atol=1e-6)


RECIPE = """
[signal]
cutoff_hz = 50
padding = "matlab"
decimation = [10]
decimation_convention = "matlab"
"""


@pytest.mark.parametrize(
    ("lines", "lacking"),
    [
        ("", 'lacks ends = "first-order", edge_rows = 0, the defaults of 0.1.0'),
        ("edge_rows = 0", 'lacks ends = "first-order", the defaults'),
        ('edge_rows = 2\nends = "second-order"', ""),
    ],
)
def test_a_recipe_of_0_1_0_is_told_of_changed_defaults(
    log: Path, capsys: pytest.CaptureFixture[str], lines: str, lacking: str
) -> None:
    text = Path("rec.toml").read_text(encoding="utf-8")
    begin = text[: text.index("\n[signal]")]
    Path("old.toml").write_text(begin + RECIPE + lines, encoding="utf-8")
    assert main(["identify", "old.toml"]) in (0, 1)
    notes = capsys.readouterr().err
    assert (lacking in notes) if lacking else ("since 0.1.0" not in notes)


def test_filters_of_ones_own_are_told_nothing(log: Path) -> None:
    assert load_experiment("rec.toml").notes == ()
    assert didim.load_experiment("rec.toml").remarks == ()
