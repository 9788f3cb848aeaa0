"""Standard deviations of results: the jackknife of every method, intervals, and what a result says of them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import CLOE, DIDIM, IDIMLS, Experiment, Identification, identify
from didim.experiment.experiment_file import load_experiment
from didim.methods.method import Method
from didim.methods.uncertainty import spread_of_fit
from didim.regression.least_squares import solve
from didim.regression.settings import LeastSquaresSettings
from didim.result.uncertainty import student_factor
from didim.studies.prediction import predict
from didim.studies.simulated_log import measured, simulated_log
from didim.terms.rows import LinearSystem, stacked
from didim.terms.unknown import Unknown, Unknowns

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def arm(project: Path) -> Experiment:
    experiment = load_experiment(project / "examples" / "planar2_simulation.toml")
    signal = didim.SignalProcessing(cutoff_hz=100, trim_start=50, trim_end=50, decimation=(10,))
    experiment = replace(experiment, signal=signal)
    return simulated_log(experiment, experiment.robot.parameter_set("reference"), noise=False)


@pytest.fixture(scope="module")
def truth(arm: Experiment) -> Array:
    return arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))


@pytest.fixture(scope="module")
def log(arm: Experiment) -> Experiment:
    return measured(arm, 1)


def all_estimated(count: int) -> Unknowns:
    return Unknowns(tuple(Unknown(name=str(k), unit="") for k in range(count)))


@pytest.mark.parametrize(
    "method",
    [IDIMLS(), DIDIM(), CLOE(start="unit"), CLOE(output="torque", start="unit")],
    ids=["idim-ls", "didim", "cloe", "clie"],
)
def test_every_method_has_the_jackknife(log: Experiment, truth: Array, method: Method) -> None:
    fit = identify(log, method)
    found = fit.uncertainty
    assert found is not None
    assert found.kind == "jackknife"
    assert found.degrees_of_freedom == 19.0
    assert found.deletions.shape == (20, len(fit.names))
    assert [block.recording for block in found.blocks] == [0] * 20
    assert found.joint_std.shape == (2,)
    # Its variances are those of the deletions, its correlations those of the noise.
    centred = found.deletions - found.deletions.mean(axis=0)
    estimated = [role == "estimated" for role in fit.roles]
    noise = found.without_shift(fit.std)
    assert noise[estimated] == pytest.approx(np.sqrt(19.0 / 20.0 * np.sum(centred**2, axis=0))[estimated])
    assert np.linalg.eigvalsh(fit.covariance).min() > 0.0
    assert 0.3 < np.median(fit.std_ratio) < 3.0
    assert "sigma by the jackknife, 20 blocks of time left out one at a time" in str(fit)
    assert np.abs(fit.beta - truth).max() < 10.0 * fit.std.max()


def test_the_other_kinds_are_those_of_the_noise(log: Experiment) -> None:
    white, decimated, jackknife = (
        identify(log, IDIMLS(uncertainty=kind)) for kind in ("white", "decimated", "jackknife")
    )
    for fit in (white, decimated, jackknife):
        assert fit.std_white == pytest.approx(white.std, rel=1e-9)
        assert fit.beta == pytest.approx(white.beta)
    assert white.uncertainty is not None
    assert white.uncertainty.kind == "white"
    assert white.std_ratio == pytest.approx(np.ones(len(white.names)))
    assert white.uncertainty.degrees_of_freedom == white.n_rows - len(white.names)
    assert np.median(decimated.std_ratio) > 1.05
    assert jackknife.std != pytest.approx(decimated.std)
    # Correlations are those of decimated noise.
    for fit in (decimated, jackknife):
        size = np.outer(fit.std, fit.std)
        assert fit.covariance / size == pytest.approx(
            decimated.covariance / np.outer(decimated.std, decimated.std)
        )


@pytest.mark.slow
def test_intervals_cover_the_truth(arm: Experiment, truth: Array) -> None:
    covered, ratios = [], []
    for seed in range(12):
        fit = identify(measured(arm, seed), DIDIM())
        low, high = fit.confidence_interval(0.95)
        covered.append((low <= truth) & (truth <= high))
        ratios.append((fit.beta - truth) / fit.std)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.04)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.15)


def test_intervals_have_students_factor() -> None:
    assert student_factor(0.95, 19.0) == pytest.approx(2.0930, abs=1e-4)
    assert student_factor(0.95, np.inf) == pytest.approx(1.95996, abs=1e-5)
    for level in (0.0, 1.0, 95, True, "much"):
        with pytest.raises(didim.errors.FitError, match="between 0 and 1"):
            student_factor(level, 19.0)  # type: ignore[arg-type]


def test_a_result_without_covariance_has_no_intervals(log: Experiment) -> None:
    fit = identify(log, CLOE(optimizer="nelder-mead", start="unit", max_iterations=20))
    assert fit.uncertainty is None
    assert np.isnan(fit.confidence_interval()[0]).all()
    assert np.isnan(fit.std_white).all()


def test_everything_comes_back_from_the_file(log: Experiment, tmp_path: Path) -> None:
    fit = identify(log)
    fit.save(tmp_path / "fit.json")
    loaded = Identification.load(tmp_path / "fit.json")
    assert loaded.uncertainty is not None
    assert fit.uncertainty is not None
    assert loaded.uncertainty.blocks == fit.uncertainty.blocks
    assert np.array_equal(loaded.uncertainty.deletions, fit.uncertainty.deletions)
    assert np.array_equal(loaded.std_white, fit.std_white)
    assert str(loaded) == str(fit)
    record = fit.to_dict()["parameters"][0]
    assert record["low"] < record["value"] < record["high"]


def test_a_parameter_of_one_block_alone_is_named() -> None:
    rng = np.random.default_rng(0)
    w = rng.standard_normal((400, 3))
    w[np.arange(400) % 200 > 6, 1] = 0.0
    y = w @ [1.0, 2.0, 3.0] + 0.1 * rng.standard_normal(400)
    system = LinearSystem(w=w, y=y, blocks=stacked(2, [200], rates_hz=[10.0]), names=("A", "B", "C"))
    settings = LeastSquaresSettings()
    selection = all_estimated(3)
    fit = solve(system, settings)
    spread = spread_of_fit(system, fit, settings, selection)
    assert spread.uncertainty is not None
    assert dict(spread.uncertainty.single_block) == {"B": 0}
    # Two others: the median of their ratios is the mean. Errors of a model make it large for all, white noise does not.
    ratios = np.diag(spread.covariance) / np.diag(fit.covariance)
    assert ratios[1] == pytest.approx(max(1.0, (ratios[0] + ratios[2]) / 2))
    lasting = replace(system, y=system.y + np.tile(np.repeat(rng.standard_normal(20), 10), 2))
    wrong = solve(lasting, settings)
    ratios = np.diag(spread_of_fit(lasting, wrong, settings, selection).covariance) / np.diag(
        wrong.covariance
    )
    assert ratios[1] == pytest.approx((ratios[0] + ratios[2]) / 2)
    assert not np.isclose(ratios[0], 1.0)
    lines = spread.uncertainty.lines(np.sqrt(np.diag(spread.covariance)))
    assert "only the rows of 0 to 1 s determine B: sigma is a guess from noise" in lines


def test_errors_that_outlast_blocks_are_a_remark() -> None:
    rng = np.random.default_rng(1)
    w = rng.standard_normal((800, 2)) + 1.0
    y = w.sum(axis=1) + np.tile(np.repeat(rng.standard_normal(5), 80), 2)
    system = LinearSystem(w=w, y=y, blocks=stacked(2, [400], rates_hz=[10.0]), names=("A", "B"))
    selection = all_estimated(2)
    spread = spread_of_fit(system, solve(system, LeastSquaresSettings()), LeastSquaresSettings(), selection)
    assert spread.uncertainty is not None
    fewer = int(spread.uncertainty.degrees_of_freedom) + 1
    assert (len(spread.uncertainty.deletions), fewer <= 10) == (20, True)
    assert spread.remarks == (
        f"neighbouring blocks of time err alike: the jackknife takes {fewer} blocks instead of 20",
    )
    assert f"by the jackknife, {fewer} blocks" in spread.uncertainty.origin


def test_few_rows_are_said_to_be_few() -> None:
    rng = np.random.default_rng(0)
    w = rng.standard_normal((30, 12))
    system = LinearSystem(
        w=w, y=w.sum(axis=1) + rng.standard_normal(30), blocks=stacked(2, [15]), names=tuple("ABCDEFGHIJKL")
    )
    selection = all_estimated(12)
    fit = solve(system, LeastSquaresSettings())
    spread = spread_of_fit(system, fit, LeastSquaresSettings(), selection)
    assert any("takes 5 blocks of time instead of 20" in remark for remark in spread.remarks)
    assert any("30 rows for 12 parameters are few" in remark for remark in spread.remarks)


def test_predicted_torques_have_intervals(arm: Experiment) -> None:
    fit = identify(measured(arm, 1))
    other = measured(arm, 2)
    (found,) = predict(fit, other)
    low, high = found.interval(0.95)
    inside = (low <= found.measured) & (found.measured <= high)
    assert inside.mean() == pytest.approx(0.95, abs=0.04)
    # Most of it is the residual: parameters alone explain a part of the width.
    assert fit.uncertainty is not None
    assert found.std is not None
    assert (found.std.min(axis=0) >= fit.uncertainty.joint_std).all()


def test_real_tx40_sigmas_are_twice_those_of_noise(project: Path, shared: Path) -> None:
    experiment = load_experiment(project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40")
    fit, noise = identify(experiment), identify(experiment, IDIMLS(uncertainty="decimated"))
    assert fit.uncertainty is not None
    assert np.median(fit.uncertainty.without_shift(fit.std) / noise.std) == pytest.approx(1.95, abs=0.1)
    assert not fit.uncertainty.single_block


@pytest.mark.parametrize(("pieces", "smallest", "largest"), [(2, 0.85, 1.2), (3, 0.75, 1.2)])
def test_parts_of_the_real_tx40_log_agree_within_their_sigmas(
    project: Path, shared: Path, pieces: int, smallest: float, largest: float
) -> None:
    experiment = load_experiment(project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40")
    (recording,) = experiment.recordings
    edges = np.linspace(0, len(recording.q), pieces + 1).astype(int)
    fits = [
        identify(replace(experiment, recordings=(replace(recording, windows=((start, stop),)),)))
        for start, stop in pairwise(edges.tolist())
    ]
    pairs = [(fits[i], fits[j]) for i in range(pieces) for j in range(i)]
    z = np.array([(a.beta - b.beta) / np.hypot(_of_noise(a), _of_noise(b)) for a, b in pairs])
    # Of three parts one has longer blocks, which widens its deviations: 0.80.
    assert smallest < np.sqrt(np.mean(z**2)) < largest
    assert np.mean(np.abs(z) < 1.96) >= 0.9
    # The shift of friction that the model lacks is on top: the parts share that error.
    reported = np.array([(a.beta - b.beta) / np.hypot(a.std, b.std) for a, b in pairs])
    assert (np.abs(reported) <= np.abs(z) * (1.0 + 1e-9)).all()


def _of_noise(fit: Identification) -> Array:
    assert fit.uncertainty is not None
    return fit.uncertainty.without_shift(fit.std)
