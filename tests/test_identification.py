"""The result: immutable, aligned in print, and restored whole from its JSON."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from types import GenericAlias, SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from didim._tools.saved import restored
from didim.errors import FitError
from didim.result.identification import Identification
from didim.result.iteration import HeldOut, Iteration, Status
from didim.result.uncertainty import TimeBlock, Uncertainty


def example() -> Identification:
    """Two joints; a parameter is fixed, one is dropped, and one is uncertain."""
    covariance = np.zeros((5, 5))
    covariance[:3, :3] = [[0.1085**2, 1e-3, 0.0], [1e-3, 1.146**2, 0.0], [0.0, 0.0, 0.00816**2]]
    return Identification(
        name="two joints",
        robot="planar2",
        method="idim-ls",
        status=Status.SOLVED,
        names=("ZZ1R", "Fv1", "XY2", "Ia2", "MY2"),
        units=("kg.m^2", "N.m.s/rad", "kg.m^2", "kg.m^2", "kg.m"),
        roles=("estimated", "estimated", "estimated", "fixed", "dropped"),
        beta=np.array([95.108935, 203.503438, -0.011044, 0.1 + 0.2, 0.0]),
        covariance=covariance,
        parameter_names=("XX1", "ZZ1", "Fv1"),
        parameters=np.array([0.0, 95.1, 1.0 / 3.0]),
        relative_error=np.array([0.040833593, 0.12345]),
        overall_relative_error=0.06,
        error_norm=108.7569243,
        error_std=2.18433,
        condition_number=25.98830344,
        n_rows=2480,
        uncertainty=Uncertainty(
            kind="jackknife",
            degrees_of_freedom=3.0,
            std_white=np.array([0.1, 0.573, 0.00816, 0.0, 0.0]),
            joint_std=np.array([2.0, 0.1 + 0.2]),
            blocks=tuple(TimeBlock(0, k // 2, 0.5 * (k % 2), 0.5 * (k % 2) + 0.5) for k in range(4)),
            deletions=np.arange(20.0).reshape(4, 5) / 7.0,
            single_block={"XY2": 2},
        ),
        n_simulations=0,
        elapsed=0.25,
        history=(
            Iteration(iteration=1, relative_error=0.07, step=1.0),
            Iteration(iteration=2, relative_error=0.06, step=0.01, more={"scale": 0.5}),
        ),
        held_out=(HeldOut(name="night", relative_error=(0.05, float("nan")), overall_relative_error=0.08),),
        warnings=("Fc2 = -1 N.m is negative, by 3.0 sigma",),
        delay={"compensated_samples": 1.5, "estimated_samples": 1.5, "estimated_seconds": 0.0015},
        settings={"signal": {"cutoff_hz": 100.0, "decimation": [10]}, "fixed": {"Ia2": 0.3}},
        digests={"log.csv": "00ff"},
    )


def test_save_and_load_restore_everything(tmp_path: Path) -> None:
    fit = example()
    fit.save(tmp_path / "fit.json")
    loaded = Identification.load(tmp_path / "fit.json")
    # Text compares NaN too, and repr of a float is exact.
    assert json.dumps(loaded.to_dict()) == json.dumps(fit.to_dict())
    for key in ("beta", "covariance", "parameters", "relative_error"):
        np.testing.assert_array_equal(getattr(loaded, key), getattr(fit, key))
    assert loaded.status is Status.SOLVED
    assert loaded.history == fit.history
    assert loaded.names == fit.names
    assert loaded.roles == fit.roles
    assert loaded.elapsed == fit.elapsed
    assert str(loaded) == str(fit)
    assert [entry.name for entry in tmp_path.iterdir()] == ["fit.json"]


def test_the_json_has_the_agreed_keys(tmp_path: Path) -> None:
    example().save(tmp_path / "fit.json")
    data = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert data["schema"] == 1
    assert data["robot"] == "planar2"
    assert data["method"] == "idim-ls"
    assert data["status"] == Status.SOLVED.value
    assert data["converged"] is True
    assert data["n_iterations"] == 2
    assert data["n_simulations"] == 0
    assert data["elapsed_s"] == 0.25
    assert data["condition_number"] == 25.98830344
    assert data["relative_error"] == [0.040833593, 0.12345]
    assert data["error_norm"] == 108.7569243
    assert data["parameters"][0] == {
        "name": "ZZ1R",
        "unit": "kg.m^2",
        "value": 95.108935,
        "std": pytest.approx(0.1085),
        "relative_std_percent": pytest.approx(0.11407972),
        "low": pytest.approx(94.763639),
        "high": pytest.approx(95.454231),
        "std_white": 0.1,
        "role": "estimated",
    }
    # (11) has no value where the parameter is zero.
    assert data["parameters"][4]["relative_std_percent"] is None
    assert data["history"][1] == {"iteration": 2, "relative_error": 0.06, "step": 0.01, "scale": 0.5}
    assert data["held_out"][0]["relative_error"] == [0.05, None]
    assert data["settings"]["signal"]["decimation"] == [10]
    assert data["digests"] == {"log.csv": "00ff"}
    assert len(data["covariance"]) == 5


def test_immutable() -> None:
    fit = example()
    with pytest.raises(FrozenInstanceError):
        fit.name = "other"  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        fit.beta[0] = 0.0
    with pytest.raises(TypeError):
        fit.settings["signal"] = {}  # type: ignore[index]


def test_the_arrays_of_the_caller_stay_theirs() -> None:
    beta = np.arange(5.0)
    fit = replace(example(), beta=beta)
    beta[0] = 7.0
    assert fit.beta[0] == 0.0


def test_derived_values() -> None:
    fit = example()
    np.testing.assert_allclose(fit.std, [0.1085, 1.146, 0.00816, 0.0, 0.0])
    np.testing.assert_allclose(fit.std_ratio[:3], [1.085, 2.0, 1.0])
    assert np.isnan(fit.std_ratio[3:]).all()
    low, high = fit.confidence_interval(0.9)
    np.testing.assert_allclose(
        high - fit.beta, 2.353363 * fit.std, rtol=1e-6
    )  # Student, three degrees of freedom
    np.testing.assert_allclose(0.5 * (low + high), fit.beta)
    with pytest.raises(FitError, match="between 0 and 1, got 95"):
        fit.confidence_interval(95)
    np.testing.assert_allclose(fit.relative_std_percent[:4], [0.11407972, 0.56313545, 73.886273, 0.0])
    assert np.isnan(fit.relative_std_percent[4])
    assert fit.converged
    assert not replace(fit, status=Status.STOPPED).converged
    assert "two joints" in repr(fit)


def test_the_estimate_is_a_row_for_each_unknown() -> None:
    fit = example()
    low, high = fit.confidence_interval()
    for k, row in enumerate(fit.estimate):
        assert (row.name, row.unit, row.role, row.group) == (
            fit.names[k],
            fit.units[k],
            fit.roles[k],
            "robot",
        )
        assert [row.value, row.std] == [fit.beta[k], fit.std[k]]
        np.testing.assert_array_equal([row.low, row.high], [low[k], high[k]])
        assert row.source == {"estimated": "log", "fixed": "file", "dropped": "none"}[row.role]
    assert {row.role for row in fit.estimate} == {*fit.roles}


def test_table() -> None:
    assert str(example()).splitlines() == [
        "two joints: 5 base parameters of robot planar2 by idim-ls",
        "",
        "parameter  unit        estimate    sigma  sigma %   95 % low  95 % high  / white",
        "---------------------------------------------------------------------------------------------",
        "ZZ1R       kg.m^2      95.1089   0.1085    0.1141   94.7636    95.4542      1.08",
        "Fv1        N.m.s/rad  203.5034   1.1460    0.5631  199.8564   207.1505      2.00",
        "XY2        kg.m^2      -0.01104  0.00816  73.9      -0.03701    0.01492     1.00  * one block",
        "Ia2        kg.m^2       0.3                                                       fixed",
        "MY2        kg.m         0                                                         dropped",
        "* not well identified, sigma above 20 %: 1 of 5 parameters",
        "",
        "relative error %  joint 1  joint 2     all",
        "fit                4.0834    12.35  6.0000",
        "held out: night    5.0000     -     8.0000",
        "",
        "condition number 25.9883, error norm 108.7569, standard deviation of the error 2.1843, 2480 rows",
        "sigma by the jackknife, 4 blocks of time left out one at a time; median 1.08 times that of white noise",
        "only the rows of 0 to 0.5 s of window 2 of recording 1 determine XY2: sigma is a guess from noise",
        "torque recorded +1.50 samples (+1.500 ms) after the motion, by estimate",
        "torque moved back by 1.5 samples",
        "",
        "Doubtful:",
        "  Fc2 = -1 N.m is negative, by 3.0 sigma",
        "",
        Status.SOLVED.value,
        "Verdict: doubtful, for 1 reason: Fc2 = -1 N.m is negative, by 3.0 sigma.",
    ]


@pytest.mark.parametrize(
    ("value", "sigma", "printed"),
    [
        (100.0, 0.00114, ["100.00000", "0.00114", "0.00114"]),
        (1.0, 0.099996, ["1.0000", "0.1000", "9.9996"]),
        (1.0, 0.10004, ["1.0000", "0.1000", "10.0"]),
        (1.0, 0.9994, ["1.0000", "0.9994", "99.9"]),
        (1.0, 1.576, ["1.0000", "1.5760", "158"]),
        (1.0, 9.99, ["1.0000", "9.9900", "999"]),
        (1.0, 12.61, ["1.0000", "12.6100", ">999"]),
        (5e-324, 1.0, ["0.0000", "1.0000", ">999"]),
        (-3e-15, 2e-17, ["-3e-15", "2e-17", "0.6667"]),
        (2.5e150, 1e148, ["2.5e+150", "1e+148", "0.4000"]),
    ],
)
def test_digits_of_a_row(value: float, sigma: float, printed: list[str]) -> None:
    fit = example()
    beta, covariance = fit.beta.copy(), fit.covariance.copy()
    beta[0], covariance[0, 0] = value, sigma**2
    row = str(replace(fit, beta=beta, covariance=covariance)).splitlines()[4].split()
    assert row[2:5] == printed


def test_a_fixed_value_is_short() -> None:
    fit = example()
    beta = fit.beta.copy()
    beta[3] = 35.150651882485469
    (row,) = [line for line in str(replace(fit, beta=beta)).splitlines() if line.startswith("Ia2 ")]
    assert row.split() == ["Ia2", "kg.m^2", "35.1507", "fixed"]


def test_wrong_shapes() -> None:
    with pytest.raises(FitError, match=r"covariance must have shape \(5, 5\), got \(2, 2\)"):
        replace(example(), covariance=np.eye(2))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "fit.json: not a JSON file"),
        ("[1]", "fit.json: not the result of an identification, it has no 'schema'"),
        ("{}", "fit.json: not the result of an identification, it has no 'schema'"),
        ('{"schema": 2}', "fit.json: schema 2 is not the schema 1"),
        ('{"schema": 1}', "fit.json: key 'parameters' is missing or unknown"),
        ('{"schema": 1, "parameters": 3}', "fit.json: "),
        (f'{{"schema": 1{5000 * "0"}}}', "fit.json: not a JSON file: Exceeds the limit"),
        (100_000 * "[", "fit.json: not a JSON file: "),
    ],
)
def test_what_is_no_result_is_told(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "fit.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FitError, match=message):
        Identification.load(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("output_error", [1.0]),
        ("relative_error", [10**400]),
        ("warnings", [["text"]]),
        ("settings", {"robot": -1e300}),
    ],
)
def test_wrong_values_of_a_result_are_told(tmp_path: Path, key: str, value: object) -> None:
    path = tmp_path / "fit.json"
    path.write_text(json.dumps({**example().to_dict(), key: value}), encoding="utf-8")
    with pytest.raises(FitError, match=r"fit\.json: not the result of an identification: "):
        Identification.load(path)


def test_a_status_of_another_version_is_told(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    data = example().to_dict()
    data["status_name"] = "ASTRAY"
    path.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(FitError, match="'ASTRAY' is missing or unknown"):
        Identification.load(path)


def test_a_missing_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        example().save(tmp_path / "nowhere" / "fit.json")


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real.json").write_text("old", encoding="utf-8")
    (tmp_path / "link.json").symlink_to(tmp_path / "real.json")
    example().save(tmp_path / "link.json")
    assert (tmp_path / "link.json").is_symlink()
    assert Identification.load(tmp_path / "real.json").name == "two joints"


def test_every_status_is_a_sentence() -> None:
    for status in Status:
        assert status.value.endswith(".")
        assert len(status.value.split()) > 5


def test_names_of_joints_stand_below_the_errors() -> None:
    fit = replace(example(), settings={"robot": {"joint_names": ["shoulder", "elbow"]}})
    assert fit.joint_names == ("shoulder", "elbow")
    lines = str(fit).splitlines()
    errors = next(k for k, line in enumerate(lines) if line.startswith("relative error %"))
    assert "joints: 1 shoulder, 2 elbow" in lines[errors + 2 : errors + 5]
    assert "\njoints:" not in str(example())
    assert example().joint_names == ()


def test_arrays_are_restored_by_the_alias_of_later_versions_of_numpy() -> None:
    """`NDArray` is an alias with a `__value__` from NumPy 2.5 on, here a stand-in; results are read back as arrays."""
    alias = GenericAlias(cast(Any, SimpleNamespace(__value__=NDArray[np.float64])), (np.float64,))
    for kind in (alias, NDArray[np.float64]):
        found = restored(kind, [1.0, None])
        assert isinstance(found, np.ndarray)
        np.testing.assert_array_equal(found, [1.0, np.nan])
