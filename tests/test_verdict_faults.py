"""Faults planted in logs of two arms are named by the verdict; `benches/verdicts.py` has all of them, over many seeds."""

from __future__ import annotations

import pytest

import didim
from verdict_arms import ARMS, Log, built, faults, planted

QUICK = {
    "gantry": (
        "gravity (0.0, 0.0, -9.81)",
        "other DH convention",
        "a length 20 % off",
        "torque 3 x 1.25",
        "sign of torque 5",
        "Stribeck friction",
        "asymmetric friction",
        "torque one sample late",
        "AR(1) 0.95 noise",
    )
}
METHODS = {"idim-ls": didim.IDIMLS, "didim": didim.DIDIM}


@pytest.fixture(scope="module")
def sound() -> dict[str, Log]:
    return {name: built(arm, None) for name, arm in ARMS.items()}


@pytest.mark.parametrize("name", ARMS)
def test_correct_logs_are_sound(sound: dict[str, Log], name: str) -> None:
    for level in (0.003, 0.03):
        verdict = didim.identify(sound[name].noisy(5, level)).verdict
        assert verdict.sound, str(verdict)


@pytest.mark.parametrize(
    ("name", "title"), [(name, title) for name, titles in QUICK.items() for title in titles]
)
def test_a_fault_is_named(sound: dict[str, Log], name: str, title: str) -> None:
    arm = ARMS[name]
    (fault,) = [item for item in faults(arm) if item.name == title]
    own = fault.truth(arm, sound[name].experiment)
    log = built(arm, fault) if own else sound[name]
    verdict = didim.identify(planted(log, fault, 1), METHODS[fault.method]()).verdict
    assert not verdict.sound
    named = [reason for reason in verdict.grave if reason.code in fault.codes]
    assert named, str(verdict)
    if fault.joints:
        assert named[0].joints == fault.joints
