"""Pictures: what is drawn is what the fit says; predictions on the rows of the fit; frames beside those of Pinocchio."""

from __future__ import annotations

import builtins
import subprocess
import sys
from dataclasses import replace
from typing import Any

import matplotlib
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

import didim
from arm import arm_log, noisy
from didim import CLOE, DIDIM, IDIMLS, Experiment, Identification, identify, plot, validate
from didim.errors import FitError, PlotError, ShapeError
from didim.experiment.specs import SimulationSettings
from didim.model.kinematics import frames
from didim.plot.style import MOST_POINTS, line, thin
from didim.robot.robot import JointLimits, Robot
from didim.signal.filters import DECIMATION_RIPPLE_DB
from didim.signal.noise import noise_correlation
from didim.signal.processing import SignalProcessing
from didim.studies.prediction import autocorrelation, predict, relative_errors, simulate_window
from robots import random_motion, random_parameters, robots
from simulated import experiment as log_experiment
from simulated import log as simulated_log
from twins import pinocchio_model


@pytest.fixture(scope="module")
def arm() -> Experiment:
    return noisy(arm_log(1))


@pytest.fixture(scope="module")
def direct(arm: Experiment) -> Identification:
    return identify(arm, IDIMLS())


@pytest.fixture(scope="module")
def closed(arm: Experiment) -> Identification:
    return identify(arm, DIDIM())


@pytest.fixture(scope="module")
def two_windows() -> Experiment:
    """A log in two windows with a torque that came late, and another one held out."""
    robot = didim.load_robot("planar2")
    x = robot.parameter_set("reference")
    first = simulated_log(robot, x, noise=0.1, name="first")
    other = simulated_log(robot, x, seed=5, noise=0.1, name="other", role="held-out")
    return log_experiment(robot, replace(first, windows=((0, 1200), (1500, 3000))), other)


# Predictions.


def test_the_errors_of_idim_ls_are_those_of_the_fit(two_windows: Experiment) -> None:
    for delay in (0.0, 1.5):
        fit = identify(two_windows, IDIMLS(compensate_samples=delay))
        found = predict(fit, two_windows)
        assert [item.recording for item in found] == ["first", "first"]
        np.testing.assert_allclose(relative_errors(found), fit.relative_error, rtol=1e-9)
        residual = np.concatenate([item.residual for item in found])
        assert np.linalg.norm(residual) == pytest.approx(fit.error_norm, rel=1e-9)
        (other,) = predict(fit, two_windows, role="held-out")
        np.testing.assert_allclose(relative_errors([other]), fit.held_out[0].relative_error, rtol=1e-9)
    assert len(predict(fit, two_windows, role="all")) == 3


def test_settings_of_the_fit_or_of_the_experiment(direct: Identification, arm: Experiment) -> None:
    signal = SignalProcessing(cutoff_hz=20.0, trim_start=50, decimation=(4,))
    fit = identify(arm, IDIMLS(signal=signal))
    (item,) = predict(fit, arm)
    np.testing.assert_allclose(relative_errors([item]), fit.relative_error, rtol=1e-9)
    found = predict(fit, arm, as_fitted=False, motion="measured")
    assert len(found[0].t) != len(item.t)
    # A validation has the filters of the result.
    checked = validate(fit, arm).recordings[0].direct
    assert checked is not None
    np.testing.assert_allclose(relative_errors([item]), checked, rtol=1e-9)


def test_the_times_are_those_of_the_rows(two_windows: Experiment) -> None:
    """A torque that is the time itself comes out of the decimation as it is, but for the ripple of its filter in both passes."""
    gain = 10.0 ** (-2.0 * DECIMATION_RIPPLE_DB / 20.0)
    fit = identify(two_windows)
    recording = two_windows.recordings[0]
    clock = np.repeat(recording.t[:, None], 2, axis=1)
    for convention in ("scipy", "matlab"):
        signal = replace(two_windows.signal, decimation_convention=convention, trim_start=33)
        ticking = replace(two_windows, recordings=(replace(recording, tau=clock),), signal=signal)
        for item in predict(replace(fit, settings={}), ticking):
            np.testing.assert_allclose(item.measured[5:-5, 0], gain * item.t[5:-5], atol=5e-4)
            assert np.all(np.diff(item.t) > 0.0)


