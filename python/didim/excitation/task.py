"""Common data of a design's starts: limits, parameters, noise, prior information, and poses in which the robot can rest.

Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array, real_array
from .._tools.words import did_you_mean
from ..errors import ExcitationError
from ..methods.start import standard_start
from ..model.dynamics import inverse_dynamics, standard_vector
from ..robot.robot import Robot
from .clearance import Clearance
from .criterion import criterion
from .limits import motion_limits
from .prior import at_reference_temperature, noise_from, prior_information
from .problem import Information, Problem
from .series import ScaledSeries
from .settings import ExcitationSettings

TORQUE_SHARE = 0.01
"""Standard deviation of the torque noise, as a share of the torque limit, where none is given."""
REST_POSES = 2000
"""Number of random poses tried to find one in which the robot can rest within all limits."""

LARGEST_PARAMETER = 1e30
"""Largest standard parameter, and largest noise (SI), of a design: squared sums stay far below the limit of floating point."""


class Task:
    """Common data of all starts."""

    def __init__(self, robot: Robot, settings: ExcitationSettings) -> None:
        self.robot, self.settings = at_reference_temperature(robot), settings
        for term in robot.friction.of("load"):
            raise ExcitationError(
                f"the load friction of joint {term.joint + 1} depends on the torques that are still to be identified: "
                "leave it out of the friction of the design"
            )
        # The sign of the velocity has no gradient.
        smooth = [max(settings.smoothing, one) for one in robot.friction.smoothing]
        self.smooth = self.robot.without("hold").with_smoothing(smooth)
        hidden = set(self.smooth.base_parameters.names) - set(self.robot.base_parameters.names)
        if hidden:
            raise ExcitationError(
                f"the friction of robot {robot.name!r} hides {min(hidden)}: its dead zone is wider than its speeds"
            )
        self.limits = motion_limits(robot, settings)
        self.remarks = list(self.limits.assumed)
        if self.robot is not robot:
            self.remarks.append(
                "terms of temperature are left out: the design is for the reference temperature"
            )
        self.x = self._parameters(robot)
        self.rate = settings.rate_hz if settings.log_rate_hz is None else settings.log_rate_hz
        self.sigma = self._noise()
        capsules = (*robot.collision, *settings.capsules)
        self.clearance = Clearance(robot, capsules, settings.workspace)
        self.start = self._pose("start", settings.start)
        self.home = self._pose("home", settings.home)
        base = len(self.robot.base_parameters.names)
        prior = np.zeros((base, base))
        for source in settings.prior:
            prior = prior + prior_information(source, self.smooth, self.sigma, self.rate)
        self.prior = prior
        self.wanted = self._wanted()
        self.limited = self.x is not None and bool(np.isfinite(self.limits.torque).any())

    def _parameters(self, robot: Robot) -> Array | None:
        given = self.settings.parameters
        if given is None and "urdf" in robot.sets:
            given = "urdf"
        if given is None:
            if np.isfinite(self.limits.torque).any():
                self.remarks.append(
                    "torque limits are not checked, because no parameters are given, such as those of an earlier result"
                )
            return None
        x = standard_vector(robot, standard_start(robot, given))
        x = x[[robot.parameter_names.index(name) for name in self.robot.parameter_names]]
        worst = int(np.abs(x).argmax())
        if abs(x[worst]) > LARGEST_PARAMETER:
            raise ExcitationError(
                f"the parameter {self.robot.parameter_names[worst]} of the design is {x[worst]:g}, beyond {LARGEST_PARAMETER:g}"
            )
        return x

    def _noise(self) -> Array:
        given, n = self.settings.torque_noise, self.robot.n_dof
        if given is not None:
            values = real_array("torque_noise", given, ExcitationError)
            sensible = (values >= 1.0 / LARGEST_PARAMETER) & (values <= LARGEST_PARAMETER)
            if values.shape not in ((), (n,)) or not sensible.all():
                raise ExcitationError(
                    f"torque_noise needs one positive number or {n}, one per joint, at most {LARGEST_PARAMETER:g}, got {given!r}"
                )
            return np.broadcast_to(values, (n,)).astype(float)
        if self.settings.noise_of is not None:
            return noise_from(self.settings.noise_of, self.smooth, self.rate)
        known = np.isfinite(self.limits.torque)
        self.remarks.append(
            f"the noise of the torques is taken as {100.0 * TORQUE_SHARE:g} % of the torque limit after the margin, 1 N.m or N "
            "where there is none: give torque_noise for deviations that can be relied on"
        )
        return np.where(known, TORQUE_SHARE * np.where(known, self.limits.torque, 1.0), 1.0)

    def _pose(self, name: str, given: object) -> Array | None:
        if given is None:
            return None
        pose = real_array(name, given, ExcitationError)  # type: ignore[arg-type]
        if pose.shape != (self.robot.n_dof,):
            raise ExcitationError(f"{name} needs {self.robot.n_dof} numbers, one per joint, got {given!r}")
        for joint, (value, low, high) in enumerate(
            zip(pose, self.limits.lowest, self.limits.highest, strict=True)
        ):
            if not low < value < high:
                raise ExcitationError(
                    f"the {name} of joint {joint + 1} is {value:g}, outside what its limits leave it, [{low:g}, {high:g}]"
                )
        why = self._cannot_rest(pose)
        if why:
            raise ExcitationError(f"the robot cannot rest at its {name}: {why}")
        return pose

    def _cannot_rest(self, pose: Array) -> str:
        """Return the sentence on why the robot cannot rest in a pose, or an empty text."""
        distances = None if self.clearance.empty else self.clearance.distances(pose[None])[0]
        if distances is not None and (distances < 0.0).any():
            column = int(distances.argmin())
            return f"{self.clearance.describe(column)} are {-1e3 * distances[column]:.3g} mm too near"
        if self.x is None:
            return ""
        rest = np.zeros((1, len(pose)))
        torques = inverse_dynamics(self.smooth, pose[None], rest, rest, self.x)[0]
        relative = np.abs(torques) / self.limits.torque
        if (relative > 1.0).any():
            joint = int(relative.argmax())
            return (
                f"joint {joint + 1} needs {abs(torques[joint]):.3g} there, where at most "
                f"{self.limits.torque[joint]:.3g} N.m or N are allowed"
            )
        return ""

    def resting_place(self, seed: int) -> Array:
        """Return the centre of a free motion: the middle of the ranges, or a random pose in which the robot can rest."""
        middle = self.limits.middle
        why = self._cannot_rest(middle)
        if not why:
            return middle
        rng = np.random.default_rng(seed)
        for _ in range(REST_POSES):
            pose = self.limits.lowest + rng.random(len(middle)) * (self.limits.highest - self.limits.lowest)
            if not self._cannot_rest(pose):
                return np.asarray(pose)
        raise ExcitationError(
            f"the limits leave no room: in none of {REST_POSES} random poses can the robot rest; in the middle, {why}"
        )

    def _wanted(self) -> Array | None:
        if not self.settings.wanted:
            return None
        names = self.robot.base_parameters.names
        for name in self.settings.wanted:
            if name not in names:
                raise ExcitationError(
                    f"robot {self.robot.name!r} has no base parameter {name!r}{did_you_mean(name, names)}"
                )
        return np.array(sorted({names.index(name) for name in self.settings.wanted}))

    def problem(self, series: ScaledSeries) -> Problem:
        """Return the problem of one start; the condition number of W is one of the motion alone, without noise."""
        information = Information(
            robot=self.smooth,
            sigma=self.sigma,
            samples=self.rate * self.settings.duration_s * self.settings.periods,
            prior=self.prior,
        )
        if self.settings.criterion == "condition":
            information = information.plain
        chosen = criterion(self.settings.criterion, self.wanted)
        return Problem(series, information, chosen, self.x if self.limited else None, self.clearance)
