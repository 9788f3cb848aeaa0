"""The tables ``[reference]``, ``[controller]``, ``[simulation]`` and ``[measurement]`` of an experiment file, read strictly.

Tested in ``tests/test_closed_loop.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._tools.toml import MISSING, Table
from .._tools.words import series
from ..errors import DidimError, ExperimentError
from ..log.units import POSITION, has_joint_values, joint_values, optional_joint_values
from ..loop.controller import Controller, Digital
from ..loop.memory import ControllerMemory
from ..loop.reference import Reference
from ..loop.tuning import mean_inertia
from ..model.dynamics import inverse_dynamics
from ..robot.robot import Robot
from .specs import ControllerSpec, Measurement, ReferenceSpec, SimulationSettings

FEEDFORWARD_HZ = 1000.0
"""Default rate (Hz) at which the model's torque is fed forward."""


def read_reference(table: Table, robot: Robot) -> ReferenceSpec:
    """Read ``[reference]``."""
    kind = table.text("kind")
    settings = table.content_unread
    made: Reference | None = None
    between = table.text("between_samples")
    if between == "held" and kind != "recorded":
        table.fail("between_samples = 'held' is for kind 'recorded'")
    if kind == "fourier":
        made = table.checked(_fourier(table, robot))
    elif kind == "point-to-point":
        factor, unit = _one_unit(table, "points", robot)
        points = np.array(table.matrix(f"points_{unit}", None, robot.n_dof)) * factor
        velocity = joint_values(table, "max_velocity", robot, "_s")
        acceleration = joint_values(table, "max_acceleration", robot, "_s2")
        dwell = table.number("dwell_s")
        made = table.checked(
            lambda: Reference.point_to_point(
                points, max_velocity=velocity, max_acceleration=acceleration, dwell_s=dwell
            )
        )
    table.done()
    return ReferenceSpec(kind, made, settings)


def _fourier(table: Table, robot: Robot) -> Callable[[], Reference]:
    n = robot.n_dof
    period, duration = table.number("period_s"), table.number("duration_s", None)
    offset = joint_values(table, "offset", robot, default=0.0)
    if table.has("harmonics"):
        harmonics, seed = table.integer("harmonics"), table.integer("seed")
        limits = {key: joint_values(table, key, robot, per) for key, per in _LIMITS.items()}
        return lambda: Reference.random_fourier(
            harmonics=harmonics, period_s=period, offset=offset, duration_s=duration, seed=seed, **limits
        )
    factor, unit = _one_unit(table, "sine", robot)
    sine = np.array(table.matrix(f"sine_{unit}", None, n)) * factor
    cosine = np.array(table.matrix(f"cosine_{unit}", len(sine), n)) * factor
    return lambda: Reference.fourier(sine, cosine, period_s=period, offset=offset, duration_s=duration)


_LIMITS = {"max_position": "", "max_velocity": "_s", "max_acceleration": "_s2"}


def _one_unit(table: Table, key: str, robot: Robot) -> tuple[float, str]:
    """Return factor to SI and unit of a matrix key such as ``points_deg``; with both kinds of joints it is ``points_si``."""
    kinds = set(robot.joint_kinds)
    units = ["si"] if len(kinds) == 2 else (["rad", "deg"] if kinds == {"revolute"} else ["m", "mm"])
    given = [unit for unit in units if table.has(f"{key}_{unit}")]
    if len(given) != 1:
        table.fail(f"give one of {series((f'{key}_{unit}' for unit in units), 60)}")
    return POSITION.get(given[0], 1.0), given[0]


_SATURATION = ("saturation_v", "saturation_a", "saturation_n_m", "saturation_n")


