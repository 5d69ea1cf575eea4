"""Robots: trees of joints, their dynamics, and the parameters that a record can tell."""

from .base import Base, base_parameters
from .robot import Joint, Robot

__all__ = ["Base", "Joint", "Robot", "base_parameters"]
