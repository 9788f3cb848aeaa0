"""Reports: everything in one page that asks nothing of a network, its numbers those of the result, its texts escaped."""

from __future__ import annotations

import base64
import builtins
import importlib
import re
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from arm import arm_log, noisy
from didim import (
    CLOE,
    DIDIM,
    IDIMLS,
    Comparison,
    Experiment,
    Identification,
    identify,
    report,
    validate,
)
from didim.cli.main import main
from didim.errors import FitError, PlotError
from didim.report.fit import judged
from didim.report.page import Html, table
from didim.result.iteration import Status
from didim.studies.comparison import sentences
from didim.studies.simulated_log import packaged_experiment
from several import arm_logs
from simulated import RATE_HZ
from simulated import experiment as log_experiment
from simulated import log as simulated_log
from test_compare import ARM, shortened

Row = list[str]
REPORTS = ("identify", "compare", "validate")
MODULES = {
    "identify": "didim.methods.identify",
    "compare": "didim.studies.compare",
    "validate": "didim.studies.validation",
}
"""Modules of the functions that the commands call."""


PICTURE = r"data:image/svg\+xml;base64,([\w+/=]+)"
"""The source of a picture: the image itself."""


@dataclass
class Page(HTMLParser):
    """What a page holds: tags with attributes, tables as rows of cells, pictures, and the text outside of them."""

    tags: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    tables: list[list[Row]] = field(default_factory=list)
    pictures: list[str] = field(default_factory=list)
    text: str = ""
    open: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, html: str) -> Page:
        page = cls()
        HTMLParser.__init__(page)
        page.feed(html)
        page.close()
        assert page.open == []
        return page

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = {key: value or "" for key, value in attrs}
        self.tags.append((tag, known))
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")
        if image := re.fullmatch(PICTURE, known.get("src", "")):
            self.pictures.append(base64.b64decode(image[1]).decode())

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.tables[-1][-1][-1] += data
        elif self.open and self.open[-1] != "style":
            self.text += data

    def table(self, first: str) -> list[Row]:
        """Rows below the headings of all tables whose first heading is this one, in order, cells without padding."""
        found = [rows for rows in self.tables if rows[0][0] == first]
        assert found
        return [[cell.strip() for cell in row] for rows in found for row in rows[1:]]


@pytest.fixture(scope="module")
def arm() -> Experiment:
    """Noise on a log whose robot, controller and reference are known."""
    return noisy(arm_log(1))


@pytest.fixture(scope="module")
def fit(arm: Experiment) -> Identification:
    return identify(arm, DIDIM())


@pytest.fixture(scope="module")
def fit_html(fit: Identification, arm: Experiment) -> str:
    return report.render(fit, arm)


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    path = tmp_path_factory.mktemp("report") / "arm.toml"
    path.write_text(ARM, encoding="utf-8")
    return shortened(didim.load_experiment(path))


@pytest.fixture(scope="module")
def pages(fit: Identification, arm: Experiment, fit_html: str, comparison: Comparison) -> dict[str, str]:
    return {
        "identify": fit_html,
        "compare": report.render(comparison),
        "validate": report.render(validate(fit, arm), arm),
    }


@pytest.mark.parametrize("which", REPORTS)
def test_nothing_is_fetched(pages: dict[str, str], which: str) -> None:
    html = pages[which]
    page = Page.of(html)
    assert not {"script", "link", "iframe", "object", "base"} & {tag for tag, _ in page.tags}
    for _, attributes in page.tags:
        assert attributes.get("href", "#").startswith("#")
        assert not {"action", "srcset", "onclick", "onload"} & set(attributes)
        assert re.fullmatch(PICTURE, attributes.get("src", "data:image/svg+xml;base64,="))
        assert re.fullmatch(r"([a-z-]+:[\d.%/ ]+;?)*", attributes.get("style", ""))
    assert not re.search(r"https?:|url\(|@import", html)
    places = {attributes["id"] for _, attributes in page.tags if "id" in attributes}
    links = [attributes["href"].removeprefix("#") for _, attributes in page.tags if "href" in attributes]
    assert len(links) == len(places) > 2
    assert set(links) == places
    policy = [attributes["content"] for tag, attributes in page.tags if attributes.get("http-equiv")]
    assert policy == ["default-src 'none'; img-src data:; style-src 'unsafe-inline'"]
    assert page.pictures
    for drawing in page.pictures:
        references = re.findall(r'(?:xlink:)?href="([^"]{0,30})', drawing)
        assert all(target.startswith(("#", "data:image/png;base64")) for target in references)
        assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", drawing))
    described = [attributes["alt"] for tag, attributes in page.tags if tag == "img"]
    assert len(described) == len(page.pictures)
    assert all(described)
    assert len(html) < 3_000_000


