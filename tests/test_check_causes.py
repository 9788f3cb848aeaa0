"""`didim check` on the robot file and on the closed loop; logs of two simulated arms, and real ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from didim import Experiment
from didim.diagnosis.check import check
from didim.diagnosis.reference import check_reference
from verdict_arms import ARMS, Log, built, faults, planted

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def sound() -> Log:
    return built(ARMS["gantry"], None)


def test_a_correct_log_has_no_finding_and_a_table_of_its_controller(sound: Log) -> None:
    found = check(sound.noisy(3))
    assert [item.kind for item in found] == []
    head, *rows = found.closed_loop
    assert head == ("joint", "kp", "kv", "left %")
    assert [row[0] for row in rows] == ["1", "2", "3", "4", "5"]
    for row in rows:
        assert float(row[1]) == pytest.approx(1.0, abs=0.01)
        assert float(row[2]) == pytest.approx(1.0, abs=0.03)
    assert "the controller as the log shows it" in str(found)
    assert found.to_dict()["closed_loop"][0]["joint"] == "1"


@pytest.mark.parametrize(
    "title", ["gravity (0.0, -9.81, 0.0)", "other DH convention", "a length 20 % off", "kp 10 % off"]
)
def test_a_wrong_robot_file_or_controller_is_found(sound: Log, title: str) -> None:
    (fault,) = [item for item in faults(ARMS["gantry"]) if item.name == title]
    found = check(planted(sound, fault, 4))
    assert found[0].kind in fault.codes, str(found)
    if title.startswith("kp"):
        assert found.closed_loop[1][1] == "1.111"


def test_without_a_controller_there_is_no_table(sound: Log) -> None:
    found = check(replace(sound.noisy(3), controller=None))
    assert found.closed_loop == ()
    assert "controller" not in str(found)


def _reference(log: Log, change: Callable[[Array, Array], Array]) -> Experiment:
    experiment = log.noisy(3)
    (recording,) = experiment.recordings
    assert recording.q_ref is not None
    q_ref = change(recording.q, recording.q_ref)
    return replace(experiment, recordings=(replace(recording, q_ref=q_ref),), controller=None, reference=None)


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("is the measured position itself", lambda q, ref: q.copy()),
        ("does not move", lambda q, ref: np.tile(ref[0], (len(ref), 1))),
        ("is a smoothed copy", lambda q, ref: sosfiltfilt(butter(4, 0.2, output="sos"), q, axis=0)),
        ("20 ms later", lambda q, ref: np.concatenate([q[:1].repeat(5, axis=0), q[:-5]])),
        ("does not go with its position", lambda q, ref: np.roll(ref, 1, axis=1)),
    ],
)
def test_a_reference_that_is_not_one_is_found(
    sound: Log, words: str, change: Callable[[Array, Array], Array]
) -> None:
    found = [item for item in check(_reference(sound, change)) if item.kind == "reference"]
    assert any(words in item.sentence for item in found), [str(item) for item in found]


def test_a_real_reference_is_none_of_these(sound: Log) -> None:
    assert check_reference(_reference(sound, lambda q, ref: ref)) == []
