"""State of the controller at the start of a run: measured, given, in balance or zero, in simulations and in all methods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import CLOE, DIDIM, Controller, Experiment, Recording, Reference, identify
from didim.cli.main import main
from didim.errors import ExperimentError, SimulationError
from didim.experiment.experiment_file import load_experiment
from didim.experiment.loop import closed_loop
from didim.experiment.specs import ReferenceSpec, SimulationSettings
from didim.loop import ControllerMemory, Digital
from didim.loop.memory import memory_of_log, remembers

Array = NDArray[np.float64]

CUT_S = 2.0
END_S = 5.0
RATE_HZ = 1000.0
STEP = 2e-4
# Gains that leave much to the integrators: gravity is 20 N.m of 40.
KP, KV, KI = [300.0, 60.0], [40.0, 5.0], [600.0, 150.0]
LAWS: dict[str, Callable[[Digital | None], Controller]] = {
    "pid": lambda digital: Controller.pid(KP, KV, KI, digital=digital),
    "cascade": lambda digital: Controller.cascade([8.0, 12.0], KV, integral_time_s=0.15, digital=digital),
}
TIMINGS = {
    "continuous": None,
    "digital": Digital(sample_time_s=0.001, delay_samples=2, smoothing=(0.5, 0.5)),
}


def run_of(controller: Controller) -> tuple[didim.Robot, Array, Reference, didim.Simulation]:
    """The vertical arm of two joints along a motion that begins, and is cut, in full swing."""
    robot = didim.load_robot("planar2").with_smoothing([0.05, 0.05])
    reference = Reference.random_fourier(
        harmonics=5,
        period_s=5.0,
        max_position=[1.5, 1.0],
        max_velocity=[3.0, 5.0],
        max_acceleration=[12.0, 20.0],
        seed=3,
        offset=[0.4, -0.3],
    )
    x = robot.parameter_set("reference")
    run = didim.simulate(robot, x, reference, controller, step=STEP, fine_step=STEP, rate_hz=RATE_HZ)
    return robot, x, reference, run


def error(measured: Array, simulated: Array) -> float:
    """Norm of the difference over that of what was measured."""
    return float(np.linalg.norm(measured - simulated) / np.linalg.norm(measured))


def log_of(controller: Controller, settings: SimulationSettings | None = None) -> tuple[Experiment, Array]:
    """The log from `CUT_S` on, without noise, with the reference that was recorded; and the parameters."""
    robot, x, reference, run = run_of(controller)
    first = round(CUT_S * RATE_HZ)
    recording = Recording.from_arrays(
        run.q[first:], run.tau[first:], rate_hz=RATE_HZ, q_ref=reference.at(run.t)[0][first:]
    )
    log = Experiment(
        name="cut log",
        robot=robot,
        recordings=(recording,),
        reference=ReferenceSpec("recorded", None, {}),
        controller=controller,
        simulation=settings or SimulationSettings(step_s=STEP, fine_step_s=STEP),
    )
    return log, x


@pytest.mark.parametrize("timing", TIMINGS)
@pytest.mark.parametrize("law", LAWS)
def test_a_log_that_is_cut_goes_on(law: str, timing: str) -> None:
    controller = LAWS[law](TIMINGS[timing])
    robot, x, reference, run = run_of(controller)
    first = round(CUT_S * RATE_HZ)
    delay = 0 if controller.digital is None else controller.digital.delay_samples
    # The state that is given: the torque of the first sample whose law is evaluated, and those on their way.
    given = ControllerMemory(
        start="torque",
        values=tuple(run.tau[first + delay].tolist()),
        outputs=run.tau[first : first + delay] if delay else None,
        positions=run.q[[first - 1, first - 2]] if delay else None,
    )
    t = np.arange(round((END_S - CUT_S) * 4 * RATE_HZ) + 1) / (4 * RATE_HZ)
    rest = Reference.through(*reference.at(t + CUT_S), rate_hz=4 * RATE_HZ)
    start = (run.q[first], run.dq[first])

    def again(memory: ControllerMemory) -> Array:
        return didim.simulate(
            robot, x, rest, controller, step=STEP, fine_step=STEP, rate_hz=RATE_HZ, start=start, memory=memory
        ).tau

    measured = run.tau[first:]
    assert error(measured, again(given)) < 1e-6
    assert error(measured, again(ControllerMemory())) > 0.02
    # From the measured start, as every method and `validate` have it.
    log, _ = log_of(controller)
    simulated = closed_loop(log, log.recordings[0]).run(x[None])[0][3][0]
    assert error(measured, simulated) < 1e-3
    zero = replace(log, simulation=replace(log.simulation, controller_start="zero"))
    assert error(measured, closed_loop(zero, zero.recordings[0]).run(x[None])[0][3][0]) > 0.02


@pytest.fixture(scope="module")
def cut() -> tuple[Experiment, Array]:
    return log_of(LAWS["pid"](TIMINGS["digital"]))


def test_methods_and_validate_begin_where_the_log_does(cut: tuple[Experiment, Array]) -> None:
    log, x = cut
    truth = log.robot.base_parameters.project(x)
    size = np.abs(truth).max()
    zero = replace(log, simulation=replace(log.simulation, controller_start="zero"))
    didim_fit, didim_zero = (identify(one, DIDIM(start="reference")) for one in (log, zero))
    assert np.max(np.abs(didim_fit.beta - truth)) < 2e-3 * size
    assert np.max(np.abs(didim_zero.beta - truth)) > 5 * np.max(np.abs(didim_fit.beta - truth))
    cloe = identify(log, CLOE(start="reference", noise=[1e-6, 1e-6]))
    assert np.max(np.abs(cloe.beta - truth)) < 2e-3 * size
    exact = replace(didim_fit, parameters=x, beta=truth)
    for one, low, high in ((log, 0.0, 1e-3), (zero, 0.02, 1.0)):
        (found,) = didim.validate(exact, one).recordings
        assert low <= np.max(found.simulated["torque"]) < high


def test_windows_begin_in_the_middle_of_a_log(cut: tuple[Experiment, Array]) -> None:
    log, x = cut
    (recording,) = log.recordings
    for window in ((500, 1500), (1500, 2500)):
        simulated = closed_loop(log, recording, window).run(x[None])[0][3][0]
        assert recording.tau is not None
        assert error(recording.tau[slice(*window)], simulated) < 2e-3


def test_each_candidate_begins_in_its_own_balance() -> None:
    robot = didim.load_robot("planar2").with_smoothing([0.05, 0.05])
    reference = Reference.point_to_point(
        [[0.5, 0.2], [1.0, -0.5]], max_velocity=[2.0, 3.0], max_acceleration=[8.0, 12.0], dwell_s=0.2
    )
    x = robot.parameter_set("reference")
    candidates = x * np.array([[1.0], [1.3], [0.7], [1.1], [0.9]])
    still = np.zeros((1, 2))
    for timing in TIMINGS.values():
        controller = LAWS["pid"](timing)
        run = didim.simulate(robot, candidates, reference, controller)
        balance = [didim.inverse_dynamics(robot, [[0.5, 0.2]], still, still, one)[0] for one in candidates]
        np.testing.assert_allclose(run.tau[:, 0], balance, rtol=1e-9)
        zero = didim.simulate(robot, x, reference, controller, memory=ControllerMemory())
        np.testing.assert_allclose(zero.tau[0], 0.0, atol=1e-9)
        # Until it moves, the arm in balance stays.
        resting = Reference.sampled(np.tile([0.5, 0.2], (200, 1)), rate_hz=200.0)
        held = didim.simulate(robot, candidates, resting, controller)
        np.testing.assert_allclose(held.q, np.broadcast_to([0.5, 0.2], held.q.shape), atol=1e-12)


def test_noise_is_averaged() -> None:
    controller = LAWS["pid"](None)
    _, _, reference, run = run_of(controller)
    first = round(CUT_S * RATE_HZ)
    rng = np.random.default_rng(0)
    noise = 0.5
    t = np.arange(round((END_S - CUT_S) * RATE_HZ) + 1) / RATE_HZ
    rest = Reference.through(*reference.at(t + CUT_S), rate_hz=RATE_HZ)
    found = []
    for _ in range(30):
        tau = run.tau[first:] + noise * rng.standard_normal(run.tau[first:].shape)
        start = (run.q[first], run.dq[first])
        found.append(memory_of_log(controller, rest, RATE_HZ, run.q[first:], tau, start).values)
    spread = np.std(np.array(found) - run.tau[first], axis=0)
    assert np.all(spread < 0.3 * noise)
    assert np.all(np.abs(np.mean(found, axis=0) - run.tau[first]) < 4.0 * noise / np.sqrt(30 * 50))


def test_a_log_at_the_limit_of_a_drive_says_nothing_about_the_integrator() -> None:
    controller = Controller.pid(KP, KV, KI, saturation=[1e-3, 1e3])
    q = np.tile([0.1, 0.2], (100, 1))
    reference = Reference.sampled(q, rate_hz=100.0)
    memory = memory_of_log(controller, reference, 100.0, q, np.tile([1.0, 2.0], (100, 1)))
    np.testing.assert_allclose(memory.values, [1.0, 2.0], rtol=1e-9)
    robot = didim.load_robot("planar2").with_smoothing([0.05, 0.05])
    run = didim.simulate(robot, robot.parameter_set("reference"), reference, controller, memory=memory)
    np.testing.assert_allclose(run.tau[0], [1e-3, 2.0], rtol=1e-6)


def test_a_law_without_memory_has_none() -> None:
    assert not remembers(Controller.pd(KP, KV))
    assert not remembers(Controller.pd(KP, KV, digital=Digital(sample_time_s=0.001)))
    assert remembers(Controller.pd(KP, KV, digital=Digital(sample_time_s=0.001, delay_samples=1)))
    assert remembers(Controller.pid(KP, KV, KI))


FILE = """schema = 1
name = "planar arm"
robot = "planar2"

