"""Settings of the signal processing from a recording to the rows of (6). Tested in ``tests/test_signals.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from .._tools.keys import declared
from .._tools.settings import check_declared, whole
from ..errors import SignalError

Convention = Literal["scipy", "matlab"]
Ends = Literal["second-order", "first-order"]
Form = Literal["sections", "transfer-function"]
Spikes = Literal["hampel"]


@dataclass(frozen=True, kw_only=True)
class SignalProcessing:
    """Settings of the filters from a recording to the rows of the linear system.

    The filter acts on both sides of (7).

    Attributes
    ----------
    cutoff_hz : float or None
        Cut-off of the positions' zero-phase Butterworth filter (Hz); None disables it.
    order : int
        Order of one of its two passes: 1 to 10.
    padding : {"scipy", "matlab"}
        Samples of odd extension at each end: SciPy's 3 (order + 1), or MATLAB's 3 order. Where `ends` is "second-order", a longer
        extension that keeps the curvature takes the place of SciPy's.
    form : {"sections", "transfer-function"}
        Implementation of the Butterworth filter. Second-order sections are numerically sound. The transfer function is that of
        MATLAB's ``filtfilt(b, a, x)``: at standstill its rounding noise decides the sign of the velocity
        (docs/published.md), so it is needed to reproduce figures that were computed with it.
    ends : {"second-order", "first-order"}
        Differences at the first and last sample of a window, and extension of the signals beyond them. Second order: one-sided
        differences that are exact for parabolas, and an extension with continuous curvature. First order: differences that,
        applied twice, give half of the acceleration at an end and three quarters beside it, and a plain odd extension, which
        makes it zero. It reproduces figures computed in this way.
    trim_start, trim_end : int
        Samples dropped at the ends after differentiation, where the filter relies on the extension.
    decimation : tuple of int
        Factors of the parallel filter (6), one per stage; empty for no decimation.
    decimation_convention : {"scipy", "matlab"}
        Padding of the decimation filter, and the samples it keeps: SciPy keeps the first of the record,
        MATLAB the last.
    edge_rows : int
        Rows dropped at each end of a decimated window. Padding mirrors a signal about its first and last sample, which ties the
        filter to the unfiltered noise of both: the first kept sample of white torque noise, decimated by 50, has 40 times the
        variance of the others (``test_signals.py``), which spoils estimates and sigmas.

    spikes : {"hampel"} or None
        Replace spikes of the measured torques first of all, by Hampel's filter (`didim.signal.spikes`). None disables it.

    Raises
    ------
    SignalError
        For an invalid value.
    """

    cutoff_hz: float | None = None
    order: int = 4
    padding: Convention = "scipy"
    ends: Ends = "second-order"
    form: Form = "sections"
    trim_start: int = 0
    trim_end: int = 0
    decimation: tuple[int, ...] = ()
    decimation_convention: Convention = "scipy"
    edge_rows: int = 2
    spikes: Spikes | None = None

    @property
    def kept_rows(self) -> slice:
        """Rows of a decimated window, without those dropped at its ends."""
        edge = self.edge_rows if self.decimation else 0
        return slice(edge, -edge if edge else None)

    def __post_init__(self) -> None:
        check_declared(self, declared("experiment", "signal"), SignalError)
        if isinstance(self.decimation, str) or not isinstance(self.decimation, Sequence):
            raise SignalError(f"decimation must be a tuple of whole numbers, got {self.decimation!r}")
        factors = tuple(
            whole("each decimation factor", factor, SignalError, least=2) for factor in self.decimation
        )
        object.__setattr__(self, "decimation", factors)


def check_order(order: int) -> int:
    """Return the order of a Butterworth filter, or refuse one that is not within the declared bounds."""
    key = declared("experiment", "signal").rows["order"]
    return whole("order", order, SignalError, least=key.minimum, most=key.maximum)
