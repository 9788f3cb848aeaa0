"""The README: its commands exist, its files exist, its Python example runs, and it reads the same on a package index."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from scripts import script

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def python_block() -> str:
    """Return the only Python block of the README."""
    (block,) = re.findall(r"^```python\n(.*?)^```$", README, flags=re.DOTALL | re.MULTILINE)
    return str(block)


def test_the_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(python_block(), "README.md", "exec"), names)

    fit = names["fit"]
    assert isinstance(fit, didim.Identification)
    printed = capsys.readouterr().out
    assert all(name in printed for name in fit.names)
    assert "sound: nothing speaks against" in printed

    robot = didim.load_robot("tx40")
    truth = robot.set_base("didim_physical")
    assert np.mean(np.abs(fit.beta - truth) <= 3.0 * fit.std) >= 0.97
    found = didim.load_parameters(robot, "found.toml")
    np.testing.assert_array_equal(found, fit.parameters)


def test_the_example_is_short() -> None:
    """Five lines, beside the import."""
    first, *lines = [line for line in python_block().splitlines() if line]
    assert first == "import didim"
    assert len(lines) <= 5


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= 110


def test_its_commands_exist(capsys: pytest.CaptureFixture[str]) -> None:
    commands = re.findall(r"^    didim (\w+) (.*)$", README, flags=re.MULTILINE)
    assert {"base", "compare", "identify", "simulate", "validate"} <= {command for command, _ in commands}
    for command, arguments in commands:
        with pytest.raises(SystemExit) as ended:
            main([command, "--help"])
        assert ended.value.code == 0
        shown = capsys.readouterr().out
        assert all(option in shown for option in re.findall(r"--\w+", arguments))


def test_it_reads_the_same_on_a_package_index() -> None:
    """Relative links lead nowhere there. Only the pictures are such links, each with a text that says what it shows."""
    links = re.findall(r"(!?)\[([^\]]*)\]\((?!https?:)([^)#]+)", README)
    pictures = ["docs/img/first.png", "docs/img/motion.gif"]
    assert [(mark, target) for mark, _, target in links] == [("!", picture) for picture in pictures]
    assert all(len(text) > 80 for _, text, _ in links)
    assert all((ROOT / picture).is_file() for picture in pictures)
    pages = re.findall(r"`(docs/\w+\.md|[A-Z]+\.md)`", README)
    assert len(pages) >= 8
    for page in pages:
        assert (ROOT / page).is_file(), page


def test_its_pictures_are_readable_on_light_and_dark_pages() -> None:
    """They have no background, and the ink has an equal contrast (WCAG) to white and to GitHub's dark page."""
    from PIL import Image

    for name in ("first.png", "motion.gif"):
        with Image.open(ROOT / "docs" / "img" / name) as opened:
            assert np.asarray(opened.convert("RGBA"))[0, 0, 3] == 0

    def luminance(colour: str) -> float:
        parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    ink = luminance(script(ROOT / "benches" / "first_picture.py").INK)
    for page in ("#ffffff", "#0d1117"):
        low, high = sorted((ink, luminance(page)))
        assert (high + 0.05) / (low + 0.05) > 4.2


def test_the_readme_of_an_index_has_absolute_links_alone() -> None:
    absolute = script(ROOT / "benches" / "index_readme.py").absolute
    text = absolute(README, "https://pages.example/didim/")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert all(link.startswith("https://pages.example/didim/") for link in links)
    assert "https://pages.example/didim/img/first.png" in links
    named = set(re.findall(r"`docs/(\w+)\.md`", README))
    assert {f"https://pages.example/didim/{name}.html" for name in named} <= set(links)
    # Nothing else changed.
    assert (
        re.sub(r"\[(`docs/\w+\.md`)\]\([^)]+\)", r"\1", text).replace("https://pages.example/didim/", "docs/")
        == README
    )
    for url in ("pages.example/didim", "file:///site", ""):
        with pytest.raises(ValueError, match="the address of the site"):
            absolute(README, url)
    with pytest.raises(ValueError, match=r"docs/none\.md is not there"):
        absolute("`docs/none.md`", "https://pages.example")


def test_its_numbers_are_those_of_the_pages() -> None:
    for page, numbers in (
        ("uncertainty", ("| 1.10 |", "| 0.80 |", "| 2.55 |")),
        ("ur10e", ("15.3 %", "0.15 %")),
        ("cloe", ("9 428",)),
    ):
        text = " ".join((ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8").split())
        for number in numbers:
            assert number in text
            assert number.strip("| ").removesuffix("5") in README


def test_its_make_targets_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^    make (\w+) ", README, flags=re.MULTILINE)
    assert targets == ["demo", "test", "wheel"]
    for target in targets:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


def test_the_records_for_citations_have_the_version_of_the_package() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    citation = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), flags=re.M)
    assert citation is not None
    records = [
        json.loads((ROOT / name).read_text(encoding="utf-8")) for name in ("codemeta.json", ".zenodo.json")
    ]
    assert [citation[1], *(record["version"] for record in records)] == [version] * 3


def test_the_paper_cites_what_its_bibliography_has() -> None:
    text = (ROOT / "paper.md").read_text(encoding="utf-8")
    _, _, body = text.split("---\n", 2)
    assert len(body.split()) <= 1000
    bibliography = (ROOT / "paper.bib").read_text(encoding="utf-8")
    keys = re.findall(r"^@\w+\{(\w+),", bibliography, flags=re.MULTILINE)
    assert len(keys) == len(set(keys))
    assert set(re.findall(r"@(\w+\d{4})", body)) == set(keys)
    for picture in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", body):
        assert (ROOT / picture).is_file()


def test_the_page_for_assistants_links_to_pages_that_exist() -> None:
    links = re.findall(r"\]\(([^)]+)\)", (ROOT / "llms.txt").read_text(encoding="utf-8"))
    assert len(links) >= 10
    assert [link for link in links if not (ROOT / link).is_file()] == []