[reference]
kind = "point-to-point"
points_rad = [[0.5, 0.2], [1.0, -0.5]]
max_velocity_rad_s = 2
max_acceleration_rad_s2 = 8
dwell_s = 0.1

[controller]
kind = "pid"
kp = [300, 60]
kv = [40, 5]
ki = [600, 150]
sample_time_s = 0.001
delay_samples = 1

[simulation]
smoothing_rad_s = 0.05
"""
STATE = """
[simulation.controller_state]
integrators = [0.01, 0.02]
outputs = [[3.0, 2.0]]
positions = [[0.5, 0.2]]
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "arm.toml"
    path.write_text(text)
    return path


def test_the_state_is_a_table_of_the_experiment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    experiment = load_experiment(written(tmp_path, FILE + STATE))
    loop = closed_loop(experiment)
    assert loop.memory.values == (0.01, 0.02)
    np.testing.assert_allclose(np.asarray(loop.memory.positions), [[0.5, 0.2]])
    x = experiment.robot.parameter_set("reference")
    tau = loop.run(x[None])[0][3][0]
    np.testing.assert_allclose(tau[0], [3.0, 2.0])
    by_default, zero = (
        closed_loop(load_experiment(written(tmp_path, FILE + more))).run(x[None])[0][3][0]
        for more in ("", 'controller_start = "zero"\n')
    )
    np.testing.assert_allclose(zero[0], 0.0, atol=1e-12)
    assert np.abs(by_default[0]).max() > 1.0
    for more, sentence in (
        ('controller_start = "zero"\n' + STATE, "give controller_start or the table controller_state"),
        ('controller_start = "log"\n', "needs a recording with torques"),
        ('controller_start = "warm"\n', "'log', 'balance' or 'zero'|controller_start"),
        (
            STATE.replace("[[3.0, 2.0]]", "[[3.0, 2.0], [1.0, 1.0]]"),
            r"outputs .* need shape \(1, 2\), got \(2, 2\)",
        ),
        (STATE.replace("[0.01, 0.02]", "[0.01, nan]"), "integrators"),
    ):
        path = written(tmp_path, FILE + more)
        with pytest.raises(ExperimentError, match=sentence):
            closed_loop(load_experiment(path))
        assert main(["simulate", str(path), "--parameters", "reference"]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_a_given_state_is_that_of_the_beginning(cut: tuple[Experiment, Array]) -> None:
    log, _ = cut
    given = ControllerMemory(start="integrators", values=(0.0, 0.0))
    log = replace(log, simulation=replace(log.simulation, controller_state=given))
    assert closed_loop(log, log.recordings[0]).memory is given
    with pytest.raises(ExperimentError, match="at the beginning of the recording"):
        closed_loop(log, log.recordings[0], (100, 900))


@pytest.mark.parametrize(
    ("memory", "sentence"),
    [
        ({"start": "warm"}, "start"),
        ({"start": "torque", "values": (1.0,)}, "need 2 numbers, one per joint, got 1"),
        ({"start": "torque", "values": (1.0, float("nan"))}, "must be finite"),
        ({"outputs": [[1.0, 2.0]]}, r"need shape \(0, 2\), got \(1, 2\)"),
        ({"positions": [1.0, 2.0]}, "one column per joint"),
    ],
)
def test_wrong_memories_are_refused(memory: dict[str, object], sentence: str) -> None:
    robot = didim.load_robot("planar2")
    with pytest.raises(SimulationError, match=sentence):
        didim.simulate(
            robot,
            robot.parameter_set("reference"),
            Reference.sampled(np.zeros((100, 2)), rate_hz=100.0),
            LAWS["pid"](None),
            memory=ControllerMemory(**memory),  # type: ignore[arg-type]
        )
