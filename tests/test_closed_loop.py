"""The closed loop of an experiment file: references, controllers, steps and measurements as its tables say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.errors import DidimError, ExperimentError
from didim.experiment.experiment import Experiment
from didim.experiment.experiment_file import load_experiment
from didim.experiment.loop import closed_loop, outside_limits
from didim.experiment.specs import ControllerSpec, Measurement, ReferenceSpec, SimulationSettings
from didim.log.recording import Recording
from didim.loop.closed_loop import ClosedLoop
from didim.loop.controller import Controller, Digital
from didim.loop.reference import Reference
from didim.loop.tuning import mean_inertia
from didim.robot.robot_file import load_robot
from didim.signal.filters import differentiate
from didim.signal.processing import SignalProcessing

Array = NDArray[np.float64]

FOURIER = """
[reference]
kind = "fourier"
period_s = 2
sine_rad = [[0.3, 0.1], [0.1, -0.2]]
cosine_rad = [[0.0, 0.2], [0.1, 0.1]]
offset_rad = [0.5, -0.3]
"""
PD = """
[controller]
kind = "pd"
kp = [200, 80]
kv = [20, 6]
"""
# A slide on a turntable: joints of both kinds.
MIXED = """\
schema = 1
name = "mixed"
[[joint]]
kind = "revolute"
[[joint]]
kind = "prismatic"
alpha_deg = 90
[parameters.one]
ZZ1 = 1.0
M2 = 2.0
"""
RECORDING = """
[[recording]]
name = "log"
rate_hz = 100
position = { file = "log.npz", variable = "q", unit = "rad", side = "joint" }
torque = { file = "log.npz", variable = "tau", unit = "N.m", side = "joint" }
reference = { file = "log.npz", variable = "q_ref", unit = "rad", side = "joint" }
"""


def write(folder: Path, *tables: str, robot: str = "planar2") -> Path:
    (folder / "mixed.toml").write_text(MIXED, encoding="utf-8")
    path = folder / "arm.toml"
    path.write_text(f'schema = 1\nrobot = "{robot}"\n' + "\n".join(tables), encoding="utf-8")
    return path


def load(folder: Path, *tables: str, robot: str = "planar2") -> Experiment:
    return load_experiment(write(folder, *tables, robot=robot))


def table(name: str, **keys: Any) -> str:
    """TOML table; Python's lists, numbers and texts happen to be written alike."""
    lines = [
        f"{key} = {str(value).lower() if isinstance(value, bool) else repr(value)}"
        for key, value in keys.items()
    ]
    return "\n".join([f"[{name}]", *lines])


def same_motion(got: Reference, want: Reference) -> None:
    assert got.n_dof == want.n_dof
    assert got.duration == pytest.approx(want.duration, abs=1e-12)
    t = np.linspace(0.0, want.duration, 301)
    for one, other in zip(got.at(t), want.at(t), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)


def motion(folder: Path, *, robot: str = "planar2", **keys: Any) -> Reference:
    """Motion of a table ``[reference]`` that needs no recording."""
    experiment = load(folder, table("reference", **keys), robot=robot)
    assert isinstance(experiment.reference, ReferenceSpec)
    assert experiment.reference.kind == keys["kind"]
    assert experiment.reference.settings == keys
    return experiment.reference.build(None, None, experiment.signal)


def controller(folder: Path, *, robot: str = "planar2", **keys: Any) -> Controller:
    """Controller of a table, for the reference of `FOURIER`."""
    experiment = load(folder, FOURIER, table("controller", **keys), robot=robot)
    assert isinstance(experiment.controller, ControllerSpec)
    assert experiment.controller.settings == keys
    assert isinstance(experiment.reference, ReferenceSpec)
    assert experiment.reference.made is not None
    return experiment.controller.build(experiment.reference.made)


def same_law(got: Controller, want: Controller) -> None:
    assert (got.kind, got.digital) == (want.kind, want.digital)
    np.testing.assert_allclose(got.laws, want.laws, rtol=1e-12)
    np.testing.assert_array_equal(got.gain, want.gain)
    np.testing.assert_array_equal(got.saturation, want.saturation)


