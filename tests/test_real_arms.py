"""One arm of ``benches/real_arms.py``: light wrist, friction that no model has, an IDIM-LS estimate that is no robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import didim
from didim.model.consistency import violations
from didim.regression.consistent.problem import conditions_of
from scripts import script


def test_consistent_didim_converges_where_least_squares_gives_no_robot(project: Path) -> None:
    bench = script(project / "benches" / "real_arms.py")
    arm = bench.random_arm(16)
    direct = didim.identify(arm.log, didim.IDIMLS())
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, arm.robot.n_dof))
    assert np.linalg.eigvalsh(didim.inertia_matrix(arm.robot, q, direct.parameters)).min() < -0.1
    fit = didim.identify(arm.log, didim.DIDIM())
    assert fit.converged
    assert fit.n_iterations <= 6
    assert violations(conditions_of(arm.robot), fit.parameters) == []
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
    text = bench.table(
        [
            {
                "arm": 16,
                "axes": 7,
                "digital": False,
                "smallest": -2.0,
                "idim-ls": rows[0],
                "didim": rows[1],
                "didim-consistent": rows[2],
            }
        ]
    )
    assert "converges on 1 of 1 arms" in text
    assert "| no start | converged, " in text
