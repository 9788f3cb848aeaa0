"""Settings of DIDIM. Tested in ``tests/test_didim.py``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from ..._tools.settings import one_of, share, whole
from ...errors import FitError
from ...regression.consistent.solver import Consistent
from ..method import FitSettings, Motion
from ..start import Start

GainUpdating = Literal["first", "always", "never"]


@dataclass(frozen=True, kw_only=True)
class DIDIMSettings(FitSettings):
    """Settings of DIDIM, in addition to those of `FitSettings`.

    Parameters
    ----------
    start : str, mapping, array or Identification, optional
        Initial parameters (`didim.methods.start.standard_start`): "consistent" for the consistent solution along the measured
        motion, "prior" for the robot of the prior, "unit" for (17), "idim-ls", a parameter set of the robot file, ... The
        default is "consistent" for physically consistent estimates and "unit" for plain ones. A consistent run begins with the
        robot nearest to the start.
    tolerance : float
        Stop when the norm of the residual changes by less than this share (absolute value; 2.5 % in the paper).
    sigma_fraction : float
        Alternatively stop when no parameter changes by more than this fraction of its standard deviation. The result names the
        rule that fired. With a slack loop, Newton's method then continues to the fixed point and gives its standard deviations
        (`didim.methods.didim.slack`).
    max_iterations : int
        Upper bound of the least-squares solutions.
    gain_updating : {"first", "always", "never"}
        Scale the gains of the simulated controller by ``J(x) / J``, joint by joint, in the first simulation, also after every
        step that had to be shortened, or never; ``J`` is the mean of ``diag M(q)`` along the reference, once for the parameters
        simulated and once for the IDIM-LS estimate. A robot far from the real one then tracks like it. After a full step the
        gains are those of the controller, so the result does not depend on the scaling.
    margin : float
        Share of M(q) that a shortened step preserves, at every position of the motion (between 0 and 1).
    stop : bool
        False to disable the stopping rules.

    Raises
    ------
    FitError
        For a value out of its range.
    """

    name: ClassVar[str] = "didim"
    motion: ClassVar[Motion] = "simulated"
    estimates_gains: ClassVar[bool] = True

    start: Start | None = None
    tolerance: float = 1e-3
    sigma_fraction: float = 0.3
    max_iterations: int = 20
    gain_updating: GainUpdating = "first"
    margin: float = 0.1
    stop: bool = True

    @property
    def chosen_start(self) -> Start:
        """The start, or the default of the solver."""
        if self.start is not None:
            return self.start
        choice = self.chosen_solver()
        return "consistent" if choice == "consistent" or isinstance(choice, Consistent) else "unit"

    def __post_init__(self) -> None:
        super().__post_init__()
        share("tolerance", self.tolerance, FitError, most=0.025)
        share("sigma_fraction", self.sigma_fraction, FitError)
        share("margin", self.margin, FitError, inside=True)
        whole("max_iterations", self.max_iterations, FitError, least=1)
        one_of("gain_updating", self.gain_updating, get_args(GainUpdating), FitError)
        one_of("stop", self.stop, (True, False), FitError)
