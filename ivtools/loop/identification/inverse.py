"""The law of a log whose noise the controller did not see: by the position that its command tells.

Such noise is in every column that the measured position makes, and least squares shrinks its gain.
But a recorded command is exact, and a law can be turned round: reference and command tell which
position the controller had. The measured one differs from that by the noise of the log alone,
whatever moves, so the right law leaves least between the two, and how that changes with the law's
settings has no noise in it. This is output error, the maximum-likelihood estimate where the noise
is white (L. Ljung, System Identification, 2nd ed., 1999, section 7.4).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import log
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...errors import AxisError
from ...linalg.noise import NoiseModel
from ..controllers import KINDS, Controller, LinearLaw
from .data import DELAYS, Data
from .forms import LEAST, MOST, Form, plausible
from .polish import NOISE, Fitted, Law, jacobian, moved, names_of, values
from .shapes import filters

Array = NDArray[np.float64]
X = TypeVar("X", Form, Controller)

_STEPS, _HALVES = 20, 8  # of Gauss and Newton, and of a step that makes it worse
_GAINED = 1e-5  # of the power left, below which a step is the last
_OUTSIDE = 1e-6  # of the unit circle, to which a law can be turned round
_TAPS = 3  # longest velocity filter of laws that are turned round
_TELLS = 100  # samples below the limit, at least, in a stretch that is used
_MOST = 12  # stretches
_SILENT = 1e-9  # of the largest singular value: answers of a start that are none
_PART = 8000  # samples among which structures are compared
_NEAR = 0.05  # of the log power of the noise: structures that are compared on all samples
_FORMS, _GROWN, _BEST = 8, 2, 4  # structures: of forms, of forms with more columns, of laws
_LOUD = 100.0  # times the command, that noise may make of it
_NEW = 1e-9  # share of a column outside of the others that is none
_LAG = 3.0  # samples, from which the lag of a derivative begins
_UNSURE = 6.0  # of Akaike's criterion, by which laws are alike
_ORDER = 20  # of the noise model at most
WHITE = 0.97  # of white noise that its own past does not tell


@dataclass(frozen=True, eq=False)
class Turned:
    """A law turned round along a log.

    Parameters
    ----------
    over, under : ndarray
        Polynomials in z^-1: the law's answer to the position is under/over.
    stretches : tuple of slice
    starts : tuple of ndarray
        Of each stretch: an orthonormal basis of what unknown starts make.
    noise : ndarray, (rows,)
        Measured position less the one that command and reference tell, up to those starts.
    """

    over: Array
    under: Array
    stretches: tuple[slice, ...]
    starts: tuple[Array, ...]
    noise: Array

    @classmethod
    def of(
        cls,
        left: Array,
        over: Array,
        under: Array,
        stretches: tuple[slice, ...],
        sign: float,
    ) -> Turned | None:
        """Turn round what a law leaves of the command, (n,).

        None if the law cannot be, or does not push back: with `sign`, that of the drive's gain.
        """
        under = np.trim_zeros(under, "f")
        if not len(under) or sign * under[0] > 0.0:
            return None
        if np.abs(np.roots(under)).max(initial=0.0) > 1.0 + _OUTSIDE:
            return None
        longest = max(s.stop - s.start for s in stretches)
        answer = signal.lfilter([1.0], under, np.eye(1, longest)[0])
        count = len(under) + len(over)
        starts = tuple(_starts(answer[: s.stop - s.start], count) for s in stretches)
        noise = cls(over, under, stretches, starts, np.zeros(0)).through(-left)
        return cls(over, under, stretches, starts, noise) if np.isfinite(noise).all() else None

    def through(self, command: Array) -> Array:
        """Return changes of the command, (n,) or (n, m), as ones of the position, (rows,) too."""
        parts = []
        for stretch, Q in zip(self.stretches, self.starts, strict=True):
            part = signal.lfilter(self.over, self.under, command[stretch], axis=0)
            parts.append(part - Q @ (Q.T @ part))
        return np.concatenate(parts)

    def clean(self, data: Data) -> Data:
        """Return the log with the position that command and reference tell."""
        q = data.record.q.copy()
        at = np.concatenate([np.arange(s.start, s.stop) for s in self.stretches])
        q[at, 0] -= self.noise
        return replace(data, record=data.record.told(q))

    @property
    def power(self) -> float:
        """Mean square of the noise, m2 or rad2."""
        return float(self.noise @ self.noise) / len(self.noise)


Found = tuple[Form, Turned]


def _starts(answer: Array, count: int) -> Array:
    """Return an orthonormal basis, (n, <= count), of an impulse's answers at the first samples."""
    late = [np.concatenate([np.zeros(i), answer[: len(answer) - i]]) for i in range(count)]
    found = np.column_stack(late)
    U, sizes, _ = np.linalg.svd(found / np.linalg.norm(found, axis=0), full_matrices=False)
    return np.asarray(U[:, sizes > _SILENT * sizes[0]])


