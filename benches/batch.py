"""How long do 9 428 simulations of the 10 s experiment take, the number that the paper's CLOE needed in 16 hours?

    python benches/batch.py [--candidates 9428] [--threads 2]

simulates random candidates around the parameters of Table II (corrected) in one batch, and prints the
seconds and what a Runge-Kutta step and lane took.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from didim.experiment.loop import closed_loop
from didim.studies.simulated_log import packaged_experiment, simulated_log


def main() -> None:
    parser = argparse.ArgumentParser(description="A batch of closed-loop simulations of the TX40.")
    parser.add_argument("--candidates", type=int, default=9428)
    parser.add_argument("--threads", type=int)
    arguments = parser.parse_args()

    experiment = packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    log = simulated_log(experiment, x)
    (recording,) = log.recordings
    loop = closed_loop(log, recording)
    assert recording.tau is not None
    # A scale in common keeps M(q) positive definite; frictions and offsets may take one each.
    rng = np.random.default_rng(0)
    candidates = np.tile(x, (arguments.candidates, 1))
    candidates *= rng.uniform(0.7, 1.4, (arguments.candidates, 1))
    rubbing = [k for k, name in enumerate(log.robot.parameter_names) if name.startswith(("Fv", "Fc", "Off"))]
    candidates[:, rubbing] *= rng.uniform(0.3, 3.0, (arguments.candidates, len(rubbing)))
    ones = np.ones(log.robot.n_dof)
    begin = time.perf_counter()
    costs, outcomes = loop.costs(
        candidates,
        recording.q,
        recording.tau,
        weight_q=ones,
        weight_tau=0.0 * ones,
        threads=arguments.threads,
    )
    seconds = time.perf_counter() - begin
    complete = sum(outcome.completed for outcome in outcomes)
    print(
        f"{len(candidates)} simulations of {loop.t[-1]:g} s, {loop.schedule.steps} steps each: {seconds:.1f} s, "
        f"{1e6 * seconds / (len(candidates) * loop.schedule.steps):.3f} us per step and candidate on all threads; "
        f"{complete} ran to their end, norm (19) from {np.sqrt(costs.min()):.3g} rad"
    )


if __name__ == "__main__":
    main()
