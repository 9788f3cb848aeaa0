"""Draw the EMPS simulated in closed loop over its recording: the picture of docs/published.md.

    python examples/emps_simulation.py --data FOLDER_OF_THE_MAT_FILE [-o docs/img/emps_simulation.png]

needs matplotlib (``pip install didim[plot]``), and the recording, which does not come with didim.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import didim
from didim.signal.filters import differentiate
from didim.studies.run import simulate_experiment

Array = NDArray[np.float64]

EXAMPLES = Path(__file__).parent
# What is enlarged: the carriage brakes to a stop and goes on, the hardest moment of the loop.
PART_S = (2.48, 2.78)
MEASURED, SIMULATED, DELAYED = "#8a8f98", "#0b6bcb", "#d9480f"


def draw(data: Path, output: Path) -> None:
    """Simulate both experiments and write the picture."""
    experiment = didim.load_experiment(EXAMPLES / "emps.toml", data=data)
    late = didim.load_experiment(EXAMPLES / "emps_delay.toml", data=data)
    (recording,) = experiment.recordings
    if recording.tau is None:
        raise SystemExit("the recording has no forces")
    _, velocity, _ = differentiate(recording.q, recording.rate_hz, experiment.signal)
    runs = [simulate_experiment(one, "published") for one in (experiment, late)]
    t = runs[0].loop.t
    rows = (
        ("force (N)", recording.tau[:, 0], [run.arrays[3][:, 0] for run in runs], "torque"),
        ("velocity (m/s)", velocity[:, 0], [run.arrays[1][:, 0] for run in runs], "velocity"),
    )
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(2, 2, figsize=(9.0, 5.0), width_ratios=(1.0, 1.25), layout="constrained")
    part = (t >= PART_S[0]) & (t <= PART_S[1])
    for (label, measured, simulated, key), (whole, zoom) in zip(rows, axes, strict=True):
        errors = [f"{100.0 * run.errors[key][0]:.3g} %" for run in runs]
        whole.plot(t, measured, color=MEASURED, linewidth=1.6)
        whole.plot(t, simulated[0], color=SIMULATED, linewidth=0.6)
        whole.axvspan(*PART_S, color="#e9c46a", zorder=0)
        whole.set(ylabel=label, xlim=(0.0, t[-1]))
        zoom.plot(t[part], measured[part], color=MEASURED, linewidth=3.0, label="measured")
        zoom.plot(
            t[part],
            simulated[1][part],
            color=DELAYED,
            linewidth=0.9,
            label=f"simulated, one sample of delay: {errors[1]}",
        )
        zoom.plot(
            t[part],
            simulated[0][part],
            color=SIMULATED,
            linewidth=0.9,
            label=f"simulated, no delay: {errors[0]}",
        )
        zoom.set(xlim=PART_S)
        zoom.legend(frameon=False, fontsize=8, loc="best")
    for axis in axes[1]:
        axis.set_xlabel("time (s)")
    axes[0][0].set_title("the whole run", fontsize=9)
    axes[0][1].set_title("the marked part", fontsize=9)
    figure.savefig(output, dpi=100, pil_kwargs={"optimize": True})
    plt.close(figure)


def main() -> int:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description="Draw the EMPS simulated over its recording.")
    parser.add_argument("--data", type=Path, required=True, help="folder of DATA_EMPS.mat")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/img/emps_simulation.png"))
    arguments = parser.parse_args()
    try:
        draw(arguments.data, arguments.output)
    except didim.DidimError as error:
        print(f"emps_simulation: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
