"""Locate: where in a record the gap sits, and which block of the loop it points to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..physics import TERMS
from ..record import Record
from .fold import near
from .rules import BANDS, LITTLE, NEARBY

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Region:
    """A part of the record.

    Parameters
    ----------
    name : str
    energy, time : float
        Its share of the energy of the force error, and of the time; of a band of frequencies, of
        the width of the spectrum.
    after : float
        The energy that the named effects leave there, as a share of the whole energy before.
    """

    name: str
    energy: float
    time: float
    after: float

    def to_dict(self) -> dict[str, object]:
        """Return the JSON of the region."""
        return {"region": self.name, "energy": self.energy, "time": self.time, "after": self.after}


def regions(record: Record, keep: Mask, before: Array, after: Array) -> tuple[Region, ...]:
    """Split the energy of the force error by what the axis was doing.

    Parameters
    ----------
    record : Record
    keep : ndarray of bool, (n_samples,)
    before, after : ndarray, (n_samples,)
        Force errors without and with the named effects, N or N m.
    """
    total = float(np.sum(before[keep] ** 2))
    found = []
    for name, mask in _masks(record).items():
        part = mask & keep
        energy = [float(np.sum(e[part] ** 2)) / max(total, 1e-300) for e in (before, after)]
        found.append(Region(name, energy[0], float(part.sum() / max(keep.sum(), 1)), energy[1]))
    return (*found, *_bands(record, keep, before, after))


def _masks(record: Record) -> dict[str, Mask]:
    assert record.q_ref is not None
    q, dt = record.q_ref[:, 0], record.dt
    dq = np.gradient(q, dt)
    ddq = np.gradient(dq, dt)
    width = max(round(NEARBY / dt), 1)
    sign = np.sign(dq)
    reversal = near(np.diff(sign, prepend=sign[0]) != 0, width)
    accelerating = (np.abs(ddq) > LITTLE * np.max(np.abs(ddq))) & ~reversal
    masks = {
        "reversal": reversal,
        "acceleration": accelerating,
        "constant speed": ~reversal & ~accelerating,
        "forward": dq > 0.0,
        "backward": dq < 0.0,
    }
    top, low, span = np.max(np.abs(dq)), q.min(), np.ptp(q)
    for i, name in enumerate(("low", "middle", "high")):
        masks[f"{name} speed"] = (np.abs(dq) > i * top / 3) & (np.abs(dq) <= (i + 1) * top / 3)
    for i, name in enumerate(("first", "second", "third")):
        masks[f"{name} third of the stroke"] = (q >= low + i * span / 3) & (
            q <= low + (i + 1) * span / 3
        )
    if record.added is not None and record.added.any():
        edge = np.abs(np.diff(record.added[:, 0], prepend=record.added[0, 0])) > 0.0
        if edge.mean() < LITTLE:
            masks["pulse edges"] = near(edge, width)
    t = np.arange(len(q)) / len(q)
    for i in range(4):
        masks[f"quarter {i + 1} of the time"] = (t >= i / 4) & (t < (i + 1) / 4)
    return masks


def _bands(record: Record, keep: Mask, before: Array, after: Array) -> list[Region]:
    hz = np.fft.rfftfreq(len(before), record.dt)
    power = [np.abs(np.fft.rfft(np.where(keep, e, 0.0))) ** 2 for e in (before, after)]
    total = float(power[0].sum())
    found = []
    for low, high in zip(BANDS[:-1], BANDS[1:], strict=True):
        band = (hz >= low) & (hz < high)
        name = f"{low:g} to {high:g} Hz" if np.isfinite(high) else f"above {low:g} Hz"
        shares = [float(p[band].sum()) / max(total, 1e-300) for p in power]
        found.append(Region(name, shares[0], float(band.mean()), shares[1]))
    return found


def block(
    effects: tuple[str, ...], controller: bool, events: bool, gap: bool, outside: bool = False
) -> str | None:
    """Return the block of the loop that the answer points to; None if there is no gap."""
    known = [TERMS[e].block for e in effects if e in TERMS]
    if known:
        return known[0]
    if effects:
        return "mechanics"
    if controller:
        return "controller"
    if events or outside:
        return "outside"
    return "mechanics" if gap else None
