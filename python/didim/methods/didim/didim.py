"""DIDIM: closed-loop output error on the torques, by linear least squares per iteration (section IV of the paper).

The closed loop is simulated with the current parameters; the regressor along the simulated motion, filtered and decimated in
parallel with the measured torques, gives the next parameters by least squares. Only torques are needed, neither positions and
velocities nor a band-pass filter. By default every iterate is a robot: (7) is solved with physical constraints. Tested in
``tests/test_didim.py`` and ``tests/test_consistent.py``.
"""

from __future__ import annotations

from typing import ClassVar

from ...experiment.experiment import Experiment
from ...result.identification import Identification
from ...result.iteration import Reporter
from .iterations import Iterations
from .settings import DIDIMSettings


class DIDIM(DIDIMSettings):
    """DIDIM with its settings, those of `DIDIMSettings` and `FitSettings`.

    By default every iterate is a robot (`didim.methods.didim.consistent`); ``physical=False`` is the DIDIM of the paper.

    Each iteration solves (16), the linear system along the simulated motion. Tested in ``tests/test_didim.py``.
    """

    physical_by_default: ClassVar[bool] = True

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        """Identify the parameters of an experiment's robot, as `Method.run`."""
        job = self.job(experiment, experiment.simulated_robot)
        return Iterations(self, job, reporter).result()
