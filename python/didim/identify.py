"""`identify`: run a method on an experiment."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from .experiment import Experiment
    from .identification import Identification, Iteration


class Method(Protocol):
    """Settings of a method, and how it runs; a new one needs no more than this and a place in `methods.METHODS`."""

    @property
    def name(self) -> str:
        """Name on the command line and in results."""

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify, telling every iteration to ``progress`` (True stops) and what goes on to ``say``."""


def identify(
    experiment: Experiment,
    method: Method | None = None,
    *,
    callback: Callable[[Iteration], bool | None] | None = None,
    verbose: bool = False,
) -> Identification:
    """Identify the dynamic parameters of an experiment's robot.

    Parameters
    ----------
    experiment : Experiment
        From `didim.load_experiment`.
    method : method, optional
        Settings such as ``didim.IDIMLS()``, which is also the default.
    callback : callable, optional
        Called with every `Iteration`; when it returns True the method stops there.
    verbose : bool
        Tell on stderr what goes on.

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
        from .idim_ls import IDIMLS

        method = IDIMLS()

    def say(text: str) -> None:
        if verbose:
            print(f"{method.name}: {text}", file=sys.stderr, flush=True)

    def progress(iteration: Iteration) -> bool:
        say(
            f"iteration {iteration.iteration}: relative error {100.0 * iteration.relative_error:.4f} %, "
            f"step {100.0 * iteration.step:.3g} %"
        )
        return callback is not None and callback(iteration) is True

    start = time.perf_counter()
    fit = method.run(experiment, progress, say)
    fit = replace(fit, elapsed=time.perf_counter() - start)
    say(f"{fit.elapsed:.3f} s; {fit.status.value}")
    return fit
