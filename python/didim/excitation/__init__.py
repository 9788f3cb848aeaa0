"""Motions that identify a robot well: designed by the information they give, within the limits of the robot."""

from ..robot.collision import Capsule as Capsule
from .clearance import Workspace as Workspace
from .settings import ExcitationSettings as ExcitationSettings
