"""Both integrators on the TX40 with steep friction: steps, position error beside encoder noise, and processor time.

    python benches/integrators.py [--smoothing 0.01 0.001] [--seconds 10]

prints the rows of the table in docs/simulation.md, section Steep friction. The error is that against steps of 0.01 ms by ``rk4``,
0.002 ms for a smoothing of 0.001 rad/s; the time is that of eight candidates on one thread, the smallest of three runs.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from peer.task import tx40

import didim
from didim.loop.closed_loop import ClosedLoop

NOISE = 1e-6 * np.array([1.0, 1.0, 2.0, 2.0, 2.0, 3.0])
"""Encoder noise of each joint (rad)."""
FINE_S = np.array([5e-4, 5e-4, 2.5e-4, 2e-4, 2e-4, 1.25e-4])
"""Fine steps of each joint for a smoothing of 0.01 rad/s, those of the packaged TX40."""
CANDIDATES = 8


def main() -> None:
    """Print the rows of each smoothing."""
    options = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    options.add_argument("--smoothing", type=float, nargs="+", default=[0.01, 0.001], help="rad/s")
    options.add_argument("--seconds", type=float, default=10.0)
    chosen = options.parse_args()
    for smoothing in chosen.smoothing:
        rows(smoothing, chosen.seconds)


def rows(smoothing: float, seconds: float) -> None:
    """Print the rows of a smoothing (rad/s)."""
    task = tx40()
    robot = task.robot.with_smoothing([smoothing] * 6)

    def loop(**settings: object) -> ClosedLoop:
        return ClosedLoop.of(
            robot,
            task.loop.reference,
            task.loop.controller,
            rate_hz=1000,
            duration_s=seconds,
            **settings,  # type: ignore[arg-type]
        )

    scale = smoothing / 0.01
    (exact, *_), _ = loop().even(1e-5 if scale >= 1.0 else 2e-6).run(task.x[None])
    motion = didim.Reference.sampled(exact[0], rate_hz=1000.0)
    along = loop(step=1e-3, fine_step=(scale * FINE_S).tolist()).along(motion)
    runs = {"rk4, defaults": loop(), "rk4, along the motion": along}
    runs |= {f"rk4, {step:g} ms": loop().even(1e-3 * step) for step in (0.1, 0.05)}
    runs |= {f"imex, {step:g} ms": loop(step=1e-3 * step, integrator="imex") for step in (1.0, 0.5, 0.25)}
    many = np.tile(task.x, (CANDIDATES, 1))
    for name, run in runs.items():
        (q, *_), _ = run.run(task.x[None])
        error = float(np.max(np.sqrt(np.mean((q[0] - exact[0]) ** 2, axis=0)) / NOISE))
        seconds_of = min(clock(run, many) for _ in range(3))
        print(
            f"{smoothing:<7g} {name:24s} {run.schedule.steps:8d} steps  {error:8.2g} noises  {seconds_of:6.2f} s",
            flush=True,
        )


def clock(loop: ClosedLoop, candidates: np.ndarray) -> float:
    """Processor time of a run on this thread (s)."""
    start = time.thread_time()
    loop.run(candidates, threads=1)
    return time.thread_time() - start


if __name__ == "__main__":
    main()
