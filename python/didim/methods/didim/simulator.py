"""The closed loops of a log: simulations with candidate parameters, their time steps and controller gains.

Tested in ``tests/test_didim.py`` and ``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array, quotient
from ..._tools.threads import core_threads
from ...errors import DidimError
from ...evidence.naming import torque_findings
from ...experiment.experiment import Experiment
from ...experiment.loop import recordings_of, windows
from ...loop.outcome import Outcome
from ...loop.tuning import mean_diagonal
from ...model.safe_step import thinned
from ...result.finding import Finding
from ...result.identification import Identification
from ...result.iteration import Reporter
from ...signal.window import Window
from ..idim_ls import direct_estimate
from ..job import Job
from .settings import DIDIMSettings
from .simulability import chosen_steps, largest_rates
from .windows import Motion, Simulated, beside, of_motions

ABREAST = 8
"""Number of candidates that are simulated at once: a few lanes of the core per thread, in bounded memory."""
CHECKED_POSITIONS = 500
"""Number of positions along a simulated motion at which M(q) must stay positive definite."""
CAREFUL = 2
"""Divisor of the smallest step when a simulation fails; the run is repeated with that uniform step."""
SAME = 1e-9
"""Largest logarithm of a gain's factor that counts as a factor of 1."""


class LogSimulator:
    """The closed loop of every window, with the steps of the experiment or smaller ones.

    It also provides the IDIM-LS estimate for starts and gains.

    Attributes
    ----------
    delay : Delay
        Delay of the torque.
    experiment : Experiment
        Robot, log and closed loop.
    windows : list of Window
        Windows with the current time steps.
    n_simulations : int
        Simulations so far.
    remarks : list of str
        Sentences on the steps.
    """

    steps_follow_rates = False
    """Whether the steps follow from the parameters, and need no check."""

    windows: list[Window]

    def __init__(self, method: DIDIMSettings, job: Job, reporter: Reporter) -> None:
        self.method, self.job, self.reporter = method, job, reporter
        self.delay, self.experiment = job.delay(), job.experiment
        self.windows = [] if self.steps_follow_rates else self.windows_of(self.experiment)
        self.n_simulations = 0
        self.remarks: list[str] = []
        self._usual: list[Window] | None = None
        self._refined = False
        self._direct: Identification | None = None

    def windows_of(self, experiment: Experiment) -> list[Window]:
        """Return the windows of the fitted recordings in the closed loop of an experiment, with their torque delay compensated.

        Torques along measured motion also compensate the hold of a digital controller, as in IDIM-LS.

        Raises
        ------
        FitError
            Without a recording to fit, without torques, or when trimming leaves nothing of a window.
        """
        held = self.delay.hold_s if self.method.motion == "measured" else 0.0
        return windows(experiment, self.job.signal, along="simulated", delay=self.delay.samples, hold_s=held)

    def run(self, window: Window, x: Array, scale: Array | None) -> tuple[Motion, Outcome]:
        """Simulate a window with standard parameters, (n_parameters,), and scaled gains, (n_dof,)."""
        own, gains = self.job.model.standard(x, window.recording), None if scale is None else scale[None]
        arrays, (outcome,) = window.loop.run(own[None], gain_scale=gains)
        return beside(window, arrays, 0), outcome

    def simulate(self, x: Array, scale: Array | None = None, checked: bool = False) -> Simulated | Outcome:
        """Simulate every window with parameters `x`, (n_parameters,), and scaled gains, (n_dof,).

        `checked` also simulates the first window with half the steps, on another core.
        """
        if checked:
            from concurrent.futures import ThreadPoolExecutor

            if core_threads() == 1:
                run, fine = self.simulate(x, scale), self._with_half_steps(x, scale)
            else:
                with ThreadPoolExecutor(1) as other:
                    finer = other.submit(self._with_half_steps, x, scale)
                    run = self.simulate(x, scale)
                    fine = finer.result()
            self.n_simulations += 1
            return run if isinstance(run, Outcome) else replace(run, finer=fine)
        motions = []
        for window in self.windows:
            motion, outcome = self.run(window, x, scale)
            self.n_simulations += 1
            if not outcome.completed:
                return outcome
            motions.append(motion)
        return of_motions(self.job.model, self.windows, x, motions, scale)

    def simulate_all(self, candidates: Sequence[Array]) -> list[Simulated | Outcome]:
        """Simulate every window with many candidates, (n_parameters,) each, in parallel."""
        results: list[Simulated | Outcome] = []
        standard = self.job.model.standard
        for first in range(0, len(candidates), ABREAST):
            some = candidates[first : first + ABREAST]
            runs = [
                (each, *each.loop.run(np.stack([standard(x, each.recording) for x in some])))
                for each in self.windows
            ]
            for k, x in enumerate(some):
                ended = [outcomes[k] for _, _, outcomes in runs if not outcomes[k].completed]
                motions = [beside(window, arrays, k) for window, arrays, _ in runs]
                results.append(
                    ended[0] if ended else of_motions(self.job.model, self.windows, x, motions, None)
                )
        self.n_simulations += len(candidates) * len(self.windows)
        return results

    def finer(self, x: Array, simulated: Simulated) -> Array:
        """Return the torques along the first window with half the steps, (n_kept, n_dof); NaN after an early end."""
        if simulated.finer is not None:
            return simulated.finer
        self.n_simulations += 1
        return self._with_half_steps(x, simulated.scale)

    def _with_half_steps(self, x: Array, scale: Array | None) -> Array:
        window = self.windows[0]
        motion, _ = self.run(replace(window, closed_loop=window.loop.divided(2)), x, scale)
        return motion[3]

    def take_small_steps(self) -> bool:
        """Switch to uniform small steps, at most once, unless the log looks wrong; return whether they changed.

        The experiment's steps suit the robot and motion of the log; a robot with less inertia is stiff elsewhere too.
        """
        if self._refined or self.suspicions():
            return False
        self._refined, self._usual = True, self.windows
        smallest = min(min(window.loop.steps[0], *window.loop.steps[1]) for window in self.windows) / CAREFUL
        self.windows = [replace(window, closed_loop=window.loop.even(smallest)) for window in self.windows]
        self.remarks.append(
            "from this start the simulation fails with the steps of the experiment: until the end is near they are "
            f"{1e3 * smallest:.3g} ms throughout"
        )
        self.reporter.say(self.remarks[-1])
        return True

    def take_usual_steps(self, x: Array) -> Simulated | None:
        """Return a simulation with the experiment's steps after small ones; None if unchanged or still too large."""
        if self._usual is None:
            return None
        small, self.windows, self._usual = self.windows, self._usual, None
        again = self.simulate(x)
        if isinstance(again, Simulated):
            return again
        self.windows = small
        return None

    def reference_positions(self) -> Array:
        """Return positions along the references at which M(q) is evaluated, (n, n_dof)."""
        positions = [window.loop.reference.at(window.loop.t)[0] for window in self.windows]
        return thinned(np.concatenate(positions), CHECKED_POSITIONS)

    def gain_scale(self, x: Array) -> Array | None:
        """Return the factor of each joint's gains: J(x) over the J of the real robot, (n_dof,); None for 1 or no scaling."""
        if self.method.gain_updating == "never":
            return None
        robot, q = self.job.robot, self.reference_positions()
        here, real = (
            mean_diagonal(robot, parameters[: len(robot.parameter_names)], q)
            for parameters in (x, self.real_parameters())
        )
        scale = np.where(here > 0.0, quotient(here, real, 1.0), 1.0)
        return None if np.abs(np.log(scale)).max() < SAME else scale

    def direct(self) -> Identification:
        """Return the IDIM-LS estimate with the settings of the method.

        Without measured positions the inertias along the reference replace it, which suffices for the gains.
        """
        if self._direct is None:
            experiment = with_positions(self.job.experiment)
            self._direct = direct_estimate(
                self.method, experiment, self.reporter, compensate_samples=self.delay
            )
        return self._direct

    def real_parameters(self) -> Array:
        """Return the standard parameters with the inertias for the controller, (p,): those of the IDIM-LS estimate."""
        return self.direct().parameters

    def suspicions(self) -> list[Finding]:
        """Return suspected faults along the measured motion, which is independent of parameters."""
        if self.job.model.n_gains:
            return []
        try:
            return torque_findings(self.job.system(self.job.parts("fit", self.delay)))
        except DidimError:  # such as a log without positions
            return []


