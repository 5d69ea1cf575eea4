"""The columns of the regression that a control law is: what it may have seen, and what it gave."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...checks import MIN_SAMPLES
from ...errors import RecordError
from ...record import Record
from ..controllers.filters import LoopFilter
from ..controllers.law import Clipped
from ..controllers.seen import FEEDFORWARDS, feedforward, speed_reference

if TYPE_CHECKING:
    from ..closed_loop import ClosedLoop

Array = NDArray[np.float64]

TAPS, DELAYS = 6, 4  # longest velocity filter, and how many delays are tried, from 0
HEAD = TAPS + DELAYS + 2  # samples whose past is not in the record
_LEAST = 10 * HEAD  # samples that tell a law, at least
_CLIPPED = 5  # so many samples at the very largest command are a limit
_BIAS = 0.005  # noise of the low-passed velocity, of its rms
_SLOWEST = 4.0  # cut-off of the low-pass at least, in median frequencies of the motion
_FASTEST = 0.125  # and at most, of the sampling rate
_STRETCH = 20 * HEAD  # samples between clipped ones from which a law can start
_PER_PERIOD = 6.0  # samples of what is low-passed that are kept
_FOLLOWS = 3  # samples by which an effect of the command may come behind it
_BEHIND = 0.5  # correlation of changes from which such a one may
_ITSELF = 0.9999  # R2 from which a column is the command itself


@dataclass(frozen=True, eq=False)
class Data:
    """What a law may have seen.

    Parameters
    ----------
    record : Record
        With one joint and a reference.
    command : ndarray, (n,)
        The law's own: without the added input.
    limit : float
        At which it is clipped, stated or seen.
    joint : str
    logged : bool
        Whether the law takes the logged velocity.
    sign : float
        Of the drive's gain, which the law's gains share.
    low_pass : float or None
        Cut-off, Hz, of the zero-phase filter that everything passes, and by which rows become few;
        None leaves everything as it is.
    shape : LoopFilter or None
        What all columns pass, for laws with that filter behind them.
    lag : float
        Time constant, s, of a low-pass of the velocity's columns, for a filtered derivative.
    whitener : ndarray, (p + 1,), optional
        Polynomial in z^-1 that everything passes.
    derivative : str
        How derivatives of the reference are made that are not logged.
    """

    record: Record
    command: Array
    limit: float
    joint: str
    logged: bool
    sign: float = 1.0
    low_pass: float | None = None
    shape: LoopFilter | None = None
    lag: float = 0.0
    whitener: Array | None = None
    derivative: str = "central"

    @classmethod
    def of(cls, loop: ClosedLoop, record: Record, logged: bool, derivative: str = "") -> Data:
        """Collect what a record has.

        Raises
        ------
        RecordError
            If there is no reference, more than one joint, or hardly a sample below the limit.
        """
        if record.q_ref is None and record.dq_ref is None:
            raise RecordError(
                "q_ref is missing; a control law is fitted from the position reference, or from "
                'dq_ref; for a record without controller write [controller] kind = "none"'
            )
        if record.n_joints != 1:
            raise RecordError(f"the record has {record.n_joints} joints; a control law serves one")
        added = 0.0 if record.added is None else record.added
        command = (loop.command(record) - added)[:, 0]
        limit, sign = _limit(command, loop.controller.limit), float(np.sign(loop.gain))
        way = derivative or loop.controller.reference_derivative
        data = cls(record, command, limit, loop.joint, logged, sign, derivative=way)
        if data.rows.sum() < _LEAST or not command[HEAD:].any():
            raise RecordError(
                f"{int(data.rows.sum())} samples of the command are below its limit and not 0; a "
                "control law needs more, so take a longer record or state the controller"
            )
        return data

    @cached_property
    def side(self) -> Array:
        """The sign of the command where it is clipped, (n,)."""
        return self.clipped(0).side

    def clipped(self, late: int) -> Clipped:
        """Return where the command of a law that is late, (n - late,), is clipped."""
        return Clipped.of(self.command[late:], self.limit, self.limit)

    @cached_property
    def rows(self) -> NDArray[np.bool_]:
        """Samples that tell the law at every delay: below the limit, with their past, (n,)."""
        free = self.side == 0.0
        wide = round(1.0 / (self.low_pass * self.record.dt)) if self.low_pass else 0
        late = np.convolve(~free, np.ones(DELAYS + 2 * wide), mode="full") > 0.5
        keep = ~late[DELAYS - 1 + wide :][: len(free)] if wide else ~late[DELAYS - 1 :][: len(free)]
        keep[: max(HEAD, 3 * wide)] = False
        keep[len(keep) - max(DELAYS, 3 * wide) :] = False
        if self.low_pass:  # what is band-limited needs few samples
            step = max(int(1.0 / (_PER_PERIOD * self.low_pass * self.record.dt)), 1)
            keep &= np.arange(len(keep)) % step == 0
        return keep

    @cached_property
    def basic(self) -> dict[str, Array]:
        """Columns by name, (n,): the words that forms of a law are made of."""
        record, q, dt = self.record, self.record.q[:, 0], self.record.dt
        dq_ref = speed_reference(record, self.derivative)
        free = self.side == 0.0
        columns = {"dq_ref": dq_ref, "-q": q[0] - q, "1": np.ones(len(q))}
        if record.q_ref is not None:
            e = record.q_ref[:, 0] - q
            columns |= {"e": e, "int e": np.cumsum(np.where(free, e, 0.0)) * dt}
        speed = record.dq[:, 0] if self.logged else np.diff(q, prepend=2 * q[0] - q[1]) / dt  # type: ignore[index]
        for i in range(1 if self.logged else TAPS):
            past = np.concatenate([np.full(i, speed[0]), speed[: len(speed) - i]])
            columns |= {f"-dq[{i}]": -past, f"lag[{i}]": dq_ref - past}
        columns["int lag"] = np.cumsum(np.where(free, columns["lag[0]"], 0.0)) * dt
        return {name: self._shaped(name, column) for name, column in columns.items()}

    def _shaped(self, name: str, column: Array) -> Array:
        """Return a column behind the filters, in which it was at rest before the record."""
        dt = self.record.dt
        if self.lag and ("dq" in name or "lag[" in name):
            keep = self.lag / (self.lag + dt)
            column = signal.lfilter([1.0 - keep], [1.0, -keep], column - column[0]) + column[0]
        if self.shape:
            over, under = self.shape.coefficients(dt)
            column = signal.lfilter(over, under, column - column[0]) + column[0]
        return column

    def part(self, n: int) -> Data:
        """Return the stretch of n samples in which the command changes most."""
        if n >= len(self.command):
            return self
        busy = np.concatenate([[0.0], np.cumsum(np.diff(self.command, prepend=0.0) ** 2)])
        at = int(np.argmax(busy[n:] - busy[:-n]))
        return replace(
            self, record=self.record.slice(at, at + n), command=self.command[at : at + n]
        )

    @property
    def unclipped(self) -> Data | None:
        """The longest stretch below the limit, if the command was clipped and it is long enough.

        How an integral stood while the command was clipped only its law tells; a regression needs
        a stretch in which it ran.
        """
        edges = np.flatnonzero(np.diff(np.concatenate([[1.0], np.abs(self.side), [1.0]])))
        if len(edges) < 4 or len(edges) % 2:
            return None
        start, stop = max(edges.reshape(-1, 2).tolist(), key=lambda pair: pair[1] - pair[0])
        if stop - start < max(_STRETCH, MIN_SAMPLES):
            return None
        part = self.record.slice(start, stop)
        return replace(self, record=part, command=self.command[start:stop])

    @cached_property
    def further(self) -> dict[str, Array]:
        """Feed-forwards and further measured columns, by name, (n,)."""
        names = ["acceleration", "coulomb"]
        names += ["gravity", "gravity_cos"] if self.joint == "revolute" else ["gravity"]
        found = {n: feedforward(n, self.record, self.joint, self.derivative) for n in names}
        for name, column in self.record.extra.items():
            if name not in FEEDFORWARDS and np.ptp(column) > 0.0 and not self._follows(column):
                found[name] = column
        return {name: self._shaped(name, column) for name, column in found.items()}

    def _follows(self, column: Array) -> bool:
        """Whether a column comes behind the command, as a measured current does: no cause of it."""
        x, y = (np.diff(z - z.mean()) for z in (column, self.command))

        def along(lag: int) -> float:
            a, b = (x[lag:], y[: len(y) - lag]) if lag >= 0 else (x[:lag], y[-lag:])
            size = float(np.linalg.norm(a) * np.linalg.norm(b))
            return abs(float(a @ b)) / size if size > 0.0 else 0.0

        behind = max(along(lag) for lag in range(1, _FOLLOWS + 1))
        ahead = max(along(-lag) for lag in range(DELAYS))
        same = np.corrcoef(column, self.command)[0, 1] ** 2
        return bool(behind > max(ahead, _BEHIND) or same > _ITSELF)

    def seen(self, column: Array, late: int = 0) -> Array:
        """Return the rows of a column, `late` samples ahead; low-passed and whitened if all are."""
        if late:
            column = np.concatenate([column[late:], np.full(late, column[-1])])
        if self.low_pass:
            column = signal.sosfiltfilt(self._sos, column)
        if self.whitener is not None:
            column = signal.lfilter(self.whitener, [1.0], column)
        return column[self.rows]

    @cached_property
    def _sos(self) -> Array:
        assert self.low_pass is not None
        return np.asarray(signal.butter(2, self.low_pass, fs=self.record.sampling_hz, output="sos"))

    @cached_property
    def quiet_hz(self) -> float | None:
        """Cut-off, Hz, below which the noise of the encoder is nothing beside the velocity."""
        q, dt, fs = self.record.q[:, 0], self.record.dt, self.record.sampling_hz
        noise = float(np.median(np.abs(np.diff(q, 4)))) / (0.6745 * np.sqrt(70.0))
        speed = speed_reference(self.record, self.derivative)
        rms = float(np.sqrt(np.mean(speed**2)))
        if noise <= 0.0 or rms <= 0.0:
            return None
        power = np.abs(np.fft.rfft(speed - speed.mean())) ** 2
        motion = float(
            np.fft.rfftfreq(len(q), dt)[np.searchsorted(power.cumsum(), power.sum() / 2)]
        )
        wanted = (_BIAS * rms / noise / (2.0 * np.pi) * np.sqrt(1.5 * fs)) ** (2.0 / 3.0)
        return float(np.clip(wanted, min(_SLOWEST * motion, _FASTEST * fs), _FASTEST * fs))


def _limit(command: Array, stated: float) -> float:
    """Return the stated limit, or the one at which the record clips."""
    top = float(np.max(np.abs(command)))
    clips = int((np.abs(command) >= top * (1.0 - 1e-9)).sum()) >= _CLIPPED
    return top if not np.isfinite(stated) and clips and top > 0.0 else stated
