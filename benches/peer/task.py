"""What ours and the peers compute: the TX40 with bodies in place of the base parameters of Table II, and a closed loop of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import didim
from didim.loop.closed_loop import ClosedLoop
from didim.loop.tuning import mean_inertia
from didim.robot.robot import Robot

from .timing import DisagreementError

Array = NDArray[np.float64]

SAMPLES = 4096
"""States of a batch."""
STEPS = 500
"""Runge-Kutta steps of a closed loop: 0.5 s at 1 ms. On a busy machine, short runs have rounds that nothing interrupts."""
STEP_S = 1e-3

BODIES = [
    (10.0, [0.0, 0.02, -0.1]),
    (8.0, [0.11, -0.01, 0.05]),
    (5.0, [0.01, -0.05, 0.02]),
    (3.0, [0.0, 0.01, -0.08]),
    (1.0, [0.0, -0.02, 0.01]),
    (0.5, [0.01, 0.0, 0.05]),
]
"""Mass (kg) and centre (m) of balls in place of the links: the peers want bodies, and Table II has base parameters alone."""
RADIUS_M = 0.1
NATURAL_HZ = [20.0, 20.0, 25.0, 35.0, 35.0, 50.0]
DAMPING = 0.7


@dataclass(frozen=True)
class Task:
    """The TX40 twice, states, and its closed loop.

    Attributes
    ----------
    robot, x
        With coupled wrist, rotors and friction; its standard parameters.
    plain, free
        What the peers can have: links and rotors without coupling; standard parameters without friction.
    q, dq, ddq : (SAMPLES, 6) arrays
        Random states.
    tau : (SAMPLES, 6) array
        Torques of `robot` there.
    loop : ClosedLoop
        Of `robot`, `STEPS` steps of `STEP_S`.
    """

    robot: Robot
    x: Array
    plain: Robot
    free: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    loop: ClosedLoop

    @property
    def rotors(self) -> Array:
        """Inertia of the rotors, joint side (kg.m^2), (6,)."""
        return self.free[[self.plain.parameter_names.index(f"Ia{j + 1}") for j in range(6)]]

    def longer(self, steps: int) -> ClosedLoop:
        """The same closed loop for more steps."""
        loop = self.loop
        return _loop(loop.robot, loop.reference, loop.controller, steps)

    def check(self, program: str, what: str, theirs: Array, ours: Array, tolerance: float = 1e-9) -> None:
        """Raise `DisagreementError` unless both are equal, relative to the largest value."""
        error = float(np.abs(theirs - ours).max() / np.abs(ours).max())
        if not error <= tolerance:
            raise DisagreementError(
                f"{program} and didim differ by {error:.2g} (relative) in {what}; at most {tolerance:g} is allowed"
            )


def tx40() -> Task:
    """Make the task."""
    robot = didim.load_robot("tx40").with_smoothing([0.01] * 6)
    x = _parameters(robot)
    identity = tuple(tuple(row) for row in np.eye(6).tolist())
    plain = replace(robot, geometry=replace(robot.geometry, coupling=identity))
    free = np.array(x[: len(plain.parameter_names)])
    free[[name.startswith(("Fv", "Fc", "Off")) for name in plain.parameter_names]] = 0.0
    rng = np.random.default_rng(0)
    q, dq, ddq = (scale * rng.uniform(-1.0, 1.0, (SAMPLES, 6)) for scale in (3.0, 2.0, 5.0))
    reference = didim.Reference.random_fourier(
        harmonics=20,
        period_s=10.0,
        max_position=[2.6, 1.8, 2.0, 3.5, 1.9, 4.0],
        max_velocity=[4.5, 4.5, 6.5, 6.5, 5.0, 10.0],
        max_acceleration=[25.0, 25.0, 35.0, 60.0, 60.0, 90.0],
        seed=1,
    )
    controller = didim.Controller.tuned(NATURAL_HZ, DAMPING, mean_inertia(robot, x, reference))
    loop = _loop(robot, reference, controller, STEPS)
    return Task(robot, x, plain, free, q, dq, ddq, didim.inverse_dynamics(robot, q, dq, ddq, x), loop)


def _loop(robot: Robot, reference: didim.Reference, controller: didim.Controller, steps: int) -> ClosedLoop:
    loop = ClosedLoop.of(
        robot,
        reference,
        controller,
        rate_hz=1.0 / STEP_S,
        duration_s=steps * STEP_S,
        step=STEP_S,
        fine_step=STEP_S,
    )
    if loop.schedule.steps != steps:
        raise SystemExit(f"the closed loop takes {loop.schedule.steps} steps, {steps} were meant")
    return loop


def bodies(task: Task) -> list[tuple[float, Array, Array]]:
    """Mass (kg), centre (m, 3) and inertia about the origin of the joint's frame (kg.m^2, 3 x 3) of each link."""
    found = []
    for j in range(6):
        first = task.plain.parameter_names.index(f"XX{j + 1}")
        xx, xy, xz, yy, yz, zz, mx, my, mz, m = task.free[first : first + 10]
        found.append(
            (
                float(m),
                np.array([mx, my, mz]) / m,
                np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
            )
        )
    return found


def _parameters(robot: Robot) -> Array:
    """Return standard parameters of the bodies, with the rotors and the friction of Table II."""
    x = np.array(robot.sets["didim"])
    for j, (mass, centre) in enumerate(BODIES):
        c = np.array(centre)
        inertia = mass * ((0.4 * RADIUS_M**2 + c @ c) * np.eye(3) - np.outer(c, c))
        first = robot.parameter_names.index(f"XX{j + 1}")
        x[first : first + 10] = [*inertia[np.triu_indices(3)], *(mass * c), mass]
    return x
