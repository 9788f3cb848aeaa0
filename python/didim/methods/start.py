"""Start of DIDIM and CLOE: regular points (17) and (21), robots computed from the log, named sets, estimates, vectors.

Tested in ``tests/test_didim.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array, real_array
from ..errors import FitError, RobotError
from ..regression.consistent.solver import CONSISTENT
from ..result.identification import Identification
from ..robot.parameter_file import is_file, load_parameters
from ..robot.robot import Robot
from .job import Delay, Job

Start = str | ArrayLike | Mapping[str, float] | Identification
FROM_LOG = ("consistent", "prior")
"""Names of the starts that are computed from the log, see `start_from_log`."""


def unit_rotors(robot: Robot) -> Array:
    """Return the regular initial point (17), (n_parameters,): rotor inertias of 1, all other parameters zero.

    Rotors turn with ``C dq`` and add ``C^T diag(Ja) C`` to M(q). By (24) the ``Ia`` of a joint contains the diagonal
    contributions of coupled rotors. Unit rotors therefore give ``Ia5 = 2`` and ``Ia6 = 1`` for the TX40; all ones would be
    singular.
    """
    coupling = np.array(robot.geometry.coupling)
    coupling = coupling / np.diag(coupling)[:, None]
    x = np.zeros(len(robot.parameter_names))
    for joint, inertia in enumerate((coupling**2).sum(axis=0)):
        x[robot.parameter_names.index(f"Ia{joint + 1}")] = inertia
    return x


def start_from_log(job: Job, delay: Delay, name: str) -> Array:
    """Return standard parameters of a robot computed from a log, (p,), and with the further parameters of logs, (p + e,).

    Parameters
    ----------
    job : Job
        Job whose recordings have positions.
    delay : Delay
        Delay of the torque.
    name : str
        "consistent" for the consistent solution along the measured motion, "prior" for the robot of its prior.

    Raises
    ------
    DidimError
        Any of its subclasses, for a log without positions or torques, for unknown drive gains, and when no robot meets all
        conditions.
    """
    if job.model.n_gains:
        raise FitError(f"the start {name!r} needs torques, and drive gains are unknown: start from 'idim-ls'")
    system = job.system(job.parts("fit", delay))
    solver = CONSISTENT.for_model(job.model)
    if name == "prior":
        return solver.on(system).start
    standard = solver(system, job.settings).standard
    assert standard is not None
    return standard


def standard_start(robot: Robot, start: Start) -> Array:
    """Return the standard parameters of the start, (n_parameters,).

    Parameters
    ----------
    robot : Robot
        The robot.
    start : str, mapping, array or Identification
        "unit" for (17), a parameter set of the robot file such as "apriori" (21), the path of a result or of its parameters
        (`load_parameters`), values of standard or base parameters by name (others are zero), a vector of either, or a result.

    Raises
    ------
    FitError
        For an unknown name or a wrong length.
    RobotError
        For an unknown parameter set.
    OSError
        For a file that cannot be read.
    """
    base = robot.base_parameters
    if isinstance(start, str):
        if start == "unit":
            return unit_rotors(robot)
        if is_file(start):
            return load_parameters(robot, start)
        try:
            return robot.parameter_set(start)
        except RobotError as reason:
            raise RobotError(f"{reason}; a start may also be 'unit', 'idim-ls' or a result") from None
    if isinstance(start, Identification):
        if start.parameter_names != robot.parameter_names:
            raise FitError(
                f"the start is a result for robot {start.robot!r}, and the robot is {robot.name!r}"
            )
        return start.parameters
    if isinstance(start, Mapping):
        values = dict(zip(start, _finite(list(start.values())).tolist(), strict=True))
        try:
            return robot.parameters_by_name(values, "the start:")
        except RobotError as reason:
            raise FitError(str(reason)) from None
    vector = _finite(start)
    if vector.shape == (len(robot.parameter_names),):
        return vector
    if vector.shape == (len(base.names),):
        return base.lift(vector)
    raise FitError(
        f"the start needs {len(robot.parameter_names)} standard or {len(base.names)} base parameters, got "
        f"{vector.shape}"
    )


def extended_start(
    job: Job, start: Start, direct: Callable[[], Identification], delay: Callable[[], Delay]
) -> Array:
    """Return the standard parameters of a start and the further ones of the logs, (p + e,).

    Parameters
    ----------
    job : Job
        Experiment and settings.
    start : str, mapping, array or Identification
        As for `standard_start` and `start_from_log`, or "idim-ls".
    direct, delay : callable
        Functions that return the estimate of IDIM-LS, and the delay of the torque.
    """
    if isinstance(start, str) and start in FROM_LOG:
        return job.model.extended(start_from_log(job, delay(), start))
    if isinstance(start, str) and start == "idim-ls":
        start = direct()
    # Drive gains start from IDIM-LS, because currents give no torques without them.
    gains = further_of(direct()) if job.model.n_gains else {}
    return job.model.extended(standard_start(job.robot, start), {**gains, **further_of(start)})


def further_of(start: Start) -> dict[str, float]:
    """Return the further parameters of logs in a start: those of a result, otherwise none."""
    if isinstance(start, Identification) and start.further is not None:
        return start.further.by_name
    return {}


def _finite(values: ArrayLike) -> Array:
    vector = real_array("start", values, FitError)
    if not np.isfinite(vector).all():
        raise FitError("the start has a value that is not finite")
    return vector
