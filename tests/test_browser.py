"""Pages in a real browser: what is on them has its size and its place, and nothing is fetched.

``make test-pages`` runs it with Debian's Chromium on the pages of ``make docs``: each page is loaded once, and seen at two widths
and in both colour schemes; screenshots go to ``out/pages``.
"""

from __future__ import annotations

import functools
import http.server
import os
import re
import shutil
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

import didim
from arm import arm_log, noisy
from didim import Experiment, Identification, report
from didim.excitation.settings import ExcitationSettings
from didim.monte_carlo.spec import read_study
from didim.monte_carlo.study import study
from scripts import script
from small_study import PLACE, small_study
from test_compare import ARM, shortened
from test_positions import commands, fitted, legs, twin

pytestmark = pytest.mark.pages

ROOT = Path(__file__).resolve().parents[1]
SCREENSHOTS = ROOT / "out" / "pages"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader"]
VIEWS = [(width, scheme) for width in (1280, 400) for scheme in ("light", "dark")]
SITE = {
    "home page": "index.html",
    "gallery": "results.html",
    "notebook page": "notebooks/first_fit.html",
    "documentation": "first_log.html",
}
"""Pages of the documentation."""
REPORTS = (
    "fit on torques",
    "fit on positions",
    "comparison",
    "validation",
    "study",
    "excitation",
    "notebook",
)
"""Pages that didim writes, and what a notebook shows."""
MEASURE = r"""
() => {
  const faults = [], shown = e => e.checkVisibility({ visibilityProperty: true });
  const name = e => e.tagName.toLowerCase() + (e.className && e.className.baseVal === undefined ? '.' + e.className : '')
    + ' "' + (e.textContent || e.alt || '').trim().slice(0, 30) + '"';
  const box = e => e.getBoundingClientRect();
  const scrolls = e => { for (; e; e = e.parentElement)
    if (/auto|scroll|hidden|clip/.test(getComputedStyle(e).overflowX)) return true; return false; };
  const pieces = [...document.querySelectorAll('img, table, pre, main svg')]
    .filter(e => shown(e) && !e.closest('nav, header, footer, .md-sidebar, mjx-container, math') && !e.matches('.twemoji svg'));
  for (const e of pieces) {
    const { width, height } = box(e);
    if (width < 8 || height < 8) faults.push(`${name(e)} is ${width} x ${height}`);
    if (e.tagName == 'IMG' && !(e.complete && e.naturalWidth > 0)) faults.push(`${name(e)} is not loaded`);
  }
  const wide = document.documentElement.scrollWidth;
  if (wide > innerWidth + 1) faults.push(`the page is ${wide} wide in a window of ${innerWidth}`);
  for (const e of document.querySelectorAll('main *, .md-content *, body > *')) {
    if (!shown(e) || !e.parentElement || e.closest('svg, math')) continue;
    const own = box(e), around = box(e.parentElement);
    if (own.width > 0 && own.right > Math.max(around.right, 0) + 2 && !scrolls(e.parentElement)
        && getComputedStyle(e).position == 'static' && !e.matches('.md-nav *, .headerlink'))
      faults.push(`${name(e)} ends ${Math.round(own.right - around.right)} right of ${name(e.parentElement)}`);
  }
  const blocks = pieces.filter(e => e.matches('table, figure, img, pre'));
  for (let i = 0; i < blocks.length; ++i) for (let j = i + 1; j < blocks.length; ++j) {
    if (blocks[i].contains(blocks[j]) || blocks[j].contains(blocks[i])) continue;
    const a = box(blocks[i]), b = box(blocks[j]);
    const x = Math.min(a.right, b.right) - Math.max(a.left, b.left), y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (x > 2 && y > 2) faults.push(`${name(blocks[i])} overlaps ${name(blocks[j])} by ${x} x ${y}`);
  }
  return { faults, pieces: pieces.length };
}
"""
"""Function that returns sentences on what lacks its size, overlaps or runs out of its parent, and how many things it measured."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium; without it the tests are skipped, and fail where every test must run."""
    if CHROMIUM is None:
        absent = "Chromium is not installed: apt-get install chromium"
        if os.environ.get("CI"):
            pytest.fail(absent)
        pytest.skip(absent)
    from playwright.sync_api import sync_playwright

    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