def read_controller(table: Table, robot: Robot) -> ControllerSpec:
    """Read ``[controller]``."""
    n = robot.n_dof
    kind = table.text("kind")
    settings = table.content_unread
    if kind == "made-up":
        # Its gains are computed by a method from its estimate (``didim.loop.tuning.made_up``).
        table.number("natural_frequency_hz", None)
        table.number("tracking_error")
        table.done()
        return ControllerSpec(MadeUpRecipe(), settings)
    own = of_actuators(robot) if kind == "pd" else {}
    damped = kind == "cascade" or (
        "kp" in own and "kp" not in settings and "natural_frequency_hz" not in settings
    )
    options: dict[str, Any] = {
        "reference_velocity": table.spread("reference_velocity", n, [0.0 if damped else 1.0] * n),
        "acceleration": table.spread("acceleration", n),
        "gain": table.spread("gain", n),
    }
    given = [key for key in _SATURATION if table.has(key)]
    if len(given) > 1:
        table.fail(f"give one of {series(given, 80)}: the unit of the controller's output")
    if given:
        options["saturation"] = table.spread(given[0], n)
    elif "saturation" in own and "gain" not in settings:  # the output is in N.m
        options["saturation"] = own["saturation"]
    options["digital"] = _digital(table, robot)
    feedforward = _set_name(table, "feedforward_of", robot)
    gains: dict[str, Any]
    inertia_of = None
    if table.has("natural_frequency_hz"):
        if kind != "pd":
            table.fail("natural_frequency_hz is for kind 'pd'")
        gains = {key: table.spread(key, n) for key in ("natural_frequency_hz", "damping")}
        inertia = table.spread("inertia", n, None)
        inertia_of = _set_name(table, "inertia_of", robot)
        if (inertia is None) == (inertia_of is None):
            table.fail(
                "natural_frequency_hz needs inertia (kg.m^2 or kg, one per joint) or inertia_of (a parameter set)"
            )
        # An inertia along the reference is 1 until the reference is known.
        gains["inertia"] = inertia or [1.0] * n
        kind = "tuned"
    else:
        gains = {key: table.spread(key, n, own.get(key, MISSING)) for key in ("kp", "kv")}
        if kind == "pid":
            gains["ki"] = table.spread("ki", n)
        if kind == "cascade" and table.has("integral_time_s"):
            gains["integral_time_s"] = table.spread("integral_time_s", n)
    table.done()
    recipe = ControllerRecipe(robot, kind, {**gains, **options}, inertia_of, feedforward)
    # A wrong number must fail on loading.
    table.checked(recipe.plain)
    digital = options["digital"]
    return ControllerSpec(recipe, settings, 0.0 if digital is None else digital.sample_time_s)


def of_actuators(robot: Robot) -> dict[str, list[float]]:
    """Return gains and largest torques of the robot's position actuators, if all joints have finite ones."""
    gains: dict[str, list[float]] = {}
    for key in ("kp", "kv"):
        values = [
            value for actuator in robot.actuators if (value := getattr(actuator, key, None)) is not None
        ]
        if len(values) == robot.n_dof:
            gains[key] = values
    efforts = [getattr(actuator, "effort", None) for actuator in robot.actuators]
    if any(effort is not None for effort in efforts):
        gains["saturation"] = [np.inf if effort is None else effort for effort in efforts]
    return gains


@dataclass(frozen=True)
class ControllerRecipe:
    """Recipe for the controller of a file, given a reference.

    Attributes
    ----------
    robot : Robot
        The robot.
    maker : str
        Constructor of `Controller`.
    options : mapping
        Its arguments.
    inertia_of, feedforward_of : str or None
        Parameter sets for gains tuned by the mean inertia along the reference, and for the feed-forward torque.
    """

    robot: Robot
    maker: str
    options: Mapping[str, Any]
    inertia_of: str | None
    feedforward_of: str | None

    def plain(self) -> Controller:
        """Return the controller without the parts that depend on the reference."""
        return getattr(Controller, self.maker)(**self.options)  # type: ignore[no-any-return]

    def __call__(self, reference: Reference) -> Controller:
        """Return the controller for a reference."""
        options, robot = dict(self.options), self.robot
        if self.inertia_of is not None:
            options["inertia"] = mean_inertia(robot, robot.parameter_set(self.inertia_of), reference).tolist()
        controller: Controller = getattr(Controller, self.maker)(**options)
        if self.feedforward_of is None:
            return controller
        t = np.arange(0.0, reference.duration + 0.5 / FEEDFORWARD_HZ, 1.0 / FEEDFORWARD_HZ)
        tau = inverse_dynamics(robot, *reference.at(t), robot.parameter_set(self.feedforward_of))
        return controller.with_feedforward(tau, rate_hz=FEEDFORWARD_HZ)


