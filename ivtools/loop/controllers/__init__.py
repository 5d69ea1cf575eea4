"""Controllers: one linear form of every law, the kinds of laws, and what a law sees of a record."""

from .controller import ANTI_WINDUP, Controller
from .kinds import KINDS, Kind
from .law import INPUTS, LinearLaw
from .seen import Seen, ahead, other_derivative, reference_response, references
from .velocity import backward_difference

__all__ = [
    "ANTI_WINDUP",
    "INPUTS",
    "KINDS",
    "Controller",
    "Kind",
    "LinearLaw",
    "Seen",
    "ahead",
    "backward_difference",
    "other_derivative",
    "reference_response",
    "references",
]
