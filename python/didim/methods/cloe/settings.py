"""Settings of CLOE."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, get_args

import numpy as np

from ..._tools.arrays import real_array
from ..._tools.settings import one_of, share, whole
from ..._tools.threads import MOST_THREADS
from ...errors import FitError
from ..method import MethodSettings, Motion
from ..start import Start

Optimizer = Literal["levenberg-marquardt", "nelder-mead"]
Output = Literal["position", "torque", "both"]
Variant = Literal["scaled", "adaptive", "literal"]


@dataclass(frozen=True, kw_only=True)
class CLOESettings(MethodSettings):
    """Settings of CLOE without its searches; the parameters are those of `didim.CLOE`.

    Raises
    ------
    FitError
        For a value out of its range.
    """

    optimizer: Optimizer = "levenberg-marquardt"
    output: Output = "position"
    start: Start | None = None
    physical: bool | None = None
    max_iterations: int | None = None
    max_evaluations: int | None = None
    variant: Variant = "adaptive"
    tolerance: float = 1e-6
    noise: Sequence[float] | None = None
    threads: int | None = None
    starts: int = 1
    seed: int = 0
    checkpoint: str | Path | None = None
    executor: Executor | None = None

    motion: ClassVar[Motion] = "simulated"
    raw: ClassVar[bool] = True
    kind: ClassVar[str] = "cloe"

    @property
    def name(self) -> str:
        """Name in results: "cloe-nelder-mead" or "cloe-levenberg-marquardt", "clie-..." on torques."""
        return f"{'clie' if self.output == 'torque' else 'cloe'}-{self.optimizer}"

    @property
    def chosen_start(self) -> Start:
        """The start, or the default."""
        if self.start is not None:
            return self.start
        return "consistent" if self.physical else "apriori"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.physical, bool | None):
            raise FitError(f"physical must be True or False, got {self.physical!r}")
        if self.physical and self.optimizer != "levenberg-marquardt":
            raise FitError("physical=True is for the optimizer 'levenberg-marquardt'")
        for key, choices in (("optimizer", Optimizer), ("output", Output), ("variant", Variant)):
            one_of(key, getattr(self, key), get_args(choices), FitError)
        whole("starts", self.starts, FitError, least=1)
        whole("seed", self.seed, FitError, least=0)
        for key in ("max_iterations", "max_evaluations"):
            if getattr(self, key) is not None:
                whole(key, getattr(self, key), FitError, least=1)
        if self.executor is not None and not isinstance(self.executor, Executor):
            raise FitError(f"executor must be one of concurrent.futures, got {self.executor!r}")
        if self.threads is not None:
            whole("threads", self.threads, FitError, least=1, most=MOST_THREADS)
        if self.noise is not None:
            noise = real_array("noise", self.noise, FitError)
            if noise.ndim != 1 or not (np.isfinite(noise) & (noise > 0.0)).all():
                raise FitError(f"noise needs positive numbers, one per joint, got {self.noise!r}")
            object.__setattr__(self, "noise", tuple(noise.tolist()))
        share("tolerance", self.tolerance, FitError)
        if self.checkpoint is not None and not Path(self.checkpoint).absolute().parent.is_dir():
            raise FitError(
                f"checkpoint '{self.checkpoint}': there is no folder '{Path(self.checkpoint).parent}'"
            )
        if self.checkpoint is not None and self.starts > 1:
            raise FitError("a checkpoint belongs to one search: starts must be 1 with it")
