"""What the pages and the docstrings name exists, the page on the API is complete, and the examples on conventions are right."""

from __future__ import annotations

import ast
import inspect
import re
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import didim
from didim.cli.main import main
from didim.formats import FORMATS, render
from didim.methods.table import METHODS
from robots import random_motion, random_parameters
from scripts import script
from test_documented import tables
from test_identification import example
from twins import PINOCCHIO_ORDER, pinocchio_model

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
FOLDERS = "tests|benches|examples|docs|python|rust"


def functions(path: Path) -> set[str]:
    """Names of the functions of a Python or Rust file."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".rs":
        return set(re.findall(r"\bfn (\w+)", text))
    return {node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)}


def named(text: str) -> list[tuple[str, str]]:
    """Files of the project that a text names (NAME is any), each with the function behind ``::``, or an empty text."""
    return re.findall(
        rf"\b((?:{FOLDERS})/(?![\w/]*NAME)[\w./-]*\.(?:pyi?|rs|toml|md|sh))\b(?:::(\w+))?", text
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_names_exists(page: Path) -> None:
    for file, function in named(page.read_text(encoding="utf-8")):
        assert (ROOT / file).is_file(), file
        if function:
            assert function in functions(ROOT / file), f"{file}::{function}"


def test_the_changelog_has_one_short_line_a_change() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if len(line) > 120] == []
    assert len(text.encode()) <= 15_000
    headings = re.findall(r"^## \[(.*?)\]", text, flags=re.MULTILINE)
    assert headings[0] == "Unreleased"
    assert didim.__version__ in headings


def test_the_gallery_draws_what_its_blocks_draw() -> None:
    gallery = script(ROOT / "docs" / "hooks" / "gallery.py")
    page = "```python\nfrom didim.plot.style import new_figure\n```\n\n```python\nfigure = new_figure(1.0)\n```\ntext"
    ((end, picture),) = gallery.drawn(page)
    assert page[end:] == "\ntext"
    assert picture.startswith("<figure>")
    assert 'alt="figure = new_figure(1.0)"' in picture
    text = (ROOT / "docs" / gallery.PAGE).read_text(encoding="utf-8")
    blocks = gallery.BLOCK.findall(text.partition(gallery.HEADING)[2])
    assert sum("figure = " in block for block in blocks) == 12
    assert all(len(block.splitlines()) <= 10 for block in blocks)


def test_the_check_of_names_finds_them() -> None:
    text = "`tests/test_pages.py::functions` and (`rust/src/lib.rs`), python benches/peers.py."
    assert named(text) == [
        ("tests/test_pages.py", "functions"),
        ("rust/src/lib.rs", ""),
        ("benches/peers.py", ""),
    ]
    assert "functions" in functions(Path(__file__))
    assert "no_such" not in functions(Path(__file__))
    validation = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    assert sum(bool(function) for _, function in named(validation)) > 40


def test_the_tests_that_modules_name_exist() -> None:
    count = 0
    for module in sorted((ROOT / "python" / "didim").rglob("*.py")):
        for file in re.findall(r"\btest_\w+\.py", module.read_text(encoding="utf-8")):
            assert (ROOT / "tests" / file).is_file(), f"{module.name}: {file}"
            count += 1
    assert count > 20


VERBS = {
    *(
        "Add",
        "Compare",
        "Compute",
        "Design",
        "Estimate",
        "Find",
        "Identify",
        "Interpolate",
        "Limit",
        "Load",
        "Look",
        "Make",
    ),
    *("Move", "Read", "Restore", "Return", "Simulate", "Write"),
}
"""First words of docstrings of public functions."""


def test_docstrings_of_the_api_begin_with_a_verb_in_a_short_line() -> None:
    names = re.findall(
        r"^::: didim\.(\S+)", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    public = {name: attrgetter(name)(didim) for name in names}
    methods = {
        f"{name}.{key}": getattr(value, key)
        for name, value in public.items()
        if isinstance(value, type)
        for key in vars(value)
        if not key.startswith("_")
        and (inspect.isfunction(method := getattr(value, key)) or inspect.ismethod(method))
    }
    for name, value in (public | methods).items():
        if inspect.ismodule(value):
            continue
        first = (inspect.getdoc(value) or "").partition("\n")[0]
        assert 0 < len(first) <= 80, f"{name}: {first}"
        assert isinstance(value, type) or not inspect.isroutine(value) or first.split()[0] in VERBS, (
            f"{name}: {first}"
        )


def test_the_page_on_the_api_has_every_public_name() -> None:
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    item = r"^::: didim\.([\w.]+)\n(?: {4}options:\n {6}members: \[(.*)\]\n)?"
    shown = re.findall(item, text, flags=re.MULTILINE)
    paths = [path for path, _ in shown]
    assert sorted(path for path in paths if "." not in path) == sorted(
        [*didim.__all__, "formats", "plot", "report"]
    )
    moved = {f"{place}.{name}" for name, place in didim._MOVED.items()}
    assert sorted(path for path in paths if "." in path) == sorted(moved)
    for path, members in shown:
        thing = attrgetter(path)(didim)
        for member in filter(None, members.split(", ")):
            assert hasattr(thing, member), f"{path}.{member}"


def test_the_home_page_and_the_menu_have_every_page_by_its_title() -> None:
    folder = ROOT / "docs"
    titles = {
        page.relative_to(folder).as_posix(): page.read_text(encoding="utf-8").partition("\n")[0].strip("# `")
        for page in folder.rglob("*.md")
    }
    titles["index.md"] = "Home"
    assert len(titles) <= 32
    menu = re.findall(
        r'- "?(.*?)"?: (\S+\.md)$', (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), flags=re.M
    )
    assert {place: title for title, place in menu} == {
        place: title.replace("`", "") for place, title in titles.items()
    }
    home = re.findall(
        r"^\| \[(.*?)\]\(([^)]+\.md)\) \|", (folder / "index.md").read_text(encoding="utf-8"), flags=re.M
    )
    rows = {place: title.replace("`", "") for title, place in home}
    assert {**rows, "index.md": "Home"} == {place: title for title, place in menu}


def test_the_tables_of_methods_are_that_of_the_package() -> None:
    for rows in (
        tables(ROOT / "docs" / "choose.md")["--method needs gives"],
        tables(ROOT / "README.md")["method needs gives"],
    ):
        cells = {name: row[1:3] for row in rows for name in METHODS if f"{name}`" in row[0]}
        assert cells == {row.name: [row.needs, row.gives] for row in METHODS.values()}
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    for name, row in METHODS.items():
        assert f"::: didim.{row.location.partition(':')[2]}\n" in text, name


def test_the_formats_are_those_of_the_page() -> None:
    page = ROOT / "docs" / "results.md"
    rows = tables(page)["format content"]
    assert tuple(row[0] for row in rows) == FORMATS
    assert f"`{render(example(), 'csv').splitlines()[0]}`" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_commands_of_a_page_exist(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every ``make TARGET``, and every ``didim COMMAND`` in a block with the options behind it."""
    text = page.read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"(?:`|^ {4})make ([\w-]+)", text, flags=re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
    for command, arguments in re.findall(r"^ {4}didim ([\w-]+)(.*)$", text, flags=re.MULTILINE):
        with pytest.raises(SystemExit) as ended:
            main([command, "--help"])
        assert ended.value.code == 0, command
        known = set(re.findall(r"--?[\w-]+", capsys.readouterr().out))
        asked = set(re.findall(r"(?<=[\s\[])--?[a-z][\w-]*", arguments))
        assert asked <= known, f"didim {command}: {asked - known}"


