"""Are the reported standard deviations right? Errors of the estimates over many noise seeds, in standard deviations.

    python benches/calibration.py [--seeds 100] [--json FILE]

simulates the log of the packaged TX40 experiment once, adds noise once per seed, and identifies each log by IDIM-LS and
DIDIM. For right standard deviations the root mean square of (estimate - truth) / sigma is 1, 95 % of the truths are in
the 95 % intervals and 0.27 % beyond 3 sigma (docs/experiment.md).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import didim
from didim.compare import LOG_REFINEMENT, measured, packaged_experiment, simulated_log

# Two-sided, normal.
SIGMA_95 = 1.959964


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Calibration of the standard deviations on the simulated TX40."
    )
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()

    experiment = packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    truth = experiment.robot.base_parameters.project(x)
    log = simulated_log(experiment, x, noise=False, refinement=LOG_REFINEMENT)
    methods = (didim.IDIMLS(), didim.DIDIM())
    off: dict[str, list[list[float]]] = {method.name: [] for method in methods}
    iterations: list[int] = []
    for seed in range(arguments.seeds):
        noisy = measured(log, seed)
        for method in methods:
            fit = didim.identify(noisy, method)
            if not fit.converged:
                raise SystemExit(f"seed {seed}: {method.name}: {fit.status.value}")
            off[method.name].append(((fit.beta - truth) / fit.std).tolist())
        iterations.append(fit.n_iterations)

    print(
        f"{arguments.seeds} seeds, {len(truth)} parameters; DIDIM in {min(iterations)} to {max(iterations)} iterations"
    )
    print(f"{'':8}  {'rms':>6}  {'in 95 %':>8}  {'beyond 3 sigma':>14}  {'largest bias':>12}")
    for name, rows in off.items():
        values = np.array(rows)
        bias = values.mean(axis=0)
        worst = int(np.argmax(np.abs(bias)))
        print(
            f"{name:8}  {np.sqrt(np.mean(values**2)):6.3f}  {100.0 * np.mean(np.abs(values) < SIGMA_95):6.2f} %  "
            f"{100.0 * np.mean(np.abs(values) > 3.0):12.2f} %  {bias[worst]:+.2f} ({experiment.robot.base_parameters.names[worst]})"
        )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({"iterations": iterations, "off": off}) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
