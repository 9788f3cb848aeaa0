"""What version 0.3.0 estimated is what this version estimates, and with as many iterations and simulations."""

from __future__ import annotations

from pathlib import Path

import pytest

from conftest import SKIP_REASON
from golden import CASES, DATA, differences, digest, known, measured, numbers

ONE_SOLUTION, SEARCHED = 1e-8, 1e-6
"""Largest change by rounding, in standard deviations: of a linear problem, and of positions, whose derivatives are differences.
Kernels for two processors differ by 2e-11 and 1e-8."""


def test_friction_chosen_on_a_ur10e_takes_a_third_of_the_error() -> None:
    plain, auto = (known()[f"ls-ur10e{choice}"] for choice in ("", "-auto"))
    assert {"Fl2", "Fl3"} <= set(auto["names"])
    assert sum(auto["relative_error"]) < (1.0 - 1.0 / 3.0) * sum(plain["relative_error"])


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_case_has_the_numbers_of_0_3_0(name: str) -> None:
    for file in measured(name):
        if not Path(DATA / file).is_file():
            pytest.skip(SKIP_REASON)
        assert digest(DATA / file) == known()[name]["data"][file], f"{file} is another file"
    now, then = numbers(name), known()[name]
    assert {key: now[key] for key in ("status", "iterations", "simulations")} == {
        key: then[key] for key in ("status", "iterations", "simulations")
    }
    value, std = differences(name, now)
    most = SEARCHED if name.startswith(("cloe", "positions")) else ONE_SOLUTION
    assert value <= most
    assert std <= most
    assert now["relative_error"] == pytest.approx(then["relative_error"], rel=1e-6)
