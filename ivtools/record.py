"""A record: what was logged on an axis, one row per sample, validated and in SI units."""

from __future__ import annotations

import copy
import dataclasses
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools import checks
from ivtools.clock import regular
from ivtools.columns import SIGNALS, column_name, match_columns, pick_further, stack
from ivtools.errors import IVToolsError, RecordError, RecordWarning, ShapeError, shown
from ivtools.record_format import RecordFormat, as_format
from ivtools.untidy import continuous, usable

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

__all__ = ["SIGNALS", "Record"]

LIVELY = 500_000  # samples of motion that tell a law, or a first guess, as well as more of them


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """What was logged on an axis: read-only, validated, SI.

    One-dimensional signals become a single column. A record that breaks a rule is refused:
    nothing is repaired, resampled or filled in.

    Parameters
    ----------
    t : array_like, shape (n,)
        Time, s. It increases at a constant rate; jitter below 1 % of the step is accepted.
    q : array_like, shape (n,) or (n, n_joints)
        Measured position, m or rad.
    q_ref : array_like, optional
        Position reference, as q.
    nu : array_like, optional
        Command as sent to the drive, added inputs included, V (or A, N, N m).
    tau : array_like, optional
        Force or torque, N or N m. One of nu and tau is needed.
    added : array_like, optional
        Known input added to the command after the controller, as nu.
    dq : array_like, optional
        Measured velocity as the controller saw it, m/s or rad/s.
    dq_ref : array_like, optional
        Velocity reference, m/s or rad/s.
    load : array_like, optional
        Known force from outside on the mechanics, not through the drive, N or N m.
    name : str
        Name used in tables and figures.
    theta_true : mapping of str to float, optional
        True parameters, for a simulated record.
    notes : tuple of str
        What a reader should know: how the file was read, jitter, suspicions.
    extra : mapping of str to array_like, shape (n,), optional
        Further logged columns by name, in the file's own units: what a control law may also have
        seen (a strain, a load's encoder, a feed-forward).
    breaks : tuple of int
        Samples before which others are missing: there a stretch ends and another begins. No filter
        or difference crosses a break, and a simulation starts anew behind it.

    Raises
    ------
    RecordError
        NaN, infinity, time that goes back, jitter above 1 %, fewer than 200 samples, a signal
        that is constant, or a needed signal that is missing.
    ShapeError
        Signals of different lengths or numbers of joints.

    Warns
    -----
    RecordWarning
        A sampling rate or speed that suggests a wrong unit.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(1000) * 1e-3
    >>> record = Record(t, q=np.sin(t), nu=np.cos(t), name="sine")
    >>> record
    Record 'sine': 1000 samples at 1000 Hz, 1 joint, signals q, nu
    >>> record.q.shape, record.dt
    ((1000, 1), 0.001)
    """

    t: NDArray[np.float64]
    q: NDArray[np.float64]
    q_ref: NDArray[np.float64] | None = None
    nu: NDArray[np.float64] | None = None
    tau: NDArray[np.float64] | None = None
    added: NDArray[np.float64] | None = None
    dq: NDArray[np.float64] | None = None
    dq_ref: NDArray[np.float64] | None = None
    load: NDArray[np.float64] | None = None
    name: str = "record"
    theta_true: Mapping[str, float] | None = None
    notes: tuple[str, ...] = ()
    extra: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    breaks: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        t = _frozen_array("t", self.t)
        if not t.shape[1]:
            raise RecordError(f"t is empty, {t.shape}; give the time of each sample")
        _set(self, "t", t[:, 0])
        if t.shape[1] != 1:
            raise ShapeError(f"t has {t.shape[1]} columns; give one time axis for all joints")
        if self.q is None:
            raise RecordError("q is missing; a record needs t, q and one of nu and tau")
        for signal in SIGNALS:
            if getattr(self, signal) is not None:
                _set(self, signal, _frozen_array(signal, getattr(self, signal)))
        _set(self, "breaks", tuple(int(row) for row in self.breaks))
        columns = {str(k): _frozen_array(k, v) for k, v in self.extra.items()}
        further = {k: a[:, 0] for k, a in columns.items() if a.shape[1]}
        _set(self, "extra", further)
        if self.theta_true is not None:
            _set(self, "theta_true", {k: float(v) for k, v in self.theta_true.items()})
        checks.check(self)
        found, doubts = checks.findings(self), checks.doubts(self)
        _set(self, "notes", tuple(dict.fromkeys((*self.notes, *found, *doubts))))
        for doubt in doubts:
            warnings.warn(f"{self.name}: {doubt}", RecordWarning, stacklevel=3)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled or copied record: its arrays are read-only again."""
        self.__dict__.update(state)
        for array in (*state.values(), *state["extra"].values()):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False

    # -- what it is -----------------------------------------------------------------------------
    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return len(self.t)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @cached_property
    def dt(self) -> float:
        """Mean sampling step, s; a rate within 1e-9 of a whole number of hertz is that number."""
        lasts = float(self.t[-1] - self.t[0]) - sum(
            float(self.t[k] - self.t[k - 1]) for k in self.breaks
        )
        step = lasts / (self.n_samples - 1 - len(self.breaks))
        rate = round(min(1 / step, 1e12))
        return 1 / rate if rate and abs(rate * step - 1) < 1e-9 else float(f"{step:.9e}")

    @property
    def sampling_hz(self) -> float:
        """Sampling rate, Hz."""
        rate = 1 / self.dt
        return float(round(rate)) if abs(rate - round(rate)) < 1e-9 * rate else rate

    @cached_property
    def jitter(self) -> float:
        """Largest departure of a step from the mean step, as a fraction of the mean step."""
        return float(np.max(np.abs(self.steps - self.dt)) / self.dt)

    @property
    def steps(self) -> NDArray[np.float64]:
        """Steps of t, s, without those at breaks."""
        steps = np.diff(self.t)
        return np.delete(steps, np.array(self.breaks) - 1) if self.breaks else steps

    @property
    def stretches(self) -> tuple[slice, ...]:
        """The samples of each stretch without a break."""
        edges = (0, *self.breaks, self.n_samples)
        return tuple(slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True))

    @cached_property
    def parts(self) -> tuple[Record, ...]:
        """The stretches as records; the record itself if it has no break."""
        return (
            tuple(self.slice(s.start, s.stop) for s in self.stretches) if self.breaks else (self,)
        )

    @property
    def longest(self) -> Record:
        """The longest stretch."""
        return max(self.parts, key=lambda part: part.n_samples)

    def liveliest(self, n: int = LIVELY) -> Record:
        """Return the n samples in which the position changes most; a shorter record as it is.

        At least 600; a few less than n, where a stretch would be cut short.
        """
        n = max(n, 3 * checks.MIN_SAMPLES)
        if n >= self.n_samples:
            return self
        moved = np.sum(np.diff(self.q, axis=0, prepend=self.q[:1]) ** 2, axis=1)
        total = np.concatenate([[0.0], np.cumsum(moved)])
        first = int(np.argmax(total[n:] - total[:-n]))
        last = first + n
        start = next((k for k in self.breaks if first < k < first + checks.MIN_SAMPLES), first)
        stop = next((k for k in self.breaks if last - checks.MIN_SAMPLES < k < last), last)
        return self.slice(start, stop)

    @property
    def signals(self) -> dict[str, NDArray[np.float64]]:
        """The signals that were logged: name to array of shape (n, n_joints)."""
        return {name: x for name in SIGNALS if (x := getattr(self, name)) is not None}

    # -- where it comes from and goes to ----------------------------------------------------------
    @classmethod
    def read(
        cls,
        path: str | Path,
        columns: Mapping[str, str] | RecordFormat | None = None,
        *,
        trusted: bool = False,
    ) -> Record:
        """Read a csv, csv.gz, parquet or MATLAB file.

        Parameters
        ----------
        path : str or Path
            File with one row per sample; the columns of the EMPS files are recognised.
        columns : mapping of str to str, or RecordFormat, optional
            Names in the file that differ from ours: ``{"q": "position", "nu": "u"}``; a format
            says units, rate and gaps as well, as that of an axis file, `ClosedLoop.log`, does.
        trusted : bool
            Whether the file is known to be sound: a MATLAB file that is not is read in a process
            of its own, as a damaged one may end that.

        Returns
        -------
        Record
            Named after the file.

        Raises
        ------
        DataError
            The file is missing, damaged or of unknown type.
        RecordError, ShapeError
            Its content breaks a rule of `Record`.
        """
        from ivtools.readers import read_table

        path = Path(path)
        try:
            table, notes = read_table(path, as_format(columns), trusted)
            name = shown(path.name.split(".")[0], 100)
            return cls.from_dict(table, columns, name=name, notes=notes)
        except IVToolsError as error:
            raise type(error)(f"{path}: {error}") from error

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        columns: Mapping[str, str] | RecordFormat | None = None,
        name: str = "record",
    ) -> Record:
        """Make a record of a DataFrame with one row per sample; ``columns`` as for `read`."""
        from ivtools.readers import frame_table

        return cls.from_dict(frame_table(frame, as_format(columns)), columns, name=name)

    @classmethod
    def from_dict(
        cls,
        table: Mapping[str, ArrayLike],
        columns: Mapping[str, str] | RecordFormat | None = None,
        name: str = "record",
        notes: tuple[str, ...] = (),
    ) -> Record:
        """Make a record of arrays by name; ``columns`` as for `read`.

        Examples
        --------
        >>> import numpy as np
        >>> t = np.arange(300) * 1e-3
        >>> Record.from_dict({"t": t, "x": np.sin(t), "nu": np.cos(t)}, columns={"q": "x"}).n_joints
        1
        """
        layout, columns_ = as_format(columns), {str(k): x for k, x in table.items()}
        found = match_columns(columns_, layout.columns, layout.units, timed=layout.rate is None)
        if layout.rows == "usable":
            columns_, told = _samples(columns_, found)
            notes = (*notes, *told)
        signals: dict[str, Any] = _in_si(columns_, found, layout)
        further = pick_further(columns_, found, len(np.ravel(signals.get("t", signals["q"]))))
        if not layout.plain:
            signals, further, breaks, done = _on_a_clock(signals, further, layout)
            notes = (*notes, *layout.notes, *done)
            return cls(**signals, name=name, notes=notes, extra=further, breaks=breaks)
        return cls(**signals, name=name, notes=notes, extra=further)

    @property
    def of_itself(self) -> tuple[str, ...]:
        """Of the notes those on what the samples show."""
        own = {*checks.findings(self), *checks.doubts(self)}
        return tuple(note for note in self.notes if note in own)

    @property
    def reading_notes(self) -> tuple[str, ...]:
        """Of the notes those on what was done to the samples when they were read."""
        own = {*self.of_itself} if self.notes else ()
        return tuple(note for note in self.notes if note not in own)

    def to_frame(self) -> pd.DataFrame:
        """Return a DataFrame with the columns of a record file."""
        import pandas as pd

        table = {"t": self.t}
        for signal, values in self.signals.items():
            for joint, column in enumerate(values.T):
                table[column_name(signal, joint, self.n_joints)] = column
        return pd.DataFrame({**table, **self.extra})

    def replace(self, **changes: Any) -> Record:
        """Return a validated record with some fields changed, for instance ``nu`` or ``name``."""
        changes.setdefault("notes", self.reading_notes)
        return dataclasses.replace(self, **changes)

    def told(self, q: NDArray[np.float64]) -> Record:
        """Return the record with the position, (n_samples, n_joints), that a model tells.

        It is not checked: what the record itself may be doubted for has been said.
        """
        other = copy.copy(self)
        other.__dict__.pop("parts", None)  # they hold the measured one
        _set(other, "q", q)
        return other

    def slice(self, start: int | None = None, stop: int | None = None) -> Record:
        """Return the samples from ``start`` to before ``stop``; time is kept as it was."""
        rows = slice(start, stop)
        parts = {name: values[rows] for name, values in self.signals.items()}
        further = {name: values[rows] for name, values in self.extra.items()}
        first, last, _ = rows.indices(self.n_samples)
        breaks = tuple(k - first for k in self.breaks if first < k < last)
        return self.replace(t=self.t[rows], extra=further, breaks=breaks, **parts)

    def joint(self, j: int) -> Record:
        """Return the record of one joint, counted from 0.

        Raises
        ------
        ShapeError
            If there is no such joint.
        """
        if not 0 <= j < self.n_joints:
            raise ShapeError(f"joint {j} of a record with {self.n_joints} joints; count from 0")
        part = object.__new__(Record)  # what is part of a record needs no check, and may rest
        for item in dataclasses.fields(self):
            _set(part, item.name, getattr(self, item.name))
        for signal, values in self.signals.items():
            _set(part, signal, values[:, j : j + 1])
        _set(part, "name", self.name if self.n_joints == 1 else f"{self.name}, joint {j + 1}")
        _set(part, "theta_true", None)
        _set(part, "notes", self.reading_notes)  # what samples show may be another joint's
        return part

    def plot(self, joint: int = 0, **options: Any) -> Figure:
        """Return the figure of what was logged of a joint, counted from 0."""
        from ivtools.plots.record import record

        return record(self, joint, **options)

    def __repr__(self) -> str:
        joints = f"{self.n_joints} joint{'s' if self.n_joints > 1 else ''}, "
        joints += f"{len(self.breaks) + 1} stretches, " if self.breaks else ""
        return (
            f"Record {self.name!r}: {self.n_samples} samples at {self.sampling_hz:g} Hz, {joints}"
            f"signals {', '.join([*self.signals, *self.extra])}"
        )

    def _repr_html_(self) -> str:
        from html import escape

        table = self.to_frame().describe().loc[["min", "max", "mean", "std"]].T
        notes = "".join(f"<br>{escape(note)}" for note in self.notes)
        return f"<p>{escape(repr(self))}{notes}</p>{table.to_html(float_format='{:.6g}'.format)}"


def _in_si(
    table: Mapping[str, ArrayLike], found: Mapping[str, list[str]], layout: RecordFormat
) -> dict[str, ArrayLike]:
    """Return the signals of a table by our names, joints side by side, in SI."""
    signals: dict[str, ArrayLike] = {}
    for signal, names in found.items():
        values = stack(table, names)
        keys = [column_name(signal, joint, len(names)) for joint in range(len(names))]
        factors = np.array([layout.factor(key) for key in keys])
        changed = bool((factors != 1.0).any())
        signals[signal] = _frozen_array(signal, values) * factors if changed else values
    if layout.unwrap:
        q, q_ref = (_frozen_array(n, signals[n]) if n in signals else None for n in ("q", "q_ref"))
        assert q is not None  # no record without a position
        q, q_ref = continuous(q, q_ref)
        signals |= {"q": q} if q_ref is None else {"q": q, "q_ref": q_ref}
    return signals


def _samples(
    table: dict[str, ArrayLike], found: Mapping[str, list[str]]
) -> tuple[dict[str, ArrayLike], tuple[str, ...]]:
    """Return the rows of a table that are samples, and what was left out."""
    own = {name: np.asarray(table[name]) for names in found.values() for name in names}
    if len({x.shape for x in own.values()}) > 1:  # which the record itself says better
        return table, ()
    keep, told = usable(own, found["t"][0] if "t" in found else None)
    if keep.all():
        return table, ()
    kept = {k: np.asarray(x)[keep] if np.shape(x) == keep.shape else x for k, x in table.items()}
    return kept, (f"left out: {', '.join(told)}",)


def _on_a_clock(
    signals: Mapping[str, Any], further: Mapping[str, Any], layout: RecordFormat
) -> tuple[dict[str, Any], dict[str, Any], tuple[int, ...], tuple[str, ...]]:
    """Return signals and further columns on the steady clock that the format asks for."""
    arrays = {key: _frozen_array(key, values) for key, values in signals.items()}
    if len({len(x) for x in arrays.values()}) > 1:  # which the record itself says better
        return dict(signals), dict(further), (), ()
    stamps = arrays.pop("t", None)
    t, moved, breaks, done = regular(
        None if stamps is None else stamps[:, 0],
        {**{(key, ""): x for key, x in arrays.items()}, **{("", k): x for k, x in further.items()}},
        layout.rate,
        layout.resample,
        layout.gaps,
    )
    own = {key: x for (key, other), x in moved.items() if not other}
    return {"t": t, **own}, {k: x for (_, k), x in moved.items() if k}, breaks, done


def _set(record: Record, name: str, value: object) -> None:
    object.__setattr__(record, name, value)


def _frozen_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return a read-only float64 array of shape (n, columns); masked values become NaN."""
    try:
        array = np.asarray(values) if not np.ma.isMaskedArray(values) else values
        if array.dtype.kind not in "biuf":
            raise RecordError(f"{name} holds {array.dtype} values; give real numbers")
        masked = np.ma.isMaskedArray(array)
        array = np.ma.filled(array.astype(float), np.nan) if masked else array
    except RecordError:
        raise
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name} is not an array of numbers: {error}") from error
    if array.ndim not in (1, 2):
        raise ShapeError(f"{name} has {array.ndim} dimensions; give (n,) or (n, n_joints)")
    array = array[:, None] if array.ndim == 1 else array
    if array.flags.writeable or array.dtype != float or not array.flags.forc:
        array = np.array(array, dtype=float, order="C")
    array.setflags(write=False)
    return array
