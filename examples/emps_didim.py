"""Draw what IDIM-LS and DIDIM make of the EMPS: the second picture of docs/published.md.

    python examples/emps_didim.py --data FOLDER_OF_THE_MAT_FILE [-o docs/img/emps_didim.png]

needs matplotlib (``pip install didim[plot]``), and the recording, which does not come with didim.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt

import didim
from didim.experiment.loop import closed_loop
from didim.signal.filters import differentiate

EXAMPLE = Path(__file__).parent / "emps.toml"
# What is enlarged: a stop and the way back, where friction turns.
PART_S = (2.3, 3.9)
MEASURED, PREDICTED, SIMULATED = "#8a8f98", "#2b8a3e", "#0b6bcb"


def draw(data: Path, output: Path) -> None:
    """Identify by both methods and write the picture."""
    experiment = didim.load_experiment(EXAMPLE, data=data)
    (recording,) = experiment.recordings
    if recording.tau is None:
        raise SystemExit("the recording has no forces")
    direct = didim.identify(experiment, didim.IDIMLS())
    closed = didim.identify(experiment, didim.DIDIM())
    motion = differentiate(recording.q, recording.rate_hz, experiment.signal)
    predicted = didim.inverse_dynamics(experiment.robot, *motion, direct.parameters)[:, 0]
    loop = closed_loop(experiment, recording)
    arrays, _ = loop.run(closed.parameters[None])
    simulated, t = arrays[3][0][:, 0], loop.t
    measured = recording.tau[:, 0]
    part = (t >= PART_S[0]) & (t <= PART_S[1])
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, (force, error) = plt.subplots(
        2, 1, figsize=(9.0, 5.0), height_ratios=(1.6, 1.0), sharex=True, layout="constrained"
    )
    force.plot(t[part], measured[part], color=MEASURED, linewidth=3.0, label="measured")
    series = (
        (f"IDIM-LS, predicted: {100.0 * direct.overall_relative_error:.2f} %", predicted, PREDICTED),
        (f"DIDIM, simulated: {100.0 * closed.overall_relative_error:.2f} %", simulated, SIMULATED),
    )
    for label, values, color in series:
        force.plot(t[part], values[part], color=color, linewidth=0.9, label=label)
        error.plot(t[part], (measured - values)[part], color=color, linewidth=0.9)
    force.set(ylabel="force (N)", title="relative errors: of the whole run, filtered and decimated as fitted")
    force.title.set_size(9)
    force.legend(frameon=False, fontsize=8, loc="best")
    error.axhline(0.0, color=MEASURED, linewidth=0.6)
    error.set(ylabel="measured less model (N)", xlabel="time (s)", xlim=PART_S)
    figure.savefig(output, dpi=100, pil_kwargs={"optimize": True})
    plt.close(figure)


def main() -> int:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description="Draw IDIM-LS and DIDIM over the recording of the EMPS.")
    parser.add_argument("--data", type=Path, required=True, help="folder of DATA_EMPS.mat")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/img/emps_didim.png"))
    arguments = parser.parse_args()
    try:
        draw(arguments.data, arguments.output)
    except didim.DidimError as error:
        print(f"emps_didim: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