@pytest.mark.parametrize("which", REPORTS)
def test_the_same_result_gives_the_same_page(
    pages: dict[str, str], fit: Identification, arm: Experiment, comparison: Comparison, which: str
) -> None:
    again = {
        "identify": lambda: report.render(fit, arm),
        "compare": lambda: report.render(comparison),
        "validate": lambda: report.render(validate(fit, arm), arm),
    }
    assert again[which]() == pages[which]


def test_numbers_of_an_identification(fit: Identification, fit_html: str, arm: Experiment) -> None:
    page = Page.of(fit_html)
    rows = page.table("parameter")[: len(fit.names)]
    assert [row[0] for row in rows] == list(fit.names)
    assert [row[1] for row in rows] == list(fit.units)
    for row, value, std, percent in zip(rows, fit.beta, fit.std, fit.relative_std_percent, strict=True):
        assert float(row[2]) == pytest.approx(value, abs=0.006 * std)
        assert float(row[3]) == pytest.approx(std, rel=0.006)
        assert float(row[4]) == pytest.approx(percent, rel=0.006)
        assert row[-1] == ("" if percent <= 20.0 else "weak")
        assert float(row[5]) == pytest.approx(value - 2.093 * std, abs=0.02 * std)
        assert float(row[6]) == pytest.approx(value + 2.093 * std, abs=0.02 * std)
    (errors,) = page.table("relative error %")
    expected = [*fit.relative_error, fit.overall_relative_error]
    np.testing.assert_allclose([float(cell) for cell in errors[1:]], 100.0 * np.array(expected), atol=1e-4)
    history = page.table("iteration")
    assert len(history) == fit.n_iterations
    assert float(history[0][1]) == pytest.approx(100.0 * fit.history[0].relative_error, abs=1e-4)
    assert [fit.names[0], arm.robot.base_parameters.groupings[0]] in page.table("parameter")
    versions = dict(page.table("software"))
    assert versions == fit.settings["versions"]


def test_the_correlations_that_are_named(fit: Identification, fit_html: str) -> None:
    correlation = fit.covariance / np.outer(fit.std, fit.std)
    pairs = [row for row in Page.of(fit_html).table("parameter") if len(row) == 3]
    sizes = [abs(float(row[2])) for row in pairs]
    assert sizes == sorted(sizes, reverse=True)
    for first, second, value in pairs:
        i, j = fit.names.index(first), fit.names.index(second)
        assert float(value) == pytest.approx(correlation[i, j], abs=6e-4)
    off_diagonal = np.abs(correlation - np.eye(len(correlation)))
    assert sizes[0] == pytest.approx(off_diagonal.max(), abs=6e-4)


def test_the_verdict(fit: Identification, fit_html: str) -> None:
    level, badge, text = judged(fit)
    assert (level, badge) == ("good", "Sound. Converged")
    assert fit.warnings == ()
    well = int(np.sum(fit.relative_std_percent <= 20.0))
    count = "all" if well == len(fit.names) else f"{well} of {len(fit.names)}"
    assert text.startswith(f"DIDIM found {len(fit.names)} base parameters, {count} well (sigma below 20 %).")
    low, high = np.sort(100.0 * fit.relative_error)
    numbers = [float(value) for value in re.findall(r"([\d.]+) %", text)]
    np.testing.assert_allclose(numbers[1:], [low, high, 100.0 * fit.overall_relative_error], rtol=0.06)
    assert text in Page.of(fit_html).text


