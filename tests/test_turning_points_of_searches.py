"""Searches of the methods and of designs end, shorten their steps and choose their ways where their documentation says.

The numbers stand here as they are documented, so that one which is doubled or halved is noticed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import didim.excitation.criterion as criterion
import didim.excitation.problem as design
from didim.excitation.problem import Problem
from didim.experiment.specs import SimulationSettings
from didim.methods.cloe.simplex import SimplexSearch
from didim.methods.didim.simulability import chosen_steps
from didim.methods.job import Job
from didim.signal.filters import low_pass
from didim.signal.processing import SignalProcessing
from didim.signal.steps import smoothed
from plain import stub

Array = NDArray[np.float64]


@pytest.mark.parametrize(("fall", "again"), [(0.8e-6, False), (1.2e-6, True)])
def test_a_restart_of_a_simplex_that_was_worth_it(fall: float, again: bool) -> None:
    def edged(point: object, norm: float) -> None:
        raise InterruptedError  # it begins anew

    search = stub(
        simplex=stub(values=[1.0 - fall]), before=1.0, stalled=False, patient=True, best=None, _edged=edged
    )
    if again:
        with pytest.raises(InterruptedError):
            SimplexSearch._restart(search)
    else:
        assert not SimplexSearch._restart(search)


def test_edges_of_a_simplex_change_the_outputs_by_three_tenths_of_their_errors() -> None:
    problem = stub(
        errors=lambda points: ([None], None), derivatives=lambda point, errors: stub(normal=np.diag([4.0, 25.0])),
        scale=np.full(2, 9.0), safe_share=lambda point, target: 1.0,
    )  # fmt: skip
    _, edges = SimplexSearch._edged(stub(problem=problem), np.zeros(2), 4.0)
    assert edges == pytest.approx([0.3 * 4.0 / 2.0, 0.3 * 4.0 / 5.0])


def test_steps_in_time_are_two_microseconds_at_least() -> None:
    """Rounded down to a quarter of an octave."""
    coarse, fine = chosen_steps(1e9, np.full(1, 1e9), SimulationSettings())
    assert 2e-6 / 2.0**0.25 < coarse <= 2e-6
    assert fine == (coarse,)


def test_a_millimetre_of_clearance_weighs_a_hundredth_of_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Squared as the excess of a torque is."""
    zero = np.zeros((1, 1))
    monkeypatch.setattr(design, "_core", stub(information_gradient=lambda *given: (zero, zero, zero)))
    clearance = stub(empty=False, penalty=lambda q, scale, extra: ((1e-3 / scale) ** 2, zero))
    motion = stub(motion=lambda: (zero, zero, zero))
    problem = stub(
        series=stub(build=lambda v: (motion, None), back=lambda *given: zero), thinning=1, torques=lambda *given: None,
        information=stub(matrix=lambda *given: None, robot=stub(core=None), columns=[], samples=1.0, sigma=np.ones(1)),
        criterion=lambda matrix: (0.0, zero), clearance=clearance, extra_clearance=0.0, x=None, _whole=lambda values: values,
    )  # fmt: skip
    assert Problem.value(problem, np.zeros(1), 1.0)[0] == pytest.approx(0.01**2)


@pytest.mark.parametrize(("pivot", "regular"), [(0.8e-5, False), (1.2e-5, True)])
def test_a_pivot_that_proves_an_information_regular(
    pivot: float, regular: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It needs no eigenvalues, which take ten times as long, and is not raised to the least one."""
    eigenvalues: list[int] = []
    eigh = np.linalg.eigh

    def counted(matrix: Array) -> Any:
        eigenvalues.append(1)
        return eigh(matrix)

    monkeypatch.setattr("numpy.linalg.eigh", counted)
    beside = np.sqrt(1.0 - pivot**2)
    value, _ = criterion.log_determinant(np.array([[1.0, beside], [beside, 1.0]]))
    assert value == pytest.approx(2.0 * np.log(pivot), rel=1e-5)
    assert not eigenvalues if regular else eigenvalues


def test_motion_between_steps_is_sought_from_an_eighth_of_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    cutoffs: list[float | None] = []

    def low_pass(q: Array, rate_hz: float, signal: SignalProcessing) -> Array:
        cutoffs.append(signal.cutoff_hz)
        return q

    monkeypatch.setattr("didim.signal.steps.low_pass", low_pass)
    for cutoff in (24.0, None):  # half of the rate without one
        smoothed(np.zeros((9, 1)), 100.0, SignalProcessing(cutoff_hz=cutoff), np.ones(1))
    assert cutoffs == [3.0, 6.0, 12.0, 6.25, 12.5, 25.0]


@pytest.mark.parametrize(
    ("steps", "fast", "follows"),
    [(56.0, 0.0, False), (64.0, 0.0, True), (300.0, 0.1, True), (300.0, 0.26, False)],
)
def test_motion_of_sixty_steps_that_loses_a_tenth_of_their_noise_is_smoothed(
    steps: float, fast: float, follows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Motion at 10 Hz is lost by the lowest low pass, which is the only one here beside that of the noise."""
    monkeypatch.setattr("didim.signal.steps.DIVISORS", (8.0, 2.0))
    t = np.arange(5000)[:, None] / 500.0
    q = 0.5 * steps * np.sin(2.0 * np.pi * 1.03 * t) + fast * np.sin(2.0 * np.pi * 10.3 * t)
    made = smoothed(np.round(q), 500.0, SignalProcessing(cutoff_hz=50.0), np.ones(1))
    lowest = low_pass(np.round(q), 500.0, SignalProcessing(cutoff_hz=6.25))
    assert (bool(made.follows[0]) and np.array_equal(made.q, lowest)) == follows


@pytest.mark.parametrize(("cutoff_hz", "tried"), [(198.0, [198.0, 396.0]), (202.0, [202.0])])
def test_delays_are_estimated_with_cut_offs_up_to_four_tenths_of_the_rate(
    monkeypatch: pytest.MonkeyPatch, cutoff_hz: float, tried: list[float]
) -> None:
    found: list[float | None] = []

    def estimated(job: Job, moved: object) -> tuple[None, float]:
        found.append(job.signal.cutoff_hz)
        return None, 1.0

    monkeypatch.setattr(Job, "_estimated_delay", estimated)
    experiment = didim.packaged_experiment("tx40")
    recording = didim.Recording.from_arrays(np.zeros((9, 6)), rate_hz=1000.0)
    job = replace(
        didim.IDIMLS().job(replace(experiment, recordings=(recording,))),
        signal=SignalProcessing(cutoff_hz=cutoff_hz),
    )
    job.estimate_delay()
    assert found == tried