# --- [reference] --------------------------------------------------------------------------------------------------------


def test_fourier_by_amplitudes(tmp_path: Path) -> None:
    sine, cosine = [[0.3, 0.1], [0.1, -0.2]], [[0.0, 0.2], [0.1, 0.1]]
    want = Reference.fourier(sine, cosine, period_s=2.0, offset=[0.5, -0.3], duration_s=5.0)
    keys: dict[str, Any] = {"kind": "fourier", "period_s": 2, "duration_s": 5}
    same_motion(motion(tmp_path, **keys, sine_rad=sine, cosine_rad=cosine, offset_rad=[0.5, -0.3]), want)
    degrees = {
        f"{key}_deg": np.rad2deg(values).tolist() for key, values in (("sine", sine), ("cosine", cosine))
    }
    same_motion(motion(tmp_path, **keys, **degrees, offset_deg=np.rad2deg([0.5, -0.3]).tolist()), want)


def test_fourier_at_random_within_limits(tmp_path: Path) -> None:
    want = Reference.random_fourier(
        harmonics=6,
        period_s=3.0,
        max_position=[1.0, 0.5],
        max_velocity=2.0,
        max_acceleration=10.0,
        offset=[0.1, 0.1],
        seed=7,
    )
    keys: dict[str, Any] = {"kind": "fourier", "harmonics": 6, "period_s": 3, "seed": 7}
    limits: dict[str, Any] = {
        "max_position_rad": [1.0, 0.5],
        "max_velocity_rad_s": 2,
        "max_acceleration_rad_s2": 10,
    }
    same_motion(motion(tmp_path, **keys, **limits, offset_rad=0.1), want)
    degrees = {key.replace("rad", "deg"): np.rad2deg(value).tolist() for key, value in limits.items()}
    same_motion(motion(tmp_path, **keys, **degrees, offset_rad=0.1), want)


def test_point_to_point(tmp_path: Path) -> None:
    points = [[0.0, 0.0], [1.0, -0.5], [0.2, 0.4]]
    want = Reference.point_to_point(points, max_velocity=[1.0, 2.0], max_acceleration=5.0, dwell_s=0.2)
    keys: dict[str, Any] = {
        "kind": "point-to-point",
        "max_velocity_rad_s": [1, 2],
        "max_acceleration_rad_s2": 5,
    }
    same_motion(motion(tmp_path, **keys, points_rad=points, dwell_s=0.2), want)
    same_motion(motion(tmp_path, **keys, points_deg=np.rad2deg(points).tolist(), dwell_s=0.2), want)


def test_joints_of_both_kinds_have_limits_of_each_and_points_in_si(tmp_path: Path) -> None:
    points = [[0.0, 0.0], [1.0, 0.2]]
    got = motion(
        tmp_path,
        robot="mixed.toml",
        kind="point-to-point",
        points_si=points,
        max_velocity_deg_s=90,
        max_velocity_mm_s=[0, 250],
        max_acceleration_rad_s2=4,
        max_acceleration_m_s2=2,
    )
    same_motion(
        got, Reference.point_to_point(points, max_velocity=[np.pi / 2, 0.25], max_acceleration=[4.0, 2.0])
    )


def log(folder: Path, n: int = 200) -> tuple[Array, Array]:
    """Write a log; returns measured and reference positions."""
    t = np.arange(n)[:, None] / 100.0
    q_ref = np.sin(t * [2.0, 3.0])
    q = q_ref + 1e-3 * np.random.default_rng(0).standard_normal(q_ref.shape)
    np.savez(folder / "log.npz", q=q, tau=0.0 * q, q_ref=q_ref)
    return q, q_ref


