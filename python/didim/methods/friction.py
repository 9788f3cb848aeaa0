"""Choice of friction terms and their velocities, before the identification of the parameters.

For every method both are determined by least squares along the measured motion and then fixed: the columns of (7) and the
simulated robot have known laws. Tested in ``tests/test_friction_choice.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from .._tools.words import joints_text, series
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..experiment.loop import recordings_of
from ..regression.friction.candidates import LEAST_WARMING
from ..regression.friction.choice import REFUSED, FrictionChoice, choose_terms
from ..regression.friction.velocity import VelocityEstimate, settled
from ..signal.noise import coarsest_steps
from ..signal.window import Window
from .job import Delay
from .method import Method, MethodSettings


@dataclass(frozen=True)
class FoundFriction:
    """Friction terms and velocities that a log supports.

    Attributes
    ----------
    velocities : tuple of VelocityEstimate
        Velocities of atan and Stribeck terms (rad/s or m/s).
    choice : FrictionChoice or None
        Choice of the terms, if any.
    """

    velocities: tuple[VelocityEstimate, ...]
    choice: FrictionChoice | None = None

    def record(self) -> dict[str, Any]:
        """Return the record for a result's settings, as JSON data."""
        record: dict[str, Any] = {
            "velocities": [
                {**asdict(velocity), "std": velocity.std if velocity.std == velocity.std else None}
                for velocity in self.velocities
            ]
        }
        if self.choice is not None:
            record["chosen"] = [asdict(gain) for gain in self.choice.gains]
            record["refused"] = [asdict(gain) for gain in self.choice.untold]
            record["untold_memory"] = {
                str(joint + 1): value for joint, value in self.choice.without_memory.items()
            }
            record["held_out_error"] = [self.choice.held_out_before, self.choice.held_out_after]
        return record

    def remarks(self) -> list[str]:
        """Return sentences on the terms and velocities."""
        sentences = []
        if self.choice is not None:
            before, after = 100.0 * self.choice.held_out_before, 100.0 * self.choice.held_out_after
            terms = [f"{gain.parameter} {100.0 * gain.gain:.1f}" for gain in self.choice.gains]
            sentences.append(
                f"held-out blocks support the friction terms {series(terms, 60)} (% of the squared error without each); "
                f"it falls from {before:.2f} to {after:.2f} %"
                if terms
                else f"no friction term was chosen: held-out blocks miss {before:.0f} % of the torques, "
                f"{REFUSED[self.choice.refused]}"
                if self.choice.refused
                else f"held-out blocks support no further friction term; their error is {before:.2f} %"
            )
            if untold := [f"{gain.parameter} ({100.0 * gain.shift:.0f} %)" for gain in self.choice.untold]:
                sentences.append(
                    f"the log does not separate {series(untold, 60)} from the links, whose torque in other poses would change: "
                    "record more poses and speeds"
                )
            if narrowest := self.choice.without_memory:
                joints = joints_text(sorted(narrowest))
                sentences.append(
                    f"memory of friction below {max(narrowest.values()):.2g} rad or m is not tried at {joints}: "
                    "encoder steps, or motion between samples at reversals, are above a tenth of it"
                )
        for what, laws in (
            ("velocities of friction laws (rad/s or m/s)", ("atan", "stribeck")),
            ("displacements of friction that remembers (rad or m)", ("dahl",)),
        ):
            known = [
                f"{velocity.velocity:.3g} +- {velocity.std:.1g} for {velocity.parameter}"
                for velocity in self.velocities
                if velocity.identified and velocity.law in laws
            ]
            if known:
                sentences.append(f"{what}: {series(known, 140)}")
        unknown = [velocity for velocity in self.velocities if not velocity.identified]
        if unknown:
            names = series((velocity.parameter for velocity in unknown), 80)
            roots = self.choice is None and any(velocity.law == "atan" for velocity in unknown)
            cure = "the square root of the speed replaces atan" if roots else "its deviation is not known"
            what = "displacement" if all(velocity.law == "dahl" for velocity in unknown) else "velocity"
            sentences.append(f"the log does not identify the {what} of {names}: {cure}")
        return sentences


def with_known_friction(
    method: Method, experiment: Experiment, say: Callable[[str], None]
) -> tuple[Experiment, FoundFriction | None]:
    """Return the experiment with known friction laws, and their estimates; None if all laws were known.

    Parameters
    ----------
    method : method
        Method whose filters, delay, fixed and dropped parameters also apply to the search.
    experiment : Experiment
        Experiment whose friction has terms of unknown velocity, or leaves the choice of terms to the log.
    say : callable
        Callback for sentences on the progress.

    Raises
    ------
    DidimError
        As for IDIM-LS.
    """
    settings = method if isinstance(method, MethodSettings) else MethodSettings()
    friction = experiment.robot.friction
    if friction.warmed:
        _check_temperature(method, experiment)
    auto = settings.friction == "auto" or friction.auto
    if not auto and not friction.estimated:
        return experiment, None
    job = settings.job(experiment)

    def windows(delay: Delay) -> list[Window]:
        parts = job.parts("fit", delay)
        # A simulation is at the reference temperature.
        return [replace(part, temperature=None) for part in parts] if method.motion == "simulated" else parts

    robot = experiment.robot
    if not auto:
        refined = settled(job.model, windows(job.delay()), job.signal, job.estimate)
        return replace(experiment, robot=refined.robot), FoundFriction(refined.velocities)
    say("choosing friction terms by their error on held-out blocks")
    parts = windows(job.declared_delay)
    used = {part.recording for part in parts}
    steps = coarsest_steps(experiment.recordings[k].measured_positions() for k in used)
    choice = choose_terms(job.model, parts, job.signal, job.estimate, steps)
    chosen = replace(experiment, robot=robot.with_terms(choice.friction.terms))
    if job.delay_setting == "estimate":
        # Friction that the model lacks looks like a delay, so the delay comes after it, and friction once more after a delay.
        delay = settings.job(chosen).delay()
        if np.any(delay.samples):
            choice = choose_terms(job.model, windows(delay), job.signal, job.estimate, steps)
            chosen = replace(experiment, robot=robot.with_terms(choice.friction.terms))
    return chosen, FoundFriction(choice.velocities, choice)


def _check_temperature(method: Method, experiment: Experiment) -> None:
    """Refuse laws of temperature for simulations, and for recordings whose temperature is unknown or hardly varies.

    Raises
    ------
    FitError
        The sentence names the parameter (``test_friction_temperature.py``).
    """
    terms = experiment.robot.friction.warmed
    if method.motion == "simulated":
        raise FitError(
            f"{terms[0].parameter} depends on the temperature, and {method.name} simulates the robot at one: identify it by "
            "idim-ls, or leave it out of [friction]"
        )
    for term in terms:
        recorded = []
        for _, recording in recordings_of(experiment):
            if recording.temperature is None:
                raise FitError(
                    f"recording '{recording.name}' has no temperature, on which {term.parameter} depends: "
                    "give [recording.temperature]"
                )
            recorded += [recording.temperature[start:stop, term.joint] for start, stop in recording.windows]
        change = float(np.ptp(np.concatenate(recorded)))
        if change < LEAST_WARMING:
            raise FitError(
                f"the temperature of joint {term.joint + 1} varies by {change:.2g} K, which is too little for {term.parameter} "
                f"(at least {LEAST_WARMING:g} K): leave it out of [friction]"
            )
