"""How often the test for missing friction alarms, and whether intervals hold with the shift that it adds.

    python benches/missing_friction.py                          40 logs a row
    python benches/missing_friction.py --motions 50 --seeds 4   200 logs a row, as in docs/uncertainty.md

Logs of 10 s of a planar arm with 13 base parameters, IDIM-LS; each row has a friction law in the log that the model lacks, or none.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from friction_logs import Law, atan, coulomb, dahl, fitted, load, lugre, stribeck, truth

CASES: dict[str, tuple[Law, dict[str, Any]]] = {
    "right, white noise": (coulomb, {}),
    "right, AR(1) 0.95": (coulomb, {"noise": "correlated"}),
    "right, 100 Hz": (coulomb, {"rate_hz": 100.0}),
    "right, 2^16 counts": (coulomb, {"counts": 65536}),
    "right, 4096 counts": (coulomb, {"counts": 4096}),
    "Stribeck 0.1 Fc": (stribeck(0.1), {}),
    "Stribeck 0.2 Fc": (stribeck(0.2), {}),
    "Stribeck 0.4 Fc": (stribeck(0.4), {}),
    "arctangent 0.4 Fc": (atan(0.4), {}),
    "memory, 2e-3 rad": (dahl(2e-3), {}),
    "memory, 2e-2 rad": (dahl(2e-2), {}),
    "load 0.08": (load(0.08), {}),
    "LuGre, Stribeck 0.3 Fc": (lugre(2e-2), {}),
}
FIRST = 1000
"""First seed of the motions; those of the tests are below."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--motions", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=4, help="draws of the noise for each motion")
    parser.add_argument("--only", nargs="*", default=(), help="rows whose name has one of these words")
    given = parser.parse_args()
    print(f"{'':24}{'logs':>5}{'alarms':>9}{'95 % before':>13}{'after':>8}{'width':>7}  named")
    for name, (law, settings) in CASES.items():
        if given.only and not any(word in name for word in given.only):
            continue
        alarms, before, after, width = [], [], [], []
        names: Counter[str] = Counter()
        for motion in range(given.motions):
            for seed in range(given.seeds):
                fit = fitted(law, FIRST + motion, draw=seed, **settings)
                assert fit.uncertainty is not None
                assert fit.uncertainty.friction is not None
                alarm, factor = fit.uncertainty.friction, fit.uncertainty.factor(0.95)
                plain = np.sqrt(fit.std**2 - alarm.shift**2)
                error = np.abs(fit.beta - truth())
                alarms.append(alarm.raised)
                names[alarm.law] += alarm.raised
                before.append(error <= factor * plain)
                after.append(error <= factor * fit.std)
                width.append(np.median(fit.std / plain))
        found = ", ".join(f"{law} {count}" for law, count in names.most_common() if count)
        print(
            f"{name:24}{len(alarms):5d}{100 * np.mean(alarms):7.1f} %{100 * np.mean(before):11.1f} %"
            f"{100 * np.mean(after):6.1f} %{np.median(width):7.2f}  {found}",
            flush=True,
        )


if __name__ == "__main__":
    main()
