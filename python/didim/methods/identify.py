"""`identify`: run a method on an experiment."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

from .._tools.progress import ProgressLine
from .._tools.words import did_you_mean
from ..errors import FitError
from ..evidence.judge import judged
from ..experiment.experiment import Experiment
from ..regression.settings import UncertaintyKind
from ..result.identification import Identification
from ..result.iteration import Iteration
from .friction import with_known_friction
from .idim_ls import IDIMLS
from .measured import measured_along
from .method import FitSettings, Method, MethodSettings

METHODS: dict[str, str | Callable[..., Method]] = {
    "idim-ls": "didim.methods.idim_ls:IDIMLS",
    "idim-iv": "didim.methods.idim_iv:IDIMIV",
    "didim": "didim.methods.didim.didim:DIDIM",
    "ekf": "didim.methods.ekf:EKF",
    "ml": "didim.methods.maximum_likelihood:MaximumLikelihood",
    "cloe": "didim.methods.cloe.cloe:CLOE",
}
"""Settings class of each method by name, or where it is, as "module:class": loaded when the method is asked for."""


def method_class(name: str) -> Callable[..., Method]:
    """Return the settings class of a method.

    Raises
    ------
    FitError
        For an unknown name; the sentence lists those that are known (``test_cli.py``).
    """
    if name not in METHODS:
        raise FitError(
            f"there is no method '{name}'{did_you_mean(name, METHODS)} (there are: {', '.join(METHODS)})"
        )
    place = METHODS[name]
    if not isinstance(place, str):
        return place
    module, _, class_name = place.partition(":")
    found: Callable[..., Method] = getattr(import_module(module), class_name)
    return found


def identify(
    experiment: Experiment,
    method: Method | None = None,
    *,
    uncertainty: UncertaintyKind | None = None,
    callback: Callable[[Iteration], bool | None] | None = None,
    verbose: bool | None = None,
) -> Identification:
    """Identify the dynamic parameters of an experiment's robot.

    Parameters
    ----------
    experiment : Experiment
        From `didim.load_experiment`.
    method : method, optional
        Settings such as ``didim.IDIMLS()``, which is also the default.
    uncertainty : {"jackknife", "decimated", "white"}, optional
        Where standard deviations come from, in place of the method's setting (`LeastSquaresSettings`).
    callback : callable, optional
        Called with every `Iteration`; when it returns True the method stops there.
    verbose : bool, optional
        True prints every iteration on stderr, False nothing. By default a terminal or a notebook shows one line with the
        iteration and the time that is left at most, and removes it at the end.

    Returns
    -------
    Identification
        Parameters, their uncertainty, and how well they explain the log.

    Raises
    ------
    DidimError
        One of its kinds, for a log or settings that allow no estimate.

    Notes
    -----
    ``test_identify.py`` recovers the parameters of simulated logs.
    """
    if method is None:
        method = IDIMLS()
    if uncertainty is not None:
        if not isinstance(method, MethodSettings):
            raise FitError(f"method '{method.name}' has no setting for uncertainty")
        method = replace(method, uncertainty=uncertainty)

    method = method.for_logs(experiment) if isinstance(method, FitSettings) else method

    start = time.perf_counter()
    line = ProgressLine() if verbose is None else None

    def say(text: str) -> None:
        if verbose:
            print(f"{method.name}: {text}", file=sys.stderr, flush=True)
        elif line is not None:
            line.show(f"{method.name}: {text}")

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
        return _identified(experiment, method, progress, say, start)
    finally:
        if line is not None:
            line.close()


def _identified(
    experiment: Experiment,
    method: Method,
    progress: Callable[[Iteration], bool],
    say: Callable[[str], None],
    start: float,
) -> Identification:
    """Choose the friction that is open, run the method, and judge the result."""
    experiment, friction = with_known_friction(method, experiment, say)
    fit = method.run(experiment, progress, say)
    if friction is not None:
        fit = replace(
            fit,
            settings={**fit.settings, "friction": friction.record()},
            remarks=(*fit.remarks, *friction.remarks()),
        )
    measured = measured_along(fit, experiment, method)
    fit = judged(
        fit,
        experiment,
        measured,
        system_tested=isinstance(method, FitSettings),
        uses_torques=getattr(method, "output", None) != "position",
        say=say,
    )
    fit = replace(fit, elapsed=time.perf_counter() - start)
    say(f"{fit.elapsed:.3f} s; {fit.conclusion}")
    return fit
