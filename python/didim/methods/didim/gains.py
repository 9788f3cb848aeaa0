"""Invented gains in an experiment, computed from a robot by rule (D). Tested in ``tests/test_consistent_methods.py``."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..._tools.arrays import Array
from ...experiment.experiment import Experiment
from ...experiment.specs import ControllerSpec
from ...loop.controller import Controller
from ...loop.reference import Reference
from ...loop.tuning import made_up


def with_gains(experiment: Experiment, x: Array, q: Array) -> Experiment:
    """Return the experiment with gains by rule (D) from a robot, if its controller is invented."""
    spec = experiment.controller
    if not isinstance(spec, ControllerSpec) or spec.settings.get("kind") != "made-up":
        return experiment
    controller = made_up(
        experiment.simulated_robot,
        x,
        q,
        frequency_hz=float(spec.settings.get("natural_frequency_hz", 10.0)),
        error=float(spec.settings.get("tracking_error", 1e-3)),
    )
    return replace(experiment, controller=ControllerSpec(Ready(controller), spec.settings))


@dataclass(frozen=True)
class Ready:
    """A controller independent of the reference."""

    controller: Controller

    def __call__(self, reference: Reference) -> Controller:
        """Return the controller."""
        return self.controller