class RateSimulator(LogSimulator):
    """Loops with time steps chosen by the rates of each candidate.

    Attributes
    ----------
    q : (n, n_dof) array
        Positions of the log at which rates and inertias are evaluated.
    damping : (n_dof,) array
        Damping gains of a continuous controller (`simulability.damping_of`).
    real : (p,) array
        Standard parameters with the inertias for the controller.
    """

    steps_follow_rates = True

    def prepare(self, experiment: Experiment, q: Array, damping: Array, real: Array) -> None:
        """Prepare the closed loop of an experiment, and the data for its steps."""
        self.experiment, self.q, self.damping, self.real = experiment, q, damping, real
        self._prepared: dict[tuple[object, object], list[Window]] = {}
        self.choose_steps(real)

    def experiment_at(self, x: Array) -> Experiment:
        """Return the experiment with time steps for the rates of an iterate."""
        settings = self.experiment.simulation
        fitted = recordings_of(self.experiment)
        robots = np.unique([self.job.model.standard(x, number) for number, _ in fitted], axis=0)
        coarse, fine = chosen_steps(*largest_rates(self.job.robot, robots, self.q, self.damping), settings)
        return replace(self.experiment, simulation=replace(settings, step_s=coarse, fine_step_s=fine))

    def choose_steps(self, x: Array) -> None:
        """Switch to the steps of an iterate."""
        experiment = self.experiment_at(x)
        steps = experiment.simulation.step_s, experiment.simulation.fine_step_s
        if steps not in self._prepared:
            self._prepared[steps] = self.windows_of(experiment)
        self.windows = self._prepared[steps]

    def simulate(self, x: Array, scale: Array | None = None, checked: bool = False) -> Simulated | Outcome:
        """Simulate every window with the steps of these parameters, without a check."""
        self.choose_steps(x)
        return super().simulate(x, scale)

    def take_small_steps(self) -> bool:
        """Return False, because the steps already follow from the rates."""
        return False

    def reference_positions(self) -> Array:
        """Return positions of the log."""
        return self.q

    def real_parameters(self) -> Array:
        """Return the standard parameters of the consistent solution."""
        return self.real


def with_positions(experiment: Experiment) -> Experiment:
    """Return an experiment in which the reference replaces positions that were not measured."""
    recordings = [
        recording
        if recording.has_positions
        else replace(recording, q=np.asarray(recording.q_ref), has_positions=True)
        for recording in experiment.recordings
    ]
    return replace(experiment, recordings=tuple(recordings))
