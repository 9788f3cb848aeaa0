"""The base parameters: links, rotors, springs and the linear coefficients of friction, whose columns are the regressor (2).

`At` computes these columns once for a window; every other linear term combines them. Tested in ``tests/test_identify.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from .._tools.threads import core_threads
from .._tools.words import did_you_mean, series
from ..errors import CoreErrorsAs, FitError
from ..model.dynamics import rigid_torque
from ..model.memory import memory_columns
from ..robot.robot import Robot
from ..signal.filters import decimate, decimation_stages
from ..signal.processing import SignalProcessing
from ..signal.window import Window, at_place
from .unknown import Role, Unknown


class At:
    """What terms may ask of a robot along the windows of a log.

    Parameters
    ----------
    robot : Robot
        Its friction laws are known.
    signal : SignalProcessing
        Decimation.
    standard : callable, optional
        Function that returns the standard parameters, (p,), of a window, for the torque of load friction; zero without it.
    """

    def __init__(
        self, robot: Robot, signal: SignalProcessing, standard: Callable[[Window], Array] | None = None
    ) -> None:
        self.robot, self.signal, self._standard = robot, signal, standard
        self._kernels: dict[int, Array] = {}

    def kernel(self, window: Window) -> Array:
        """Return the base columns of a window, (n_dof, n_rows, b): one pass of the core over its samples."""
        if id(window) not in self._kernels:
            with at_place(window.place):
                self._kernels[id(window)] = self._computed(window)
        return self._kernels[id(window)]

    def combined(self, window: Window, directions: Array) -> Array:
        """Return the columns of directions of the standard parameters, (p, k) or (p,): (n_dof, n_rows, k) or (n_dof, n_rows)."""
        return np.asarray(self.kernel(window) @ (self.robot.base_parameters.matrix @ directions))

    def _computed(self, window: Window) -> Array:
        robot, columns = self.robot, list(self.robot.base_parameters.indices)
        stages = decimation_stages(window.q.shape[0], self.signal)
        load = None
        if robot.friction.has_load:
            x = np.zeros(len(robot.parameter_names)) if self._standard is None else self._standard(window)
            load = rigid_torque(robot, window.q, window.dq, window.ddq, x)
        motion = window.q, window.dq, window.ddq
        with CoreErrorsAs(FitError):
            rows = _core.observation(robot.core, *motion, columns, list(stages), core_threads(), load=load)
        w = np.asarray(rows).reshape(robot.n_dof, -1, len(columns))
        for name, joint, column in memory_columns(robot, window.q, window.dq, load, window.temperature):
            index = robot.parameter_names.index(name)
            if index in columns:
                w[joint, :, columns.index(index)] += decimate(column[:, None], stages)[:, 0]
        if not np.isfinite(w).all():
            raise FitError(
                "positions, velocities or accelerations are too large for floating point; check their unit"
            )
        return w[:, self.signal.kept_rows]


@dataclass(frozen=True, eq=False)
class Base:
    """The term of all that a robot has in every recording.

    Attributes
    ----------
    robot : Robot
        The robot.
    """

    robot: Robot

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Base parameters, b of them, SI units, joint side."""
        base = self.robot.base_parameters
        return tuple(Unknown(name=name, unit=unit) for name, unit in zip(base.names, base.units, strict=True))

    def columns(self, window: Window, at: At) -> Array:
        """Return the columns of the unknowns in a window, (n_dof, n_rows, b)."""
        return at.kernel(window)


def dropped_names(dropped: Iterable[str]) -> tuple[str, ...]:
    """Check names of parameters to drop.

    Raises
    ------
    FitError
        For a single text, which would be taken letter by letter, and for values that are not text
        (``test_identify.py``).
    """
    names = None if isinstance(dropped, str) or not isinstance(dropped, Iterable) else tuple(dropped)
    if names is None or not all(isinstance(name, str) for name in names):
        raise FitError(f"dropped must be a list of parameter names, got {dropped!r}")
    return names


def roles_of(
    robot: Robot, fixed: Mapping[str, float], dropped: Iterable[str]
) -> dict[str, tuple[Role, float]]:
    """Return roles and values of the base parameters that are not estimated.

    Parameters
    ----------
    robot : Robot
        Robot with the base parameters.
    fixed : mapping of str to float
        Values of known base parameters, SI units, joint side.
    dropped : iterable of str
        Base parameters taken as zero.

    Raises
    ------
    FitError
        For a name that is not a base parameter (the message says which one a standard parameter regroups into),
        for a value that is not finite, and for a name that is both fixed and dropped.

    Notes
    -----
    ``test_identify.py`` fixes and drops parameters of a simulated log.
    """
    roles: dict[str, tuple[Role, float]] = {}
    for name, value in fixed.items():
        _check_base(robot, name)
        if isinstance(value, bool) or not isinstance(value, Real) or not np.isfinite(value):
            raise FitError(f"fixed parameter {name} must have a finite value, got {value!r}")
        roles[name] = "fixed", value
    for name in dropped:
        _check_base(robot, name)
        if name in fixed:
            raise FitError(f"parameter {name} is both fixed and dropped; choose one")
        roles[name] = "dropped", 0.0
    return roles


def _check_base(robot: Robot, name: str) -> None:
    """Refuse a name that is not a base parameter."""
    base = robot.base_parameters
    if name in base.names:
        return
    if name in base.unidentifiable:
        raise FitError(
            f"parameter {name} of robot '{robot.name}' has no effect on the torques: it needs no value"
        )
    if name in robot.parameter_names:
        column = base.matrix[:, robot.parameter_names.index(name)]
        into = [base.names[row] for row in np.flatnonzero(column)]
        raise FitError(
            f"{name} is a standard parameter of robot '{robot.name}' that regroups into {series(into, 40)}: "
            "fix or drop base parameters"
        )
    hint = did_you_mean(name, base.names) or f"; `didim base {robot.name}` lists them"
    raise FitError(f"robot '{robot.name}' has no base parameter {name}{hint}")