def _stretches(data: Data, late: int) -> tuple[slice, ...]:
    """Return the longest stretches below the limit, of the command `late` samples ahead."""
    free = np.concatenate([[False], data.side[late:] == 0.0, [False]])
    edges = np.flatnonzero(np.diff(free.astype(int))).reshape(-1, 2).tolist()
    longest = sorted((a - b, b, a) for b, a in edges if a - b >= _TELLS)[-_MOST:]
    return tuple(slice(b, a) for _, b, a in longest)


def _descended(
    x: X,
    turn: Callable[[X], Turned | None],
    step: Callable[[X, Turned], Callable[[float], X]],
    steps: int = _STEPS,
) -> tuple[X, Turned] | None:
    """Return where Gauss and Newton's steps end, or None if they cannot begin."""
    best = turn(x)
    if best is None:
        return None
    for _ in range(steps):
        along, before = step(x, best), best.power
        for half in range(_HALVES):
            try:
                trial = along(0.5**half)
                found = turn(trial)
            except AxisError:
                continue
            if found is not None and found.power < before:
                x, best = trial, found
                break
        if best.power > (1.0 - _GAINED) * before:
            break
    return x, best


def _solved(J: Array, noise: Array) -> Array:
    """Return the step that takes most of the noise away."""
    size = np.linalg.norm(J, axis=0)
    size[size == 0.0] = 1.0
    return np.asarray(-np.linalg.lstsq(J / size, noise, rcond=1e-10)[0] / size)


# --- forms ------------------------------------------------------------------------------------


def _answer(form: Form, dt: float) -> tuple[Array, Array]:
    """Return numerator and denominator, in z^-1, of a form's answer to the position."""
    whole = any(c.startswith("int") for c in form.columns)
    over = np.array([1.0, -1.0]) if whole else np.ones(1)
    under = np.zeros(8)
    for name in form.columns:
        word, _, tap = name.partition("[")
        if word in ("e", "-q"):
            own = -over
        elif word in ("-dq", "lag"):
            own = np.convolve(over, np.convolve(np.eye(1, 4, int(tap[:-1]))[0], [-1.0, 1.0]) / dt)
        else:
            own = np.array({"int e": [-dt], "int lag": [-1.0, 1.0]}.get(word, [0.0]))
        under[: len(own)] += form.coefficients.get(name, 0.0) * own
    return over, np.trim_zeros(under, "b")


def solved(data: Data, form: Form, begin: Iterable[Mapping[str, float]]) -> Found | None:
    """Return a form with the coefficients that leave least of the position.

    Parameters
    ----------
    data : Data
    form : Form
    begin : iterable of mapping
        Coefficients to begin from, of which the best are taken.
    """
    names = tuple(c for c in (*form.columns, *form.further) if c != "1")  # a start makes that
    stretches = _stretches(data, form.delay)
    if not stretches or data.logged:
        return None
    n = len(data.command) - form.delay
    own = data.command[form.delay :]

    def columns(data: Data) -> Array:
        words = {**data.basic, **data.further} if form.further else data.basic
        return np.column_stack([words[name][:n] for name in names])

    measured = columns(data)

    def turn(form: Form) -> Turned | None:
        left = own - measured @ np.array([form.coefficients[name] for name in names])
        if not np.linalg.norm(left) < _LOUD * np.linalg.norm(own):
            return None  # a command beside which the recorded one is nothing
        return Turned.of(left, *_answer(form, data.record.dt), stretches, data.sign)

    def step(form: Form, at: Turned) -> Callable[[float], Form]:
        change = _solved(at.through(columns(at.clean(data))), at.noise)
        old = form.coefficients
        return lambda share: replace(
            form,
            coefficients={
                **old,
                **{k: old[k] + share * d for k, d in zip(names, change, strict=True)},
            },
        )

    starts = [
        replace(form, coefficients={k: x.get(k, 0.0) for k in (*form.columns, *form.further)})
        for given in begin
        for x in (given, _steady(given, data.sign))
    ]
    able = [(found.power, i) for i, s in enumerate(starts) if (found := turn(s)) is not None]
    return _descended(starts[min(able)[1]], turn, step) if able else None


def _steady(given: Mapping[str, float], sign: float) -> dict[str, float]:
    """Return coefficients from which a law can be turned round: gains that push."""
    late = {name for name in given if name.endswith("]") and not name.endswith("[0]")}
    return {name: 0.0 if name in late else sign * abs(value) for name, value in given.items()}


