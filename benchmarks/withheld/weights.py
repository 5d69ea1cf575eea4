"""Weights: what turns the evidence for a name into a probability.

    python -m benchmarks.withheld.weights build/withheld

fits a logistic regression to the evidence that a run has noted for the best effect of every round
of the selection, given as a name or not, and prints its weights and, of each seed by those of the
others, how often names of each stated probability were right. `ivtools.gap.rules.WEIGHTS` holds
such weights. An effect that is left out of the library has no name that could be right: `outside`
is not asked.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .run import read

_RIDGE = 1.0  # of the standardised weights, against the count of names
_FOLDS = 6
_BINS = (0.0, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0)


def rows(folder: Path) -> list[dict[str, Any]]:
    """Return the evidence in the results of a run, with the seed of each."""
    found = (r for p in sorted(folder.glob("*.jsonl")) for r in read(p))
    return [
        {"seed": r["seed"], **name}
        for r in found
        if r["suite"] != "outside"
        for name in r.get("names", ())
    ]


def design(found: list[dict[str, Any]]) -> tuple[list[str], NDArray[np.float64]]:
    """Return names and values of the regressors, (n, p)."""
    from ivtools.gap.attribute import Evidence, features

    kinds = Evidence.__dataclass_fields__
    X = [features(Evidence(**{n: row[n] for n in kinds if n in row})) for row in found]
    return list(X[0]), np.array([[*x.values()] for x in X])


def fit(X: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return constant and slopes of a logistic regression with a small ridge, (1 + p,)."""
    from scipy.optimize import minimize

    mean, scale = X.mean(axis=0), np.maximum(X.std(axis=0), 1e-9)
    Z = (X - mean) / scale

    def loss(w: NDArray[np.float64]) -> float:
        z = Z @ w[1:] + w[0]
        return float(np.sum(np.logaddexp(0.0, z) - y * z) + 0.5 * _RIDGE * w[1:] @ w[1:])

    w = minimize(loss, np.zeros(X.shape[1] + 1)).x
    slopes = w[1:] / scale
    return np.array([w[0] - slopes @ mean, *slopes])


def crossed(
    X: NDArray[np.float64], y: NDArray[np.float64], seeds: NDArray[np.int_]
) -> NDArray[np.float64]:
    """Return the probability of each name by weights from other seeds, (n,)."""
    p = np.zeros(len(y))
    for k in range(_FOLDS):
        out = seeds % _FOLDS == k
        w = fit(X[~out], y[~out])
        p[out] = 1.0 / (1.0 + np.exp(-w[0] - X[out] @ w[1:]))
    return p


def main() -> None:
    """Read, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    found = rows(parser.parse_args().folder)
    names, X = design(found)
    y = np.array([r["right"] for r in found], dtype=float)
    print(len(found), "names,", int(y.sum()), "right")
    weights = fit(X, y).tolist()
    print({n: round(w, 2) for n, w in zip(["constant", *names], weights, strict=True)})
    p = crossed(X, y, np.array([r["seed"] for r in found]))
    for low, high in zip(_BINS[:-1], _BINS[1:], strict=True):
        inside = (p >= low) & (p < high if high < 1.0 else True)
        if inside.any():
            told = f"{inside.sum():5d} at {p[inside].mean():.2f}: right {y[inside].mean():.2f}"
            print(f"{low:.2f} to {high:.2f}: {told}")


if __name__ == "__main__":
    main()