def test_didim_predicts_along_the_simulated_motion(closed: Identification, arm: Experiment) -> None:
    (item,) = predict(closed, arm)
    assert item.motion == "simulated"
    np.testing.assert_allclose(relative_errors([item]), closed.relative_error, rtol=1e-3)
    (measured,) = predict(closed, arm, motion="measured")
    assert not np.allclose(measured.predicted, item.predicted, rtol=1e-6)


def test_cloe_compares_the_torques_as_they_are(arm: Experiment) -> None:
    fit = identify(arm, CLOE(start="reference", max_iterations=2))
    (item,) = predict(fit, arm)
    assert len(item.t) == len(arm.recordings[0].t) - 50
    assert item.noise_correlation is None
    np.testing.assert_allclose(relative_errors([item]), fit.relative_error, rtol=1e-6)


def test_what_cannot_be_predicted(closed: Identification, arm: Experiment) -> None:
    (recording,) = arm.recordings
    with pytest.raises(FitError, match="recording 'log 1' has no torques to compare with"):
        predict(closed, replace(arm, recordings=(replace(recording, tau=None),)))
    with pytest.raises(FitError, match="experiment 'arm' has no recording with role 'held-out'"):
        predict(closed, arm, role="held-out")
    other = replace(arm, robot=didim.load_robot("emps"), recordings=(), simulation=SimulationSettings())
    with pytest.raises(
        FitError,
        match="the result is for robot 'planar2' with 28 parameters, the experiment for 'emps' with 14",
    ):
        predict(closed, other)
    light = replace(closed, beta=1e-4 * closed.beta, parameters=1e-4 * closed.parameters)
    with pytest.raises(FitError, match="recording 'log 1': the simulation diverged at "):
        predict(light, arm)


def test_autocorrelation() -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(20_000)
    smooth = np.convolve(noise, [1.0, 0.5], mode="valid")  # correlation 0.5 / 1.25 at lag 1, none beyond
    found = autocorrelation([smooth[:12_000], smooth[12_000:]], 3)
    np.testing.assert_allclose(found, [1.0, 0.4, 0.0, 0.0], atol=0.03)
    assert np.isnan(autocorrelation([np.zeros(5)], 2)).all()
    # Windows are not glued together: two blocks of opposite sign have no pair across the gap.
    np.testing.assert_allclose(autocorrelation([np.ones(4), -np.ones(4)], 1), [1.0, 6.0 / 8.0])


# Frames.


@settings(max_examples=50)
@given(robot=robots(coupled=False), seed=st.integers(0, 2**32 - 1))
def test_frames_are_those_of_pinocchio(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = pinocchio_model(robot, random_parameters(rng, robot, drive=False))
    data = model.createData()
    q = random_motion(rng, 3, robot.n_dof).q
    found = frames(robot, q)
    np.testing.assert_array_equal(found[:, 0], np.broadcast_to(np.eye(4), (3, 4, 4)))
    for k in range(3):
        pin.forwardKinematics(model, data, q[k])
        for joint in range(robot.n_dof):
            np.testing.assert_allclose(found[k, joint + 1], data.oMi[joint + 1].homogeneous, atol=1e-12)


def test_frames_of_the_wrong_positions() -> None:
    robot = didim.load_robot("planar2")
    with pytest.raises(
        ShapeError, match=r"q must have shape \(n_samples, 2\) for robot 'planar2', got \(2,\)"
    ):
        frames(robot, [0.0, 0.0])
    with pytest.raises(ShapeError, match="q of joint 2 is nan at sample 0"):
        frames(robot, [[0.0, np.nan]])


# Pictures.


def panels(figure: Figure) -> list[Any]:
    return list(figure.axes)


def test_torques(closed: Identification, arm: Experiment) -> None:
    figure = plot.torques(closed, arm)
    (item,) = predict(closed, arm)
    axes = panels(figure)
    assert len(axes) == 4
    for joint in range(2):
        upper, lower = axes[2 * joint], axes[2 * joint + 1]
        measured, model = upper.get_lines()
        np.testing.assert_array_equal(measured.get_xdata(), item.t)
        np.testing.assert_array_equal(measured.get_ydata(), item.measured[:, joint])
        np.testing.assert_array_equal(model.get_ydata(), item.predicted[:, joint])
        np.testing.assert_array_equal(lower.get_lines()[0].get_ydata(), item.residual[:, joint])
        assert upper.get_title(loc="left") == f"joint {joint + 1}"
        shown = float(upper.get_title(loc="right").removeprefix("difference ").removesuffix(" %"))
        assert shown == pytest.approx(100.0 * closed.relative_error[joint], rel=0.05)
        assert upper.get_ylabel() == "torque (N.m)"
        (band,) = lower.collections
        ends = np.asarray(band.get_paths()[0].vertices)[:, 1]
        low, high = item.interval()
        half = 0.5 * (high - low)[:, joint]
        assert ends.max() == pytest.approx(half.max())
        assert ends.min() == pytest.approx(-half.max())
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "measured",
        "simulated",
        "difference",
    ]


