"""The closed loop of an experiment: what its tables ``[reference]``, ``[controller]`` and ``[simulation]`` say.

Tables are read strictly when the experiment is loaded; references and controllers are made when a recording, or none, is
at hand. Tested in ``tests/test_closed_loop.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .control import Controller, Digital
from .errors import DidimError, ExperimentError
from .model import inertia_matrix, inverse_dynamics
from .recording import Recording
from .reference import Reference
from .robot import Robot
from .schema import Table
from .signals import SignalProcessing, differentiate, white_noise
from .simulation import DIVERGENCE, ClosedLoop

if TYPE_CHECKING:
    from .experiment import Experiment

Array = NDArray[np.float64]

_Made = TypeVar("_Made")

LEAST_SAMPLES = 50
"""Shorter windows say too little about their noise."""
FEEDFORWARD_HZ = 1000.0
"""Rate at which a model's torque is fed forward."""


@dataclass(frozen=True)
class ReferenceSpec:
    """A reference as a file describes it.

    Attributes
    ----------
    kind : str
        "recorded", "measured", "fourier" or "point-to-point".
    made : Reference or None
        The motion, where it does not depend on a recording.
    settings : Mapping
        The table, for the record of a result.
    """

    kind: str
    made: Reference | None
    settings: Mapping[str, Any]

    def build(
        self, recording: Recording | None, window: tuple[int, int] | None, signal: SignalProcessing
    ) -> Reference:
        """Return the motion for a window of a recording, with time 0 at its first sample.

        Raises
        ------
        ExperimentError
            When the recording is missing, or has no reference.
        """
        if self.made is not None:
            return self.made
        if recording is None:
            raise ExperimentError(f"the reference is {self.kind!r}, and the experiment has no recording")
        start, stop = window or (0, len(recording.q))
        if self.kind == "recorded":
            if recording.q_ref is None:
                raise ExperimentError(
                    f"recording {recording.name!r} has no reference positions: add [recording.reference], or say "
                    "kind = 'measured' to follow the filtered measured positions"
                )
            return Reference.sampled(recording.q_ref[start:stop], rate_hz=recording.rate_hz)
        q, _, _ = differentiate(recording.q[start:stop], recording.rate_hz, signal)
        return Reference.sampled(q, rate_hz=recording.rate_hz)


