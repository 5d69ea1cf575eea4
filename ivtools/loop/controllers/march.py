"""A law with states, sample by sample, compiled."""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from ...compiled import cached


@cached()
def march(A, driven, direct, C, back, hold, x, side, limit, frozen, given, sure, out):
    """Fill `out` with the command, and `frozen` with the states that were held.

    Where `side` is not 0 the command was clipped, to `side * limit`; if that is not `sure`, only
    where it is beyond that. If the held states are `given` they are taken, not found.
    """
    n, new = C.size, x.copy()
    for k in range(out.size):
        value = direct[k]
        for i in range(n):
            value += C[i] * x[i]
        out[k] = value
        for i in range(n):
            new[i] = driven[k, i]
            for j in range(n):
                new[i] += A[i, j] * x[j]
        if side[k] != 0.0 and (sure or side[k] * value >= limit):
            for i in range(n):
                new[i] += back[i] * (side[k] * limit - value)
                if not given:
                    frozen[k, i] = hold[i] and C[i] * (new[i] - x[i]) * side[k] > 0.0
                if frozen[k, i]:
                    new[i] = x[i]
        x[:] = new