def test_recordings_stand_one_after_the_other(two_windows: Experiment) -> None:
    fit = identify(two_windows)
    both = predict(fit, two_windows, role="all")
    axes = panels(plot.torques(fit, two_windows, predictions=both))
    t, y = (np.asarray(values) for values in axes[0].get_lines()[0].get_data())
    gaps = np.flatnonzero(np.isnan(t))
    np.testing.assert_array_equal(gaps, [len(both[0].t), len(both[0].t) + 1 + len(both[1].t)])
    np.testing.assert_array_equal(t[: gaps[0]], both[0].t)
    assert np.all(np.diff(t[~np.isnan(t)]) >= 0.0)
    np.testing.assert_array_equal(y[gaps[1] + 1 :], both[2].measured[:, 0])
    assert "one recording after the other" in axes[1].get_xlabel()


def slide() -> Experiment:
    """A carriage with 100 N of noise."""
    robot = didim.load_robot("emps")
    x = robot.parameter_set("published")
    return log_experiment(robot, simulated_log(robot, x, noise=100.0))


def test_units_of_a_simulated_slide() -> None:
    experiment = slide()
    fit = identify(experiment)
    axes = panels(plot.torques(fit, experiment))
    (error,) = relative_errors(predict(fit, experiment))
    assert axes[0].get_ylabel() == "force (N)"
    assert axes[0].get_title(loc="right") == f"difference {100.0 * error:.2g} %"
    assert 0.001 < error < 0.1