@pytest.mark.usefixtures("without_drawing")
def test_the_verdict_on_what_is_not_good(fit: Identification, arm: Experiment) -> None:
    lost = replace(fit, status=Status.NOT_CONVERGED)
    level, badge, text = judged(lost)
    assert (level, badge) == ("bad", "Wrong. Not converged")
    assert text.startswith(Status.NOT_CONVERGED.value)
    heavy = replace(fit, warnings=("the inertia of link 2 is negative",))
    level, badge, text = judged(heavy)
    assert (level, badge) == ("caution", "Doubtful. Converged")
    html = report.render(heavy, arm)
    assert 'class="verdict caution"' in html
    assert "the inertia of link 2 is negative" in Page.of(html).text
    assert judged(replace(fit, remarks=("the log has five windows",)))[0] == "good"
    blind = replace(fit, covariance=np.zeros_like(fit.covariance))
    assert "the method gives no standard deviations" in judged(blind)[2]


@pytest.mark.usefixtures("without_drawing")
def test_text_is_escaped(fit: Identification, arm: Experiment) -> None:
    evil = "<script>alert('1')</script> & \"co\""
    odd = replace(
        fit,
        name=evil,
        warnings=(evil,),
        remarks=(evil,),
        digests={evil: evil},
        settings={**fit.settings, "evil": evil},
    )
    (recording,) = arm.recordings
    experiment = replace(arm, name=evil, recordings=(replace(recording, name=evil),))
    for html in (report.render(odd, experiment), report.render(validate(odd, experiment), experiment)):
        page = Page.of(html)
        assert "script" not in [tag for tag, _ in page.tags]
        assert evil in page.text
    cell = table(
        ["<b>"],
        [
            [
                "<i>",
            ]
        ],
    ).text
    assert "<th>&lt;b&gt;</th>" in cell
    assert "<td>&lt;i&gt;</td>" in cell
    assert "<td><i></td>" in table(["a"], [[Html("<i>")]]).text


def test_numbers_of_a_comparison(comparison: Comparison, pages: dict[str, str]) -> None:
    page = Page.of(pages["compare"])
    assert " ".join(sentences(comparison)) in page.text
    fits = comparison.fits
    rows = next(row for row in page.tables if row[0][:2] == ["", "IDIM-LS"])[2:]
    assert len(rows) == len(comparison.truth)
    for index, row in enumerate(rows):
        cells = [cell.strip() for cell in row]
        assert float(cells[2]) == pytest.approx(comparison.truth[index], rel=1e-3)
        for number, (method, fit) in enumerate(fits.items()):
            estimate, share, off = cells[3 + 3 * number : 6 + 3 * number]
            assert float(estimate) == pytest.approx(fit.beta[index], rel=1e-3)
            if not fit.std.any():
                assert (share, off) == ("-", "-")
                continue
            assert float(off) == pytest.approx(comparison.deviations(method)[index], abs=0.051)
            assert share == ">999" or float(share) == pytest.approx(fit.relative_std_percent[index], rel=0.01)
    effort = next(row for row in page.table("") if row[0] == "DIDIM")
    deviations = comparison.deviations("didim")
    assert effort[1:3] == [str(fits["didim"].n_iterations), str(fits["didim"].n_simulations)]
    assert float(effort[4]) == pytest.approx(np.sqrt(np.mean(deviations**2)), abs=0.006)
    assert "CLOE, Nelder-Mead gives no standard deviations and is not drawn." in page.text
    assert "Shortened: Nelder-Mead ends after 50 iterations" in page.text


def test_numbers_of_a_validation(fit: Identification, arm: Experiment, pages: dict[str, str]) -> None:
    found = validate(fit, arm)
    (item,) = found.recordings
    rows = {
        row[0]: [float(cell) for cell in row[1:]]
        for row in Page.of(pages["validate"]).table("relative error %")
    }
    assert item.direct is not None
    np.testing.assert_allclose(rows["torque, predicted"], 100.0 * item.direct, rtol=1e-3)
    for name, values in item.simulated.items():
        np.testing.assert_allclose(rows[f"{name}, simulated"], 100.0 * values, rtol=1e-3)


