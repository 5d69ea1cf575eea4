"""An experiment on a simulated axis, and how visible an effect is in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, signal

from .axes import DT, Axis
from .plant import INDEX, run

Effects = Mapping[str, Mapping[str, float]]

_HEAD = 300  # samples that still know the start
_ORDER = 20  # of the noise model
_BASE = {"m": 1.0, "fv": 4.0, "fc": 0.4, "off": 0.4}  # small changes of the base parameters, SI


@dataclass(frozen=True)
class Experiment:
    """What one record is made of, before scaling: (n_samples,) each.

    Parameters
    ----------
    ref : ndarray
        Position reference, m.
    added : ndarray
        Known input added to the command, V.
    force : ndarray
        Everything that acts from outside, noise included, N.
    noise : ndarray
        Of the encoder, m.
    """

    ref: np.ndarray
    added: np.ndarray
    force: np.ndarray
    noise: np.ndarray

    def silent(self) -> Experiment:
        """Return it without noise."""
        zero = np.zeros(len(self.ref))
        return replace(self, force=zero, noise=zero)


def play(
    axis: Axis,
    effects: Effects,
    experiment: Experiment,
    *,
    change: Mapping[str, float] | None = None,
    sub: int = 20,
) -> np.ndarray:
    """Run the plant; return measured position, m, command, V, and true position, m: (3, n).

    `change` adds to base parameters of the plant, and `sub` is the number of steps per sample.
    A silent experiment has no quantisation either.
    """
    p, changes = axis.vector(), [*(v for e in effects.values() for v in e.items())]
    settings = {"kp": axis.kp, "kv": axis.kv, "limit": axis.limit, "pulse": 1.0}
    taps = np.asarray(axis.taps, float)
    for key, value in changes:
        if key == "tap":
            taps = np.append((1.0 - value) * taps, value * taps.sum())
        elif key == "limit":
            settings["limit"] = value
        elif key in settings:
            settings[key] *= 1.0 + value
        else:
            p[INDEX[key]] = value
    for key, value in (change or {}).items():
        p[INDEX[key]] += value
    ref, noisy = experiment.ref, bool(experiment.noise.any())
    out = np.full((3, len(ref)), np.nan)
    run(
        DT,
        sub,
        ref,
        np.gradient(ref, DT),
        np.gradient(np.gradient(ref, DT), DT),
        settings["pulse"] * experiment.added,
        settings["kp"],
        settings["kv"],
        (axis.ki, axis.weight, axis.ahead),
        taps,
        axis.law,
        axis.delay,
        settings["limit"],
        axis.gain,
        p,
        experiment.force,
        experiment.noise,
        axis.noise.quantum if noisy else 0.0,
        ref[0],
        out,
    )
    return out


def signature(axis: Axis, effects: Effects, experiment: Experiment) -> float:
    """Return the whitened size of the effects over the floor, after the base absorbed its part.

    The floor is what the experiment's own force and noise do to the command of the axis without
    the effects; an autoregression of order 20 whitens it. The change of the command that the
    effects make without noise is projected off the changes that the four base parameters make.
    """
    silent = experiment.silent()
    return _signature(axis, experiment, play(axis, effects, silent)[1])


def visible(axis: Axis, experiment: Experiment, force: np.ndarray) -> float:
    """Return the same of a force from outside, N, (n,)."""
    silent = experiment.silent()
    return _signature(axis, experiment, play(axis, {}, replace(silent, force=force))[1])


def _signature(axis: Axis, experiment: Experiment, there: np.ndarray) -> float:
    if not np.isfinite(there).all():
        return float("nan")
    silent = experiment.silent()
    clean = play(axis, {}, silent)[1]
    noise = play(axis, {}, experiment)[1] - clean
    base = [play(axis, {}, silent, change={k: v})[1] - clean for k, v in _BASE.items()]
    white = signal.lfilter(
        _whitener(noise[_HEAD:]), [1.0], np.column_stack([*base, there - clean, noise]), axis=0
    )[_HEAD:]
    columns, change, floor = white[:, :4], white[:, 4], white[:, 5]
    left = change - columns @ np.linalg.lstsq(columns, change, rcond=None)[0]
    return float(np.std(left) / np.std(floor))


def _whitener(e: np.ndarray) -> np.ndarray:
    r = np.array([e[k:] @ e[: len(e) - k] for k in range(_ORDER + 1)])
    r[0] *= 1.0001
    return np.concatenate([[1.0], -linalg.solve_toeplitz(r[:-1], r[1:])])


def least(axis: Axis, effects: Effects, experiments: Iterable[Experiment]) -> float:
    """Return the smaller signature of the experiments."""
    return min(signature(axis, effects, x) for x in experiments)


def off_limit(axis: Axis, out: np.ndarray, added: np.ndarray) -> bool:
    """Whether the command before added inputs stays off the limit of the axis."""
    return bool(np.max(np.abs(out[1] - added)) < 0.97 * axis.limit)


def record(axis: Axis, experiment: Experiment, out: np.ndarray) -> dict[str, np.ndarray]:
    """Return what a logger would write: t, q, q_ref, nu and, if there is any, added; scaled.

    The command keeps its unit: the drive gain of the axis file carries mass and length.
    """
    table = {
        "t": np.arange(len(experiment.ref)) * DT,
        "q": out[0] * axis.length,
        "q_ref": experiment.ref * axis.length,
        "nu": out[1],
    }
    return {**table, "added": experiment.added} if experiment.added.any() else table
