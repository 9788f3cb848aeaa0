"""Are errors of the palletiser of docs/palletiser.md as large as sigma says? Its log over many seeds, by three methods.

python benches/palletiser.py [--seeds 30] [--methods idim-ls didim cloe]
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

import didim
from didim.methods.method import Method
from didim.studies.simulated_log import measured

PAGE = Path(__file__).resolve().parents[1] / "docs" / "palletiser.md"
METHODS: dict[str, Method] = {
    "idim-ls": didim.IDIMLS(),
    "didim": didim.DIDIM(),
    "cloe": didim.CLOE(start="idim-ls"),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    asked = parser.parse_args()
    (code,) = re.findall(
        r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    page: dict[str, Any] = {"__name__": "palletiser"}
    exec(compile(code, str(PAGE), "exec", dont_inherit=True), page)
    clean = page["simulated"](None)
    errors: dict[str, list[np.ndarray]] = {name: [] for name in asked.methods}
    for seed in range(asked.seeds):
        log = measured(clean, seed)
        base = log.robot.base_parameters
        truth = dict(zip(base.names, base.project(page["truth"](log.robot)), strict=True))
        for name in asked.methods:
            fit = didim.identify(log, METHODS[name])
            errors[name].append((fit.beta - np.array([truth[key] for key in fit.names])) / fit.std)
        for name, found in errors.items():
            z = np.array(found)
            inside = 100.0 * np.mean(np.abs(z) < 1.96)
            rms = np.sqrt(np.mean(z**2))
            print(f"{seed + 1:3d} seeds  {name:8s} rms z {rms:.3f}  within 1.96: {inside:.1f} %", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
