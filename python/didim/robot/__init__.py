"""What a robot is."""

from .base_parameters import BaseParameters as BaseParameters
from .friction import Friction as Friction
