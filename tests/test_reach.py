"""Pose of the last frame at q = 0, and the reach, as `didim base` prints them."""

from __future__ import annotations

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.model.kinematics import flange_at_zero, reach


def test_the_planar_arm() -> None:
    robot = didim.load_robot("planar2")
    expected = np.eye(4)
    expected[0, 3] = 0.5
    np.testing.assert_allclose(flange_at_zero(robot), expected, atol=1e-12)
    # From the first axis to the second, whatever the joints do.
    assert reach(robot) == pytest.approx(0.5)


def test_the_tx40_reaches_as_far_as_its_two_long_links() -> None:
    geometry = didim.load_robot("tx40").geometry
    longest = np.hypot(geometry.d[2], 0.0) + np.hypot(geometry.r[3], geometry.d[3]) + abs(geometry.r[2])
    assert 0.8 * longest < reach(didim.load_robot("tx40")) <= longest + 1e-9


def test_the_command_prints_both(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["base", "planar2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2] == (
        "Frame 2 at q = 0, in frame 0: origin [0.5, 0, 0] m, x along [1, 0, 0]; y along [0, 1, 0]; z along [0, 0, 1]"
    )
    assert lines[-1] == "Reach, from the origin of frame 1 to that of frame 2: 0.5 m"
