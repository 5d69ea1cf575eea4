"""The search: every form of every kind, the few best polished, the cheapest that explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...errors import RecordError
from ...linalg.noise import NoiseModel
from ...record import Record
from ..controllers import Controller, other_derivative
from . import linear
from .data import Data
from .forms import LEAST, Form, Regressions, plausible, price
from .instruments import refined
from .inverse import WHITE, innovation, turned
from .linear import just_logged
from .polish import Fitted, polished, values
from .report import ControllerFit, Tried, fit_of, std_errors
from .shapes import filters

if TYPE_CHECKING:
    from ..closed_loop import ClosedLoop

_NOISY = 1e-4  # share of the power that a law leaves which did not see just what was logged
_PERFECT = 1e-14  # share of the power that exact data leave
_EACH = 2  # forms of a kind that become laws, with feed-forwards and without
_WORSE = 1e3  # times the power left of the best law from which a form is none
_CONSTANTS = 2  # columns of a cascade's form that are no settings of it
_PART = 5000  # samples among which a filter is looked for
_INTEGRAL = 0.1  # of the proportional part, that an integral may become in a record at least
_ORDER = 20  # of the noise model at most
_CERTAIN = 0.05  # standard error of a gain, of itself, at most, that instruments tell
_STARTS = 2  # laws with filters that are fitted, of each sort of filter
_FORMS = 3  # of each filter, from which such laws begin
_DAMPED = 20.0  # damping of a filter at most
_POOR = 0.5  # share of the power of the command, low-passed, that is not explained at most
_ROWS = 200  # at least, of a low-passed log from which a search begins
_PER_NAME = 20  # rows of it per coefficient, at least
_MOVED = 1e-3  # of a gain, by which the law that shows there is another one
_UNLIKELY = 0.7  # prices of a setting that a kind must be better by if it is the less likely one
_FILTERED = 1e-7  # share of the power left from which a filter in the loop is looked for
_WORTH = 0.5  # of the residual's power that it must remove


Searched = tuple[Fitted | None, Data, list[Tried]]  # the law, what it saw, and what was tried


def least(loop: ClosedLoop, record: Record) -> tuple[float, float]:
    """Return the shares of a record's command that no law of a few samples explains, rms.

    The second one without what a law sees, from the command's own past alone.

    Raises
    ------
    RecordError
        As `identify`.
    """
    return linear.least(Data.of(loop, record, logged=False))


def identify(loop: ClosedLoop, record: Record) -> ControllerFit:
    """Fit the law of a record's longest stretch; see `ClosedLoop.identify_controller`."""
    record = record.longest.liveliest()
    return fit_of(loop, *(_told_by_part(loop, record) or _search(loop, record)))


def _told_by_part(loop: ClosedLoop, record: Record) -> Searched | None:
    """Return the law that a part of a record without noise shows, if it is that of all of it."""
    part = record.liveliest(_PART)
    if part.n_samples == record.n_samples:
        return None
    try:
        exact = just_logged(Data.of(loop, part, logged=False))
    except RecordError:  # of which all may be at the limit
        return None
    if not exact:
        return None
    best, seen, tried = _search(loop, part)
    if best is None:
        return None
    data = Data.of(loop, record, seen.logged, seen.derivative)
    whole = polished(data, best.controller)
    return (whole, data, tried) if whole.left < _FILTERED else None


class _Laws(NamedTuple):
    """The best law of one way to derive the reference, what it saw, all others, what was tried."""

    best: Fitted | None
    data: Data
    laws: list[list[Fitted]]
    seen: list[Data]
    tried: list[Tried]

    @property
    def left(self) -> float:
        """Share of the command's power that it leaves."""
        return self.best.left if self.best is not None else float("inf")


def _simple(loop: ClosedLoop, record: Record, ways: Sequence[bool], derivative: str) -> _Laws:
    """Return the laws without filters, by where they have their velocity and how they derive."""
    seen = [Data.of(loop, record, logged, derivative) for logged in ways]
    found = [_plain(loop, data) for data in seen]
    laws = [plain for plain, _ in found]
    tried = [form for _, forms in found for form in forms]
    return _Laws(*_cheapest(loop, laws, seen), laws, seen, tried)


def _better(found: _Laws, other: _Laws, most: float) -> _Laws:
    """Return other laws where they leave less than that."""
    return other if other.left < most else found


