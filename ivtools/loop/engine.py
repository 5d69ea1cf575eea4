"""From a loop and a record to the compiled kernel's arguments, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AxisError, ShapeError
from ..physics import TERMS, Term
from ..record import Record
from . import kernel, mechanics
from .controllers import Controller, LinearLaw, Seen
from .controllers.law import MEASURED, Clipped
from .simulation import Simulation

if TYPE_CHECKING:
    from .closed_loop import ClosedLoop, Initial

Array = NDArray[np.float64]
Motion = tuple[float, float, float]  # position, velocity and acceleration

_LONGEST_DELAY = 10.0  # s
_BEGINNING = 0.3  # s that tell in which state a law began a record
_START_SAMPLES = 20  # the initial velocity is the slope of a parabola through so many samples
_START_TIME = 0.021  # s; where they last longer, through fewer
_FEWER, _BENT = (20, 14, 10, 7, 5, 4), 2.0  # until it leaves no more than so much of the noise
_NUMBERS = mechanics.PARAMETERS.itemsize // 8  # of a parameter record


class Plant(NamedTuple):
    """What the compiled functions want to know of drive, mechanics and sensor."""

    p: np.void  # every parameter, mechanics.PARAMETERS
    on: np.void  # which effects act, mechanics.FLAGS
    user: Callable[..., float]  # a user's own law


def plant(
    loop: ClosedLoop,
    values: Mapping[str, float],
    general: bool = False,
    stiction: bool = True,
) -> Plant:
    """Collect the parameters of drive and mechanics for the kernel.

    `general` asks for the general integrator where the closed form would do; without `stiction`
    friction has no rule of standstill.

    Raises
    ------
    AxisError
        If the model has no inertia, it is not positive, own terms have too many parameters, or
        the drive's delay is absurd.
    """
    if not values.get("inertia", 0.0) > 0.0:
        raise AxisError(
            f"inertia is {values.get('inertia', 'missing')}; a simulation needs a positive one"
        )
    form = _FORMS.get(loop)
    if form is None:
        form = _FORMS[loop] = _Form.of(loop.terms)
    numbers, on = np.zeros(_NUMBERS), form.on.copy().view(mechanics.FLAGS)[0]
    numbers[form.at] = [loop.gain, loop.delay, *(values[name] for name in form.names)]
    p = numbers.view(mechanics.PARAMETERS)[0]  # field by field takes five times as long
    late = p["delay"] + p["drive-timing.delay"]
    if not 0.0 <= late <= _LONGEST_DELAY:
        raise AxisError(
            f"the drive's delay is {late:g} s; it lies between 0 and {_LONGEST_DELAY} s"
        )
    on["presliding"] &= bool(np.isfinite(p["presliding.stiffness"]))
    on["sign"] = not (stiction or on["presliding"])  # a bristle needs no rule of standstill
    on["beyond"] = on["laws"] or on["own"] or on["presliding"]
    timed = general or loop.delay > 0.0 or on["drive-timing"]
    on["effects"] = timed or on["two"] or on["sign"] or on["beyond"]
    return Plant(p, on, form.user)


class _Form(NamedTuple):
    """What the terms of a loop make of its plant, whatever their parameters are."""

    names: tuple[str, ...]  # of the parameters
    at: list[int]  # of the drive's gain and delay, and of the parameters, among the plant's numbers
    on: NDArray[np.uint8]  # a flag record, byte by byte
    user: Callable[..., float]

    @classmethod
    def of(cls, terms: tuple[Term, ...]) -> _Form:
        flags = np.zeros(mechanics.FLAGS.itemsize, np.uint8)
        on = flags.view(mechanics.FLAGS)[0]
        mine = tuple(term for term in terms if TERMS.get(term.name) is not term)
        known = [term for term in terms if term not in mine]
        for term in known:
            on[term.name] = True
        own = [name for term in mine for name in term.names]
        if len(own) > len(mechanics.OWN):
            raise AxisError(
                f"own terms have {len(own)} parameters; at most {len(mechanics.OWN)} fit"
            )
        on["own"] = bool(mine)
        on["laws"] = sum(mechanics.BITS.get(t.name, 0) for t in known)
        on["two"] = any(on[name] for name in mechanics.TWO_MASSES)
        names = [name for term in known for name in term.names]
        places: Any = mechanics.PARAMETERS.fields
        fields = ("gain", "delay", *names, *mechanics.OWN[: len(own)])
        at = [places[field][1] // 8 for field in fields]
        user = _compile(mine, tuple(t.law for t in mine)) if mine else mechanics.no_law
        return cls((*names, *own), at, flags, user)


_FORMS: WeakKeyDictionary[ClosedLoop, _Form] = WeakKeyDictionary()


@lru_cache(maxsize=16)
def _compile(terms: tuple[Term, ...], laws: tuple[Any, ...]) -> Callable[..., float]:
    """Compile own laws once; terms that differ in their laws only are equal."""
    for term in terms:
        if term.law is None:
            raise AxisError(f"{term.name} has no law; a term of your own needs one to be simulated")
    return mechanics.user_law(terms)


def simulate(
    loop: ClosedLoop,
    record: Record,
    values: Mapping[str, float],
    *,
    initial: Initial,
    substeps: int | None,
    position_noise: ArrayLike | None,
    force_noise: ArrayLike | None,
    place: ArrayLike | None,
    link: ArrayLike | None,
    quantum: float,
    ramp: bool,
    stiction: bool,
) -> Simulation:
    """Run the kernel; see `ClosedLoop.simulate`."""
    if record.n_joints != 1:
        raise ShapeError(f"the record has {record.n_joints} joints; a loop simulates one")
    steps = loop.substeps if substeps is None else substeps
    if steps < 1:
        raise AxisError(f"substeps is {steps}; it counts the integration steps per sample")
    n, dt = record.n_samples, record.dt
    law = driven(loop, record, values, initial)
    if record.load is not None:
        values = {**values, **_rigid(loop, values, dt)}
    out = np.empty((4, n))
    kernel.run(
        dt,
        steps,
        law.known,
        _added(record, values),
        ramp,
        (at := _noise("place", place, n)),
        _noise("position_noise", position_noise, n),
        _noise("force_noise", force_noise, n),
        *_links(record, link),
        float(quantum),
        *law[1:],
        *plant(loop, values, general=ramp, stiction=stiction),
        out,
    )
    q, dq, ddq, nu = out[:, :, None]
    with np.errstate(over="ignore"):  # an unstable loop is reported by Simulation.finite
        tau = loop.gain * nu
    return Simulation(record.t, q, dq, ddq, nu, tau, loop, place=at if at.size else None)


class Driven(NamedTuple):
    """A control law along a record, as the kernels take it; see `controllers.LinearLaw`.

    Attributes
    ----------
    known : (n_samples,) ndarray
        What references and all else that is known beforehand add to the command.
    gains, taps : (2,), (m,) ndarray
        On the measured position and velocity; of the positions that make that velocity.
    sensed : bool
        The velocity is a sensor's instead: that of the motion.
    known_inner : (n_samples, n) ndarray
        What is known beforehand adds so much to the law's own states.
    A, B, C, back, hold, inner : ndarray
        Own states: (n, n), (n, 2) of position and velocity, (n,) each, and the first of them.
    delay : int
    limit : float
    q, v, a : float
        Position, velocity and acceleration at the start.
    first : (delay + 1,) ndarray
        Commands before the law's own: `delay` of them, then the one before the record.
    """

    known: Array
    gains: Array
    taps: Array
    sensed: bool
    known_inner: Array
    A: Array
    B: Array
    C: Array
    back: Array
    hold: NDArray[np.bool_]
    inner: Array
    delay: int
    limit: float
    q: float
    v: float
    a: float
    first: Array


def driven(
    loop: ClosedLoop, record: Record, values: Mapping[str, float], initial: Initial
) -> Driven:
    """Return the law of a loop along a record; the one place that knows its form.

    Of each record the last one is kept: a search changes the mechanics, not the law.
    """
    controller = effective_controller(loop, values)
    limit = min(controller.limit, values.get("saturation.limit", np.inf))
    kept = _DRIVEN.get(record)
    asked = (limit, loop.gain, loop.joint, initial if isinstance(initial, str) else "")
    if kept is None or kept[0] is not controller or kept[1] != asked or not asked[-1]:
        kept = controller, asked, _along(loop, controller.known(record), record, limit, initial)
        _DRIVEN[record] = kept
    return kept[2]._replace(inner=kept[2].inner.copy())  # a simulation moves it on


_DRIVEN: WeakKeyDictionary[Record, tuple[Controller, tuple[Any, ...], Driven]] = WeakKeyDictionary()


def _along(
    loop: ClosedLoop, controller: Controller, record: Record, limit: float, initial: Initial
) -> Driven:
    law, delay = controller.law(record.dt), controller.delay
    seen = Seen.of(controller, record, loop.command(record), loop.joint)
    known, known_inner = law.known(seen.inputs[:, :3])
    start, first = _initial(record, initial, delay, seen)
    inner = _inner_state(law, initial, seen, delay, record.dt, limit)
    return Driven(
        np.ascontiguousarray(known),
        np.ascontiguousarray(law.D[MEASURED]),
        np.ascontiguousarray(law.taps),
        law.sensed,
        np.ascontiguousarray(known_inner),
        np.ascontiguousarray(law.A),
        np.ascontiguousarray(law.B[:, MEASURED]),
        np.ascontiguousarray(law.C),
        np.ascontiguousarray(law.back),
        np.ascontiguousarray(law.hold),
        inner,
        delay,
        limit,
        *start,
        first,
    )


def effective_controller(loop: ClosedLoop, values: Mapping[str, float]) -> Controller:
    """Return the controller, with the mismatch that the model gives it."""
    own = "controller-mismatch."
    changes = {k.removeprefix(own): v for k, v in values.items() if k.startswith(own) and v}
    return loop.controller.with_mismatch(**changes) if changes else loop.controller


def _initial(record: Record, initial: Any, delay: int, seen: Seen) -> tuple[Motion, Array]:
    """Return the motion, and the commands that the controller gave before the record."""
    if initial == "record":
        first = np.append(seen.command[:delay], seen.command[0])
        return started(record.q[:, 0], record.dt), first
    if initial == "rest":
        start = record.q if record.q_ref is None else record.q_ref
        return (float(start[0, 0]), 0.0, 0.0), np.zeros(delay + 1)
    try:
        q0, v0 = (float(x) for x in initial)
    except (TypeError, ValueError):
        raise AxisError(f"initial is {initial!r}; it is 'record', 'rest' or (q, dq)") from None
    return (q0, v0, 0.0), np.zeros(delay + 1)


def _inner_state(
    law: LinearLaw, initial: Any, seen: Seen, delay: int, dt: float, limit: float
) -> Array:
    """Return the controller's own state: that in which the record begins, or a settled one."""
    if not len(law.C) or isinstance(initial, tuple):
        return np.zeros(len(law.C))
    if initial == "rest":
        start = seen.inputs[0].copy()
        start[3:] = start[0], 0.0  # on its reference
        return law.settled(start)
    n = min(len(seen.command) - delay, max(_START_SAMPLES, round(_BEGINNING / dt)))
    command = seen.command[delay : delay + n]
    return law.began(seen.inputs[:n], command, Clipped.of(command, limit, limit))


