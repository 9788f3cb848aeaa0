"""Results in notebooks, as HTML, short texts and data frames; and the notebooks of the documentation run."""

from __future__ import annotations

import json
import pickle
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim._tools.notebook import Printed, page
from didim.diagnosis.finding import Findings
from didim.errors import DidimError
from didim.result.contrast import Contrast
from didim.result.finding import Finding as Evidence
from didim.result.finding import worded
from didim.result.verdict import Verdict
from didim.studies.compare import Contrasts
from didim.studies.comparison import Comparison
from didim.studies.loads.payload_result import PayloadEstimate
from didim.studies.loads.residual import Residual
from scripts import script
from several import arm_logs
from test_identification import example


def cells(text: str, tag: str = "td") -> list[str]:
    return ["".join(cell.itertext()) for cell in ET.fromstring(text).iter(tag)]


def comparison() -> Comparison:
    experiment = didim.packaged_experiment("tx40")
    log = didim.simulated_log(experiment, experiment.robot.sets["didim"])
    fit = didim.identify(log, didim.IDIMLS())
    truth = experiment.robot.set_base("didim")
    return Comparison(experiment=log, truth=truth, fits={"idim-ls": fit}, norms={})


def test_a_result() -> None:
    fit = example()
    text = fit._repr_html_()
    shown = cells(text)
    for row in (*fit.parameter_rows()[1:], *fit.error_rows()[1:]):
        assert set(row) <= set(shown)
    (tail,) = ("".join(part.itertext()) for part in ET.fromstring(text).iter("pre"))
    assert str(fit).endswith(tail)
    assert "condition number" in tail
    assert "relative error" not in tail
    frame = fit.to_dataframe()
    assert tuple(frame.index) == fit.names
    np.testing.assert_array_equal(frame["value"], fit.beta)
    np.testing.assert_array_equal(frame["std"], fit.std)
    assert {"unit", "low", "high", "relative_std_percent", "role"} <= set(frame.columns)
    assert set(frame["group"]) == {"robot"}


def test_a_data_frame_has_the_parameters_of_the_logs() -> None:
    logs = arm_logs([False, True], offsets={1: (0.3, -0.2)}, own=("offsets",), noise=(0.02, 0.01))
    fit = didim.identify(logs, didim.IDIMLS())
    assert fit.further is not None
    frame = fit.to_dataframe()
    assert tuple(frame.index) == (*fit.names, *fit.further.names)
    assert list(dict.fromkeys(frame["group"])) == ["robot", "payload", "offset"]
    own = frame[frame["group"] != "robot"]
    np.testing.assert_array_equal(own["value"], fit.further.values)
    np.testing.assert_array_equal(own["std"], fit.further.std)
    assert tuple(own["unit"]) == fit.further.units
    factor = fit.interval_factor()
    np.testing.assert_allclose((own["high"] - own["low"]).astype(float), 2.0 * factor * fit.further.std)
    assert frame["low"].dtype == frame["high"].dtype == float
    # The table that is printed has the same bounds.
    (_, rows), *_ = fit.further.tables(factor)
    assert len(rows) - 1 == (frame["group"] == "payload").sum()


def test_a_comparison() -> None:
    found = comparison()
    text = found._repr_html_()
    assert "".join(ET.fromstring(text).itertext()).replace("\n", "") == str(found).replace("\n", "")
    frame = found.to_dataframe()
    assert list(frame.columns) == [("truth", "value"), ("idim-ls", "value"), ("idim-ls", "std")]
    assert frame.loc["ZZ1R", ("truth", "value")] == found.truth[0]
    assert len(repr(found)) < 80


def test_robots_and_base_parameters() -> None:
    robot = didim.load_robot("tx40")
    assert repr(robot) == "<Robot 'tx40': 6 joints, 86 standard parameters>"
    assert repr(robot.base_parameters) == "<BaseParameters: 60 of 86 standard parameters>"
    assert cells(robot._repr_html_())[:6] == ["1", "revolute", "0", "0", "0", "0"]
    assert cells(robot._repr_html_(), "th")[2] == "alpha (deg)"
    shown = cells(robot.base_parameters._repr_html_())
    assert len(shown) == 180
    frame = robot.base_parameters.to_dataframe()
    assert frame.loc["ZZ1R", "grouping"] == robot.base_parameters.groupings[0]
    named = replace(robot, description="a <b> & c")
    assert "a &lt;b&gt; &amp; c" in named._repr_html_()


