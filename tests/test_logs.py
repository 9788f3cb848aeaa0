"""One estimator over several logs: blocks of columns for payloads, own offsets and own friction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from arm import arm_file, arm_log
from didim import Experiment
from didim.errors import ExperimentError, FitError
from didim.methods.builder import Run, fitted, solved_status
from didim.methods.method import Method
from didim.regression.friction.velocity import settled
from didim.robot.friction import FrictionTerm
from didim.robot.payload import Payload
from didim.studies.prediction import predict, relative_errors
from several import DISC, arm_logs, further

TRUTH = {"disc.ZZ": DISC[5], "disc.MX": DISC[6], "disc.MY": DISC[7], "disc.M": DISC[9]}


@pytest.fixture(scope="module")
def exact() -> Experiment:
    """Three logs without noise; the second and third with a payload, the third with offsets of its own."""
    return arm_logs([False, True, True], offsets={2: (0.3, -0.2)}, own=("offsets",))


def beta_of(experiment: Experiment) -> np.ndarray:
    return experiment.robot.base_parameters.project(experiment.robot.parameter_set("reference"))


@pytest.mark.parametrize(
    ("method", "tolerance"),
    [
        (didim.IDIMLS(), 6e-3),  # the filter of the positions
        (didim.IDIMIV(), 6e-3),
        (didim.DIDIM(), 1e-5),
        # The logs are simulated with the steps of the search, and the estimate is that of finer ones.
        (didim.CLOE(start="idim-ls", output="torque"), 2e-5),
    ],
    ids=lambda item: getattr(item, "name", ""),
)
def test_every_method_finds_robot_payload_and_offsets(
    exact: Experiment, method: Method, tolerance: float
) -> None:
    fit = didim.identify(exact, method)
    found = further(fit)
    assert fit.converged
    np.testing.assert_allclose(fit.beta, beta_of(exact), atol=tolerance)
    for name, value in TRUTH.items():
        assert abs(found[name] - value) < tolerance
    assert abs(found["log 3.Off1"] - 0.3) < tolerance
    assert abs(found["log 3.Off2"] + 0.2) < tolerance
    assert abs(found["log 2.Off1"]) < tolerance


def test_a_result_with_further_parameters_is_saved_printed_and_predicts(
    exact: Experiment, tmp_path: Path
) -> None:
    fit = didim.identify(exact, didim.DIDIM())
    fit.save(tmp_path / "fit.json")
    again = didim.Identification.load(tmp_path / "fit.json")
    assert again.further is not None
    assert fit.further is not None
    assert again.further.by_name == fit.further.by_name
    np.testing.assert_array_equal(again.further.covariance, fit.further.covariance)
    rows = {row.name: row for row in again.estimate}
    assert {rows["disc.MX"].group, rows["log 3.Off1"].group} == {"payload", "offset"}
    assert rows["disc.MX"].value == fit.further.by_name["disc.MX"]
    text = str(again)
    assert "payload 'disc', on the flange" in text
    assert "centre of mass: 250.0 +- " in text
    assert "offsets of recording 'log 3', less those of 'log 1'" in text
    assert (relative_errors(predict(again, exact)) < 1e-6).all()
    validation = didim.validate(again, exact)
    assert all((item.simulated["torque"] < 1e-4).all() for item in validation.recordings)
    # Without its payload the second log is another robot's.
    bare = replace(exact, recordings=tuple(replace(item, payload="none") for item in exact.recordings))
    assert (relative_errors(predict(again, bare)) > 0.01).all()


@pytest.mark.slow
def test_known_parts_of_a_payload_are_kept(exact: Experiment) -> None:
    mass, centre = float(DISC[9]), tuple((DISC[6:9] / DISC[9]).tolist())
    for payload, left in (
        (Payload(name="disc", mass_kg=mass), {"disc.ZZ", "disc.MX", "disc.MY"}),
        (Payload(name="disc", com_m=centre), {"disc.ZZ", "disc.M"}),
        (Payload(name="disc", mass_kg=mass, com_m=centre), {"disc.ZZ"}),
    ):
        fit = didim.identify(replace(exact, payloads={"disc": payload}), didim.DIDIM())
        found = further(fit)
        assert {name for name in found if name.startswith("disc")} == left
        for name in left:
            assert abs(found[name] - TRUTH[name]) < 1e-5
        np.testing.assert_allclose(fit.beta, beta_of(exact), atol=1e-5)
        assert fit.further is not None
        ten, covariance = fit.further.ten("disc")
        np.testing.assert_allclose(ten[[5, 6, 7, 9]], DISC[[5, 6, 7, 9]], atol=1e-5)
        assert covariance.shape == (10, 10)


def test_parameters_that_no_recording_tells_are_refused_by_name() -> None:
    with pytest.raises(FitError, match="of payload 'disc' cannot be separated from the last link"):
        didim.identify(arm_logs([True]), didim.IDIMLS())
    logs = arm_logs([False, True])
    held_out = replace(logs, recordings=(logs.recordings[0], replace(logs.recordings[1], role="held-out")))
    with pytest.raises(FitError, match=r"no recording to fit has payload 'disc', of which .* are unknown"):
        didim.identify(held_out, didim.IDIMLS())
    with pytest.raises(
        ExperimentError, match=r"log 2: payload 'disc' is not described; add a table \[payload.disc\]"
    ):
        didim.identify(arm_logs([False, True], payloads={"disk": Payload(name="disk")}), didim.IDIMLS())


def test_a_sentence_says_that_own_offsets_were_left_out() -> None:
    drifting = arm_logs([False, True, False], offsets={1: (0.3, 0.0)}, noise=(0.5, 0.3))
    reasons = didim.identify(drifting, didim.IDIMLS()).verdict.grave
    (reason,) = [item for item in reasons if item.code == "drift"]
    assert reason.sentence.startswith("the offsets of joint 1 differ between recordings, most by 0.")
    assert reason.sentence.endswith("in Off1 of 'log 2'")
    assert reason.advice == 'Give the recordings offsets = "own"'
    assert reason.joints == (1,)
    for steady in (
        arm_logs([False, True, False], noise=(0.5, 0.3)),
        replace(drifting, recordings=tuple(replace(item, own=("offsets",)) for item in drifting.recordings)),
    ):
        reasons = didim.identify(steady, didim.IDIMLS()).verdict.reasons
        assert "drift" not in {item.code for item in reasons}


@pytest.mark.usefixtures("without_alarm", "unjudged")
def test_offsets_of_their_own_are_as_uncertain_as_they_say() -> None:
    """Four logs with offsets of their own and one payload: error/sigma near 1 over seeds."""
    offsets = {1: (0.3, -0.2), 2: (-0.1, 0.1), 3: (0.2, 0.05)}
    clean = arm_logs([False, True, True, False], offsets=offsets, own=("offsets",))
    scores = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        noisy = tuple(
            replace(item, tau=item.tau + rng.standard_normal(item.q.shape) * (0.5, 0.3))
            for item in clean.recordings
            if item.tau is not None
        )
        fit = didim.identify(
            replace(clean, recordings=noisy), didim.IDIMLS(uncertainty="decimated", weights="per-joint")
        )
        assert fit.further is not None
        truth = dict(TRUTH)
        for number, values in offsets.items():
            truth |= {f"log {number + 1}.Off{joint + 1}": value for joint, value in enumerate(values)}
        scores.append(
            [
                (value - truth[name]) / std
                for name, value, std in zip(
                    fit.further.names, fit.further.values, fit.further.std, strict=True
                )
            ]
        )
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2


FILE = """schema = 1
name = "two"
robot = "planar2"
[payload.none]
[payload.disc]
mass_kg = 0.8
[flange]
xyz_m = [0.1, 0.0, 0.0]
rpy_deg = [0.0, 0.0, 90.0]
[[recording]]
name = "free"
rate_hz = 500
position = { file = "log.npz", variable = "q", unit = "rad", side = "joint" }
torque = { file = "log.npz", variable = "tau", unit = "N.m", side = "joint" }
[[recording]]
name = "loaded"
payload = "disc"
offsets = "own"
friction = "own"
rate_hz = 500
position = { file = "log.npz", variable = "q", unit = "rad", side = "joint" }
torque = { file = "log.npz", variable = "tau", unit = "N.m", side = "joint" }
"""


def test_an_experiment_file_names_payloads_and_what_a_recording_has_for_itself(tmp_path: Path) -> None:
    arm_file(arm_log(1), tmp_path, tmp_path / "one.toml")
    path = tmp_path / "two.toml"
    path.write_text(FILE)
    experiment = didim.load_experiment(path)
    free, loaded = experiment.recordings
    assert (free.payload, free.own, loaded.payload, loaded.own) == (
        "none", (), "disc", ("offsets", "friction")
    )  # fmt: skip
    assert experiment.payloads["disc"].mass_kg == 0.8
    assert experiment.flange is not None
    np.testing.assert_allclose(
        np.array(experiment.flange), np.array([[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0]]), atol=1e-12
    )
    for wrong, message in (
        ('payload = "disk"', "payload 'disk' is not described"),
        ('offsets = "mine"', "offsets must be one of"),
    ):
        key = wrong.split(" = ")[0]
        old = next(line for line in FILE.splitlines() if line.startswith(key))
        path.write_text(FILE.replace(old, wrong))
        with pytest.raises(ExperimentError, match=message):
            didim.identify(didim.load_experiment(path), didim.IDIMLS())
    path.write_text(FILE.replace("mass_kg = 0.8", "mass_kg = -1"))
    with pytest.raises(ExperimentError, match="mass_kg"):
        didim.load_experiment(path)


def test_the_emps_log_as_two_with_everything_shared_gives_the_published_digits(
    project: Path, shared: Path
) -> None:
    """The rows of the filtered log as those of two recordings; two files are filtered apart, which moves it by 0.2 sigma."""
    experiment = didim.load_experiment(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    (item,) = experiment.recordings
    two = replace(experiment, recordings=(item, replace(item, name="second")))
    method = didim.IDIMLS()
    job = method.job(two)
    (part,) = method.job(experiment).parts("fit", job.delay())
    system = job.system([part])
    (block,) = system.blocks
    middle = block.n_rows // 2
    blocks = (
        replace(block, rows=slice(0, middle)),
        replace(block, rows=slice(middle, block.n_rows), recording=1),
    )
    system = replace(system, blocks=blocks)
    solved = job.solve(system)
    status = solved_status(solved)
    run = Run(job=job, method=method, status=status, history=[], delay=job.delay(), q=part.q)
    fit = fitted(run, system, solved)
    published = {
        "M1R": (95.1089, 0.1085),
        "Fv1": (203.5034, 1.1460),
        "Fc1": (20.3935, 0.1012),
        "Off1": (-3.1648, 0.0444),
    }
    for name, value, std in zip(fit.names, fit.beta, fit.std, strict=True):
        assert (round(value, 4), round(std, 4)) == published[name]
    assert round(100.0 * fit.overall_relative_error, 4) == 4.0834
    halves = []
    for name, rows in (("first", slice(0, 12069)), ("second", slice(12069, None))):
        assert item.tau is not None
        assert item.q_ref is not None
        halves.append(
            replace(item, name=name, t=item.t[rows], q=item.q[rows], tau=item.tau[rows], q_ref=item.q_ref[rows], windows=())
        )  # fmt: skip
    split = didim.identify(replace(experiment, recordings=tuple(halves)), method)
    np.testing.assert_array_less(np.abs(split.beta - fit.beta), 0.2 * fit.std)


def test_check_knows_payloads_and_leaves_currents_alone() -> None:
    log = arm_logs([False, True], noise=(0.3, 0.2))
    # The controller of the log is not looked at here.
    assert "torque-sign" not in {item.kind for item in didim.check(log)}
    first, second = log.recordings
    assert second.tau is not None
    turned = replace(second, tau=second.tau * [-1.0, 1.0])
    assert first.tau is not None
    found = didim.check(replace(log, recordings=(replace(first, tau=first.tau * [-1.0, 1.0]), turned)))
    assert any(1 in item.joints for item in found)
    drives = ((1.0, 0.0), (0.0, 1.0))
    currents = tuple(replace(item, drives=drives) for item in log.recordings)
    known = {"disc": Payload(name="disc", mass_kg=0.8)}
    (finding,) = didim.check(replace(log, recordings=currents, payloads=known))
    assert (finding.kind, finding.sentence[:30]) == ("drive-gain", "the drive gains are to be esti")
    assert finding.advice.startswith("Identify them by idim-ls")
    (finding,) = didim.check(replace(log, recordings=currents, payloads={"disc": Payload(name="disc")}))
    assert "add a recording with a payload of known mass" in finding.advice


def test_a_payload_offsets_and_friction_laws_are_one_problem(exact: Experiment) -> None:
    """A velocity, load friction under a payload, and offsets of a recording, from torques that have exactly these."""
    laws = [FrictionTerm(law="stribeck", joint=0, velocity=0.3), FrictionTerm(law="load", joint=1)]
    asked = [replace(laws[0], velocity=0.1, estimated=True), laws[1]]
    robot = exact.robot.with_terms(laws)
    job = didim.IDIMLS().job(replace(exact, robot=exact.robot.with_terms(asked)))
    values = dict(zip(exact.robot.parameter_names, exact.robot.parameter_set("reference"), strict=True))
    values |= {"Fs1": 0.4, "Fl2": 0.06}
    truth = {**TRUTH, "log 3.Off1": 0.3, "log 3.Off2": -0.2}
    x = job.model.extended(np.array([values[name] for name in robot.parameter_names]), truth)
    parts = [
        replace(
            part,
            tau=didim.inverse_dynamics(
                robot, part.q, part.dq, part.ddq, job.model.standard(x, part.recording)
            ),
        )
        for part in job.parts("fit")
    ]
    found = settled(job.model, parts, job.signal, job.estimate)
    (velocity,) = found.velocities
    assert velocity.identified
    assert velocity.velocity == pytest.approx(0.3, rel=1e-4)
    np.testing.assert_allclose(found.beta, job.model.project(x), atol=1e-4)
