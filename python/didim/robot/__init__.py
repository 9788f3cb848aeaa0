"""Robots: geometry, friction, limits and named parameter sets, and the files they are read from."""

from .friction import Friction as Friction
from .parameters import BaseParameters as BaseParameters
