"""Solvers of (7) as objects, with settings of their own: ``didim.IDIMLS(solver=didim.solvers.Consistent(...))``."""

from .regression.classical.solvers import Bisquare as Bisquare
from .regression.classical.solvers import Huber as Huber
from .regression.consistent.bounds import Bounds as Bounds
from .regression.consistent.prior import Prior as Prior
from .regression.consistent.solver import Consistent as Consistent
from .regression.recursive import Recursive as Recursive
from .regression.recursive import RecursiveEstimate as RecursiveEstimate
from .regression.settings import LeastSquaresSettings as LeastSquaresSettings
