"""The paper's experiment: a simulated log of a robot with known parameters, identified by every method.

`contrasts_of` contrasts IDIM-LS, IDIM-IV and DIDIM on one log: whether the filter is wrong, or the controller.
Tested in ``tests/test_compare.py`` and ``tests/test_contrast.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array, quotient
from .._tools.notebook import Printed
from .._tools.saved import save_json
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..methods.cloe.settings import Variant
from ..methods.didim.didim import DIDIM
from ..methods.identify import identify_as
from ..methods.idim_iv import IDIMIV
from ..methods.idim_ls import IDIMLS
from ..methods.method import Method
from ..methods.table import method_of, title_of
from ..regression.settings import UncertaintyKind
from ..regression.solver import SolverChoice
from ..result.contrast import Contrast, contrast, reading
from ..result.identification import Identification
from ..result.iteration import Iteration
from .comparison import Comparison, duration, ending
from .simulated_log import LOG_REFINEMENT, packaged_experiment, simulated_log

PHYSICAL = "didim_physical"
"""Parameter set nearest to the paper's among those of robots that can be built."""
SHORT_SIMPLEX = 1000
"""Upper bound of the simplex's iterations in a comparison, so that it takes minutes."""


def all_methods(
    experiment: Experiment,
    *,
    simplex_iterations: int | None = SHORT_SIMPLEX,
    variants: Sequence[Variant] = ("adaptive",),
    uncertainty: UncertaintyKind | None = None,
    solver: SolverChoice = "least-squares",
) -> list[Method]:
    """Return the methods of a comparison.

    Parameters
    ----------
    experiment : Experiment
        Experiment; CLOE starts from the set ``apriori`` of its robot, (21), or without one from unit rotors, (17).
    simplex_iterations : int, optional
        Upper bound of the iterations of Nelder and Mead; None for that of the paper's recipe, 0 to omit the simplex.
    variants : sequence of str
        Variants of the simplex, one method each.
    uncertainty : {"jackknife", "decimated", "white"}, optional
        Source of the standard deviations, as in `LeastSquaresSettings`; by default that of the experiment.
    solver : str or solver
        Solver of (7) in IDIM-LS and DIDIM; CLOE has no linear system.
    """
    from ..methods.cloe.cloe import CLOE
    from ..methods.didim.didim import DIDIM
    from ..methods.idim_ls import IDIMLS

    start = "apriori" if "apriori" in experiment.robot.sets else "unit"
    simplexes = [
        CLOE(
            optimizer="nelder-mead",
            variant=variant,
            max_iterations=simplex_iterations or None,
            start=start,
            uncertainty=uncertainty,
        )
        for variant in ([] if simplex_iterations == 0 else variants)
    ]
    return [
        IDIMLS(uncertainty=uncertainty, solver=solver),
        # The DIDIM of the paper first: its parameters are compared with Table II, which is not a robot.
        DIDIM(uncertainty=uncertainty, solver=solver),
        DIDIM(uncertainty=uncertainty),
        *simplexes,
        CLOE(optimizer="levenberg-marquardt", start=start, uncertainty=uncertainty),
    ]


def compare(
    experiment: Experiment | str = "tx40",
    *,
    parameters: str | None = None,
    methods: Sequence[Method | type[Method] | str] | None = None,
    noise: bool = True,
    seed: int | None = None,
    callback: Callable[[str, Iteration], None] | None = None,
    verbose: bool | None = None,
) -> Comparison:
    """Simulate a log with known parameters and identify it back by several methods.

    Tested in ``tests/test_compare.py``.

    Parameters
    ----------
    experiment : Experiment or str
        Experiment to be simulated, or the name of a robot with an included experiment.
    parameters : str, optional
        True parameter set. By default `PHYSICAL` if the robot has it, because a physically impossible truth is unfair to
        methods with physical constraints; otherwise "didim", the paper's.
    methods : sequence, optional
        Settings, classes or names of methods, as for `identify`; by default all of `all_methods`.
    noise : bool
        False for a log without noise, simulated with the steps of the identification so that the truth is recovered exactly.
    seed : int, optional
        Seed of the noise.
    callback : callable, optional
        Callback with the method and every iteration.
    verbose : bool, optional
        True prints a line on stderr when a method ends, False nothing. Unless False, a terminal or a notebook shows the progress of
        the current method.

    Returns
    -------
    Comparison

    Raises
    ------
    DidimError
        Any of its subclasses.
    """
    from ..methods.cloe.cloe import CLOE
    from ..methods.method import FitSettings
    from ..methods.start import FROM_LOG, standard_start
    from ..result.iteration import Status

    if isinstance(experiment, str):
        experiment = packaged_experiment(experiment)
    x = truth_of(experiment, parameters)
    log = simulated_log(experiment, x, noise=noise, seed=seed, refinement=LOG_REFINEMENT if noise else 1)
    fits: dict[str, Identification] = {}
    notes: list[str] = []
    chosen = all_methods(experiment) if methods is None else [method_of(method) for method in methods]
    chosen = [method.for_logs(log) if isinstance(method, FitSettings) else method for method in chosen]
    for method in chosen:
        key = _key(method, fits)

        def record(iteration: Iteration, name: str = key) -> None:
            if callback is not None:
                callback(name, iteration)

        try:
            fit = fits[key] = identified(key, log, method, record, verbose)
        except FitError as reason:
            # The results of the preceding methods are worth more than an error.
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
                f"Shortened: Nelder-Mead ends after {SHORT_SIMPLEX} iterations; --nelder-mead full allows 200 per parameter, "
                "as fminsearch does."
            )
    sets = {"truth": x, **{name: fit.parameters for name, fit in fits.items()}}
    for method in chosen:
        if isinstance(method, CLOE) and isinstance(method.chosen_start, str):
            start = method.chosen_start
            if start not in ("idim-ls", *FROM_LOG):
                sets["start"] = standard_start(log.robot, start)
    return Comparison(
        log,
        log.robot.base_parameters.project(x),
        fits,
        tuple(notes),
        position_norms(log, sets),
        torque_errors(log, sets),
    )


