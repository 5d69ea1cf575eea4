"""Whether a log suffices: what will be used, in which units, and what it can tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .columns import UNITS
from .display import Displayed
from .errors import IVToolsError
from .gap.parity import Parity, at_motion, check, doubted, known_oversampling, otherwise_derived
from .problem import Problem
from .tables import Text, table
from .units import JOINTS, quantity

if TYPE_CHECKING:
    from .loop import ClosedLoop
    from .record import Record

_SHORT, _POOR_R2, _STILL, _LINES = 5.0, 0.98, 0.01, 20
_CONDITION = 300.0
_PERIODS = 20  # of the loop's mode that a record should last


@dataclass(frozen=True, eq=False, repr=False)
class Suitability(Displayed):
    """What a log is like, before anything is estimated from it.

    Attributes
    ----------
    record : Record
    loop : ClosedLoop
    parity : Parity or None
    rows : tuple
        What was looked at, its value, and what it means.
    advice : tuple of str
        What to mend or to record instead.
    """

    figure: ClassVar[str] = "record.in_units"

    record: Record
    loop: ClosedLoop
    parity: Parity | None
    rows: tuple[tuple[str, str, str], ...]
    advice: tuple[str, ...]

    @property
    def sufficient(self) -> bool:
        """Whether nothing has to be mended."""
        return not self.advice

    def summary(self) -> Text:
        """Return at most 20 lines."""
        verdict = "it suffices" if self.sufficient else "see below"
        title = f"{self.record.name} on {self.loop.name}: {verdict}"
        notes = (*self.record.reading_notes, *self.advice)
        return table(title, [], ["", "value", ""], self.rows, notes, left=3)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of `ivtools check`."""
        rows = {name: {"value": value, "means": means} for name, value, means in self.rows}
        r2 = None if self.parity is None else 1.0 - self.parity.before**2
        return {"parity_r2": r2, "rows": rows, "advice": list(self.advice),
                "sufficient": self.sufficient}  # fmt: skip


def suitability(record: Record, loop: ClosedLoop) -> Suitability:
    """Look at a record before anything is estimated from it.

    Examples
    --------
    >>> import ivtools as iv
    >>> suitability(iv.datasets.twin(), iv.axes.emps()).sufficient
    True
    """
    advice: list[str] = []
    rows = [*_used(record, loop), *_motion(record, loop, advice)]
    parity = _law(record, loop, rows, advice)
    _excited(record, loop, rows, advice)
    return Suitability(record, loop, parity, tuple(rows), tuple(advice))


def _used(record: Record, loop: ClosedLoop) -> list[tuple[str, str, str]]:
    """Return signals with their units and ranges."""
    revolute = loop.joint == "revolute"
    seconds = quantity(record.n_samples * record.dt, "s", 3)
    rows = [("samples", f"{record.n_samples}", f"{record.sampling_hz:g} Hz, {seconds}")]
    for name, values in record.signals.items():
        unit = UNITS[name][revolute] if name in UNITS else "(command)"
        source = loop.log.columns.get(name, name)
        told = loop.log.units.get(name)
        how = f"column {source[:24]!r}" + (f", logged in {told}" if told else "")
        spans = f"{values.min():.3g} to {values.max():.3g} {unit}"
        rows.append((name, spans, how))
    return rows


def _motion(record: Record, loop: ClosedLoop, advice: list[str]) -> list[tuple[str, str, str]]:
    """Return encoder noise, standstill and reversals."""
    q, unit = record.q[:, 0], JOINTS[loop.joint][0]
    third = np.diff(q, 3)
    noise = float(np.median(np.abs(third))) / 0.6745 / np.sqrt(20.0)
    steps = np.abs(np.diff(q))
    step = float(steps[steps > 0].min()) if (steps > 0).any() else 0.0
    speed = np.abs(np.gradient(np.convolve(q, np.ones(5) / 5, "same")[5:-5]))
    moving = float(np.mean(speed > _STILL * np.quantile(speed, 0.99)))
    if moving < 0.2:
        advice.append(f"the axis moves in {100 * moving:.0f} % of the record only; log more motion")
    stroke = float(np.ptp(q))
    if noise > 0.01 * stroke:
        advice.append("the position's noise is above 1 % of the stroke; check its column and unit")
    return [
        ("noise", quantity(noise, unit, 2), f"smallest step {quantity(step, unit, 2)}"),
        ("in motion", f"{100 * moving:.0f} %", "of the samples"),
    ]