def test_recorded_and_measured_references(tmp_path: Path) -> None:
    q, q_ref = log(tmp_path)
    signal = "[signal]\ncutoff_hz = 10\n"
    windows = RECORDING + "windows_s = [[0.5, 1.5]]\n"
    for kind in ("recorded", "measured"):
        experiment = load(tmp_path, table("reference", kind=kind), PD, signal, windows)
        (recording,) = experiment.recordings
        assert recording.windows == ((50, 150),)
        for window in (None, recording.windows[0]):
            start, stop = window or (0, 200)
            loop = closed_loop(experiment, recording, window)
            filtered, dq, _ = differentiate(q[start:stop], 100.0, experiment.signal)
            followed = q_ref[start:stop] if kind == "recorded" else filtered
            assert (loop.rate_hz, loop.n_records) == (100.0, stop - start)
            np.testing.assert_allclose(loop.reference.at(loop.t)[0], followed, rtol=0, atol=1e-12)
            # The run begins as the log does, which may be in motion.
            assert loop.start is not None
            np.testing.assert_array_equal(loop.start, [filtered[0], dq[0]])


def test_a_motion_of_its_own_starts_by_itself(tmp_path: Path) -> None:
    log(tmp_path)
    experiment = load(tmp_path, FOURIER, PD, RECORDING)
    (recording,) = experiment.recordings
    loop = closed_loop(experiment, recording)
    assert (loop.start, loop.n_records, loop.rate_hz) == (None, 200, 100.0)
    measured = load(tmp_path, FOURIER, PD, RECORDING, table("simulation", start="measured"))
    assert closed_loop(measured, recording).start is not None
    reference = load(
        tmp_path, table("reference", kind="recorded"), PD, RECORDING, table("simulation", start="reference")
    )
    assert closed_loop(reference, recording).start is None


# --- [controller] -------------------------------------------------------------------------------------------------------


def test_pd_pid_and_cascade(tmp_path: Path) -> None:
    same_law(controller(tmp_path, kind="pd", kp=[200, 80], kv=[20, 6]), Controller.pd([200, 80], [20, 6]))
    options: dict[str, Any] = {"reference_velocity": 0.5, "acceleration": [0.1, 0.2], "gain": [2.0, -3.0]}
    same_law(
        controller(tmp_path, kind="pid", kp=200, kv=20, ki=[5, 6], **options, saturation_a=[4, 5]),
        Controller.pid([200] * 2, 20, [5, 6], **options, saturation=[4, 5]),
    )
    same_law(controller(tmp_path, kind="cascade", kp=30, kv=[4, 5]), Controller.cascade(30, [4, 5]))
    same_law(
        controller(tmp_path, kind="cascade", kp=30, kv=[4, 5], integral_time_s=0.2, reference_velocity=1),
        Controller.cascade(30, [4, 5], integral_time_s=0.2, reference_velocity=1.0),
    )


@pytest.mark.parametrize("unit", ["v", "a", "n_m", "n"])
def test_a_saturation_in_any_unit_of_the_output(tmp_path: Path, unit: str) -> None:
    saturation: dict[str, Any] = {f"saturation_{unit}": 3}
    got = controller(tmp_path, kind="pd", kp=[200, 80], kv=1, **saturation)
    np.testing.assert_array_equal(got.saturation, [3.0, 3.0])


def test_gains_by_natural_frequency(tmp_path: Path) -> None:
    keys: dict[str, Any] = {"kind": "pd", "natural_frequency_hz": [10, 15], "damping": 0.7, "gain": [2, 4]}
    options: dict[str, Any] = {"gain": [2.0, 4.0]}
    same_law(
        controller(tmp_path, **keys, inertia=[1.5, 0.2]),
        Controller.tuned([10, 15], 0.7, [1.5, 0.2], **options),
    )
    robot = load_robot("planar2")
    followed = Reference.fourier(
        [[0.3, 0.1], [0.1, -0.2]], [[0.0, 0.2], [0.1, 0.1]], period_s=2.0, offset=[0.5, -0.3]
    )
    inertia = mean_inertia(robot, robot.sets["reference"], followed)
    # The mean along the reference, by hand.
    matrices = didim.inertia_matrix(
        robot, followed.at(np.linspace(0.0, 2.0, 5000))[0], robot.sets["reference"]
    )
    np.testing.assert_allclose(inertia, matrices.mean(axis=0).diagonal(), rtol=1e-3)
    same_law(
        controller(tmp_path, **keys, inertia_of="reference"),
        Controller.tuned([10, 15], 0.7, inertia, **options),
    )