def _behind_filters(loop: ClosedLoop, found: _Laws) -> _Laws:
    """Return the laws with filters as well."""
    laws = [
        plain + _surrounded(loop, data, _chosen(loop, plain, data).left) if plain else plain
        for plain, data in zip(found.laws, found.seen, strict=True)
    ]
    best, data = _cheapest(loop, laws, found.seen)
    return found._replace(best=best, data=data, laws=laws)


def _search(loop: ClosedLoop, record: Record) -> Searched:
    """Return the law of a record, what it saw, and what was tried."""
    ways = [False, True] if record.dq is not None else [False]
    if loop.controller.velocity == "logged" and record.dq is not None:
        ways = [True]
    found = _simple(loop, record, ways, loop.controller.reference_derivative)
    if found.best is not None and found.left > _PERFECT:
        other = _simple(loop, record, ways, other_derivative(found.data.derivative))
        found = _better(found, other, _WORTH * found.left)
    noisy = found.left > _NOISY and not just_logged(found.seen[0])
    if found.best is not None and noisy:
        unseen = _unseen(loop, found.seen[0], found.best)
        if unseen is not None:
            return *unseen, found.tried
    if found.best is not None and found.left > _FILTERED:
        found = _behind_filters(loop, found)
    if found.best is not None and found.left > _PERFECT and just_logged(found.data):
        other = _behind_filters(
            loop, _simple(loop, record, ways, other_derivative(found.data.derivative))
        )
        found = _better(found, other, _WORTH * found.left)
    best, data, *_, tried = found
    if best is not None and best.left > _FILTERED and just_logged(data):
        law = linear.state_space(data)
        whole = polished(data, law) if law is not None else best
        best = whole if whole.left < _FILTERED else best
    if best is not None and best.left > _NOISY:
        best, data = _quiet(loop, data, best) or (best, data)
        told = _instrumented(replace(data, low_pass=None), best)
        if told is not None and _certain(told):
            best = replace(told, left=best.left)
    return best, data, tried


def _cheapest(
    loop: ClosedLoop, laws: list[list[Fitted]], seen: list[Data]
) -> tuple[Fitted | None, Data]:
    """Return the best law, and what it saw.

    A velocity that a drive logs is more likely its own than differences.
    """
    best = [
        (_chosen(loop, some, data), data) for some, data in zip(laws, seen, strict=True) if some
    ]

    def cost(one: tuple[Fitted, Data]) -> float:
        return one[0].criterion - _UNLIKELY * price(one[1].record.n_samples) * one[1].logged

    return min(best, key=cost, default=(None, seen[0]))


def _plain(loop: ClosedLoop, data: Data) -> tuple[list[Fitted], list[Tried]]:
    """Return laws without a filter in the loop, and what was tried."""
    regressions = Regressions(data)
    forms = list(regressions.forms())
    tried = [Tried(f.kind, len(f.taps), f.delay, f.left) for f in forms]
    fitted = _fitted(loop, data, [*forms, *_grown(regressions, forms)])
    part = data.unclipped
    if part is not None:
        own = Regressions(part)
        begun = list(own.forms())
        fitted += _fitted(loop, data, [*begun, *_grown(own, begun)])
    return fitted, tried


def _grown(regressions: Regressions, forms: list[Form]) -> list[Form]:
    """Return the best forms of each kind with feed-forwards and columns beside them."""
    best: dict[tuple[str, int], Form] = {}
    for form in sorted(forms, key=lambda f: f.criterion):
        best.setdefault((form.kind, len(form.columns)), form)
    grown = []
    for form in best.values():
        same = [f for f in forms if f.kind == form.kind and f.columns == form.columns]
        grown += [regressions.grown(f) for f in same]
    return [f for f in grown if f.further]


def _fitted(loop: ClosedLoop, data: Data, forms: list[Form]) -> list[Fitted]:
    """Return the best forms of each kind as laws, without those with a gain against its error.

    A form says how good its law is, but for a cascade with an integrator: that is no linear
    regression, and may be better than its form.
    """
    found: list[Fitted] = []
    count: dict[tuple[str, bool], int] = {}
    for form in sorted(forms, key=lambda f: f.criterion):
        group = (form.kind, bool(form.further))
        least = min((f.left for f in found), default=np.inf)
        cheapest = min((len(f.names) for f in found if f.left < _PERFECT), default=99)
        linear = form.kind != "p-pi"
        if count.get(group, 0) >= _EACH or (linear and form.left > _WORSE * max(least, _PERFECT)):
            continue
        if len(form.columns) + len(form.further) > cheapest + 1 + _CONSTANTS * (not linear):
            continue
        controllers = form.controllers(loop.controller, data)
        count[group] = count.get(group, 0) + bool(controllers)
        found += [polished(data, c) for one in controllers for c in (one, *form.ahead(one))]
    seconds = data.record.n_samples * data.record.dt
    good = (f for f in found if plausible(f.controller.settings, data.sign))
    return [f for f in good if _integrates(f.controller, seconds) and _felt(f.controller, data)]


