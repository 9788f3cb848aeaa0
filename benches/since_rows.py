"""Rows of `since_0_1_0.py`: what is measured, and what it must be; run as a program under each version."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from since_edges import (
    REFUSED,
    Value,
    best_iterate,
    eight_windows,
    errors_with_delay,
    given_state,
    hold,
    late_wrist,
    measured_start,
    no_delay,
    nothing_left,
    one_sample,
    packaged_filter,
    resting_joint,
    resting_joint_absolute,
    rows_of_cloe,
    sigmas_of_a_failure,
    slow_contraction,
    sticking_start,
)
from since_files import (
    another_robot,
    control_characters,
    copies,
    damaged_parameters,
    full_checkpoint,
    full_disk,
    impossible_variances,
    interrupted_import,
    kinds_of_errors,
    limit_of_threads,
    mode_of_a_result,
    names_of_the_tx40,
    numbers_of_threads,
    recipe,
    repeated_iterations,
    reweightings,
    right_angles,
    saves_of_threads,
    uncounted_simulations,
    work_before_refusal,
)

import didim


@dataclass(frozen=True)
class Row:
    """A row of the table: what is measured, and what it must be now."""

    row: str
    what: str
    measure: Callable[[Path], Value]
    limit: float | str
    """A number is the largest allowed; a text is what must be found."""
    unit: str = ""

    def holds(self, value: Value | None) -> bool:
        if isinstance(self.limit, str) or not isinstance(value, float):
            return value == self.limit
        return value <= self.limit


ROWS = (
    Row("1", "CLOE, joint 2 at rest on one count: worst parameter", resting_joint, 3.0, "sigma"),
    Row("1", "the same: largest error", resting_joint_absolute, 0.1, "SI"),
    Row("2", "PID log cut in full swing, true parameters: torque error", measured_start, 0.1, "%"),
    Row("2", "the same from the given state, relative", given_state, 1e-6),
    Row("3", "eight windows without trimming: worst parameter", eight_windows, 0.5, "%"),
    Row("4", "CLOE with trimming: `error_std` off", rows_of_cloe, 1e-6, "%"),
    Row("4", "CLOE, trimming that leaves nothing", nothing_left, REFUSED),
    Row("4", "CLOE with a delay: errors less those of `predict`", errors_with_delay, 1e-4, "%"),
    Row("9", "slack loop: distance to the fixed point beyond what is told", slow_contraction, 0.0, "sigma"),
    Row("10", "failed DIDIM: torque error over that of its best iterate", best_iterate, 1.0),
    Row("10", "failed DIDIM: parameters with a standard deviation", sigmas_of_a_failure, 0.0),
    Row("11", "start whose joint sticks: worst parameter", sticking_start, 4.0, "sigma"),
    Row("12", "delay of a sound log, filter of 60 Hz", no_delay, 0.05, "samples"),
    Row("12", "delay of one sample: error", one_sample, 0.05, "samples"),
    Row("12", "wrist two samples late: worst joint", late_wrist, 0.1, "samples"),
    Row("13", "hold of a digital controller: bias of `Fv1`", hold, 1.5, "sigma"),
    Row("14", "packaged TX40, IDIM-LS: errors, rms", packaged_filter, 1.15, "sigma"),
    Row("15", "base parameters added by `alpha_rad = 1.5708`", right_angles, 0.0),
    Row("16", "`validate` with the result of another robot", another_robot, REFUSED),
    Row("16", "accepted results with variances nan and -1", impossible_variances, 0.0),
    Row("17", "simulations that `n_simulations` leaves out", uncounted_simulations, 0.0),
    Row("17", "`reweightings = 3` that the IDIM-LS of DIDIM leaves out", reweightings, 0.0),
    Row("17", "iterations that a callback hears twice", repeated_iterations, 0.0),
    Row("17", "`compare`: torque errors of one kind", kinds_of_errors, "one kind"),
    Row(
        "outputs", "output to an absent folder: identifications before the refusal", work_before_refusal, 0.0
    ),
    Row("outputs", "result on a full disk", full_disk, "table printed"),
    Row("outputs", "checkpoint on a full disk", full_checkpoint, "best point printed"),
    Row("outputs", "damaged parameter files: tracebacks of 2", damaged_parameters, 0.0),
    Row("outputs", "8 threads save to one path: failures of 320", saves_of_threads, 0.0),
    Row("outputs", "`threads` = '2', 1.5, 2**70: not refused in a sentence", numbers_of_threads, 0.0),
    Row("outputs", "Ctrl-C during import: lines", interrupted_import, 1.0),
    Row("outputs", "control characters on the terminal", control_characters, 0.0),
    Row("outputs", "mode of a result that was 0600", mode_of_a_result, "0600"),
    Row("outputs", "`pickle`, `deepcopy` of 4 objects: failures of 8", copies, 0.0),
    Row("outputs", "limit of threads", limit_of_threads, "set_threads, DIDIM_THREADS"),
)


def measured(call: Callable[[], Value]) -> Value:
    """Return a measurement, or how it ended."""
    try:
        return call()
    except didim.DidimError as error:
        return f"{type(error).__name__}: {error}"
    except Exception as error:
        return f"traceback, {type(error).__name__}: {error}"


def main() -> None:
    folder, data, output = Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3])
    chosen = [int(text) for text in sys.argv[4:]] or range(len(ROWS))
    found: dict[str, Value] = {"version": didim.__version__, "package": str(Path(didim.__file__).parent)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for index in chosen:
            found[str(index)] = measured(partial(ROWS[index].measure, folder))
        found["names"] = measured(lambda: names_of_the_tx40(folder))
        if data.is_dir():
            found["emps"] = measured(lambda: recipe(folder, data, "emps", 4))
            found["tx40"] = measured(lambda: recipe(folder, data, "tx40_log_best", 4))
    output.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
