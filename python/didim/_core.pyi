"""Typed border of the numerical core; private to the package. Arrays are float64, shapes are checked."""

from collections.abc import Sequence
from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ConsistentProblem",
    "ConsistentSolutions",
    "Controller",
    "LeastSquares",
    "Reference",
    "Robot",
    "Schedule",
    "base_parameters",
    "decimate",
    "direct_dynamics",
    "filtfilt",
    "inertia_matrix",
    "information",
    "information_gradient",
    "instruction_set",
    "instruction_sets",
    "inverse_dynamics",
    "largest_safe_step",
    "least_squares",
    "observation",
    "parse_table",
    "regressor",
    "set_point_areas",
    "simulate",
    "simulate_cost",
    "simulate_servos",
    "smallest_eigenvalue",
]

_Array = NDArray[np.float64]
_Stage = tuple[_Array, _Array, int, int, int]

_Cone = tuple[Sequence[int], _Array, _Array, float, _Array]

@final
class ConsistentProblem:
    def __new__(
        cls,
        count: int,
        cones: Sequence[_Cone],
        coefficients: _Array | None = None,
        values: _Array | None = None,
        least_weight: float = ...,
    ) -> ConsistentProblem: ...
    def solve(self, a: _Array, z: _Array, start: _Array, threads: int = 1) -> ConsistentSolutions: ...

@final
class ConsistentSolutions:
    @property
    def x(self) -> _Array: ...
    @property
    def endings(self) -> list[tuple[str, int | None]]: ...
    @property
    def iterations(self) -> list[int]: ...
    def multipliers(self, solution: int) -> list[list[float]]: ...

@final
class Robot:
    def __new__(
        cls,
        *,
        kind: Sequence[int],
        alpha: Sequence[float],
        d: Sequence[float],
        theta: Sequence[float],
        r: Sequence[float],
        gravity: Sequence[float],
        transmission: Sequence[Sequence[float]],
        asymmetric: bool,
        printed_coupling: bool,
        smoothing: Sequence[float],
        dead_zone: Sequence[float],
        held: Sequence[float],
        terms: Sequence[tuple[int, str, str, float, float, Sequence[float]]] = ...,
        mounts: Sequence[tuple[int | None, float, float, tuple[float, float, float]]] | None = ...,
        followers: Sequence[tuple[Sequence[tuple[int, float]], float]] = ...,
    ) -> Robot: ...
    @property
    def n_dof(self) -> int: ...
    @property
    def n_parameters(self) -> int: ...
    @property
    def parameter_names(self) -> list[str]: ...
    @property
    def parameter_units(self) -> list[str]: ...

@final
class LeastSquares:
    @property
    def solution(self) -> _Array: ...
    @property
    def inverse_r(self) -> _Array: ...
    @property
    def singular_values(self) -> _Array: ...
    @property
    def residual_norm(self) -> float: ...
    @property
    def dependent(self) -> list[tuple[int, list[tuple[int, float]]]]: ...

def base_parameters(
    robot: Robot,
) -> tuple[list[int], list[list[tuple[int, float, str]]], list[int]]: ...
def inverse_dynamics(robot: Robot, q: _Array, dq: _Array, ddq: _Array, x: _Array) -> _Array: ...
def inertia_matrix(robot: Robot, q: _Array, x: _Array) -> _Array: ...
def direct_dynamics(
    robot: Robot, q: _Array, dq: _Array, tau: _Array, x: _Array
) -> tuple[_Array, tuple[int, int] | None]: ...
def smallest_eigenvalue(robot: Robot, q: _Array, x: _Array) -> tuple[int, float] | None: ...
def largest_safe_step(robot: Robot, q: _Array, x: _Array, target: _Array, margin: float) -> float: ...
def regressor(
    robot: Robot, q: _Array, dq: _Array, ddq: _Array, out: _Array | None = None, load: _Array | None = None
) -> _Array: ...
def parse_table(
    text: bytes, delimiter: int, columns: int, wanted: Sequence[int], threads: int | None = None
) -> _Array | None: ...
def filtfilt(
    signals: _Array, sos: _Array, zi: _Array, padding: int, threads: int | None = None
) -> _Array: ...
def decimate(signals: _Array, stages: Sequence[_Stage], threads: int | None = None) -> _Array: ...
def observation(
    robot: Robot,
    q: _Array,
    dq: _Array,
    ddq: _Array,
    columns: Sequence[int],
    stages: Sequence[_Stage],
    threads: int | None = None,
    load: _Array | None = None,
) -> _Array: ...
def least_squares(w: _Array, y: _Array, tolerance: float = 1e-10) -> LeastSquares: ...

