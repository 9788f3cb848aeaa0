"""`didim check` on the robot file and on the closed loop; logs of two simulated arms, and real ones."""

from __future__ import annotations

from dataclasses import replace

import pytest

from didim.diagnosis.check import check
from verdict_arms import ARMS, Log, built, faults, planted


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
