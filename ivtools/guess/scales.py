"""Which units the signals have: as stated, by what they are to each other, else the likeliest."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..clock import Clock
from ..units import parse
from ..untidy import TURN, wraps
from .roles import Roles
from .words import known

Array = NDArray[np.float64]

#: Units of an angle that is wrapped, by its turn.
TURNS = {TURN: "rad", 360.0: "deg", 1.0: "rev"}
_SPOILT = 0.1  # share of the cells of a column that may be no numbers
_RATES = (18.0, 30_000.0)  # Hz; what loggers of controlled axes do
_USUAL = (50.0, 100.0, 125.0, 200.0, 250.0, 400.0, 500.0, 800.0, 1e3, 2e3, 4e3, 5e3, 8e3, 1e4, 2e4)
_SPEEDS = {
    "prismatic": ("m/s", "mm/s", "mm/min", "m/min", "cm/s", "um/s", "inch/s"),
    "revolute": ("rad/s", "deg/s", "rpm", "rev/s", "mrad/s"),
}
_PLACES = {
    "prismatic": ("m", "mm", "um", "cm", "inch"),
    "revolute": ("rad", "deg", "rev", "mrad"),
}
_NEAR = 0.1  # relative; how well a velocity must fit the differences of the position
_ANGLES = ("winkel", "angle", "theta", "phi", "rotor", "joint", "gelenk", "drehzahl", "rpm")
_NUMBER = r"([0-9]+(?:[.,][0-9]+)?)"


@dataclass
class Scales:
    """Units, clock and joint.

    Attributes
    ----------
    units : dict of str to str
        Of each signal; what is not here is in SI.
    joint : str
    rate : float or None
        Nominal rate, Hz, where the stamps are not good enough.
    gaps : bool
        Whether samples are missing.
    rows : str
        As in `RecordFormat`.
    unwrap : bool
        Whether the position jumps by a turn.
    rated, counts : dict of str to float
    gain : float or None
        Drive gain, if the log says so much.
    sure : dict of str to str
        Per signal: ``"stated"``, ``"from the others"``, ``"a guess"``.
    doubts : list of str
    """

    units: dict[str, str] = field(default_factory=dict)
    joint: str = "prismatic"
    rate: float | None = None
    gaps: bool = False
    rows: str = "refuse"
    unwrap: bool = False
    rated: dict[str, float] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)
    gain: float | None = None
    sure: dict[str, str] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)

    def set(self, signal: str, unit: str, sure: str) -> None:
        """Give a signal its unit."""
        self.units[signal], self.sure[signal] = unit, sure


def measure(
    table: Mapping[str, Array],
    roles: Roles,
    preamble: Sequence[str],
    turns: Mapping[str, float] | None = None,
) -> Scales:
    """Find the units of the signals of a log, of which some columns were wrapped at a turn."""
    scales = Scales()
    for signal, column in roles.columns.items():
        unit = roles.said[column].unit
        if unit:
            scales.set(signal, unit, "stated")
        elif column in (turns or {}) and signal in ("q", "q_ref"):
            scales.set(signal, TURNS[turns[column]], "from the others")  # type: ignore[index]
    scales.unwrap = any(roles.columns.get(s) in (turns or {}) for s in ("q", "q_ref"))
    step = _clock(scales, table, roles, preamble)
    _joint(scales, roles)
    _motion(scales, table, roles, step)
    _force(scales, roles, preamble)
    return scales


def tidied(table: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, float], bool]:
    """Return a table to guess from, the turns of angles that jump, and whether rows are left out.

    Whole rows only, and angles made continuous.
    """
    columns = {
        n: x for n, x in table.items() if x.ndim == 1 and np.isfinite(x).mean() > 1 - _SPOILT
    }
    if not columns or len({len(x) for x in columns.values()}) > 1:
        return dict(table), {}, False
    whole = np.column_stack(list(columns.values()))
    keep = np.asarray(np.isfinite(whole).all(axis=1))
    some = np.flatnonzero(keep & (whole != 0.0).any(axis=1))
    last = int(some[-1]) + 1 if len(some) else len(keep)
    keep[last if last < len(keep) - 1 else len(keep) :] = False
    steps = np.diff(whole[keep], axis=0)
    if len(steps) and ((steps >= 0.0).all(axis=0) & (steps > 0.0).any(axis=0)).any():  # a clock
        keep[np.flatnonzero(keep)[1:]] = (steps != 0.0).any(axis=1)
    turns = {n: turn for n, x in columns.items() if (turn := wraps(x[keep], tuple(TURNS)))}
    kept = {n: np.unwrap(x[keep], period=turns[n]) if n in turns else x[keep]
            for n, x in columns.items()}  # fmt: skip
    return kept, turns, not keep.all()


def _clock(
    scales: Scales, table: Mapping[str, Array], roles: Roles, preamble: Sequence[str]
) -> float:
    """Find the unit of the time and the rate; return the step, s."""
    told = _told_rate(preamble)
    if "t" not in roles.columns or (np.diff(table[roles.columns["t"]]) == 1.0).all():
        moved = None if told or "t" in scales.units else _moved_rate(scales, table, roles)
        if moved:
            scales.doubts.append(f"rate = {moved:g} Hz is told by dq, the derivative of q, alone")
            roles.columns.pop("t", None)
        told = told or moved
    if "t" not in roles.columns:
        scales.rate = told or 1000.0
        if not told:
            scales.doubts.append("no column is the time: rate = 1000 is a guess, put yours")
        return 1.0 / scales.rate
    t = table[roles.columns["t"]]
    step = float(np.median(np.diff(t))) or float(np.ptp(t) / (len(t) - 1))
    if "t" not in scales.units:
        fits = [u for u in ("s", "ms", "us", "ns") if _plausible(step * parse(u).factor, told)]
        if told and step == 1.0 and (np.diff(t) == 1.0).all():
            scales.rate = told
            del roles.columns["t"]
            return 1.0 / told
        if told and not fits and step == 1.0 and (t == np.round(t)).all():  # rows are missing
            scales.set("t", "counts", "from the others")
            scales.counts["t"] = told
        else:
            unit = fits[0] if fits else "s"
            scales.set("t", unit, "from the others" if len(fits) == 1 else "a guess")
            if len(fits) > 1 and not told:
                scales.doubts.append(f"t could be in {' or '.join(fits)}; {unit} is taken")
    factor = parse(scales.units["t"]).factor / scales.counts.get("t", 1.0)
    clock = Clock.of(t * factor)
    scales.gaps = len(clock.missing) > 0
    late = float(np.max(np.abs(np.diff(t * factor) * clock.rate - 1.0)))
    if not scales.gaps and late > 0.009 or scales.gaps and clock.jitter > 0.009:
        scales.rate = clock.rate
    return 1.0 / clock.rate


def _moved_rate(scales: Scales, table: Mapping[str, Array], roles: Roles) -> float | None:
    """Return the rate at which a velocity is the derivative of the position, Hz, if units say."""
    if not {"q", "dq"} <= {*scales.units} & {*roles.columns}:
        return None
    place, fast = (parse(scales.units[s]) for s in ("q", "dq"))
    if (place.si, fast.si) not in (("m", "m/s"), ("rad", "rad/s")):
        return None
    per_row = _ratio(table[roles.columns["q"]], table[roles.columns["dq"]], 1.0)
    rate = fast.factor / place.factor / per_row if per_row > 0.0 else 0.0
    if not _RATES[0] < rate < _RATES[1]:
        return None
    return next((r for r in _USUAL if abs(r / rate - 1.0) < _NEAR), float(f"{rate:.3g}"))


def _plausible(step: float, told: float | None) -> bool:
    if told:
        return abs(step * told - 1.0) < 0.1
    return _RATES[0] < 1.0 / step < _RATES[1]


def _told_rate(preamble: Sequence[str]) -> float | None:
    """Return the rate that lines above the header state, Hz."""
    for line in preamble[:200]:
        lower = line.lower()[:500]
        words = ("sampl", "abtast", "rate", "cycle", "zyklus", "echantill", "period", "frequen")
        if any(word in lower for word in words):
            for number, unit in re.findall(_NUMBER + r"\W{0,3}(khz|hz|ms|us|µs|s)\b", lower):
                value = float(number.replace(",", "."))
                unit = {"khz": "kHz", "hz": "Hz"}.get(unit, unit)
                size = value * parse(unit).factor
                rate = size if unit.endswith("Hz") else 1.0 / size if size else 0.0
                if 1.0 < rate < 1e6:
                    return rate
    return None


def _joint(scales: Scales, roles: Roles) -> None:
    """Say whether the axis turns: by units, else by words."""
    kinds = [parse(u).si for s, u in scales.units.items() if s != "t"]
    turning = sum(k in ("rad", "rad/s", "N m") for k in kinds)
    sliding = sum(k in ("m", "m/s", "N") for k in kinds)
    text = " ".join(roles.columns.values()).lower()
    scales.joint = "revolute" if turning > sliding or scales.unwrap else "prismatic"
    scales.sure["joint"] = "stated"
    if turning == sliding and not scales.unwrap:
        scales.joint = "revolute" if any(word in text for word in _ANGLES) else "prismatic"
        scales.sure["joint"] = "a guess"
        scales.doubts.append(f"no unit says whether it turns or slides: {scales.joint} is taken")


def _motion(scales: Scales, table: Mapping[str, Array], roles: Roles, step: float) -> None:
    """Find the units of position and velocity, which must be each other's derivative."""
    places, speeds = _PLACES[scales.joint], _SPEEDS[scales.joint]
    for own, reference in (("q", "q_ref"), ("dq", "dq_ref")):
        pair = [s for s in (own, reference) if s in roles.columns]
        stated = [s for s in pair if s in scales.units]
        if len(stated) == 1 and len(pair) == 2:
            other = next(s for s in pair if s not in stated)
            scales.set(other, scales.units[stated[0]], "from the others")
    velocity = next((s for s in ("dq", "dq_ref") if s in roles.columns), None)
    place = "q" if velocity != "dq_ref" or "q_ref" not in roles.columns else "q_ref"
    if velocity is not None and place in roles.columns:
        ratio = _ratio(table[roles.columns[place]], table[roles.columns[velocity]], step)
        _match(scales, roles, place, velocity, ratio, places, speeds)
    for signal, default in (("q", places[0]), ("q_ref", places[0]), ("dq", speeds[0]),
                            ("dq_ref", speeds[0])):  # fmt: skip
        if signal in roles.columns and signal not in scales.units:
            like = {"q_ref": "q", "dq_ref": "dq", "q": "q_ref", "dq": "dq_ref"}[signal]
            unit = scales.units.get(like) or _likely(scales, table, roles, signal, default)
            scales.set(signal, unit, "from the others" if like in scales.units else "a guess")
    _counts(scales, table, roles, step)