def _felt(controller: Controller, data: Data) -> bool:
    """Whether what is fed forward is still worth a setting once the law is polished."""
    forward = controller.feedforward
    if any(data.sign * forward.get(name, 0.0) < 0.0 for name in ("acceleration", "coulomb")):
        return False
    size = LEAST * float(np.sqrt(np.mean(data.command**2)))
    fed = ((data.further.get(name), gain) for name, gain in forward.items())
    return all(x is None or abs(g) * float(np.sqrt(np.mean(x**2))) > size for x, g in fed)


def _integrates(controller: Controller, seconds: float) -> bool:
    """Whether an integral that a law has comes to something within a record."""
    s = controller.settings
    proportional = 1.0 if "kv" in s else abs(s.get("kp", 1.0))
    return "ki" not in s or abs(s["ki"]) * seconds > _INTEGRAL * proportional


def _chosen(loop: ClosedLoop, fitted: list[Fitted], data: Data) -> Fitted:
    """Return the cheapest law; among equals the declared kind, then the nearest to it.

    Where a position reference is logged, the integral of the velocity's error is more likely the
    error of the position.
    """
    follows = data.record.q_ref is not None

    def cost(f: Fitted) -> float:
        unlikely = follows and f.controller.kind == "pi-velocity" != loop.controller.kind
        return f.criterion + _UNLIKELY * f.price * unlikely

    first = min(fitted, key=cost)
    alike = [f for f in fitted if cost(f) <= cost(first) + first.alike]
    order = ["cascade-pd", "p-pi", "pd", "pi-velocity", "p-velocity", "pid"]

    def rank(f: Fitted) -> tuple[bool, int, float]:
        declared = loop.controller
        other = f.controller.kind != declared.kind
        weighted = not set(f.controller.settings) <= {*declared.settings}  # as a cascade's c = 0
        return (
            other or weighted,
            order.index(f.controller.kind),
            _distance(f.controller, loop.controller),
        )

    return min(alike, key=rank)


def _distance(one: Controller, other: Controller) -> float:
    """Return how far the gains of one kind are apart; else prefer the slower outer loop."""
    if one.kind != other.kind:
        return float(one.settings.get("kp", 0.0))
    pairs = [(one.full[k], other.full[k]) for k in ("kp", "kv", "ki", "kd") if k in one.full]
    return sum(abs(np.log(max(abs(a), 1e-12) / max(abs(b), 1e-12))) for a, b in pairs)


# --- what surrounds the law --------------------------------------------------------------------


def _surrounded(loop: ClosedLoop, data: Data, least: float) -> list[Fitted]:
    """Return the best laws with a filter in the loop, or of the derivative."""
    fs = data.record.sampling_hz
    part = data.part(_PART)
    starts: list[tuple[float, Controller]] = []
    for shape, lag in filters(fs):
        behind = replace(part, shape=shape, lag=lag)
        regressions = Regressions(behind)
        forms = [f for f in regressions.forms() if not lag or f.kind == "pid"]
        for form in sorted(forms, key=lambda f: f.criterion)[:_FORMS]:
            grown = regressions.grown(form)
            first = grown.controllers(loop.controller, data)[:1]
            for c in (law for one in first for law in (one, *grown.ahead(one))):
                own = {**c.settings, "derivative_filter": lag} if lag else c.settings
                starts.append((grown.criterion, replace(c, filter=shape, settings=own)))
    families: dict[tuple[object, ...], list[Controller]] = {}
    for _, c in sorted(starts, key=lambda start: start[0]):
        kind = c.filter and (c.filter.kind, c.filter.damping is None)
        families.setdefault((kind,), []).append(c)
    begun = [c for some in families.values() for c in (*some[:_STARTS], *_stated(loop, some[0]))]
    found = [polished(data, c) for c in begun]
    found = [f if _felt(f.controller, data) else polished(data, _unfed(f)) for f in found]
    return [
        f
        for f in found
        if f.left < _WORTH * least
        and _stands(f.controller, fs)
        and plausible(f.controller.settings, data.sign)
    ]


