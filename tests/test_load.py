"""A load on the last body that a log has and the parameters, or another log, do not: in the verdict and in `didim check`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.diagnosis.check import check
from verdict_arms import UR5E, Arm, Log
from verdict_arms import experiment as experiment_of

MASS, CENTRE = 1.5, np.array([0.02, -0.01, 0.08])


def loaded(robot: didim.Robot, truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Parameters of the arm with a point mass on its last body."""
    x = dict(zip(robot.parameter_names, truth, strict=True))
    inertia = MASS * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
    added = {"M6": MASS, **{f"{key}6": v for key, v in zip(("MX", "MY", "MZ"), MASS * CENTRE, strict=True)}}
    places = {"XX": (0, 0), "XY": (0, 1), "XZ": (0, 2), "YY": (1, 1), "YZ": (1, 2), "ZZ": (2, 2)}
    added |= {f"{key}6": float(inertia[place]) for key, place in places.items()}
    return np.array([value + added.get(name, 0.0) for name, value in x.items()])


@pytest.fixture(scope="module")
def logs() -> tuple[Log, Log]:
    arm: Arm = UR5E
    one, other = (experiment_of(arm, seed=seed) for seed in (0, 1))
    return Log.of(arm, one), Log.of(arm, other, x=loaded)


def both(first: didim.Experiment, second: didim.Experiment) -> didim.Experiment:
    (one,), (two,) = first.recordings, second.recordings
    return replace(first, recordings=(replace(one, name="free"), replace(two, name="second")))


@pytest.mark.slow
def test_a_load_in_one_of_two_logs_is_weighed(logs: tuple[Log, Log]) -> None:
    experiment = both(logs[0].noisy(1), logs[1].noisy(2))
    fit = didim.identify(experiment)
    (reason,) = [item for item in fit.verdict.grave if item.code == "payload"]
    assert "'second'" in reason.sentence
    assert "heavier" in reason.sentence
    assert reason.value == pytest.approx(MASS, abs=0.15)
    found = [item for item in check(experiment) if item.kind == "payload"]
    assert len(found) == 1
    assert found[0].recording == "second"


@pytest.mark.slow
def test_two_logs_of_one_robot_have_no_load(logs: tuple[Log, Log]) -> None:
    for seed in range(5):
        experiment = both(logs[0].noisy(seed), logs[0].noisy(seed + 50))
        assert "payload" not in {item.code for item in didim.identify(experiment).verdict.reasons}


def test_a_load_beyond_known_parameters_is_found(logs: tuple[Log, Log]) -> None:
    truth = UR5E.truth(logs[0].experiment.robot)
    (finding,) = [item for item in check(logs[1].noisy(3), truth) if item.kind == "payload"]
    assert finding.value == pytest.approx(MASS, abs=0.15)
    assert "payload" not in {item.kind for item in check(logs[0].noisy(3), truth)}
