"""Methods under physical conditions: DIDIM by default, IDIM-IV and CLOE on request, their starts, gains and refusals."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from arm import arm_file, arm_log
from arm import noisy as with_torque_noise
from conditions import conditions_of, violations
from didim import CLOE, DIDIM, IDIMIV, Experiment, identify
from didim.cli.main import main
from didim.errors import ExperimentError, FitError
from didim.evidence.naming import torque_findings
from didim.methods.cloe.consistent import consistent_steps
from didim.result.iteration import Iteration, Reporter
from didim.studies.simulated_log import simulated_log


@pytest.fixture(scope="module")
def exact() -> Experiment:
    return arm_log(3)


def noisy(log: Experiment) -> Experiment:
    """The log with noise on torques and positions."""
    (recording,) = with_torque_noise(log).recordings
    noise = 2e-5 * np.random.default_rng(4).standard_normal(recording.q.shape)
    return replace(log, recordings=(replace(recording, q=recording.q + noise),))


@pytest.fixture(scope="module")
def log(exact: Experiment) -> Experiment:
    return noisy(exact)


def off(fit: didim.Identification, log: Experiment) -> float:
    """Rms of estimate less truth in standard deviations."""
    return float(np.sqrt(np.mean(((fit.beta - log.robot.set_base("reference")) / fit.std) ** 2)))


@pytest.mark.slow
@pytest.mark.usefixtures("unjudged")
def test_where_the_truth_is_a_robot_plain_and_consistent_didim_agree() -> None:
    """Same weights, same answer: a prior of a hundredth of a nat moves nothing by more than 0.01 sigma rms."""
    experiment = didim.packaged_experiment("tx40")
    log = simulated_log(experiment, experiment.robot.parameter_set("didim_physical"), seed=1)
    plain, consistent = identify(log, DIDIM(physical=False)), identify(log, DIDIM())
    assert np.sqrt(np.mean(((consistent.beta - plain.beta) / plain.std) ** 2)) < 0.01
    assert (consistent.n_iterations, consistent.n_simulations) == (2, 4)
    assert consistent.settings["didim"]["start"] == "consistent"
    assert plain.settings["didim"]["start"] == "unit"
    assert 0.01 <= consistent.settings["solver"]["gamma"] < 0.015
    assert violations(conditions_of(log.robot), consistent.parameters) == []
    prior = identify(log, DIDIM(start="prior"))
    assert prior.n_iterations == 4
    assert np.abs((prior.beta - consistent.beta) / plain.std).max() < 0.01


def test_the_emps_is_met_in_four_digits(project: Path, shared: Path) -> None:
    experiment = didim.load_experiment(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    plain, consistent = identify(experiment, DIDIM(physical=False)), identify(experiment, DIDIM())
    assert [f"{value:.4g}" for value in consistent.beta] == [f"{value:.4g}" for value in plain.beta]


@pytest.mark.usefixtures("unjudged")
@pytest.mark.parametrize("start", ["consistent", "prior", "unit", "idim-ls", "reference"])
def test_starts_of_both_kinds_of_didim(log: Experiment, start: str) -> None:
    for physical in (True, False):
        fit = identify(log, DIDIM(physical=physical, start=start))
        assert fit.converged, physical
        assert fit.settings["didim"]["start"] in (start, "consistent")
        assert off(fit, log) < 1.6


@pytest.mark.usefixtures("unjudged")
def test_idim_iv_and_cloe_under_conditions(log: Experiment) -> None:
    conditions = conditions_of(log.robot)
    for method in (IDIMIV(physical=True), CLOE(physical=True), CLOE(physical=True, output="torque")):
        fit = identify(log, method)
        assert fit.converged, method.name
        assert fit.n_iterations <= 6
        assert off(fit, log) < 2.0
        assert violations(conditions, fit.parameters) == []
        np.testing.assert_allclose(log.robot.base_parameters.project(fit.parameters), fit.beta, atol=1e-9)
        assert fit.settings["solver"]["prior"] == "generic"
    plain, free = identify(log, CLOE(physical=True)), identify(log, CLOE(start="reference"))
    assert np.abs((plain.beta - free.beta) / free.std).max() < 0.3


def test_consistent_cloe_comes_back_from_a_wrong_start_and_without_a_controller_it_says_so(
    log: Experiment,
) -> None:
    fit = identify(log, CLOE(physical=True, start="prior", max_iterations=1), callback=lambda iteration: True)
    assert fit.status is didim.Status.STOPPED
    assert fit.settings["cloe"]["start"] == "prior"
    with pytest.raises(ExperimentError, match="controller"):
        identify(replace(log, controller=None), CLOE(physical=True))


@pytest.mark.usefixtures("unjudged")
def test_consistent_cloe_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    arm, file = noisy(arm_log(1, natural_frequency_hz=1.0)), tmp_path / "search.npz"
    whole = identify(arm, CLOE(physical=True, start="prior"))
    assert whole.n_iterations >= 2
    parts = CLOE(physical=True, start="prior", checkpoint=file)
    first = identify(arm, parts, callback=lambda iteration: True)
    assert first.status is didim.Status.STOPPED
    assert first.n_iterations == 1
    rest = identify(arm, parts)
    assert rest.converged
    assert rest.n_iterations == whole.n_iterations
    np.testing.assert_array_equal(rest.beta, whole.beta)
    np.testing.assert_array_equal(rest.parameters, whole.parameters)
    # Another search must not go on from it.
    with pytest.raises(FitError, match="belongs to another search"):
        identify(arm, CLOE(physical=True, start="prior", output="torque", checkpoint=file))


@pytest.mark.usefixtures("unjudged")
def test_consistent_cloe_from_several_starts() -> None:
    arm = noisy(arm_log(1))
    one, several = (identify(arm, CLOE(physical=True, output="torque", starts=starts)) for starts in (1, 3))
    assert several.converged
    records = several.settings["cloe"].get("starts", 0)
    assert records == 3
    assert len(several.settings["starts"]) == 3
    assert any(remark.endswith("reached the best optimum") for remark in several.remarks)
    assert violations(conditions_of(arm.robot), several.parameters) == []
    assert np.abs((several.beta - one.beta) / one.std).max() < 0.1
    # Each search began at a robot of its own.
    begun = consistent_steps(CLOE(physical=True, output="torque"), arm, Reporter())
    near = begun.begun_near(begun.point(begun.x) + 0.3 * begun.problem.scale)
    assert violations(conditions_of(arm.robot), near.x) == []
    assert np.abs((near.point(near.x) - begun.point(begun.x)) / begun.problem.scale).max() > 0.1


def test_ctrl_c_ends_consistent_cloe_with_the_best_robot_so_far() -> None:
    arm = noisy(arm_log(1))

    def interrupt(iteration: Iteration) -> bool:
        raise KeyboardInterrupt

    fit = identify(arm, CLOE(physical=True, output="torque", start="prior"), callback=interrupt)
    assert fit.status is didim.Status.INTERRUPTED
    assert violations(conditions_of(arm.robot), fit.parameters) == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"physical": 1}, "physical must be True or False, got 1"),
        ({"physical": True, "optimizer": "nelder-mead"}, "for the optimizer 'levenberg-marquardt'"),
    ],
)
def test_settings_of_cloe_that_do_not_go_together(settings: dict[str, object], message: str) -> None:
    with pytest.raises(FitError, match=message):
        CLOE(**settings)  # type: ignore[arg-type]


def test_settings_of_didim_that_do_not_go_together() -> None:
    with pytest.raises(FitError, match="give physical or solver, not both"):
        DIDIM(physical=True, solver="huber")
    with pytest.raises(FitError, match="physical must be True or False, got 'yes'"):
        DIDIM(physical="yes")  # type: ignore[arg-type]


def test_a_made_up_controller_has_gains_for_didim_and_no_other(
    exact: Experiment, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No gains are known: DIDIM makes them (D) from its estimate, and the others say who does."""
    log = noisy(exact)
    file = arm_file(log, tmp_path, tmp_path / "arm.toml")
    lines = [
        line.replace('kind = "recorded"', 'kind = "measured"').replace('kind = "pd"', 'kind = "made-up"')
        for line in file.read_text(encoding="utf-8").splitlines()
        if not line.startswith(("kp =", "kv =", "reference =", "start ="))
    ]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    fit_file = str(tmp_path / "fit.json")
    assert main(["identify", str(file), "--method", "didim", "--json", fit_file, "--quiet"]) == 0
    fit = didim.Identification.load(fit_file)
    assert fit.converged
    assert fit.settings["closed_loop"]["controller"]["kind"] == "made-up"
    assert (np.array(fit.settings["closed_loop"]["laws"])[:, :2] != 0.0).all()
    # A PD of rule (D) follows this fast motion less closely than the real controller.
    assert fit.overall_relative_error < 0.05
    assert (
        main(["identify", str(file), "--method", "cloe", "--physical", "--output", "torque", "--quiet"]) == 0
    )
    capsys.readouterr()
    for command in (
        ["simulate", str(file), "--parameters", fit_file, "-o", str(tmp_path / "run.csv")],
        ["identify", str(file), "--method", "didim", "--plain"],
    ):
        assert main(command) == 2
        err = capsys.readouterr().err
        assert "kind = 'made-up' has no gains yet: consistent DIDIM" in err
        assert err.count("\n") == 1
    assert main(["validate", fit_file, str(file)]) == 0
    assert (
        "not simulated: the experiment has no [controller] and [reference], or made-up gains"
        in capsys.readouterr().out
    )