class Folder:
    """A folder behind a local address."""

    def __init__(self, folder: Path) -> None:
        class Quiet(http.server.SimpleHTTPRequestHandler):
            def log_message(self, *texts: Any) -> None: ...

        self.server = http.server.ThreadingHTTPServer(
            ("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder))
        )
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Folder]:
    """The documentation that ``make docs`` built, and the README as a package index shows it."""
    if not (ROOT / "site" / "index.html").is_file():
        pytest.fail("site/ is not built: make docs")
    folder = tmp_path_factory.mktemp("site") / "site"
    shutil.copytree(ROOT / "site", folder)
    served = Folder(folder)
    import markdown

    absolute = script(ROOT / "benches" / "index_readme.py").absolute
    text = absolute((ROOT / "README.md").read_text(encoding="utf-8"), served.url)
    body = markdown.markdown(text, extensions=["fenced_code", "tables"])
    style = "main{max-width:880px;margin:auto} img{max-width:100%} pre,table{overflow-x:auto;display:block}"
    style += "code{overflow-wrap:anywhere} pre code{overflow-wrap:normal}"
    (folder / "readme.html").write_text(f"{HEAD}<style>{style}</style><main>{body}</main>", encoding="utf-8")
    yield served
    served.server.shutdown()
    served.server.server_close()


@pytest.fixture(scope="module")
def arm() -> Experiment:
    return noisy(arm_log(1))


@pytest.fixture(scope="module")
def fit(arm: Experiment) -> Identification:
    return didim.identify(arm, didim.DIDIM())


