"""The closed loops of a log for DIDIM: simulations with candidate parameters, with the steps of the experiment or smaller ones.

Tested in ``tests/test_didim.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ..._tools.threads import core_threads
from ...errors import DidimError
from ...experiment.experiment import Experiment
from ...loop.outcome import Outcome
from ...model.dynamics import inertia_matrix
from ...result.identification import Identification
from ..idim_ls import IDIMLS
from ..job import Delay, Job
from ..verdict.torques import TORQUE_CODES
from .settings import DIDIMSettings
from .windows import Simulated, Window, checked_positions, simulated, windows_of

CAREFUL = 2
"""Where a robot cannot be simulated, all is tried again with equal steps, so many times smaller than the smallest one before."""


class Loops:
    """The closed loop of every window, and the IDIM-LS estimate that starts and gains may need.

    Attributes
    ----------
    windows : list of Window
        Windows with the steps that are taken now.
    n_simulations : int
        Simulations so far.
    remarks : list of str
        Sentences on the steps.
    """

    def __init__(self, method: DIDIMSettings, job: Job, delay: Delay, say: Callable[[str], None]) -> None:
        self.method, self.job, self.delay, self.say = method, job, delay, say
        self.windows = windows_of(job, delay, held=method.motion == "measured")
        self.n_simulations = 0
        self.remarks: list[str] = []
        self._usual: list[Window] | None = None
        self._refined = False
        self._direct: Identification | None = None

    @property
    def measured(self) -> bool:
        """Whether every recording that is fitted has measured positions."""
        recordings = self.job.experiment.recordings
        return all(recording.has_positions for recording in recordings if recording.role == "fit")

    def simulate(self, x: Array, scale: Array | None = None, checked: bool = False) -> Simulated | Outcome:
        """Simulate every window with parameters `x`, (n_parameters,), and scaled gains, (n_dof,).

        `checked` simulates the first window with half the steps beside it, on another core.
        """
        if checked:
            from concurrent.futures import ThreadPoolExecutor

            if core_threads() == 1:
                found, fine = self.simulate(x, scale), self._with_half_steps(x, scale)
            else:
                with ThreadPoolExecutor(1) as other:
                    finer = other.submit(self._with_half_steps, x, scale)
                    found = self.simulate(x, scale)
                    fine = finer.result()
            self.n_simulations += 1
            return found if isinstance(found, Outcome) else replace(found, finer=fine)
        found, count = simulated(self.windows, x, scale)
        self.n_simulations += count
        return found

    def finer(self, x: Array, simulated: Simulated) -> Array:
        """Torques along the first window with half the steps, (n_kept, n_dof); NaN after an early end."""
        if simulated.finer is not None:
            return simulated.finer
        self.n_simulations += 1
        return self._with_half_steps(x, simulated.scale)

    def _with_half_steps(self, x: Array, scale: Array | None) -> Array:
        window = self.windows[0]
        arrays, _ = window.loop.divided(2).run(
            window.standard(x)[None], gain_scale=None if scale is None else scale[None]
        )
        return np.asarray(arrays[3][0][window.kept])

    def take_small_steps(self) -> bool:
        """Take small steps in time everywhere, once, unless it is the log that looks wrong; whether they are taken now.

        Those of the experiment suit the robot of the log and its motion; one with less inertia is stiff elsewhere too.
        """
        if self._refined or self.suspicions():
            return False
        self._refined, self._usual = True, self.windows
        smallest = min(min(window.loop.steps[0], *window.loop.steps[1]) for window in self.windows) / CAREFUL
        self.windows = [replace(window, loop=window.loop.even(smallest)) for window in self.windows]
        self.remarks.append(
            "from this start the simulation fails with the steps of the experiment: until the end is near they are "
            f"{1e3 * smallest:.3g} ms throughout"
        )
        self.say(self.remarks[-1])
        return True

    def take_usual_steps(self, x: Array) -> Simulated | None:
        """Return the simulation with the steps of the experiment after small ones; None where these hold, or remain needed."""
        if self._usual is None:
            return None
        small, self.windows, self._usual = self.windows, self._usual, None
        again = self.simulate(x)
        if isinstance(again, Simulated):
            return again
        self.windows = small
        return None

    def reference_positions(self) -> Array:
        """Positions along the references at which M(q) is looked at, (n, n_dof)."""
        positions = [window.loop.reference.at(window.loop.t)[0] for window in self.windows]
        return checked_positions(np.concatenate(positions))

    def gain_scale(self, x: Array) -> Array:
        """Factor of the gains of each joint: J(x) over the J of the IDIM-LS estimate, (n_dof,)."""
        q = self.reference_positions()
        here, real = (
            np.diagonal(inertia_matrix(self.job.robot, q, parameters), axis1=1, axis2=2).mean(axis=0)
            for parameters in (x[: len(self.job.robot.parameter_names)], self.direct().parameters)
        )
        return np.where((real > 0.0) & (here > 0.0), here / np.where(real > 0.0, real, 1.0), 1.0)

    def direct(self) -> Identification:
        """Return the IDIM-LS estimate with the settings of the method.

        A log without measured positions has the inertias of its joints along the reference, which is all that gains need of it.
        """
        if self._direct is None:
            method = self.method
            idim = IDIMLS(
                solver=method.chosen_solver(),
                weights=method.weights,
                reweightings=method.reweightings,
                variance=method.variance,
                uncertainty=method.uncertainty,
                blocks=method.blocks,
                decimation_corrected=method.decimation_corrected,
                signal=method.signal,
                compensate_samples=self.delay,
                fixed=method.fixed,
                dropped=method.dropped,
            )
            self._direct = idim.run(with_positions(self.job.experiment), lambda iteration: False, self.say)
        return self._direct

    def suspicions(self) -> list[str]:
        """Return what looks wrong along the measured motion, which no wrong parameter spoils."""
        if not self.measured:
            return []
        try:
            found = self.direct().evidence
        except DidimError:
            return []
        return [reason.sentence for reason in found if reason.code in TORQUE_CODES]


def with_positions(experiment: Experiment) -> Experiment:
    """Return an experiment whose robot is taken to be where its reference is, wherever positions were not measured."""
    recordings = [
        item if item.has_positions else replace(item, q=np.asarray(item.q_ref), has_positions=True)
        for item in experiment.recordings
    ]
    return replace(experiment, recordings=tuple(recordings))
