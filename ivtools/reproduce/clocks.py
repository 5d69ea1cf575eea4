"""Why the published simulation differs from an exact one: three quirks, each switchable.

1. Its sample time is ``tec = t(10) - t(9)``, which in the files is 0.999984 ms, not 1 ms: the
   simulated clock, and the reference read at it, drift by 0.4 ms over the record.
2. The pulses are interpolated between samples: each ramps up in the millisecond before it.
3. sign(dq) is taken as it comes, without a rule of standstill: it chatters where the axis rests.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ivtools.loop import ClosedLoop, Simulation
from ivtools.record import Record


@dataclass(frozen=True)
class Clock:
    """A way to simulate the record.

    Attributes
    ----------
    name, title : str
        What it is called in tables.
    published : bool
        Whether the sample time is the published one.
    options : mapping
        For `ClosedLoop.simulate`.
    """

    name: str
    title: str
    published: bool
    options: Mapping[str, Any]

    def simulate(self, loop: ClosedLoop, record: Record, theta: Mapping[str, float]) -> Simulation:
        """Simulate the closed loop on the record's reference."""
        driven = on_published_clock(record) if self.published else record
        return loop.simulate(driven, theta, **self.options)

    def relative_error(
        self, loop: ClosedLoop, record: Record, theta: Mapping[str, float]
    ) -> dict[str, float]:
        """Return the relative errors of the simulated signals, in %."""
        return self.simulate(loop, record, theta).relative_error(record)


def on_published_clock(record: Record) -> Record:
    """Return the record with the sample time of the published simulation, t(10) - t(9).

    Examples
    --------
    >>> import numpy as np
    >>> from ivtools.record import Record
    >>> t = np.arange(300) * 1e-3
    >>> on_published_clock(Record(t, q=np.sin(t), q_ref=np.sin(t), nu=np.cos(t))).n_samples
    300
    """
    clock = np.arange(record.n_samples) * (record.t[9] - record.t[8])
    changes = {
        name: np.interp(clock, record.t, signal[:, 0])
        for name, signal in (("q_ref", record.q_ref), ("added", record.added))
        if signal is not None
    }
    return record.replace(t=clock, **changes)


_PLAIN = {"initial": (0.0, 0.0), "substeps": 10, "stiction": False}

CLOCKS = (
    Clock("published", "published", True, {**_PLAIN, "ramp": True}),
    Clock("true", "true clock", False, _PLAIN),
    Clock("exact", "standstill", False, {"initial": (0.0, 0.0)}),
)