@pytest.mark.slow
def test_a_measured_ur10e_with_a_made_up_controller(shared: Path, tmp_path: Path) -> None:
    """A log without reference and controller, from `didim init`: as good along the measured motion as least squares."""
    (tmp_path / "free.csv").symlink_to(shared / "data" / "ur10e" / "free.csv")
    gains = ["14.87", "13.26", "11.13", "10.62", "11.03", "11.47"]
    columns = ["--columns", "current=14-19", "--gain", *gains]
    assert main(["init", "ur10e", str(tmp_path / "free.csv"), *columns, "--plain"]) == 0
    file = tmp_path / "free.toml"
    loop = '\n[controller]\nkind = "made-up"\n[reference]\nkind = "measured"\n'
    file.write_text(file.read_text(encoding="utf-8") + loop, encoding="utf-8")
    experiment = didim.load_experiment(file)
    direct, fit = identify(experiment), identify(experiment, DIDIM())
    assert fit.converged
    assert fit.n_iterations <= 4
    assert violations(conditions_of(experiment.robot), fit.parameters) == []
    job = didim.IDIMLS().job(experiment)
    system = job.system(job.parts("fit", job.delay()))
    sizes = [np.linalg.norm(system.y - system.w @ found.beta) for found in (direct, fit)]
    assert 100.0 * sizes[0] / np.linalg.norm(system.y) == pytest.approx(3.59, abs=0.02)
    assert sizes[1] < 1.02 * sizes[0]