def identified(
    key: str,
    log: Experiment,
    method: Method,
    callback: Callable[[Iteration], None] | None = None,
    verbose: bool | None = None,
) -> Identification:
    """Run one of several methods; if verbose, print a line with its time and ending on stderr."""
    fit = identify_as(key, log, method, callback, None if verbose else verbose)
    if verbose:
        print(f"{title_of(key)}: {duration(fit.elapsed)}, {ending(fit).lower()}", file=sys.stderr, flush=True)
    return fit


def truth_of(experiment: Experiment, name: str | None = None) -> Array:
    """Return the true parameter set of a simulated log, (c,): the named one, else `PHYSICAL`, else "didim"."""
    robot = experiment.robot
    return robot.parameter_set(name or (PHYSICAL if PHYSICAL in robot.sets else "didim"))


def _key(method: Method, taken: Collection[str]) -> str:
    """Return the key of a method in a comparison: its name, with a suffix if an earlier method has the same name."""
    from ..methods.cloe.cloe import CLOE
    from ..methods.method import FitSettings

    if method.name not in taken:
        return method.name
    key = method.name
    if isinstance(method, CLOE):
        key += "-consistent" if method.physical else f"-{method.variant}" if "nelder" in key else ""
    elif isinstance(method, FitSettings):
        choice = method.chosen_solver()
        known = {"least-squares": "plain"}
        key += f"-{known.get(choice, choice) if isinstance(choice, str) else getattr(choice, 'name', 'own-solver')}"
    label, number = key, 2
    while label in taken:
        label, number = f"{key}-{number}", number + 1
    return label


def position_norms(log: Experiment, parameters: Mapping[str, Array]) -> dict[str, float]:
    """Return the norm (19) of position errors, simulated less measured (rad or m), by name; infinite if a run does not complete."""
    from ..experiment.loop import closed_loop

    (recording,) = log.recordings
    loop = closed_loop(log, recording)
    ones = np.ones(log.robot.n_dof)
    tau = np.zeros_like(recording.q)
    costs, _ = loop.costs(
        np.stack(list(parameters.values())), recording.q, tau, weight_q=ones, weight_tau=0.0 * ones
    )
    return dict(zip(parameters, np.sqrt(costs).tolist(), strict=True))


def torque_errors(log: Experiment, parameters: Mapping[str, Array]) -> dict[str, Array]:
    """Return the relative errors of simulated torques by name, (n_dof,) each, unfiltered; NaN if a run does not complete."""
    from ..experiment.loop import closed_loop

    (recording,) = log.recordings
    if recording.tau is None:
        return {}
    (tau,), _ = closed_loop(log, recording).run(np.stack(list(parameters.values())), signals=("tau",))
    sizes = np.linalg.norm(recording.tau, axis=0)
    errors = np.linalg.norm(tau - recording.tau, axis=1)
    shares = quotient(errors, sizes, np.nan)
    return dict(zip(parameters, shares, strict=True))


@dataclass(frozen=True, eq=False, repr=False)
class Contrasts(Printed):
    """Three estimates of one log, and their contrasts.

    Attributes
    ----------
    experiment : str
        Name of the experiment.
    fits : mapping of str to Identification
        Results by method.
    contrasts : tuple of Contrast
        IDIM-IV less IDIM-LS, and DIDIM less IDIM-IV.
    """

    experiment: str
    fits: Mapping[str, Identification]
    contrasts: tuple[Contrast, ...]

    @property
    def reading(self) -> str:
        """Return the joint conclusion of the contrasts."""
        return reading(self.contrasts)

    def __str__(self) -> str:
        lines = [f"{self.experiment}: contrasts of three estimates", ""]
        lines += [f"- {each}" for each in self.contrasts]
        failed = [f"{name}: {fit.status.value}" for name, fit in self.fits.items() if not fit.converged]
        return "\n".join([*lines, *failed, "", f"{self.reading[0].upper()}{self.reading[1:]}."])

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``didim compare --contrast --json``."""
        return {
            "schema": 1,
            "experiment": self.experiment,
            "reading": self.reading,
            "contrasts": [each.to_dict() for each in self.contrasts],
            "methods": {name: fit.to_dict() for name, fit in self.fits.items()},
        }

    def save(self, path: str | Path) -> None:
        """Write the JSON of `to_dict`, whole or not at all."""
        save_json(
            path, self.to_dict(), {digest for fit in self.fits.values() for digest in fit.digests.values()}
        )


def contrasts_of(log: Experiment, *, verbose: bool | None = None) -> Contrasts:
    """Identify a log by IDIM-LS, IDIM-IV and DIDIM, and contrast the estimates.

    Parameters
    ----------
    log : Experiment
        Experiment with recordings, a reference and a controller.
    verbose : bool, optional
        As for `compare`.

    Raises
    ------
    DidimError
        Any of its subclasses, as for the methods.
    """
    methods = (
        IDIMLS(uncertainty="jackknife"),
        IDIMIV(uncertainty="jackknife"),
        DIDIM(physical=False, uncertainty="jackknife"),
    )
    fits = {method.name: identified(method.name, log, method, verbose=verbose) for method in methods}
    pairs = [("idim-ls", "idim-iv"), ("idim-iv", "didim")]
    known = [pair for pair in pairs if all(fits[name].uncertainty is not None for name in pair)]
    return Contrasts(log.name, fits, tuple(contrast(fits[first], fits[second]) for first, second in known))