_Signal = tuple[float, _Array]
_Ending = tuple[int, float, int]

@final
class Reference:
    @staticmethod
    def from_knots(times: _Array, q: _Array, dq: _Array, ddq: _Array) -> Reference: ...
    @staticmethod
    def sampled(rate: float, q: _Array) -> Reference: ...
    @staticmethod
    def fourier(
        period: float, offset: Sequence[float], sine: _Array, cosine: _Array, duration: float, knots: int
    ) -> Reference: ...
    @staticmethod
    def point_to_point(
        points: _Array, velocity: Sequence[float], acceleration: Sequence[float], dwell: float
    ) -> Reference: ...
    def with_breaks(self, breaks: Sequence[float]) -> Reference: ...
    @property
    def n_dof(self) -> int: ...
    @property
    def span(self) -> tuple[float, float]: ...
    @property
    def breaks(self) -> list[float]: ...
    def at(self, times: _Array) -> tuple[_Array, _Array, _Array]: ...

@final
class Controller:
    def __new__(
        cls,
        laws: Sequence[Sequence[float]],
        digital: tuple[float, int, Sequence[float], Sequence[float]] | None = None,
        feedforward: _Signal | None = None,
    ) -> Controller: ...
    @property
    def period(self) -> float | None: ...

@final
class Schedule:
    def __new__(
        cls,
        robot: Robot,
        reference: Reference,
        *,
        rate: float,
        records: int,
        period: float | None,
        coarse: float,
        fine: Sequence[float],
        slow: Sequence[float],
        motion: Reference | None = None,
    ) -> Schedule: ...
    @property
    def steps(self) -> int: ...
    @property
    def records(self) -> int: ...
    @property
    def edges(self) -> _Array: ...
    def divided(self, parts: int) -> Schedule: ...

class _Setting(Protocol):
    @property
    def robot(self) -> Robot: ...
    @property
    def reference(self) -> Reference: ...
    @property
    def controller(self) -> Controller: ...
    @property
    def schedule(self) -> Schedule: ...
    @property
    def start(self) -> tuple[Sequence[float], Sequence[float]] | None: ...
    @property
    def memory(self) -> tuple[str, list[float], list[float] | None, list[float] | None]: ...
    @property
    def external(self) -> _Signal | None: ...
    @property
    def divergence(self) -> float: ...
    @property
    def implicit_friction(self) -> bool: ...

def simulate(
    setting: _Setting, x: _Array, scale: _Array, threads: int | None = None, wanted: Sequence[bool] = ...
) -> tuple[list[_Array], list[_Ending]]: ...
def simulate_servos(
    setting: _Setting, x: _Array, rows: _Array, targets: _Array, threads: int | None = None
) -> tuple[_Array, list[_Ending]]: ...
def set_point_areas(goals: _Array, rate: float, acceleration: float, times: _Array) -> _Array: ...
def simulate_cost(
    setting: _Setting,
    x: _Array,
    scale: _Array,
    q: _Array,
    tau: _Array,
    weight_q: Sequence[float],
    weight_tau: Sequence[float],
    threads: int | None = None,
) -> tuple[_Array, list[_Ending]]: ...
def information(
    robot: Robot, q: _Array, dq: _Array, ddq: _Array, columns: Sequence[int], weights: _Array
) -> _Array: ...
def information_gradient(
    robot: Robot,
    q: _Array,
    dq: _Array,
    ddq: _Array,
    columns: Sequence[int],
    weights: _Array,
    derivative: _Array,
    torque_weights: _Array | None = None,
    x: _Array | None = None,
) -> tuple[_Array, _Array, _Array]: ...
def instruction_set() -> str: ...
def instruction_sets() -> list[str]: ...