def told(log: Experiment) -> str:
    """What consistent DIDIM says of a log, whether it ends with a result or an error."""
    try:
        return " ".join(identify(log, DIDIM(max_iterations=1)).remarks)
    except FitError as error:
        return str(error)


@pytest.fixture(scope="module")
def sound() -> Experiment:
    experiment = didim.packaged_experiment("tx40")
    return simulated_log(experiment, experiment.robot.parameter_set("didim_physical"), seed=3)


@pytest.mark.usefixtures("unjudged")
@pytest.mark.parametrize("joint", [3, 6])
def test_a_reversed_torque_is_named_with_both_residuals(sound: Experiment, joint: int) -> None:
    (recording,) = sound.recordings
    assert recording.tau is not None
    tau = recording.tau.copy()
    tau[:, joint - 1] *= -1.0
    wrong = replace(sound, recordings=(replace(recording, tau=tau),))
    job = didim.IDIMLS().job(wrong)
    (finding,) = torque_findings(job.system(job.parts("fit", job.delay())))
    assert (finding.code, finding.joints) == ("torque-sign", (joint,))
    text = told(wrong)
    assert finding.sentence in text
    assert re.search(r"physical conditions raise the residual from [\d.]+ % to [\d.]+ %", text)


@pytest.mark.usefixtures("unjudged")
def test_a_wrong_gravity_is_told(sound: Experiment, tmp_path: Path, project: Path) -> None:
    text = (project / "python" / "didim" / "packaged" / "robots" / "tx40.toml").read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith("gravity_m_s2"))
    file = tmp_path / "turned.toml"
    file.write_text(text.replace(line, "gravity_m_s2 = [0.0, 0.0, 9.81]"), encoding="utf-8")
    turned = didim.load_robot(file)
    found = told(replace(sound, robot=turned.with_smoothing(sound.robot.friction.smoothing)))
    assert "check the signs of the torques, gravity and" in found
    assert re.search(r"physical conditions raise the residual from [\d.]+ % to [\d.]+ %", found)
