"""The closed loop, simulated: one candidate or thousands at once.

Runge-Kutta in the core, candidates side by side in the lanes of vector registers and on all cores. Tested in
``tests/test_simulation.py``: order four, energy, power balance, a pendulum against its elliptic functions, the EMPS.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array, real_array
from .._tools.notebook import Brief
from ..errors import ShapeError, SimulationError
from ..model.dynamics import standard_vector
from ..robot.robot import Robot
from .closed_loop import DIVERGENCE, ClosedLoop
from .controller import Controller
from .memory import BALANCE, ControllerMemory
from .outcome import IntegrationError, Outcome, SimulationStatus
from .reference import Reference


class StepWarning(UserWarning):
    """Warning on too large a step of a simulation.

    Tested in ``tests/test_simulation.py``.
    """


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Brief):
    """Trajectories of the closed loop at the recording rate, joint side, SI units.

    Tested in ``tests/test_simulation.py``.

    Attributes
    ----------
    t : (n_records,) array
        Times (s).
    q, dq, ddq, tau : (n_records, n_dof) arrays; (n_candidates, n_records, n_dof) for several candidates
        Positions, velocities, accelerations, and torques (N.m, N) of the drives. NaN after an early end.
    outcomes : tuple of Outcome
        One per candidate.
    error : IntegrationError or None
        Estimate for the first candidate, if requested.
    n_steps : int
        Steps of one run; of the limb that takes most.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    outcomes: tuple[Outcome, ...]
    error: IntegrationError | None
    n_steps: int

    @property
    def status(self) -> SimulationStatus:
        """Ending of the only candidate, or of the first that did not complete."""
        return self.outcome.status

    @property
    def outcome(self) -> Outcome:
        """Outcome of the only candidate, or of the first that did not complete."""
        return next((outcome for outcome in self.outcomes if not outcome.completed), self.outcomes[0])

    @property
    def completed(self) -> bool:
        """Whether every candidate reached the end."""
        return self.outcome.completed


def simulate(  # many parameters: the public keywords of the page on the API
    robot: Robot,
    x: ArrayLike,
    reference: Reference,
    controller: Controller,
    *,
    step: float | None = None,
    fine_step: float | Sequence[float] | None = None,
    rate_hz: float | None = None,
    duration_s: float | None = None,
    gain_scale: ArrayLike | None = None,
    start: tuple[ArrayLike, ArrayLike] | None = None,
    external: tuple[float, ArrayLike] | None = None,
    divergence: float = DIVERGENCE,
    memory: ControllerMemory = BALANCE,
    integrator: str = "rk4",
    threads: int | None = None,
    check: bool | None = None,
) -> Simulation:
    """Simulate the controlled robot (4), for one candidate or many.

    Tested in ``tests/test_simulation.py``.

    Parameters
    ----------
    robot : Robot
        The robot; its friction should be smooth (``tanh``) if velocities pass through zero.
    x : (n_parameters,) or (n_candidates, n_parameters) array
        Standard parameters in the order of ``robot.parameter_names``.
    reference : Reference
        Reference motion.
    controller : Controller
        Controller.
    step, fine_step : float, optional
        Largest step (s), and largest step where a velocity of the reference is near zero, which may differ between joints:
        friction is the stiffer the smaller the inertia. By default 0.5 ms and 0.1 ms with smooth friction, 0.2 ms with ``sign``.
    rate_hz : float, optional
        Records per second; 1000 by default.
    duration_s : float, optional
        Length; that of the reference by default.
    gain_scale : (n_dof,) or (n_candidates, n_dof) array, optional
        Factor of the controller's gains.
    start : (q, dq), optional
        Positions and velocities at time 0; those of the reference by default.
    external : (rate_hz, (n_samples, n_dof) array), optional
        External torque on the joints (N.m or N), straight lines between samples.
    divergence : float
        Tracking error (rad or m) that ends a run.
    memory : ControllerMemory
        State of the controller at time 0: integrators and delayed outputs. By default each candidate begins in static balance.
        An experiment begins with the state of its log, if this has torques.
    integrator : {"rk4", "imex"}
        The classical Runge-Kutta method, or a third-order method that treats Coulomb and viscous friction implicitly, so that
        neither limits the step; `fine_step` is then `step` by default.
    threads : int, optional
        All cores by default; the result has the same bits for any number.
    check : bool, optional
        Estimate the integration error by a second run with half the steps and warn (`StepWarning`) when it is large.
        By default for a single candidate.

    Returns
    -------
    Simulation

    Raises
    ------
    ShapeError
        For wrong parameters.
    SimulationError
        When the parts do not fit together, such as a reference shorter than the run.
    """
    loop = ClosedLoop.of(
        robot,
        reference,
        controller,
        rate_hz=rate_hz,
        duration_s=duration_s,
        step=step,
        fine_step=fine_step,
        start=start,
        external=external,
        divergence=divergence,
        memory=memory,
        integrator=integrator,
    )
    candidates, single = candidate_matrix(robot, x)
    scale = _scale(gain_scale, len(candidates), robot.n_dof)
    (q, dq, ddq, tau), outcomes = loop.run(candidates, gain_scale=scale, threads=threads)
    error = None
    if (single if check is None else check) and outcomes[0].completed:
        first = None if scale is None else scale[:1]
        error = loop.integration_error(candidates[0], q[0], tau[0], gain_scale=first, threads=threads)
        if error.large:
            warnings.warn(too_large(error), StepWarning, stacklevel=2)
    if single:
        q, dq, ddq, tau = q[0], dq[0], ddq[0], tau[0]
    return Simulation(loop.t, q, dq, ddq, tau, outcomes, error, loop.n_steps)


def too_large(error: IntegrationError) -> str:
    """Return the sentence on too large a step."""
    if not np.isfinite(error.tau_relative):
        return "the step is too large: with half of it the run ends differently"
    joint = int(np.argmax(error.tau)) + 1
    return (
        f"the step is too large: halving it changes the torque by {100.0 * error.tau_relative:.2g} % "
        f"(joint {joint}: {error.tau[joint - 1]:.2g} rms); reduce step and fine_step"
    )


def candidate_matrix(robot: Robot, x: ArrayLike) -> tuple[Array, bool]:
    """Return standard parameters as rows, and whether it was a single vector."""
    array = real_array("x", x, ShapeError)
    if array.ndim == 2:
        if not len(array):
            raise ShapeError("x holds no candidate")
        return np.ascontiguousarray([standard_vector(robot, row) for row in array]), False
    return standard_vector(robot, array)[None], True


def _scale(gain_scale: ArrayLike | None, m: int, n: int) -> Array | None:
    if gain_scale is None:
        return None
    scale = real_array("gain_scale", gain_scale, SimulationError)
    if scale.shape not in ((n,), (m, n)) or not np.isfinite(scale).all():
        raise SimulationError(f"gain_scale must have shape ({n},) or ({m}, {n}) and be finite")
    return np.broadcast_to(scale, (m, n)).copy()
