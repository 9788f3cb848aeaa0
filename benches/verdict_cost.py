"""What the verdict costs beside the fit, in processor seconds of all threads.

    python benches/verdict_cost.py FOLDER [--rounds 15]

FOLDER holds the CSV files of the measured TX40 (examples/tx40_log.toml). In each round the log is read and identified by IDIM-LS;
the smallest of the rounds counts for each part: reading, the fit with its jackknife, the test for missing friction, and the verdict
with its search for causes; of the ratio of the whole to the whole without the verdict, the median. docs/verdict.md has the figures.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import didim
from didim.methods import builder, identify

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "tx40_log.toml"
PARTS = {"friction": (builder, "_with_model_errors"), "verdict": (identify, "judged")}
"""Module and function of each part that is measured inside of the identification."""


def main() -> None:
    """Print the seconds of each part, and all of them over the fit."""
    parser = argparse.ArgumentParser(description="Processor seconds of the verdict beside those of the fit.")
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="CSV files of the measured TX40")
    parser.add_argument("--rounds", type=int, default=15, help="default: %(default)s")
    asked = parser.parse_args()
    smallest: dict[str, float] = defaultdict(lambda: float("inf"))
    spent: dict[str, float] = {}
    ratios = []

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **settings: Any) -> Any:
            start = time.process_time()
            result = function(*arguments, **settings)
            spent[name] = time.process_time() - start
            return result

        return run

    for name, (module, function) in PARTS.items():
        setattr(module, function, timed(name, getattr(module, function)))
    reading, identifying = timed("reading", didim.load_experiment), timed("all", didim.identify)
    for _ in range(asked.rounds):
        identifying(reading(EXAMPLE, data=asked.folder), didim.IDIMLS())
        spent["fit"] = spent.pop("all") - sum(spent[name] for name in PARTS)
        whole = sum(spent.values())
        ratios.append(whole / (whole - spent["verdict"]))
        for name, value in spent.items():
            smallest[name] = min(smallest[name], value)
    for name in ("reading", "fit", *PARTS):
        print(f"{name:10} {smallest[name]:6.3f} s")
    alone = smallest["reading"] + smallest["fit"]
    print(
        f"friction and verdict over reading and fit: {(smallest['friction'] + smallest['verdict']) / alone:.2f}"
    )
    print(f"all over reading, fit and friction, median of the rounds: {statistics.median(ratios):.2f}")


if __name__ == "__main__":
    main()
