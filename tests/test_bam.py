"""Logs of servos on pendulums by BAM: gain and load of each file, and the part in which the servo is on."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import RecordingError
from didim.log.bam_file import BamFile
from test_pendulum import DELAY_S, GAINS, LOAD, LOADS, PENDULUM, RATE, TRUTH, commands, simulated

UNIT = 0.08
"""Gain (N.m/rad) of one unit of the servo."""


def content(q: np.ndarray, r: np.ndarray, **more: Any) -> dict[str, Any]:
    """Content of a file whose servo is switched off for the last second, while the pendulum drops."""
    entries = [
        {
            "timestamp": k / RATE,
            "position": position,
            "goal_position": goal,
            "speed": 0.0,
            "load": 0,
            "torque_enable": k < len(r) - RATE,
        }
        for k, (position, goal) in enumerate(zip(q.ravel().tolist(), r.tolist(), strict=True))
    ]
    return {"vin": 7.4, "motor": "xl330", "trajectory": "sin_sin", "entries": entries, **more}


def test_a_folder_of_logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a question: kp by unit of the servo, and armature, damping and friction are those of the truth."""
    monkeypatch.chdir(tmp_path)
    Path("pendulum.xml").write_text(PENDULUM.format(load=""))
    t = np.arange(500) / RATE
    names = []
    for number, (kp, (mass, length), kind) in enumerate(itertools.product(GAINS, LOADS.values(), (0, 2))):
        r = commands(kind, t)
        q = simulated(PENDULUM.format(load=LOAD.format(mass=mass, length=length)), tmp_path, kp, r)
        q[-int(RATE) :] = 0.0  # it hangs down
        names.append(f"2026-01-15_10h28m{number}.json")
        Path(names[-1]).write_text(json.dumps(content(q, r, kp=kp / UNIT, mass=mass, length=length)))
    assert main(["init", "pendulum.xml", *names, "-o", "logs.toml"]) == 0
    text = Path("logs.toml").read_text()
    smooth = '[friction]\ncoulomb = "tanh"\nsmoothing_rad_s = 0.02\n'
    Path("logs.toml").write_text(text.replace("# [friction]\n", smooth, 1))
    assert text.count("[[recording]]") == 8
    assert text.count("[payload.") == 2
    assert main(["identify", "logs.toml", "--method", "cloe", "--json", "fit.json"]) == 0
    fit = didim.Identification.load("fit.json")
    for name, value in {"kp1": UNIT, **{f"{kind}1": value for kind, value in TRUTH.items()}}.items():
        assert fit.beta[fit.names.index(name)] == pytest.approx(value, rel=0.02), name
    assert fit.beta[fit.names.index("delay_s")] == pytest.approx(DELAY_S, abs=2e-4)


def test_the_arm_is_a_rod() -> None:
    """Mass, centre and moment of a rod of 60 g with 200 g at its end, 0.1 m from the axis."""
    raw = json.dumps(content(np.zeros(200), np.zeros(200), kp=8, mass=0.2, length=0.1, arm_mass=0.06))
    file = BamFile(raw.encode(), "log.json")
    mass, distance, moment = file.pendulum.body
    assert (mass, distance) == pytest.approx((0.26, 0.023 / 0.26))
    assert moment + mass * distance**2 == pytest.approx(0.0022)
    assert len(file.array("position")) == 100


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"entries": [{"torque_enable": False}]}, "log.json: the servo is off in the whole log; leave it out"),
        ({"kp": 0}, "log.json: kp, mass and length of a log by BAM must be above 0"),
        ({"length": float("nan")}, "log.json: kp, mass and length of a log by BAM must be above 0"),
        ({"entries": 3}, "log.json: this is not a readable BAM file"),
    ],
)  # fmt: skip
def test_other_files_are_refused(change: dict[str, Any], message: str) -> None:
    whole = content(np.zeros(200), np.zeros(200), kp=8, mass=0.2, length=0.1)
    with pytest.raises(RecordingError, match=message):
        BamFile(json.dumps(whole | change).encode(), "log.json")
