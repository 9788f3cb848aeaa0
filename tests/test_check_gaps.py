"""``didim check`` of a log with jitter and gaps: the filters get the stretches that are long enough, as ``identify`` takes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import didim
from didim.errors import SignalError
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.signal.filters import decimation_stages, least_samples
from didim.signal.processing import SignalProcessing
from planted import Log


@pytest.mark.parametrize("factors", [(), (10,), (10, 8), (3, 3, 3)])
@pytest.mark.parametrize("convention", ["scipy", "matlab"])
def test_least_samples_is_the_bound_of_the_stages(factors: tuple[int, ...], convention: str) -> None:
    signal = SignalProcessing(cutoff_hz=40.0, decimation=factors, decimation_convention=convention)  # type: ignore[arg-type]
    least = least_samples(signal)
    rows = least
    for factor in factors:
        rows = -(-rows // factor)
    decimation_stages(least, signal)
    assert rows > (2 * signal.edge_rows if factors else 0)
    if factors:
        fewer = -(-(least - 1) // int(np.prod(factors)))
        if fewer > 2 * signal.edge_rows:
            with pytest.raises(SignalError, match="needs more than"):
                decimation_stages(least - 1, signal)


def test_gaps_leave_stretches_that_are_too_short_for_the_filters(tmp_path: Path) -> None:
    """1 kHz with 24 lost samples: 39, 260 and 2 098 samples lie between them, and the filters need 310."""
    rng = np.random.default_rng(2)
    sine, cosine = rng.uniform(-0.25, 0.25, (2, 4, 2))
    reference = Reference.fourier(sine, cosine, period_s=10.0, duration_s=20.0)
    robot = didim.load_robot("planar2").with_friction(coulomb="tanh", smoothing_rad_s=0.01)
    law = Controller.pd(kp=[900.0, 300.0], kv=[60.0, 20.0])
    run = didim.simulate(robot, robot.parameter_set("reference"), reference, law, rate_hz=1000.0)
    lost = np.unique([begin + 2400 * k for begin in (600, 640, 901) for k in range(8)])
    kept = np.setdiff1d(np.arange(len(run.t)), lost)
    tau = run.tau + 0.1 * rng.standard_normal(run.tau.shape)
    signal = "\n[signal]\ncutoff_hz = 40\ndecimation = [10, 8]\n"
    path = Log(run.t[kept], run.q[kept], tau[kept], robot="planar2", signal=signal).write(tmp_path)
    kinds = {finding.kind for finding in didim.check(path)}
    assert "gap" in kinds
    assert "signal" not in kinds  # that the log cannot be filtered
    path.write_text(path.read_text().replace('unit = "s"', 'unit = "s"\nresample = true'))
    assert not didim.check(path)
    assert didim.identify(didim.load_experiment(path), didim.IDIMLS()).overall_relative_error < 0.02