HEAD = (
    '<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,">'
    '<meta name="viewport" content="width=device-width">'
)
"""Begin of a page without one of its own."""
SHORT = ExcitationSettings(iterations=15, starts=1, duration_s=4.0, parameters="reference")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, fit: Identification, arm: Experiment) -> dict[str, Path]:
    """A file of each kind of page."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "arm.toml").write_text(ARM, encoding="utf-8")
    (folder / "twin").mkdir()

    def on_positions() -> str:
        log = twin(folder / "twin", legs(), commands(6, 8.0, steps=True), noise=1e-4)
        return report.render(fitted(log), log)

    def of_study() -> str:
        spec = read_study(small_study(), PLACE)
        return report.render(study(spec, folder / "study.jsonl", executor="serial"))

    def in_notebook() -> str:
        # The output of a cell in Jupyter is as wide as the page less the prompt.
        style = "body{margin:0 8px 0 72px;font:13px/1.3 system-ui}@media(max-width:640px){body{margin:0 8px}}"
        shown = fit._repr_html_()
        return f'{HEAD}<style>{style}</style><main><div style="overflow-x:auto">{shown}</div></main>'

    made: dict[str, Callable[[], str]] = {
        "fit on torques": lambda: report.render(fit, arm),
        "fit on positions": on_positions,
        "comparison": lambda: report.render(shortened(didim.load_experiment(folder / "arm.toml"))),
        "validation": lambda: report.render(didim.validate(fit, arm), arm),
        "study": of_study,
        "excitation": lambda: report.render(didim.excite("planar2", SHORT)),
        "notebook": in_notebook,
    }
    written = {}
    for name in REPORTS:
        written[name] = folder / f"{name}.html"
        written[name].write_text(made[name](), encoding="utf-8")
    return written


def faults_of(browser: Any, url: str, name: str) -> list[str]:
    """Load a page once, and return what is wrong with it in any of the views, of which it takes pictures."""
    page, faults = browser.new_page(), []
    page.on("console", lambda told: faults.append(f"console: {told.text}") if told.type == "error" else None)
    page.on("pageerror", lambda error: faults.append(f"script: {error}"))
    page.on(
        "request",
        lambda request: (
            None
            if re.match(r"(file|data|blob):|http://127\.0\.0\.1:", request.url)
            else faults.append(f"asks for {request.url}")
        ),
    )
    page.goto(url, wait_until="load")
    for width, scheme in VIEWS:
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(300)
        state = page.evaluate("[innerWidth, matchMedia('(prefers-color-scheme: dark)').matches]")
        assert state == [width, scheme == "dark"]
        found = page.evaluate(MEASURE)
        faults += [f"{width} {scheme}: {fault}" for fault in found["faults"]]
        if found["pieces"] == 0:
            faults.append(f"{width} {scheme}: nothing is shown")
        page.screenshot(path=SCREENSHOTS / f"{name} {width} {scheme}.png".replace(" ", "-"), full_page=True)
    page.close()
    return faults


@pytest.mark.xdist_group("reports")
@pytest.mark.parametrize("name", REPORTS)
def test_a_page_shows_what_it_holds(browser: Any, pages: dict[str, Path], name: str) -> None:
    assert faults_of(browser, pages[name].as_uri(), name) == []


@pytest.mark.xdist_group("site")
@pytest.mark.parametrize("name", [*SITE, "README"])
def test_a_page_of_the_documentation_shows_what_it_holds(browser: Any, site: Folder, name: str) -> None:
    assert faults_of(browser, f"{site.url}/{SITE.get(name, 'readme.html')}", name) == []


@pytest.fixture(scope="module")
def view() -> Iterator[str]:
    """The address of `didim view`."""
    command = [sys.executable, "-u", "-m", "didim", "view", "ur5e", "--port", "18231"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        (address,) = re.findall(r"http://[\w.]+:\d+", next(process.stdout))
        yield address
        process.terminate()


CANVAS_ALONE = "body * { visibility: hidden } canvas { visibility: visible !important }"
AXES_PX = 90
"""Size (pixels) of the small axes in the lower left corner."""


@pytest.mark.xdist_group("site")
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (400, "dark")])
def test_the_view_shows_the_robot_within_its_window(browser: Any, view: str, width: int, scheme: str) -> None:
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme)
    page, errors = context.new_page(), list[str]()
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(view)
    panel = page.get_by_text("joint axes").first
    panel.wait_for(timeout=120_000)
    page.wait_for_timeout(5000)
    path = SCREENSHOTS / f"view-{width}-{scheme}.png"
    page.screenshot(path=path)
    # On a phone the panel lies below; on a desktop it floats beside the robot.
    covered = page.get_by_text("ur5e").first.bounding_box()["y"] if width < 640 else 800.0
    page.add_style_tag(content=CANVAS_ALONE)
    page.wait_for_timeout(500)
    alone = SCREENSHOTS / f"view-{width}-{scheme}-canvas.png"
    page.screenshot(path=alone)
    shown = page.evaluate("document.documentElement.dataset.mantineColorScheme")
    context.close()
    assert not errors
    assert shown == scheme
    picture = matplotlib.image.imread(alone)[:, :, :3]
    # Axes of the joints and gravity are coloured; links, floor and paper are grey.
    coloured = np.ptp(picture, axis=2) > 0.15
    coloured[-AXES_PX:, :AXES_PX] = False
    rows, columns = (np.flatnonzero(coloured.any(axis=axis)) for axis in (1, 0))
    assert 0 < rows[0] < rows[-1] < covered
    assert 0 < columns[0] < columns[-1] < width - 1
    assert max(np.ptp(rows) / covered, np.ptp(columns) / width) > 0.4


@pytest.mark.xdist_group("site")
def test_the_socket_of_the_view_refuses_another_origin(view: str) -> None:
    address = view.replace("http", "ws", 1)
    with urllib.request.urlopen(view) as page:
        assert page.status == 200
    with connect(address, origin=Origin(view), open_timeout=10):
        pass
    with pytest.raises(InvalidStatus, match="403"):
        connect(address, origin=Origin("http://elsewhere.example"), open_timeout=10)
