"""The counterbalance of a KUKA KR 300: two public logs, models with and without a spring, each log predicted by the other's result.

    python benches/kr300.py DATA

takes ``A.mat`` and ``B.mat`` from DATA/kr300 and prints the table of docs/mechanisms.md, relative errors in per cent, and the
parameters of the spring with their standard deviations in each log. Nothing is chosen by the logs: the geometry is that of the
maker's drawing, and the moving part is that between the standstills that `didim check` reports.
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

from test_springs import OPTIONS, kr300, moving

SHOULDER = 1
"""Joint with the counterbalance, from 0."""
MODELS: dict[str, tuple[tuple[Law, tuple[int, ...]], ...]] = {
    "plain": (),
    "linear spring": (("spring", (SHOULDER,)),),
    "weight (`gravity`)": (("sine", (SHOULDER,)), ("cosine", (SHOULDER,))),
    "friction with root and load": (("root", tuple(range(6))), ("load", tuple(range(6)))),
}
"""Laws, and the joints that have them, by name."""


def compare(
    title: str, logs: dict[str, didim.Experiment], laws: tuple[tuple[Law, tuple[int, ...]], ...]
) -> None:
    """Print the errors of a model in each log and in the other one, unconstrained and consistent, and its spring."""
    terms = [FrictionTerm(law=law, joint=joint) for law, joints in laws for joint in joints]
    own = {key: replace(log, robot=log.robot.with_terms(terms)) for key, log in logs.items()}
    for solver in (None, "consistent"):
        fits = {key: didim.identify(log, didim.IDIMLS(solver=solver)) for key, log in own.items()}
        errors = [100.0 * fits[run].overall_relative_error for run in "AB"]
        for run, other in ("AB", "BA"):
            (seen,) = didim.validate(fits[other], own[run]).recordings
            errors.append(100.0 * seen.direct_overall)
        print(
            f"{title}, {solver or 'unconstrained'}:", " ".join(f"{error:.1f}" for error in errors), flush=True
        )
        for run, fit in fits.items():
            for place in [k for k, key in enumerate(fit.names) if key.startswith(("Ks", "G"))]:
                print(f"  {run}: {fit.names[place]} = {fit.beta[place]:.3g} +- {fit.std[place]:.3g}")


def main() -> int:
    data = Path(sys.argv[1]) / "kr300"
    ratios = scipy.io.loadmat(data / "A.mat")["para"][0, 0]["u"].ravel()
    logs = {}
    with tempfile.TemporaryDirectory() as folder:
        robot = kr300(Path(folder), ratios, "")
        for run in "AB":
            out = Path(folder) / f"{run}.toml"
            if command(["init", str(robot), str(data / f"{run}.mat"), *OPTIONS, "-o", str(out)]):
                return 1
            logs[run] = didim.load_experiment(out)
    compare("plain, whole log", logs, ())
    parts = {run: moving(log) for run, log in logs.items()}
    for name, laws in MODELS.items():
        compare(name, parts, laws)
    return 0


if __name__ == "__main__":
    sys.exit(main())
