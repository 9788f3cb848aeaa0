"""`identify`: run a method on an experiment."""

from __future__ import annotations

import importlib
import sys
import textwrap
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from .._tools.progress import ProgressLine
from ..errors import FitError
from ..evidence.judge import judged
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import experiment_of
from ..log.recording import Recording
from ..regression.settings import UncertaintyKind
from ..result.identification import Identification
from ..result.iteration import Iteration, Reporter
from ..result.positions.record import PositionRecord
from ..robot.robot import Robot
from ..robot.robot_file import check_closed
from ..terms.rows import LinearSystem
from .friction import with_known_friction
from .job import MeasuredRows
from .measured import law_along, measured_along
from .method import FitSettings, Method, MethodSettings
from .table import method_of

COLUMNS = 100
"""Width of the lines that `identify` prints when verbose; longer ones wrap between words."""


def identify(
    experiment: Experiment | str | Path | Recording | Sequence[Recording],
    method: Method | type[Method] | str | None = None,
    *,
    robot: Robot | str | Path | None = None,
    uncertainty: UncertaintyKind | None = None,
    callback: Callable[[Iteration], bool | None] | None = None,
    verbose: bool | None = None,
) -> Identification:
    """Identify the dynamic parameters of an experiment's robot.

    Parameters
    ----------
    experiment : Experiment, path, Recording or sequence of Recording
        Log with its robot and settings, the path of its file, or recordings of `robot`, with filters chosen as by ``didim
        init`` and reported in a note of the result.
    method : method, class or str, optional
        IDIM-LS by default: settings such as ``didim.DIDIM(start="unit")``, their class, or a name of `didim methods`;
        "module:Class" for a user-defined method.
    robot : Robot, str or Path, optional
        Robot of recordings, its file, or the name of an included one.
    uncertainty : {"jackknife", "decimated", "white"}, optional
        Source of the standard deviations, which overrides the method's setting (`LeastSquaresSettings`).
    callback : callable, optional
        Callback with every `Iteration`; the method stops if it returns True.
    verbose : bool, optional
        True prints every iteration on stderr, False nothing. By default a terminal or a notebook shows one line with the
        iteration and an upper bound of the remaining time, and removes it at the end.

    Returns
    -------
    Identification
        Parameters, their uncertainty, and the torque errors.

    Raises
    ------
    DidimError
        Any of its subclasses, for a log or settings without an estimate.

    Notes
    -----
    ``test_identify.py`` recovers the parameters of simulated logs.
    """
    experiment = experiment_of(experiment, robot)
    method = method_of(default_method(experiment) if method is None else method)
    if uncertainty is not None:
        if not isinstance(method, MethodSettings):
            raise FitError(f"method '{method.name}' has no setting for uncertainty")
        method = replace(method, uncertainty=uncertainty)

    method = method.for_logs(experiment) if isinstance(method, FitSettings) else method
    return identify_as(method.name, experiment, method, callback, verbose)


def rows(
    experiment: Experiment | str | Path, method: Method | type[Method] | str | None = None
) -> LinearSystem:
    """Return the rows of (7) of an experiment, along its measured motion.

    They are those of a method's settings: the first that DIDIM's start and IDIM-LS solve.

    Parameters
    ----------
    experiment : Experiment or path
        Log with its robot.
    method : method, class or str, optional
        Its filters, delay, friction, fixed and dropped parameters; IDIM-LS by default.

    Returns
    -------
    LinearSystem
        ``w`` (r, n), ``y`` (r,) in N.m or N, joint side (A, motor side, where drive gains are unknown), ``names`` of the columns,
        and ``blocks``: the rows of each joint in each window.

    Raises
    ------
    DidimError
        As for `identify`.

    Notes
    -----
    ``test_windows.py`` solves them.
    """
    method = method_of("idim-ls" if method is None else method)
    experiment, _ = with_known_friction(method, experiment_of(experiment, None), lambda text: None)
    job = (method if isinstance(method, MethodSettings) else MethodSettings()).job(experiment)
    return job.system(job.parts("fit", job.delay()))


def identify_as(
    label: str,
    experiment: Experiment,
    method: Method,
    callback: Callable[[Iteration], bool | None] | None = None,
    verbose: bool | None = None,
) -> Identification:
    """Run a method as `identify` does, with its progress under a label."""
    # Imports that take a fifth of a second, which the first of several methods would pay for all, are no part of `elapsed`.
    for name in ("scipy.special", "scipy.linalg.lapack"):
        importlib.import_module(name)
    start = time.perf_counter()
    line = ProgressLine() if verbose is None else None

    def say(text: str) -> None:
        if verbose:
            lines = textwrap.fill(f"{label}: {text}", COLUMNS, subsequent_indent="  ")
            print(lines, file=sys.stderr, flush=True)
        elif line is not None:
            line.show(f"{label}: {text}")

    def progress(iteration: Iteration) -> bool:
        error, step = 100.0 * iteration.relative_error, 100.0 * iteration.step
        text = f"iteration {iteration.iteration}: relative error {error:.4f} %, step {step:.3g} %"
        most = getattr(method, "max_iterations", None)
        if line is not None and isinstance(most, int):
            each = (time.perf_counter() - start) / iteration.iteration
            text += f", at most {each * max(0, most - iteration.iteration):.0f} s left"
        say(text)
        return callback is not None and callback(iteration) is True

    try:
        return _identified(experiment, method, Reporter(progress=progress, say=say), start)
    finally:
        if line is not None:
            line.close()


def default_method(experiment: Experiment) -> str:
    """Return the name of an experiment's default method: CLOE if its links are known, otherwise IDIM-LS."""
    return "cloe" if experiment.links == "fixed" else "idim-ls"


def _identified(experiment: Experiment, method: Method, reporter: Reporter, start: float) -> Identification:
    """Choose open friction terms, run the method, and judge the result."""
    check_closed(experiment.robot)
    experiment, friction = with_known_friction(method, experiment, reporter.say)
    along: list[MeasuredRows] = []
    fit = method.run(experiment, replace(reporter, measured=along.append))
    fit = replace(fit, remarks=(*fit.remarks, *experiment.remarks))
    if friction is not None:
        fit = replace(
            fit,
            settings={**fit.settings, "friction": friction.record()},
            remarks=(*fit.remarks, *friction.remarks()),
        )
    if fit.further is not None and fit.further.gains is not None:
        experiment = experiment.with_gains(fit.further.gains)
    if PositionRecord.of(fit.settings) is None:
        of_positions = getattr(method, "output", None) == "position"
        fit = judged(
            fit,
            experiment,
            measured_along(fit, experiment, method, along),
            law_along(fit, experiment, method) if of_positions else None,
            system_tested=isinstance(method, FitSettings),
            uses_torques=not of_positions,
            say=reporter.say,
        )
    fit = replace(fit, elapsed=time.perf_counter() - start)
    reporter.say(f"{fit.elapsed:.3f} s; {fit.conclusion}")
    return fit
