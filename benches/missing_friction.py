"""How often the test for missing friction alarms, and whether intervals hold with the shift that it adds.

    python benches/missing_friction.py                          40 logs a row
    python benches/missing_friction.py --motions 50 --seeds 4   200 logs a row, as in docs/uncertainty.md
    python benches/missing_friction.py --choice                 the terms that ``auto`` chooses on three arms, and their intervals

Logs of 10 s of a planar arm with 13 base parameters, IDIM-LS; each row has a friction law in the log that the model lacks, or none.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import didim
from friction_logs import (
    Law,
    atan,
    coulomb,
    dahl,
    fitted,
    load,
    logged,
    lugre,
    robot,
    stribeck,
    subject,
    truth,
)

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
CHOSEN: dict[str, tuple[str, dict[str, float]]] = {
    "right, white noise": ("", {}),
    "Stribeck 0.2 Fc": ("curve", {"Fs": 0.2}),
    "Stribeck 0.4 Fc": ("curve", {"Fs": 0.4}),
    "arctangent 0.4 Fc": ("curve", {"Fa": 0.4}),
    "memory, 2e-3 rad": ("dahl", {"Fz": 1.0, "Fc": 0.0}),
    "memory, 2e-2 rad": ("dahl", {"Fz": 1.0, "Fc": 0.0}),
    "load 0.08": ("load", {"Fl": 0.08}),
    "LuGre, Stribeck 0.3 Fc": ("dahl", {}),
}
"""Law to be chosen at all joints, Stribeck and arctangent being one, and what differs from the plain robot, over Fc but for Fl."""
FIRST = 1000
"""First seed of the motions; those of the tests are below."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--motions", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=4, help="draws of the noise for each motion")
    parser.add_argument("--only", nargs="*", default=(), help="rows whose name has one of these words")
    parser.add_argument("--choice", action="store_true", help="choose terms in place of testing for them")
    parser.add_argument(
        "--arms", nargs="+", default=["planar2", "tx40", "ur5e-like"], help="arms of --choice"
    )
    given = parser.parse_args()
    if given.choice:
        choose(given)
        return
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


def choose(given: argparse.Namespace) -> None:
    """Print at how many joints the law of the log is chosen, other terms, coverage, and widths over the true one."""
    print(
        f"{'':36}{'joints':>7}{'chosen':>9}{'others a joint':>16}{'95 % of parameters':>20}  width of memory / true"
    )
    for arm, name in itertools.product(given.arms, CHOSEN):
        if given.only and not any(word in name for word in given.only):
            continue
        law, more = CHOSEN[name]
        n = robot(arm).n_dof
        values = dict(zip(robot(arm).base_parameters.names, truth(arm), strict=True))
        for key, share in more.items():
            values |= {
                f"{key}{j + 1}": share * (1.0 if key == "Fl" else subject(arm).fc[j]) for j in range(n)
            }
        true_width = float(name.split()[-2]) if name.startswith("memory") else np.nan
        right, others, inside, widths = [], [], [], []
        for motion, seed in itertools.product(range(given.motions), range(given.seeds)):
            function, settings = CASES[name]
            log = logged(robot(arm), function, FIRST + motion, draw=seed, of=arm, **settings)
            fit = didim.identify(log, didim.IDIMLS(friction="auto"))
            terms = fit.settings["robot"]["friction"]["terms"]
            kinds = {
                ("curve" if one["law"] in ("atan", "stribeck") else one["law"], one["joint"]) for one in terms
            }
            right += [not law or (law, joint) in kinds for joint in range(n)]
            others.append(sum(kind not in (law, "hold") for kind, _ in kinds) / n)
            widths += [one["velocity"] / true_width for one in terms if one["law"] == "dahl"]
            # With an arctangent in the place of Stribeck's law Coulomb friction is another.
            if (
                all(right[-n:])
                and not name.startswith("LuGre")
                and {f"{key}1" for key in more} <= set(fit.names)
            ):
                factor = fit.uncertainty.factor(0.95)  # type: ignore[union-attr]
                for parameter, value, std in zip(fit.names, fit.beta, fit.std, strict=True):
                    if parameter in values and std > 0.0:
                        inside.append(abs(value - values[parameter]) <= factor * std)
        covered = f"{100 * np.mean(inside):.1f} %" if inside else "-"
        spread = (
            f"{np.median(widths):.3f} ({np.min(widths):.2f} to {np.max(widths):.2f})"
            if law == "dahl" and np.isfinite(true_width) and widths
            else ""
        )
        print(
            f"{arm + ', ' + name:36}{len(right):7d}{100 * np.mean(right):7.1f} %{np.mean(others):16.2f}{covered:>20}  {spread}",
            flush=True,
        )


if __name__ == "__main__":
    main()
