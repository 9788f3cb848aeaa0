"""``didim init`` writes the friction and the delay that a log supports, each line with its reason."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import didim
import friction_logs
from didim.cli.main import main
from didim.experiment.draft import initialise
from didim.experiment.draft_friction import friction_lines
from didim.regression.friction.choice import FirstFit, FrictionChoice, TermGain

LAW = friction_logs.stribeck(0.4)


def written(folder: Path, law: friction_logs.Law = LAW, late: int = 0) -> Path:
    """Write the log of a planar arm, its torques late by some samples."""
    (recording,) = friction_logs.logged(friction_logs.robot(), law, 1001).recordings
    assert recording.tau is not None
    columns = [recording.t, recording.q, np.roll(recording.tau, late, axis=0)]
    path = folder / "log.csv"
    values = np.column_stack(columns)[late:]
    np.savetxt(path, values, fmt="%.9g", delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    return path


def test_the_file_has_the_laws_of_the_log_and_their_reasons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = written(tmp_path)
    assert main(["init", "planar2", str(log)]) == 0
    assert "- friction Fs" in capsys.readouterr().out
    text = (tmp_path / "log.toml").read_text(encoding="utf-8")
    (line,) = (each for each in text.splitlines() if each.startswith("stribeck"))
    assert line.startswith("stribeck = [1, 2] # left-out blocks: -")
    assert "% squared error; links' torque in other poses: +-" in line
    assert re.search(r"\n# stribeck: 0\.1\d+ rad/s, 0\.1\d+ rad/s by this log, estimated in each fit\n", text)
    assert "[delay]" not in text
    # It loads, and `identify` chooses the same laws.
    experiment = didim.load_experiment(tmp_path / "log.toml")
    assert experiment.least_squares.physical is True
    own = {term.parameter for term in experiment.robot.friction.terms}
    (tmp_path / "auto.toml").write_text(
        "\n".join('terms = "auto"' if each == line else each for each in text.splitlines())
    )
    fit = didim.identify(didim.load_experiment(tmp_path / "auto.toml"))
    assert own == {item["parameter"] for item in fit.settings["friction"]["chosen"]} == {"Fs1", "Fs2"}


def test_a_plain_file_has_no_laws(tmp_path: Path) -> None:
    log = written(tmp_path)
    path, draft = initialise("planar2", log, plain=True)
    assert "# [friction]\n" in path.read_text(encoding="utf-8")
    assert not didim.load_experiment(path).robot.friction.terms
    assert not any("friction" in sentence for sentence in draft.read)


def test_a_smooth_sign_is_found_and_no_laws_with_it(tmp_path: Path) -> None:
    path, _ = initialise("planar2", written(tmp_path, friction_logs.coulomb))
    text = path.read_text(encoding="utf-8")
    assert re.search(
        r"\n\[friction\]\n# left-out blocks: -.*\ncoulomb = \"tanh\"\nsmoothing_rad_s = 0.02\n", text
    )
    friction = didim.load_experiment(path).robot.friction
    assert (friction.coulomb, friction.smoothing, friction.terms) == ("tanh", (0.02, 0.02), ())
    # Without laws the method decides.
    assert "[least_squares]" not in text


def test_gains_to_be_estimated_leave_laws_and_solver_to_the_next_file(tmp_path: Path) -> None:
    """Laws, and parameters of a robot, need torques: `identify` refuses a file that asks for these and for gains."""
    log = written(tmp_path)
    log.write_text(log.read_text(encoding="utf-8").replace("tau1,tau2", "iq1,iq2"), encoding="utf-8")
    path, _ = initialise("planar2", log, gains="estimate")
    text = path.read_text(encoding="utf-8")
    assert 'gain = "estimate"' in text
    assert "stribeck = " not in text
    assert "[least_squares]" not in text


def test_a_delay_comes_after_friction(tmp_path: Path) -> None:
    path, _ = initialise("planar2", written(tmp_path, late=3))
    text = path.read_text(encoding="utf-8")
    assert "\n[delay]\ncompensate_samples = " in text
    assert " # after friction; left-out blocks: -" in text
    experiment = didim.load_experiment(path)
    assert experiment.delay.compensate_samples == pytest.approx(3.0, abs=0.5)
    assert {"Fs1", "Fs2"} <= {term.parameter for term in experiment.robot.friction.terms}


def test_an_interrupted_init_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*given: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("didim.experiment.draft_friction.first_fit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        initialise("planar2", written(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_springs_and_refused_laws_have_their_lines() -> None:
    robot = didim.load_robot("planar2")
    sprung = robot.with_terms([didim.FrictionTerm(law="spring", joint=1)])
    choice = FrictionChoice(
        friction=sprung.friction,
        velocities=(),
        gains=(TermGain(parameter="Ks2", gain=0.5, significance=8.0, shift=0.4),),
        untold=(TermGain(parameter="Fa1", gain=0.2, significance=12.0, shift=0.34),),
        held_out_before=0.2,
        held_out_after=0.1,
    )
    assert friction_lines(robot, FirstFit(choice=choice)) == [
        "# Relative error of blocks left out of the fit: 20.00 %, with these laws 10.00 %.",
        "[springs]",
        "linear = [2] # left-out blocks: -50 % squared error; links' torque in other poses: +-40 %",
        "# Fa1 is seen (gain 12 times its error), and not separated from the links, whose torque in other poses would move "
        "by 34 %: record more combinations of poses.",
    ]


@pytest.mark.slow
def test_the_raw_log_of_a_ur10e(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No header, uneven stamps, currents: two questions, their answers, and a fit below 4.6 %."""
    log = tmp_path / "free.csv"
    log.symlink_to(shared / "data" / "ur10e" / "free.csv")
    assert main(["init", "ur10e", str(log)]) == 1
    question = capsys.readouterr().err
    assert "which columns hold the torques of the 6 joints (14-19 or 20-25 or 26-31)?" in question
    options = ["--columns", "current=14-19", "--force"]
    assert main(["init", "ur10e", str(log), *options]) == 1
    assert "how many N.m are one A" in capsys.readouterr().err
    published = ["14.87", "13.26", "11.13", "10.62", "11.03", "11.47"]
    assert main(["init", "ur10e", str(log), *options, "--gain", *published]) == 0
    assert "resample = true" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "free.toml")]) in (0, 1)
    assert main(
        ["identify", str(tmp_path / "free.toml"), "--quiet", "--json", str(tmp_path / "fit.json")]
    ) in (0, 1)
    fit = didim.Identification.load(tmp_path / "fit.json")
    # With the friction that `init` has written; 3.6 % without.
    assert 0.012 < fit.overall_relative_error < 0.02
    assert fit.verdict.sound, str(fit.verdict)
    (note,) = [reason for reason in fit.verdict.reasons if reason.code == "gain-unchecked"]
    assert (note.joints, note.grade) == ((6,), "note")
