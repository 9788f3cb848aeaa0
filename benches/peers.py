"""Speed beside Pinocchio in one run, on the same TX40 and one thread.

    python benches/peers.py [--json FILE]

needs ``pip install didim[peers]``. Every round times each function once, so that a machine that slows down slows all of
them; the medians over the rounds are printed, and the ratios are what to look at. Pinocchio has the links and the rotors; ours has
the friction and the coupled wrist as well. Pinocchio's regressor and ``crba`` have no batch: their times include a call from
Python for each sample.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import didim
from didim.closed_loop import mean_inertia
from didim.robot import Robot
from didim.simulation import ClosedLoop

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from twins import PINOCCHIO_ORDER, pinocchio_model

Array = NDArray[np.float64]

SAMPLES = 4096
"""States of a batch."""
STEPS = 1000
"""Runge-Kutta steps of a closed loop: 1 s at 1 ms."""
CANDIDATES = 64


BODIES = [
    (10.0, [0.0, 0.02, -0.1]),
    (8.0, [0.11, -0.01, 0.05]),
    (5.0, [0.01, -0.05, 0.02]),
    (3.0, [0.0, 0.01, -0.08]),
    (1.0, [0.0, -0.02, 0.01]),
    (0.5, [0.01, 0.0, 0.05]),
]
"""Mass (kg) and centre (m) of balls in place of the links: Pinocchio wants bodies, and Table II has base parameters alone."""
RADIUS_M = 0.1


def parameters(robot: Robot) -> Array:
    """Return standard parameters of the bodies, with the rotors and the friction of Table II."""
    x = np.array(robot.sets["didim"])
    for j, (mass, centre) in enumerate(BODIES):
        c = np.array(centre)
        inertia = mass * ((0.4 * RADIUS_M**2 + c @ c) * np.eye(3) - np.outer(c, c))
        first = robot.parameter_names.index(f"XX{j + 1}")
        x[first : first + 10] = [*inertia[np.triu_indices(3)], *(mass * c), mass]
    return x


def agree(robot: Robot, model: pin.Model, x: Array, states: tuple[Array, Array, Array]) -> None:
    """Stop unless both compute the same robot, without what Pinocchio does not have."""
    identity = tuple(tuple(row) for row in np.eye(6).tolist())
    plain = replace(robot, geometry=replace(robot.geometry, coupling=identity))
    free = np.array(x[: len(plain.parameter_names)])
    free[[name.startswith(("Fv", "Fc", "Off")) for name in plain.parameter_names]] = 0.0
    q, dq, ddq = states
    data = model.createData()
    for k in range(10):
        tau = pin.rnea(model, data, q[k], dq[k], ddq[k])
        ours = didim.inverse_dynamics(plain, q[k : k + 1], dq[k : k + 1], ddq[k : k + 1], free)[0]
        np.testing.assert_allclose(ours, tau, rtol=0, atol=1e-9 * np.abs(tau).max())
        back = didim.direct_dynamics(plain, q[k : k + 1], dq[k : k + 1], tau[None], free)[0]
        acceleration = pin.aba(model, data, q[k], dq[k], tau)
        np.testing.assert_allclose(back, acceleration, rtol=0, atol=1e-9 * np.abs(acceleration).max())
        regressor = pin.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])
        columns = [14 * j + place for j in range(6) for place in PINOCCHIO_ORDER]
        W = didim.regressor(plain, q[k : k + 1], dq[k : k + 1], ddq[k : k + 1])[0][:, columns]
        np.testing.assert_allclose(W, regressor, rtol=0, atol=1e-9 * np.abs(regressor).max())


def contestants() -> dict[str, tuple[Callable[[], object], int]]:
    """Return what is timed, and how many units of work one call does."""
    robot = didim.load_robot("tx40").with_smoothing([0.01] * 6)
    x = parameters(robot)
    rng = np.random.default_rng(0)
    q, dq, ddq = (scale * rng.uniform(-1.0, 1.0, (SAMPLES, 6)) for scale in (3.0, 2.0, 5.0))
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    model = pinocchio_model(robot, x)
    model.armature = x[[robot.parameter_names.index(f"Ia{j + 1}") for j in range(6)]]
    agree(robot, model, x, (q, dq, ddq))
    data, pool = model.createData(), pin.ModelPool(model, 1)
    columns = [np.asfortranarray(values.T) for values in (q, dq, ddq, tau)]
    out = np.zeros((6, SAMPLES), order="F")
    few = 512  # of what is called from Python sample by sample

    def each(function: Callable[..., object], *arrays: Array) -> Callable[[], None]:
        def run() -> None:
            for row in zip(*(values[:few] for values in arrays), strict=True):
                function(model, data, *row)

        return run

    reference = didim.Reference.random_fourier(
        harmonics=20,
        period_s=10.0,
        max_position=[2.6, 1.8, 2.0, 3.5, 1.9, 4.0],
        max_velocity=[4.5, 4.5, 6.5, 6.5, 5.0, 10.0],
        max_acceleration=[25.0, 25.0, 35.0, 60.0, 60.0, 90.0],
        seed=1,
    )
    controller = didim.Controller.tuned(
        [20.0, 20.0, 25.0, 35.0, 35.0, 50.0], 0.7, mean_inertia(robot, x, reference)
    )
    step = 1.0 / STEPS
    loop = ClosedLoop.of(
        robot, reference, controller, rate_hz=1.0 / step, duration_s=1.0, step=step, fine_step=step
    )
    if loop.schedule.steps != STEPS:
        raise SystemExit(f"the closed loop takes {loop.schedule.steps} steps, {STEPS} were meant")
    target, one = reference.at(loop.t)[0], np.ones(6)

    def costs(candidates: int) -> Callable[[], None]:
        xs = np.tile(x, (candidates, 1))

        def run() -> None:
            found, _ = loop.costs(xs, target, 0.0 * target, weight_q=one, weight_tau=one, threads=1)
            if not np.isfinite(found).all():
                raise SystemExit("the closed loop did not run to its end")

        return run

    return {
        "Pinocchio abaInParallel": (
            lambda: pin.abaInParallel(1, pool, columns[0], columns[1], columns[3], out),
            SAMPLES,
        ),
        "Pinocchio rneaInParallel": (lambda: pin.rneaInParallel(1, pool, *columns[:3], out), SAMPLES),
        "Pinocchio computeJointTorqueRegressor": (each(pin.computeJointTorqueRegressor, q, dq, ddq), few),
        "Pinocchio crba": (each(pin.crba, q), few),
        "direct_dynamics": (lambda: didim.direct_dynamics(robot, q, dq, tau, x), SAMPLES),
        "inverse_dynamics": (lambda: didim.inverse_dynamics(robot, q, dq, ddq, x), SAMPLES),
        "regressor, fresh arrays": (lambda: didim.regressor(robot, q, dq, ddq), SAMPLES),
        "inertia_matrix": (lambda: didim.inertia_matrix(robot, q, x), SAMPLES),
        "closed-loop RK4 step, 1 candidate": (costs(1), STEPS),
        f"closed-loop RK4 step and lane, {CANDIDATES} candidates": (costs(CANDIDATES), STEPS * CANDIDATES),
    }


RATIOS = {
    f"4 aba / RK4 step and lane, {CANDIDATES} candidates": (
        4.0,
        "Pinocchio abaInParallel",
        f"closed-loop RK4 step and lane, {CANDIDATES} candidates",
    ),
    "4 aba / RK4 step, 1 candidate": (4.0, "Pinocchio abaInParallel", "closed-loop RK4 step, 1 candidate"),
    "aba / direct_dynamics": (1.0, "Pinocchio abaInParallel", "direct_dynamics"),
    "rnea / inverse_dynamics": (1.0, "Pinocchio rneaInParallel", "inverse_dynamics"),
    "computeJointTorqueRegressor / regressor": (
        1.0,
        "Pinocchio computeJointTorqueRegressor",
        "regressor, fresh arrays",
    ),
    "crba / inertia_matrix": (1.0, "Pinocchio crba", "inertia_matrix"),
}


def measure(rounds: int) -> dict[str, float]:
    """Median time of a unit of work (us) of each contestant."""
    found = contestants()
    times: dict[str, list[float]] = {name: [] for name in found}
    for round_ in range(rounds + 1):
        for name, (run, units) in found.items():
            start = time.perf_counter()
            run()
            elapsed = time.perf_counter() - start
            if round_:  # the first round warms up
                times[name].append(1e6 * elapsed / units)
    return {name: median(values) for name, values in times.items()}


def main() -> int:
    """Print times and ratios."""
    parser = argparse.ArgumentParser(description="Time didim beside Pinocchio, on one thread.")
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write times (us) and ratios as JSON")
    parser.add_argument("--rounds", type=int, default=21, help="rounds (default: %(default)s)")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error(f"--rounds must be at least 1, got {arguments.rounds}")
    times = measure(arguments.rounds)
    ratios = {name: factor * times[over] / times[under] for name, (factor, over, under) in RATIOS.items()}
    print(
        f"TX40, one thread, medians of {arguments.rounds} rounds; Pinocchio {pin.__version__}, didim {didim.__version__}\n"
    )
    width = max(map(len, [*times, *ratios]))
    for name, value in times.items():
        print(f"{name:{width}}  {value:8.3f} us")
    print()
    for name, value in ratios.items():
        print(f"{name:{width}}  {value:8.2f}")
    if arguments.json is not None:
        result = {
            "rounds": arguments.rounds,
            "pinocchio": pin.__version__,
            "times_us": times,
            "ratios": ratios,
        }
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