def test_a_model_fed_forward_leaves_little_to_the_feedback(tmp_path: Path) -> None:
    smooth = table("friction", coulomb="tanh", smoothing_rad_s=0.5)
    errors = []
    for extra in ("", 'feedforward_of = "reference"\n'):
        loop = closed_loop(load(tmp_path, FOURIER, PD + extra, smooth))
        (q, _, _, _), outcomes = loop.run(loop.robot.sets["reference"][None])
        assert outcomes[0].completed
        errors.append(np.abs(q[0] - loop.reference.at(loop.t)[0]).max())
    assert errors[0] > 0.01
    # Straight lines between samples of the torque at 1 kHz.
    assert errors[1] < 1e-6


def test_digital(tmp_path: Path) -> None:
    keys: dict[str, Any] = {"kind": "pd", "kp": 200, "kv": 20, "sample_time_s": 0.002}
    plain = controller(tmp_path, **keys)
    assert plain.digital == Digital(sample_time_s=0.002, resolution=(0.0, 0.0))
    full = controller(
        tmp_path, **keys, delay_samples=2, velocity_fir=[0.5, 0.3, 0.2], encoder_resolution_deg=0.1
    )
    assert full.digital is not None
    assert (full.digital.delay_samples, full.digital.smoothing) == (2, (0.5, 0.3, 0.2))
    np.testing.assert_allclose(full.digital.resolution, np.deg2rad([0.1, 0.1]))
    assert controller(tmp_path, kind="pd", kp=200, kv=[1, 2]).digital is None


# --- [simulation] and [measurement] -------------------------------------------------------------------------------------


def test_simulation_settings_are_those_of_the_run(tmp_path: Path) -> None:
    keys: dict[str, Any] = {
        "step_s": 0.002,
        "fine_step_s": 0.001,
        "rate_hz": 50,
        "duration_s": 1.5,
        "divergence": 7,
    }
    experiment = load(tmp_path, FOURIER, PD, table("simulation", **keys, smoothing_rad_s=[0.01, 0.02]))
    loop = closed_loop(experiment)
    assert (loop.rate_hz, loop.n_records, loop.divergence) == (50.0, 76, 7.0)
    assert loop.robot.friction.coulomb == "tanh"
    assert loop.robot.friction.smoothing == (0.01, 0.02)
    # The robot of the experiment, which the log is identified with, keeps its own friction.
    assert experiment.robot.friction.coulomb == "sign"
    by_hand = ClosedLoop.of(
        load_robot("planar2").with_smoothing([0.01, 0.02]),
        loop.reference,
        loop.controller,
        rate_hz=50.0,
        duration_s=1.5,
        step=0.002,
        fine_step=0.001,
    )
    assert loop.schedule.steps == by_hand.schedule.steps
    plain = closed_loop(load(tmp_path, FOURIER, PD))
    assert (plain.rate_hz, plain.t[-1], plain.divergence) == (1000.0, 2.0, 100.0)


def test_a_measurement_is_quantised_noisy_and_reproducible(tmp_path: Path) -> None:
    keys: dict[str, Any] = {
        "encoder_resolution_rad": [1e-3, 0],
        "position_noise_deg": 0.1,
        "torque_noise_n_m": [2, 0],
    }
    measurement = load(tmp_path, FOURIER, table("measurement", **keys, seed=4)).measurement
    assert measurement is not None
    assert measurement.seed == 4
    q, tau = np.tile(np.linspace(-1.0, 1.0, 5000)[:, None], 2), np.ones((5000, 2))
    seen, felt = measurement.measure(q, tau)
    again = measurement.measure(q, tau)
    np.testing.assert_array_equal(again[0], seen)
    np.testing.assert_array_equal(again[1], felt)
    counts = seen[:, 0] / 1e-3
    np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-9)
    noise = seen - q
    assert np.std(noise[:, 1]) == pytest.approx(np.deg2rad(0.1), rel=0.05)
    # A count more or less, of a uniform error.
    assert np.std(noise[:, 0]) == pytest.approx(np.hypot(np.deg2rad(0.1), 1e-3 / np.sqrt(12.0)), rel=0.05)
    assert np.std(felt[:, 0]) == pytest.approx(2.0, rel=0.05)
    np.testing.assert_array_equal(felt[:, 1], 1.0)
    assert abs(np.corrcoef(noise[:, 1], felt[:, 0])[0, 1]) < 0.1
    other = replace(measurement, seed=5).measure(q, tau)
    assert np.abs(other[0] - seen).max() > 1e-3
    # One setting does not change the noise of another.
    np.testing.assert_array_equal(replace(measurement, position_noise=()).measure(q, tau)[1], felt)
    exact_q, exact_tau = Measurement().measure(q, tau)
    np.testing.assert_array_equal(exact_q, q)
    np.testing.assert_array_equal(exact_tau, tau)


