"""Samples of a fit: their distribution beside scipy's and the covariance, a fleet whose spread is known, and MuJoCo with draws."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import didim
from didim import Identification
from didim.cli.main import main
from didim.errors import FitError
from didim.methods.cloe.cloe import CLOE
from didim.result.samples import draws_between
from scripts import script
from test_positions import commands, twin

ROOT = Path(__file__).resolve().parents[1]
WITHOUT = np.full(3, -np.inf), np.full(3, np.inf)


@pytest.mark.parametrize("freedom", [np.inf, 7.0])
def test_draws_have_the_marginals_and_the_correlation_of_their_covariance(freedom: float) -> None:
    std = np.array([0.01, 2.0, 0.0])
    covariance = np.array([[1.0, -0.9, 0.0], [-0.9, 1.0, 0.0], [0.0, 0.0, 1.0]]) * np.outer(std, std)
    draws = draws_between(np.array([0.03, 5.0, 7.0]), covariance, WITHOUT, freedom, (20000, 0))
    law = stats.norm if np.isinf(freedom) else stats.t(freedom)
    for k, centre in enumerate((0.03, 5.0)):
        expected = centre + std[k] * law.ppf([0.025, 0.25, 0.5, 0.75, 0.975])
        found = np.quantile(draws[:, k], [0.025, 0.25, 0.5, 0.75, 0.975])
        np.testing.assert_allclose(found, expected, atol=0.05 * std[k])
    assert stats.spearmanr(draws[:, :2]).statistic == pytest.approx(
        6.0 / np.pi * np.arcsin(-0.45) if np.isinf(freedom) else -0.885, abs=0.01
    )
    assert (draws[:, 2] == 7.0).all()


@pytest.mark.parametrize("freedom", [np.inf, 7.0])
def test_draws_between_bounds_are_those_that_remain_without_the_others(freedom: float) -> None:
    """Two that exchange, near zero and another bound: beside draws of which those outside are thrown away."""
    centre, low, high = np.array([0.1, 0.5]), np.zeros(2), np.array([np.inf, 0.9])
    covariance = np.array([[0.04, -0.05], [-0.05, 0.1]])
    draws = draws_between(centre, covariance, (low, high), freedom, (20000, 1))
    random = np.random.default_rng(2)
    other = random.multivariate_normal(np.zeros(2), covariance, 400000)
    if np.isfinite(freedom):
        other /= np.sqrt(random.chisquare(freedom, (400000, 1)) / freedom)
    other += centre
    other = other[((other >= low) & (other <= high)).all(axis=1)]
    assert len(other) < 300000
    for k in range(2):
        one, two = (np.quantile(each[:, k], [0.05, 0.25, 0.5, 0.75, 0.95]) for each in (draws, other))
        np.testing.assert_allclose(one, two, atol=0.012)
    one, two = (np.corrcoef(each[:, 0], each[:, 1]) for each in (draws, other))
    np.testing.assert_allclose(one, two, atol=0.02)


def test_no_draw_of_an_unknown_at_its_bound_is_moved_there() -> None:
    """Twelve whose estimates are zero, as the friction of a quadruped may be: the upper half of Student's distribution each."""
    draws = draws_between(
        np.zeros(12), np.diag(np.arange(1.0, 13.0) ** 2), (np.zeros(12), np.full(12, np.inf)), 20.0, (2000, 0)
    )
    assert (draws > 0.0).all()
    assert stats.kstest((draws / np.arange(1.0, 13.0)).ravel(), stats.t(20.0).cdf).statistic > 0.4
    for k in (0, 11):
        assert stats.kstest(draws[:, k] / (k + 1.0), lambda x: 2.0 * stats.t(20.0).cdf(x) - 1.0).pvalue > 1e-3


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of a motor with a vertical axis and next to no link: all its torques may take the factor of a gain."""
    folder = tmp_path_factory.mktemp("motor")
    inertia = '<inertial pos="0 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/>'
    text = f'<mujoco><worldbody><body>{inertia}<joint name="turn" axis="0 0 1" armature="0.01"/></body></worldbody></mujoco>'
    unknown = "kp = { start = 20.0, sigma = 2.0 }\nkv = {}\ndelay_s = { max = 0.05 }"
    experiment = twin(folder, text, commands(1, 8.0, steps=True), noise=3e-3, unknown=unknown)
    fit = didim.identify(experiment, CLOE(threads=1), verbose=False)
    fit.save(folder / "fit.json")
    return folder / "fit.json"


def test_what_the_log_does_not_tell_is_named_and_has_its_value_or_the_width_of_its_prior(path: Path) -> None:
    samples = Identification.load(path).samples(4000, seed=1)
    at = {name: k for k, name in enumerate(samples.names)}
    told = {name: samples.origins[k] for name, k in at.items() if samples.origins[k] != "log"}
    assert told == {"kp1": "prior", "kv1": "held"}
    assert samples.texts[at["kv1"]].startswith("only Fv + kv is known")
    assert (samples.values[:, at["kv1"]] == 0.5).all()
    assert "the log does not tell kv1: all draws have one value of each" in str(samples)
    gain = samples.values[:, at["kp1"]]
    assert gain.std() == pytest.approx(2.0, rel=0.1)
    for name in ("Ia1", "Fc1"):  # only their ratios to the gain are known
        torque = samples.values[:, at[name]]
        assert np.corrcoef(gain, torque)[0, 1] > 0.98
        assert np.std(torque / gain) < 0.2 * torque.std() / gain.mean()


def test_draws_have_the_covariance_of_the_fit_and_are_widened_by_the_spread_between_logs(path: Path) -> None:
    """With a hundredth of the covariance, so that no bound is near."""
    fit = Identification.load(path)
    fit = replace(fit, covariance=fit.covariance / 100.0)
    plain = fit.samples(3000)
    assert fit.uncertainty is not None
    freedom = fit.uncertainty.degrees_of_freedom
    factor = np.sqrt(freedom / (freedom - 2.0))  # of Student's distribution
    known = np.array([origin == "log" for origin in plain.origins])
    np.testing.assert_allclose(plain.values.std(axis=0)[known], factor * fit.std[known], rtol=0.07)
    np.testing.assert_allclose(
        np.corrcoef(plain.values[:, :3].T),
        fit.covariance[:3, :3] / np.outer(fit.std[:3], fit.std[:3]),
        atol=0.02,
    )
    np.testing.assert_array_equal(fit.samples(3000).values, plain.values)
    assert not np.array_equal(fit.samples(3000, seed=1).values, plain.values)
    settings = json.loads(json.dumps(dict(fit.settings)))
    settings["positions"]["rows"][0]["runs"] = 2.0 * fit.std[0]
    wider = replace(fit, settings=settings).samples(3000)
    assert np.std(wider.values[:, 0]) / np.std(plain.values[:, 0]) == pytest.approx(np.sqrt(5.0), rel=0.06)
    assert "the draws are widened by what the logs differ among each other" in str(wider)
    del settings["positions"]["rows"][0]["bounds"]
    with pytest.raises(FitError, match="of an older version lacks what samples need: identify the log again"):
        replace(fit, settings=settings).samples()
    with pytest.raises(FitError, match=r"at least 20 draws, a whole number, got 100\.5"):
        fit.samples(100.5)  # type: ignore[arg-type]
    with pytest.raises(FitError, match="no standard deviations: its log is too short"):
        replace(fit, uncertainty=None).samples()


def test_files_of_samples(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("draws.npz", "draws.json"):
        command = ["export", str(path), "--samples", "200", "--seed", "3", "-o", str(tmp_path / name)]
        assert main(command) == 0
        assert capsys.readouterr().out.splitlines()[0].split() == [
            "unit",
            "estimate",
            "5",
            "%",
            "50",
            "%",
            "95",
            "%",
            "from",
        ]
    arrays, data = np.load(tmp_path / "draws.npz"), json.loads((tmp_path / "draws.json").read_text())
    assert {*arrays} == {*data}
    assert arrays["values"].shape == (200, 7)
    for key in (
        "names",
        "kinds",
        "units",
        "origins",
        "texts",
        "values",
        "estimate",
        "ranges",
        "percent",
        "seed",
    ):
        np.testing.assert_array_equal(arrays[key], data[key])
    assert data["joints"] == [["turn"]] * 7
    np.testing.assert_allclose(arrays["ranges"], np.percentile(arrays["values"], [5, 50, 95], axis=0))
    assert main(["export", str(path), "--mjlab", "--ranges"]) == 0
    assert '"gains_turn": EventTermCfg(func=dr.pd_gains' in capsys.readouterr().out
    assert main(["export", str(path), "--mjlab", "--seed", "1"]) == 2
    assert "--seed is for --samples" in capsys.readouterr().err
    assert main(["export", str(path), "--bam", "--ranges"]) == 2
    assert "--ranges is for --mjlab and --isaac-lab" in capsys.readouterr().err
    for options in (["-o", "draws.csv"], [], ["-o", "draws.npz", "--payload", "none"]):
        assert main(["export", str(path), "--samples", "200", *options]) == 2
        assert "needs -o NAME.npz or NAME.json" in capsys.readouterr().err
    assert main(["export", str(path), "--samples", "2", "-o", str(tmp_path / "few.npz")]) != 0
    assert "samples need at least 20 draws, a whole number, got 2" in capsys.readouterr().err


@pytest.mark.slow
def test_a_fleet_moves_as_the_draws_of_its_logs(tmp_path: Path) -> None:
    """Six arms with spreads of 15 to 20 %, simulated by MuJoCo: their logs tell the spread, and draws what six others do."""
    bench = script(ROOT / "benches" / "positions.py")
    fit, arms, shares = bench.fleet(tmp_path, 12, 5.0, 60)
    samples = fit.samples(100)
    for kind in ("Ia", "Fv", "Fc"):
        found = samples.runs[np.array(samples.kinds) == kind]
        ratio = found / np.std([p[kind] for p in arms], axis=0, ddof=1)
        assert 0.6 < np.median(ratio) < 1.4
    assert samples.runs[samples.kinds.index("delay_s")] < 1e-3  # all have one
    within, every = shares.mean(axis=(0, 2))
    assert every > 0.9
    assert 0.75 < within < 0.97
