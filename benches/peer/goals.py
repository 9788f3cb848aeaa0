"""What is wanted of the speed, as ratios in one run where there is a peer to compare with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .against_mujoco import MANY as MUJOCO_MANY
from .against_scipy import COLUMNS, ITERATIONS, SIZES
from .ours import CACHED, LANES, MANY, WHOLE_MANY, WHOLE_STEPS
from .task import STEPS
from .timing import Figures

SINGLE = "RK4 step and candidate, 1 candidate, 1 thread"
IN_LANES = f"RK4 step and candidate, {LANES} candidates, 1 thread"
BATCH = f"RK4 step and candidate, {MANY} candidates, 1 thread"
BATCH_TWO = f"RK4 step and candidate, {MANY} candidates, 2 threads"
WHOLE = f"RK4 step and candidate, {WHOLE_MANY} candidates of {WHOLE_STEPS} steps, 1 thread"
WHOLE_TWO = f"RK4 step and candidate, {WHOLE_MANY} candidates of {WHOLE_STEPS} steps, 2 threads"
ABA, RNEA = "Pinocchio abaInParallel, 1 thread", "Pinocchio rneaInParallel, 1 thread"
REGRESSOR = "Pinocchio computeJointTorqueRegressor, called from Python"
CASADI = "CasADi's C, forward dynamics"
STAGES = 4
"""Forward dynamics in a Runge-Kutta step: what a peer without a simulation is charged for one, its controller for nothing."""


@dataclass(frozen=True)
class Goal:
    """A ratio of two contestants, or one of them alone.

    Attributes
    ----------
    text : str
        What the table calls it.
    under : str
        Ours.
    over : str or None
        The peer's, times `factor`; None for ours alone.
    wanted : float or None
        Smallest good ratio, or largest good cost; None where nothing was asked for.
    """

    text: str
    under: str
    over: str | None = None
    factor: float = 1.0
    wanted: float | None = None

    def known(self, figures: Mapping[str, Figures]) -> bool:
        """Whether all that it needs was measured."""
        return self.under in figures and (self.over is None or self.over in figures)

    def values(self, figures: Mapping[str, Figures]) -> tuple[float, float]:
        """Ratios of the medians, and of the smallest."""
        ours = figures[self.under]
        if self.over is None:
            return ours.median, ours.smallest
        theirs = figures[self.over]
        return self.factor * theirs.median / ours.median, self.factor * theirs.smallest / ours.smallest

    def met(self, value: float) -> bool | None:
        """Whether a value is good enough."""
        if self.wanted is None:
            return None
        return value <= self.wanted if self.over is None else value >= self.wanted


def _mujoco(many: int) -> str:
    return f"MuJoCo RK4 step, {many} simulation{'s' if many > 1 else ''}, "


GOALS = (
    Goal("RK4 step and lane, 4 lanes, one core (us)", IN_LANES, wanted=0.30),
    Goal("4 abaInParallel / RK4 step and lane, 4 lanes", IN_LANES, ABA, STAGES, 20.0),
    Goal("4 CasADi / RK4 step and lane, 4 lanes", IN_LANES, CASADI, STAGES, 5.0),
    Goal("4 abaInParallel / RK4 step of one simulation", SINGLE, ABA, STAGES, 5.0),
    Goal("4 CasADi / RK4 step of one simulation", SINGLE, CASADI, STAGES, 1.0),
    Goal("MuJoCo's RK4 step / ours, one simulation", SINGLE, _mujoco(1) + "1 thread", wanted=5.0),
    Goal("MuJoCo's RK4 step / ours, batches, one core", BATCH, _mujoco(MUJOCO_MANY) + "1 thread"),
    Goal("MuJoCo's RK4 step / ours, batches, two threads", BATCH_TWO, _mujoco(MUJOCO_MANY) + "2 threads"),
    Goal(f"one thread / two threads, RK4 batch of {STEPS} steps", BATCH_TWO, BATCH),
    Goal(f"one thread / two threads, RK4 batch of {WHOLE_STEPS} steps", WHOLE_TWO, WHOLE, wanted=1.9),
    Goal("regressor in the cache", f"regressor, {CACHED} samples a call", REGRESSOR, wanted=15.0),
    Goal("rneaInParallel / inverse_dynamics", "inverse_dynamics", RNEA, wanted=5.0),
    Goal("abaInParallel / direct_dynamics", "direct_dynamics", ABA),
    Goal("CasADi / direct_dynamics", "direct_dynamics", CASADI),
    Goal("crba / inertia_matrix", "inertia_matrix", "Pinocchio crba, called from Python"),
    *(
        Goal(
            f"SciPy's lstsq ({driver}) / ours, {rows} rows",
            f"least squares, {rows} x {COLUMNS}",
            f"SciPy lstsq ({driver}), {rows} x {COLUMNS}",
        )
        for rows in SIZES
        for driver in ("gelsd", "gelsy")
    ),
    Goal(
        "SciPy's simplex / batched simplex",
        f"batched simplex, {ITERATIONS} iterations in {COLUMNS} dimensions",
        f"SciPy's simplex, {ITERATIONS} iterations in {COLUMNS} dimensions",
    ),
    Goal("IDIM-LS, TX40 log, CSV to table (s)", "IDIM-LS, TX40 log, both cores", wanted=0.25),
    Goal("IDIM-LS, TX40 log, numerics (s)", "IDIM-LS, TX40 log, both cores, numerics", wanted=0.10),
    Goal("figaroh / IDIM-LS", "IDIM-LS, TX40 log, both cores", "figaroh, TX40 log", wanted=20.0),
    Goal("IDIM-LS, TX40 log, peak memory (MB)", "IDIM-LS, TX40 log, peak memory", wanted=150.0),
    Goal("DIDIM, simulated TX40 (s)", "DIDIM, simulated TX40, both cores", wanted=0.25),
    Goal("import didim, beyond NumPy (s)", "import didim, beyond NumPy", wanted=0.15),
)
