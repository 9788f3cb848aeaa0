"""A simulation that moves like the robot of a file and a log of positions: the examples by MuJoCo, and a real quadruped."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import FitError
from didim.export.drives import Drives, JointDrive, drives_of, for_step
from didim.export.mjcf_edit import edit_mjcf
from didim.methods.cloe.cloe import CLOE
from didim.studies.in_mujoco import Logged, _loaded, replayed, validate_in_mujoco
from didim.studies.mujoco_model import load_model
from quadrupeds import ARM_DELAY_S, ARM_TRUTH, arm_episodes, arm_text, followed, recorded
from scripts import script
from test_documented import tables, words
from test_lerobot import dataset
from test_tutorials import ends_sound, walked

mujoco = pytest.importorskip("mujoco", reason="needs mujoco, the group 'test'")

DOCS = Path(__file__).parents[1] / "docs"
QUADRUPED, HOBBY_ARM = DOCS / "quadruped.md", DOCS / "hobby_arm.md"
ARM_MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "gripper")


ARM = """
schema = 1
robot = "so101.xml"
[parameters]
links = "fixed"
dropped = ["Off"]
[controller]
kind = "pd"
[reference]
kind = "recorded"
between_samples = "held"
[unknown]
delay_s = { max = 0.06 }
[[recording]]
name = "log"
rate_hz = 50
"""
ARM += recorded("log.npz", "q", "r")


def arm_commands(rng: np.random.Generator, count: int = 900) -> np.ndarray:
    """Jumps and waves of a hobby arm, (n_samples, 4), at 50 Hz."""
    t = np.arange(count) / 50.0
    jumps = np.repeat(rng.uniform(-0.35, 0.35, (count // 25, 4)), 25, axis=0)
    waves = 0.3 * np.sin(2.0 * np.pi * np.outer(t, rng.uniform(0.3, 1.0, 4)) + rng.uniform(0.0, 6.0, 4))
    return np.asarray(np.where((t % 6.0 < 3.0)[:, None], jumps, waves) + np.array([0.0, 0.2, 0.4, 0.7]))


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example of docs/quadruped.md: its simulated log, an experiment by `didim init`, the fit, and the files exported."""
    folder = tmp_path_factory.mktemp("example")
    text = QUADRUPED.read_text(encoding="utf-8")
    printed = walked("quadruped", text, folder)
    assert ends_sound(printed["didim identify log.toml --json fit.json"])
    assert (
        "(RL_knee): Fc is 0.8 N.m, where its siblings have 0.4"
        in printed["didim identify log.toml --json fit.json"]
    )
    (toml,) = re.findall(r"^```toml\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    written = (folder / "quadruped" / "log.toml").read_text(encoding="utf-8").splitlines()
    assert {line.strip() for line in toml.splitlines()} <= {line.strip() for line in written}
    replays = [out for command, out in printed.items() if command.startswith("didim validate")]
    before, after = (float(row[1]) for row in tables(QUADRUPED)["rms error of all joints (mrad) "])
    assert all_joints(replays[0]) == pytest.approx([before, after], rel=0.05)
    corrected = re.search(r"With two steps a sample the error is (\S+) mrad", text)
    assert corrected
    assert all_joints(replays[1])[1] == pytest.approx(float(corrected.group(1)), rel=0.05)
    return folder / "quadruped"


def all_joints(printed: str) -> list[float]:
    """Errors of all joints in the table of a replay, before and after (mrad)."""
    return [float(cell) for cell in re.findall(r"^all (.*)$", printed, flags=re.MULTILINE)[0].split()]


@pytest.mark.slow
def test_the_drives_are_those_of_the_truth(twin: Path) -> None:
    """Of the simulation, and those that the page shows of the knees."""
    logs, fit = script(twin / "make_logs.py"), didim.Identification.load(twin / "fit.json")
    model = mujoco.MjModel.from_xml_path(str(twin / "quadruped_fit.xml"))
    knees: dict[str, list[float]] = {}
    for joint in range(1, model.njnt):
        name, dof = model.joint(joint).name, model.jnt_dofadr[joint]
        truth = logs.TRUTH[name.split("_")[1]]
        found = {key: float(getattr(model, f"dof_{key}")[dof]) for key in truth}
        assert found["armature"] == pytest.approx(truth["armature"], rel=0.003)
        assert found["damping"] == pytest.approx(truth["damping"], rel=0.003)
        assert found["frictionloss"] == pytest.approx(
            truth["frictionloss"] * (2.0 if name == logs.WORN else 1.0), rel=0.003
        )
        if name.endswith("knee"):
            knees[name] = [*found.values()]
    position = fit.settings["positions"]
    assert position["drive"]["delay_s"][0] == pytest.approx(logs.DELAY_S, abs=1e-5)
    rows = tables(QUADRUPED)[" FL FR"]
    for row, values in zip(rows[:3], zip(*knees.values(), strict=True), strict=True):
        assert [float(cell) for cell in row[1:5]] == pytest.approx(values, rel=0.005)
    for row, key in zip(rows[3:], ("before", "after"), strict=True):
        errors = 1e3 * np.array(position["errors"][key])[2::3]
        np.testing.assert_allclose([float(cell) for cell in row[1:5]], errors, rtol=0.05)


@pytest.mark.slow
def test_nothing_but_attributes_of_joints_changes(twin: Path) -> None:
    old, new = ((twin / name).read_text() for name in ("quadruped.xml", "quadruped_fit.xml"))
    assert new != old
    assert (
        re.sub(r'(<joint) armature="[^"]*" damping="[^"]*" frictionloss="[^"]*" (name=)', r"\1 \2", new)
        == old
    )


@pytest.mark.slow
@pytest.mark.parametrize("step", [None, "0.001"])
def test_mujoco_replays_the_log(
    twin: Path, step: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As exported with steps whose effect is taken off, and exported for a step with that step."""
    monkeypatch.chdir(twin)
    file, options = "quadruped_fit.xml", []
    if step is not None:
        file, options = "short_step.xml", ["--step", step]
        assert main(["export", "fit.json", "--mjcf", "quadruped.xml", "-o", file, "--for-step", step]) == 0
    capsys.readouterr()
    assert (
        main(["validate", "fit.json", "log.toml", "--mujoco", file, "--json", "replay.json", *options]) == 0
    )
    found = json.loads(Path("replay.json").read_text())
    if step is None:
        assert found["ratio"] < 1.1
    else:  # less than a tenth of a milliradian is left of the friction, beside a noise of 0.1
        assert np.sqrt(np.mean(np.square(found["after"]))) < 0.14e-3
    assert np.mean(found["before"]) > 5.0 * np.mean(found["after"])
    told = capsys.readouterr().out
    assert f"The error in MuJoCo is {found['ratio']:.3f} times that of the fit." in told
    assert [line.split()[0] for line in told.splitlines()[1:14]] == [*found["joints"], "all"]
    assert found["step_s"] == pytest.approx(1e-3 if step else 1e-4)
    if step is None:
        assert found["at_file_step"][0] == pytest.approx(1.0 / 600.0)
        assert found["at_file_step"][1] > 2.0 * np.sqrt(np.mean(np.square(found["after"])))
        assert "At the file's own step of 1.667 ms it is" in told


@pytest.mark.slow
def test_the_files_own_values_stay_where_they_are(twin: Path) -> None:
    """The values before are those of the robot file: with them a replay of the exported file is as bad."""
    fit, experiment = didim.Identification.load(twin / "fit.json"), didim.load_experiment(twin / "log.toml")
    found = validate_in_mujoco(fit, experiment, twin / "quadruped.xml")
    assert found.before is not None
    np.testing.assert_allclose(found.after, found.before, rtol=0.6)
    assert not np.allclose(found.after, found.before, rtol=0.01)  # the delay and the offsets are the fit's


@pytest.mark.parametrize(
    "servo",
    [
        '<general joint="j" biastype="affine" gainprm=".2" biasprm="3 -20 0"/>',
        '<position joint="j" kp="5" gear="2"/>',
        '<position tendon="t" kp="80"/>',
    ],
)
def test_servos_whose_commands_are_no_positions_are_replayed_by_their_gains(
    tmp_path: Path, servo: str
) -> None:
    body = '<worldbody><body><joint name="j" axis="0 1 0" damping=".3"/><geom size=".1" pos=".1 0 0"/></body></worldbody>'
    tendon = '<tendon><fixed name="t"><joint joint="j" coef=".5"/></fixed></tendon>'
    drives = Drives((JointDrive(joint="j", kind="revolute", rotor=0.0, viscous=0.3, coulomb=0.0, kp=20.0),))
    commands = np.sin(np.arange(200) / 20.0)[:, None]
    replays = []
    for text in ('<position joint="j" kp="20"/>', servo):
        (tmp_path / "j.xml").write_text(f"<mujoco>{body}{tendon}<actuator>{text}</actuator></mujoco>")
        model = load_model(tmp_path / "j.xml")
        model.opt.timestep = 1e-3
        replays.append(replayed(model, "j.xml", drives, commands, 0.0 * commands, 100.0, 10))
    assert np.ptp(replays[0]) > 0.5
    np.testing.assert_allclose(replays[1], replays[0], atol=1e-12)


@pytest.mark.slow
def test_what_cannot_be_replayed_is_a_sentence(twin: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit, experiment = didim.Identification.load(twin / "fit.json"), didim.load_experiment(twin / "log.toml")
    (twin / "renamed.xml").write_text((twin / "quadruped.xml").read_text().replace('"FL_hip"', '"hip"'))
    with pytest.raises(FitError, match=r"renamed.xml: there is no joint 'FL_hip'"):
        validate_in_mujoco(fit, experiment, twin / "renamed.xml")
    (twin / "broken.xml").write_text("<mujoco><worldbody><body/></worldbody></mujoco>")
    with pytest.raises(FitError, match=r"broken.xml: (MuJoCo cannot load it|there is no joint)"):
        validate_in_mujoco(fit, experiment, twin / "broken.xml")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(FitError, match=r"needs the package mujoco: pip install 'didim\[mujoco\]'"):
        validate_in_mujoco(fit, experiment, twin / "quadruped.xml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--step", "0.001"], "--step takes a positive number of seconds, and is for --mujoco"),
        (["--mujoco", "quadruped_fit.xml", "--report", "r.html"], "--report is for a validation without --mujoco"),
    ],
)  # fmt: skip
def test_wrong_options(
    twin: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(twin)
    assert main(["validate", "fit.json", "log.toml", *options]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_a_real_quadruped(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four commands on the log of a Go2: MuJoCo replays it within 1.1 times the fit's own error, with those of the page."""
    source = shared / "data" / "go2"
    monkeypatch.chdir(tmp_path)
    log, robot = str(source / "traj_0.pt"), str(source / "go2.xml")
    assert main(["init", robot, log, "--kp", "20", "--kv", "1.5", "-o", "go2.toml"]) == 0
    assert main(["identify", "go2.toml", "--method", "cloe", "--json", "fit.json"]) == 0
    assert main(["export", "fit.json", "--mjcf", robot, "-o", "go2_fit.xml"]) == 0
    assert main(["validate", "fit.json", "go2.toml", "--mujoco", "go2_fit.xml", "--json", "replay.json"]) == 0
    found = json.loads(Path("replay.json").read_text())
    assert found["ratio"] < 1.1
    shown = re.search(
        r"rms error of (\S+) mrad with the file and (\S+) mrad with the fit, whose own error is (\S+) mrad",
        words(QUADRUPED),
    )
    assert shown
    for text, key in zip(shown.groups(), ("before", "after", "own"), strict=True):
        assert 1e3 * np.sqrt(np.mean(np.square(found[key]))) == pytest.approx(float(text), rel=0.003)


@pytest.mark.slow
def test_a_hobby_arm(tmp_path: Path) -> None:
    """The page and its example: the servos of the truth come back, and MuJoCo follows a log that was not fitted."""
    text = HOBBY_ARM.read_text(encoding="utf-8").partition("## A LeRobot dataset")[0]
    printed = walked("hobby_arm", text, tmp_path)
    folder = tmp_path / "hobby_arm"
    assert printed["didim check log.toml"].startswith("log: nothing found.\n")
    assert ends_sound(printed["didim identify log.toml --json fit.json"])
    fit, logs = didim.Identification.load(folder / "fit.json"), script(folder / "make_logs.py")
    assert 'unit = "deg" # confirm' in (folder / "log.toml").read_text(encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(folder / "arm_fit.xml"))
    rows = {row[0].split(" (")[0]: row[1:] for row in tables(HOBBY_ARM)[" identified truth"]}
    for name, key in (("armature", "armature"), ("damping", "damping"), ("friction loss", "frictionloss")):
        found, (shown, truth) = getattr(model, f"dof_{key}"), rows[name]
        assert logs.TRUTH[key] == float(truth)
        low, high = (float(cell) for cell in (shown.split(" to ") * 2)[:2])
        margin = 0.0006 if low < high else 0.005 * low
        assert (low - margin < found).all()
        assert (found < high + margin).all()
    delay = fit.settings["positions"]["drive"]["delay_s"][0]
    assert [1e3 * delay, 1e3 * logs.DELAY_S] == pytest.approx(list(map(float, rows["delay"])), abs=0.06)
    training = text.partition("## Training in what you measured")[2]
    errors = [line.split()[-6:] for line in printed["didim validate fit.json other.toml"].splitlines()[1:]]
    assert len(errors) == 4
    assert all(0.4 <= round(float(cell), 1) <= 0.7 for row in errors for cell in row)
    draws_move_mujoco(
        folder, training, np.array([fit.std[list(fit.names).index(f"Ia{j + 1}")] for j in range(6)])
    )
    before, after = rows["rms error of the other log in MuJoCo"][0].split(" and ")
    (replay,) = (out for command, out in printed.items() if "--mujoco" in command)
    assert all_joints(replay) == pytest.approx([float(before), float(after)], rel=0.03)


@pytest.mark.slow
def test_a_hobby_arm_with_a_lerobot_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`init` of docs/hobby_arm.md, and what follows: the drives of the truth come back, and MuJoCo replays the episodes."""
    section = HOBBY_ARM.read_text(encoding="utf-8").partition("## A LeRobot dataset")[2]
    init = re.findall(r"^    didim (init .*)$", section, flags=re.MULTILINE)[0].split()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "so101.xml").write_text(arm_text())
    episodes = arm_episodes(mujoco)
    columns = {key: np.concatenate([one[key] for one in episodes]).astype(np.float32) for key in episodes[0]}
    columns["episode_index"] = np.repeat(
        np.arange(len(episodes)), [len(one["timestamp"]) for one in episodes]
    )
    dataset(tmp_path / "so101_wave", "v3.0", [f"{name}.pos" for name in ARM_MOTORS], columns)
    for arguments in (
        init,
        ["identify", "arm.toml", "--method", "cloe", "--json", "fit.json"],
        ["export", "fit.json", "--mjcf", "so101.xml", "-o", "so101_fit.xml"],
        ["validate", "fit.json", "arm.toml", "--mujoco", "so101_fit.xml", "--json", "replay.json"],
    ):
        assert main(arguments) == 0
    toml = re.findall(r"^```toml\n(.*?)^```$", section, flags=re.DOTALL | re.MULTILINE)[0]
    written = {line.strip() for line in Path("arm.toml").read_text(encoding="utf-8").splitlines()}
    assert {line.partition(" #")[0] for line in toml.splitlines()} <= {
        line.partition(" #")[0] for line in written
    }
    assert json.loads(Path("replay.json").read_text())["ratio"] < 1.1
    model = mujoco.MjModel.from_xml_path("so101_fit.xml")
    np.testing.assert_allclose(model.dof_armature, ARM_TRUTH["armature"], rtol=0.01)
    np.testing.assert_allclose(model.dof_damping, ARM_TRUTH["damping"], rtol=0.01)
    np.testing.assert_allclose(model.dof_frictionloss, ARM_TRUTH["frictionloss"], rtol=0.02)
    drive = didim.Identification.load("fit.json").settings["positions"]["drive"]
    assert drive["delay_s"][0] == pytest.approx(ARM_DELAY_S, abs=0.0002)


def draws_move_mujoco(folder: Path, page: str, spread: np.ndarray) -> None:
    """The program of a page gives a model the draws; their rollouts differ by as much as the draws do, and stay near the fit's."""
    program, *_ = re.findall(r"^```python\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    program = re.sub(r'"(draws\.npz|arm_fit\.xml)"', lambda name: repr(str(folder / name[1])), program)
    scope: dict[str, Any] = {}
    exec(program, scope)
    model, motions, armatures = scope["model"], [], []
    for draw in (None, *range(20)):
        if draw is not None:
            scope["take"](draw)
            armatures.append(model.dof_armature.copy())
        data, moved = mujoco.MjData(model), []
        for k in range(250):
            data.ctrl[:] = 0.3 * (k // 50 % 2)
            mujoco.mj_step(model, data)
            moved.append(data.qpos.copy())
        motions.append(moved)
    values = np.array(motions)
    off = np.abs(values[1:] - values[0]).max(axis=(1, 2))
    assert np.ptp(values[0]) > 0.1
    assert 0.0 < off.min() < off.max() < 5e-3
    np.testing.assert_allclose(np.std(armatures, axis=0), spread, rtol=0.6)


STEPPED = ARM.replace("[unknown]\n", "[unknown]\nkp = { start = 15.0 }\nkv = { start = 0.8 }\n")


@pytest.mark.slow
def test_the_filter_of_an_actuator_is_fitted_and_exported(tmp_path: Path) -> None:
    """The file's own filter is held by default; as an unknown its time constant is found, and written into the file."""
    truth, r = (
        arm_text(truth=True).replace("<position kp", '<position timeconst="0.05" kp'),
        arm_commands(np.random.default_rng(3), 450),
    )
    np.savez(tmp_path / "log.npz", q=followed(mujoco, truth, r, 50.0, ARM_DELAY_S), r=r)
    for seconds, unknown in (("0.05", ""), ("0.03", "lag_s = {}\n")):
        file = arm_text().replace("<position kp", f'<position timeconst="{seconds}" kp')
        (tmp_path / "so101.xml").write_text(file)
        (tmp_path / "arm.toml").write_text(ARM.replace("[unknown]\n", "[unknown]\n" + unknown))
        experiment = didim.load_experiment(tmp_path / "arm.toml")
        fit = didim.identify(experiment, CLOE(threads=1), verbose=False)
        drives = drives_of(fit, "fit")
        assert drives.joints[1].lag_s == pytest.approx(0.05, rel=0.02)
        content, _ = edit_mjcf(drives, tmp_path / "so101.xml")
        (tmp_path / "new.xml").write_bytes(content)
        assert load_model(tmp_path / "new.xml").actuator_dynprm[1, 0] == pytest.approx(0.05, rel=0.02)
        replay = validate_in_mujoco(fit, experiment, tmp_path / "new.xml", step_s=2e-4)
        assert replay.after.max() < 1e-3


def test_a_load_moves_the_centre_of_a_body(tmp_path: Path) -> None:
    """MuJoCo 4 refuses another centre of mass for a body whose own one is at its origin."""
    body = '<body><inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/><joint name="j" axis="0 1 0"/></body>'
    servo = '<position joint="j" kp="10"/>'
    (tmp_path / "one.xml").write_text(
        f"<mujoco><worldbody>{body}</worldbody><actuator>{servo}</actuator></mujoco>"
    )
    drives = Drives((JointDrive(joint="j", kind="revolute", rotor=0.0, viscous=0.0, coulomb=0.0),))
    load = np.array([1e-4, 0.0, 0.0, 0.01, 0.0, 0.01, 0.1, 0.0, 0.0, 1.0])  # 1 kg, 0.1 m along x
    logged = Logged(cast("Any", None), {}, np.ones(1), load, 0)
    model, _ = _loaded(load_model(tmp_path / "one.xml"), "one.xml", drives, logged)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.qfrc_bias[0] == pytest.approx(-9.81 * 0.1)


@pytest.mark.slow
def test_the_step_of_the_truth_is_taken_off(tmp_path: Path) -> None:
    """A log by MuJoCo at 2 ms, whose servos saturate: what is left is the noise, and the drives for that step are the truth."""
    step = 0.002
    rng = np.random.default_rng(3)
    r = arm_commands(rng)
    q = followed(mujoco, arm_text(truth=True), r, 50.0, 0.02, step)
    np.savez(tmp_path / "log.npz", q=q + 1e-4 * rng.standard_normal(q.shape), r=r)
    (tmp_path / "so101.xml").write_text(arm_text())
    (tmp_path / "arm.toml").write_text(STEPPED)
    fit = didim.identify(didim.load_experiment(tmp_path / "arm.toml"), CLOE(threads=1), verbose=False)
    assert fit.settings["positions"]["soft"]
    assert not [finding for finding in fit.evidence if finding.code == "model-error"]
    found = for_step(drives_of(fit, "fit.json"), step, "implicitfast").joints
    truth = {"rotor": 0.028, "viscous": 0.6, "coulomb": 0.12, "kp": 17.8, "kv": 0.5}
    for name, value in truth.items():
        np.testing.assert_allclose([getattr(drive, name) for drive in found], value, rtol=0.01, err_msg=name)
    assert found[0].delay_s == pytest.approx(0.02, abs=1e-4)


@pytest.mark.slow
def test_a_replay_in_short_steps_has_no_error_of_its_own(tmp_path: Path) -> None:
    """A replay leaves the error of the fit to a log by MuJoCo without noise, a few urad, also where the file has implicit steps."""
    steps = arm_text(truth=True).replace("implicitfast", "RK4")
    r = arm_commands(np.random.default_rng(3), 400)
    np.savez(tmp_path / "log.npz", q=followed(mujoco, steps, r, 50.0, 0.02, 5e-4), r=r)
    (tmp_path / "so101.xml").write_text(arm_text())
    (tmp_path / "arm.toml").write_text(ARM)
    experiment = didim.load_experiment(tmp_path / "arm.toml")
    fit = didim.identify(experiment, CLOE(threads=1), verbose=False)
    fit.save(tmp_path / "fit.json")
    drives = drives_of(fit, "fit.json")
    for integrator in ("implicitfast", "RK4"):
        (tmp_path / "so101.xml").write_text(arm_text().replace("implicitfast", integrator))
        content, _ = edit_mjcf(drives, tmp_path / "so101.xml")
        (tmp_path / "new.xml").write_bytes(content)
        found = validate_in_mujoco(fit, experiment, tmp_path / "new.xml")
        assert found.ratio is not None
        assert found.ratio < 1.05
        # In steps of the file Runge and Kutta's method loses next to nothing, the implicit one 0.7 mrad.
        lost = 0.0 if found.at_file_step is None else found.at_file_step[1]
        assert (lost < 5e-6) == (integrator == "RK4")