def _law(
    record: Record, loop: ClosedLoop, rows: list[tuple[str, str, str]], advice: list[str]
) -> Parity | None:
    """Compare the recorded command with the control law."""
    if loop.controller.kind == "none":
        rows.append(("control law", "none", "the command is taken as it is"))
        return None
    try:
        shown = record.longest.liveliest()
        known, rate = loop.known(record), known_oversampling(loop)
        parity = _parity(shown, known, rate)
        again = otherwise_derived(
            shown, known, [parity], lambda other: [_parity(shown, other, rate)]
        )
    except IVToolsError as error:
        advice.append(f"the control law cannot be compared: {error}")
        return None
    if again:
        (parity,) = again
        way = parity.declared.reference_derivative
        rows.append(("derived", way, f'is the reference: reference_derivative = "{way}"'))
    r2 = 1.0 - parity.before**2
    kind = parity.declared.kind
    where = _where(shown, record.longest)
    if parity.below is not None:
        where += f", below {parity.below:.2g} Hz: above it is noise that only one of them has"
    rows.append(("parity R2", f"{r2:.4f}", f"of the law in the axis file ({kind}){where}"))
    if parity.oversampling > 1:
        rows.append(("its rate", f"{parity.oversampling} times", "that of the log"))
    own = known.controller.filter
    if parity.oversampling == 1 and own is not None and not own.fits(record.dt):
        rows.append(("filter", f"{own.hz:g} Hz", "beyond the log's rate: compared without it"))
    if parity.after < parity.before - 1e-3:
        rows.append(("", f"{1.0 - parity.after**2:.4f}", "as the record has it"))
    rows.append(("at limit", f"{100 * parity.clipped:.1f} %", "of the samples"))
    if r2 < _POOR_R2:
        found = ", ".join(f"{k} {v:+.3g}" for k, v in parity.found.items())
        told = f"the record shows: {found}" if found else "check units, kind and gains"
        advice.append(f"the law explains {100 * r2:.1f} % of the command's power; {told}")
    if parity.clipped > 0.3:
        advice.append("the command is at its limit for long; log slower motions")
    return parity


def _parity(record: Record, loop: ClosedLoop, rate: int) -> Parity:
    """Return how a law compares; with the record's own where that is another one."""
    found = at_motion(record, loop, check(record, loop, False, rate), rate)
    return check(record, loop, oversampling=rate) if doubted(record, found) else found


def _where(shown: Record, record: Record) -> str:
    """Return which part of a record a row is of, unless it is of all."""
    return "" if shown is record else f", where it moves most, {shown.n_samples} samples"


def _excited(
    record: Record, loop: ClosedLoop, rows: list[tuple[str, str, str]], advice: list[str]
) -> None:
    """Say how well the parameters can be told apart, and whether the record is long enough."""
    try:
        shown = record.liveliest()
        problem = Problem(shown, loop)
        X = problem.X / np.linalg.norm(problem.X, axis=0)
        condition = float(np.linalg.cond(X))
    except (IVToolsError, np.linalg.LinAlgError) as error:
        advice.append(f"no rows for a regression: {error}")
        return
    cutoff = problem.pipeline.cutoff_hz
    filtered = f"low-pass at {cutoff:g} Hz" if cutoff else "no low-pass"
    every = f"every {problem.pipeline.decimation}{_where(shown, record)}"
    rows.append(("rows", f"{len(problem.y)}", f"{filtered}, {every}"))
    rows.append(("condition", f"{condition:.3g}", f"of {', '.join(problem.names)}"))
    if not condition < _CONDITION:
        advice.append(
            "the motion does not tell the parameters apart: log slow and fast moves both ways"
        )
    lasts = record.n_samples * record.dt
    natural = (cutoff or 0.0) / 5.0
    if lasts * natural < _PERIODS or lasts < 1.0:
        enough = np.ceil(max(_PERIODS / natural, _SHORT)) if natural else _SHORT
        advice.append(
            f"{lasts:.3g} s are few for a loop of {natural:.3g} Hz; log {enough:g} s or more"
        )