def test_units_of_a_prismatic_joint(project: Any, shared: Any) -> None:
    experiment = didim.load_experiment(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    fit = identify(experiment)
    axes = panels(plot.torques(fit, experiment))
    assert axes[0].get_ylabel() == "force (N)"
    assert axes[0].get_title(loc="right") == "difference 4.1 %"
    np.testing.assert_allclose(relative_errors(predict(fit, experiment)), [0.0408336], atol=1e-7)


def test_residuals(closed: Identification, arm: Experiment) -> None:
    (item,) = predict(closed, arm)
    axes = panels(plot.residuals(closed, arm))
    for joint in range(2):
        upper, lower = axes[2 * joint], axes[2 * joint + 1]
        bars = next(part for part in upper.collections if len(part.get_segments()) > 1)
        heights = np.array([segment[1, 1] for segment in bars.get_segments()])
        expected = autocorrelation([item.residual[:, joint]], 40)[1:]
        np.testing.assert_allclose(heights, expected)
        band = upper.patches[0].get_extents().transformed(upper.transData.inverted())
        np.testing.assert_allclose([band.y0, band.y1], np.array([-1.96, 1.96]) / np.sqrt(len(item.t)))
        correlation = noise_correlation(arm.signal)
        assert correlation is not None
        np.testing.assert_allclose(upper.get_lines()[0].get_ydata(), correlation[1:41])
        area = sum(patch.get_width() * patch.get_height() for patch in lower.patches)
        assert area == pytest.approx(1.0)
        sigma = item.residual[:, joint].std()
        assert lower.get_lines()[0].get_ydata().max() == pytest.approx(
            1.0 / (sigma * np.sqrt(2 * np.pi)), rel=0.01
        )
        assert f"{sigma:.3g}" in lower.get_xlabel()


def test_correlation(closed: Identification) -> None:
    axes = panels(plot.correlation(closed))[0]
    shown = np.asarray(axes.images[0].get_array())
    np.testing.assert_allclose(np.diag(shown), 1.0)
    covariance = shown * np.outer(closed.std, closed.std)
    np.testing.assert_allclose(covariance, closed.covariance, atol=1e-12)
    assert [label.get_text() for label in axes.get_yticklabels()] == list(closed.names)


def test_fixed_parameters_have_no_correlation(arm: Experiment) -> None:
    fit = identify(arm, IDIMLS(fixed={"Fc1": 0.5}))
    axes = panels(plot.correlation(fit))[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == [n for n in fit.names if n != "Fc1"]
    drawn = panels(plot.parameters(fit))[0]
    assert [text.get_text() for text in drawn.texts] == ["fixed"]
    assert len(drawn.patches) == len(fit.names) - 1


def test_convergence(closed: Identification, direct: Identification) -> None:
    left, right = panels(plot.convergence({"IDIM-LS": direct, "DIDIM": closed}))
    for line_drawn, fit in zip(left.get_lines(), (direct, closed), strict=True):
        errors = [100.0 * item.relative_error for item in fit.history]
        np.testing.assert_array_equal(line_drawn.get_ydata(), errors)
    np.testing.assert_array_equal(right.get_lines()[1].get_xdata(), range(1, closed.n_iterations + 1))
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["IDIM-LS", "DIDIM"]


def test_intervals_of_one_result(closed: Identification) -> None:
    axes = panels(plot.parameters(closed))[0]
    ends = np.array([bar.get_x() + bar.get_width() for bar in axes.patches])
    half = closed.interval_factor() * closed.relative_std_percent
    np.testing.assert_allclose(ends, np.clip(half, 0.01, 1000.0))
    well = np.array([bar.get_hatch() is None for bar in axes.patches])
    np.testing.assert_array_equal(well, closed.relative_std_percent <= 20.0)


def test_standardised_parameters(closed: Identification, arm: Experiment) -> None:
    """The dots are the parameters times the torque that their columns of W make, worked out here from W itself."""
    (item,) = found = predict(closed, arm)
    axes = panels(plot.parameters(closed, experiment=arm, predictions=found))[0]
    dots = [(x, y) for drawn in axes.get_lines()[1:] for x, y in zip(*drawn.get_data(), strict=True)]
    shown = np.array([x for x, _ in sorted(dots, key=lambda dot: dot[1])])
    assert item.sizes is not None
    torque = np.sqrt(np.mean(item.measured**2, axis=0))
    expected = 100.0 * closed.beta * (item.sizes / torque[:, None]).max(axis=0)
    np.testing.assert_allclose(shown, expected, rtol=1e-12)
    # A parameter that acts alone explains as much as the torque falls without it.
    offset = closed.names.index("Fv2")
    alone = item.predicted - predict(without(closed, offset), arm, motion="simulated")[0].predicted
    np.testing.assert_allclose(
        np.sqrt(np.mean(alone[:, 1] ** 2)), abs(closed.beta[offset]) * item.sizes[1, offset], rtol=0.2
    )
    drawn = [segment[:, 0] for part in axes.collections for segment in part.get_segments()]
    half = 0.5 * np.array([high - low for low, high in drawn])
    scale = (item.sizes / torque[:, None]).max(axis=0)
    np.testing.assert_allclose(
        np.sort(half), np.sort(100.0 * closed.interval_factor() * closed.std * scale), rtol=1e-9
    )


def test_motion_and_its_limits(arm: Experiment) -> None:
    (recording,) = arm.recordings
    robot = replace(arm.robot, limits=(JointLimits(position=(-4.0, 4.0), velocity=10.0), JointLimits()))
    late = replace(recording, t=recording.t + 7.0)
    axes = panels(plot.motion(replace(arm, robot=robot, recordings=(late,))))
    assert len(axes) == 4
    t, q = (np.asarray(values) for values in axes[0].get_lines()[0].get_data())
    assert 0.0 <= t[0] < 0.2
    assert axes[1].get_xlim()[0] == 0.0
    kept = slice(arm.signal.trim_start, len(late.t) - arm.signal.trim_end)
    assert np.abs(q).max() == pytest.approx(np.abs(recording.q[kept, 0]).max(), rel=0.01)
    assert [drawn.get_ydata()[0] for drawn in axes[0].get_lines()[1:]] == [-4.0, 4.0]
    used = 100.0 * np.ptp(recording.q[kept, 0]) / 8.0
    text = axes[0].get_title(loc="right")
    assert float(text.split()[1]) == pytest.approx(used, abs=1.0)
    assert axes[2].get_title(loc="right") == "no limits known"
    with pytest.raises(PlotError, match="has no positions to draw"):
        plot.motion(replace(arm, recordings=()))


def test_spectra(closed: Identification, arm: Experiment) -> None:
    (item,) = predict(closed, arm)
    rate = 1.0 / float(item.t[1] - item.t[0])
    # A ripple of 0.3 N.m at a fifth of the rate stands out at its frequency, with its power.
    ripple = 0.3 * np.sin(2.0 * np.pi * 0.2 * rate * item.t)
    rough = replace(item, measured=item.measured + ripple[:, None])
    axes = panels(plot.spectra(closed, arm, predictions=[rough]))
    f, density = (np.asarray(values) for values in axes[0].get_lines()[1].get_data())
    assert f[np.argmax(density)] == pytest.approx(0.2 * rate, abs=2.0 * f[0])
    power = float(np.sum(density**2) * (f[1] - f[0]))
    assert power == pytest.approx(float(np.mean(rough.residual[:, 0] ** 2)), rel=0.2)
    with pytest.raises(PlotError, match="too short for spectra"):
        plot.spectra(closed, arm, predictions=[replace(item, t=item.t[:20])])


def without(fit: Identification, index: int) -> Identification:
    """Result whose base parameter is zero, and the standard parameter that it is alone."""
    parameters = np.array(fit.parameters)
    parameters[list(fit.parameter_names).index(fit.names[index])] = 0.0
    return replace(fit, parameters=parameters)


def test_deviations_from_the_truth(closed: Identification, direct: Identification, arm: Experiment) -> None:
    truth = arm.robot.set_base("reference")
    axes = panels(plot.parameters({"a": direct, "b": closed}, truth=truth))[0]
    points = {item.get_label(): item for item in axes.get_lines() if item.get_label() in ("a", "b")}
    for name, fit in (("a", direct), ("b", closed)):
        off = (fit.beta - truth) / fit.std
        np.testing.assert_allclose(points[name].get_xdata(), np.clip(off, -8.0, 8.0))


def test_methods_beside_each_other(closed: Identification, direct: Identification) -> None:
    axes = panels(plot.parameters({"a": direct, "b": closed}))[0]
    points = {item.get_label(): item for item in axes.get_lines() if item.get_label() in ("a", "b")}
    np.testing.assert_allclose(points["a"].get_xdata(), 0.0, atol=1e-12)
    off = (closed.beta - direct.beta) / direct.std
    np.testing.assert_allclose(points["b"].get_xdata(), np.clip(off, -8.0, 8.0))
    bars = [np.asarray(part.get_segments())[:, :, 0] for part in axes.collections]
    np.testing.assert_allclose(
        bars[1][:, 1] - bars[1][:, 0], 2 * closed.interval_factor() * closed.std / direct.std
    )


def test_overlay(closed: Identification, arm: Experiment) -> None:
    (recording,) = arm.recordings
    simulation = simulate_window(closed.parameters, arm, recording, (0, len(recording.q)))
    shown = validate(closed, arm).recordings[0].simulated["position"]
    for quantity, unit in (("q", "position (rad)"), ("tau", "torque (N.m)")):
        axes = panels(plot.overlay(simulation, recording, experiment=arm, quantity=quantity))  # type: ignore[arg-type]
        assert axes[0].get_ylabel() == unit
        difference = axes[1].get_lines()[0]
        t, values = thin(recording.t, (getattr(recording, quantity) - getattr(simulation, quantity))[:, 0])
        np.testing.assert_array_equal(difference.get_xdata(), t)
        np.testing.assert_array_equal(difference.get_ydata(), values)
    assert np.all(shown < 1e-3)  # the run is that of `validate`
    with pytest.raises(PlotError, match="recording 'log 1' has 1991 samples from sample 10 on"):
        plot.overlay(simulation, recording, experiment=arm, start=10)
    with pytest.raises(PlotError, match="recording 'log 1' has no torques to draw"):
        plot.overlay(simulation, replace(recording, tau=None), experiment=arm, quantity="tau")


def test_robot(arm: Experiment) -> None:
    q = np.array([0.3, -1.1])
    axes = panels(plot.robot(arm.robot, q))[0]
    skeleton = next(item for item in axes.get_lines() if item.get_linewidth() == 5.0)
    corners = np.array(skeleton.get_data_3d()).T
    np.testing.assert_allclose(corners[-1], frames(arm.robot, q[None])[0, -1, :3, 3])
    # The links are as long as the rows say.
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    geometry = arm.robot.geometry
    np.testing.assert_allclose(lengths, np.ravel(np.column_stack([geometry.d, geometry.r])), atol=1e-12)
    assert [text.get_text() for text in axes.texts] == ["1", "2"]
    motion = arm.recordings[0].q
    axes = panels(plot.robot(arm.robot, motion=motion))[0]
    (way,) = [item for item in axes.get_lines() if item.get_label() == "path of the last frame"]
    np.testing.assert_allclose(np.array(way.get_data_3d())[:, 0], frames(arm.robot, motion[:1])[0, -1, :3, 3])
    with pytest.raises(PlotError, match=r"q must have shape \(2,\) for robot 'planar2', got \(3,\)"):
        plot.robot(arm.robot, [0.0, 0.0, 0.0])


def test_what_cannot_be_drawn(closed: Identification, direct: Identification) -> None:
    blind = replace(closed, covariance=np.zeros_like(closed.covariance))
    with pytest.raises(PlotError, match="the result by didim has no covariance, and so no correlations"):
        plot.correlation(blind)
    with pytest.raises(PlotError, match="no result has a covariance, and so no intervals"):
        plot.parameters(blind)
    with pytest.raises(PlotError, match="there is no history to draw"):
        plot.convergence(replace(closed, history=()))
    with pytest.raises(PlotError, match=r"truth must have shape \(\d+,\), got \(3,\)"):
        plot.parameters(closed, truth=[1.0, 2.0, 3.0])
    other = replace(direct, names=tuple(f"{name}x" for name in direct.names))
    with pytest.raises(PlotError, match="results of different base parameters cannot stand in one picture"):
        plot.parameters({"a": closed, "b": other})


def test_a_long_line_keeps_its_extremes() -> None:
    rng = np.random.default_rng(1)
    t, y = np.arange(50_003.0), rng.standard_normal(50_003)
    y[[31, 40_000, 50_002]] = [50.0, -60.0, 70.0]
    short_t, short_y = thin(t, y)
    assert len(short_t) < 1.5 * MOST_POINTS
    assert np.all(np.diff(short_t) > 0.0)
    np.testing.assert_array_equal(short_y, y[short_t.astype(int)])
    assert {50.0, -60.0, 70.0} <= set(short_y)
    np.testing.assert_array_equal(thin(t[:1000], y[:1000])[1], y[:1000])
    axes = Figure().add_subplot()
    line(axes, [(t[:3], y[:3]), (t[5:7], y[5:7])])
    assert np.isnan(np.asarray(axes.get_lines()[0].get_ydata())[3])


def test_nothing_of_the_caller_is_touched_and_svg_is_reproducible(
    closed: Identification, arm: Experiment
) -> None:
    before = dict(matplotlib.rcParams)
    texts = [plot.svg(plot.residuals(closed, arm)) for _ in range(2)]
    assert texts[0] == texts[1]
    assert "dc:date" not in texts[0]
    assert dict(matplotlib.rcParams) == before


def test_a_missing_matplotlib_is_one_sentence(
    closed: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name.split(".")[0] == "matplotlib":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(PlotError, match=r"^pictures and reports need matplotlib: pip install didim\[plot\]$"):
        plot.convergence(closed)


@pytest.mark.slow
def test_import_didim_loads_no_matplotlib_and_pictures_no_pyplot() -> None:
    code = (
        "import sys, didim; assert 'didim.plot' not in sys.modules; didim.plot.torques; didim.report.write; "
        "assert not any(name.startswith('matplotlib') for name in sys.modules); "
        "didim.plot.svg(didim.plot.robot(didim.load_robot('tx40'))); assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    with pytest.raises(AttributeError, match="module 'didim' has no attribute 'plots'"):
        didim.plots  # type: ignore[attr-defined]  # noqa: B018
