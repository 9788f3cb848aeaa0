"""Execute the notebooks of the documentation, and write the pages that show them.

    python benches/notebooks.py [NAME ...]

runs every ``docs/notebooks/*.ipynb``, or those that are named, from top to bottom in a fresh kernel, saves it with its outputs, and
writes the page of the same name beside it: text, code, tables and pictures. It needs nbclient and ipykernel
(`pip install --group notebooks`); the site is built from the pages and needs neither.
Tested in ``tests/test_notebook.py``.
"""

from __future__ import annotations

import base64
import io
import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
MOST_LINES = 40
"""Lines of printed text that a page shows."""
COLORS = 48
"""Colours of a picture."""


def execute(path: Path) -> None:
    """Run a notebook and save it with its outputs, without times and counters of the machine."""
    # Both are for writers of notebooks alone.
    nbformat, client = import_module("nbformat"), import_module("nbclient")
    notebook = nbformat.read(path, as_version=4)
    client.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(path.parent)}}).execute()
    for cell in notebook.cells:
        cell.metadata = {}
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = _small(output.data["image/png"])
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"]}
    nbformat.write(notebook, path)


def _small(picture: str) -> str:
    """Return a picture in base64 with as few colours as curves need."""
    from PIL import Image

    data = io.BytesIO()
    colors = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB").quantize(COLORS)
    colors.save(data, "PNG", optimize=True)
    return base64.b64encode(data.getvalue()).decode("ascii")


def page(notebook: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """Return the page of a notebook, and its pictures by name."""
    lines: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            lines += [text, ""]
            continue
        lines += ["```python", text, "```", ""]
        for output in cell["outputs"]:
            data = output.get("data", {"text/plain": output.get("text", "")})
            if "image/png" in data:
                picture = f"{name}_{len(pictures) + 1}.png"
                pictures[picture] = base64.b64decode("".join(data["image/png"]))
                lines += [f"![Picture of the cell above]({picture})", ""]
            elif "text/html" in data:
                # A page of MkDocs takes HTML that stands on one line as it is; lines of preformatted text stay.
                html = re.sub(r">\s*\n\s*<", "><", "".join(data["text/html"]).strip())
                html = html.replace(' style="text-align: left"', "")  # as cells are without it
                html = re.sub(r"<style.*?</style>", "", html, flags=re.DOTALL)
                # The site has a style for plain tables, and none for those of pandas.
                html = html.replace(' border="1" class="dataframe"', "")
                lines += [html.replace("\n", "&#10;"), ""]
            else:
                printed = "".join(data["text/plain"]).rstrip("\n")
                if not printed:  # a line of progress that is gone
                    continue
                shown = printed.split("\n")
                shown = shown if len(shown) <= MOST_LINES else [*shown[:MOST_LINES], "[...]"]
                lines += ["```text", *shown, "```", ""]
    lines.append(f"[This page as a notebook]({name}.ipynb)")
    return "\n".join(lines) + "\n", pictures


def main() -> int:
    """Execute all notebooks and write their pages."""
    import json

    names = sys.argv[1:]
    for path in sorted(FOLDER.glob("*.ipynb")):
        if not names or path.stem in names:
            execute(path)
        text, pictures = page(json.loads(path.read_text(encoding="utf-8")), path.stem)
        path.with_suffix(".md").write_text(text, encoding="utf-8")
        for name, data in pictures.items():
            (FOLDER / name).write_bytes(data)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB, {len(pictures)} pictures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