@pytest.mark.usefixtures("without_drawing")
def test_a_validation_whose_simulation_ends_early(fit: Identification, arm: Experiment) -> None:
    light = replace(fit, beta=1e-4 * fit.beta, parameters=1e-4 * fit.parameters)
    html = report.render(validate(light, arm), arm)
    assert 'class="verdict bad"' in html
    assert "the simulated closed loop diverged at " in html
    # An estimate that cannot be simulated is still shown, along the measured motion.
    text = Page.of(report.render(light, arm)).text
    assert (
        "The torques below are predicted along the measured motion: recording 'log 1': the simulation diverged"
        in text
    )


@pytest.mark.usefixtures("without_drawing")
def test_a_log_without_torques(arm: Experiment) -> None:
    (recording,) = arm.recordings
    silent = replace(arm, recordings=(replace(recording, tau=None),))
    found = identify(silent, CLOE(start="reference", max_iterations=1))
    page = Page.of(report.render(found, silent))
    assert "Recording 'log 1' has no torques" in page.text
    assert page.table("parameter")[0][0] == found.names[0]


@pytest.mark.usefixtures("without_drawing")
def test_recordings_held_out_are_shown() -> None:
    robot = didim.load_robot("planar2")
    x = robot.parameter_set("reference")
    other = simulated_log(robot, x, seed=5, noise=0.1, name="other day", role="held-out")
    experiment = log_experiment(robot, simulated_log(robot, x, noise=0.1), other)
    fit = identify(experiment)
    page = Page.of(report.render(fit, experiment))
    rows = page.table("relative error %")
    assert [row[0] for row in rows] == ["fit", "held out: other day"]
    assert float(rows[1][1]) == pytest.approx(100.0 * fit.held_out[0].relative_error[0], abs=1e-4)
    assert "on 'other day', which was held out of the fit, " in page.text


@pytest.mark.slow
@pytest.mark.usefixtures("without_drawing")
def test_payloads_and_own_offsets_are_shown_with_their_intervals() -> None:
    experiment = arm_logs([False, True, True], offsets={2: (0.3, -0.2)}, own=("offsets",), noise=(0.3, 0.2))
    fit = identify(experiment)
    found = fit.further
    assert found is not None
    page = Page.of(report.render(fit, experiment))
    tables = [rows for rows in page.tables if rows[0][0] == "parameter" and rows[1][0] in ("ZZ", "Off1")]
    assert [[row[0] for row in rows[1:]] for rows in tables] == [list(block.names) for block in found.blocks]
    (mass,) = (row for row in tables[0] if row[0] == "M")
    std, value = found.std[found.names.index("disc.M")], found.by_name["disc.M"]
    half = fit.interval_factor() * std
    for cell, expected in zip(
        (*mass[2:4], *mass[5:7]), (value, std, value - half, value + half), strict=True
    ):
        assert float(cell) == pytest.approx(expected, abs=0.1 * std)
    assert "Payload 'disc', on the flange. Centre of mass: " in page.text
    assert "Offsets of recording 'log 2', less those of 'log 1'." in page.text


# The file and the command.


@pytest.mark.usefixtures("without_drawing")
def test_write(fit: Identification, arm: Experiment, tmp_path: Path) -> None:
    report.write(tmp_path / "fit.html", fit, arm)
    assert (tmp_path / "fit.html").read_text(encoding="utf-8") == report.render(fit, arm)
    assert [path.name for path in tmp_path.iterdir()] == ["fit.html"]
    with pytest.raises(PlotError, match="a report needs the experiment that the result was made of"):
        report.render(fit)
    tx40 = packaged_experiment("tx40")
    with pytest.raises(
        FitError,
        match="the result is for robot 'planar2' with 28 parameters, the experiment for 'tx40' with 86",
    ):
        report.render(fit, tx40)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """An experiment file with its data."""
    robot = didim.load_robot("planar2")
    recording = simulated_log(robot, robot.parameter_set("reference"), noise=0.1)
    assert recording.tau is not None
    np.savez(tmp_path / "log.npz", q=recording.q, tau=recording.tau)
    lines = [
        'schema = 1\nname = "arm"\nrobot = "planar2"\n[[recording]]',
        f"rate_hz = {RATE_HZ}",
        'position = { file = "log.npz", variable = "q", unit = "rad", side = "joint" }',
        'torque = { file = "log.npz", variable = "tau", unit = "N.m", side = "joint" }',
        "[signal]\ncutoff_hz = 40\ntrim_start = 25\ntrim_end = 25\ndecimation = [5]\n",
    ]
    (tmp_path / "arm.toml").write_text("\n".join(lines), encoding="utf-8")
    return tmp_path


