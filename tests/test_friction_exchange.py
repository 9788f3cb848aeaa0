"""Friction parameters that exchange: the pair is marked, and friction at speeds inside the log is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.regression.friction.alarm import EXCHANGED, SHARES, Exchange
from didim.report.fit import fit_page
from didim.robot.friction import FrictionTerm
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


def only(fit: didim.Identification) -> Exchange:
    assert fit.uncertainty is not None
    (item,) = fit.uncertainty.exchanges
    return item


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
        z.append((np.array(item.torques) - true) / item.stds)
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3
    own = np.mean([fit.std[fit.names.index("Fc1")] for fit in fits])
    assert own > 5.0 * np.mean([item.stds for item in items])


def test_deviations_include_the_velocity() -> None:
    known, searched = only(fitted(estimated=False)), only(fitted())
    assert known.speeds == searched.speeds
    assert np.array(searched.stds).max() > np.array(known.stds).max()


def test_a_pair_that_the_log_tells_apart_is_not_marked() -> None:
    fit = fitted(0.3)
    assert fit.uncertainty is not None
    assert fit.uncertainty.exchanges == ()
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
    assert np.abs(np.array(item.torques) - (value["Fv1"] * v + value["Fc1"])).max() < 4.0 * max(item.stds)
    assert (
        "the log does not identify the velocity of Fr1; friction of joint 1 (N.m, 95 %) by speed (rad/s): "
        in str(fit)
    )


def test_a_velocity_below_twice_the_dead_zone_is_refused() -> None:
    term = FrictionTerm(law="atan", joint=0, velocity=0.05)
    robot = planar(term, dead_zone=0.04)
    experiment = log(robot, parameters(robot, Fa1=2.0), noise=0.02)
    open_robot = robot.with_terms([replace(term, estimated=True, velocity=0.1)])
    fit = didim.identify(replace(experiment, robot=open_robot))
    (velocity,) = fit.settings["friction"]["velocities"]
    assert not velocity["identified"]
    assert only(fit).refused


@pytest.mark.usefixtures("without_drawing")
def test_the_pair_is_printed_and_saved(tmp_path: Path) -> None:
    fit = fitted()
    item = only(fit)
    marked = [line for line in str(fit).splitlines() if line.endswith("exchanges")]
    assert [line.split()[0] for line in marked] == ["Fc1", "Fa1"]
    assert f"Fa1 and Fc1 exchange (correlation {item.correlation:.3f})" in str(fit)
    assert "Fa1 and Fc1 exchange" in fit_page(fit, open_log())
    fit.save(tmp_path / "fit.json")
    assert only(didim.Identification.load(tmp_path / "fit.json")) == item