def code_of(file: str) -> dict[str, Any]:
    """Run the only Python block of a page; the names it makes."""
    text = (ROOT / file).read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {"__name__": file}
    exec(compile(code, file, "exec", dont_inherit=True), names)
    return names


def conventions_example() -> dict[str, Any]:
    return code_of("docs/conventions.md")


def test_the_link_of_the_example_is_pinocchios() -> None:
    names = conventions_example()
    inertia = pin.Inertia.FromDynamicParameters(names["link"])
    assert inertia.mass == names["m"] == 2.0
    np.testing.assert_allclose(inertia.lever, names["c"])
    # What is left of a rod about its centre: l^2 / 12 and r^2 / 4 of its mass.
    np.testing.assert_allclose(inertia.inertia, names["about_centre"], atol=1e-12)
    np.testing.assert_allclose(
        np.diag(inertia.inertia), [0.000625, *[2.0 * (0.4**2 / 12.0 + 0.025**2 / 4.0)] * 2], rtol=1e-6
    )
    standard = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
    assert [standard[place] for place in PINOCCHIO_ORDER] == list(names["ORDER"])


def test_links_in_pinocchios_order_have_our_torques() -> None:
    """Also those of a lift, which has no masses: by the regressor."""
    order = conventions_example()["ORDER"]
    assert isinstance(order, tuple)
    robot = didim.load_robot("tx40")
    rng = np.random.default_rng(3)
    x = random_parameters(rng, robot, drive=False)
    motion = random_motion(rng, 1, 6)
    (expected,) = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    model = pinocchio_model(robot, x)
    lifted = robot.base_parameters.lift(robot.base_parameters.project(x))
    for parameters in (x, lifted):
        values = dict(zip(robot.parameter_names, parameters, strict=True))
        links = np.array([values[f"{name}{joint}"] for joint in range(1, 7) for name in order])
        W = pin.computeJointTorqueRegressor(
            model, model.createData(), motion.q[0], motion.dq[0], motion.ddq[0]
        )
        np.testing.assert_allclose(W @ links, expected, rtol=1e-9, atol=1e-9)


def test_a_row_places_its_frame_where_the_page_says() -> None:
    alpha, d, theta, r = 0.7, 0.3, -1.1, 0.2
    placement = pin.SE3(pin.utils.rotate("x", alpha), np.array([d, 0.0, 0.0]))
    placement *= pin.SE3(pin.utils.rotate("z", theta), np.array([0.0, 0.0, r]))
    np.testing.assert_allclose(placement.translation, [d, -r * np.sin(alpha), r * np.cos(alpha)])
    rotation = pin.utils.rotate("x", alpha) @ pin.utils.rotate("z", theta)
    np.testing.assert_allclose(placement.rotation, rotation)
    assert not np.allclose(pin.rpy.matrixToRpy(rotation), [alpha, 0.0, 0.0])
    np.testing.assert_allclose(pin.rpy.matrixToRpy(pin.utils.rotate("x", alpha)), [alpha, 0.0, 0.0])
