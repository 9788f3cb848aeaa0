"""The windows of an experiment, and its closed loop over one of them or over its own length.

Tested in ``tests/test_closed_loop.py``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError, ExperimentError, FitError
from ..log.recording import Recording
from ..loop.closed_loop import ClosedLoop
from ..loop.controller import Controller
from ..loop.memory import BALANCE, ZERO, ControllerMemory, memory_of_log, remembers
from ..loop.reference import Reference
from ..robot.robot import Robot
from ..signal.noise import white_noise
from ..signal.processing import SignalProcessing
from ..signal.spikes import without_spikes
from ..signal.window import Along, Shift, Window, motion_of, windows_of
from .experiment import Experiment
from .specs import ControllerSpec, ReferenceSpec

LEAST_NOISE_SAMPLES = 50
"""Smallest number of samples of a window whose noise is estimated."""
MOST_DECLARED = 3_000_000
"""Largest number of recorded values per quantity of a run whose length the file declares: a few bytes can take most of a
gigabyte. The log of a long recording is a large file itself."""


def recordings_of(experiment: Experiment, role: str = "fit") -> list[tuple[int, Recording]]:
    """Return the recordings of a role with their numbers.

    Raises
    ------
    FitError
        Without one to fit (``test_identify.py``).
    """
    every = enumerate(experiment.recordings)
    recordings = [(number, recording) for number, recording in every if recording.role == role]
    if role == "fit" and not recordings:
        raise FitError(f"experiment '{experiment.name}' has no recording with role 'fit'")
    return recordings


def windows(
    log: Experiment,
    signal: SignalProcessing | None = None,
    *,
    role: str = "fit",
    along: Along = "measured",
    delay: Shift = 0.0,
    hold_s: float = 0.0,
) -> list[Window]:
    """Return the windows of an experiment's recordings, as every method takes them.

    Parameters
    ----------
    log : Experiment
        With recordings.
    signal : SignalProcessing, optional
        Filter and trimming; those of the experiment by default.
    role : {"fit", "held-out"}
        Role of the recordings.
    along : {"measured", "simulated", "outputs"}
        Along the measured motion, filtered; along that of the closed loop, which is attached; or with raw outputs beside it.
    delay : float or sequence of float
        Delay of the torques (samples), which is taken back: of all joints, or of each.
    hold_s : float
        Sample time (s) of a digital controller whose hold is compensated (`didim.signal.window.hold_samples`).

    Returns
    -------
    list of Window
        In the order of the recordings: ``q dq ddq tau``, (n_samples, n_dof) each, SI units, joint side.

    Raises
    ------
    FitError
        Without a recording to fit, without torques, or when trimming leaves nothing of a window.
    ExperimentError
        Without the closed loop that `along` needs.
    SignalError
        When the filter cannot be applied; the message names recording and window.

    Notes
    -----
    ``test_windows.py`` cuts by hand, and compares what methods take.
    """
    return [
        window
        for number, recording in recordings_of(log, role)
        for window in windows_of(
            recording,
            log.signal if signal is None else signal,
            number=number,
            along=along,
            delay=delay,
            hold_s=hold_s,
            loop=None if along == "measured" else _loops(log, recording),
        )
    ]


def _loops(log: Experiment, recording: Recording) -> Callable[[tuple[int, int]], ClosedLoop]:
    return lambda span: closed_loop(log, recording, span)


def closed_loop(
    experiment: Experiment, recording: Recording | None = None, window: tuple[int, int] | None = None
) -> ClosedLoop:
    """Return the closed loop of an experiment, over a window of a recording or over its own length.

    Parameters
    ----------
    experiment : Experiment
        Its reference, controller and simulation settings.
    recording : Recording, optional
        Recording that defines rate and length; not needed if the reference is independent of recordings.
    window : (start, stop), optional
        Samples of the recording; all of them by default.

    Returns
    -------
    ClosedLoop
        Closed loop with the friction of ``[simulation]``.

    Raises
    ------
    ExperimentError
        Without a reference or a controller, and when they do not fit; the sentence names the table.
    """
    if experiment.reference is None or experiment.controller is None:
        raise _without_loop(experiment)
    settings = experiment.simulation
    reference, controller = experiment.reference, experiment.controller
    try:
        if isinstance(reference, ReferenceSpec):
            reference = reference.build(recording, window, experiment.signal)
        if isinstance(controller, ControllerSpec):
            controller = controller.build(reference)
        rate, duration, state = settings.rate_hz, settings.duration_s, None
        external = None
        from_recording = isinstance(experiment.reference, ReferenceSpec) and experiment.reference.made is None
        if recording is None and settings.start == "measured":
            raise ExperimentError("[simulation] start = 'measured' needs a recording")
        if recording is not None:
            start, stop = window or (0, len(recording.q))
            rate = recording.rate_hz
            duration = (stop - start - 1) / rate
            if recording.external is not None:
                external = (rate, recording.external[start:stop])
            if start > 0 and not from_recording:
                raise ExperimentError(
                    f"the window of recording {recording.name!r} begins at {start / rate:g} s, and a reference that is "
                    "a motion of its own begins with the recording: take a window from 0 s on"
                )
            shown = from_recording and recording.has_positions
            if settings.start == "measured" or (settings.start is None and shown):
                q, dq, _ = motion_of(recording, (start, stop), experiment.signal)
                state = (q[0], dq[0])
        memory = _memory(experiment, controller, reference, recording, window, state)
        loop = ClosedLoop.of(
            settings.robot(experiment.robot),
            reference,
            controller,
            rate_hz=rate,
            duration_s=duration,
            step=settings.step_s,
            fine_step=settings.fine_step_s,
            start=state,
            external=external,
            divergence=settings.divergence,
            memory=memory,
            integrator=settings.integrator,
        )
        if recording is None and loop.n_records * loop.robot.n_dof > MOST_DECLARED:
            raise ExperimentError(
                f"{loop.t[-1]:g} s at {loop.rate_hz:g} Hz are too many records: {MOST_DECLARED // loop.robot.n_dof} are possible "
                "for a run that follows no recording"
            )
        if recording is not None:
            motion = measured_motion(recording, (start, stop), experiment.signal, loop.robot)
            loop = loop if motion is None else loop.along(motion)
        return loop
    except DidimError as error:
        raise ExperimentError(f"{experiment.name}: {error}") from None


def _without_loop(experiment: Experiment) -> ExperimentError:
    """Return the error on an experiment without a reference or a controller."""
    if experiment.reference is None:
        missing = "[reference]: which positions the robot was to follow"
        missing += ", and [controller]" if experiment.controller is None else ""
    else:
        missing = "[controller]: the law of its drives"
    return ExperimentError(
        f"{experiment.name}: a simulation needs the table {missing}; without them --method idim-ls identifies from the "
        "measured motion"
    )


def _memory(
    experiment: Experiment,
    controller: Controller,
    reference: Reference,
    recording: Recording | None,
    window: tuple[int, int] | None,
    state: tuple[Array, Array] | None,
) -> ControllerMemory:
    """Return the state of the controller at the beginning of a window or of a run, according to ``[simulation]``."""
    settings = experiment.simulation
    start, stop = window or (0, 0 if recording is None else len(recording.q))
    if settings.controller_state is not None:
        if start > 0:
            raise ExperimentError(
                "[simulation.controller_state] is that at the beginning of the recording, and a window begins later: say "
                "controller_start = 'log'"
            )
        return settings.controller_state
    # Currents of drives with unknown gains are not torques.
    tau = None if recording is None or recording.drives is not None else recording.tau
    chosen = settings.controller_start or ("balance" if tau is None else "log")
    if chosen == "zero":
        return ZERO
    if chosen == "balance" or not remembers(controller):
        return BALANCE
    if recording is None or tau is None:
        raise ExperimentError("[simulation] controller_start = 'log' needs a recording with torques")
    tau = without_spikes(tau[start:stop], experiment.signal)
    if recording.has_positions:
        return memory_of_log(controller, reference, recording.rate_hz, recording.q[start:stop], tau, state)
    # Without measured positions the robot is assumed to be at its reference.
    times = np.arange(stop - start) / recording.rate_hz
    return memory_of_log(controller, reference, recording.rate_hz, reference.at(times)[0], tau, state)


def measured_motion(
    recording: Recording, window: tuple[int, int], signal: SignalProcessing, robot: Robot
) -> Reference | None:
    """Return the measured motion of a window, raw or filtered; None if it does not reveal velocities near zero."""
    if not recording.has_positions:
        return None
    q = recording.q[slice(*window)]
    if len(q) < LEAST_NOISE_SAMPLES or robot.friction.coulomb != "tanh":
        return None
    # A filter smears reversals over milliseconds, so raw positions are better unless the velocity is too noisy.
    if np.all(white_noise(q) * recording.rate_hz <= np.asarray(robot.friction.smoothing)):
        return Reference.sampled(q, rate_hz=recording.rate_hz)
    if signal.cutoff_hz is None:
        return None
    return Reference.through(*motion_of(recording, window, signal), rate_hz=recording.rate_hz)


def outside_limits(robot: Robot, reference: Reference, duration_s: float) -> list[str]:
    """Return sentences on joints whose reference exceeds the limits of the robot file."""
    t = np.linspace(0.0, duration_s, 20_001)
    q, dq, _ = reference.at(t)
    exceeded = []
    for joint, limits in enumerate(robot.limits):
        if limits.position is not None:
            low, high = limits.position
            worst = int(np.argmax(np.maximum(low - q[:, joint], q[:, joint] - high)))
            if not low <= q[worst, joint] <= high:
                exceeded.append(
                    f"the reference of joint {joint + 1} is {q[worst, joint]:.4g} at {t[worst]:.4g} s, outside its "
                    f"limits {low:.4g} to {high:.4g}"
                )
        if limits.velocity is not None:
            worst = int(np.argmax(np.abs(dq[:, joint])))
            if abs(dq[worst, joint]) > limits.velocity:
                exceeded.append(
                    f"the reference of joint {joint + 1} moves at {abs(dq[worst, joint]):.4g} at {t[worst]:.4g} s, "
                    f"faster than its limit {limits.velocity:.4g}"
                )
    return exceeded
