"""A study whose tasks take milliseconds: the planar arm, one second long, with coarse steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PLACE = EXAMPLES / "study"
"""Path that a study has in messages, beside the experiments of the examples."""


def small_study(seeds: int = 3, **changes: Any) -> dict[str, Any]:
    """Content of a study of two scenarios and two methods."""
    content: dict[str, Any] = {
        "schema": 1,
        "name": "planar",
        "experiment": str(EXAMPLES / "planar2_simulation.toml"),
        "parameters": "reference",
        "refinement": 1,
        "method": ["idim-ls", {"name": "idim-ls", "label": "filtered", "signal.cutoff_hz": 20}],
        "grid": {
            "measurement.torque_noise_n_m": [[0.1, 0.05], [0.5, 0.2]],
            "simulation.duration_s": [2.0],
            "simulation.rate_hz": [200],
            "simulation.step_s": [0.002],
            "simulation.fine_step_s": [0.002],
        },
        "repeat": {"seeds": seeds, "root": 7},
    }
    return {**content, **changes}