def test_a_quantised_position_is_the_nearest_count(tmp_path: Path) -> None:
    measurement = load(tmp_path, FOURIER, table("measurement", encoder_resolution_rad=0.1)).measurement
    assert measurement is not None
    q = np.array([[0.04, 0.06], [-0.26, 1.0]])
    np.testing.assert_allclose(measurement.measure(q, q)[0], [[0.0, 0.1], [-0.3, 1.0]], rtol=0, atol=1e-15)


def test_limits_of_the_robot_are_told_for_the_run_only() -> None:
    robot = load_robot("planar2")
    reference = Reference.point_to_point(
        [[0.0, 0.0], [0.0, -3.0], [0.0, 0.0]], max_velocity=[1.0, 10.0], max_acceleration=200.0
    )
    (position, velocity) = outside_limits(robot, reference, reference.duration)
    assert position.startswith("the reference of joint 2 is -3 at ")
    assert position.endswith(", outside its limits -2.6 to 2.6")
    assert velocity.startswith("the reference of joint 2 moves at 10 at ")
    assert velocity.endswith(", faster than its limit 6")
    assert outside_limits(robot, reference, 0.02) == []


# --- Wrong tables -------------------------------------------------------------------------------------------------------

RANDOM = 'kind = "fourier"\nharmonics = 5\nperiod_s = 1\nmax_position_rad = 1\nmax_velocity_rad_s = 1\n'
MOVE = 'kind = "point-to-point"\npoints_rad = [[0, 0], [1, 1]]\nmax_velocity_rad_s = 1\n'
TUNED = 'kind = "pd"\nnatural_frequency_hz = 10\ndamping = 0.7\n'
GAINS = 'kind = "pd"\nkp = [1, 1]\nkv = 1\n'


