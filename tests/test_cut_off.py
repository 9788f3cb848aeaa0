"""What the cut-off of the positions does to IDIM-LS: rounded reversals spoil the friction columns (docs/idim_ls.md)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.experiment.experiment import Experiment
from didim.methods.identify import identify
from didim.regression.least_squares import solve
from didim.studies.simulated_log import measured
from didim.terms.model import Model
from didim.terms.rows import LinearSystem
from planted import tx40_exact

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def log() -> Experiment:
    """The packaged experiment without noise."""
    return tx40_exact()


@pytest.fixture(scope="module")
def sigma(log: Experiment) -> Array:
    """Standard deviations that the noise of the packaged experiment causes."""
    return identify(measured(log)).std


def filtered(log: Experiment, cutoff_hz: float) -> Experiment:
    return replace(log, signal=replace(log.signal, cutoff_hz=cutoff_hz))


def system(log: Experiment, cutoff_hz: float) -> LinearSystem:
    experiment = filtered(log, cutoff_hz)
    parts = didim.windows(experiment)
    return Model(experiment.robot).rows(parts, experiment.signal)


def bias(log: Experiment, beta: Array, sigma: Array) -> Array:
    truth = log.robot.base_parameters.project(log.robot.parameter_set("didim"))
    return np.asarray((beta - truth) / sigma)


def test_sixty_hertz_bias_light_inertias_without_any_noise(log: Experiment, sigma: Array) -> None:
    low = identify(filtered(log, 60.0))
    off = bias(log, low.beta, sigma)
    assert off[low.names.index("Ia6")] > 10.0
    assert np.sqrt(np.mean(off**2)) > 2.0
    assert log.signal.cutoff_hz == 200.0
    off = bias(log, identify(log).beta, sigma)
    assert np.max(np.abs(off)) < 1.0
    assert np.sqrt(np.mean(off**2)) < 0.2


def test_the_friction_columns_carry_the_bias(log: Experiment, sigma: Array) -> None:
    low, high = system(log, 60.0), system(log, 300.0)
    friction = np.array([name.startswith("F") for name in low.names])

    def rms(columns_of_friction: LinearSystem, others: LinearSystem) -> float:
        w = np.where(friction, columns_of_friction.w, others.w)
        fit = solve(replace(low, w=np.ascontiguousarray(w)), log.least_squares)
        return float(np.sqrt(np.mean(bias(log, fit.solution, sigma) ** 2)))

    both = rms(low, low)
    assert rms(high, low) < 0.1 * both
    assert rms(low, high) == pytest.approx(both, rel=0.05)
