"""Settings of DIDIM. Tested in ``tests/test_didim.py``."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import ClassVar, Literal

from ...errors import FitError
from ..method import FitSettings, Motion
from ..start import Start

GainUpdating = Literal["first", "always", "never"]


@dataclass(frozen=True, kw_only=True)
class DIDIMSettings(FitSettings):
    """Settings of DIDIM, beside those of `FitSettings`.

    Parameters
    ----------
    start : str, mapping, array or Identification
        Initial parameters (`didim.methods.start.standard_start`): "unit" for (17), "idim-ls", a parameter set of the robot
        file, ...
    tolerance : float
        Stop when the norm of the residual changes by less than this share (absolute value of the change; the paper takes
        2.5 %).
    sigma_fraction : float
        Or when no parameter changes by more than this fraction of its standard deviation. The result names the rule that
        fired, and the distance from the fixed point where slow contraction leaves more than 0.3 sigma.
    max_iterations : int
        Least-squares solutions at most.
    gain_updating : {"first", "always", "never"}
        Scale the gains of the simulated controller by ``J(x) / J``, joint by joint, in the first simulation, also after every
        step that had to be shortened, or never; ``J`` is the mean of ``diag M(q)`` along the reference, once for the parameters
        simulated and once for the IDIM-LS estimate. A robot far from the real one then tracks like it. After a full step
        the gains are those of the controller, so that the result does not depend on it.
    margin : float
        A step that must be shortened keeps at least this share of M(q), at every position of the motion (between 0 and 1).
    stop : bool
        False to make all iterations, whatever the rule says.

    Raises
    ------
    FitError
        For a value out of its range.
    """

    name: ClassVar[str] = "didim"
    motion: ClassVar[Motion] = "simulated"

    start: Start = "unit"
    tolerance: float = 1e-3
    sigma_fraction: float = 0.3
    max_iterations: int = 20
    gain_updating: GainUpdating = "first"
    margin: float = 0.1
    stop: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, low, high in (("tolerance", 0.0, 0.025), ("sigma_fraction", 0.0, 1.0), ("margin", 0.0, 1.0)):
            value = getattr(self, key)
            number = isinstance(value, Real) and not isinstance(value, bool)
            if not number or not low <= value <= high or (key == "margin" and not 0.0 < value < 1.0):
                raise FitError(f"{key} must be between {low:g} and {high:g}, got {value!r}")
        if (
            isinstance(self.max_iterations, bool)
            or not isinstance(self.max_iterations, int)
            or self.max_iterations < 1
        ):
            raise FitError(
                f"max_iterations must be a whole number of at least 1, got {self.max_iterations!r}"
            )
        if self.gain_updating not in ("first", "always", "never"):
            raise FitError(f"gain_updating must be 'first', 'always' or 'never', got {self.gain_updating!r}")
        if not isinstance(self.stop, bool):
            raise FitError(f"stop must be True or False, got {self.stop!r}")
