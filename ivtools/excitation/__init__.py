"""Excitation: references that make a record tell the parameters, within the limits of the axes."""

from .excitation import Excitation
from .fourier import Fourier
from .limits import Limits
from .optimal import fourier
from .patterns import PATTERNS, pattern

__all__ = ["PATTERNS", "Excitation", "Fourier", "Limits", "fourier", "pattern"]
