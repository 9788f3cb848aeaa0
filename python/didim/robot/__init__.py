"""Robots: geometry, friction, limits and named parameter sets, and the files they are read from."""

from .base_parameters import BaseParameters as BaseParameters
from .friction import Friction as Friction
