"""The verdict: what makes a result sound, doubtful or wrong, and that every output says the same."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import simulated
from didim import IDIMLS, Identification, Status, identify
from didim.cli.main import main
from didim.evidence.causes import Tried
from didim.evidence.hypotheses.geometry import place_of
from didim.evidence.hypotheses.hypothesis import Hypothesis
from didim.evidence.naming import remedy_of
from didim.evidence.physics import physical_findings
from didim.evidence.whiteness import whiteness
from didim.model.physics import Flag, physical_flags
from didim.result.finding import Finding
from didim.result.verdict import State, Verdict
from didim.result.words.causes import edit
from didim.signal.noise import noise_correlation
from didim.terms.rows import stacked

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def fit() -> Identification:
    """A sound result: planar arm, white noise on the torques."""
    robot = didim.load_robot("planar2")
    log = simulated.log(robot, robot.parameter_set("reference"), n_samples=6000, noise=0.1)
    return identify(simulated.experiment(robot, log))


def test_states_follow_the_gravest_reason() -> None:
    note, doubt, wrong = (
        Finding(code="x", grade=grade, facts={"text": f"it is {grade}"})
        for grade in ("note", "doubtful", "wrong")
    )
    assert Verdict.of([]).state is State.SOUND
    assert Verdict.of([note]).sound
    assert Verdict.of([note, doubt]).state is State.DOUBTFUL
    verdict = Verdict.of([note, doubt, wrong, replace(doubt, code="again")])
    assert verdict.state is State.WRONG
    assert verdict.reasons == (wrong, doubt, note)
    assert verdict.sentence == "Verdict: wrong, for 2 reasons: it is wrong."
    assert [line for line in verdict.lines() if not line.startswith(" ")] == [
        "",
        "Wrong:",
        "",
        "Doubtful:",
        "",
        "Notes:",
    ]


def test_a_correct_log_is_sound_and_every_output_says_so(fit: Identification) -> None:
    verdict = fit.verdict
    assert verdict.state is State.SOUND, str(verdict)
    assert str(fit).splitlines()[-1] == verdict.sentence
    assert fit.to_dict()["verdict"] == verdict.to_dict()
    assert pickle.loads(pickle.dumps(fit)).verdict == verdict


def test_a_verdict_is_saved_and_loaded_whole(fit: Identification, tmp_path: Path) -> None:
    spoiled = replace(
        fit,
        status=Status.NOT_CONVERGED,
        remarks=("five windows",),
        evidence=(Finding(code="x", grade="doubtful", joints=(2,), value=3.0, facts={"text": "odd"}),),
    )
    assert spoiled.verdict.state is State.WRONG
    spoiled.save(tmp_path / "fit.json")
    loaded = Identification.load(tmp_path / "fit.json")
    assert loaded.verdict == spoiled.verdict
    assert loaded.evidence == spoiled.evidence
    # A result of version 0.1.0 has no verdict: status, warnings and remarks say what is known.
    data = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    del data["verdict"]
    (tmp_path / "old.json").write_text(json.dumps(data), encoding="utf-8")
    assert Identification.load(tmp_path / "old.json").verdict.state is State.WRONG


@pytest.mark.parametrize(
    ("status", "state"),
    [
        (Status.SOLVED, State.SOUND),
        (Status.NO_STEP, State.WRONG),
        (Status.ILL_CONDITIONED, State.WRONG),
        (Status.STOPPED, State.DOUBTFUL),
        (Status.INTERRUPTED, State.DOUBTFUL),
    ],
)
def test_the_status_is_separate_but_never_better_than_the_verdict(
    fit: Identification, status: Status, state: State
) -> None:
    assert replace(fit, status=status).verdict.state is state


def test_physics_is_weighted_by_significance() -> None:
    flags = [
        Flag("ZZ6 is negative", ("ZZ6",), 0.2),
        Flag("ZZ5 is negative", ("ZZ5",), 5.0),
        Flag("Fc7 is negative", ("Fc7",), 16.0),
        Flag("Fv7 is negative", ("Fv7",), np.inf),
    ]
    assert [item.grade for item in physical_findings(flags)] == [
        "note",
        "doubtful",
        "doubtful",
        "doubtful",
    ]


def test_an_indefinite_inertia_by_noise_is_a_note_without_a_word_on_signs() -> None:
    robot = didim.load_robot("planar2")
    base = robot.base_parameters
    beta = base.project(robot.parameter_set("reference"))
    beta[[name.startswith(("ZZ2", "Ia2")) for name in base.names]] = -0.01
    q = simulated.motion(2, 200)
    for size, grade in ((1.0, "note"), (1e-8, "doubtful")):
        flags = physical_flags(robot, beta, size * np.eye(len(beta)), q)
        (found,) = [reason for reason in physical_findings(flags) if "M(q)" in reason.sentence]
        assert found.grade == grade
        assert "sign" not in found.sentence.replace("sigma", "")
        assert ("noise can explain it" in found.sentence) == (grade == "note")


def test_whiteness() -> None:
    rng = np.random.default_rng(2)
    white = rng.standard_normal((3000, 2))
    lasting = np.copy(white)
    for k in range(1, len(lasting)):
        lasting[k] = 0.7 * lasting[k - 1] + white[k]
    blocks = stacked(2, [3000])

    def joints(noise: Array) -> list[int]:
        return np.flatnonzero(whiteness(noise.T.ravel(), blocks, 2).coloured).tolist()

    assert joints(white) == []
    assert joints(lasting) == [0, 1]
    assert joints(np.column_stack([white[:, 0], lasting[:, 1]])) == [1]
    # sqrt((1 + a) / (1 - a)) for a = 0.7, less the lags that are left out.
    growth = whiteness(lasting.T.ravel(), blocks, 2).growth
    np.testing.assert_allclose(growth, np.sqrt(1.7 / 0.3), rtol=0.15)


def test_white_noise_through_the_decimation_is_white() -> None:
    robot = didim.load_robot("planar2")
    log = simulated.log(robot, robot.parameter_set("reference"), n_samples=20_000, noise=0.3)
    experiment = simulated.experiment(robot, log)
    assert noise_correlation(experiment.signal) is not None
    assert identify(experiment).verdict.sound


def test_correlation_that_is_known_of_the_noise_is_not_the_models() -> None:
    """Sums of three neighbours are correlated by two thirds and a third: with that in the blocks they are white."""
    white = np.random.default_rng(3).standard_normal((2, 3002))
    noise = (white[:, 2:] + white[:, 1:-1] + white[:, :-2]).ravel()
    known = whiteness(noise, stacked(2, [3000], correlation=np.array([1.0, 2.0 / 3.0, 1.0 / 3.0])), 2)
    assert not known.coloured.any()
    np.testing.assert_allclose(known.growth, 1.0, rtol=0.1)
    assert whiteness(noise, stacked(2, [3000]), 2).coloured.all()


def test_exit_codes_and_colours(
    fit: Identification, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = didim.load_robot("planar2")
    recording = simulated.log(robot, robot.parameter_set("reference"), n_samples=6000, noise=0.1)
    assert recording.tau is not None
    file = tmp_path / "log.toml"

    def write(tau: Array) -> None:
        np.savez(tmp_path / "log.npz", q=recording.q, tau=tau)

    file.write_text(
        """\