def _stated(loop: ClosedLoop, other: Controller) -> list[Controller]:
    """Return the declared law, with all that it has, behind the filter of another one."""
    known = loop.controller
    gains = bool(known.settings) and all(np.ndim(v) == 0 for v in known.settings.values())
    around = replace(other, kind=known.kind, settings=known.settings, delay=known.delay)
    return [replace(around, velocity_filter=known.velocity_filter)] if gains else []


def _unfed(fitted: Fitted) -> Controller:
    """Return a law without its feed-forwards."""
    return replace(fitted.controller, feedforward={})


def _stands(controller: Controller, fs: float) -> bool:
    """Whether a fitted filter is one."""
    shape, lag = controller.filter, float(controller.full.get("derivative_filter", 0.0))
    return lag >= 0.0 and (
        shape is None or (0.0 < shape.hz < 0.5 * fs and 0.0 < (shape.damping or 1.0) < _DAMPED)
    )


# --- noise between the encoder and the log -----------------------------------------------------


def _unseen(loop: ClosedLoop, data: Data, raw: Fitted) -> tuple[Fitted, Data] | None:
    """Return the law of a log with noise that the controller did not see, if that is what it has.

    It is, where such noise is white: what a wrong law leaves follows the motion, and what a law
    leaves that saw just what was logged is whiter as it is.
    """
    hz = data.quiet_hz
    if hz is None or data.logged:
        return None
    low = replace(data, low_pass=hz)
    low = low if low.rows.sum() >= _ROWS else data
    laws = turned(data, loop.controller, Regressions(low).forms())
    least = [replace(f, left=polished(low, f.controller, steps=0).left) for f in laws]
    laws = [f for f in least if f.left < _POOR and _felt(f.controller, data)]
    if not laws:
        return None
    best = _chosen(loop, laws, data)
    plain = polished(data, best.controller)
    if plain.left < _FILTERED:
        return plain, data
    own, others = innovation(best.resids), innovation(raw.resids)
    return (best, low) if own > max(WHITE, others) else None


def _instrumented(data: Data, best: Fitted) -> Fitted | None:
    """Return a law with its gains by instrumental variables, if the reference tells them.

    Twice: the second time with the noise that the first answer leaves made white. Weights of the
    velocity are more than a reference tells.
    """
    plain = replace(best.controller, velocity_filter=(1.0,))
    fitted = polished(data, plain, steps=0)
    for _ in range(2):
        found = refined(data, fitted)
        if found is None:
            return None
        fitted = found
        noise = NoiseModel.fit(fitted.resids, max_order=_ORDER, criterion="bic")
        data = replace(data, whitener=np.append(1.0, -noise.coefficients))
    return fitted


def _certain(fitted: Fitted) -> bool:
    """Whether the gains are."""
    errors = std_errors(fitted)
    gains = dict(zip(fitted.names, values(fitted.controller, fitted.names), strict=True))
    own = [n for n in ("kp", "kv", "ki", "kd") if gains.get(n)]
    return all(errors[n] < _CERTAIN * abs(gains[n]) for n in own)


def _quiet(loop: ClosedLoop, data: Data, raw: Fitted) -> tuple[Fitted, Data] | None:
    """Return the law behind a low-pass, if noise of the log has shrunk the gains of the raw one.

    A velocity that is differentiated from a noisy position is mostly noise; where the controller
    did not see that noise, the regression takes it for velocity that had no effect, and gains come
    out too small. Below a low-pass the noise is nothing, and the law is the same.
    """
    hz = data.quiet_hz
    if hz is None:
        return None
    low = replace(data, low_pass=hz)
    if low.rows.sum() < _PER_NAME * (len(raw.names) + 1):
        return None
    same = polished(low, raw.controller)
    gains = [n for n in raw.names if n in ("kp", "kv", "kd")]
    before, after = raw.controller.settings, same.controller.settings
    moved = [abs(after[n] / before[n] - 1.0) for n in gains if before[n]]
    if not moved or max(moved) < _MOVED:
        return None
    laws, _ = _plain(loop, low)
    laws += _surrounded(loop, low, _chosen(loop, laws, low).left) if laws else []
    best = _chosen(loop, laws, low) if laws else None
    return (best, low) if best is not None and best.left < raw.left else None
