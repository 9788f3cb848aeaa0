"""The hold of a digital controller: half a step by which a logged torque is ahead of measured motion (docs/idim_ls.md, Delays)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.experiment.experiment import Experiment
from didim.experiment.specs import Measurement, SimulationSettings
from didim.loop.controller import Controller, Digital
from didim.loop.reference import Reference
from didim.loop.tuning import mean_inertia
from didim.methods.didim.didim import DIDIM
from didim.methods.identify import identify
from didim.methods.idim_iv import IDIMIV
from didim.methods.idim_ls import IDIMLS
from didim.robot.robot import Robot
from didim.robot.robot_file import load_robot
from didim.signal.processing import SignalProcessing
from didim.signal.window import hold_samples
from didim.studies.simulated_log import measured, simulated_log
from didim.studies.validation import validate

pytestmark = pytest.mark.usefixtures("without_verdict")

SEEDS = 8


def sigmas(log: Experiment, x: np.ndarray, method: IDIMLS | DIDIM | IDIMIV) -> dict[str, np.ndarray]:
    """Estimate less truth in standard deviations, over some seeds of the noise, by parameter."""
    truth = log.robot.base_parameters.project(x)
    # The noise is white: (10) without model error is the sharpest measure.
    method = replace(method, uncertainty="decimated")
    fits = [identify(measured(log, seed), method) for seed in range(SEEDS)]
    off = np.array([(fit.beta - truth) / fit.std for fit in fits])
    return dict(zip(fits[0].names, off.T, strict=True))


def planar2(project: Path, rate_hz: float) -> tuple[Experiment, np.ndarray]:
    """Log of the packaged planar arm without noise; its controller runs at 1 kHz."""
    experiment = didim.load_experiment(project / "examples" / "planar2_simulation.toml")
    trim = int(rate_hz / 20)
    signal = SignalProcessing(
        cutoff_hz=100.0, trim_start=trim, trim_end=trim, decimation=(int(rate_hz / 100),)
    )
    simulation = replace(experiment.simulation, rate_hz=rate_hz)
    x = experiment.robot.parameter_set("reference")
    return simulated_log(replace(experiment, signal=signal, simulation=simulation), x, noise=False), x


def test_half_a_step_or_half_a_sample() -> None:
    assert hold_samples(0.0, 500.0) == 0.0
    assert hold_samples(1e-3, 500.0) == 0.25
    assert hold_samples(1e-3, 1000.0) == 0.5
    assert hold_samples(1e-3, 5000.0) == 0.5


@pytest.mark.usefixtures("without_alarm")
@pytest.mark.parametrize("rate_hz", [500.0, 2000.0])
def test_idim_ls_accounts_for_the_hold_of_the_planar_arm(project: Path, rate_hz: float) -> None:
    log, x = planar2(project, rate_hz)
    off = sigmas(log, x, IDIMLS())
    assert max(abs(values.mean()) for values in off.values()) < 3.0
    assert abs(off["Fv1"].mean()) < 1.5
    assert np.sqrt(np.mean([values**2 for values in off.values()])) < 1.3
    # A number is taken as it is: without the hold viscous friction is too small.
    assert sigmas(log, x, IDIMLS(compensate_samples=0.0))["Fv1"].mean() < -4.0


@pytest.mark.slow
def test_didim_needs_no_hold_and_validation_has_that_of_the_method(project: Path) -> None:
    log, x = planar2(project, 500.0)
    off = sigmas(log, x, DIDIM())
    assert abs(off["Fv1"].mean()) < 1.5
    noisy = measured(log)
    fit = identify(noisy, IDIMLS())
    assert fit.delay == {"compensated_samples": 0.0, "hold_s": 0.001}
    assert "hold of the digital controller, 1 ms" in str(fit)
    (check,) = validate(fit, noisy).recordings
    assert check.direct is not None
    np.testing.assert_allclose(check.direct, fit.relative_error, rtol=1e-12)
    # DIDIM predicts recordings that are held out along their measured motion, where the hold counts.
    kept_out = replace(noisy.recordings[0], name="kept out", role="held-out")
    both = replace(noisy, recordings=(*noisy.recordings, kept_out))
    found = identify(both, DIDIM())
    assert "hold of the digital controller" not in str(found)
    assert found.held_out[0].overall_relative_error < 1.02 * fit.overall_relative_error


@pytest.mark.slow
@pytest.mark.usefixtures("without_alarm")
def test_idim_iv_accounts_for_the_hold_too(project: Path) -> None:
    log, x = planar2(project, 500.0)
    off = sigmas(log, x, IDIMIV())
    assert max(abs(values.mean()) for values in off.values()) < 3.0
    assert abs(off["Fv1"].mean()) < 1.5


@pytest.mark.parametrize("method", [IDIMLS(), DIDIM()])
def test_an_estimate_finds_no_delay_beside_the_hold(project: Path, method: IDIMLS | DIDIM) -> None:
    log, _ = planar2(project, 500.0)
    noisy = measured(log)
    fit = identify(noisy, replace(method, compensate_samples="estimate"))
    assert fit.delay["estimated_samples"] == 0.0
    assert fit.delay["estimated_std_samples"] < 0.05
    np.testing.assert_array_equal(fit.beta, identify(noisy, method).beta)
    (recording,) = noisy.recordings
    assert recording.tau is not None
    late = replace(recording, tau=np.vstack([recording.tau[:2], recording.tau[:-2]]))
    fit = identify(replace(noisy, recordings=(late,)), replace(method, compensate_samples="estimate"))
    assert fit.delay["estimated_samples"] == pytest.approx(2.0, abs=0.1)
    assert fit.delay["hold_s"] == 0.001


def seven_joints(folder: Path) -> tuple[Robot, np.ndarray]:
    """Load an arm of seven revolute joints with made-up bodies."""
    lines = [
        'schema = 1\nname = "seven"\ngravity_m_s2 = [0.0, 0.0, -9.81]\n',
        '[friction]\ncoulomb = "tanh"\nsmoothing_rad_s = 0.02\n',
    ]
    truth = ["[parameters.truth]\n"]
    rows = zip(
        (0, -90, 90, 90, -90, -90, 90),
        (0.34, 0.0, 0.4, 0.0, 0.4, 0.0, 0.13),
        (4.0, 4.0, 3.0, 2.7, 1.7, 1.8, 0.4),
        strict=True,
    )
    for joint, (tilt, offset, mass) in enumerate(rows, start=1):
        lines.append(
            f'[[joint]]\nkind = "revolute"\nalpha_deg = {tilt}.0\nd_m = 0.0\ntheta_deg = 0.0\nr_m = {offset}\n'
        )
        c = np.array([0.01, 0.02, 0.06]) * [1.0, (-1.0) ** joint, (-1.0) ** joint]
        inertia = mass * (np.diag([0.010, 0.009, 0.004]) + c @ c * np.eye(3) - np.outer(c, c))
        size = 0.6 ** (joint - 1)
        values = dict(zip(("XX", "XY", "XZ"), inertia[0], strict=True))
        values |= {"YY": inertia[1, 1], "YZ": inertia[1, 2], "ZZ": inertia[2, 2], "M": mass}
        values |= dict(zip(("MX", "MY", "MZ"), mass * c, strict=True))
        values |= {"Ia": 0.9 * size, "Fv": 3.0 * size, "Fc": 4.0 * size, "Off": 0.3 * size}
        truth += [f"{name}{joint} = {float(value)!r}\n" for name, value in values.items()]
    path = folder / "seven.toml"
    path.write_text("".join(lines + truth), encoding="utf-8")
    robot = load_robot(path)
    return robot, robot.parameter_set("truth")


@pytest.mark.slow
@pytest.mark.usefixtures("without_alarm")
def test_idim_ls_accounts_for_the_hold_of_a_seven_joint_arm(tmp_path: Path) -> None:
    robot, x = seven_joints(tmp_path)
    reference = Reference.random_fourier(
        harmonics=20,
        period_s=10.0,
        max_position=[1.5] * 7,
        max_velocity=[2.5] * 7,
        max_acceleration=[25.0] * 7,
        seed=1,
    )
    inertia = mean_inertia(robot, x, reference)
    controller = Controller.tuned([12.0] * 7, [0.7] * 7, inertia, digital=Digital(sample_time_s=1e-3))
    experiment = Experiment(
        name="seven",
        robot=robot,
        recordings=(),
        reference=reference,
        controller=controller,
        signal=SignalProcessing(cutoff_hz=100.0, trim_start=40, trim_end=40, decimation=(10, 2)),
        simulation=SimulationSettings(rate_hz=1000.0),
        measurement=Measurement(
            position_noise=(2e-6,) * 7, torque_noise=tuple(0.05 * 0.6**joint for joint in range(7))
        ),
    )
    log = simulated_log(experiment, x, noise=False, refinement=2)
    off = sigmas(log, x, IDIMLS())
    assert abs(off["Ia7"].mean()) < 3.0
    assert max(abs(values.mean()) for values in off.values()) < 3.0
    without = sigmas(log, x, IDIMLS(compensate_samples=0.0))
    assert np.mean([without[f"Fv{joint}"].mean() for joint in range(1, 8)]) < -5.0
