"""How functions are compiled: `compiled` ones are called, `inlined` ones become part of the caller.

Numba hands the wish to be inlined on to whatever it compiles first on behalf of such a function, so
that one inlined function drags a whole tree into its callers, and again into theirs. Each function
therefore says what it wants for itself.
"""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

from numba import njit

compiled = njit(error_model="numpy", forceinline=False)
inlined = njit(error_model="numpy", forceinline=True)
