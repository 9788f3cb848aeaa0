"""Program that observes rows of `since_0_2_0.py` under one version, each in an empty folder of its own."""

from __future__ import annotations

import json
import os
import shutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import didim


def measured(call: Callable[[], str], folder: Path) -> str:
    """Return what a row shows, or how it ended."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    os.chdir(folder)
    try:
        return call()
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:120]


def main() -> None:
    """Measure the rows of the command line into a JSON file."""
    from since_0_2_0 import ROWS

    folder, output = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    warnings.simplefilter("ignore")
    found = {"version": didim.__version__, "package": str(Path(didim.__file__).resolve().parent)}
    for index in map(int, sys.argv[3:]):
        found[str(index)] = measured(ROWS[index].observe, folder / str(index))
        print(index, found[str(index)], file=sys.stderr, flush=True)
    output.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
