"""Equations of the pages: TeX becomes MathML when the pages are built, code keeps its dollars."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from scripts import script

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    "conventions", "idim_ls", "didim", "cloe", "physical", "friction", "uncertainty", "simulation",
    "keys", "excitation",
)  # fmt: skip


@pytest.fixture(scope="module")
def hook() -> Any:
    for name in ("markdown", "latex2mathml"):
        pytest.importorskip(name, reason="needs the group 'docs'")
    return script(ROOT / "docs" / "hooks" / "equations.py")


def html(hook: Any, text: str) -> str:
    import markdown

    return str(markdown.markdown(text, extensions=["tables", hook.Equations()]))


def test_an_equation_in_a_line(hook: Any) -> None:
    found = html(hook, r"of $W_{\mathrm{st}}\,x$ and $\beta$, both")
    assert found.count("<math") == found.count("</math>") == 2
    assert "<mi>\N{GREEK SMALL LETTER BETA}</mi>" in found
    assert re.sub(r"<math.*?</math>", "-", found) == "<p>of - and -, both</p>"


def test_an_equation_of_its_own_has_its_number_beside_it(hook: Any) -> None:
    found = html(hook, r"$$C = \sigma^2 (W^\top W)^{-1} \tag{10}$$")
    line = ElementTree.fromstring(found).find("span")
    assert line is not None
    math, number = line
    assert math.tag.endswith("}math")
    assert math.get("display") == "block"
    assert (number.get("class"), number.text) == ("number", "(10)")
    assert "(10)" not in "".join(math.itertext())
    assert "&amp;" not in found


def test_matrices_have_brackets_of_the_style_sheet(hook: Any) -> None:
    found = html(hook, r"$$P = \begin{bmatrix} a & b \\ c & d \end{bmatrix} + [e] \pm f$$")
    assert found.count('class="matrix"') == 1
    assert re.findall(r"<mo[^>]*>(.)</mo>", found) == ["=", "+", "[", "]", "\N{PLUS-MINUS SIGN}"]
    assert ".matrix" in (ROOT / "docs" / "hooks" / "pages.css").read_text(encoding="utf-8")


def test_dots_and_hats_are_accents(hook: Any) -> None:
    found = html(hook, r"$\dot q + \ddot q + \hat\beta + \bar b$ and $\overline{ab}$")
    assert found.count('<mover accent="true">') == 4


@pytest.mark.parametrize("text", ["`$a$`", "    $a$ and $b$", "it costs 5 $", r"\$a$", "nothing"])
def test_code_and_single_dollars_stay(hook: Any, text: str) -> None:
    assert "<math" not in html(hook, text)


@pytest.mark.parametrize("page", PAGES)
def test_the_equations_of_a_page_are_all_typeset(hook: Any, page: str) -> None:
    """No dollar and no command of TeX is left over outside code, and no number stands twice."""
    found = html(hook, (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8"))
    assert found.count('class="equation"') >= 1
    text = re.sub(r"<(code|pre)>.*?</\1>", "", found, flags=re.DOTALL)
    assert "$" not in text
    assert not re.search(r"\\[a-zA-Z]+", text)
    numbers = re.findall(r'class="number">(.*?)<', found)
    assert len(numbers) == len(set(numbers))
