"""The paper's experiment: a simulated log of a robot whose parameters are known, identified by every method.

Tested in ``tests/test_compare.py``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cloe import CLOE, Variant
from .closed_loop import closed_loop, measured_motion
from .didim_method import DIDIM
from .errors import ExperimentError
from .experiment import Experiment, load_experiment
from .files import write_atomically
from .identification import Identification, Iteration
from .identify import Method, identify
from .idim_ls import IDIMLS
from .recording import Recording

Array = NDArray[np.float64]

PACKAGED = Path(__file__).parent / "experiments"
"""Folder of the experiments that come with the package, by robot."""
SHORT_SIMPLEX = 60
"""Iterations of the simplex in a comparison that nobody waits hours for."""
SIMPLEX_STEPS = (1e-3, 2e-4)
"""Largest steps of its simulations (s)."""
MOST_PILOTS = 6
"""Runs of a log: its steps are fine where the velocities of the run before were near zero."""
LOG_REFINEMENT = 4
"""The log is simulated with steps so many times finer than those of the identification."""


def packaged_experiment(robot: str) -> Experiment:
    """Load the experiment of a robot that comes with the package.

    Raises
    ------
    ExperimentError
        When there is none.
    """
    known = {path.stem: path for path in sorted(PACKAGED.glob("*.toml"))}
    if robot not in known:
        raise ExperimentError(
            f"there is no packaged experiment for robot {robot!r} (there are: {', '.join(known)}); give an experiment file "
            "with a [reference], a [controller] and a [measurement]"
        )
    return load_experiment(known[robot])


def all_methods(
    experiment: Experiment,
    *,
    simplex_iterations: int | None = SHORT_SIMPLEX,
    variant: Variant = "adaptive",
) -> list[Method]:
    """Return the methods of a comparison.

    Parameters
    ----------
    experiment : Experiment
        CLOE starts from the set ``apriori`` of its robot, (21), or where there is none from unit rotors, (17).
    simplex_iterations : int, optional
        Of Nelder and Mead; None for as many as the paper's recipe allows, 0 to leave the simplex out.
    variant : str
        Of the simplex.
    """
    start = "apriori" if "apriori" in experiment.robot.sets else "unit"
    simplex = CLOE(
        optimizer="nelder-mead", variant=variant, max_iterations=simplex_iterations or None, start=start
    )
    least_squares = CLOE(optimizer="levenberg-marquardt", start=start)
    return [IDIMLS(), DIDIM(), *([] if simplex_iterations == 0 else [simplex]), least_squares]


def simulated_log(
    experiment: Experiment,
    x: Array,
    *,
    noise: bool = True,
    seed: int | None = None,
    refinement: int = LOG_REFINEMENT,
) -> Experiment:
    """Simulate the log of an experiment with known parameters.

    Parameters
    ----------
    experiment : Experiment
        With a reference of its own, a controller and, for noise, a measurement.
    x : (n_parameters,) array
        Standard parameters: the truth.
    noise : bool
        Add what the measurement adds.
    seed : int, optional
        Of the noise; that of the measurement by default.
    refinement : int
        Steps so many times finer than those of the experiment's simulation.

    Returns
    -------
    Experiment
        The same with one recording, joint side.

    Raises
    ------
    ExperimentError
        When the closed loop is not complete, or the run does not reach its end.
    """
    loop = closed_loop(experiment)
    recording: Recording | None = None
    for _ in range(MOST_PILOTS):
        arrays, outcomes = loop.run(x[None], divided=refinement)
        if not outcomes[0].completed:
            raise ExperimentError(f"{experiment.name}: the log cannot be simulated: the run {outcomes[0]}")
        before = recording
        recording = Recording.from_arrays(
            arrays[0][0], arrays[3][0], rate_hz=loop.rate_hz, name="simulated log"
        )
        # An identification has the steps that follow from this log: the log must have them too.
        if before is not None and np.array_equal(before.q, recording.q):
            break
        motion = measured_motion(recording, (0, len(recording.q)), experiment.signal, loop.model)
        if motion is None:
            break
        loop = loop.along(motion)
    assert recording is not None
    # The friction of the simulation is that of the log; the regressors of all methods are built with it.
    robot = experiment.simulation.robot(experiment.robot)
    log = replace(experiment, robot=robot, recordings=(recording,))
    return measured(log, seed) if noise else log


def measured(log: Experiment, seed: int | None = None) -> Experiment:
    """Add to a simulated log what its measurement adds.

    Parameters
    ----------
    log : Experiment
        From `simulated_log` without noise.
    seed : int, optional
        Of the noise; that of the measurement by default.

    Returns
    -------
    Experiment
        The same log where the experiment has no measurement.

    Raises
    ------
    ExperimentError
        For a negative seed.
    """
    if seed is not None and seed < 0:
        raise ExperimentError(f"the seed of the noise must not be negative, got {seed}")
    measurement = log.measurement
    (recording,) = log.recordings
    if measurement is None or recording.tau is None:
        return log
    q, tau = (measurement if seed is None else replace(measurement, seed=seed)).measure(
        recording.q, recording.tau
    )
    return replace(log, recordings=(replace(recording, q=q, tau=tau),))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results of several methods on one simulated log, beside the truth.

    Attributes
    ----------
    experiment : Experiment
        With the simulated log.
    truth : (b,) array
        Base parameters of the log.
    fits : dict of Identification
        By method.
    notes : tuple of str
        What was shortened.
    """

    experiment: Experiment
    truth: Array
    fits: dict[str, Identification]
    notes: tuple[str, ...] = ()

    def deviations(self, method: str) -> Array:
        """Estimate less truth in standard deviations, (b,)."""
        fit = self.fits[method]
        return np.asarray((fit.beta - self.truth) / np.where(fit.std > 0.0, fit.std, np.nan))

    def to_dict(self) -> dict[str, Any]:
        """As ``compare --json`` writes it."""
        names = self.experiment.robot.base_parameters.names
        return {
            "robot": self.experiment.robot.name,
            "truth": dict(zip(names, self.truth.tolist(), strict=True)),
            "methods": {method: fit.to_dict() for method, fit in self.fits.items()},
        }

    def save(self, path: Path) -> None:
        """Write as JSON."""
        write_atomically(path, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")

    def __str__(self) -> str:
        from .compare_table import render

        return render(self)


def compare(
    experiment: Experiment | str = "tx40",
    *,
    parameters: str = "didim",
    methods: Sequence[Method] | None = None,
    noise: bool = True,
    seed: int | None = None,
    callback: Callable[[str, Iteration], None] | None = None,
    verbose: bool = False,
) -> Comparison:
    """Simulate a log with known parameters and identify it back by several methods.

    Parameters
    ----------
    experiment : Experiment or str
        What is simulated, or the name of a robot whose experiment comes with the package.
    parameters : str
        Parameter set of the robot: the truth.
    methods : sequence of methods, optional
        All by default, with their default settings.
    noise : bool
        False for a log without noise; it is then simulated with the steps of the identification, so that the truth is met.
    seed : int, optional
        Of the noise.
    callback : callable, optional
        Told the method and every iteration.
    verbose : bool
        Tell on stderr what goes on.

    Returns
    -------
    Comparison

    Raises
    ------
    DidimError
        One of its kinds.
    """
    if isinstance(experiment, str):
        experiment = packaged_experiment(experiment)
    x = experiment.robot.parameter_set(parameters)
    log = simulated_log(experiment, x, noise=noise, seed=seed, refinement=LOG_REFINEMENT if noise else 1)
    fits: dict[str, Identification] = {}
    notes: list[str] = []
    if methods is None:
        methods = all_methods(experiment)
    for method in methods:

        def told(iteration: Iteration, name: str = method.name) -> None:
            if callback is not None:
                callback(name, iteration)

        # The simplex stays far above the noise: coarse steps are exact enough for it, and several times faster.
        simplex = isinstance(method, CLOE) and method.optimizer == "nelder-mead"
        seen = (
            replace(
                log, simulation=replace(log.simulation, step_s=SIMPLEX_STEPS[0], fine_step_s=SIMPLEX_STEPS[1])
            )
            if simplex
            else log
        )
        fit = fits[method.name] = identify(seen, method, callback=told, verbose=verbose)
        if simplex and fit.n_iterations == SHORT_SIMPLEX:
            notes.append(
                f"Shortened: Nelder-Mead ends after {SHORT_SIMPLEX} iterations, where fminsearch would go on to 200 per "
                "parameter; --nelder-mead full lets it."
            )
    return Comparison(log, log.robot.base_parameters.project(x), fits, tuple(notes))
