"""IDIM-IV, and contrasts of estimates from one log: which of the filter and the controller is wrong."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import DIDIM, IDIMIV, IDIMLS, Experiment, Identification, contrast, identify
from didim.cli.main import main
from didim.errors import FitError
from didim.experiment.loop import closed_loop
from didim.experiment.specs import ControllerSpec
from didim.loop.controller import Controller
from didim.result.contrast import reading
from didim.studies.compare import contrasts_of
from didim.studies.simulated_log import measured

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def exact() -> Experiment:
    experiment = didim.packaged_experiment("tx40")
    return didim.simulated_log(experiment, experiment.robot.parameter_set("didim"), noise=False)


@pytest.fixture(scope="module")
def truth(exact: Experiment) -> Array:
    return exact.robot.base_parameters.project(exact.robot.parameter_set("didim"))


@pytest.fixture(scope="module")
def log(exact: Experiment) -> Experiment:
    return measured(exact, 1)


@pytest.fixture(scope="module")
def fits(log: Experiment) -> dict[str, Identification]:
    return three(log)


def three(log: Experiment) -> dict[str, Identification]:
    return {method.name: identify(log, method) for method in (IDIMLS(), IDIMIV(), DIDIM(physical=False))}


def read(fits: dict[str, Identification]) -> tuple[str, float, float]:
    filters = contrast(fits["idim-ls"], fits["idim-iv"])
    controller = contrast(fits["idim-iv"], fits["didim"])
    return reading([filters, controller]), filters.rms, controller.rms


def with_slack_controller(log: Experiment, factor: float) -> Experiment:
    """The log for one of a controller whose position gains are so many times those of the real one."""
    laws = closed_loop(log).controller.laws.copy()
    laws[:, 0] *= factor
    law = replace(closed_loop(log).controller, laws=laws)

    def build(reference: object) -> Controller:
        return law

    return replace(log, controller=ControllerSpec(build=build, settings={"kind": "slack"}))


def test_idim_iv_finds_the_parameters_in_three_iterations(
    fits: dict[str, Identification], truth: Array
) -> None:
    fit = fits["idim-iv"]
    assert fit.converged
    assert fit.n_iterations == 3
    off = (fit.beta - truth) / fit.std
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.1, abs=0.25)
    # It is IDIM-LS where the columns of W have hardly any noise.
    assert np.abs((fit.beta - fits["idim-ls"].beta) / fit.std).max() < 0.1
    strength = fit.settings["instruments"]["strength"]
    assert max(strength.values()) < 0.01
    assert set(strength) == set(fit.names)
    assert len(fit.settings["instruments"]["durbin_watson"]) == 6


def test_without_noise_the_truth_is_met(exact: Experiment, truth: Array) -> None:
    sharp = replace(exact, signal=replace(exact.signal, cutoff_hz=None))
    fit = identify(sharp, IDIMIV())
    assert fit.converged
    # Central differences at 1 kHz are what is left.
    assert np.abs(fit.beta - truth).max() < 0.02


@pytest.mark.slow
def test_instruments_repair_a_noisy_regressor_that_nothing_averages(exact: Experiment, truth: Array) -> None:
    measurement = exact.measurement
    assert measurement is not None
    noisy = replace(measurement, position_noise=tuple(10.0 * s for s in measurement.position_noise))
    signal = replace(exact.signal, cutoff_hz=450.0, decimation=(), edge_rows=0)
    exact = replace(exact, recordings=(replace(exact.recordings[0], windows=((0, 3400),)),))  # rows at 1 kHz
    log = measured(replace(exact, measurement=noisy, signal=signal), 0)
    direct, instrumental = identify(log), identify(log, IDIMIV())
    sigma = identify(measured(exact, 0), DIDIM(physical=False)).std
    inertial = [k for k, name in enumerate(direct.names) if not name.startswith("F")]
    size = [np.sqrt(np.mean(((fit.beta - truth) / sigma)[inertial] ** 2)) for fit in (direct, instrumental)]
    assert size[0] > 50.0
    assert size[1] < 8.0
    worst = max(instrumental.settings["instruments"]["strength"].values())
    assert worst == pytest.approx(0.75, abs=0.1)
    assert any("weak instrument" in remark for remark in instrumental.remarks)
    test = instrumental.settings["instruments"]["durbin_wu_hausman"]
    assert test["p_value"] < 1e-10


def test_a_sound_log_gives_estimates_that_agree(fits: dict[str, Identification]) -> None:
    sentence, filters, controller = read(fits)
    assert "the estimates agree" in sentence
    assert filters == pytest.approx(1.1, abs=0.3)
    assert controller == pytest.approx(1.2, abs=0.3)
    found = contrast(fits["idim-ls"], fits["idim-iv"])
    assert found.bound == pytest.approx(3.96, abs=0.01)
    assert found.agree
    assert found.rms_in_sigma < 0.01
    assert "no difference beyond chance" in str(found)
    assert found.to_dict()["beyond"] == []


@pytest.mark.slow
def test_a_wrong_filter_is_exposed_by_instruments(log: Experiment) -> None:
    fits = three(replace(log, signal=replace(log.signal, cutoff_hz=60.0)))
    sentence, filters, _ = read(fits)
    assert "IDIM-LS and IDIM-IV differ in" in sentence
    assert "raise the cut-off" in sentence
    assert filters > 1.6
    assert len(contrast(fits["idim-ls"], fits["idim-iv"]).beyond) >= 3


@pytest.mark.slow
def test_a_wrong_controller_is_exposed_by_didim(log: Experiment, truth: Array) -> None:
    fits = three(with_slack_controller(log, 0.7))
    sentence, filters, _ = read(fits)
    assert "DIDIM differs from IDIM-IV in" in sentence
    assert "check controller" in sentence
    assert filters < 1.3
    found = contrast(fits["idim-iv"], fits["didim"])
    assert "Ia6" in found.large
    # The two that the sentence trusts are near the truth; DIDIM is not.
    first = fits["idim-ls"]
    assert first.uncertainty is not None
    noise = first.uncertainty.without_shift(first.std)
    off = {name: np.sqrt(np.mean(((fit.beta - truth) / noise) ** 2)) for name, fit in fits.items()}
    assert max(off["idim-ls"], off["idim-iv"]) < 1.5 < 5.0 < off["didim"]


def test_the_emps_has_wrong_friction_near_reversals(shared: Path, project: Path) -> None:
    log = didim.load_experiment(project / "examples/emps.toml", data=shared / "data/emps")
    filters, loop = contrasts_of(log).contrasts
    # tanh of 1 mm/s against the measured velocity.
    assert set(filters.beyond) == {"M1R", "Fv1", "Fc1"}
    assert filters.rms > 9.0
    assert set(loop.beyond) == {"Fv1", "Fc1"}
    assert loop.rms == pytest.approx(5.6, rel=0.05)
    assert "the observation matrix is wrong" in reading([filters, loop])


@pytest.mark.slow
def test_nothing_is_known_of_the_controller_of_the_tx40(shared: Path, project: Path) -> None:
    log = didim.load_experiment(project / "examples/tx40_didim.toml", data=shared / "data/tx40")
    filters, loop = contrasts_of(log).contrasts
    assert filters.agree
    assert filters.rms == pytest.approx(1.4, abs=0.1)
    assert loop.rms == pytest.approx(1.7, abs=0.1)
    assert len(loop.beyond) == 2
    assert "the simulated loop is wrong" in reading([filters, loop])


@pytest.mark.slow
@pytest.mark.usefixtures("without_alarm")
def test_the_deviation_of_a_difference_is_its_spread_over_logs(exact: Experiment) -> None:
    differences, stds = [], []
    for seed in range(12):
        log = measured(exact, seed)
        found = contrast(identify(log), identify(log, IDIMLS(weights="none")))
        differences.append(found.difference)
        stds.append(found.std)
    spread = np.std(differences, axis=0, ddof=1)
    ratio = np.sqrt(np.mean(np.square(stds), axis=0)) / spread
    assert np.median(ratio) == pytest.approx(1.0, abs=0.3)


def test_results_of_different_logs_are_refused(
    log: Experiment, exact: Experiment, fits: dict[str, Identification]
) -> None:
    half = replace(log, recordings=(replace(log.recordings[0], windows=((0, 5000),)),))
    with pytest.raises(FitError, match="are not from the same log"):
        contrast(fits["idim-ls"], identify(half))
    with pytest.raises(FitError, match='identify with uncertainty = "jackknife"'):
        contrast(fits["idim-ls"], identify(log, IDIMLS(uncertainty="white")))
    arm = replace(fits["didim"], names=tuple(reversed(fits["didim"].names)))
    with pytest.raises(FitError, match="different parameters"):
        contrast(fits["idim-ls"], arm)


@pytest.mark.slow
def test_compare_prints_the_contrasts_of_a_simulated_log(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["compare", "--contrast", "--quiet", "--seed", "1", "--json", str(tmp_path / "c.json")]) == 0
    text = capsys.readouterr().out
    assert "idim-iv less idim-ls: rms" in text
    assert text.rstrip().endswith("by the filter or by the controller.")
    data = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    assert set(data["methods"]) == {"idim-ls", "idim-iv", "didim"}
    assert [item["second"] for item in data["contrasts"]] == ["idim-iv", "didim"]