def _ratio(q: Array, dq: Array, step: float) -> float:
    """Return what the velocity column is to be multiplied by to be the derivative of q, per s."""
    width = max(3, min(len(q) // 200, 25))
    kernel = np.ones(width) / width
    slope = np.convolve(np.gradient(q, step), kernel, "valid")
    speed = np.convolve(dq, kernel, "valid")
    power = float(speed @ speed)
    return float(slope @ speed) / power if power > 0 else 0.0


def _match(
    scales: Scales,
    roles: Roles,
    place: str,
    velocity: str,
    ratio: float,
    places: Sequence[str],
    speeds: Sequence[str],
) -> None:
    """Choose the pair of units whose ratio fits; what is stated stays."""
    own = [scales.units[place]] if place in scales.units else list(places)
    fast = [scales.units[velocity]] if velocity in scales.units else list(speeds)
    if ratio <= 0:
        return
    pairs = [(p, v) for p in own for v in fast if "counts" not in parse(p).si + parse(v).si]
    if not pairs or "%" in (parse(own[0]).si, parse(fast[0]).si):
        return

    def off(pair: tuple[str, str]) -> float:
        return abs(ratio * parse(pair[0]).factor / parse(pair[1]).factor - 1.0)

    good = [pair for pair in pairs if off(pair) < _NEAR]
    if not good:
        if len(pairs) == 1:
            scales.doubts.append(
                f"{velocity} in {fast[0]} is {1 / max(off(pairs[0]) + 1, 1e-9):.3g} times the "
                f"derivative of {place} in {own[0]}; check both units"
            )
        return
    best = good[0]
    for signal, unit in zip((place, velocity), best, strict=True):
        if signal not in scales.units:
            sure = "from the others" if len({pair[0] for pair in good}) == 1 else "a guess"
            scales.set(signal, unit, sure)


def _likely(
    scales: Scales, table: Mapping[str, Array], roles: Roles, signal: str, default: str
) -> str:
    """Return the likeliest unit of a position or velocity that nothing states."""
    x = table[roles.columns[signal]]
    size = float(np.ptp(x))
    whole = bool((x == np.round(x)).all()) and size > 500
    if signal in ("q", "q_ref") and whole:
        return "counts"
    limit = {"m": 5.0, "rad": 40.0, "m/s": 5.0, "rad/s": 400.0}[default]
    coarse = {"m": "mm", "rad": "deg", "m/s": "mm/s", "rad/s": "deg/s"}[default]
    unit = coarse if size > limit else default
    scales.doubts.append(f"no unit is stated for {signal}: {unit} is taken, by its size")
    return unit


def _counts(scales: Scales, table: Mapping[str, Array], roles: Roles, step: float) -> None:
    """Find the counts per unit, where a velocity in other units tells them."""
    counted = [s for s in ("q", "q_ref") if parse(scales.units.get(s, "m")).si == "counts"]
    if not counted:
        return
    dq = scales.units.get("dq") if "dq" in roles.columns else None
    if dq and parse(dq).si in ("m/s", "rad/s"):
        ratio = _ratio(table[roles.columns["q"]], table[roles.columns["dq"]], step)
        per_unit = float(f"{ratio / parse(dq).factor:.4g}")
        scales.counts["q"] = per_unit
        scales.sure["counts"] = "from the others"
        return
    scales.counts["q"] = 1.0
    scales.doubts.append("put counts_per_unit, counts per m or rad: 1 is no guess at all")


def _force(scales: Scales, roles: Roles, preamble: Sequence[str]) -> None:
    """Find the unit of the command, and what makes a force of it."""
    if "nu" not in roles.columns:
        return
    natural = {"prismatic": "N", "revolute": "N m"}[scales.joint]
    if "nu" not in scales.units:
        quantity = roles.said[roles.columns["nu"]].quantity
        unit = {"force": natural, "current": "A"}.get(quantity, "V")
        scales.set("nu", unit, "a guess")
        scales.doubts.append(f"no unit is stated for the command: {unit} is taken")
    si = parse(scales.units["nu"]).si
    if si == "%":
        told = _told(preamble, ("rated", "nenn", "nominal", "bemess", "peak", "100"))
        value, unit = told or (1.0, "")
        scales.rated["nu"] = value
        si = unit
        if told is None:
            scales.doubts.append(
                "the command is in %: put what 100 % is as rated (1 is no guess at all; masses and "
                "forces scale with it)"
            )
    if si in ("N", "N m"):
        scales.gain = 1.0
        return
    constant = _told(preamble, ("constant", "konstante", "kt", "gain"))
    if constant is not None:
        scales.gain = constant[0]
        return
    scales.doubts.append(
        f"[drive] gain, {natural} per unit of the command, is not in a log: 1 is no guess at all; "
        "masses and forces scale with it"
    )


def _told(preamble: Sequence[str], words: Sequence[str]) -> tuple[float, str] | None:
    """Return a number with its unit, in SI, that a line above the header states."""
    for line in preamble[:200]:
        lower = line[:500]
        if not any(word in lower.lower() for word in words):
            continue
        for number, text in re.findall(_NUMBER + r"[\s;,:\t]{0,3}([A-Za-z]{1,4}(?:/A)?)", lower):
            if known(text) and parse(text).si in ("N", "N m", "A", "m2 kg s-2 A-1", "V"):
                return float(number.replace(",", ".")) * parse(text).factor, parse(text).si
            if text.endswith("/A") and known(text[:-2]):
                return float(number.replace(",", ".")) * parse(text[:-2]).factor, "N m/A"
    return None