def searched(data: Data, forms: Iterable[Form], known: Iterable[Found] = ()) -> list[Found]:
    """Return forms solved anew, small ones first, from which the larger begin."""
    found: dict[tuple[tuple[str, ...], int], Found | None] = {}
    inner = list(known)
    for form in sorted(forms, key=lambda f: len(f.columns)):
        key = form.columns, form.delay
        if key not in found:
            starts = [
                f.coefficients
                for f, _ in inner
                if f.delay == form.delay and {*f.columns} <= {*form.columns}
            ]
            found[key] = one = solved(data, form, [form.coefficients, *starts])
            inner += [one] if one is not None else []
    return [one for one in found.values() if one is not None]


def _grown(data: Data, found: Found) -> Iterator[Found]:
    """Yield a form with more and more feed-forwards and columns, as long as they are worth it."""
    words = {**data.basic, **data.further}
    for _ in range(MOST):
        form, at = found
        n = len(data.command) - form.delay
        own = np.column_stack([words[name][:n] for name in (*form.columns, *form.further)])
        Q = np.linalg.qr(at.through(own))[0]
        gains: dict[str, float] = {}
        for name in {*data.further} - {*form.further}:
            whole = at.through(words[name][:n])
            x = whole - Q @ (Q.T @ whole)
            if x @ x > _NEW * float(whole @ whole):
                gains[name] = float(x @ at.noise) ** 2 / float(x @ x) / float(at.noise @ at.noise)
        best = max(sorted(gains), key=lambda name: gains[name], default="")
        if not best or -log(max(1.0 - gains[best], 1e-300)) < max(2.0 * log(n) / n, NOISE):
            break
        wider = replace(form, further=(*form.further, best))
        more = solved(data, wider, [form.coefficients])
        if more is None or not _real(data, more[0], best):
            break
        found = more
        yield found


def _real(data: Data, form: Form, name: str) -> bool:
    """Whether a column makes some of the command, and a feed-forward pushes ahead."""
    gain = form.coefficients[name]
    if name in ("acceleration", "coulomb") and data.sign * gain < 0.0:
        return False
    made = abs(gain) * float(np.linalg.norm(data.further[name]))
    return made > LEAST * float(np.linalg.norm(data.command))


def _nearest(found: Iterable[Found], count: int) -> list[Found]:
    """Return the forms that leave hardly more noise than the best, the cheapest first."""

    def cost(one: Found) -> float:
        return log(one[1].power) + NOISE * (len(one[0].columns) + len(one[0].further))

    ranked = sorted(found, key=cost)
    return [one for one in ranked[:count] if cost(one) < cost(ranked[0]) + _NEAR]


# --- laws -------------------------------------------------------------------------------------


class _Whole(Law):
    """A law along every sample, from any start: that is projected out."""

    def resids(self, controller: Controller, start: Array | None = None) -> Array:
        law, inputs, late = self._known(controller)
        state = law.settled(inputs[0]) if start is None else start
        return np.asarray(
            self.data.command[late:] - law.command(inputs, state, self.data.clipped(late))
        )

    def began(self, controller: Controller) -> tuple[Array, Array, Array]:
        """Return the settled state; of others nothing need be projected out here."""
        law, inputs, _ = self._known(controller)
        start = law.settled(inputs[0])
        return start, self.resids(controller, start), np.zeros((len(inputs), 0))

    def _known(self, controller: Controller) -> tuple[LinearLaw, Array, int]:
        law, inputs, _ = self._along(controller)
        return law, inputs[: len(inputs) - controller.delay], controller.delay


def settled(data: Data, controller: Controller, steps: int = _STEPS) -> Fitted | None:
    """Return the law of a controller's structure that leaves least of the position."""
    names = tuple(names_of(controller))
    stretches = _stretches(data, controller.delay)
    if not stretches or data.logged:
        return None
    law, dt = _Whole(data, controller), data.record.dt

    def turn(controller: Controller) -> Turned | None:
        under, over = controller.law(dt).polynomials()
        return Turned.of(law.resids(controller), over, under, stretches, data.sign)

    def slopes(controller: Controller, at: Turned) -> Array:
        clean = _Whole(at.clean(data), controller)
        return at.through(jacobian(clean, controller, names))

    def step(controller: Controller, at: Turned) -> Callable[[float], Controller]:
        change = _solved(slopes(controller, at), at.noise)
        return lambda share: moved(controller, names, share * change)

    found = _descended(controller, turn, step, steps)
    if found is None:
        return None
    controller, at = found
    e = law.resids(controller)
    left = float(e @ e) / law.power
    return Fitted(controller, names, -slopes(controller, at), at.noise, left, at.power**0.5)