schema = 1
name = "arm"
robot = "planar2"
[[recording]]
name = "arm"
rate_hz = 500
position = { file = "log.npz", variable = "q", unit = "rad", side = "joint" }
torque = { file = "log.npz", variable = "tau", unit = "N.m", side = "joint" }
[signal]
cutoff_hz = 40
trim_start = 25
trim_end = 25
decimation = [5]
""",
        encoding="utf-8",
    )
    write(recording.tau)
    assert main(["identify", str(file), "--strict"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("Verdict: sound")
    # Errors that last and are large: doubtful, which only --strict refuses.
    rng = np.random.default_rng(1)
    lasting = np.zeros_like(recording.tau)
    for k in range(1, len(lasting)):
        lasting[k] = 0.98 * lasting[k - 1] + 1.5 * rng.standard_normal(2)
    write(recording.tau + lasting)
    assert main(["identify", str(file)]) == 0
    assert main(["identify", str(file), "--strict"]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("Verdict: doubtful")
    write(recording.tau * [1.0, -1.0])
    assert main(["identify", str(file)]) == 1
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert main(["identify", str(file), "--strict"]) == 1
    assert "\033[1;31mVerdict: wrong" in capsys.readouterr().out


def test_white_least_squares_have_a_verdict_too(fit: Identification) -> None:
    robot = didim.load_robot("planar2")
    log = simulated.log(robot, robot.parameter_set("reference"), n_samples=6000, noise=0.1)
    found = identify(simulated.experiment(robot, log), IDIMLS(uncertainty="white"))
    assert found.verdict.sound


def test_a_sign_that_noise_hardly_explains_has_advice(fit: Identification) -> None:
    """A result between two and ten sigma off is doubtful, and says what to do."""
    flag = Flag("Ia2 is negative, by 3 sigma", ("Ia2",), 3.0)
    found = replace(fit, warnings=(flag.sentence,), evidence=tuple(physical_findings([flag]))).verdict
    assert found.state is State.DOUBTFUL
    (reason,) = found.grave
    assert reason.parameters == ("Ia2",)
    assert "--physical" in reason.advice


def test_rows_are_counted_as_the_file_has_them() -> None:
    """In a standard table the twist and length before joint 3 are of row 2, in a modified one of row 3."""
    standard, modified = didim.load_robot("ur5e"), didim.load_robot("tx40")
    assert [place_of(standard, key, 2)["row"] for key in ("alpha", "d", "r")] == [2, 2, 3]
    assert [place_of(modified, key, 2)["row"] for key in ("alpha", "d", "r")] == [3, 3, 3]
    for robot, row in ((standard, 2), (modified, 3)):
        found = Hypothesis(code="twist-sign", joints=(3,), facts=place_of(robot, "alpha", 2))
        remedy = remedy_of(Tried(found, -5.0))
        assert remedy is not None
        assert (remedy.file, remedy.table, remedy.key, remedy.joints) == (
            "robot",
            "[[joint]]",
            "alpha_deg",
            (row,),
        )
        assert f"alpha_deg in row {row}" in edit(found.code, found.joints, None, found.facts)
    in_urdf = Hypothesis(code="twist-sign", joints=(3,), facts={"row": 3, "urdf": True})
    assert remedy_of(Tried(in_urdf, -5.0)) is None
    assert "URDF" in edit(in_urdf.code, in_urdf.joints, None, in_urdf.facts)
