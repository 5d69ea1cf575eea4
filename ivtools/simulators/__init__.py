"""A user's own simulator: what it does on a record's reference, and the way back into it."""

from __future__ import annotations

from ivtools.simulators.protocol import Simulator
from ivtools.simulators.rollout import MujocoSimulator

__all__ = ["MujocoSimulator", "Simulator"]