@pytest.mark.parametrize(
    ("name", "keys", "message"),
    [
        ("reference", "", "key 'kind' is missing"),
        ("reference", 'kind = "fourie"', "kind must be one of 'recorded', 'measured', 'fourier', 'point-to-point'"),
        ("reference", 'kind = "recorded"\nperiod_s = 1', "unknown key 'period_s'"),
        ("reference", 'kind = "fourier"', "key 'period_s' is missing"),
        ("reference", 'kind = "fourier"\nperiod_s = 0', "period_s must be above 0"),
        ("reference", 'kind = "fourier"\nperiod_s = 1', "give one of sine_rad, sine_deg"),
        ("reference", 'kind = "fourier"\nperiod_s = 1\nsine_m = [[1, 1]]', "give one of sine_rad, sine_deg"),
        ("reference", 'kind = "fourier"\nperiod_s = 1\nsine_rad = [[1, 1]]', "key 'cosine_rad' is missing"),
        (
            "reference",
            'kind = "fourier"\nperiod_s = 1\nsine_rad = [[1, 1]]\ncosine_rad = [[1, 1, 1]]',
            "cosine_rad, row 1, must hold 2 numbers, got 3",
        ),
        (
            "reference",
            'kind = "fourier"\nperiod_s = 1\nsine_rad = [[1, 1]]\ncosine_rad = [[1, 1], [1, 1]]',
            "cosine_rad must be a matrix of 1 row and 2 columns, got 2 rows",
        ),
        ("reference", 'kind = "fourier"\nperiod_s = 1\nsine_rad = []\ncosine_rad = []', "sine must have shape"),
        ("reference", RANDOM, "key 'max_acceleration_rad_s2' is missing, for joint 1"),
        ("reference", RANDOM.replace("5", "3"), "harmonics must be at least 4, got 3"),
        ("reference", RANDOM + "max_acceleration_rad_s2 = -1", "max_acceleration must be positive, got [-1.0, -1.0]"),
        ("reference", RANDOM + "max_acceleration_rad_s2 = 1\nseed = -1", "seed must be at least 0, got -1"),
        ("reference", RANDOM + "max_acceleration_rad_s2 = 1\nseeds = 1", "unknown key 'seeds'; did you mean 'seed'?"),
        ("reference", RANDOM + "max_acceleration_m_s2 = 1", "max_acceleration_m_s2 is for prismatic joints, and robot"),
        (
            "reference",
            RANDOM + "max_acceleration_rad_s2 = 1\nmax_acceleration_deg_s2 = 1",
            "give max_acceleration_rad_s2 or max_acceleration_deg_s2, not both",
        ),
        ("reference", RANDOM + "max_acceleration_rad_s2 = [1, 2, 3]", "max_acceleration_rad_s2 must hold 2 numbers"),
        ("reference", MOVE, "key 'max_acceleration_rad_s2' is missing, for joint 1"),
        ("reference", MOVE + "max_acceleration_rad_s2 = 0", "acceleration of joint 1 must be positive, got 0"),
        ("reference", MOVE + "max_acceleration_rad_s2 = 1\ndwell_s = -1", "dwell_s must be at least 0"),
        ("reference", MOVE.replace("[1, 1]", "[1]") + "max_acceleration_rad_s2 = 1", "points_rad, row 2, must hold 2"),
        ("reference", MOVE.replace(", [1, 1]", "") + "max_acceleration_rad_s2 = 1", "at least two different points"),
        ("controller", "", "key 'kind' is missing"),
        ("controller", 'kind = "lqr"', "kind must be one of 'pd', 'pid', 'cascade', 'made-up', got 'lqr'"),
        ("controller", 'kind = "pd"\nkp = 1', "key 'kv' is missing"),
        ("controller", 'kind = "pid"\nkp = 1\nkv = 1', "key 'ki' is missing"),
        ("controller", GAINS + "ki = 1", "unknown key 'ki'"),
        ("controller", GAINS + "kf = 1", "unknown key 'kf'"),
        ("controller", 'kind = "pd"\nkp = [1, 1, 1]\nkv = 1', "kp must hold 2 numbers, got 3"),
        ("controller", 'kind = "pd"\nkp = "high"\nkv = 1', "kp must be a finite number, got 'high'"),
        ("controller", 'kind = "pd"\nkp = nan\nkv = 1', "kp must be a finite number, got nan"),
        ("controller", GAINS + "gain = 0", "the drive gain of joint 1 is zero"),
        ("controller", GAINS + "saturation_v = [1, 0]", "the saturation of joint 2 must be positive, got 0"),
        ("controller", GAINS + "saturation_v = 1\nsaturation_a = 1", "give one of saturation_v, saturation_a"),
        ("controller", GAINS + "integral_time_s = 1", "unknown key 'integral_time_s'"),
        (
            "controller",
            'kind = "cascade"\nkp = [1, 1]\nkv = 1\nintegral_time_s = 0',
            "integral_time_s must be positive, got [0.0, 0.0]",
        ),
        ("controller", TUNED, "natural_frequency_hz needs inertia (kg.m^2 or kg, one per joint) or inertia_of"),
        ("controller", TUNED + "inertia = 1\ninertia_of = 'reference'", "natural_frequency_hz needs inertia"),
        ("controller", TUNED.replace('"pd"', '"pid"') + "inertia = 1", "natural_frequency_hz is for kind 'pd'"),
        ("controller", TUNED + "inertia = [1, -1]", "inertia must be positive, got [1.0, -1.0]"),
        ("controller", TUNED + "inertia = 1\nkp = 1", "unknown key 'kp'"),
        (
            "controller",
            TUNED.replace("10", "-10") + "inertia_of = 'reference'",
            "natural_frequency_hz must be above 0.0, got -10.0",
        ),
        ("controller", TUNED + "inertia_of = 'referenc'", "inertia_of: planar2.toml: no parameter set 'referenc'; did"),
        ("controller", GAINS + "feedforward_of = 'x'", "feedforward_of: planar2.toml: no parameter set 'x'"),
        ("controller", GAINS + "feedforward_of = 'reference'\ngain = 0", "the drive gain of joint 1 is zero"),
        ("controller", GAINS + "delay_samples = 1", "delay_samples is for a digital controller: add sample_time_s"),
        ("controller", GAINS + "velocity_fir = [1]", "velocity_fir is for a digital controller: add sample_time_s"),
        ("controller", GAINS + "encoder_resolution_deg = 1", "encoder_resolution is for a digital controller"),
        ("controller", GAINS + "sample_time_s = 0", "sample_time_s must be above 0"),
        ("controller", GAINS + "sample_time_s = 1\ndelay_samples = -1", "delay_samples must be at least 0, got -1"),
        ("controller", GAINS + "sample_time_s = 1\ndelay_samples = 0.5", "delay_samples must be an integer, got 0.5"),
        ("controller", GAINS + "sample_time_s = 1\nvelocity_fir = []", "smoothing needs one or more finite weights"),
        ("controller", GAINS + "sample_time_s = 1\nencoder_resolution_rad = -1", "resolution must be finite and not negative"),
        (
            "controller",
            GAINS + "sample_time_s = 1\nencoder_resolution_m = 1",
            "encoder_resolution_m is for prismatic joints, and robot 'planar2' has none",
        ),
        ("simulation", "step = 0.1", "unknown key 'step'; did you mean 'step_s'?"),
        ("simulation", "step_s = 0", "step_s must be above 0"),
        ("simulation", "fine_step_s = -1", "fine_step_s must be above 0"),
        ("simulation", "rate_hz = 0", "rate_hz must be above 0"),
        ("simulation", "duration_s = nan", "duration_s must be a finite number, got nan"),
        ("simulation", "divergence = 0", "divergence must be above 0"),
        ("simulation", 'start = "zero"', "start must be one of 'measured', 'reference', got 'zero'"),
        ("simulation", "smoothing_rad_s = [0.1, 0]", "smoothing_rad_s number 2 must be above 0.0, got 0.0"),
        ("simulation", "smoothing_rad_s = 1e12", "smoothing_rad_s must be at most 1000.0, got 1000000000000.0"),
        ("simulation", "smoothing_m_s = 0.1", "smoothing_m_s is for prismatic joints, and robot 'planar2' has none"),
        ("measurement", "noise = 1", "unknown key 'noise'"),
        ("measurement", "position_noise_rad = -1", "position_noise_rad must be at least 0.0, got -1.0"),
        ("measurement", "torque_noise_n_m = [1, -1]", "torque_noise_n_m number 2 must be at least 0.0, got -1.0"),
        ("measurement", "torque_noise_n_m = 1\ntorque_noise_n = 1", "give torque_noise_n_m or torque_noise_n, not both"),
        ("measurement", "encoder_resolution_mm = 1", "encoder_resolution_mm is for prismatic joints, and robot"),
        ("measurement", "seed = 1.5", "seed must be an integer, got 1.5"),
        ("measurement", "seed = -1", "seed must be at least 0, got -1"),
    ],
)  # fmt: skip
def test_a_wrong_table_is_one_sentence_of_loading(tmp_path: Path, name: str, keys: str, message: str) -> None:
    needed = "" if name == "reference" else FOURIER
    path = write(tmp_path, needed, f"[{name}]\n{keys}\n")
    with pytest.raises(DidimError) as caught:
        load_experiment(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"arm.toml: [{name}] ")
    assert message in sentence
    assert "\n" not in sentence


