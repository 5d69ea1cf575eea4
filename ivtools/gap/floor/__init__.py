"""Floor: what no model of the axis could close.

floor       the noise of the command
events      stretches that stand out of it
repeats     what differs from pass to pass, and between two records of one motion
measured    a record with its base model and floor, as it is judged, whole or in folds
"""

from .floor import Floor, autoregression
from .measured import (
    Measured,
    Ready,
    audible,
    beside_silent,
    come_again,
    fitted,
    folds,
    masked,
    measure,
    prepared,
)
from .repeats import between

__all__ = [
    "Floor",
    "Measured",
    "Ready",
    "audible",
    "autoregression",
    "beside_silent",
    "between",
    "come_again",
    "fitted",
    "folds",
    "masked",
    "measure",
    "prepared",
]
