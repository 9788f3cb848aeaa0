"""Design of motions with maximum information on a robot's parameters, within its limits."""

from ..robot.collision import Capsule as Capsule
from .clearance import Workspace as Workspace
from .settings import ExcitationSettings as ExcitationSettings