def started(q: Array, dt: float) -> Motion:
    """Return the motion at the start of a recorded position (n_samples,)."""
    third = np.diff(q[: _START_SAMPLES + 1], 3)
    noise = np.sqrt(np.mean(third**2) / 20.0) if len(third) else 0.0  # white: 1 + 9 + 9 + 1
    for n in _FEWER:
        y, k = q[: n + 1] - q[0], np.arange(min(n + 1, len(q)))
        (start, slope, bend), _ = np.polynomial.polynomial.polyfit(k, y, 2, full=True)
        rest = y - (start + slope * k + bend * k**2)
        if n * dt <= _START_TIME or np.sqrt(np.mean(rest**2)) <= _BENT * noise:
            break
    return float(start + q[0]), float(slope / dt), float(2.0 * bend / dt**2)


def _added(record: Record, values: Mapping[str, float]) -> Array:
    """Return what is added to the command, (n_samples,) or empty."""
    if record.added is None:
        return np.zeros(0)
    return record.added[:, 0] * (1.0 + values.get("controller-mismatch.added", 0.0))


def _rigid(loop: ClosedLoop, values: Mapping[str, float], dt: float) -> dict[str, float]:
    """Return the frequencies that are as good as rigid, as high as that takes."""
    named = loop.parameters.items()
    return {n: min(values[n], p.rigid / dt) for n, p in named if p.rigid < np.inf}


def _links(record: Record, link: ArrayLike | None) -> tuple[Array, Array]:
    """Return the known load, and what the last mass has more, (n_samples,) each or empty."""
    if link is None:
        none = np.zeros(0)
        return none if record.load is None else np.ascontiguousarray(record.load[:, 0]), none
    load, more = (np.ascontiguousarray(x) for x in np.asarray(link, dtype=float).T)
    return load, more


def _noise(name: str, noise: ArrayLike | None, n: int) -> Array:
    if noise is None:
        return np.zeros(0)
    array = np.ravel(np.asarray(noise, dtype=float))
    if len(array) != n:
        raise ShapeError(f"{name} has {len(array)} samples and the record {n}; both must match")
    return array
