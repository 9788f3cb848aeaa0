"""One arm of ``benches/real_arms.py``: light wrist, friction beyond the model, an inconsistent IDIM-LS estimate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvalsh

import didim
from conditions import conditions_of, violations
from didim._tools.arrays import Array
from didim.experiment.specs import SimulationSettings
from didim.loop.outcome import Outcome
from didim.methods.didim.consistent import ConsistentProblem
from didim.methods.didim.problem import Simulated
from didim.model.consistency import pseudo_inertias
from scripts import script


def recorded_iterates(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Array, Array, SimulationSettings]]:
    """Standard parameters, damping and steps of every simulation of consistent DIDIM from now on."""
    found = []
    simulate = ConsistentProblem.simulate

    def recorded(
        run: ConsistentProblem, x: Array, scale: Array | None = None, checked: bool = False
    ) -> Simulated | Outcome:
        found.append((x.copy(), run.damping, run.experiment_at(x).simulation))
        return simulate(run, x, scale)

    monkeypatch.setattr(ConsistentProblem, "simulate", recorded)
    return found


@pytest.mark.slow
def test_consistent_didim_converges_where_least_squares_gives_no_robot(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    iterates = recorded_iterates(monkeypatch)
    bench = script(project / "benches" / "real_arms.py")
    arm = bench.random_arm(16)
    direct = didim.identify(arm.log, didim.IDIMLS())
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, arm.robot.n_dof))
    assert np.linalg.eigvalsh(didim.inertia_matrix(arm.robot, q, direct.parameters)).min() < -0.1
    fit = didim.identify(arm.log, didim.DIDIM())
    assert fit.converged
    assert fit.n_iterations <= 6
    assert violations(conditions_of(arm.robot), fit.parameters) == []
    # Every iterate is a robot, and its fastest rate is one that the steps of its simulation can follow; the fixed point to which
    # a slack loop goes on was looked at above.
    assert len(iterates) >= 3
    fc, fv, joints = (
        [arm.robot.parameter_names.index(f"{key}{j}") for j in range(1, 8)] for key in ("Fc", "Fv", "Ia")
    )
    for x, damping, settings in iterates:
        assert min(np.linalg.eigvalsh(body)[0] for body in pseudo_inertias(arm.robot, x)) > 0.0
        assert violations(conditions_of(arm.robot), x) == []
        friction = np.diag(x[fv] + damping + x[fc] / np.array(arm.robot.friction.smoothing))
        rate = max(eigvalsh(friction, mass)[-1] for mass in didim.inertia_matrix(arm.robot, q, x))
        assert rate <= np.max((x[fv] + damping + x[fc] / 0.02) / x[joints]) * (1.0 + 1e-9)
        assert rate * np.min(np.asarray(settings.fine_step_s, dtype=float)) <= 1.5 * 1.05
    other = replace(arm.other(), controller=None)
    errors = [didim.validate(one, other).recordings[0].direct_overall for one in (direct, fit)]
    assert errors[1] <= 1.05 * errors[0]
    # Alike on every machine: the table's count leaves out what has a positive definite estimate.
    rows = [
        {**bench.row_of(one, other), "seconds": 1.0}
        if kind != "didim"
        else {"status": "no start", "seconds": 0.1}
        for kind, one in (("idim-ls", direct), ("didim", direct), ("consistent", fit))
    ]
    row = {"arm": 16, "axes": 7, "digital": False, "smallest": -2.0, "idim-ls": rows[0]}
    row |= {"didim": rows[1], "didim-consistent": rows[2]}
    text = bench.table([row])
    assert "converges on 1 of 1 arms" in text
    assert "| no start | converged, " in text
    assert f"| didim | 1 | {fit.n_iterations} / {fit.n_iterations} | 1 |" in bench.summary([row], ["didim"])
