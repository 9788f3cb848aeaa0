"""What ``didim check`` says of a sound log: notes on what the log cannot show, and no factor that errors of friction suggest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import Experiment, SignalProcessing, check, load_experiment
from didim.diagnosis.finding import Findings
from didim.diagnosis.probe import Probe, Reading
from didim.diagnosis.readings import Reader
from didim.log.recording import Recording
from didim.studies.simulated_log import measured, simulated_log

Array = NDArray[np.float64]
ROWS = 1000


@pytest.fixture(scope="module")
def arm(project: Path) -> Experiment:
    experiment = load_experiment(project / "examples" / "planar2_simulation.toml")
    signal = SignalProcessing(cutoff_hz=50, trim_start=50, trim_end=50, decimation=(10,))
    return replace(experiment, signal=signal)


def planar_log(arm: Experiment, **values: float) -> Experiment:
    """A log of the planar arm with other parameters."""
    x = arm.robot.parameter_set("reference").copy()
    for name, value in values.items():
        x[arm.robot.parameter_names.index(name)] = value
    return measured(simulated_log(arm, x, noise=False), 1)


def test_joints_that_share_nothing_are_noted_and_are_no_finding(arm: Experiment) -> None:
    found = check(planar_log(arm, MX2=0.0, ZZ2=1e-4, Ia2=0.05))
    assert not found.items, str(found)
    (note,) = found.notes
    assert "the drive gains of joints 1 and 2 cannot be checked by this log" in note
    assert str(found).splitlines()[1] == f"To know: {note}."
    assert found.to_dict()["notes"] == [note]


def test_nothing_is_noted_where_the_log_checks_all_gains(arm: Experiment) -> None:
    found = check(planar_log(arm))
    assert (found.items, found.notes) == ((), ()), str(found)


def test_notes_stand_before_the_table_of_the_closed_loop() -> None:
    shown = str(Findings("log", closed_loop=(("joint", "kp"), ("1", "1.00")), notes=("a gain is open",)))
    assert shown.splitlines()[:3] == ["log: nothing found.", "To know: a gain is open.", ""]


class Fitted:
    """A log whose chi^2 per row depends on the scale of the position of joint 2 alone."""

    viscous = np.zeros(0, dtype=int)
    names = ()
    n_rows = ROWS // 2

    def __init__(self, declared: float, right: float) -> None:
        self._declared, self._right = declared, right

    def relative(self, reading: Reading) -> tuple[float, Array]:
        return 0.05, np.zeros(0)

    def solve(self, reading: Reading, weights: Array) -> tuple[float, Array]:
        off = np.log(reading.position[1, 1] / 2.0) ** 2 / np.log(2.0) ** 2
        turned = 0.0 if np.allclose(reading.torque, np.eye(2)) else 0.1
        chi2 = self._right + (self._declared - self._right) * (off + turned)
        return ROWS * float(chi2), np.zeros(0)


@pytest.mark.parametrize(
    ("declared", "right", "kinds"),
    [
        # Measured: a gear that is 10 % off; friction that is smooth in the log and a sign in the model.
        (7.62, 4.88, ["position-scale"]),
        (2.99, 2.63, []),
    ],
)
def test_a_factor_has_to_take_a_fifth_of_the_residual(
    arm: Experiment, declared: float, right: float, kinds: list[str]
) -> None:
    log = planar_log(arm)
    probe = cast(Probe, Fitted(declared, right))
    recording: Recording = log.recordings[0]
    reader = Reader(probe, probe, log.robot, recording, timed=True, noise=np.ones(2), known=False)
    found = reader.fine()
    assert [item.kind for item in found] == kinds
    for item in found:
        assert item.value == pytest.approx(2.0, rel=0.02)


def test_the_causes_of_friction_say_what_a_file_takes(arm: Experiment, tmp_path: Path) -> None:
    """What the advice says to write is read: friction = "auto" at the top of a file, as it once said, is not."""
    robot = didim.load_robot("planar2")
    for line in ("stribeck = true", 'terms = "auto"', 'coulomb = "tanh"\nsmoothing_rad_s = 0.01'):
        path = tmp_path / "robot.toml"
        robot_text = (Path(didim.__file__).parent / "packaged" / "robots" / "planar2.toml").read_text(
            encoding="utf-8"
        )
        path.write_text(f"{robot_text}\n[friction]\n{line}\n", encoding="utf-8")
        assert didim.load_robot(path).n_dof == robot.n_dof
