"""The paper's experiment: a simulated log of a robot whose parameters are known, identified by every method.

Tested in ``tests/test_compare.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import ExperimentError, FitError
from .files import write_atomically
from .identify import Method, identify

# `import didim` loads this module, so that what only a comparison needs is loaded by it.
if TYPE_CHECKING:
    from .cloe import Variant
    from .experiment import Experiment
    from .identification import Identification, Iteration
    from .recording import Recording

Array = NDArray[np.float64]

PACKAGED = Path(__file__).parent / "experiments"
"""Folder of the experiments that come with the package, by robot."""
SHORT_SIMPLEX = 1000
"""Iterations of the simplex in a comparison that is to be over within minutes."""
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
    from .experiment import load_experiment

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
    variants: Sequence[Variant] = ("adaptive",),
) -> list[Method]:
    """Return the methods of a comparison.

    Parameters
    ----------
    experiment : Experiment
        CLOE starts from the set ``apriori`` of its robot, (21), or where there is none from unit rotors, (17).
    simplex_iterations : int, optional
        Of Nelder and Mead; None for as many as the paper's recipe allows, 0 to leave the simplex out.
    variants : sequence of str
        Of the simplex; one method each.
    """
    from .cloe import CLOE
    from .didim_method import DIDIM
    from .idim_ls import IDIMLS

    start = "apriori" if "apriori" in experiment.robot.sets else "unit"
    simplexes = [
        CLOE(optimizer="nelder-mead", variant=variant, max_iterations=simplex_iterations or None, start=start)
        for variant in ([] if simplex_iterations == 0 else variants)
    ]
    return [IDIMLS(), DIDIM(), *simplexes, CLOE(optimizer="levenberg-marquardt", start=start)]


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
    from .closed_loop import closed_loop, measured_motion
    from .recording import Recording

    loop = closed_loop(experiment)
    recording: Recording | None = None
    for _ in range(MOST_PILOTS):
        arrays, outcomes = loop.divided(refinement).run(x[None])
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
    norms : dict of float
        Norm (19) of the position errors (rad) of each method, at the "truth", and at the "start" of CLOE.
    """

    experiment: Experiment
    truth: Array
    fits: dict[str, Identification]
    notes: tuple[str, ...] = ()
    norms: Mapping[str, float] = field(default_factory=dict)

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
            "position_norms": {
                name: value if np.isfinite(value) else None for name, value in self.norms.items()
            },
            "methods": {method: fit.to_dict() for method, fit in self.fits.items()},
        }

    def save(self, path: Path) -> None:
        """Write as JSON."""
        import json

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
    from .cloe import CLOE
    from .starts import standard_start
    from .status import Status

    if isinstance(experiment, str):
        experiment = packaged_experiment(experiment)
    x = experiment.robot.parameter_set(parameters)
    log = simulated_log(experiment, x, noise=noise, seed=seed, refinement=LOG_REFINEMENT if noise else 1)
    fits: dict[str, Identification] = {}
    notes: list[str] = []
    if methods is None:
        methods = all_methods(experiment)
    for method in methods:
        # A second simplex is another variant of the first.
        key = method.name
        if key in fits and isinstance(method, CLOE):
            key = f"{method.name}-{method.variant}"

        def told(iteration: Iteration, name: str = key) -> None:
            if callback is not None:
                callback(name, iteration)

        try:
            fit = fits[key] = identify(log, method, callback=told, verbose=verbose)
        except FitError as reason:
            # What the methods before have found is worth more than a refusal.
            if not fits:
                raise
            notes.append(f"{key} gives no result: {reason}")
            continue
        if fit.status is Status.INTERRUPTED:
            notes.append(f"Interrupted during {key}; what would have come after it was not run.")
            break
        if (
            isinstance(method, CLOE)
            and method.max_iterations == fit.settings["cloe"].get("iterations") == SHORT_SIMPLEX
        ):
            notes.append(
                f"Shortened: Nelder-Mead ends after {SHORT_SIMPLEX} iterations, where fminsearch would go on to 200 per "
                "parameter; --nelder-mead full lets it."
            )
    sets = {"truth": x, **{name: fit.parameters for name, fit in fits.items()}}
    for method in methods:
        if isinstance(method, CLOE) and isinstance(method.start, str) and method.start != "idim-ls":
            sets["start"] = standard_start(log.robot, method.start)
    norms = position_norms(log, sets)
    return Comparison(log, log.robot.base_parameters.project(x), fits, tuple(notes), norms)


def position_norms(log: Experiment, parameters: Mapping[str, Array]) -> dict[str, float]:
    """Return the norm (19) of position errors, simulated less measured (rad or m), by name; infinite where no run completes."""
    from .closed_loop import closed_loop

    (recording,) = log.recordings
    loop = closed_loop(log, recording)
    ones = np.ones(log.robot.n_dof)
    tau = np.zeros_like(recording.q)
    costs, _ = loop.costs(
        np.stack(list(parameters.values())), recording.q, tau, weight_q=ones, weight_tau=0.0 * ones
    )
    return dict(zip(parameters, np.sqrt(costs).tolist(), strict=True))
