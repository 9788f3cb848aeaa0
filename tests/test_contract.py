"""Every method keeps the contract of `contract.py`; a method that breaks it is caught."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import pytest

from contract import CHECKS, Contract, check_method
from didim import CLOE, DIDIM, IDIMIV, IDIMLS, Experiment, Identification
from didim.methods.method import Motion
from didim.methods.table import METHODS
from didim.regression.solver import SOLVERS
from didim.result.iteration import Reporter

pytestmark = pytest.mark.usefixtures("without_causes")

NELDER_MEAD = partial(CLOE, optimizer="nelder-mead", start="idim-ls", max_iterations=60)

METHODS_UNDER_CONTRACT: dict[str, Contract] = {
    "idim-ls": Contract(make=IDIMLS),
    "idim-ls huber": Contract(make=partial(IDIMLS, solver="huber")),
    "idim-ls bisquare": Contract(make=partial(IDIMLS, solver="bisquare")),
    "idim-ls consistent": Contract(make=partial(IDIMLS, physical=True)),
    "idim-iv": Contract(make=IDIMIV, needs_controller=True),
    "didim plain": Contract(make=partial(DIDIM, physical=False), needs_controller=True),
    "didim consistent": Contract(make=DIDIM, needs_controller=True),
    "cloe levenberg-marquardt": Contract(
        make=partial(CLOE, start="idim-ls"), needs_controller=True, needs_torque=False
    ),
    # A simplex that is stopped after so few iterations has no standard deviations.
    "cloe nelder-mead": Contract(make=NELDER_MEAD, needs_controller=True, needs_torque=False, coverage=None),
}


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", METHODS_UNDER_CONTRACT)
def test_a_method_keeps(name: str, check: Callable[[Contract], None]) -> None:
    check(METHODS_UNDER_CONTRACT[name])


def test_every_method_and_every_solver_is_under_contract() -> None:
    assert {name.split()[0] for name in METHODS_UNDER_CONTRACT} == set(METHODS)
    solvers = {name.partition(" ")[2] for name in METHODS_UNDER_CONTRACT if name.startswith("idim-ls ")}
    assert solvers == set(SOLVERS) - {"least-squares"}


@dataclass(frozen=True, kw_only=True)
class Own:
    """A method of one's own: least squares, with one promise of the contract broken."""

    broken: str = ""
    fixed: Mapping[str, float] | None = None
    dropped: Sequence[str] | None = None

    name: ClassVar[str] = "own"
    motion: ClassVar[Motion] = "measured"
    raw: ClassVar[bool] = False

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        forgets = self.broken == "keeps_fixed_and_dropped"
        inner = IDIMLS(fixed=None if forgets else self.fixed, dropped=None if forgets else self.dropped)
        if self.broken == "calls_back":
            reporter = reporter.without_iterations
        elif self.broken == "refuses_in_one_sentence" and experiment.recordings[0].tau is None:
            raise ValueError("no torques")
        fit = inner.run(experiment, reporter)
        if self.broken == "recovers_without_noise":
            fit = replace(fit, beta=1.01 * fit.beta)
        elif self.broken == "covers_the_truth":
            fit = replace(fit, covariance=0.1 * fit.covariance)
        elif self.broken == "repeats_bit_by_bit":
            fit = replace(fit, beta=fit.beta * (1.0 + 1e-15 * next(COUNT)))
        return fit


COUNT = itertools.count()


def test_a_method_of_ones_own_passes() -> None:
    check_method(Contract(make=Own))


@pytest.mark.parametrize(
    "promise",
    [
        "recovers_without_noise",
        "repeats_bit_by_bit",
        "calls_back",
        "keeps_fixed_and_dropped",
        "refuses_in_one_sentence",
        "covers_the_truth",
    ],
)
def test_a_broken_promise_is_caught(promise: str) -> None:
    (check,) = (check for check in CHECKS if check.__name__ == promise)
    with pytest.raises((AssertionError, ValueError)):
        check(Contract(make=partial(Own, broken=promise)))
