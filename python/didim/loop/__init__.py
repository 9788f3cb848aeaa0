"""The closed loop: references, controllers, simulation."""

from .controller import Digital as Digital
from .memory import ControllerMemory as ControllerMemory
from .outcome import SimulationStatus as SimulationStatus
from .simulation import StepWarning as StepWarning
