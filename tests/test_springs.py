"""Springs and counterbalances: columns, files, conditions, choice, exports, and a simulated palletiser with known parameters."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

import didim
from conditions import drive_cones
from didim.cli.main import main
from didim.errors import RobotError
from didim.export.mjcf import to_mjcf
from didim.export.sdf import to_sdf
from didim.robot.friction import FrictionTerm
from didim.robot.robot import Robot
from didim.robot.robot_text import robot_text
from test_export_c import check

pytestmark = pytest.mark.usefixtures("without_verdict")

COLUMNS = {
    "position": "act_pos_mot_deg",
    "torque": "act_torque_abs_nm",
    "time": "time_cont",
    "reference": "ref_pos_deg",
}
"""Columns of the logs of a KR 300."""
OPTIONS = [
    *(word for signal, name in COLUMNS.items() for word in ("--columns", f"{signal}=rec.{name}")),
    *(word for side in ("position=joint", "reference=joint", "torque=motor") for word in ("--side", side)),
]
"""Options of `didim init` for these logs."""
ROOT = Path(__file__).parent.parent
GEOMETRY = (0.6, 0.25, 0.35, 0.35)
SPRINGS = (
    FrictionTerm(law="spring", joint=0),
    FrictionTerm(law="sine", joint=1),
    FrictionTerm(law="cosine", joint=1),
    FrictionTerm(law="cylinder", joint=0, values=GEOMETRY),
    FrictionTerm(law="cylinder_rate", joint=0, values=GEOMETRY),
)
VALUES = {"Ks1": 8.0, "Gs2": 1.5, "Gc2": -2.0, "Cf1": 30.0, "Ck1": 70.0}


def sprung() -> tuple[Robot, np.ndarray]:
    """Planar arm with every kind of spring, and parameters."""
    plain = didim.load_robot("planar2")
    robot = plain.with_terms(SPRINGS)
    x = np.zeros(len(robot.parameter_names))
    known = plain.parameter_set("reference")
    x[: known.size] = known
    for name, value in VALUES.items():
        x[robot.parameter_names.index(name)] = value
    return robot, x


def springs_torque(q: np.ndarray) -> np.ndarray:
    """Torques of the springs by their formulas; the slope of the length by differences."""
    a, b, phi, rest = GEOMETRY

    def length(angle: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(angle + phi)))

    slope = (length(q[:, 0] + 1e-6) - length(q[:, 0] - 1e-6)) / 2e-6
    first = 8.0 * q[:, 0] + (30.0 + 70.0 * (length(q[:, 0]) - rest)) * slope
    return np.column_stack([first, 1.5 * np.sin(q[:, 1]) - 2.0 * np.cos(q[:, 1])])


def states(n: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    q, dq, ddq = (rng.uniform(-2.0, 2.0, (n, 2)) for _ in range(3))
    return q, dq, ddq


def test_springs_add_their_formulas_and_the_direct_model_undoes_them() -> None:
    robot, x = sprung()
    plain = didim.load_robot("planar2")
    q, dq, ddq = states()
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    without = didim.inverse_dynamics(plain, q, dq, ddq, plain.parameter_set("reference"))
    np.testing.assert_allclose(tau - without, springs_torque(q), atol=1e-7)
    w = didim.regressor(robot, q, dq, ddq)
    np.testing.assert_allclose(w @ x, tau, atol=1e-10)
    np.testing.assert_allclose(didim.direct_dynamics(robot, q, dq, tau, x), ddq, atol=1e-9)


def test_a_weight_on_an_axis_regroups_into_gravity_and_a_spring_does_not() -> None:
    """The second joint follows a level one: gravity has the sine and cosine of the sum of both, not of its own position."""
    robot, x = sprung()
    plain = didim.load_robot("planar2").base_parameters.names
    assert set(robot.base_parameters.names) - set(plain) == {"Ks1", "Gs2", "Gc2", "Cf1R", "MY1R"}
    # (l - rest) dl/dq = a b sin(q + phi) - rest dl/dq: gravity of the first joint, and the force of the cylinder.
    q, dq, ddq = states()
    columns = didim.regressor(robot, q, dq, ddq)[:, :, list(robot.base_parameters.indices)]
    beta = robot.base_parameters.project(x)
    np.testing.assert_allclose(columns @ beta, didim.inverse_dynamics(robot, q, dq, ddq, x), atol=1e-9)


def test_a_robot_file_keeps_its_springs(tmp_path: Path) -> None:
    robot = didim.load_robot("planar2").with_terms(SPRINGS)
    text = robot_text(robot)
    path = tmp_path / "sprung.toml"
    path.write_text(text, encoding="utf-8")
    again = didim.load_robot(path)
    assert [(term.law, term.joint) for term in again.friction.terms] == [
        (term.law, term.joint) for term in SPRINGS
    ]
    np.testing.assert_allclose(again.friction.terms[-1].values, GEOMETRY, rtol=1e-12)
    assert robot_text(again) == text


@pytest.mark.parametrize(
    ("springs", "message"),
    [
        ("linear = [3]", "linear must be true, false or a list of joints from 1 to 2"),
        ("linear = [1]\nstiff = 2", "stiff"),
        ("[[springs.cylinder]]\njoint = 1\na_m = 0.2\nb_m = 0.2", "a_m and b_m must differ"),
        ("[[springs.cylinder]]\njoint = 3\na_m = 0.2\nb_m = 0.3", "joint"),
        ("[[springs.cylinder]]\njoint = 1\na_m = 0.2", "b_m"),
    ],
)
def test_wrong_springs_are_named(tmp_path: Path, springs: str, message: str) -> None:
    path = tmp_path / "sprung.toml"
    path.write_text(robot_text(didim.load_robot("planar2")) + f"\n[springs]\n{springs}\n", encoding="utf-8")
    with pytest.raises(RobotError, match=re.escape(message)) as raised:
        didim.load_robot(path)
    assert "sprung.toml" in str(raised.value)
    assert len(str(raised.value)) <= 200


def test_a_joint_that_slides_has_linear_springs_only() -> None:
    emps = didim.load_robot("emps")
    assert emps.with_terms([FrictionTerm(law="spring", joint=0)]).parameter_names[-1] == "Ks1"
    with pytest.raises(RobotError, match="only a joint that turns"):
        _ = emps.with_terms([FrictionTerm(law="sine", joint=0)]).core


def test_stiffness_is_a_condition_and_a_force_is_none() -> None:
    robot, _ = sprung()
    labels = [cone.label for cone in drive_cones(robot)]
    assert {"Ks1", "Ck1"} <= set(labels)
    assert not {"Gs2", "Gc2", "Cf1"} & set(labels)


def logged(robot: Robot, x: np.ndarray, noise: float, seed: int = 0) -> didim.Experiment:
    t = np.arange(6000) / 200.0
    q, dq, ddq = (np.zeros((t.size, 2)) for _ in range(3))
    for joint, frequencies in enumerate(((0.13, 0.41, 0.83), (0.19, 0.53, 0.71))):
        for k, f in enumerate(frequencies):
            w, a = 2.0 * np.pi * f, 0.9 / (k + 1)
            q[:, joint] += a * np.sin(w * t + joint + k)
            dq[:, joint] += a * w * np.cos(w * t + joint + k)
            ddq[:, joint] -= a * w * w * np.sin(w * t + joint + k)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    tau = tau + noise * np.random.default_rng(seed).standard_normal(tau.shape)
    recording = didim.Recording.from_arrays(q, tau, rate_hz=200.0)
    signal = didim.SignalProcessing(cutoff_hz=None, trim_start=10, trim_end=10)
    return didim.Experiment(name="sprung", robot=robot, recordings=(recording,), signal=signal)


def test_held_out_blocks_find_a_spring_and_do_not_invent_one() -> None:
    robot = didim.load_robot("planar2")
    for stiffness, found in ((6.0, True), (0.0, False)):
        sprung = robot.with_terms([FrictionTerm(law="spring", joint=1)])
        x = np.append(robot.parameter_set("reference"), stiffness)
        log = replace(logged(sprung, x, 0.05), robot=robot)
        fit = didim.identify(log, didim.IDIMLS(friction="auto"))
        assert ("Ks2" in fit.names) == found
        if found:
            place = fit.names.index("Ks2")
            assert abs(fit.beta[place] - stiffness) < 4.0 * fit.std[place]


def test_a_negative_stiffness_is_not_consistent() -> None:
    robot = didim.load_robot("planar2").with_terms([FrictionTerm(law="spring", joint=1)])
    x = robot.parameter_set("reference").copy()
    x[-1] = -0.05
    fit = didim.identify(logged(robot, x, 0.2), didim.IDIMLS(solver="consistent"))
    assert fit.beta[fit.names.index("Ks2")] >= -1e-6


def test_exports_have_the_spring() -> None:
    plain = didim.load_robot("planar2")
    robot = plain.with_terms([FrictionTerm(law="spring", joint=0)])
    x = np.append(plain.parameter_set("reference"), 8.0)
    mjcf = to_mjcf(robot, x)
    assert 'stiffness="8.0"' in mjcf
    (rest,) = re.findall(r'springref="([^"]+)"', mjcf)
    assert float(rest) == pytest.approx(-0.1 / 8.0)  # Off1 = 0.1
    sdf = to_sdf(robot, x)
    assert "<spring_stiffness>8.0</spring_stiffness>" in sdf
    assert sdf.count("<spring_reference>") == 1


def test_mujoco_has_the_torque_of_the_spring() -> None:
    mujoco = pytest.importorskip("mujoco")
    plain = didim.load_robot("planar2")
    robot = plain.with_terms([FrictionTerm(law="spring", joint=0)])
    x = np.append(plain.parameter_set("reference"), 8.0)
    model = mujoco.MjModel.from_xml_string(to_mjcf(robot, x))
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = (0.7, -0.4), 0.0, (1.0, -2.0)
    mujoco.mj_inverse(model, data)
    q, dq, ddq = (np.array(value)[None] for value in (data.qpos, data.qvel, data.qacc))
    x[robot.parameter_names.index("Off2")] = 0.0  # no place in the format
    want = didim.inverse_dynamics(robot, q, dq, ddq, x)[0]
    np.testing.assert_allclose(data.qfrc_inverse, want, atol=1e-9)


def test_c_has_the_torques_of_springs(tmp_path: Path) -> None:
    robot, x = sprung()
    check(tmp_path, robot, x)


def palletiser() -> dict[str, Any]:
    """Run the block of docs/mechanisms.md; the names it makes."""
    text = (ROOT / "docs" / "mechanisms.md").read_text(encoding="utf-8")
    *_, code = re.findall(r"^```python\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {"__name__": "palletiser"}
    exec(compile(code, "docs/mechanisms.md", "exec", dont_inherit=True), names)
    return names


def errors(fit: didim.Identification, robot: Robot, x: np.ndarray) -> np.ndarray:
    """Errors of the estimates in standard deviations."""
    truth = dict(zip(robot.base_parameters.names, robot.base_parameters.project(x), strict=True))
    want = np.array([truth[name] for name in fit.names])
    return np.asarray((fit.beta - want) / fit.std)


@pytest.mark.slow
def test_the_palletiser_of_the_page_is_identified() -> None:
    """The model without the cylinder fails; with it, errors are as large as sigma says, by all three methods."""
    page = palletiser()
    fit, plain = page["fit"], page["plain"]
    assert fit.overall_relative_error < 0.5 * plain.overall_relative_error
    log = page["log"]
    x = page["truth"](log.robot)
    for method in (didim.IDIMLS(), didim.DIDIM(), didim.CLOE(start="idim-ls")):
        z = errors(didim.identify(log, method), log.robot, x)
        assert np.sqrt(np.mean(z**2)) < 1.6
        assert np.abs(z).max() < 5.0


def kr300(folder: Path, ratios: np.ndarray, springs: str) -> Path:
    """Write the robot of the logs: the axes of the packaged KR 16 with the lengths of a KR 300, zero in the home position."""
    lengths = {"0.26": "0.35", "0.68": "1.15", "-0.035": "-0.041", "-0.67": "-1.0"}
    head, *joints = robot_text(didim.load_robot("kr16")).replace('"kr16"', '"kr300"').split("[[joint]]")
    joints[1] = joints[1].replace("theta_deg = 0.0", "theta_deg = -90.0")
    joints[2] = joints[2].replace("theta_deg = -90.0", "theta_deg = 0.0")
    text = "[[joint]]".join([head, *joints])
    text = re.sub(
        r"(?<=[ad]_m = )\S+$", lambda found: lengths.get(found[0], found[0]), text, flags=re.MULTILINE
    )
    path = folder / "kr300.toml"
    gears = "".join(f"{row},\n" for row in np.diag(ratios).tolist())
    path.write_text(f"{text}\n[transmission]\nreduction = [\n{gears}]\n{springs}", encoding="utf-8")
    return path


def moving(log: didim.Experiment) -> didim.Experiment:
    """Return a log from where the last axis has started to where the first one stops: at the dead zone of `didim check`."""
    (recording,) = log.recordings
    fast = np.abs(np.gradient(recording.q, axis=0)) * recording.rate_hz > 0.01
    start, stop = int(fast.argmax(axis=0).max()), len(fast) - int(fast[::-1].argmax(axis=0).max())
    return replace(log, recordings=(replace(recording, windows=((start, stop),)),))


def test_a_spring_on_axis_2_of_a_kuka_with_a_counterbalance(shared: Path, tmp_path: Path) -> None:
    """Within half a radian gravity has the torque of the counterbalance: a spring gains little, and is the same in both runs."""
    data = shared / "data" / "kr300"
    ratios = scipy.io.loadmat(data / "A.mat")["para"][0, 0]["u"].ravel()
    robot = kr300(tmp_path, ratios, "\n[springs]\nlinear = [2]\n")
    stiffness, variance = [], 0.0
    for run in "AB":
        out = tmp_path / f"{run}.toml"
        assert main(["init", str(robot), str(data / f"{run}.mat"), *OPTIONS, "-o", str(out)]) == 0
        log = didim.load_experiment(out)
        # Most of the error is that of the standstill before and after the motion.
        assert didim.identify(log, didim.IDIMLS()).overall_relative_error > 0.09
        log = moving(log)
        fit = didim.identify(log, didim.IDIMLS())
        plain = didim.identify(replace(log, robot=log.robot.with_terms([])), didim.IDIMLS())
        assert (
            0.9 * plain.overall_relative_error
            < fit.overall_relative_error
            < plain.overall_relative_error + 1e-4
        )
        assert plain.overall_relative_error < 0.04
        place = fit.names.index("Ks2")
        stiffness.append(fit.beta[place])
        variance += fit.std[place] ** 2
    assert abs(stiffness[0] - stiffness[1]) < np.sqrt(variance)