@pytest.mark.usefixtures("without_drawing")
def test_commands(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    experiment, page = str(files / "arm.toml"), files / "fit.html"
    assert main(["identify", experiment, "--report", str(page), "--json", str(files / "fit.json")]) == 0
    fit = Identification.load(files / "fit.json")
    rows = Page.of(page.read_text(encoding="utf-8")).table("parameter")
    assert [row[0] for row in rows[: len(fit.names)]] == list(fit.names)
    assert float(rows[0][2]) == pytest.approx(fit.beta[0], rel=1e-2)
    assert set(fit.digests) == {"experiment arm.toml", "robot planar2.toml", "data log.npz"}
    assert dict(Page.of(page.read_text(encoding="utf-8")).table("file")) == dict(fit.digests)
    assert main(["validate", str(files / "fit.json"), experiment, "--report", str(files / "check.html")]) == 0
    text = Page.of((files / "check.html").read_text(encoding="utf-8")).text
    assert "the closed loop is not simulated, because there is no [controller] or no [reference]" in text
    (files / "sim.toml").write_text(ARM, encoding="utf-8")
    command = ["compare", "--experiment", str(files / "sim.toml"), "--parameters", "reference"]
    assert main([*command, "--nelder-mead", "none", "--quiet", "--report", str(files / "all.html")]) == 0
    capsys.readouterr()
    assert "DIDIM found" in Page.of((files / "all.html").read_text(encoding="utf-8")).text


@pytest.mark.parametrize("command", REPORTS)
def test_a_report_that_cannot_be_written_is_told_before_the_work(
    files: Path, command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = {
        "identify": [str(files / "arm.toml")],
        "compare": ["--robot", "tx40"],
        "validate": [str(files / "fit.json"), str(files / "arm.toml")],
    }[command]
    if command == "validate":
        assert main(["identify", str(files / "arm.toml"), "--quiet", "--json", str(files / "fit.json")]) == 0
    for name in REPORTS:
        # Called, they would be an error.
        monkeypatch.setattr(importlib.import_module(MODULES[name]), name, None)
    assert main([command, *arguments, "--report", str(files / "no" / "fit.html")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"didim: cannot write '.*fit\.html': there is no folder '.*no'\n", err)

    real = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name.split(".")[0] == "matplotlib":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    assert main([command, *arguments, "--report", str(files / "fit.html")]) == 2
    assert capsys.readouterr().err == "didim: pictures and reports need matplotlib: pip install didim[plot]\n"


@pytest.mark.slow
@pytest.mark.usefixtures("without_drawing")
def test_the_example_of_the_page_runs(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (project / "docs" / "results.md").read_text(encoding="utf-8").partition("\n## Gallery\n")[0]
    (block,) = re.findall(r"^```python\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(block, "results.md", "exec"), names)
    assert {path.name for path in tmp_path.iterdir()} == {"deviations.png", "compare.html", "fit.html"}
    listed = re.findall(r"^\| `([a-z]+)\(", text, flags=re.MULTILINE)
    assert sorted(listed) == sorted(set(didim.plot.__all__) - {"require", "svg"})


@pytest.mark.slow
@pytest.mark.usefixtures("without_causes")
def test_a_measured_tx40(project: Path, shared: Path) -> None:
    experiment = didim.load_experiment(project / "examples" / "tx40_log.toml", data=shared / "data" / "tx40")
    fit = identify(experiment, IDIMLS())
    html = report.render(fit, experiment)
    assert len(html) < 1_500_000
    page = Page.of(html)
    assert len(page.table("parameter")) >= 2 * 60
    assert "27 of 60 well" in page.text
    assert re.search(r"the residual of joints 1, 2, 3, 4, 5 and 6, .* is correlated in time", page.text)
