"""Results as markdown, LaTeX and CSV: every number is there, special characters are shown, and CSV reads back equal."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import didim
from didim import DIDIM, IDIMLS, Comparison, Identification
from didim.cli.main import main
from didim.errors import FitError
from didim.formats import FORMATS, Result, latex_text, render
from didim.model.kinematics import pose_lines
from didim.result.table import PARAMETER_HEAD
from several import arm_logs
from test_cli import arm as arm_fixture
from test_cli import identify_arm
from test_compare import ARM
from test_identification import example

arm = arm_fixture


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    path = tmp_path_factory.mktemp("formats") / "arm.toml"
    path.write_text(ARM, encoding="utf-8")
    found = didim.compare(didim.load_experiment(path), parameters="reference", methods=[IDIMLS(), DIDIM()])
    # A simplex gives no standard deviations.
    silent = replace(found.fits["didim"], covariance=np.zeros_like(found.fits["didim"].covariance))
    return replace(found, fits={**found.fits, "cloe-nelder-mead": silent})


def odd() -> Identification:
    """Return a result whose texts have every character that LaTeX or markdown takes for a command."""
    fit = example()
    return replace(
        fit,
        name=r"50 % of $5 & #1_a {b} ~c \d | *e* <f>",
        names=("A_1%", "Fv1+", "X&Y", "Ia2#", r"M\{2}|"),
        beta=np.array([1e12, -3.5e-13, -0.011044, 0.3, 0.0]),
        covariance=np.diag([1e20, 1e-30, 0.05**2, 0.0, 0.0]),
    )


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def number(text: str) -> float:
    return float(text) if text else math.nan


def pipe_tables(text: str) -> list[list[list[str]]]:
    """Cells of the pipe tables, unescaped, without the rules."""
    found = []
    for block in text.split("\n\n"):
        if block.startswith("|"):
            lines = [re.split(r"(?<!\\)\|", line)[1:-1] for line in block.splitlines()]
            assert all(set(cell) <= set("-:") for cell in lines[1])
            assert len({len(line) for line in lines}) == 1
            cells = [[unescape(re.sub(r"\\(.)", r"\1", cell.strip())) for cell in line] for line in lines]
            found.append([cells[0], *cells[2:]])
    return found


def check_latex(text: str) -> list[list[str]]:
    """Rows of a table that LaTeX would take: groups and dollars closed, as many cells as columns, nothing left unescaped."""
    lines = [line for line in text.splitlines() if not line.startswith("%")]
    assert lines[0].startswith(r"\begin{tabular}{")
    assert lines[1] == r"\toprule"
    assert lines[-2:] == [r"\bottomrule", r"\end{tabular}"]
    columns = len(lines[0].removeprefix(r"\begin{tabular}{").removesuffix("}"))
    rows = []
    for line in lines[2:-2]:
        if line == r"\midrule" or line.startswith(r"\cmidrule"):
            continue
        assert line.endswith(r" \\")
        plain = re.sub(r"\\[\\&%$#_{}]", "", line.removesuffix(r" \\").replace(r"\textbackslash{}", ""))
        assert plain.count("$") % 2 == 0
        depth = 0
        for character in plain:
            depth += {"{": 1, "}": -1}.get(character, 0)
            assert depth >= 0
        assert depth == 0
        for outside in plain.split("$")[::2]:
            assert not set("%#_^~<>") & set(outside)
        widths = [int(width) for width in re.findall(r"\\multicolumn\{(\d+)\}", line)]
        assert plain.count("&") + 1 + sum(widths) - len(widths) == columns
        if not widths:
            rows.append([cell.strip() for cell in re.split(r"(?<!\\)&", line.removesuffix(r" \\"))])
    return rows


def test_csv_reads_back_equal() -> None:
    for fit in (example(), odd()):
        rows = rows_of(render(fit, "csv"))
        assert list(rows[0]) == [
            "name",
            "unit",
            "value",
            "std",
            "relative_std_percent",
            "low",
            "high",
            "std_white",
            "role",
        ]
        assert [row["name"] for row in rows] == list(fit.names)
        assert [row["unit"] for row in rows] == list(fit.units)
        assert [row["role"] for row in rows] == list(fit.roles)
        # Every bit: assert_array_equal has no tolerance, and takes NaN for equal to NaN.
        for key, values in (
            ("value", fit.beta),
            ("std", fit.std),
            ("relative_std_percent", fit.relative_std_percent),
        ):
            np.testing.assert_array_equal([number(row[key]) for row in rows], values)


def test_parameters_of_single_logs_are_in_every_format() -> None:
    fit = didim.identify(
        arm_logs([False, True, True], offsets={2: (0.3, -0.2)}, own=("offsets",), noise=(0.3, 0.2)),
        didim.IDIMLS(),
    )
    found = fit.further
    assert found is not None
    rows = rows_of(render(fit, "csv"))[len(fit.names) :]
    assert [row["name"] for row in rows] == list(found.names)
    half = fit.interval_factor() * found.std
    for key, values in (
        ("value", found.values),
        ("std", found.std),
        ("low", found.values - half),
        ("high", found.values + half),
        ("std_white", found.std_white),
    ):
        np.testing.assert_array_equal([number(row[key]) for row in rows], values)
    tables = pipe_tables(render(fit, "markdown"))
    assert [[row[0] for row in table[1:]] for table in tables[1:-1]] == [
        list(block.names) for block in found.blocks
    ]
    assert "payload 'disc', on the flange" in render(fit, "markdown")
    latex = check_latex(render(fit, "latex"))
    assert [row[0] for row in latex[-len(found.names) :]] == [latex_text(name) for name in found.names]


def test_standard_deviations_that_nobody_knows_are_empty_and_not_zero() -> None:
    fit = replace(example(), covariance=np.zeros((5, 5)))
    rows = rows_of(render(fit, "csv"))
    assert [row["std"] for row in rows] == ["", "", "", "0.0", "0.0"]
    (table, _) = pipe_tables(render(fit, "markdown"))
    assert table[1][3:5] == ["-", "-"]
    assert check_latex(render(fit, "latex"))[1][3:5] == ["--", "--"]


def test_markdown() -> None:
    fit = example()
    text = render(fit, "markdown")
    table, errors = pipe_tables(text)
    assert table[0] == [*PARAMETER_HEAD[:-1], "remark"]
    assert table[1] == ["ZZ1R", "kg.m^2", "95.1089", "0.1085", "0.1141", "94.7636", "95.4542", "1.08", ""]
    assert table[3][:4] == ["XY2", "kg.m^2", "-0.01104", "0.00816"]
    assert table[3][-1] == "* one block"
    assert table[4] == ["Ia2", "kg.m^2", "0.3", "", "", "", "", "", "fixed"]
    assert "|---|---|---:|---:|---:|---:|---:|---:|---|" in text
    assert errors[1] == ["fit", "4.0834", "12.35", "6.0000"]
    assert fit.status.value in text
    assert fit.warnings[0] in text
    text = render(odd(), "markdown")
    assert text.startswith(r"50 % of $5 & #1\_a {b} ~c \\d \| \*e\* &lt;f&gt;: robot")
    (table, _) = pipe_tables(text)
    assert [row[0] for row in table[1:]] == list(odd().names)


def test_latex() -> None:
    fit = example()
    text = render(fit, "latex")
    assert text.splitlines()[0] == "% two joints: robot planar2 by idim-ls"
    assert f"% {fit.status.value}" in text.splitlines()
    assert r"% needs \usepackage{booktabs}" in text.splitlines()
    rows = check_latex(text)
    assert rows[0] == [
        "parameter",
        "unit",
        "estimate",
        r"$\sigma$",
        r"$\sigma$ \%",
        r"95 \% low",
        r"95 \% high",
        "/ white",
        "remark",
    ]
    assert rows[1][:5] == ["ZZ1R", r"kg\,m$^{2}$", "$95.1089$", "$0.1085$", "$0.1141$"]
    assert rows[2][1] == r"N\,m\,s/rad"
    assert rows[3][2] == "$-0.01104$"


def test_latex_escapes() -> None:
    rows = check_latex(render(odd(), "latex"))
    names = [r"A\_1\%", "Fv1+", r"X\&Y", r"Ia2\#", r"M\textbackslash{}\{2\}|"]
    assert [row[0] for row in rows[1:]] == names
    assert rows[1][2] == r"$1\cdot10^{12}$"
    assert rows[2][2] == r"$-3.5\cdot10^{-13}$"
    assert rows[3][4] == "$453$"
    assert latex_text("d3^2 M4 ~ 2^x") == r"d3$^{2}$ M4 \textasciitilde{} 2\textasciicircum{}x"


def test_a_comparison(comparison: Comparison) -> None:
    rows = rows_of(render(comparison, "csv"))
    for method, fit in comparison.fits.items():
        silent = method == "cloe-nelder-mead"
        for key, values in (
            ("value", fit.beta),
            ("std", fit.std),
            ("relative_std_percent", fit.relative_std_percent),
            ("deviation", comparison.deviations(method)),
        ):
            expected = np.full_like(values, np.nan) if silent and key != "value" else values
            np.testing.assert_array_equal([number(row[f"{method}_{key}"]) for row in rows], expected)
    np.testing.assert_array_equal([float(row["truth"]) for row in rows], comparison.truth)

    (table,) = pipe_tables(render(comparison, "markdown"))
    latex = check_latex(render(comparison, "latex"))
    assert table[0][:6] == [
        "parameter",
        "unit",
        "truth",
        "IDIM-LS: estimate",
        "IDIM-LS: sigma %",
        "IDIM-LS: off",
    ]
    assert r"\multicolumn{3}{c}{DIDIM}" in render(comparison, "latex")
    names = comparison.fits["didim"].names
    assert [row[0] for row in table[1:]] == list(names)
    assert len(table) == len(latex) == 1 + len(names)
    for row, exact, tex in zip(table[1:], rows, latex[1:], strict=True):
        assert float(row[2]) == pytest.approx(number(exact["truth"]), rel=1e-3)
        assert float(row[3]) == pytest.approx(number(exact["idim-ls_value"]), rel=1e-3)
        assert [cell.strip("$").replace("--", "-") for cell in tex[2:]] == row[2:]


def test_base_parameters() -> None:
    base = didim.load_robot("tx40").base_parameters
    assert [row["grouping"] for row in rows_of(render(base, "csv"))] == list(base.groupings)
    (table,) = pipe_tables(render(base, "markdown"))
    assert [row[2] for row in table[1:]] == list(base.groupings)
    assert len(check_latex(render(base, "latex"))) == 61


def test_text_is_what_print_shows(comparison: Comparison) -> None:
    results: tuple[Result, ...] = (example(), comparison, didim.load_robot("planar2").base_parameters)
    for result in results:
        assert render(result) == str(result)
    with pytest.raises(FitError, match="there is no format 'html'; there are: text, markdown, latex, csv"):
        render(example(), "html")


@pytest.mark.parametrize("form", FORMATS)
def test_commands(arm: Path, tmp_path: Path, form: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert identify_arm(arm, "--format", form, "--json", str(tmp_path / "fit.json")) == 0
    fit = Identification.load(tmp_path / "fit.json")
    assert capsys.readouterr() == (f"{render(fit, form)}\n", "")
    assert main(["base", "planar2", "--format", form]) == 0
    robot = didim.load_robot("planar2")
    text = render(robot.base_parameters, form)
    expected = "\n".join([f"planar2: {text}", "", *pose_lines(robot)]) if form == "text" else text
    assert capsys.readouterr() == (f"{expected}\n", "")


def test_compare_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(ARM, encoding="utf-8")
    command = ["compare", "--experiment", str(path), "--parameters", "reference", "--quiet"]
    assert main([*command, "--nelder-mead", "none", "--format", "csv"]) == 0
    rows = rows_of(capsys.readouterr().out)
    assert [row["name"] for row in rows] == list(didim.load_robot("planar2").base_parameters.names)
    assert {"idim-ls_std", "didim_std", "cloe-levenberg-marquardt_std"} <= set(rows[0])
