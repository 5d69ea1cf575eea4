"""Floor: what no model of the axis could close.

floor       the noise of the command, and the events from outside
measured    a record with its base model and floor, as it is judged, whole or in folds
"""

from .floor import Floor, autoregression, between
from .measured import Measured, Ready, audible, beside_silent, folds, masked, measure, prepared

__all__ = [
    "Floor",
    "Measured",
    "Ready",
    "audible",
    "autoregression",
    "beside_silent",
    "between",
    "folds",
    "masked",
    "measure",
    "prepared",
]