@dataclass(frozen=True)
class ControllerSpec:
    """A controller as a file describes it; gains may need the inertia along the reference.

    Attributes
    ----------
    build : callable
        Makes the controller for a reference.
    settings : Mapping
        The table, for the record of a result.
    """

    build: Callable[[Reference], Controller]
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """How the closed loop is simulated.

    Attributes
    ----------
    step_s : float or None
        Largest step (s).
    fine_step_s : tuple of float or None
        Largest step where the velocity of a joint is near zero (s), one for all joints or one per joint. What is near zero is
        read off the measured motion where there is one that can tell, as measured or filtered, and off the reference
        otherwise.
    rate_hz : float or None
        Records per second of a run without a recording, which has its own; 1000 by default.
    duration_s : float or None
        Length of a run without a recording; that of the reference by default.
    smoothing : tuple of float or None
        Velocity of ``tanh`` friction per joint (rad/s or m/s) in simulations and in what is built on them; the friction of
        the robot by default.
    divergence : float
        Tracking error (rad or m) that ends a run.
    start : {"measured", "reference"} or None
        State at time 0: the filtered measured one, or that of the reference. By default measured where the reference
        comes from a recording, which may begin in motion, and the reference's where it is a motion of its own.
    """

    step_s: float | None = None
    fine_step_s: float | Sequence[float] | None = None
    rate_hz: float | None = None
    duration_s: float | None = None
    smoothing: tuple[float, ...] | None = None
    divergence: float = DIVERGENCE
    start: str | None = None

    def __post_init__(self) -> None:
        if self.start not in (None, "measured", "reference"):
            raise ExperimentError(f"start must be 'measured' or 'reference', got {self.start!r}")

    def robot(self, robot: Robot) -> Robot:
        """Return the robot as it is simulated: with smooth friction, where the settings say so."""
        if self.smoothing is None:
            return robot
        return robot.with_smoothing(self.smoothing)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What a simulated measurement adds to a simulation, joint side.

    Attributes
    ----------
    encoder_resolution, position_noise, torque_noise : tuple of float
        Step of the encoders (rad or m), standard deviation of position noise, and of torque noise (N.m or N), per joint.
    seed : int
        Of NumPy's default generator.
    """

    encoder_resolution: tuple[float, ...] = ()
    position_noise: tuple[float, ...] = ()
    torque_noise: tuple[float, ...] = ()
    seed: int = 0

    def measure(self, q: Array, tau: Array) -> tuple[Array, Array]:
        """Positions and torques as a log has them; `q` and `tau` are (n_samples, n_dof)."""
        for name in ("encoder_resolution", "position_noise", "torque_noise"):
            values = getattr(self, name)
            if len(values) not in (0, q.shape[1]):
                raise ExperimentError(f"{name} needs {q.shape[1]} numbers, one per joint, got {len(values)}")
        rng = np.random.default_rng(self.seed)
        # Both are drawn always: one setting must not change the noise of the other.
        noise_q, noise_tau = rng.standard_normal((2, *q.shape))
        if self.position_noise:
            q = q + noise_q * np.asarray(self.position_noise)
        if self.encoder_resolution:
            step = np.asarray(self.encoder_resolution)
            exact = step == 0.0
            q = np.where(exact, q, np.round(q / np.where(exact, 1.0, step)) * step)
        if self.torque_noise:
            tau = tau + noise_tau * np.asarray(self.torque_noise)
        return q, tau


def closed_loop(
    experiment: Experiment,
    recording: Recording | None = None,
    window: tuple[int, int] | None = None,
) -> ClosedLoop:
    """Return the closed loop of an experiment, over a window of a recording or over its own length.

    Parameters
    ----------
    experiment : Experiment
        Its reference, controller and simulation settings.
    recording : Recording, optional
        Sets rate and length; an experiment whose reference is a motion of its own needs none.
    window : (start, stop), optional
        Samples of the recording; all of them by default.

    Returns
    -------
    ClosedLoop
        Ready to run, with the friction of ``[simulation]``.

    Raises
    ------
    ExperimentError
        Without a reference or a controller, and when they do not fit; the sentence names the table.
    """
    if experiment.reference is None or experiment.controller is None:
        missing = "[reference]" if experiment.reference is None else "[controller]"
        raise ExperimentError(
            f"{experiment.name}: a simulation needs the table {missing}: what the robot follows, and what makes it"
        )
    settings = experiment.simulation
    reference, controller = experiment.reference, experiment.controller
    try:
        if isinstance(reference, ReferenceSpec):
            reference = reference.build(recording, window, experiment.signal)
        if isinstance(controller, ControllerSpec):
            controller = controller.build(reference)
        rate, duration, state = settings.rate_hz, settings.duration_s, None
        from_recording = isinstance(experiment.reference, ReferenceSpec) and experiment.reference.made is None
        if recording is None and settings.start == "measured":
            raise ExperimentError("[simulation] start = 'measured' needs a recording")
        if recording is not None:
            start, stop = window or (0, len(recording.q))
            rate = recording.rate_hz
            duration = (stop - start - 1) / rate
            if start > 0 and not from_recording:
                raise ExperimentError(
                    f"the window of recording {recording.name!r} begins at {start / rate:g} s, and a reference that is "
                    "a motion of its own begins with the recording: take a window from 0 s on"
                )
            if settings.start == "measured" or (settings.start is None and from_recording):
                q, dq, _ = differentiate(recording.q[start:stop], rate, experiment.signal)
                state = (q[0], dq[0])
        loop = ClosedLoop.of(
            settings.robot(experiment.robot),
            reference,
            controller,
            rate_hz=rate,
            duration_s=duration,
            step=settings.step_s,
            fine_step=settings.fine_step_s,
            start=state,
            divergence=settings.divergence,
        )
        if recording is not None:
            motion = measured_motion(recording, (start, stop), experiment.signal, loop.model)
            loop = loop if motion is None else loop.along(motion)
        return loop
    except DidimError as error:
        raise ExperimentError(f"{experiment.name}: {error}") from None


def measured_motion(
    recording: Recording, window: tuple[int, int], signal: SignalProcessing, robot: Robot
) -> Reference | None:
    """Return the measured motion of a window, as it is or filtered; None where it cannot tell where velocities are near zero."""
    q = recording.q[slice(*window)]
    if len(q) < LEAST_SAMPLES or robot.friction.coulomb != "tanh":
        return None
    # A filter smears reversals over milliseconds: as measured is better where the noise of the velocity lets it.
    if np.all(white_noise(q) * recording.rate_hz <= np.asarray(robot.friction.smoothing)):
        return Reference.sampled(q, rate_hz=recording.rate_hz)
    if signal.cutoff_hz is None:
        return None
    return Reference.through(*differentiate(q, recording.rate_hz, signal), rate_hz=recording.rate_hz)


def outside_limits(robot: Robot, reference: Reference, duration_s: float) -> list[str]:
    """Sentences on joints whose reference leaves the limits of the robot file in a run; empty if none does."""
    t = np.linspace(0.0, duration_s, 20_001)
    q, dq, _ = reference.at(t)
    found = []
    for joint, limits in enumerate(robot.limits):
        if limits.position is not None:
            low, high = limits.position
            worst = int(np.argmax(np.maximum(low - q[:, joint], q[:, joint] - high)))
            if not low <= q[worst, joint] <= high:
                found.append(
                    f"the reference of joint {joint + 1} is {q[worst, joint]:.4g} at {t[worst]:.4g} s, outside its "
                    f"limits {low:.4g} to {high:.4g}"
                )
        if limits.velocity is not None:
            worst = int(np.argmax(np.abs(dq[:, joint])))
            if abs(dq[worst, joint]) > limits.velocity:
                found.append(
                    f"the reference of joint {joint + 1} moves at {abs(dq[worst, joint]):.4g} at {t[worst]:.4g} s, "
                    f"faster than its limit {limits.velocity:.4g}"
                )
    return found


def read_reference(table: Table, robot: Robot) -> ReferenceSpec:
    """Read ``[reference]``."""
    kind = table.text("kind", choices=("recorded", "measured", "fourier", "point-to-point"))
    settings = table.content_unread
    made: Reference | None = None
    if kind == "fourier":
        made = _told(table, _fourier(table, robot))
    elif kind == "point-to-point":
        made = _told(table, _point_to_point(table, robot))
    table.done()
    return ReferenceSpec(kind, made, settings)


def _fourier(table: Table, robot: Robot) -> Callable[[], Reference]:
    n = robot.n_dof
    period, duration = table.number("period_s", above=0.0), table.number("duration_s", None, above=0.0)
    offset = _joint_values(table, "offset", robot, default=0.0)
    if table.has("harmonics"):
        harmonics, seed = table.integer("harmonics", minimum=4, maximum=1000), table.integer("seed", 0, 0)
        limits = {key: _joint_values(table, key, robot, per) for key, per in _LIMITS.items()}
        return lambda: Reference.random_fourier(
            harmonics=harmonics,
            period_s=period,
            offset=offset,
            duration_s=duration,
            seed=seed,
            **limits,
        )
    factor, unit = _one_unit(table, "sine", robot)
    rows = table.raw(f"sine_{unit}")
    count = len(rows) if isinstance(rows, list) else 1
    sine, cosine = (np.array(table.matrix(f"{key}_{unit}", count, n)) * factor for key in ("sine", "cosine"))
    return lambda: Reference.fourier(sine, cosine, period_s=period, offset=offset, duration_s=duration)


def _point_to_point(table: Table, robot: Robot) -> Callable[[], Reference]:
    factor, unit = _one_unit(table, "points", robot)
    rows = table.raw(f"points_{unit}")
    count = len(rows) if isinstance(rows, list) else 2
    points = np.array(table.matrix(f"points_{unit}", count, robot.n_dof)) * factor
    velocity = _joint_values(table, "max_velocity", robot, "_s")
    acceleration = _joint_values(table, "max_acceleration", robot, "_s2")
    dwell = table.number("dwell_s", 0.0, minimum=0.0)
    return lambda: Reference.point_to_point(
        points, max_velocity=velocity, max_acceleration=acceleration, dwell_s=dwell
    )


_LIMITS = {"max_position": "", "max_velocity": "_s", "max_acceleration": "_s2"}
_UNITS = {"rad": 1.0, "deg": math.pi / 180.0, "m": 1.0, "mm": 1e-3}


def _one_unit(table: Table, key: str, robot: Robot) -> tuple[float, str]:
    """Factor to SI and unit of a matrix key such as ``points_deg``; a robot of both kinds takes SI units of each: ``points_si``."""
    kinds = set(robot.joint_kinds)
    units = ["si"] if len(kinds) == 2 else (["rad", "deg"] if kinds == {"revolute"} else ["m", "mm"])
    given = [unit for unit in units if table.has(f"{key}_{unit}")]
    if len(given) != 1:
        table.fail(f"give one of {', '.join(f'{key}_{unit}' for unit in units)}")
    return _UNITS.get(given[0], 1.0), given[0]


def _joint_values(
    table: Table, key: str, robot: Robot, per: str = "", default: float | None = None
) -> list[float]:
    """One number per joint of a key such as ``max_velocity_rad_s``: a number for all of a kind, or one per joint."""
    values: list[float | None] = [default] * robot.n_dof
    for unit, factor in _UNITS.items():
        numbers = table.spread(f"{key}_{unit}{per}", robot.n_dof, None)
        if numbers is None:
            continue
        kind = "revolute" if unit in ("rad", "deg") else "prismatic"
        if kind not in robot.joint_kinds:
            table.fail(f"{key}_{unit}{per} is for {kind} joints, and robot {robot.name!r} has none")
        other = {"deg": "rad", "mm": "m"}.get(unit)
        if other and table.has(f"{key}_{other}{per}"):
            table.fail(f"give {key}_{other}{per} or {key}_{unit}{per}, not both")
        for joint, number in enumerate(numbers):
            if robot.joint_kinds[joint] == kind:
                values[joint] = number * factor
    found = [value for value in values if value is not None]
    if len(found) < robot.n_dof:
        joint = values.index(None)
        unit = "rad" if robot.joint_kinds[joint] == "revolute" else "m"
        table.fail(f"key '{key}_{unit}{per}' is missing, for joint {joint + 1}")
    return found


_SATURATION = ("saturation_v", "saturation_a", "saturation_n_m", "saturation_n")


def read_controller(table: Table, robot: Robot) -> ControllerSpec:
    """Read ``[controller]``."""
    n = robot.n_dof
    kind = table.text("kind", choices=("pd", "pid", "cascade"))
    settings = table.content_unread
    options: dict[str, Any] = {
        "reference_velocity": table.spread("reference_velocity", n, [0.0 if kind == "cascade" else 1.0] * n),
        "acceleration": table.spread("acceleration", n, [0.0] * n),
        "gain": table.spread("gain", n, [1.0] * n),
    }
    given = [key for key in _SATURATION if table.has(key)]
    if len(given) > 1:
        table.fail(f"give one of {' and '.join(given)}: the unit of the controller's output")
    if given:
        options["saturation"] = table.spread(given[0], n)
    options["digital"] = _digital(table, robot)
    feedforward = _set_name(table, "feedforward_of", robot)
    build: Callable[[Reference | None], Controller]
    if table.has("natural_frequency_hz"):
        if kind != "pd":
            table.fail("natural_frequency_hz is for kind 'pd'")
        frequency, damping = table.spread("natural_frequency_hz", n), table.spread("damping", n)
        inertia = table.spread("inertia", n, None)
        of = _set_name(table, "inertia_of", robot)
        if (inertia is None) == (of is None):
            table.fail(
                "natural_frequency_hz needs inertia (kg.m^2 or kg, one per joint) or inertia_of (a parameter set)"
            )

        def build(reference: Reference | None) -> Controller:
            felt = inertia or [1.0] * n
            if of is not None and reference is not None:
                felt = mean_inertia(robot, robot.parameter_set(of), reference).tolist()
            return Controller.tuned(frequency, damping, felt, **options)
    else:
        gains: dict[str, Any] = {key: table.spread(key, n) for key in ("kp", "kv")}
        if kind == "pid":
            gains["ki"] = table.spread("ki", n)
        if kind == "cascade" and table.has("integral_time_s"):
            gains["integral_time_s"] = table.spread("integral_time_s", n)

        def build(reference: Reference | None) -> Controller:
            return getattr(Controller, kind)(**gains, **options)  # type: ignore[no-any-return]

    table.done()

    def complete(reference: Reference) -> Controller:
        controller = build(reference)
        if feedforward is None:
            return controller
        t = np.arange(0.0, reference.duration + 0.5 / FEEDFORWARD_HZ, 1.0 / FEEDFORWARD_HZ)
        tau = inverse_dynamics(robot, *reference.at(t), robot.parameter_set(feedforward))
        return controller.with_feedforward(tau, rate_hz=FEEDFORWARD_HZ)

    # Now, so that a wrong number is an error of loading; inertias that need the reference are 1 here.
    _told(table, lambda: build(None))
    return ControllerSpec(complete, settings)


def mean_inertia(robot: Robot, x: Array, reference: Reference) -> Array:
    """Mean of ``diag M(q)`` along a reference, (n_dof,): the representative inertia ``J`` of gain updating (findings, 6)."""
    q, _, _ = reference.at(np.linspace(0.0, reference.duration, 1001))
    return np.asarray(np.diagonal(inertia_matrix(robot, q, x), axis1=1, axis2=2).mean(axis=0))


def _digital(table: Table, robot: Robot) -> Digital | None:
    keys = ("delay_samples", "velocity_fir")
    resolution = any(table.has(f"encoder_resolution_{unit}") for unit in _UNITS)
    if not table.has("sample_time_s"):
        given = [key for key in keys if table.has(key)] + (["encoder_resolution"] if resolution else [])
        if given:
            table.fail(f"{given[0]} is for a digital controller: add sample_time_s")
        return None
    steps = _joint_values(table, "encoder_resolution", robot, default=0.0)
    fir = table.numbers("velocity_fir", default=[1.0])
    sample_time, delay = table.number("sample_time_s", above=0.0), table.integer("delay_samples", 0, 0, 1000)
    return _told(
        table,
        lambda: Digital(
            sample_time_s=sample_time, delay_samples=delay, smoothing=tuple(fir), resolution=tuple(steps)
        ),
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
    smoothing = None
    if any(table.has(f"smoothing_{unit}_s") for unit in _UNITS):
        smoothing = tuple(_joint_values(table, "smoothing", robot, "_s"))
        if min(smoothing) <= 0.0:
            table.fail(f"smoothing must be above 0 for every joint, got {list(smoothing)}")
    settings = SimulationSettings(
        step_s=table.number("step_s", None, above=0.0),
        fine_step_s=_fine_step(table, robot),
        rate_hz=table.number("rate_hz", None, above=0.0),
        duration_s=table.number("duration_s", None, above=0.0),
        divergence=table.number("divergence", DIVERGENCE, above=0.0),
        start=table.text("start", None, choices=("measured", "reference")),
        smoothing=smoothing,
    )
    table.done()
    return settings


def _fine_step(table: Table, robot: Robot) -> float | tuple[float, ...] | None:
    if not isinstance(table.raw("fine_step_s", None), list):
        return table.number("fine_step_s", None, above=0.0)
    steps = tuple(table.spread("fine_step_s", robot.n_dof))
    if min(steps) <= 0.0:
        table.fail(f"fine_step_s must be above 0 for every joint, got {list(steps)}")
    return steps


def read_measurement(table: Table, robot: Robot) -> Measurement:
    """Read ``[measurement]``."""

    def values(key: str) -> tuple[float, ...]:
        if not any(table.has(f"{key}_{unit}") for unit in _UNITS):
            return ()
        return _positive(table, key, _joint_values(table, key, robot, default=0.0))

    noise: Sequence[float] = ()
    units = [unit for unit in ("n_m", "n") if table.has(f"torque_noise_{unit}")]
    if len(units) > 1:
        table.fail(
            "give torque_noise_n_m or torque_noise_n, not both: one number per joint in the unit of each"
        )
    if units:
        noise = _positive(table, "torque_noise", table.spread(f"torque_noise_{units[0]}", robot.n_dof))
    measurement = Measurement(
        encoder_resolution=values("encoder_resolution"),
        position_noise=values("position_noise"),
        torque_noise=tuple(noise),
        seed=table.integer("seed", 0, 0),
    )
    table.done()
    return measurement


def _positive(table: Table, key: str, values: Sequence[float]) -> tuple[float, ...]:
    if min(values) < 0.0:
        table.fail(f"{key} must not be negative, got {list(values)}")
    return tuple(values)


def _told(table: Table, make: Callable[[], _Made]) -> _Made:
    """Return what `make` makes, or raise its error with the table's name in front."""
    try:
        return make()
    except DidimError as error:
        table.fail(str(error))