def test_findings() -> None:
    finding = worded(kind="delay", sentence="torques are late", advice="Say so", joints=(1,))
    found = Findings("log", (finding,), ("pan",))
    assert cells(found._repr_html_()) == ["delay", "torques are late", "Say so"]
    assert "joints: 1 pan" in found._repr_html_()
    assert "nothing found" in Findings("log")._repr_html_()


def test_numbers_stand_on_the_right() -> None:
    root = ET.fromstring(page("t", [("name", "value"), ("a", "1.5"), ("b", "-")]))
    styles = [cell.get("style") for cell in root.iter("td")]
    assert styles == ["text-align: left", "text-align: right"] * 2
    assert page("t", "", []) == "<div><strong>t</strong></div>"


def test_what_people_print_shows_itself() -> None:
    """Every class with a text for people has it in notebooks, with a repr of one line."""
    found = comparison()
    log, fit = found.experiment, found.fits["idim-ls"]
    (recording,) = log.recordings
    assert repr(log) == "<Experiment 'TX40, simulated': robot 'tx40', 'simulated log' 10 s>"
    assert cells(log._repr_html_())[:5] == ["simulated log", "fit", "10001", "1000", "10"]
    assert len(repr(recording)) < 1000
    assert "q=array(10001, 6)" in repr(recording)
    verdict = fit.verdict
    assert fit.verdict.sentence in verdict._repr_html_()
    doubtful = Verdict((Evidence(code="a", grade="doubtful", facts={"text": "1 < 2", "advice": "Try 3"}),))
    assert cells(doubtful._repr_html_()) == ["doubtful", "1 < 2", "Try 3"]
    errors = didim.validate(fit, log)
    assert repr(errors).startswith("<Validation: ")
    text = "".join(ET.fromstring(errors._repr_html_()).itertext())
    assert text.split() == str(errors).split()
    for kind in (
        didim.Excitation,
        didim.StudyResults,
        Contrast,
        Contrasts,
        PayloadEstimate,
        Residual,
    ):
        assert kind._repr_html_ is Printed._repr_html_
        assert kind.__repr__ is Printed.__repr__


def test_figures_show_themselves_without_pyplot() -> None:
    figure: Any = didim.plot.correlation(example())
    assert figure._repr_png_().startswith(b"\x89PNG")
    again = pickle.loads(pickle.dumps(figure))
    assert again._repr_png_() == figure._repr_png_()


def test_without_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(DidimError, match="pip install pandas"):
        example().to_dataframe()


FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST_BYTES = 200_000


def read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def test_there_are_two() -> None:
    assert len(NOTEBOOKS) == 2


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_its_last_answer_is_that_of_the_page(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    codes = ["".join(cell["source"]) for cell in read(path)["cells"] if cell["cell_type"] == "code"]
    for code in codes[:-1]:
        exec(compile(code, path.name, "exec"), names)
    *statements, answer = codes[-1].split("\n")
    exec(compile("\n".join(statements), path.name, "exec"), names)
    assert eval(answer, names) in path.with_suffix(".md").read_text(encoding="utf-8")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_page_is_that_of_its_notebook(path: Path) -> None:
    page_of = script(FOLDER.parents[1] / "benches" / "notebooks.py").page
    text, pictures = page_of(read(path), path.stem)
    assert path.with_suffix(".md").read_text(encoding="utf-8") == text
    assert pictures
    for name, data in pictures.items():
        assert (FOLDER / name).read_bytes() == data
    assert path.stat().st_size < LARGEST_BYTES
    for cell in read(path)["cells"]:
        assert cell["cell_type"] == "markdown" or cell["execution_count"] is not None
