"""Hints: what a command that does not follow from the controller looks like."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import IVToolsError

if TYPE_CHECKING:
    from ..loop import ClosedLoop, Controller
    from ..record import Record

Array = NDArray[np.float64]

_NEAR = 0.2  # relative; how well a factor must match that of a unit
_FITS = 0.3  # error of the law, once scaled, that still is this law
_LAW = 5.0  # %; a law fitted to the record that leaves less is the right one
_SCALES = {
    "prismatic": {"mm": 1e3, "µm": 1e6, "cm": 100.0, "inches": 39.37},
    "revolute": {"degrees": 180.0 / np.pi, "turns": 0.5 / np.pi, "mrad": 1e3},
}


def scale(factor: float, joint: str, signal: str) -> str:
    """Say which unit a factor looks like: 0.001 of what should be is a signal in mm.

    Examples
    --------
    >>> scale(0.00101, "prismatic", "q")
    'as if q were in mm; give m'
    >>> scale(0.0175, "revolute", "q and q_ref")
    'as if q and q_ref were in degrees; give rad'
    >>> scale(1.7, "prismatic", "q")
    ''
    """
    unit = "m" if joint == "prismatic" else "rad"
    for name, times in _SCALES[joint].items():
        if abs(factor * times - 1.0) < _NEAR:
            return f"as if {signal} were in {name}; give {unit}"
    return ""


def command(record: Record, loop: ClosedLoop, delay: int, left: float) -> str:
    """Say how the recorded command differs from that of the control law.

    Parameters
    ----------
    record : Record
    loop : ClosedLoop
        Its controller does not reproduce the command.
    delay : int
        Samples from the position to the command.
    left : float
        Error of the law, relative.
    """
    factor, rest = _factor(record, loop, delay)
    found = law(shown(record, loop))
    if rest > _FITS:
        return (
            f"the control law reproduces the recorded command only to {100 * left:.0f} %; check "
            "kind, gains and velocity_filter in [controller], and that q, q_ref and nu belong "
            f"together{found}"
        )
    if factor < 0.0:
        text = "the recorded command has the opposite sign of what the controller gives"
        return f"{text}; check the sign of nu, or of q and q_ref"
    text = f"the recorded command is {factor:.3g} times what the controller gives for the recorded"
    guess = scale(factor, loop.joint, "q and q_ref") if factor < 1.0 else ""
    if abs(factor / 1000.0 - 1.0) < _NEAR:
        guess = "as if nu were in mV; give V"
    guess = f"{guess}, else " if guess else ""
    return (
        f"{text} position: {guess}check the units of q, q_ref and nu, and the gains in "
        f"[controller]{found}"
    )


def _factor(record: Record, loop: ClosedLoop, delay: int) -> tuple[float, float]:
    """Return the recorded command per command of the declared law, and what that leaves."""
    assert record.q_ref is not None
    dq_ref = record.dq_ref
    dq_ref = np.gradient(record.q_ref, record.dt, axis=0) if dq_ref is None else dq_ref
    given = loop.controller.law(record.dt)(record.q_ref[:, 0], dq_ref[:, 0], record.q[:, 0])
    nu = loop.command(record)[delay:, 0]
    columns = [given[: len(given) - delay], np.ones(len(nu))]
    if record.added is not None and record.added.any():
        columns.append(record.added[delay:, 0])
    X = np.column_stack(columns)
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    whole = max(float(np.linalg.norm(nu)), 1e-300)
    weights = np.linalg.lstsq(X / size, nu, rcond=None)[0] / size
    return float(weights[0]), float(np.linalg.norm(nu - X @ weights)) / whole


def shown(record: Record, loop: ClosedLoop) -> Controller | None:
    """Return the controller that the record shows; None if no law fits."""
    try:
        fit = loop.identify_controller(record)[1]
    except IVToolsError:
        return None
    return fit.controller if fit.residual <= _LAW else None


def law(found: Controller | None) -> str:
    """Say which law the record shows; nothing if none fits."""
    return "" if found is None else f" (the record shows {described(found)})"


def described(controller: Controller) -> str:
    """Return kind and gains as text."""
    gains = ", ".join(f"{k} = {v:.4g}" for k, v in controller.settings.items())
    return f"kind {controller.kind}, {gains}"
