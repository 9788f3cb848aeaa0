"""The friction curve is the friction of the model, and the rows of the log scatter around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import didim
from didim.errors import FitError
from didim.robot.friction import FrictionTerm
from didim.studies.friction_curve import friction_curves
from several import arm_logs
from test_friction_terms import log, parameters, planar


def fitted(noise: float = 0.0) -> tuple[didim.Identification, didim.Experiment]:
    robot = planar(FrictionTerm(law="atan", joint=0, velocity=0.3), FrictionTerm(law="load", joint=1))
    experiment = log(robot, parameters(robot, Fa1=1.5, Fl2=0.1), noise)
    return didim.identify(experiment), experiment


def test_the_curve_is_the_sum_of_the_terms() -> None:
    fit, experiment = fitted()
    first, second = friction_curves(fit, experiment)
    value = dict(zip(fit.names, fit.beta, strict=True))
    v = first.speed
    assert len(v) == 401
    assert v[0] == -v[-1]
    want = value["Fv1"] * v + value["Fc1"] * np.sign(v) + value["Off1"] + value["Fa1"] * np.arctan(v / 0.3)
    np.testing.assert_allclose(first.torque, want, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(first.low, first.high)
    # Load friction widens the curve where the joint moves.
    assert np.all((second.high - second.low)[second.speed > 0.1] > 0.0)
    assert np.all((second.high - second.low)[second.speed < -0.1] < 0.0)


def test_the_rows_of_the_log_lie_on_it() -> None:
    fit, experiment = fitted()
    first, _ = friction_curves(fit, experiment)
    moving = np.abs(first.measured_speed) > 0.1
    predicted = np.interp(first.measured_speed[moving], first.speed, first.torque)
    error = first.measured[moving] - predicted
    assert np.sqrt(np.mean(error**2)) < 0.03 * np.ptp(first.torque)


def test_the_picture_has_a_panel_per_joint() -> None:
    fit, experiment = fitted(0.05)
    figure = didim.plot.friction(fit, experiment)
    assert isinstance(figure, Figure)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["joint 1", "joint 2"]
    assert [len(axes.collections) for axes in figure.axes] == [0, 1]


def test_another_robot_is_refused() -> None:
    fit, experiment = fitted()
    with pytest.raises(
        FitError, match=r"the parameters differ: only the result has Fa1, Fl2; write the same \[friction\]"
    ):
        friction_curves(replace(fit, settings={}), replace(experiment, robot=planar()))
    kept = tuple(replace(item, role="held-out") for item in experiment.recordings)
    with pytest.raises(FitError, match="no recording with role 'fit'"):
        friction_curves(fit, replace(experiment, recordings=kept))


@pytest.mark.parametrize("own", [(), ("offsets", "friction")])
def test_payloads_and_what_a_recording_has_for_itself_are_subtracted(own: tuple[str, ...]) -> None:
    """The dots of all recordings lie on the curve of the robot, whatever each of them carries."""
    experiment = arm_logs([False, True, True], offsets={1: (0.6, -0.4)} if own else None, own=own)
    fit = didim.identify(experiment)
    for curve in friction_curves(fit, experiment):
        moving = np.abs(curve.measured_speed) > 0.3
        error = curve.measured[moving] - np.interp(curve.measured_speed[moving], curve.speed, curve.torque)
        assert np.sqrt(np.mean(error**2)) < 0.03 * np.ptp(curve.torque)
