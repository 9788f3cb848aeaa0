"""IDIM-LS on simulated logs: exact without noise, several recordings, fixed parameters, messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import simulated
from didim.errors import FitError, RankError, SignalError
from didim.log.recording import Recording
from didim.methods.identify import identify
from didim.methods.idim_ls import IDIMLS
from didim.methods.table import METHODS, method_class
from didim.result.iteration import Iteration, Status
from didim.robot.robot import Robot
from didim.robot.robot_file import load_robot
from didim.signal.processing import SignalProcessing

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("planar2")


@pytest.fixture(scope="module")
def x(robot: Robot) -> Array:
    return np.asarray(robot.sets["reference"])


@pytest.fixture(scope="module")
def truth(robot: Robot, x: Array) -> Array:
    return np.asarray(robot.base_parameters.project(x))


def value(robot: Robot, beta: Array, name: str) -> float:
    return float(beta[robot.base_parameters.names.index(name)])


@pytest.mark.parametrize("weights", ["none", "per-joint"])
@pytest.mark.parametrize("name", ["planar2", "tx40"])
def test_a_log_without_noise_gives_the_parameters_back(name: str, weights: str) -> None:
    robot = load_robot(name)
    x = np.asarray(robot.sets["didim" if name == "tx40" else "reference"])
    fit = identify(
        simulated.experiment(robot, simulated.log(robot, x)),
        IDIMLS(weights="none" if weights == "none" else "per-joint"),
    )
    base = robot.base_parameters
    # Ten digits of the largest parameter, on every parameter.
    np.testing.assert_allclose(fit.beta, base.project(x), rtol=0, atol=1e-9)
    np.testing.assert_allclose(base.project(fit.parameters), fit.beta, atol=1e-12)
    assert fit.status is Status.SOLVED
    assert fit.names == base.names
    assert fit.parameter_names == robot.parameter_names
    assert fit.overall_relative_error < 1e-9
    assert fit.n_simulations == 0
    assert fit.elapsed > 0.0


def test_rows_are_joint_by_joint_across_recordings(robot: Robot, x: Array) -> None:
    one, two = (simulated.log(robot, x, seed=seed, noise=0.3, name=f"run {seed}") for seed in (1, 2))
    # Swapping the recordings moves rows within a joint, which changes nothing but rounding.
    first = identify(simulated.experiment(robot, one, two))
    second = identify(simulated.experiment(robot, two, one))
    np.testing.assert_allclose(first.beta, second.beta, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(first.relative_error, second.relative_error, rtol=1e-9)
    alone = identify(simulated.experiment(robot, one))
    assert first.n_rows == 2 * alone.n_rows
    assert np.all(first.std_white < alone.std_white)


def test_windows_leave_the_rest_out(robot: Robot, x: Array) -> None:
    spoiled = simulated.log(robot, x, n_samples=4000)
    assert spoiled.tau is not None
    tau = spoiled.tau.copy()
    tau[1500:2000] = 1e3
    # Each window is filtered by itself: its torques are the model's only inside, away from its edges.
    windows = ((0, 1500), (2000, 4000))
    cut = replace(spoiled, tau=tau, windows=windows)
    signal = replace(simulated.SIGNAL, trim_start=200, trim_end=200)
    fit = identify(simulated.experiment(robot, cut, signal=signal))
    whole = identify(simulated.experiment(robot, replace(spoiled, tau=tau), signal=signal))
    assert fit.overall_relative_error < 1e-5
    assert whole.overall_relative_error > 0.5
    assert fit.settings["recordings"][0]["windows"] == [[0, 1500], [2000, 4000]]


def test_held_out_recordings_are_predicted_and_not_fitted(robot: Robot, x: Array) -> None:
    fitted = simulated.log(robot, x, seed=1, noise=0.3)
    held = simulated.log(robot, x, seed=2, noise=0.3, name="night", role="held-out")
    fit = identify(simulated.experiment(robot, fitted, held))
    alone = identify(simulated.experiment(robot, fitted))
    np.testing.assert_array_equal(fit.beta, alone.beta)
    assert alone.held_out == ()
    (night,) = fit.held_out
    assert night.name == "night"
    np.testing.assert_allclose(night.relative_error, fit.relative_error, rtol=0.5)
    wrong = simulated.log(robot, 2.0 * x, seed=2, name="heavy", role="held-out")
    (heavy,) = identify(simulated.experiment(robot, fitted, wrong)).held_out
    assert heavy.overall_relative_error == pytest.approx(0.5, abs=0.05)


def test_fixed_and_dropped_parameters(robot: Robot, x: Array, truth: Array) -> None:
    log = simulated.log(robot, x, noise=0.1)
    exact = value(robot, truth, "Fv1")
    fit = identify(simulated.experiment(robot, log), IDIMLS(fixed={"Fv1": exact}, dropped=["Off2"]))
    assert value(robot, fit.beta, "Fv1") == exact
    assert value(robot, fit.beta, "Off2") == 0.0
    assert value(robot, fit.std, "Fv1") == 0.0
    assert dict(zip(fit.names, fit.roles, strict=True)) == {
        name: {"Fv1": "fixed", "Off2": "dropped"}.get(name, "estimated") for name in fit.names
    }
    others = [k for k, role in enumerate(fit.roles) if role == "estimated"]
    # Off2 = -0.05 N.m was dropped, which Fc2 and MX2 hardly notice.
    np.testing.assert_allclose(fit.beta[others], truth[others], atol=0.05)
    assert np.all(fit.std[others] > 0.0)
    free = identify(simulated.experiment(robot, log))
    assert value(robot, fit.std, "Fc1") < value(robot, free.std, "Fc1")
    # The errors are those of the measured torque, not of what the fixed parameter leaves of it.
    assert fit.relative_error[0] == pytest.approx(free.relative_error[0], rel=0.05)
    text = str(fit)
    assert "fixed" in text
    assert "dropped" in text


def test_the_experiment_names_fixed_parameters_and_the_method_overrides_them(robot: Robot, x: Array) -> None:
    exp = replace(
        simulated.experiment(robot, simulated.log(robot, x)), fixed={"Off1": 0.5}, dropped=("Off2",)
    )
    fit = identify(exp)
    assert value(robot, fit.beta, "Off1") == 0.5
    assert fit.settings["fixed"] == {"Off1": 0.5}
    free = identify(exp, IDIMLS(fixed={}, dropped=()))
    assert set(free.roles) == {"estimated"}


def test_settings_of_the_method_override_those_of_the_experiment(robot: Robot, x: Array) -> None:
    exp = simulated.experiment(robot, simulated.log(robot, x, noise=0.2))
    fit = identify(exp, IDIMLS(reweightings=3, variance="r-1", uncertainty="white"))
    assert fit.settings["least_squares"] == {
        "weights": "per-joint",
        "reweightings": 3,
        "variance": "r-1",
        "uncertainty": "white",
        "blocks": 20,
        "physical": None,
    }
    assert len(fit.history) == 4
    raw = identify(exp, IDIMLS(signal=SignalProcessing(cutoff_hz=40.0)))
    assert raw.settings["signal"]["decimation"] == []
    assert raw.n_rows == 2 * 3000


@pytest.mark.parametrize(
    ("fixed", "dropped", "message"),
    [
        ({"Fv9": 1.0}, (), "robot 'planar2' has no base parameter Fv9; did you mean 'Fv"),
        ({"quux": 1.0}, (), "robot 'planar2' has no base parameter quux; `didim base planar2` lists them"),
        ({"YY1": 1.0}, (), "YY1 of robot 'planar2' has no effect on the torques"),
        ({"ZZ1": 1.0}, (), "ZZ1 is a standard parameter of robot 'planar2' that regroups into ZZ1R"),
        ({}, ("M2",), "M2 is a standard parameter .* that regroups into ZZ1R, MX1R"),
        ({"Fv1": "1.2"}, (), "fixed parameter Fv1 must have a finite value, got '1.2'"),
        ({"Fv1": float("nan")}, (), "fixed parameter Fv1 must have a finite value, got nan"),
        ({"Fv1": 1.0}, ("Fv1",), "parameter Fv1 is both fixed and dropped"),
    ],
)
def test_wrong_names(
    robot: Robot, x: Array, fixed: dict[str, Any], dropped: tuple[str, ...], message: str
) -> None:
    with pytest.raises(FitError, match=message):
        identify(simulated.experiment(robot, simulated.log(robot, x)), IDIMLS(fixed=fixed, dropped=dropped))


def test_a_joint_at_rest_is_named(robot: Robot, x: Array) -> None:
    q = simulated.motion(2, 3000)
    q[:, 1] = 0.3
    log = Recording.from_arrays(q, np.ones_like(q), rate_hz=simulated.RATE_HZ)
    with pytest.raises(RankError, match=r"the log does not separate .*Fv2") as caught:
        identify(simulated.experiment(robot, log))
    assert "\n" not in str(caught.value)


def test_a_rank_deficient_log_can_be_rescued_by_dropping_what_it_does_not_excite(
    robot: Robot, x: Array
) -> None:
    q = simulated.motion(2, 3000)
    q[:, 1] = 0.3
    log = Recording.from_arrays(q, np.ones_like(q), rate_hz=simulated.RATE_HZ)
    names = [name for name in robot.base_parameters.names if name not in ("ZZ1R", "Fv1", "Fc1", "Off1")]
    fit = identify(simulated.experiment(robot, log), IDIMLS(dropped=names))
    assert fit.roles.count("estimated") == 4


@pytest.mark.parametrize(
    ("logs", "signal", "message"),
    [
        ([{"tau": None}], {}, "recording 'log' has no torques"),
        ([{"role": "held-out"}], {}, "experiment 'simulated' has no recording with role 'fit'"),
        ([{}], {"trim_start": 2000, "trim_end": 2000}, "recording 'log': trimming 2000 and 2000 samples leaves nothing"),
        ([{}], {"edge_rows": 300}, "recording 'log': decimation leaves nothing of 2950 samples"),
        ([{}, {"tau": np.full((3000, 2), 1e200), "role": "held-out", "name": "night"}], {},
         "^recording 'night': the torques of joint 1 are too large to be squared"),
    ],
)  # fmt: skip
def test_logs_that_leave_nothing_to_fit(
    robot: Robot, x: Array, logs: list[dict[str, Any]], signal: dict[str, Any], message: str
) -> None:
    recordings = [replace(simulated.log(robot, x), **changes) for changes in logs]
    with pytest.raises(FitError, match=message):
        identify(simulated.experiment(robot, *recordings, signal=replace(simulated.SIGNAL, **signal)))


def test_errors_of_the_filters_name_recording_and_window(robot: Robot, x: Array) -> None:
    log = simulated.log(robot, x, name="night")
    short = replace(log, windows=((0, 1500), (2000, 2010)))
    message = (
        r"^recording 'night', window of samples 2000 to 2010: the zero-phase filter of order 4 needs more"
    )
    with pytest.raises(SignalError, match=message):
        identify(simulated.experiment(robot, short))
    message = (
        r"^recording 'night', window of samples 2000 to 2070: decimation by 5 needs more than 27 samples"
    )
    with pytest.raises(SignalError, match=message):
        identify(simulated.experiment(robot, replace(log, windows=((0, 1500), (2000, 2070)))))
    message = r"^recording 'night': a record of 3000 samples is too short to compensate a delay of 5000"
    with pytest.raises(FitError, match=message):
        identify(simulated.experiment(robot, log), IDIMLS(compensate_samples=5000.0))


def test_wrong_settings_are_told_when_they_are_made() -> None:
    with pytest.raises(FitError, match="reweightings must be a whole number from 0 to 1000"):
        IDIMLS(reweightings=-2)
    with pytest.raises(
        FitError, match="compensate_samples must be a number, one per joint, 'hold' or 'estimate', got nan"
    ):
        IDIMLS(compensate_samples=float("nan"))
    with pytest.raises(FitError, match=r"^dropped must be a list of parameter names, got 'Off1'$"):
        IDIMLS(dropped="Off1")
    with pytest.raises(FitError, match="dropped must be a list of parameter names, got \\[1\\]"):
        IDIMLS(dropped=[1])  # type: ignore[list-item]


def test_the_callback_hears_every_iteration_and_stops(robot: Robot, x: Array) -> None:
    exp = simulated.experiment(robot, simulated.log(robot, x, noise=0.2))
    heard: list[Iteration] = []
    fit = identify(exp, callback=heard.append)
    assert tuple(heard) == fit.history
    assert [item.iteration for item in heard] == [1, 2]
    assert heard[0].step == pytest.approx(1.0)
    assert 0.0 < heard[1].step < 0.5
    assert heard[-1].relative_error == fit.overall_relative_error
    stopped = identify(exp, callback=lambda iteration: True)
    assert stopped.status is Status.STOPPED
    assert not stopped.converged
    np.testing.assert_array_equal(stopped.beta, identify(exp, IDIMLS(weights="none")).beta)


def test_verbose_tells_on_stderr(robot: Robot, x: Array, capsys: pytest.CaptureFixture[str]) -> None:
    exp = simulated.experiment(robot, simulated.log(robot, x))
    identify(exp)
    assert capsys.readouterr() == ("", "")
    identify(exp, verbose=True)
    told = capsys.readouterr()
    assert told.out == ""
    assert "iteration 2: relative error" in told.err
    assert all(line.startswith("idim-ls: ") for line in told.err.splitlines())


def test_an_ill_conditioned_log_is_no_success(robot: Robot, x: Array) -> None:
    # Joint 2 trembles by a nanometre or so: full rank in floating point, and worth nothing.
    q = simulated.motion(2, 3000)
    q[:, 1] = 0.3 + 1e-13 * q[:, 1]
    log = Recording.from_arrays(q, np.ones_like(q), rate_hz=simulated.RATE_HZ)
    try:
        fit = identify(simulated.experiment(robot, log))
    except RankError:
        return
    assert fit.status is Status.ILL_CONDITIONED
    assert not fit.converged


def test_methods_by_name() -> None:
    for name in METHODS:
        assert method_class(name)().name.startswith(name)


def test_rows_at_the_ends_of_each_decimated_window_are_left_out(robot: Robot, x: Array, truth: Array) -> None:
    """There the torque noise of a single sample counts as that of forty (``test_signals.py``)."""
    log = simulated.log(robot, x)
    windows = replace(log, windows=((0, 1500), (1500, 3000)))
    assert simulated.SIGNAL.edge_rows == 2
    # 25 samples are trimmed at each end, every fifth of the others is kept, and two rows less at each end.
    for recording, rows in ((log, 590 - 4), (windows, 2 * (290 - 4))):
        fit = identify(simulated.experiment(robot, recording))
        assert fit.n_rows == robot.n_dof * rows
        assert fit.settings["signal"]["edge_rows"] == 2
        # The torques of a window are the model's only inside it.
        np.testing.assert_allclose(fit.beta, truth, atol=1e-9 if recording is log else 1e-3)
    signal = replace(simulated.SIGNAL, edge_rows=0)
    assert identify(simulated.experiment(robot, windows, signal=signal)).n_rows == robot.n_dof * 2 * 290
    raw = replace(simulated.SIGNAL, decimation=())
    assert identify(simulated.experiment(robot, log, signal=raw)).n_rows == robot.n_dof * 2950


def test_a_spike_at_the_first_kept_sample_does_not_count(robot: Robot, x: Array) -> None:
    log = simulated.log(robot, x, noise=0.1)
    assert log.tau is not None
    tau = log.tau.copy()
    tau[simulated.SIGNAL.trim_start] += 1.0
    spoilt = replace(log, tau=tau)
    moved = {}
    for edge_rows in (0, 2):
        signal = replace(simulated.SIGNAL, edge_rows=edge_rows)
        fits = [identify(simulated.experiment(robot, one, signal=signal)) for one in (log, spoilt)]
        moved[edge_rows] = np.max(np.abs(fits[1].beta - fits[0].beta) / fits[0].std)
    assert moved[2] < 0.1 * moved[0]


def test_the_file_and_the_choice_of_laws_ask_for_a_robot(robot: Robot, x: Array) -> None:
    """Laws that are chosen among parameters of a robot are solved among these, unless a file or a method says otherwise."""
    log = simulated.experiment(robot, simulated.log(robot, x))

    def solver(experiment: Any, method: Any) -> str:
        return str(identify(experiment, method).settings["solver"]["name"])

    def asked(value: bool) -> Any:
        return replace(log, least_squares=replace(log.least_squares, physical=value))

    assert solver(log, IDIMLS()) == "least-squares"
    assert solver(asked(True), IDIMLS()) == "consistent"
    assert solver(asked(True), IDIMLS(physical=False)) == "least-squares"
    assert solver(log, IDIMLS(friction="auto")) == "consistent"
    auto = replace(robot, friction=replace(robot.friction, auto=True))
    assert solver(replace(log, robot=auto), IDIMLS()) == "consistent"
    assert solver(asked(False), IDIMLS(friction="auto")) == "least-squares"
    wrong: Any
    for wrong in ("true", 1):
        with pytest.raises(FitError, match="physical must be True or False, got"):
            replace(log.least_squares, physical=wrong)
