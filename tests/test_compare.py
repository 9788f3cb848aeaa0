"""`compare`: a simulated log identified by every method beside the truth, its table, its JSON and its command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from conditions import violations
from didim import CLOE, DIDIM, IDIMLS, Comparison, Experiment, Identification, compare
from didim.cli.main import main
from didim.errors import DidimError, ExperimentError, FitError
from didim.experiment.loop import closed_loop
from didim.experiment.specs import Measurement
from didim.model.consistency import link_cones
from didim.result.iteration import Iteration
from didim.studies.compare import _key, all_methods, truth_of
from didim.studies.comparison import sentences, text_of
from didim.studies.simulated_log import measured, packaged_experiment, simulated_log

ARM = """\
schema = 1
name = "arm, simulated"
robot = "planar2"
[reference]
kind = "fourier"
period_s = 4
harmonics = 8
seed = 1
max_position_rad = 1.5
max_velocity_rad_s = [4, 5]
max_acceleration_rad_s2 = [30, 40]
[controller]
kind = "pd"
natural_frequency_hz = 10
damping = 0.7
inertia_of = "reference"
[simulation]
rate_hz = 500
smoothing_rad_s = 0.02
step_s = 0.001
fine_step_s = 0.0005
[measurement]
torque_noise_n_m = [0.2, 0.1]
position_noise_rad = 1e-5
seed = 3
[signal]
cutoff_hz = 50
trim_start = 25
trim_end = 25
decimation = [10]
"""
LEAST_SQUARES = (IDIMLS(solver="least-squares"), DIDIM(solver="least-squares"))


def shortened(experiment: Experiment) -> Comparison:
    """Every method, and of the simplex the first 50 iterations; ``tests/test_cloe.py`` has where it ends."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("didim.studies.compare.SHORT_SIMPLEX", 50)
        methods = all_methods(experiment, simplex_iterations=50)
        return compare(experiment, parameters="reference", methods=methods)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("compare") / "arm.toml"
    path.write_text(ARM, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def experiment(path: Path) -> Experiment:
    return didim.load_experiment(path)


@pytest.fixture(scope="module")
def tx40() -> Comparison:
    return compare(parameters="didim", methods=LEAST_SQUARES)


@pytest.fixture(scope="module")
def arm(experiment: Experiment) -> Comparison:
    return shortened(experiment)


def test_the_papers_experiment_is_that_of_the_package(tx40: Comparison) -> None:
    """Findings, 5 and 8: ten seconds at 1 kHz, the noise of torques and encoders, the corrected Table II."""
    log = tx40.experiment
    (recording,) = log.recordings
    assert recording.rate_hz == 1000.0
    assert recording.q.shape == (10_001, 6)
    assert log.measurement == Measurement(
        torque_noise=(0.5, 0.5, 0.2, 0.1, 0.1, 0.1), position_noise=(1e-6, 1e-6, 2e-6, 2e-6, 2e-6, 3e-6)
    )
    np.testing.assert_array_equal(tx40.truth, log.robot.set_base("didim"))
    q_ref, dq_ref, ddq_ref = closed_loop(packaged_experiment("tx40")).reference.at(recording.t)
    peaks = np.stack([np.abs(values).max(axis=0) for values in (q_ref, dq_ref, ddq_ref)])
    limits = np.array([[2.6, 1.8, 2.0, 3.5, 1.9, 4.0], [4.5, 4.5, 6.5, 6.5, 5, 10], [25, 25, 35, 60, 60, 90]])
    assert np.all(peaks <= limits * 1.0001)
    assert np.all((peaks / limits).max(axis=0) > 0.99)


def test_both_are_as_near_as_sigma_says_and_didim_a_little_nearer(tx40: Comparison) -> None:
    assert list(tx40.fits) == ["idim-ls", "didim"]
    for name in tx40.fits:
        assert 0.85 < np.sqrt(np.mean(tx40.deviations(name) ** 2)) < 1.2
    direct, didim_fit = tx40.fits["idim-ls"], tx40.fits["didim"]
    assert np.all(didim_fit.relative_error < direct.relative_error)
    assert np.mean(didim_fit.std_white < direct.std_white) > 0.9


def test_the_table(tx40: Comparison) -> None:
    text = text_of(tx40, every=True)
    lines = text.splitlines()
    assert lines[0] == "TX40, simulated: 10 s at 1000 Hz, 60 base parameters"
    # Student's distribution with 19 degrees of freedom has 0.738 % beyond 3, the normal distribution 0.27 %.
    assert (
        "off: estimate less truth in standard deviations, above their rms; 0.74 % of correct estimates exceed 3 (Student's "
        "distribution, 19 degrees of freedom)"
    ) in text.replace("\n", " ")
    fit = tx40.fits["didim"]
    index = fit.names.index("Ia3")
    (row,) = [line for line in lines if line.startswith("Ia3 ")]
    cells = row.split()
    assert cells[:3] == ["Ia3", "kg.m^2", "0.0875"]
    assert cells[5:] == [f"{fit.beta[index]:.3g}", f"{tx40.deviations('didim')[index]:.1f}"]
    head = next(number for number, line in enumerate(lines) if line.startswith("---"))
    assert [line.split()[0] for line in lines[head + 1 : head + 61]] == list(fit.names)
    (answer,) = [line for line in lines if line.startswith("DIDIM ") and "Converged" in line]
    assert answer.split()[2] == str(fit.n_simulations)
    assert answer.endswith(f"Converged, {fit.verdict.state}")
    well = fit.relative_std_percent < 20.0
    worst = np.max(np.abs(tx40.deviations("didim")[well]))
    last = text.replace("\n", " ")
    assert f"DIDIM found 60 base parameters in {fit.n_iterations} iterations" in last
    assert last.endswith(
        f"the {well.sum()} with a sigma below 20 % are within {worst:.1f} sigma of the truth."
    )


def test_the_answer_comes_first_within_100_columns(tx40: Comparison, arm: Comparison) -> None:
    short = str(tx40).splitlines()
    assert short[3].split()[0] == "(truth)"
    assert short[4].split()[0] == "IDIM-LS"
    rows = [line for line in short if line.split()[:1] and line.split()[0] in tx40.fits["didim"].names]
    assert len(rows) == 10
    assert "10 of 60 base parameters; --all prints all of them." in short
    # Reasons of verdicts may be longer: only --all prints them.
    assert max(map(len, str(arm).splitlines())) <= 100
    assert max(map(len, short)) <= 100
    # An arm of 13 parameters loses three rows.
    assert sum(line.startswith(arm.fits["didim"].names) for line in str(arm).splitlines()) == 10
    assert (
        sum(line.startswith(arm.fits["didim"].names) for line in text_of(arm, every=True).splitlines()) == 13
    )


def test_the_truth_is_a_robot_that_can_be_built_unless_another_is_named() -> None:
    experiment = packaged_experiment("tx40")
    robot = experiment.robot
    np.testing.assert_array_equal(truth_of(experiment), robot.parameter_set("didim_physical"))
    np.testing.assert_array_equal(truth_of(experiment, "didim"), robot.parameter_set("didim"))
    conditions = link_cones(robot)
    assert violations(conditions, truth_of(experiment)) == []
    assert violations(conditions, truth_of(experiment, "didim"))


def test_the_table_of_all_methods(arm: Comparison) -> None:
    assert list(arm.fits) == [
        "idim-ls",
        "didim",
        "didim-consistent",
        "cloe-nelder-mead",
        "cloe-levenberg-marquardt",
    ]
    text = text_of(arm, every=True)
    (title,) = [
        line for line in text.splitlines() if line.split()[:1] == ["IDIM-LS"] and line.startswith("      ")
    ]
    assert title.split()[1:] == ["DIDIM", "consistent", "CLOE", "simplex", "CLOE"]
    wrapped = " ".join(text.splitlines())
    assert "Shortened: Nelder-Mead ends after 50 iterations" in wrapped
    assert ". CLOE, Levenberg-Marquardt is at the optimum after " in wrapped
    # A search without covariance has no sigma and no distance in it.
    (row,) = [line.split() for line in text.splitlines() if line.startswith("MX2 ")]
    assert row[10] == "-"
    assert np.isnan(arm.deviations("cloe-nelder-mead")).all()
    assert np.nanmax(np.abs(arm.deviations("didim"))) < 4.0


def test_the_sentence_of_a_failure(arm: Comparison) -> None:
    lost = replace(arm.fits["didim"], status=didim.Status.NO_STEP)
    assert sentences(replace(arm, fits={"didim": lost}))[0].startswith(
        "DIDIM did not converge: Not converged: with every step, however short"
    )
    assert sentences(replace(arm, fits={})) == ["DIDIM was not run."]


def test_json(tx40: Comparison, tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    tx40.save(path)
    data = json.loads(path.read_text(encoding="utf-8"))
    assert data["robot"] == "tx40"
    assert data["truth"]["ZZ1R"] == 1.24
    assert list(data["truth"]) == list(tx40.fits["didim"].names)
    assert set(data["methods"]) == {"idim-ls", "didim"}
    (tmp_path / "fit.json").write_text(json.dumps(data["methods"]["didim"]), encoding="utf-8")
    fit = Identification.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(fit.beta, tx40.fits["didim"].beta)
    assert data["methods"]["didim"]["history"][0]["step_length"] == 1.0
    assert data["methods"]["didim"]["history"][0]["residual_change"] is None
    # The log was made here: no recording was read.
    assert set(data["methods"]["didim"]["digests"]) == {"experiment tx40.toml", "robot tx40.toml"}


def test_noise_is_that_of_its_seed(experiment: Experiment) -> None:
    x = experiment.robot.parameter_set("reference")
    exact = simulated_log(experiment, x, noise=False)
    default, again, third, fourth = (measured(exact, seed) for seed in (None, None, 3, 4))
    for other in (again, third, simulated_log(experiment, x), simulated_log(experiment, x, seed=3)):
        np.testing.assert_array_equal(default.recordings[0].q, other.recordings[0].q)
        np.testing.assert_array_equal(default.recordings[0].tau, other.recordings[0].tau)
    assert default.recordings[0].tau is not None
    assert exact.recordings[0].tau is not None
    noise = default.recordings[0].tau - exact.recordings[0].tau
    np.testing.assert_allclose(noise.std(axis=0), [0.2, 0.1], rtol=0.05)
    assert np.max(np.abs(default.recordings[0].q - exact.recordings[0].q)) < 1e-4
    assert np.any(default.recordings[0].q != fourth.recordings[0].q)
    still = replace(exact, measurement=None)
    assert measured(still) is still


def test_the_log_is_simulated_with_finer_steps_than_the_identification(experiment: Experiment) -> None:
    x = experiment.robot.parameter_set("reference")
    coarse, fine, finer = (
        simulated_log(experiment, x, noise=False, refinement=parts).recordings[0] for parts in (1, 4, 8)
    )
    assert fine.tau is not None
    assert finer.tau is not None
    assert coarse.tau is not None
    assert 0.0 < np.abs(fine.tau - finer.tau).max() < 0.1 * np.abs(coarse.tau - finer.tau).max()


def test_without_noise_didim_meets_the_truth(experiment: Experiment) -> None:
    comparison = compare(experiment, parameters="reference", methods=[DIDIM()], noise=False)
    np.testing.assert_allclose(comparison.fits["didim"].beta, comparison.truth, atol=1e-5)


def test_the_callback_hears_method_and_iteration(experiment: Experiment) -> None:
    heard: list[tuple[str, int]] = []

    def listen(method: str, iteration: Iteration) -> None:
        heard.append((method, iteration.iteration))

    found = compare(experiment, parameters="reference", methods=LEAST_SQUARES, callback=listen)
    assert heard[:3] == [("idim-ls", 1), ("idim-ls", 2), ("didim", 1)]
    assert len(heard) == 2 + found.fits["didim"].n_iterations


def test_standard_deviations_and_solver_are_those_of_all_methods_that_have_them(
    experiment: Experiment,
) -> None:
    methods = all_methods(experiment, simplex_iterations=0, uncertainty="white", solver="huber")
    assert [method.uncertainty for method in methods] == ["white"] * 4  # type: ignore[attr-defined]
    assert [getattr(method, "solver", None) for method in methods] == ["huber", "huber", None, None]


def test_the_methods_start_where_the_robot_allows(experiment: Experiment) -> None:
    idim_ls, didim_method, consistent, simplex, levenberg = all_methods(packaged_experiment("tx40"))
    assert (idim_ls, didim_method) == LEAST_SQUARES
    assert consistent == DIDIM()
    assert isinstance(simplex, CLOE)
    assert isinstance(levenberg, CLOE)
    assert (simplex.start, levenberg.start) == ("apriori", "apriori")
    assert (simplex.optimizer, simplex.max_iterations) == ("nelder-mead", 1000)
    *_, full, _ = all_methods(experiment, simplex_iterations=None, variants=["literal"])
    assert isinstance(full, CLOE)
    assert (full.start, full.max_iterations, full.variant) == ("unit", None, "literal")
    names = [method.name for method in all_methods(experiment, simplex_iterations=0)]
    assert names == ["idim-ls", "didim", "didim", "cloe-levenberg-marquardt"]


def test_the_file_says_whether_methods_ask_for_a_robot(experiment: Experiment) -> None:
    """As in `identify`; a second one of the name is labelled by its own solver."""
    asked = replace(experiment, least_squares=replace(experiment.least_squares, physical=True))
    fits = compare(asked, methods=[IDIMLS(), IDIMLS(physical=False)], parameters="reference").fits
    solvers = {key: fit.settings["solver"]["name"] for key, fit in fits.items()}
    assert solvers == {"idim-ls": "consistent", "idim-ls-plain": "least-squares"}
    plain = replace(experiment, least_squares=replace(experiment.least_squares, physical=False))
    (fit,) = compare(plain, methods=[DIDIM()], parameters="reference").fits.values()
    assert fit.settings["solver"]["name"] == "least-squares"


def test_methods_of_one_name_have_labels_of_what_differs() -> None:
    taken: list[str] = []
    for method in (
        IDIMLS(),
        IDIMLS(physical=True),
        IDIMLS(),
        DIDIM(),
        DIDIM(physical=False),
        DIDIM(physical=False),
    ):
        taken.append(_key(method, taken))
    assert taken == [
        "idim-ls",
        "idim-ls-consistent",
        "idim-ls-plain",
        "didim",
        "didim-plain",
        "didim-plain-2",
    ]


def test_a_method_that_cannot_start_costs_no_other_result(experiment: Experiment) -> None:
    none = -np.asarray(experiment.robot.set_base("reference"))
    found = compare(experiment, parameters="reference", methods=[IDIMLS(), CLOE(start=none)])
    assert list(found.fits) == ["idim-ls"]
    (note,) = found.notes
    assert note.startswith("cloe-levenberg-marquardt gives no result: ")
    assert "CLOE cannot start from these parameters" in note
    assert note in str(found).replace("\n", " ")
    with pytest.raises(FitError, match="CLOE cannot start from these parameters"):
        compare(experiment, parameters="reference", methods=[CLOE(start=none)])


def test_what_cannot_be_compared(experiment: Experiment) -> None:
    with pytest.raises(ExperimentError, match="no packaged experiment for robot 'emps'"):
        compare("emps")
    with pytest.raises(DidimError, match="no parameter set 'didim'"):
        compare(experiment)
    with pytest.raises(ExperimentError, match="the seed of the noise must not be negative, got -1"):
        compare(experiment, parameters="reference", seed=-1)
    with pytest.raises(ExperimentError, match=r"needs the table \[reference\]"):
        compare(replace(experiment, reference=None), parameters="reference")
    printed = packaged_experiment("tx40")
    # Table II as in our copy: M(q) is indefinite, no such robot can be simulated.
    with pytest.raises(ExperimentError, match="the log cannot be simulated: the run ended at 0 s: M"):
        compare(printed, parameters="didim_printed")


# The command.


@pytest.mark.slow
def test_command(path: Path, arm: Comparison, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["compare", "--experiment", str(path), "--parameters", "reference", "--nelder-mead", "none"]
    assert main([*command, "--json", str(tmp_path / "out.json")]) == 0
    out, err = capsys.readouterr()
    data = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert set(data["methods"]) == {"idim-ls", "didim", "didim-consistent", "cloe-levenberg-marquardt"}
    values = [item["value"] for item in data["methods"]["didim"]["parameters"]]
    np.testing.assert_array_equal(values, arm.fits["didim"].beta)
    assert out.startswith("arm, simulated: 4 s at 500 Hz, 13 base parameters\n")
    titles = ["IDIM-LS", "DIDIM", "DIDIM, consistent", "CLOE, Levenberg-Marquardt"]
    assert [line.rpartition(": ")[0] for line in err.splitlines()] == titles
    assert main([*command, "--quiet", "--seed", "5", "--json", str(tmp_path / "five.json")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    other = json.loads((tmp_path / "five.json").read_text(encoding="utf-8"))
    assert other["truth"] == data["truth"]
    assert other["methods"]["didim"]["parameters"] != data["methods"]["didim"]["parameters"]
    assert main([*command, "--quiet", "--no-noise", "--json", str(tmp_path / "exact.json")]) == 0
    exact = json.loads((tmp_path / "exact.json").read_text(encoding="utf-8"))
    values = [item["value"] for item in exact["methods"]["didim"]["parameters"]]
    np.testing.assert_allclose(values, list(exact["truth"].values()), atol=1e-5)


def test_command_that_does_not_converge_is_exit_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # So slack a controller that twenty iterations do not do.
    slack = tmp_path / "slack.toml"
    slack.write_text(ARM.replace("natural_frequency_hz = 10", "natural_frequency_hz = 1"), encoding="utf-8")
    command = ["compare", "--experiment", str(slack), "--parameters", "reference", "--nelder-mead", "none"]
    assert main([*command, "--quiet"]) == 1
    assert "\nDIDIM did not converge: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--robot", "emps"], "didim: there is no packaged experiment for robot 'emps'"),
        (["--parameters", "nothing"], "didim: tx40.toml: no parameter set 'nothing'"),
        (["--seed", "-1"], "didim: the seed of the noise must not be negative, got -1"),
        (["--experiment", "nothing.toml"], "nothing.toml"),
        (["--contrast", "--solver", "huber"], "didim: --solver is not for --contrast"),
        (["--contrast", "--uncertainty", "white"], "didim: --uncertainty is not for --contrast"),
    ],
)
def test_wrong_commands_are_one_line_and_exit_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert message in err


def test_data_files_of_an_experiment_are_looked_up_in_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The log is simulated, but what the file names must be there."""
    (tmp_path / "data").mkdir()
    np.savez(tmp_path / "data" / "log.npz", q=np.zeros((100, 2)))
    path = tmp_path / "arm.toml"
    path.write_text(
        ARM
        + '[[recording]]\nrate_hz = 500\nposition = { file = "log.npz", variable = "q", unit = "rad", side = "joint" }\n',
        encoding="utf-8",
    )
    command = ["compare", "--experiment", str(path), "--parameters", "reference", "--quiet"]
    assert main([*command, "--nelder-mead", "none"]) == 2
    assert "log.npz" in capsys.readouterr().err
    assert main([*command, "--nelder-mead", "none", "--data", str(tmp_path / "data")]) == 0