def test_what_a_simulation_cannot_do_without(tmp_path: Path) -> None:
    def refused(*tables: str, recorded: bool = False) -> str:
        experiment = load(tmp_path, *tables)
        with pytest.raises(ExperimentError) as caught:
            closed_loop(experiment, experiment.recordings[0] if recorded else None)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    log(tmp_path)
    recorded = table("reference", kind="recorded")
    assert refused(FOURIER).startswith("arm: a simulation needs the table [controller]")
    assert refused(RECORDING, PD).startswith("arm: a simulation needs the table [reference]")
    assert (
        refused(recorded, PD)
        == "arm: the reference is 'recorded', the motion of a recording, and this simulation is made without one"
    )
    assert "recording 'log' has no reference positions: add [recording.reference]" in refused(
        recorded, PD, RECORDING.replace("reference =", "#"), recorded=True
    )
    assert refused(FOURIER, PD, table("simulation", duration_s=5)) == (
        "arm: the reference starts at 0 s and ends at 2 s, before the run, at 5 s"
    )
    sentence = refused(FOURIER, PD, table("simulation", rate_hz=1e6))
    assert sentence.startswith("arm: 2 s at 1e+06 Hz are too many records: 1500000 are possible")
    assert "[simulation] start = 'measured' needs a recording" in refused(
        FOURIER, PD, table("simulation", start="measured")
    )


