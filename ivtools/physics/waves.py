"""Waves: sine and cosine of the position, as forces and encoders have them.

Compiled, they are calls that nobody may move. LLVM takes its own sine for so cheap that it works
it out before it asks whether the law that wants it acts at all, in each step of each simulation.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from typing import Any

import numpy as np
from numba import float64
from numba.extending import overload
from numba.types import ExternalFunction

from ..compiled import compiled

_SINE, _COSINE = (ExternalFunction(name, float64(float64)) for name in ("sin", "cos"))


def sine(x: Any) -> Any:
    """Return the sine of an angle, rad, or of several."""
    return np.sin(x)


def cosine(x: Any) -> Any:
    """Return the cosine of an angle, rad, or of several."""
    return np.cos(x)


@overload(sine)
def _sine(x):
    return lambda x: _SINE(x)


@overload(cosine)
def _cosine(x):
    return lambda x: _COSINE(x)


@compiled
def wave(q, a, b, period):
    """Return a cos(2 pi q/p) + b sin(2 pi q/p) at a position, m or rad, or at several."""
    angle = 2.0 * np.pi * q / period
    return a * cosine(angle) + b * sine(angle)
