"""``didim check`` names planted defects by kind, joint, column and sample, and is silent on clean logs."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import Experiment, Recording, SignalProcessing, check, load_experiment
from didim.cli.main import main
from didim.diagnosis.finding import Findings
from didim.diagnosis.limits import check_limits
from didim.errors import FitError
from didim.evidence.lasting import friction_findings
from didim.evidence.rows import LogRows
from didim.evidence.torques import constant_torque_findings
from didim.loop.reference import Reference
from didim.methods.measured import law_along
from didim.result.finding import Finding, worded
from didim.result.sentences import WORDS
from didim.result.words.causes import CAUSES
from didim.robot.robot import JointLimits
from didim.signal.window import Window
from didim.studies.simulated_log import PACKAGED, measured, packaged_experiment, simulated_log
from friction_logs import subject
from planted import SIGNAL, Log, log_of, tx40_exact
from simulated import experiment
from test_documented import tables

Array = NDArray[np.float64]
REDUCTION = didim.load_robot("tx40").reduction
DIGITAL = "sample_time_s = 0.001\ndelay_samples = 1\nvelocity_fir = [0.5, 0.5]\n"


@pytest.fixture(scope="module")
def exact() -> Experiment:
    return tx40_exact()


@pytest.fixture(scope="module")
def tx40(exact: Experiment) -> Log:
    """Six joints, two of them coupled, where the number of joints or their coupling is the point, for 10 s: 2 s a check."""
    return log_of(exact)


@pytest.fixture(scope="module")
def short_tx40(tx40: Log) -> Log:
    """Five seconds of it, which show most defects as well."""
    return replace(tx40, t=tx40.t[:5001], q=tx40.q[:5001], tau=tx40.tau[:5001])


@pytest.fixture(scope="module")
def log(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Log:
    """The planar arm without the delays of its digital controller, for 5 s at 1 kHz: 0.1 s a check."""
    text = (project / "examples" / "planar2_simulation.toml").read_text(encoding="utf-8")
    assert text.count(DIGITAL) == 1
    file = tmp_path_factory.mktemp("planar2") / "arm.toml"
    file.write_text(text.replace(DIGITAL, "").replace("rate_hz = 500", "rate_hz = 1000"), encoding="utf-8")
    experiment = load_experiment(file)
    parameters = experiment.robot.parameter_set("reference")
    return log_of(simulated_log(experiment, parameters, noise=False), robot="planar2")


@pytest.fixture(scope="module")
def arm(project: Path) -> Experiment:
    """The planar arm without noise, of which `measured` makes logs with encoder steps."""
    experiment = load_experiment(project / "examples" / "planar2_simulation.toml")
    signal = SignalProcessing(cutoff_hz=50, trim_start=50, trim_end=50, decimation=(10,))
    experiment = replace(experiment, signal=signal)
    return simulated_log(experiment, experiment.robot.parameter_set("reference"), noise=False)


def scaled(joint: int, q: float = 1.0, tau: float = 1.0) -> Callable[[Array, Array], object]:
    """Position and torque of a joint times factors: a sign, a gain; a gear ratio that is declared too small is (f, 1 / f)."""

    def plant(positions: Array, torques: Array) -> None:
        positions[:, joint - 1] *= q
        torques[:, joint - 1] *= tau

    return plant


def exchanged(i: int, j: int, *keys: str) -> Callable[[Array, Array], object]:
    def plant(q: Array, tau: Array) -> None:
        for key, values in (("q", q), ("tau", tau)):
            if key in keys:
                values[:, [i - 1, j - 1]] = values[:, [j - 1, i - 1]]

    return plant


def stuck(joint: int, start: int, stop: int) -> Callable[[Array, Array], object]:
    def plant(q: Array, tau: Array) -> None:
        q[start:stop, joint - 1] = q[start, joint - 1]

    return plant


def late(log: Log, samples: int) -> Log:
    return replace(log, t=log.t[samples:], q=log.q[samples:], tau=log.tau[:-samples])


def without(log: Log, start: int, stop: int) -> Log:
    kept = np.r_[0:start, stop : len(log.t)]
    return replace(log, t=log.t[kept], q=log.q[kept], tau=log.tau[kept])


def every(log: Log, step: int) -> Log:
    return replace(log, t=log.t[::step], q=log.q[::step], tau=log.tau[::step], rate_hz=1000.0 / step)


def on_motor_side(log: Log, reduction: Array | None = REDUCTION) -> Log:
    assert reduction is not None
    return replace(log, q=log.q @ reduction.T, tau=log.tau @ np.linalg.inv(reduction))


def clip(joint: int, limit: float) -> Callable[[Array, Array], object]:
    def plant(q: Array, tau: Array) -> None:
        tau[:, joint - 1] = np.clip(tau[:, joint - 1], -limit, limit)

    return plant


def alone(found: Findings, kind: str, joints: tuple[int, ...] = ()) -> Finding:
    """The one finding, which must be of this kind and of these joints."""
    assert [(item.kind, item.joints) for item in found] == [(kind, joints)], str(found)
    return found[0]


def test_nothing_is_found_on_a_clean_log(
    log: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = log.write(tmp_path)
    assert main(["check", str(path), "--json", str(tmp_path / "found.json")]) == 0
    assert capsys.readouterr().out == "log: nothing found.\n"
    found = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert found == {"schema": 1, "experiment": "log", "findings": [], "closed_loop": [], "notes": []}
    assert not check(replace(log, timed=False).write(tmp_path))
    assert not check(path, "reference")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "signal"),
    [
        (1, SignalProcessing(cutoff_hz=60, trim_start=50, trim_end=50, decimation=(5, 10))),
        (2, SignalProcessing(cutoff_hz=30, trim_start=50, trim_end=50, decimation=(10,))),
        (3, SignalProcessing(cutoff_hz=150, trim_start=50, trim_end=50, decimation=(20,))),
    ],
)
def test_other_noise_and_filters_raise_no_alarm(
    exact: Experiment, seed: int, signal: SignalProcessing
) -> None:
    assert not check(replace(measured(exact, seed), signal=signal))


@pytest.mark.parametrize("seed", range(4))
def test_another_robot_raises_no_alarm(arm: Experiment, seed: int) -> None:
    assert not check(measured(arm, seed))


def test_logs_without_noise_raise_no_alarm(arm: Experiment) -> None:
    assert not check(arm)


@pytest.mark.parametrize(
    ("factor", "declared", "real", "advice"),
    [
        (180.0 / np.pi, "rad", "deg", 'unit = "deg"'),
        (1.0, "deg", "rad", 'unit = "rad"'),
        (1e3, "rad", "mrad", "scale = 0.001 under [recording.position]"),
    ],
)
def test_positions_in_another_unit(
    log: Log, tmp_path: Path, factor: float, declared: str, real: str, advice: str
) -> None:
    path = replace(log, q=factor * log.q, unit=declared).write(tmp_path)
    item = alone(check(path), "unit", (1, 2))
    assert f"were in {real}, not in {declared}" in item.sentence
    assert advice in item.advice
    right = (
        advice.partition(" under")[0]
        if "unit" in advice
        else f'unit = "rad"\n{advice.partition(" under")[0]}'
    )
    path.write_text(path.read_text(encoding="utf-8").replace(f'unit = "{declared}"', right), encoding="utf-8")
    assert not check(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "kind", "joints"),
    [(scaled(6, tau=-1.0), "torque-sign", (6,)), (exchanged(2, 5, "tau"), "swapped-torques", (2, 5))],
)
def test_torques_of_six_joints(
    short_tx40: Log,
    tmp_path: Path,
    plant: Callable[[Array, Array], object],
    kind: str,
    joints: tuple[int, ...],
) -> None:
    alone(check(short_tx40.change(plant).write(tmp_path)), kind, joints)


def test_wrong_sign_of_a_small_robot(arm: Experiment) -> None:
    (recording,) = measured(arm).recordings
    assert recording.tau is not None
    for joint in (1, 2):
        tau = recording.tau * np.where(np.arange(2) == joint - 1, -1.0, 1.0)
        alone(check(replace(arm, recordings=(replace(recording, tau=tau),))), "torque-sign", (joint,))
    item = alone(
        check(replace(arm, recordings=(replace(recording, tau=-recording.tau),))), "torque-sign", (1, 2)
    )
    assert item.facts["friction"]


@pytest.mark.parametrize(
    ("plant", "kind", "joints"),
    [
        (scaled(1, q=-1.0), "position-sign", (1,)),
        (scaled(2, q=-1.0, tau=-1.0), "joint-sign", (2,)),
        (exchanged(1, 2, "tau"), "swapped-torques", (1, 2)),
        (exchanged(1, 2, "q"), "swapped-positions", (1, 2)),
        (exchanged(1, 2, "q", "tau"), "swapped-joints", (1, 2)),
    ],
)
def test_signs_and_exchanged_columns(
    log: Log, tmp_path: Path, plant: Callable[[Array, Array], object], kind: str, joints: tuple[int, ...]
) -> None:
    alone(check(log.change(plant).write(tmp_path)), kind, joints)


def test_motor_side_declared_as_joint_side(log: Log, tmp_path: Path) -> None:
    """The second motor of this arm turns with the first joint."""
    reduction = np.array([[50.0, 0.0], [10.0, 40.0]])
    text = (PACKAGED.parent / "robots" / "planar2.toml").read_text(encoding="utf-8")
    (tmp_path / "geared.toml").write_text(
        f"{text}\n[transmission]\nreduction = {reduction.tolist()}\n", encoding="utf-8"
    )
    log = replace(log, robot="geared.toml")
    item = alone(check(on_motor_side(log, reduction).write(tmp_path)), "side")
    assert "positions and torques look like those of the motors" in item.sentence
    assert 'side = "motor"' in item.advice
    motor_torques = replace(log, tau=on_motor_side(log, reduction).tau)
    item = alone(check(motor_torques.write(tmp_path)), "side")
    assert "the torques look like those of the motors" in item.sentence
    item = alone(check(replace(log, side="motor").write(tmp_path)), "side")
    assert "those of the joints, not of the motors" in item.sentence


@pytest.mark.slow
def test_a_log_of_the_motors_is_clean(short_tx40: Log, tmp_path: Path) -> None:
    assert not check(replace(on_motor_side(short_tx40), side="motor").write(tmp_path))


@pytest.mark.parametrize("samples", [5, -3])
def test_delay(log: Log, tmp_path: Path, samples: int) -> None:
    early = replace(log, t=log.t[:samples], q=log.q[:samples], tau=log.tau[-samples:])
    spoiled = late(log, samples) if samples > 0 else early
    item = alone(check(spoiled.write(tmp_path)), "delay")
    # The estimate is one of filtered motion (docs/check.md): half a sample is its bias here.
    assert item.value == pytest.approx(samples, abs=0.8)
    assert ("behind" if samples > 0 else "ahead of") in item.sentence
    compensated = replace(spoiled, more="", signal=f"{SIGNAL}\n[delay]\ncompensate_samples = {samples}\n")
    assert not check(compensated.write(tmp_path))


@pytest.mark.slow
def test_delay_of_the_wrist(tx40: Log, tmp_path: Path) -> None:
    def wrist(q: Array, tau: Array) -> None:
        tau[:, 3:] = np.roll(tau[:, 3:], 5, axis=0)

    item = alone(check(tx40.change(wrist).write(tmp_path)), "delay", (4, 5, 6))
    assert item.value == pytest.approx(5.0, abs=0.3)


@pytest.mark.parametrize(("start", "stop"), [(1500, 1900), (4300, 5001), (0, 700)])
def test_stuck_encoder(log: Log, tmp_path: Path, start: int, stop: int) -> None:
    item = alone(check(log.change(stuck(2, start, stop)).write(tmp_path)), "stuck", (2,))
    assert (item.file, item.column, item.sample, item.last_sample) == ("log.csv", "q2", start, stop - 1)


def test_dead_encoder(log: Log, tmp_path: Path) -> None:
    item = alone(check(log.change(stuck(2, 0, 5001)).write(tmp_path)), "excitation", (2,))
    assert "its encoder is dead" in item.advice


@pytest.mark.parametrize("limit", [5.0, 9.0])
def test_clipped_torque(log: Log, tmp_path: Path, limit: float) -> None:
    item = alone(check(log.change(clip(2, limit)).write(tmp_path)), "clipped", (2,))
    assert (item.file, item.column) == ("log.csv", "tau2")
    assert item.sample == int(np.argmax(np.abs(log.tau[:, 1]) >= limit))
    assert f"{limit:g}" in item.sentence


@pytest.mark.slow
def test_clipped_current_of_a_motor_is_found_behind_the_coupling(short_tx40: Log, tmp_path: Path) -> None:
    motors = replace(on_motor_side(short_tx40), side="motor")
    clipped = motors.change(clip(5, 0.8 * np.abs(motors.tau[:, 4]).max()))
    item = alone(check(clipped.write(tmp_path)), "clipped", (5,))
    assert "motor 5" in item.sentence
    assert item.column == "tau5"


def test_gaps(log: Log, tmp_path: Path) -> None:
    item = alone(check(without(log, 2000, 2007).write(tmp_path)), "gap")
    assert (item.file, item.sample) == ("log.csv", 1999)
    assert "7 samples are missing after row 2000" in item.sentence
    found = check(without(without(log, 4000, 4001), 2000, 2007).write(tmp_path))
    assert [(item.kind, item.sample) for item in found] == [("gap", 1999), ("gap", 3992)]


def test_gap_without_time_stamps(log: Log, tmp_path: Path) -> None:
    spoiled = replace(without(log, 2000, 2007), timed=False)
    item = alone(check(spoiled.write(tmp_path)), "gap", (1, 2))
    assert item.sample is not None
    assert abs(item.sample - 1999) <= 1


def test_glitch_of_one_encoder(log: Log, tmp_path: Path) -> None:
    def plant(q: Array, tau: Array) -> None:
        q[2500, 1] += 0.01

    item = alone(check(log.change(plant).write(tmp_path)), "jump", (2,))
    assert item.column == "q2"
    assert item.sample is not None
    assert abs(item.sample - 2500) <= 1


def test_uneven_time_stamps(log: Log, tmp_path: Path) -> None:
    t = log.t + 1e-4 * np.random.default_rng(0).uniform(-1.0, 1.0, len(log.t))
    item = alone(check(replace(log, t=t).write(tmp_path)), "uneven-time")
    assert "sampling is uneven after row" in item.sentence
    t = log.t.copy()
    t[70] = t[69]
    item = alone(check(replace(log, t=t).write(tmp_path)), "uneven-time")
    assert "time does not grow from row 70" in item.sentence


def test_wrong_rate(log: Log, tmp_path: Path) -> None:
    item = alone(check(replace(log, rate_hz=500.0).write(tmp_path)), "rate")
    assert item.value == pytest.approx(1000.0)
    assert "rate of 1000 Hz, rate_hz says 500 Hz" in item.sentence
    item = alone(check(replace(log, rate_hz=500.0, timed=False).write(tmp_path)), "rate")
    assert item.value == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_joint_that_does_not_move(tmp_path: Path) -> None:
    source = (PACKAGED / "tx40.toml").read_text(encoding="utf-8")
    assert "2.0, 3.5, 1.9" in source
    (tmp_path / "still.toml").write_text(source.replace("2.0, 3.5, 1.9", "2.0, 1e-6, 1.9"), encoding="utf-8")
    experiment = load_experiment(tmp_path / "still.toml")
    still = simulated_log(experiment, experiment.robot.parameter_set("didim"), noise=False)
    item = alone(check(log_of(still).write(tmp_path)), "excitation", (4,))
    assert {"Ia4", "Fv4", "Fc4"} <= set(item.parameters)
    # What belongs to other joints is told as well as before.
    assert not {"ZZ1R", "Fv3", "Fc5", "Ia6"} & set(item.parameters)


def test_too_slow_a_recording(tx40: Log, tmp_path: Path) -> None:
    slow = every(tx40, 50)
    item = check(slow.write(tmp_path))[0]
    assert (item.kind, item.value) == ("too-slow", 20.0)
    slow_filters = replace(slow, signal="\n[signal]\ncutoff_hz = 5\n")
    assert [item.kind for item in check(slow_filters.write(tmp_path))] == ["too-slow"]


@pytest.mark.parametrize(
    ("step", "signal", "kind", "words"),
    [
        (2, "cutoff_hz = 250", "too-slow", "cut-off of 250 Hz"),
        (1, "cutoff_hz = 60\ntrim_start = 4000\ntrim_end = 2000", "signal", "trimming 4000 and 2000 samples leaves nothing"),
    ],
)  # fmt: skip
def test_filters_that_do_not_suit_the_log(
    log: Log, tmp_path: Path, step: int, signal: str, kind: str, words: str
) -> None:
    spoiled = replace(every(log, step), signal=f"\n[signal]\n{signal}\n")
    assert words in alone(check(spoiled.write(tmp_path)), kind).sentence


@pytest.mark.parametrize(
    ("joint", "factor", "known"),
    [(1, 0.9, None), (2, 1.25, None), (1, 0.9, "reference"), (2, 0.9, "reference")],
)
def test_wrong_gear_ratio(log: Log, tmp_path: Path, joint: int, factor: float, known: str | None) -> None:
    path = log.change(scaled(joint, factor, 1.0 / factor)).write(tmp_path)
    item = alone(check(path, known), "gear-ratio", (joint,))
    assert item.value == pytest.approx(factor, rel=0.02 if known else 0.03)


@pytest.mark.slow
def test_gears_that_stand_for_each_other_are_both_named(tx40: Log, tmp_path: Path) -> None:
    """With rows at 50 Hz the gear of joint 6 and the reciprocal factor at joint 5 leave nearly the same residual."""
    spoiled = replace(tx40.change(scaled(6, 0.9, 1.0 / 0.9)), signal=SIGNAL.replace("[5, 10]", "[5, 4]"))
    item = alone(check(spoiled.write(tmp_path)), "gear-ratio", (6,))
    (tie,) = item.facts["ties"]
    assert (tie["code"], tie["joints"]) == ("gear-ratio", [5])
    assert tie["value"] == pytest.approx(1.11, abs=0.01)
    assert item.value == pytest.approx(0.9, abs=0.01)
    assert "this log does not show which" in item.advice


def test_wrong_gain_of_one_joint_with_the_fit_of_another_log(
    arm: Experiment, log: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = didim.identify(measured(arm, 5))
    fit.save(tmp_path / "fit.json")
    path = log.change(scaled(2, tau=1.25)).write(tmp_path)
    assert main(["check", str(path), "--parameters", str(tmp_path / "fit.json")]) == 1
    shown = capsys.readouterr().out
    assert shown.startswith("log: 1 finding\n- drive-gain: the torque of joint 2")
    item = alone(check(path, fit), "drive-gain", (2,))
    assert item.value == pytest.approx(1.25, rel=0.02)
    alone(check(path, fit.parameters), "drive-gain", (2,))


def test_several_defects_are_told_together(short_tx40: Log, tmp_path: Path) -> None:
    spoiled = without(short_tx40.change(scaled(3, tau=-1.0)).change(clip(2, 40.0)), 2000, 2007)
    assert {item.kind for item in check(spoiled.write(tmp_path))} == {"gap", "clipped", "torque-sign"}


def test_limits(exact: Experiment, arm: Experiment) -> None:
    (recording,) = measured(arm).recordings
    assert recording.tau is not None
    robot = arm.robot
    narrow = replace(robot.limits[1], velocity=1.0)
    robot = replace(robot, limits=(robot.limits[0], narrow))
    item = alone(check(replace(arm, robot=robot, recordings=(recording,))), "limits", (2,))
    assert "the speed of joint 2 reaches" in item.sentence
    turns = np.column_stack([recording.q[:, 0] + np.linspace(0.0, 60.0, len(recording.q)), recording.q[:, 1]])
    found = check(replace(arm, recordings=(replace(recording, q=turns),)))
    assert ("range", (1,)) in [(item.kind, item.joints) for item in found]


def test_coarse_channel(log: Log, tmp_path: Path) -> None:
    def plant(q: Array, tau: Array) -> None:
        tau[:, 1] = np.round(tau[:, 1])

    item = alone(check(log.change(plant).write(tmp_path)), "quantised", (2,))
    assert item.column == "tau2"


def test_log_without_torques(exact: Experiment) -> None:
    (recording,) = exact.recordings
    bare = Recording.from_arrays(recording.q, rate_hz=recording.rate_hz)
    alone(check(replace(exact, recordings=(bare,))), "no-torque")


def test_wrong_input(log: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log.write(tmp_path)
    assert main(["check", str(tmp_path / "none.toml")]) == 2
    assert main(["check", str(path), "--parameters", "none"]) == 2
    assert "no parameter set 'none'" in capsys.readouterr().err
    with pytest.raises(FitError, match="must be 28 finite numbers"):
        check(path, np.zeros(5))


def test_findings_as_json(log: Log, tmp_path: Path) -> None:
    path = log.change(stuck(2, 1500, 1900)).write(tmp_path)
    assert main(["check", str(path), "--json", str(tmp_path / "found.json")]) == 1
    (item,) = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))["findings"]
    assert (item["kind"], item["joints"], item["column"], item["sample"]) == ("stuck", [2], "q2", 1500)
    assert item["sentence"]
    assert item["advice"]


@pytest.mark.slow
def test_real_logs(project: Path, shared: Path) -> None:
    assert not check(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    assert not check(project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40")
    # The arm rests: without a dead zone the noise decides (docs/published.md).
    item = alone(
        check(project / "examples" / "tx40_log.toml", data=shared / "data" / "tx40"),
        "standstill",
        (1, 2, 3, 4, 5, 6),
    )
    assert "dead_zone_rad_s" in item.advice


@pytest.mark.slow
def test_wrong_sign_in_a_real_log(project: Path, shared: Path) -> None:
    """Of the wrist, whose torques are the smallest; another joint is in tests/test_evidence_causes.py."""
    experiment = load_experiment(project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40")
    (recording,) = experiment.recordings
    assert recording.tau is not None
    tau = recording.tau * np.where(np.arange(6) == 5, -1.0, 1.0)
    alone(check(replace(experiment, recordings=(replace(recording, tau=tau),))), "torque-sign", (6,))


def test_every_kind_is_documented(project: Path) -> None:
    """Those that have words in the table of causes, and those that are named where they are found."""
    rows = tables(project / "docs" / "check.md")["kind observation what to do"]
    named = {name.strip("` ") for row in rows for name in row[0].split(",")}
    package = project / "python" / "didim"
    sources = [*sorted((package / "diagnosis").glob("*.py")), package / "evidence" / "standstill.py"]
    own = {kind for path in sources for kind in re.findall(r'kind="([a-z-]+)"', path.read_text("utf-8"))}
    assert {*CAUSES, *own} <= named
    assert named <= {*CAUSES, *own, *WORDS, "payload", "drift", "gap", "uneven-time"}


def test_the_files_of_these_tests_say_what_they_should(tx40: Log, tmp_path: Path) -> None:
    content = tomllib.loads(tx40.write(tmp_path).read_text(encoding="utf-8"))
    assert content["recording"][0]["position"]["columns"] == [f"q{k}" for k in range(1, 7)]
    assert np.allclose(load_experiment(tmp_path / "log.toml").recordings[0].q, tx40.q, rtol=1e-9, atol=1e-15)


def test_names_of_joints_stand_below_the_findings() -> None:
    found = worded(kind="gap", sentence="joint 2 jumps", advice="Look at it", joints=(2,))
    named = Findings("log", (found,), ("shoulder", "elbow"))
    assert str(named).splitlines()[-1] == "joints: 2 elbow"
    assert len(str(Findings("log", (found,))).splitlines()) == 2


@pytest.mark.parametrize("value", [0.0, 2.5])
def test_a_dead_torque_sensor(arm: Experiment, value: float) -> None:
    """One finding, and nothing compared with the model; `identify` calls its result wrong for it."""
    (recording,) = measured(arm).recordings
    assert recording.tau is not None
    dead = replace(recording, tau=np.where(np.arange(2) == 1, value, recording.tau))
    alone(check(replace(arm, recordings=(dead,))), "constant-torque", (2,))
    fit = didim.identify(replace(arm, recordings=(dead,)))
    assert fit.verdict.state.value == "wrong"
    (reason,) = [reason for reason in fit.verdict.reasons if reason.code == "constant-torque"]
    assert reason.joints == (2,)
    assert reason.sentence.endswith(f"the torque of joint 2 is constant in all {len(recording.tau)} samples")


def test_torques_that_are_all_zero(arm: Experiment) -> None:
    (recording,) = measured(arm).recordings
    assert recording.tau is not None
    dead = replace(arm, recordings=(replace(recording, tau=0.0 * recording.tau),))
    assert [(item.kind, item.joints) for item in check(dead)] == [
        ("constant-torque", (1, 2)),
    ]
    assert didim.identify(dead).verdict.state.value == "wrong"


def test_a_dead_torque_sensor_of_a_motor_is_found_behind_the_coupling(tx40: Log, tmp_path: Path) -> None:
    def plant(q: Array, tau: Array) -> None:
        tau[:, 4] = 0.7

    motors = replace(on_motor_side(tx40), side="motor").change(plant).write(tmp_path)
    item = alone(check(motors), "constant-torque")
    assert "the torque of motor 5 is constant" in item.sentence
    assert (item.file, item.column) == ("log.csv", "tau5")
    assert item.sentence.endswith("(column tau5 of log.csv)")
    (reason,) = constant_torque_findings(load_experiment(motors))
    assert "the torque of motor 5 is constant" in reason.sentence


def backwards(log: Log, *keys: str) -> Log:
    return replace(log, **{key: getattr(log, key)[:, ::-1] for key in keys})


@pytest.mark.slow
@pytest.mark.parametrize("keys", [("q", "tau"), ("q",), ("tau",)])
def test_columns_that_begin_with_the_last_joint(
    short_tx40: Log, tmp_path: Path, keys: tuple[str, ...]
) -> None:
    item = alone(check(backwards(short_tx40, *keys).write(tmp_path)), "reversed-order")
    words = " and ".join({"q": "positions", "tau": "torques"}[key] for key in keys)
    assert item.sentence.startswith(f"the {words} look reversed, the last joint first")
    for key, table in (("q", "[recording.position]"), ("tau", "[recording.torque]")):
        assert (table in item.advice) == (key in keys)


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "ratio"), [("rad", 100.0), ("deg", 30.0)])
def test_motors_behind_gears_that_no_file_has(
    short_tx40: Log, tmp_path: Path, unit: str, ratio: float
) -> None:
    """One line for one cause, where each joint was far beyond its range before."""
    log = replace(short_tx40, q=ratio * short_tx40.q, tau=short_tx40.tau / ratio, unit=unit)
    item = alone(check(log.write(tmp_path)), "side")
    assert item.facts["ratio"] == pytest.approx(ratio, rel=0.02)
    assert f"behind gears of about {item.facts['ratio']:.3g}, not of the joints" in item.sentence
    assert "the gear ratios under [transmission]" in item.advice


@pytest.mark.slow
def test_radians_of_motors_declared_as_degrees_of_joints(short_tx40: Log, tmp_path: Path) -> None:
    """By the gears of the robot file."""
    item = alone(check(replace(on_motor_side(short_tx40), unit="deg").write(tmp_path)), "side")
    assert "those of the motors, in rad, not of the joints" in item.sentence
    assert 'unit = "rad" for the positions' in item.advice


@pytest.mark.parametrize("known", ["the parameter set", "the limits", "neither"])
@pytest.mark.parametrize("factor", [1.0, 10.0, 1000.0])
def test_torques_in_millinewton_metres(
    log: Log, project: Path, tmp_path: Path, known: str, factor: float
) -> None:
    """A fit does not see them; the parameters of the robot file do, or its limits, and no line a joint is left."""
    text = (project / "python/didim/packaged/robots/planar2.toml").read_text(encoding="utf-8")
    if known != "the parameter set":
        text = text[: text.index("[parameters.")]
    if known == "neither":
        text = re.sub(r", torque_n_m = [0-9.]+", "", text)
    (tmp_path / "arm.toml").write_text(text, encoding="utf-8")
    found = check(replace(log, tau=factor * log.tau, robot="arm.toml").write(tmp_path))
    if factor == 1000.0 and known != "neither":
        item = alone(found, "torque-unit", (1, 2))
        assert item.grade == "wrong"
        assert "1000 times too large, as if they were in mN.m, not in N.m" in item.sentence
        assert "scale = 0.001 under [recording.torque]" in item.advice
    else:
        assert {item.kind for item in found} <= {"limits"}
    if known == "the parameter set":
        with_parameters = check(replace(log, tau=factor * log.tau).write(tmp_path), "reference")
        assert [item.kind for item in with_parameters][:1] == {1.0: [], 10.0: ["drive-gain"]}.get(
            factor, ["torque-unit"]
        ) or factor == 10.0


@pytest.mark.slow
@pytest.mark.parametrize("declared", ["kr16", "ur5e"])
def test_another_included_robot_is_named(short_tx40: Log, tmp_path: Path, declared: str) -> None:
    item = alone(check(replace(short_tx40, robot=declared).write(tmp_path)), "another-robot")
    assert item.facts["robot"] == "tx40"
    assert f"the log fits the included robot 'tx40' better than '{declared}'" in item.sentence
    assert 'robot = "tx40"' in item.advice


def test_limits_of_many_joints_are_one_line() -> None:
    log = packaged_experiment("tx40")
    n = log.robot.n_dof
    limits = tuple(JointLimits(position=(-1.0, 1.0), velocity=1.0, effort=1.0) for _ in range(n))
    robot = replace(log.robot, limits=limits)
    t = np.arange(400) / 1000.0
    q = np.sin(2.0 * t)[:, None] * np.ones(n)

    def part(joints: int) -> Window:
        mask = np.arange(n) < joints
        values: dict[str, Any] = {"q": 2.0 * q * mask, "dq": 3.0 * q * mask, "ddq": q, "tau": 4.0 * q * mask}
        return Window(name="log", place="log", rate_hz=1000.0, **values)

    for joints, lines in ((0, 0), (1, 3), (2, 6), (3, 3), (6, 3)):
        found = check_limits(replace(log, robot=robot), [part(joints)])
        assert len(found) == lines
        assert all(len(item.joints) == (joints if joints > 2 else 1) for item in found)
    assert "the torques of joints 1, 2, 3, 4, 5 and 6 are beyond the limits of robot" in found[-1].sentence
    far = check_limits(replace(log, robot=robot), [replace(part(6), q=100.0 * q)])
    (item,) = [each for each in far if each.kind == "range"]
    assert item.joints == (1, 2, 3, 4, 5, 6)


def stop_and_go(seed: int, dead_zone: float = 0.0) -> Experiment:
    """Return a log whose arm stops for half a second in every 1.5 s, held by half of the friction of its last motion."""
    plain, x, rate_hz = didim.load_robot("planar2"), subject().x, 500.0
    t = np.arange(int(20.0 * rate_hz)) / rate_hz
    pace = np.clip(1.5 * np.sin(2.0 * np.pi * t / 1.5) + 0.6, 0.0, 1.0)
    reference = Reference.random_fourier(harmonics=10, period_s=10.0, seed=seed, **subject().motion)
    q, dq, ddq = reference.at(np.cumsum(pace) / rate_hz % 10.0)
    faster = (np.gradient(pace) * rate_hz)[:, None]
    dq, ddq = dq * pace[:, None], ddq * pace[:, None] ** 2 + dq * faster
    tau = didim.inverse_dynamics(plain, q, dq, ddq, x)
    for k in np.flatnonzero(pace == 0.0):
        tau[k] += 0.5 * subject().fc * np.sign(dq[np.flatnonzero(pace[:k])[-1]])
    rng = np.random.default_rng(seed)
    q, tau = (
        values + size * rng.standard_normal(q.shape)
        for values, size in ((q, 2e-6), (tau, 0.05 * subject().fc))
    )
    recording = Recording.from_arrays(q, tau, rate_hz=rate_hz, name="log")
    signal = SignalProcessing(cutoff_hz=50.0, trim_start=25, trim_end=25, decimation=(10,))
    zoned = replace(plain, friction=replace(plain.friction, dead_zone=(dead_zone,) * plain.n_dof))
    return experiment(zoned, recording, signal=signal)


def test_the_verdict_knows_the_standstill_of_check() -> None:
    """It is doubtful where parameters move without the rows at rest, and a dead zone heals it."""
    log = stop_and_go(1)
    assert "standstill" in {item.kind for item in check(log)}
    (found,) = [item for item in didim.identify(log).verdict.reasons if item.code == "standstill"]
    assert found.grade == "doubtful"
    assert found.facts["sigmas"] > 3.0
    assert found.joints == (1, 2)
    healed = stop_and_go(1, 0.01)
    assert "standstill" not in {item.kind for item in check(healed)}
    assert "standstill" not in {item.code for item in didim.identify(healed).verdict.reasons}
    (slight,) = [item for item in didim.identify(stop_and_go(2)).verdict.reasons if item.code == "standstill"]
    assert slight.grade == "note"


@pytest.fixture(scope="module")
def plain_arm(project: Path) -> Experiment:
    experiment = load_experiment(project / "examples" / "planar2_simulation.toml")
    signal = SignalProcessing(cutoff_hz=50, trim_start=50, trim_end=50, decimation=(10,))
    return replace(experiment, signal=signal)


def planar_log(plain_arm: Experiment, **values: float) -> Experiment:
    """A log of the planar plain_arm with other parameters."""
    x = plain_arm.robot.parameter_set("reference").copy()
    for name, value in values.items():
        x[plain_arm.robot.parameter_names.index(name)] = value
    return measured(simulated_log(plain_arm, x, noise=False), 1)


def test_joints_that_share_nothing_are_noted_and_are_no_finding(plain_arm: Experiment) -> None:
    found = check(planar_log(plain_arm, MX2=0.0, ZZ2=1e-4, Ia2=0.05))
    assert not found.items, str(found)
    (note,) = found.notes
    assert "the drive gains of joints 1 and 2 cannot be checked by this log" in note
    assert str(found).splitlines()[1] == f"Note: {note}."
    assert found.to_dict()["notes"] == [note]


def test_nothing_is_noted_where_the_log_checks_all_gains(plain_arm: Experiment) -> None:
    found = check(planar_log(plain_arm))
    assert (found.items, found.notes) == ((), ()), str(found)


def test_friction_that_differs_between_recordings_is_a_finding(plain_arm: Experiment) -> None:
    fc = dict(zip(plain_arm.robot.parameter_names, plain_arm.robot.parameter_set("reference"), strict=True))[
        "Fc1"
    ]
    (first,) = planar_log(plain_arm).recordings
    warmer, same = (planar_log(plain_arm, Fc1=factor * fc).recordings[0] for factor in (0.8, 1.0))
    alike = replace(plain_arm, recordings=(first, replace(same, name="again")))
    assert not [item for item in check(alike).items if item.kind == "drift"]
    found = check(replace(plain_arm, recordings=(first, replace(warmer, name="warm"))))
    (item,) = (item for item in found.items if item.kind == "drift" and "Fc1" in item.sentence)
    assert (item.joints, item.recording) == ((1,), "warm")
    assert item.value is not None
    assert item.value == pytest.approx(-0.2 * fc, rel=0.3)


def test_check_says_by_how_much_the_friction_of_a_log_differs(plain_arm: Experiment) -> None:
    known = dict(
        zip(plain_arm.robot.parameter_names, plain_arm.robot.parameter_set("reference"), strict=True)
    )
    (first,) = planar_log(plain_arm).recordings
    (other,) = planar_log(plain_arm, **{name: 0.85 * known[name] for name in ("Fv1", "Fc1")}).recordings
    found = check(replace(plain_arm, recordings=(first, replace(other, name="warm"))))
    (item,) = (item for item in found.items if item.kind == "drift" and item.facts["of"] == "friction")
    assert item.joints == (1,)
    (level,) = item.facts["levels"]
    assert (level["recording"], level["joint"]) == ("warm", 1)
    assert level["share"] == pytest.approx(-0.15, abs=min(0.02, 4.0 * level["std"]))
    assert f"(warm: joint 1 {-100.0 * level['share']:.2g} % lower, " in item.sentence
    assert "sigma): warmer, or loaded? Most by -" in item.sentence


def test_the_law_is_judged_with_the_friction_of_the_simulation(plain_arm: Experiment) -> None:
    """A digital controller and friction that the simulation smooths: no law of friction is missed beside it."""
    log = replace(planar_log(plain_arm), robot=plain_arm.robot)
    along = law_along(didim.identify(log), log, didim.CLOE())
    assert along is not None
    rows = LogRows(along.robot, along.signal, along.parts, logs=along.logs)
    assert friction_findings(rows, None, chosen=False) == []


@pytest.mark.parametrize("moves", [True, False])
def test_a_torque_that_is_noise_alone_is_a_finding_where_the_joint_moves(
    plain_arm: Experiment, moves: bool
) -> None:
    log = planar_log(plain_arm)
    (recording,) = log.recordings
    assert recording.tau is not None
    noise = 0.05 * np.random.default_rng(0).standard_normal(len(recording.tau))
    tau = np.column_stack([recording.tau[:, 0], 3.0 + noise])
    flat = replace(log, recordings=(replace(recording, q=recording.q * [1.0, float(moves)], tau=tau),))
    assert ("constant-torque" in [item.code for item in check(flat)]) is moves
    if moves:
        assert "constant-torque" in [item.code for item in didim.identify(flat).verdict.grave]


def test_notes_stand_before_the_table_of_the_closed_loop() -> None:
    shown = str(Findings("log", closed_loop=(("joint", "kp"), ("1", "1.00")), notes=("a gain is open",)))
    assert shown.splitlines()[:3] == ["log: nothing found.", "Note: a gain is open.", ""]


@pytest.mark.parametrize("factor", [1.0, 0.9])
def test_a_factor_is_found_to_the_percent_and_none_where_none_is(
    plain_arm: Experiment, factor: float
) -> None:
    """The scale of the position of joint 2, noise and friction of the plain_arm beside it."""
    log = planar_log(plain_arm)
    (recording,) = log.recordings
    scaled = replace(log, recordings=(replace(recording, q=recording.q * [1.0, factor]),))
    found = [item for item in check(scaled) if "ties" in item.facts]
    if factor == 1.0:
        assert found == []
    else:
        (item,) = found
        named = [(item.code, item.value), *((tie["code"], tie["value"]) for tie in item.facts["ties"])]
        (value,) = [value for code, value in named if code == "position-scale"]
        assert value == pytest.approx(1.0 / factor, rel=0.02)


def test_the_causes_of_friction_say_what_a_file_takes(plain_arm: Experiment, tmp_path: Path) -> None:
    """What the advice says to write is read: friction = "auto" at the top of a file, as it once said, is not."""
    robot = didim.load_robot("planar2")
    for line in ("stribeck = true", 'terms = "auto"', 'coulomb = "tanh"\nsmoothing_rad_s = 0.01'):
        path = tmp_path / "robot.toml"
        robot_text = (Path(didim.__file__).parent / "packaged" / "robots" / "planar2.toml").read_text(
            encoding="utf-8"
        )
        path.write_text(f"{robot_text}\n[friction]\n{line}\n", encoding="utf-8")
        assert didim.load_robot(path).n_dof == robot.n_dof