def turned(data: Data, declared: Controller, forms: Iterable[Form]) -> list[Fitted]:
    """Return the laws that leave least of the position, the best first.

    Parameters
    ----------
    data : Data
        As measured.
    declared : Controller
        Whose limit and the like are kept.
    forms : iterable of Form
        From whose coefficients the search begins.
    """
    part = data.part(_PART)
    plain = searched(part, [f for f in forms if len(f.taps) == 1])
    near = _nearest(plain, _FORMS)
    wide = [
        replace(f, columns=tuple(_widened(f, taps)))
        for f, _ in near[:_GROWN]
        for taps in range(2, _TAPS + 1)
    ]
    near = _nearest([*near, *searched(part, wide, near)], _FORMS)
    near = _nearest([*near, *(more for one in near[:_GROWN] for more in _grown(part, one))], _FORMS)
    laws = [c for form, _ in near for c in _laws(form, declared, data)]
    found = _best(part, [*laws, *_lagging(plain, declared, data)])
    compared = found
    if found and not white(found[0].resids):
        fs = data.record.sampling_hz
        shaped = [replace(found[0].controller, filter=shape) for shape, lag in filters(fs) if shape]
        begun = _best(part, shaped, steps=2)
        found = _best(part, [f.controller for f in (*found, *begun[:_BEST])])
    if part is not data:
        found = _best(data, [f.controller for f in found[:_BEST]])
    return [replace(f, spread=_spread(f, compared, len(data.command))) for f in found]


def _spread(one: Fitted, others: list[Fitted], rows: int) -> dict[str, float]:
    """Return how far settings are apart in laws of a kind that so many samples cannot tell apart.

    Akaike's criterion, in which `others` were compared on some of the samples.
    """
    kind = one.controller.kind
    some = [f for f in others if f.controller.kind == kind]

    def surprise(f: Fitted) -> float:
        assert f.noise is not None
        return rows * 2.0 * log(f.noise) + 2.0 * len(f.names)

    least = min((surprise(f) for f in some), default=0.0)
    alike = [f for f in some if surprise(f) < least + _UNSURE]
    spread = {}
    for name in one.names:
        told = [values(f.controller, (name,))[0] for f in alike if name in f.names]
        spread[name] = (max(told) - min(told)) / 2.0 if told else 0.0
    return spread


def _widened(form: Form, taps: int) -> Iterator[str]:
    """Yield the columns of a form with a longer filter of the velocity."""
    for name in form.columns:
        word, _, tap = name.partition("[")
        yield from (f"{word}[{i}]" for i in range(taps)) if tap else (name,)


def _laws(form: Form, declared: Controller, data: Data) -> Iterator[Controller]:
    """Yield the laws, of every kind that has this form, that its coefficients may belong to."""
    words = tuple(dict.fromkeys(name.partition("[")[0] for name in form.columns))
    for kind, law in KINDS.items():
        if words in law.forms:
            yield from replace(form, kind=kind).controllers(declared, data)


def _lagging(plain: Iterable[Found], declared: Controller, data: Data) -> Iterator[Controller]:
    """Yield laws, one for each delay, whose derivative is filtered: no form has that."""
    whole = [one for one in plain if {"e", "int e"} <= {*one[0].columns}]
    whole = [one for one in whole if one[0].collected.get("dq")]
    for delay in range(DELAYS):
        for form, _ in sorted((o for o in whole if o[0].delay == delay), key=_power)[:1]:
            (found,) = KINDS["pid"].from_columns(form.collected)
            own = {k: float(np.clip(found.get(k, 1.0), 0.0, 1.0)) for k in ("b", "c")}
            own |= {k: data.sign * abs(found.get(k, 0.0)) for k in ("kp", "ki", "kd")}
            own["derivative_filter"] = _LAG * data.record.dt
            yield replace(form, kind="pid").around(declared, data, own)


def _power(found: Found) -> float:
    return found[1].power


def _best(data: Data, laws: Iterable[Controller], steps: int = _STEPS) -> list[Fitted]:
    """Return laws settled, the best first, each once."""
    found: list[Fitted] = []
    for law in laws:
        one = settled(data, law, steps)
        if one is not None and plausible(one.controller.settings, data.sign):
            found.append(one)
    found.sort(key=lambda f: (f.criterion, len(f.names)))
    apart: list[Fitted] = []
    for f in found:
        if not any(_same(f, other) for other in apart):
            apart.append(f)
    return apart


def _same(one: Fitted, other: Fitted) -> bool:
    """Whether two laws are one."""
    a, b = one.controller, other.controller
    if (a.kind, a.delay, one.names) != (b.kind, b.delay, other.names):
        return False
    return bool(np.allclose(values(a, one.names), values(b, one.names), rtol=1e-3, atol=0.0))


def innovation(e: Array) -> float:
    """Return the share of a residual's power, (n,), that its own past does not tell."""
    model = NoiseModel.fit(e, max_order=_ORDER, criterion="bic")
    return float(np.mean(model(e) ** 2) / np.mean(e**2))


def white(e: Array) -> bool:
    """Whether a residual's own past tells nothing of it."""
    return innovation(e) > WHITE
