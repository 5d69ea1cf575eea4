"""The [record] table of an axis file: what a log does not have in SI and under our names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import isfinite
from typing import Any

from ivtools.columns import SIGNALS, UNITS
from ivtools.errors import RecordError
from ivtools.units import parse

__all__ = ["GAPS", "ROWS", "RecordFormat"]

#: What to do where samples are missing.
GAPS = ("refuse", "longest", "all")
#: What to do with rows that are no samples.
ROWS = ("refuse", "usable")
_FASTEST, _SLOWEST = 1e9, 1e-3  # Hz


@dataclass(frozen=True)
class RecordFormat:
    """How the columns of a file become the signals of a record.

    Parameters
    ----------
    columns : mapping of str to str
        Names in the file, ours = theirs: ``{"q": "Pos [mm]"}``.
    units : mapping of str to str
        Units in the file, ``{"q": "mm", "t": "ms"}``; what is not here is in SI.
    rated : mapping of str to float
        What 100 % of a signal is, in SI or in the unit of the command.
    counts_per_unit : mapping of str to float
        Counts per metre or radian (per second in ``t``). A position's holds for its reference and
        its velocities too.
    torque_constant : float, optional
        N or N m per ampere, for a force that is logged as a current.
    rate : float, optional
        Nominal sampling rate, Hz. Stamps that jitter around it are replaced.
    resample : bool
        Take the stamps as they are, and resample the signals to `rate`.
    gaps : str
        ``"refuse"`` a record with missing samples, use its ``"longest"`` stretch, or ``"all"`` that
        are long enough, as one record with breaks.
    rows : str
        ``"refuse"`` rows that are no samples, or take the ``"usable"`` ones: without those that are
        said twice, that hold a cell that is no number, or that are all zeros at the end.
    unwrap : bool
        Whether the position is an angle that jumps by a turn, to be made continuous.

    Raises
    ------
    RecordError
        A key, unit or number that cannot be used.

    Examples
    --------
    >>> RecordFormat(units={"q": "mm"}).factor("q")
    0.001
    >>> RecordFormat(units={"nu": "%"}, rated={"nu": 3.2}).factor("nu")
    0.032
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    rated: Mapping[str, float] = field(default_factory=dict)
    counts_per_unit: Mapping[str, float] = field(default_factory=dict)
    torque_constant: float | None = None
    rate: float | None = None
    resample: bool = False
    gaps: str = "refuse"
    rows: str = "refuse"
    unwrap: bool = False

    def __post_init__(self) -> None:
        for table in ("units", "rated", "counts_per_unit"):
            for key in getattr(self, table):
                if signal_of(key) not in ("t", *SIGNALS):
                    known = f"known: t, {', '.join(SIGNALS)}"
                    raise RecordError(f"[record.{table}] {key!r} is not a signal; {known}")
        for table in ("rated", "counts_per_unit"):
            for key, value in getattr(self, table).items():
                _positive(f"{table} = {{ {key} = {value!r} }}", value)
        if self.torque_constant is not None:
            _positive(f"torque_constant = {self.torque_constant!r}", self.torque_constant)
        if self.rate is not None and not _SLOWEST <= _positive("rate", self.rate) <= _FASTEST:
            raise RecordError(f"[record] rate = {self.rate:g}; it is in Hz, 0.001 to 1e9")
        if self.resample and self.rate is None:
            raise RecordError("[record] resample = true needs the rate to resample to: rate = 1000")
        if self.gaps not in GAPS:
            known = " or ".join(f'"{g}"' for g in GAPS)
            raise RecordError(f"[record] gaps = {self.gaps!r}; it is {known}")
        if self.rows not in ROWS:
            known = " or ".join(f'"{r}"' for r in ROWS)
            raise RecordError(f"[record] rows = {self.rows!r}; it is {known}")
        for key in self.units:
            self.factor(key)

    @property
    def plain(self) -> bool:
        """Whether it changes nothing but names."""
        return not self.units and self.rate is None and self.gaps == "refuse" and self.tidy

    @property
    def tidy(self) -> bool:
        """Whether it takes every row as a sample and every angle as it is."""
        return self.rows == "refuse" and not self.unwrap

    @property
    def notes(self) -> tuple[str, ...]:
        """What was converted, in one line."""
        units = ", ".join(f"{key} from {unit}" for key, unit in self.units.items())
        return (f"converted to SI: {units}",) if units else ()

    def factor(self, column: str) -> float:
        """Return what to multiply a column of ours (``q``, ``q2``) by to have it in SI."""
        text = self.units.get(column, self.units.get(signal_of(column)))
        return 1.0 if text is None else self._factor(column, text)

    def _factor(self, column: str, text: str) -> float:
        signal, unit = signal_of(column), parse(text)
        if unit.si == "%":
            return unit.factor * self._scale("rated", column, text, "what 100 % is, in SI")
        if unit.si.split("/")[0] == "counts":
            return unit.factor / self._scale(
                "counts_per_unit", column, text, "counts per m, rad or s"
            )
        if unit.si == "A" and signal in ("tau", "load"):
            if self.torque_constant is None:
                raise RecordError(
                    f"{column} is in {text}; write [record] torque_constant = 0.12, N m (or N) per "
                    f"ampere, or call the column nu and give the constant as [drive] gain"
                )
            return unit.factor * self.torque_constant
        kinds = UNITS.get(signal)
        if kinds is not None and unit.si not in kinds:
            raise RecordError(
                f'[record] units = {{ {column} = "{text}" }}: {column} is measured in '
                f"{' or '.join(kinds)}, in one of the same kind, in counts or in %"
            )
        return unit.factor

    def _scale(self, table: str, column: str, text: str, what: str) -> float:
        """Return a number of a table: of the column, its signal, or of the position."""
        values: Mapping[str, float] = getattr(self, table)
        signal = signal_of(column)
        akin = {"q_ref": "q", "dq": "q", "dq_ref": "q", "added": "nu"}.get(signal, signal)
        for key in (column, signal, akin):
            if key in values:
                return values[key]
        raise RecordError(
            f"{column} is in {text}; write [record] {table} = {{ {column} = ... }}: {what}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return what is not as it is by default, as in an axis file.

        Examples
        --------
        >>> RecordFormat(columns={"q": "x"}, rate=500.0).to_dict()
        {'columns': {'q': 'x'}, 'rate': 500.0}
        """
        default, told = RecordFormat(), {}
        for f in fields(self):
            value = getattr(self, f.name)
            if value != getattr(default, f.name):
                told[f.name] = dict(value) if isinstance(value, Mapping) else value
        return told


def signal_of(column: str) -> str:
    """Return the signal of a numbered column: q2 is a q."""
    return column.rstrip("0123456789")


def as_format(columns: Mapping[str, str] | RecordFormat | None) -> RecordFormat:
    """Return a format; a mapping holds the names of columns."""
    return columns if isinstance(columns, RecordFormat) else RecordFormat(dict(columns or {}))


def _positive(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RecordError(f"[record] {what}: give a number")
    try:
        number = float(value)
    except OverflowError:
        number = float("inf")
    if not (isfinite(number) and number > 0.0):
        raise RecordError(f"[record] {what}: give a positive number")
    return number
