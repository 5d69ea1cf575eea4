"""The closed loop: controller, drive, mechanics and sensor, as one model."""

from .closed_loop import ClosedLoop
from .controllers import Controller, LinearLaw
from .robot_loop import RobotLoop
from .simulation import Simulation

__all__ = ["ClosedLoop", "Controller", "LinearLaw", "RobotLoop", "Simulation"]
