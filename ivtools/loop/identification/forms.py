"""Linear regressions of the command, one for every form of every kind, and the cheapest of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import log, pi

import numpy as np
from numpy.typing import NDArray

from ..controllers import KINDS, Controller
from .data import DELAYS, TAPS, Data

Array = NDArray[np.float64]

ROUNDING = 1e-9  # a law that leaves less of the command than this is exact
_PRODUCTS = 1e-12  # share of the power to which products of columns can be subtracted
WORTH = 0.8  # one setting more must leave at most this much of the residual
_SLIPS, _SLIP = (1e-3, 1e-6, pi / 180.0), 0.01  # mm, um or degrees for m or rad, so exactly
_FED = 0.05  # how near to 1 the weight of a force is that is fed forward as it is
_SLACK = 0.05  # below 0 and above 1 of the weight of a reference
MOST = 4  # feed-forwards and columns beside one law
LEAST = 2e-3  # share of the command that a feed-forward must be
_ROUNDED = 1e-6  # of a gain, that a velocity reference is fed forward with at least
_STEEPEST = 10.0  # weight of a sample in a filter of the velocity: beyond, it is made of noise
_SAME = 1e-7  # share of a column outside of the others that is none


@dataclass(frozen=True)
class Form:
    """One regression and its answer.

    Parameters
    ----------
    kind : str
    columns : tuple of str
        Those of the form, velocity columns tap by tap.
    delay : int
    further : tuple of str
        Feed-forwards and measured columns beside them.
    coefficients : mapping
        Of all columns.
    left : float
        Share of the command's power that is left.
    rows : int
    """

    kind: str
    columns: tuple[str, ...]
    delay: int
    further: tuple[str, ...] = ()
    coefficients: Mapping[str, float] = field(default_factory=dict)
    left: float = 1.0
    rows: int = 1

    @property
    def criterion(self) -> float:
        """Log residual power, and a price per setting that more samples do not lower."""
        return criterion(
            max(self.left, _PRODUCTS), len(self.columns) + len(self.further), self.rows
        )

    @property
    def taps(self) -> tuple[float, ...]:
        """Weights of the velocity filter, which sum to 1."""
        own = [self.coefficients[c] for c in self.columns if "dq[" in c or "lag[" in c]
        return tuple(w / sum(own) for w in own) if own and sum(own) else (1.0,)

    @property
    def collected(self) -> dict[str, float]:
        """Coefficients with the taps of the velocity summed under dq."""
        found: dict[str, float] = {}
        for column in self.columns:
            plain = column.split("[")[0]
            if plain in ("-dq", "lag"):
                found["dq"] = found.get("dq", 0.0) + self.coefficients[column]
            if plain == "lag":
                found["lag"] = 1.0
            if plain != "-dq" and plain != "lag":
                found[plain] = self.coefficients[column]
        return found

    def controllers(self, known: Controller, data: Data) -> list[Controller]:
        """Return the controllers that the coefficients may belong to: those with gains that push.

        No error of position or velocity has a negative gain.
        """
        collected, sign = self.collected, data.sign
        if any(sign * collected.get(c, 0.0) < 0.0 for c in ("e", "dq", "int e", "int lag")):
            return []
        if "dq" in collected and collected["dq"] == 0.0:
            return []
        if max(abs(weight) for weight in self.taps) > _STEEPEST:
            return []
        try:
            found = KINDS[self.kind].from_columns(collected)
        except (KeyError, ZeroDivisionError):
            return []
        settings = [_weighted(s) for s in found if np.isfinite(list(s.values())).all()]
        return [self.around(known, data, s) for s in settings if plausible(s, sign)]

    def ahead(self, controller: Controller) -> list[Controller]:
        """Return the law with what of the velocity reference its weight of it does not say.

        A weight near 0 or 1 is meant to be that; the rest is a feed-forward, if it is anything.
        """
        collected, c = self.collected, controller.settings.get("c", 1.0)
        rest = collected.get("dq_ref", 0.0) - c * collected.get("dq", 0.0)
        if not {"dq_ref", "dq"} <= {*collected} or abs(rest) <= _ROUNDED * abs(collected["dq"]):
            return []
        return [replace(controller, feedforward={**controller.feedforward, "velocity": rest})]

    def around(self, known: Controller, data: Data, settings: Mapping[str, float]) -> Controller:
        """Return the controller with these settings and all else that the form has."""
        fed = {name: self.coefficients[name] for name in self.further}
        back = {k: v for k, v in fed.items() if k in data.record.extra and abs(v - 1.0) > _FED}
        return replace(
            known,
            kind=self.kind,
            settings=settings,
            velocity_filter=self.taps,
            velocity="logged" if data.logged else "differences",
            reference_derivative=data.derivative,
            delay=self.delay,
            limit=data.limit,
            feedforward={k: v for k, v in fed.items() if k not in back},
            feedback=back,
            filter=None,
        )


def _weighted(settings: Mapping[str, float]) -> dict[str, float]:
    """Return settings without a weight above 1: what is above it is fed forward."""
    above = settings.get("c", 0.0) > 1.0 + _SLACK
    return {**settings, "c": 1.0} if above else {**settings}


def plausible(settings: Mapping[str, float], sign: float) -> bool:
    """Whether no gain works against its error; gains in units of the command carry its sign."""
    free = {"kp", "ki"} if "kv" in settings else set()
    if any(not -_SLACK <= settings.get(k, 0.0) <= 1.0 + _SLACK for k in ("b", "c")):
        return False
    if any(abs(settings.get("b", 1.0) / slip - 1.0) < _SLIP for slip in _SLIPS):
        return False  # no weight, but a reference in another unit
    return all(
        v >= 0.0 if k in free else sign * v >= 0.0
        for k, v in settings.items()
        if k in ("kp", "ki", "kv", "kd")
    )


def criterion(left: float, settings: int, rows: int) -> float:
    """Return log residual power plus the price of so many settings."""
    return log(max(left, ROUNDING**2)) + settings * price(rows)


def price(rows: int) -> float:
    """Return what a setting costs."""
    return max(log(rows) / rows, -2.0 * log(WORTH))


class Regressions:
    """All columns' products, from which each regression is solved without the columns."""

    def __init__(self, data: Data) -> None:
        words = {**data.basic, **data.further}
        self.data, self.names = data, list(words)
        X = np.column_stack([data.seen(column) for column in words.values()])
        self.size = np.linalg.norm(X, axis=0)
        self.size[self.size == 0.0] = 1.0
        X /= self.size
        self.rows, self.gram = len(X), X.T @ X
        late = [data.seen(data.command, late=delay) for delay in range(DELAYS)]
        self.power = [float(y @ y) for y in late]
        self.along = np.column_stack([X.T @ y for y in late])
        self.solutions: dict[tuple[str, ...], tuple[Array, Array]] = {}

    def forms(self) -> Iterator[Form]:
        """Yield each form of each kind, with every velocity filter and delay, solved."""
        there = {name.split("[")[0] for name in self.names}
        lengths = range(1, 2 if self.data.logged else TAPS + 1)
        for kind, law in KINDS.items():
            for words in law.forms:
                if not {*words} <= there:
                    continue
                moving = any(w in ("-dq", "lag") for w in words)
                for taps in lengths if moving else (1,):
                    columns = tuple(_spread(words, taps))
                    for delay in range(DELAYS):
                        yield self.solved(Form(kind, columns, delay))

    def solved(self, form: Form) -> Form:
        """Return a form with its coefficients and what it leaves."""
        names = (*form.columns, *form.further)
        if names not in self.solutions:  # the products are those of every delay
            at = [self.names.index(name) for name in names]
            gram = self.gram[np.ix_(at, at)]
            x = np.linalg.lstsq(gram, self.along[at], rcond=_SAME**2)[0]
            explained = np.sum(x * (2.0 * self.along[at] - gram @ x), axis=0)
            self.solutions[names] = x / self.size[at][:, np.newaxis], explained
        x, explained = self.solutions[names]
        power = max(self.power[form.delay], 1e-300)
        left = 1.0 - float(explained[form.delay]) / power
        found = dict(zip(names, x[:, form.delay].tolist(), strict=True))
        return replace(form, coefficients=found, left=max(left, 0.0), rows=self.rows)

    def grown(self, form: Form) -> Form:
        """Return a form with those feed-forwards and columns that are worth their price."""
        for _ in range(MOST):
            rest = [n for n in self.data.further if n not in form.further and self._new(form, n)]
            more = [self.solved(replace(form, further=(*form.further, n))) for n in rest]
            more = [f for f in more if self._real(f, f.further[-1])]
            best = min(more, key=lambda f: f.criterion, default=form)
            if best.criterion >= form.criterion:
                break
            form = best
        return form

    def _real(self, form: Form, name: str) -> bool:
        """Whether a column makes some of the command, and a feed-forward pushes ahead."""
        if name in ("acceleration", "coulomb") and self.data.sign * form.coefficients[name] < 0.0:
            return False
        size = self.size[self.names.index(name)] * abs(form.coefficients[name])
        return bool(size > LEAST * self.power[form.delay] ** 0.5)

    def _new(self, form: Form, name: str) -> bool:
        """Whether a column is not a sum of those of the form."""
        at = [self.names.index(c) for c in (*form.columns, *form.further)]
        j = self.names.index(name)
        along = self.gram[at, j]
        x = np.linalg.lstsq(self.gram[np.ix_(at, at)], along, rcond=_SAME**2)[0]
        return bool(self.gram[j, j] - float(x @ along) > _SAME)


def _spread(words: tuple[str, ...], taps: int) -> Iterator[str]:
    for word in words:
        if word in ("-dq", "lag"):
            yield from (f"{word}[{i}]" for i in range(taps))
        else:
            yield word