def test_an_indefinite_set_has_no_inertia_to_tune_by(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(MIXED.replace("ZZ1 = 1.0", "ZZ1 = -1.0"), encoding="utf-8")
    keys: dict[str, Any] = {"kind": "pd", "natural_frequency_hz": 5, "damping": 1, "inertia_of": "one"}
    move = table(
        "reference",
        kind="point-to-point",
        points_si=[[0, 0], [1, 0.1]],
        max_velocity_rad_s=1,
        max_velocity_m_s=1,
        max_acceleration_rad_s2=1,
        max_acceleration_m_s2=1,
    )
    experiment = load(tmp_path, move, table("controller", **keys), robot="bad.toml")
    with pytest.raises(ExperimentError, match=r"^arm: inertia must be positive, got \[-"):
        closed_loop(experiment)


def test_a_motion_of_its_own_begins_with_the_recording(tmp_path: Path) -> None:
    """A window that begins later would meet the wrong part of the motion."""
    log(tmp_path)
    experiment = load(tmp_path, FOURIER, PD, RECORDING)
    (recording,) = experiment.recordings
    with pytest.raises(
        ExperimentError, match=r"^arm: the window of recording 'log' begins at 0\.5 s, and a reference"
    ):
        closed_loop(experiment, recording, (50, 150))
    assert closed_loop(experiment, recording, (0, 150)).n_records == 150


def test_settings_made_in_python_are_checked_too() -> None:
    with pytest.raises(ExperimentError, match="start must be 'measured' or 'reference', got 'now'"):
        SimulationSettings(start="now")
    q = np.zeros((5, 2))
    with pytest.raises(ExperimentError, match="torque_noise needs 2 numbers, one per joint, got 3"):
        Measurement(torque_noise=(1.0, 1.0, 1.0)).measure(q, q)
    robot = load_robot("planar2")
    reference = Reference.sampled(q, rate_hz=10.0)
    recording = Recording.from_arrays(q, q, rate_hz=10.0)
    experiment = Experiment(
        name="made",
        robot=robot,
        recordings=(recording,),
        signal=SignalProcessing(cutoff_hz=None),
        reference=reference,
        controller=Controller.pd(1.0, 1.0),
    )
    with pytest.raises(
        ExperimentError, match=r"^made: the controller has 1 joints and robot 'planar2' has 2$"
    ):
        closed_loop(experiment)
    whole = replace(experiment, controller=Controller.pd([1.0, 1.0], 1.0))
    assert closed_loop(whole, recording).n_records == 5
    smooth = replace(whole, simulation=SimulationSettings(smoothing=(0.1,)))
    with pytest.raises(ExperimentError, match="smoothing needs 2 entries, one per joint, got 1"):
        closed_loop(smooth)
