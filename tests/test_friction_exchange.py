"""Friction parameters that exchange: the pair is marked, and friction at speeds inside the log is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import didim
from didim.errors import FitError
from didim.loop.reference import Reference
from didim.regression.friction.alarm import EXCHANGED, SHARES, FrictionAtSpeeds
from didim.report.fit import fit_page
from didim.robot.friction import FrictionTerm
from friction_logs import Law, load, logged, robot, stribeck, subject
from simulated import experiment
from test_friction_terms import log, motion, parameters, planar

pytestmark = pytest.mark.usefixtures("without_causes")

SLOW = 0.01
"""Velocity of an arctangent that is nearly a sign along the motion of the tests (rad/s)."""


def open_log(velocity: float = SLOW, seed: int = 0, *, estimated: bool = True) -> didim.Experiment:
    term = FrictionTerm(law="atan", joint=0, velocity=velocity)
    robot = planar(term)
    searched = robot.with_terms([replace(term, estimated=True, velocity=0.1)]) if estimated else robot
    return replace(log(robot, parameters(robot, Fa1=1.5), noise=0.3, seed=seed), robot=searched)


def fitted(
    velocity: float = SLOW, seed: int = 0, *, estimated: bool = True, **settings: object
) -> didim.Identification:
    return didim.identify(open_log(velocity, seed, estimated=estimated), **settings)  # type: ignore[arg-type]


def friction(fit: didim.Identification, speeds: tuple[float, ...], velocity: float) -> np.ndarray:
    """Friction of joint 1 by the formula."""
    value = dict(zip(fit.parameter_names, fit.parameters, strict=True))
    v = np.array(speeds)
    return np.asarray(value["Fv1"] * v + value["Fc1"] + value["Fa1"] * np.arctan(v / velocity))


def only(fit: didim.Identification) -> FrictionAtSpeeds:
    assert fit.uncertainty is not None
    (item,) = fit.uncertainty.at_speeds
    return item


def half(item: FrictionAtSpeeds) -> np.ndarray:
    """Half the width of the intervals."""
    return np.asarray(0.5 * np.subtract(item.high, item.low))


@pytest.mark.slow
@pytest.mark.parametrize("uncertainty", ["jackknife", "white"])
def test_friction_at_speeds_is_known_where_the_pair_is_not(uncertainty: str) -> None:
    fits = [fitted(seed=seed, uncertainty=uncertainty) for seed in range(16)]
    items = [only(fit) for fit in fits]
    (found,) = {item.parameters for item in items}
    assert found == ("Fa1", "Fc1")
    assert all(item.correlation < -EXCHANGED and not item.refused for item in items)
    _, dq, _ = motion()
    speeds = np.abs(dq[:, 0])
    np.testing.assert_allclose(items[0].speeds, np.percentile(speeds, SHARES), rtol=0.05)
    velocity = fits[0].settings["friction"]["velocities"][0]["velocity"]
    np.testing.assert_allclose(items[0].torques, friction(fits[0], items[0].speeds, velocity), rtol=1e-9)
    truth = parameters(planar(FrictionTerm(law="atan", joint=0, velocity=SLOW)), Fa1=1.5)
    names = planar(FrictionTerm(law="atan", joint=0, velocity=SLOW)).parameter_names
    value = dict(zip(names, truth, strict=True))
    z = []
    for item in items:
        v = np.array(item.speeds)
        true = value["Fv1"] * v + value["Fc1"] + 1.5 * np.arctan(v / SLOW)
        z.append((np.array(item.torques) - true) / half(item) * fits[0].interval_factor())
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3
    own = np.mean([fit.std[fit.names.index("Fc1")] for fit in fits])
    assert own * fits[0].interval_factor() > 5.0 * np.mean([half(item) for item in items])


def test_deviations_include_the_velocity() -> None:
    fit = fitted(0.3, uncertainty="white")
    (term,) = fit.settings["robot"]["friction"]["terms"]
    known = replace(open_log(0.3), robot=planar(FrictionTerm(law="atan", joint=0, velocity=term["velocity"])))
    speeds = (0.1, 0.3, 3.0)
    searched, given = (
        one.friction_at(0, speeds) for one in (fit, didim.identify(known, uncertainty="white"))
    )
    np.testing.assert_allclose(searched.torques, given.torques, rtol=1e-6)
    assert (half(searched) > 1.001 * half(given)).any()
    assert (half(searched) > 0.999 * half(given)).all()


def test_a_pair_that_the_log_tells_apart_is_not_marked() -> None:
    fit = fitted(0.3)
    assert fit.uncertainty is not None
    assert fit.uncertainty.at_speeds == ()
    assert "exchange" not in str(fit)


def test_a_velocity_that_is_refused_is_marked() -> None:
    robot = planar()
    unknown = planar(FrictionTerm(law="atan", joint=0, velocity=0.1, estimated=True))
    fit = didim.identify(replace(log(robot, parameters(robot), noise=0.05), robot=unknown))
    item = only(fit)
    assert item.refused
    assert item.parameters[0] == "Fr1"
    value = dict(zip(fit.parameter_names, parameters(robot), strict=False))
    v = np.array(item.speeds)
    assert np.abs(np.array(item.torques) - (value["Fv1"] * v + value["Fc1"])).max() < 2.0 * half(item).max()
    assert "joint 1: velocity of Fr1 unknown  N.m" in str(fit)


def test_a_velocity_below_twice_the_dead_zone_is_refused() -> None:
    term = FrictionTerm(law="atan", joint=0, velocity=0.05)
    robot = planar(term, dead_zone=0.04)
    experiment = log(robot, parameters(robot, Fa1=2.0), noise=0.02)
    open_robot = robot.with_terms([replace(term, estimated=True, velocity=0.1)])
    fit = didim.identify(replace(experiment, robot=open_robot))
    (velocity,) = fit.settings["friction"]["velocities"]
    assert not velocity["identified"]
    assert fit.uncertainty is not None
    assert [item.joint for item in fit.uncertainty.at_speeds if item.refused] == [0]


@pytest.mark.usefixtures("without_drawing")
def test_the_pair_is_printed_and_saved(tmp_path: Path) -> None:
    fit = fitted()
    item = only(fit)
    marked = [line for line in str(fit).splitlines() if line.endswith("exchanges")]
    assert [line.split()[0] for line in marked] == ["Fc1", "Fa1"]
    assert "joint 1: Fa1 and Fc1 exchange  N.m" in str(fit)
    assert "Fa1 and Fc1 exchange" in fit_page(fit, open_log())
    fit.save(tmp_path / "fit.json")
    assert only(didim.Identification.load(tmp_path / "fit.json")) == item


@pytest.mark.usefixtures("without_drawing")
def test_friction_at_speeds_of_a_loaded_result(tmp_path: Path) -> None:
    """The method gives what is printed, and that of the formula with a velocity from the log."""
    fit = fitted()
    item = only(fit)
    fit.save(tmp_path / "fit.json")
    loaded = didim.Identification.load(tmp_path / "fit.json").friction_at(0, item.speeds)
    np.testing.assert_allclose(loaded.torques, item.torques, rtol=1e-12)
    np.testing.assert_allclose(loaded.low, item.low, rtol=1e-9)
    np.testing.assert_allclose(loaded.high, item.high, rtol=1e-9)
    with pytest.raises(FitError, match="joint 2 does not exist: the joints of 'planar2' are 0 to 1"):
        fit.friction_at(2, [0.1])
    with pytest.raises(FitError, match="speeds must be finite and above zero"):
        fit.friction_at(0, [0.1, 0.0])
    with pytest.raises(FitError, match="joint True does not exist"):
        fit.friction_at(True, [0.1])
    with pytest.raises(FitError, match="speeds must be numbers, got 'a'"):
        fit.friction_at(0, "a")
    with pytest.raises(FitError, match="no standard deviations"):
        replace(fit, uncertainty=None).friction_at(0, [0.1])


def test_exchanges_of_an_older_file_are_friction_at_speeds(tmp_path: Path) -> None:
    fit = fitted(0.3)
    fit.save(tmp_path / "fit.json")
    data = json.loads((tmp_path / "fit.json").read_text())
    for key in ("at_speeds", "noise", "load", "velocities", "crossed"):
        del data["uncertainty"][key]
    for key in ("missing", "moved"):
        del data["uncertainty"]["friction"][key]
    data["uncertainty"]["exchanges"] = [
        {
            "joint": 0,
            "kind": "revolute",
            "parameters": ["Fa1", "Fc1"],
            "correlation": -0.99,
            "refused": False,
            "speeds": [0.5],
            "torques": [3.0],
            "stds": [0.1],
        }
    ]
    (tmp_path / "old.json").write_text(json.dumps(data))
    old = didim.Identification.load(tmp_path / "old.json")
    assert only(old).high[0] - 3.0 == pytest.approx(0.1 * old.interval_factor())
    assert old.uncertainty is not None
    assert fit.uncertainty is not None
    # Nothing was missing, so its variances are the sum of squares that they were in such a file.
    np.testing.assert_allclose(old.uncertainty.without_shift(old.std), fit.uncertainty.noise, rtol=1e-9)


@pytest.mark.parametrize(("law", "names"), [(stribeck(0.2), {"stribeck", "atan"}), (load(0.08), {"load"})])
def test_friction_at_speeds_is_known_where_a_law_is_missing(law: Law, names: set[str]) -> None:
    """Its intervals hold though those of noise alone do not, at a few per cent of the friction."""
    inside, by_noise, halves = [], [], []
    for seed in range(4):
        fit = didim.identify(logged(robot(), law, 500 + seed), didim.IDIMLS())
        assert fit.uncertainty is not None
        assert fit.uncertainty.friction is not None
        for item in fit.uncertainty.at_speeds:
            v, dq = np.array(item.speeds), np.zeros((len(item.speeds), 2))
            assert item.law in names
            dq[:, item.joint] = v
            still, loads = np.zeros_like(dq), np.tile(fit.uncertainty.load, (len(v), 1))
            x = subject().x
            both = [didim.inverse_dynamics(robot(), still, way * dq, still, x) for way in (1.0, -1.0)]
            true = (0.5 * (both[0] - both[1]) + law(still, dq, loads, subject().fc))[:, item.joint]
            inside.append((np.array(item.low) <= true) & (true <= item.high))
            unbiased = replace(
                fit,
                uncertainty=replace(
                    fit.uncertainty,
                    friction=replace(
                        fit.uncertainty.friction,
                        missing=(),
                        p_value=np.ones_like(fit.uncertainty.friction.p_value),
                    ),
                ),
            ).friction_at(item.joint, v)
            by_noise.append((np.array(unbiased.low) <= true) & (true <= unbiased.high))
            halves.append(half(item) / true)
    assert np.mean(inside) >= 0.92
    assert np.mean(by_noise) < np.mean(inside)
    assert np.median(halves) < 0.1


def test_friction_at_speeds_of_solvers_with_own_factors(tmp_path: Path) -> None:
    """They have no columns of the velocity of joint 1; load friction of joint 2 is missing all the same."""
    known = FrictionTerm(law="atan", joint=0, velocity=0.3)
    truth = planar(known, FrictionTerm(law="load", joint=1))
    noisy = log(truth, parameters(truth, Fa1=1.5, Fl2=0.3), noise=0.1)
    searched = replace(noisy, robot=planar(replace(known, estimated=True)))
    for solver in (None, "huber"):
        fit = didim.identify(searched, didim.IDIMLS(solver=solver))
        assert fit.uncertainty is not None
        assert fit.uncertainty.friction is not None
        assert fit.uncertainty.friction.laws == {"load": (1,)}
        fit.save(tmp_path / "fit.json")
        assert didim.Identification.load(tmp_path / "fit.json").friction_at(1, 0.5).law == "load"


def test_an_alarm_always_has_a_law() -> None:
    """Noise that lasts hides from plain rows what the whitened ones show: no block left out is explained, and there is a law."""
    slide = didim.load_robot("emps").with_smoothing([0.002])
    x = np.array([{"M1": 95.0, "Fv1": 200.0, "Fc1": 20.0}.get(name, 0.0) for name in slide.parameter_names])
    reference = Reference.random_fourier(
        harmonics=15, period_s=10.0, seed=1, max_position=(0.2,), max_velocity=(0.4,), max_acceleration=(3.0,)
    )
    q, dq, ddq = reference.at(np.arange(2000) / 200.0)
    tau = didim.inverse_dynamics(slide, q, dq, ddq, x)
    tau += 2.0 * np.exp(-((dq / 0.015) ** 2)) * np.tanh(dq / 0.002)
    errors = lfilter(
        [np.sqrt(1.0 - 0.97**2)], [1.0, -0.97], np.random.default_rng(1).standard_normal((4000, 1)), axis=0
    )
    recording = didim.Recording.from_arrays(q, tau + 2.5 * errors[2000:], rate_hz=200.0)
    signal = didim.SignalProcessing(cutoff_hz=30.0, trim_start=20, trim_end=20, decimation=(4,))
    fit = didim.identify(experiment(slide, recording, signal=signal), didim.IDIMLS())
    assert fit.uncertainty is not None
    assert fit.uncertainty.friction is not None
    assert fit.uncertainty.friction.raised
    assert [law.joint for law in fit.uncertainty.friction.missing] == [0]
    assert "explains the residual of joint 1" in str(fit)