@dataclass(frozen=True)
class MadeUpRecipe:
    """Gains that a method computes from its estimate; none until then."""

    controller: Controller | None = None

    def __call__(self, reference: Reference) -> Controller:
        """Return the controller, if it has been computed.

        Raises
        ------
        ExperimentError
            Before then.
        """
        if self.controller is not None:
            return self.controller
        raise ExperimentError(
            "[controller] kind = 'made-up' has no gains yet: consistent DIDIM "
            "(didim identify --method didim) makes them from its estimate"
        )


def _digital(table: Table, robot: Robot) -> Digital | None:
    keys = ("delay_samples", "velocity_fir")
    resolution = has_joint_values(table, "encoder_resolution")
    if not table.has("sample_time_s"):
        given = [key for key in keys if table.has(key)] + (["encoder_resolution"] if resolution else [])
        if given:
            table.fail(f"{given[0]} is for a digital controller: add sample_time_s")
        return None
    steps = joint_values(table, "encoder_resolution", robot, default=0.0)
    fir = table.numbers("velocity_fir")
    sample_time, delay = table.number("sample_time_s"), table.integer("delay_samples")
    return table.checked(
        lambda: Digital(
            sample_time_s=sample_time, delay_samples=delay, smoothing=tuple(fir), resolution=tuple(steps)
        )
    )


def _set_name(table: Table, key: str, robot: Robot) -> str | None:
    name = table.text(key, None)
    if name is not None:
        try:
            robot.parameter_set(name)
        except DidimError as error:
            table.fail(f"{key}: {error}")
    return name


def read_simulation(table: Table, robot: Robot) -> SimulationSettings:
    """Read ``[simulation]``."""
    smoothing = optional_joint_values(table, "smoothing", robot, "_s")
    per_joint = isinstance(table.raw("fine_step_s", None), list)
    fine = tuple(table.spread("fine_step_s", robot.n_dof)) if per_joint else table.number("fine_step_s", None)
    settings = SimulationSettings(
        **table.given(), fine_step_s=fine, smoothing=None if smoothing is None else tuple(smoothing)
    )
    if table.has("controller_state"):
        if settings.controller_start is not None:
            table.fail("give controller_start or the table controller_state, not both")
        settings = replace(settings, controller_state=_state(table.table("controller_state"), robot))
    table.done()
    return settings


def _state(table: Table, robot: Robot) -> ControllerMemory:
    """Read ``[simulation.controller_state]``."""
    n = robot.n_dof
    integrators = table.spread("integrators", n)
    outputs, positions = (table.matrix(key, None, n, None) for key in ("outputs", "positions"))
    table.done()
    return table.checked(
        lambda: ControllerMemory(
            start="integrators", values=tuple(integrators), outputs=outputs, positions=positions
        )
    )


def read_measurement(table: Table, robot: Robot) -> Measurement:
    """Read ``[measurement]``."""
    values = {
        key: tuple(optional_joint_values(table, key, robot, default=0.0) or ())
        for key in ("encoder_resolution", "position_noise")
    }
    noise: Sequence[float] = ()
    units = [unit for unit in ("n_m", "n") if table.has(f"torque_noise_{unit}")]
    if len(units) > 1:
        table.fail(
            "give torque_noise_n_m or torque_noise_n, not both: one number per joint in the unit of each"
        )
    if units:
        noise = table.spread(f"torque_noise_{units[0]}", robot.n_dof)
    measurement = Measurement(**values, torque_noise=tuple(noise), seed=table.integer("seed"))
    table.done()
    return measurement
