"""The counterbalance of a KUKA KR 300: two public logs, models with and without a spring, each log predicted by the other's result.

    python benches/kr300.py DATA

takes ``A.mat`` and ``B.mat`` from DATA/kr300 and prints the table of docs/palletiser.md, relative errors in per cent, and the
stiffness with its standard deviation in each log. Nothing is chosen by the logs: the geometry is that of the maker's drawing.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import scipy.io

import didim
from didim.cli.main import main as command
from didim.robot.friction import FrictionTerm, Law

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from test_springs import COLUMNS, kr300

SHOULDER = 1
"""Joint with the counterbalance, from 0."""
MODELS: dict[str, tuple[Law, ...]] = {
    "plain": (),
    "linear spring": ("spring",),
    "weight (`gravity`)": ("sine", "cosine"),
}


def main() -> int:
    data = Path(sys.argv[1]) / "kr300"
    ratios = scipy.io.loadmat(data / "A.mat")["para"][0, 0]["u"].ravel()
    logs = {}
    with tempfile.TemporaryDirectory() as folder:
        robot = kr300(Path(folder), ratios, "")
        options = [word for key, name in COLUMNS.items() for word in ("--columns", f"{key}=rec.{name}")]
        for side in ("position=joint", "reference=joint", "torque=motor"):
            options += ["--side", side]
        for run in "AB":
            out = Path(folder) / f"{run}.toml"
            if command(["init", str(robot), str(data / f"{run}.mat"), *options, "-o", str(out)]):
                return 1
            logs[run] = didim.load_experiment(out)
    for solver in (None, "consistent"):
        for name, laws in MODELS.items():
            terms = [FrictionTerm(law=law, joint=SHOULDER) for law in laws]
            own = {key: replace(log, robot=log.robot.with_terms(terms)) for key, log in logs.items()}
            fits = {key: didim.identify(log, didim.IDIMLS(solver=solver)) for key, log in own.items()}
            errors = [100.0 * fits[run].overall_relative_error for run in "AB"]
            for run, other in ("AB", "BA"):
                (seen,) = didim.validate(fits[other], own[run]).recordings
                errors.append(100.0 * seen.direct_overall)
            print(
                f"{name}, {solver or 'unconstrained'}:",
                " ".join(f"{error:.2f}" for error in errors),
                flush=True,
            )
            for run, fit in fits.items():
                for place in [k for k, key in enumerate(fit.names) if key.startswith(("Ks", "G"))]:
                    print(f"  {run}: {fit.names[place]} = {fit.beta[place]:.4g} +- {fit.std[place]:.4g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
