"""Measured: from their owners' files to records in SI, one short reader per machine.

What a file holds that is not a signal of ours is kept by name in ``record.extra``: a control law
may have seen it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .clock import nice_rate
from .record import Record
from .record_format import RecordFormat

__all__ = ["READERS"]

Array = NDArray[np.float64]

#: Of a log whose stamps are when its samples were taken.
_STAMPS: dict[str, Any] = {"resample": True, "gaps": "longest"}


def laas_motor(name: str, part: str, file: Path) -> Record:
    """Return the half of a speed test without, or with, the compensation of the cogging.

    The flag in the file does not mean the same in all of them; in each the first half is the one
    whose current is the velocity's law alone. The loop was late now and then, and caught up: the
    signals are resampled. After a late stamp it is the next row's position that has moved on, so a
    row was read when the one before it was stamped.
    """
    table = pd.read_csv(file, skipinitialspace=True)
    table = table.assign(Time=table["Time"].shift()).iloc[1:]
    switch = int(np.flatnonzero(np.diff(table["Function Activated"]))[0]) + 1
    table = table[switch:] if part else table[:switch]
    columns = {"t": "Time", "q": "Position", "dq": "Velocity", "dq_ref": "Reference Velocity"}
    return _record(table, RecordFormat({**columns, "nu": "Iq"}, rate=1000.0, **_STAMPS), name)


def quanser_flexible_link(name: str, part: str, file: Path) -> Record:
    """Return joint 1 behind its gear, with the deflection of the link that it carries.

    The second half of the run was logged apart; the states as the controller saw them, velocities
    by its own filter, are those of the whole run.
    """
    from scipy.io import loadmat

    content = loadmat(file, simplify_cells=True)
    current, angle = content["data_Im1"], np.deg2rad(content["data_th11"])
    seen = content["stage1_X1_meas"]
    rows = np.searchsorted(seen["time"], current[:, 0] - 1e-6)
    states = seen["signals"]["values"][rows]
    table = {"t": current[:, 0], "q": angle[:, 2], "q_ref": angle[:, 1], "nu": current[:, 1]}
    table |= {"dq": states[:, 2], "deflection": states[:, 1], "deflection_rate": states[:, 3]}
    return _record({**table, "measured_current": current[:, 2]}, RecordFormat(rate=500.0), name)


def dfki_pendulum(name: str, part: str, file: Path, plan: Path) -> Record:
    """Return a swing-up, with the torque of its plan beside the reference.

    Both files have a row per pass of the controller. Energy shaping follows no reference.
    """
    measured, desired = pd.read_csv(file), pd.read_csv(plan)
    table = {"t": measured["time"], "q": measured["position"], "dq": measured["velocity"]}
    table |= {"tau": measured["torque"], "planned_torque": desired["torque"]}
    if np.ptp(desired["position"]) > 0.0:
        table |= {"q_ref": desired["position"], "dq_ref": desired["velocity"]}
    rate = nice_rate((len(measured) - 1) / measured["time"].iloc[-1])
    return _record(table, RecordFormat(rate=rate), name)


def dfki_double_pendulum(name: str, part: str, file: Path, plan: Path | None = None) -> Record:
    """Return the joints of the double pendulum, or one of them (1, shoulder; 2, elbow).

    The stamps are when the drives answered, up to half a step late: the reference is that of the
    stamps, and the signals are resampled.
    """
    log, rate = pd.read_csv(file), 500.0
    table: dict[str, Array] = {"t": log["time"].to_numpy()}
    path = pd.read_csv(plan) if plan is not None else None
    for j in (part,) if part else ("1", "2"):
        ours = "" if part else j
        for signal, column in {"q": "pos", "dq": "vel", "tau": "tau"}.items():
            table[f"{signal}{ours}"] = log[f"{column}{j}"].to_numpy()
        if path is not None:
            rate = 300.0
            for signal, column in {"q_ref": "pos", "dq_ref": "vel"}.items():
                table[f"{signal}{ours}"] = np.interp(
                    log["time"], path["time"], path[f"{column}{j}"]
                )
    return _record(table, RecordFormat(rate=rate, **_STAMPS), name)


def _record(table: Mapping[Any, Any] | pd.DataFrame, layout: RecordFormat, name: str) -> Record:
    """Return a record of columns, its time from 0."""
    columns = {str(k): np.asarray(x, dtype=float) for k, x in table.items()}
    t = layout.columns.get("t", "t")
    columns[t] = columns[t] - columns[t][0]
    return Record.from_dict(columns, layout, name=name)


#: From the name of a registered reader to the function (name, part, files...) that it means.
READERS: dict[str, Callable[..., Record]] = {
    "laas-motor": laas_motor,
    "quanser-flexible-link": quanser_flexible_link,
    "dfki-pendulum": dfki_pendulum,
    "dfki-double-pendulum": dfki_double_pendulum,
}
