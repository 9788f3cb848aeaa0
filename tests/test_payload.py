"""`didim payload`: an unknown payload of a log, with the robot of another one (benches/payloads.py has ten random payloads)."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from arm import arm_file
from didim import Experiment
from didim.cli.main import main
from didim.errors import FitError
from didim.regression.logs.body import nearest_bodies
from didim.robot.payload import Payload, flange_in_last_frame, frame_of_payloads, last_link
from didim.robot.rigid_body import body_pseudo_inertia, pose, pseudo_inertia, ten_parameters
from didim.robot.robot_text import robot_text
from didim.studies.loads.payload import identify_payload, other_frames
from several import DISC, arm_logs

Array = NDArray[np.float64]

CENTRE, INERTIA = np.array([0.03, -0.02, 0.11]), np.diag([0.012, 0.010, 0.006])
LOAD = ten_parameters(body_pseudo_inertia(2.0, INERTIA, pose(np.eye(3), CENTRE)))


def tx40_log(x: Array, seed: int) -> Experiment:
    """Log of 8 s of a TX40 with noise on its torques."""
    robot = didim.load_robot("tx40").with_smoothing([0.05] * 6)
    reference = didim.Reference.random_fourier(
        harmonics=8,
        period_s=8.0,
        max_position=[1.5] * 6,
        max_velocity=[3.0] * 6,
        max_acceleration=[12.0] * 6,
        seed=seed,
    )
    q, dq, ddq = reference.at(np.arange(0.0, 8.0, 0.005))
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    tau += np.random.default_rng(seed).standard_normal(tau.shape) * 0.3
    return Experiment(
        name=f"log {seed}",
        robot=robot,
        recordings=(didim.Recording.from_arrays(q, tau, rate_hz=200.0),),
        signal=didim.SignalProcessing(cutoff_hz=40.0, trim_start=20, trim_end=20, decimation=(5,)),
        least_squares=didim.solvers.LeastSquaresSettings(weights="per-joint"),
    )


@pytest.fixture(scope="module")
def known() -> didim.Identification:
    robot = didim.load_robot("tx40")
    return didim.identify(tx40_log(robot.parameter_set("didim"), 1), didim.IDIMLS())


def loaded(seed: int, ten: Array = LOAD) -> Experiment:
    robot = didim.load_robot("tx40")
    return tx40_log(robot.parameter_set("didim") + last_link(robot, flange_in_last_frame(robot)) @ ten, seed)


def test_mass_centre_and_inertia_lie_within_their_intervals(known: didim.Identification) -> None:
    found = identify_payload(known, loaded(2))
    np.testing.assert_array_less(np.abs(found.ten - LOAD), 4.0 * found.std)
    assert found.body is not None
    assert found.body_low is not None
    assert found.body_high is not None
    truth = np.array([2.0, *CENTRE, *INERTIA[np.triu_indices(3)]])
    wide = 0.5 * (found.body_high - found.body_low)
    assert (np.abs(found.body - truth) < 2.0 * wide).all()
    assert abs(found.mass_kg - 2.0) < 0.03
    # The body is one: its pseudo-inertia about the centre is positive definite.
    xx, xy, xz, yy, yz, zz = found.body[4:]
    assert 0.5 * (xx + yy + zz) > np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])[2]
    text = str(found)
    assert re.search(
        r"For a pendant with these coordinates: (1.9|2.0)\d+ kg, centre \d+, -\d+, \d+ mm, inertia about it",
        text,
    )
    assert "jackknife, 20 blocks of time" in text


def test_a_mass_that_is_known_stays_and_sharpens_the_rest(known: didim.Identification) -> None:
    log = loaded(2)
    named = replace(log, recordings=(replace(log.recordings[0], payload="gripper"),))
    free = identify_payload(known, named)
    assert free.name == "gripper"
    held = identify_payload(known, replace(named, payloads={"gripper": Payload(name="gripper", mass_kg=2.0)}))
    assert held.body is not None
    assert held.body[0] == pytest.approx(2.0, abs=1e-9)
    assert "M" not in held.names
    with pytest.raises(FitError, match="all payloads are known"):
        identify_payload(
            known,
            replace(
                named,
                payloads={
                    "gripper": Payload(
                        name="gripper", mass_kg=2.0, com_m=(0, 0, 0.1), inertia_kg_m2=(1, 0, 0, 1, 0, 1)
                    )
                },
            ),
        )


def test_the_uncertainty_of_the_robot_is_in_that_of_the_payload(known: didim.Identification) -> None:
    vague = replace(known, covariance=100.0 * known.covariance)
    sharp, wide = (identify_payload(fit, loaded(2)) for fit in (known, vague))
    # Ten times where the log had no noise; the log alone, whose weights the robot changes, gives one and a half times.
    assert 4.0 * sharp.std[9] < wide.std[9] < 10.0 * sharp.std[9]
    with pytest.raises(FitError, match="no standard deviations"):
        identify_payload(replace(known, covariance=0.0 * known.covariance), loaded(2))


def test_the_robot_of_another_result_is_refused(known: didim.Identification) -> None:
    with pytest.raises(FitError):
        identify_payload(known, arm_logs([True]))


def test_own_offsets_of_the_log_are_told_from_its_payload(known: didim.Identification) -> None:
    log = loaded(3)
    (item,) = log.recordings
    assert item.tau is not None
    shifted = replace(item, tau=item.tau + np.array([1.0, -0.5, 0.3, 0.0, 0.0, 0.2]), own=("offsets",))
    found = identify_payload(known, replace(log, recordings=(shifted,)))
    value, std = found.offsets[f"{item.name}.Off1"]
    assert abs(value - 1.0) < 4.0 * std
    assert abs(found.mass_kg - 2.0) < 0.05


def test_the_frame_of_the_coordinates_is_named(tmp_path: Path) -> None:
    urdf = Path(didim.__file__).parent / "packaged" / "examples" / "ur10e" / "ur10e.urdf"
    arm, flange = didim.load_robot(urdf), tuple(tuple(row) for row in np.eye(4)[:3].tolist())
    assert frame_of_payloads(arm) == "link wrist_3_link"
    assert other_frames(arm, None) == ("link tool0 has the same coordinates",)
    (tmp_path / "arm.toml").write_text(robot_text(arm), encoding="utf-8")
    (remark,) = other_frames(didim.load_robot(tmp_path / "arm.toml"), None)
    assert remark.startswith("links fixed to wrist_3_link: tool0; ")
    turned = '<origin xyz="0 0 0" rpy="0 0 0"/>\n  </joint>\n  <link name="tool0"/>'
    text = urdf.read_text(encoding="utf-8")
    assert turned in text
    turned_text = text.replace(
        turned, turned.replace("0 0 0", "0 0.117 0", 1).replace("0 0 0", "-1.57079632679 0 0")
    )
    (tmp_path / "arm.urdf").write_text(turned_text, encoding="utf-8")
    assert other_frames(didim.load_robot(tmp_path / "arm.urdf"), None) == (
        "for coordinates of link tool0: [flange] with xyz_m = [0, 0.117, 0], rpy_rad = [-1.5707963, 0, 0]",
    )
    assert frame_of_payloads(arm, flange) == "[flange]"
    assert not other_frames(arm, flange)
    assert frame_of_payloads(didim.load_robot("tx40")) == "frame 6"
    assert frame_of_payloads(didim.load_robot("ur10e")) == "frame 6 of the maker's table"
    assert not other_frames(didim.load_robot("ur10e"), None)


def test_a_planar_arm_gives_what_it_shows_and_says_what_not() -> None:
    fit = didim.identify(arm_logs([False], noise=(0.3, 0.2)), didim.IDIMLS())
    found = identify_payload(fit, arm_logs([True], noise=(0.3, 0.2), seed=1))
    assert found.names == ("ZZ", "MX", "MY", "M")
    assert found.body is None
    (remark,) = found.remarks
    assert remark.startswith("this arm cannot identify XX, XY, XZ, YY, YZ, MZ")
    places = [5, 6, 7, 9]
    np.testing.assert_array_less(np.abs(found.ten - DISC)[places], 4.0 * found.std[places])


def test_nearest_bodies_are_bodies_and_true_ones_stay() -> None:
    rng = np.random.default_rng(2)
    covariance = np.diag(np.array([1e-3] * 6 + [1e-3] * 3 + [1e-2]) ** 2)
    estimates = LOAD + rng.standard_normal((50, 10)) @ np.linalg.cholesky(100.0 * covariance).T
    bodies = nearest_bodies(estimates, covariance, np.zeros(10), np.eye(10))
    assert all(np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0 for body in bodies)
    (same,) = nearest_bodies(LOAD[None], covariance, np.zeros(10), np.eye(10))
    np.testing.assert_array_less(np.abs(same - LOAD), 0.1 * np.sqrt(np.diag(covariance)))


def test_the_command_prints_the_table_and_writes_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = didim.identify(arm_logs([False], noise=(0.3, 0.2)), didim.IDIMLS())
    fit.save(tmp_path / "fit.json")
    log = arm_file(arm_logs([True], noise=(0.3, 0.2), seed=1), tmp_path, tmp_path / "log.toml")
    found = tmp_path / "payload.json"
    assert main(["payload", str(tmp_path / "fit.json"), str(log), "--json", str(found)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("payload 'payload' of log, on robot planar2, in coordinates of frame 2\n")
    data = json.loads(found.read_text())
    assert data["estimated"] == ["ZZ", "MX", "MY", "M"]
    assert abs(data["flange"]["M"] - 0.8) < 4.0 * data["flange_std"]["M"]
