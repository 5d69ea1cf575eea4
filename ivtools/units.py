"""Units and prefixes: read as people write them, converted to SI, and written with a prefix."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from math import inf, isfinite, pi
from typing import NamedTuple

from ivtools.errors import IVToolsError

__all__ = ["JOINTS", "Unit", "parse", "prefixed", "quantity"]

LONGEST = 40  # characters of a unit
_BASE = ("m", "kg", "s", "A", "rad", "counts", "%")
_PREFIXES = {"M": 1e6, "k": 1e3, "c": 1e-2, "d": 1e-1, "da": 10.0,
             "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9, "p": 1e-12}  # fmt: skip
#: Symbols that take a prefix: factor to SI, and powers of m, kg, s, A, rad, counts, %.
_SYMBOLS: dict[str, tuple[float, str]] = {
    "m": (1.0, "m"),
    "s": (1.0, "s"),
    "g": (1e-3, "kg"),
    "A": (1.0, "A"),
    "V": (1.0, "m m kg s-1 s-1 s-1 A-1"),
    "N": (1.0, "m kg s-1 s-1"),
    "Hz": (1.0, "s-1"),
    "rad": (1.0, "rad"),
    "deg": (pi / 180.0, "rad"),
}
#: Symbols that take none.
_FIXED: dict[str, tuple[float, str]] = {
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    "rev": (2.0 * pi, "rad"),
    "gon": (pi / 200.0, "rad"),
    "arcmin": (pi / 10800.0, "rad"),
    "arcsec": (pi / 648000.0, "rad"),
    "inch": (0.0254, "m"),
    "ft": (0.3048, "m"),
    "lbf": (4.4482216152605, "m kg s-1 s-1"),
    "ozf": (0.27801385095378, "m kg s-1 s-1"),
    "kgf": (9.80665, "m kg s-1 s-1"),
    "counts": (1.0, "counts"),
    "%": (0.01, "%"),
    "‰": (0.001, "%"),
}
#: Other spellings, in lower case; what is written in SI symbols has precedence.
_SPELLINGS = {
    "s": "sec secs second seconds sek sekunde sekunden seconde secondes с сек [s]",
    "ms": "msec msecs millisecond milliseconds millisekunden millisecondes мс",
    "us": "usec usecs microsecond microseconds mikrosekunden мкс",
    "ns": "nsec nanosecond nanoseconds",
    "min": "minute minutes minuten",
    "m": "meter metre meters metres mètre mètres м",
    "mm": "millimeter millimetre millimeters millimetres мм",
    "um": "micron microns micrometer mikrometer",
    "inch": "in inches zoll",
    "ft": "foot feet",
    "deg": "° degree degrees grad degré degrés degre degres graus grados gradi град",
    "rad": "radian radians рад",
    "rev": "rot turn turns revs revolution revolutions umdr umdrehung umdrehungen tour tours tr u "
    "об",
    "rev/min": "rpm u/min upm 1/min min-1 min^-1 tr/min r/min umdr/min об/мин",
    "rev/s": "rps u/s tr/s r/s",
    "counts": "count cnt cnts cts pulse 脉冲 inc incr incs increments inkremente "
    "ticks tick pulses imp lsb",
    "%": "percent pct prozent %rated",
    "‰": "permille promille",
    "V": "volt volts в",
    "A": "amp amps ampere amperes arms a_rms apk а",
    "N": "newton newtons н",
    "N m": "nm newtonmeter newtonmetre н·м нм",
    "mN m": "mnm",
    "kN m": "knm",
    "cN m": "cnm",
    "N cm": "ncm",
    "N mm": "nmm",
    "ozf inch": "ozin oz-in oz.in ozfin",
    "lbf inch": "lbin lb-in lb.in",
    "lbf": "lb",
}
_NAMES = {name: unit for unit, names in _SPELLINGS.items() for name in names.split()}


class JointUnits(NamedTuple):
    """Units of a joint's position, force and inertia."""

    length: str
    force: str
    inertia: str


#: By the kind of joint.
JOINTS = {
    "prismatic": JointUnits("m", "N", "kg"),
    "revolute": JointUnits("rad", "N m", "kg m2"),
}

_FACTOR = re.compile(
    r"([^\d\s*·./^()²³⁻¹+-]+)\^?([²³]|⁻¹|⁻²|-?\d)?|(0[.]\d{0,8}[1-9]|[1-9]\d{0,8})"
)
_POWERS = {"": 1, "²": 2, "³": 3, "⁻¹": -1, "⁻²": -2}
_SMALL = ((1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n"))
_LARGE = 1e5  # from here on a number with fewer digits has an exponent
_WITH_PREFIX = ("m", "rad", "s", "V", "A", "N", "N m")


@dataclass(frozen=True)
class Unit:
    """A unit.

    Attributes
    ----------
    text : str
        As it was written.
    factor : float
        What one of it is in SI; a per cent is 0.01, a count 1.
    powers : tuple of int
        Of m, kg, s, A, rad, counts and %, so that an angle is no length and no number.
    """

    text: str
    factor: float
    powers: tuple[int, ...]

    @property
    def si(self) -> str:
        """The SI unit of the same kind, in base units if it has no name here.

        Examples
        --------
        >>> parse("mm").si, parse("rpm").si, parse("kHz").si
        ('m', 'rad/s', 's-1')
        """
        named = {parse(name).powers: name for name in _NAMED}
        power = {1: ""}
        parts = (f"{b}{power.get(p, p)}" for b, p in zip(_BASE, self.powers, strict=True) if p)
        return named.get(self.powers) or " ".join(parts)

    def to(self, other: str) -> float:
        """Return the factor from this unit to another of the same kind.

        Raises
        ------
        IVToolsError
            If the other is of another kind.

        Examples
        --------
        >>> parse("km").to("m")
        1000.0
        """
        target = parse(other)
        if target.powers != self.powers:
            raise IVToolsError(
                f"{self.text} cannot be converted to {other}; it is another quantity"
            )
        return self.factor / target.factor


_NAMED = ("s", "m", "rad", "m/s", "rad/s", "m/s2", "rad/s2", "N", "N m", "V", "A", "kg", "kg m2",
          "counts", "counts/s", "%")  # fmt: skip


@lru_cache(maxsize=512)
def parse(text: str) -> Unit:
    """Read a unit: ``mm``, ``deg/s``, ``1/min``, ``mN m``, ``0.1 %``, ``[µm]``, ``U/min``.

    Raises
    ------
    IVToolsError
        If it is not known.

    Examples
    --------
    >>> parse("mm").factor, parse("rpm").factor == parse("U/min").factor
    (0.001, True)
    >>> parse("Nm").powers == parse("N m").powers != parse("N/m").powers
    True
    """
    plain = text.strip().strip("[]").strip() if len(text) <= LONGEST else ""
    found = _known(plain) or _product(plain)
    if found is None:
        raise IVToolsError(
            f"unit {text[:LONGEST]!r} is not known; known are m, mm, um, inch, rad, deg, rev, "
            "counts, s, ms, us, min, rpm, V, A, N, N m, %, and products and quotients of them"
        )
    return Unit(plain, *found)


def _known(name: str) -> tuple[float, tuple[int, ...]] | None:
    """Return factor and powers of a name that stands for a unit as a whole."""
    if name in _FIXED:
        factor, base = _FIXED[name]
        return factor, _powers(base)
    for symbol, (factor, base) in _SYMBOLS.items():
        before = name.removesuffix(symbol)
        if name.endswith(symbol) and (not before or before in _PREFIXES):
            return factor * _PREFIXES.get(before, 1.0), _powers(base)
    spelt = _NAMES.get(name.lower())
    if spelt is None:
        return None
    return _product(spelt) if any(mark in spelt for mark in " /") else _known(spelt)


def _powers(base: str) -> tuple[int, ...]:
    parts = base.split()
    return tuple(parts.count(b) - parts.count(f"{b}-1") for b in _BASE)


def _product(text: str) -> tuple[float, tuple[int, ...]] | None:
    """Return factor and powers of a product or quotient of names."""
    factor, powers, sign, place = 1.0, [0] * len(_BASE), 1, 0
    text = text.replace("(", " ").replace(")", " ").replace("**", "^").strip()
    while place < len(text):
        if text[place] in " *·.":
            place += 1
            continue
        if text[place] == "/":
            sign, place = -1, place + 1
            continue
        match = _FACTOR.match(text, place)
        if match is None:
            return None
        place = match.end()
        if match[3]:
            factor *= float(match[3]) ** sign
            continue
        unit, power = _known(match[1]), match[2] or ""
        if unit is None:
            return None
        times = sign * (_POWERS[power] if power in _POWERS else int(power))
        factor *= unit[0] ** times
        powers = [p + times * u for p, u in zip(powers, unit[1], strict=True)]
    return (factor, tuple(powers)) if any(powers) and 0.0 < factor < inf else None


def prefixed(size: float, unit: str) -> tuple[float, str]:
    """Return a factor and the unit with the prefix that make a small value readable.

    Examples
    --------
    >>> prefixed(2e-5, "m"), prefixed(3.0, "N m"), prefixed(0.01, "kg")
    ((1000000.0, 'µm'), (1.0, 'N m'), (1.0, 'kg'))
    """
    takes = unit in _WITH_PREFIX or unit.split("/")[0] in _WITH_PREFIX[:3]
    if not takes or not isfinite(size) or size == 0.0:
        return 1.0, unit
    factor, prefix = next((s for s in _SMALL if abs(size) * s[0] >= 0.1), (1.0, ""))
    return factor, prefix + unit


def plural(count: int, what: str) -> str:
    """Return a number of things.

    Examples
    --------
    >>> plural(1, "record"), plural(2, "record")
    ('1 record', '2 records')
    """
    return f"{count} {what}{'s' * (count != 1)}"


def percent(share: float) -> str:
    """Return a share in per cent with two digits or one decimal, the same before and after.

    Examples
    --------
    >>> percent(0.0774), percent(0.02), percent(7.06), percent(0.000312), percent(1e-9)
    ('7.7 %', '2.0 %', '706 %', '0.031 %', 'less than 0.01 %')
    """
    x = 100.0 * share
    if 0.0 < x < 0.01:
        return "less than 0.01 %"
    return f"{x:.0f} %" if x >= 10.0 else f"{x:.1f} %" if x >= 0.1 else f"{x:.2g} %"


def plain_number(value: float, digits: int = 3, sign: str = "") -> str:
    """Return a number with so many digits, and up to five before the point.

    Examples
    --------
    >>> plain_number(0.12345), plain_number(1234.5), plain_number(99.96, 2)
    ('0.123', '1234', '100')
    >>> plain_number(140.2, 2, sign="+"), plain_number(99_999.6, 2)
    ('+140', '1e+05')
    """
    whole = 10.0**digits - 0.5 <= abs(value) < _LARGE - 0.5
    return f"{value:{sign}.0f}" if whole else f"{value:{sign}.{digits}g}"


def setting(value: float, unit: str) -> str:
    """Return a setting with its unit; a relative error, whose unit is "%", with its sign.

    Examples
    --------
    >>> setting(-0.0833, "%"), setting(14.02, "%"), setting(141.6, "Hz"), setting(0.12, "")
    ('-8.33 %', '+1402 %', '141.6 Hz', '0.12')
    """
    return f"{plain_number(100.0 * value, sign='+')} %" if unit == "%" else quantity(value, unit)


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """Return a value with its unit, small ones with a prefix.

    Examples
    --------
    >>> quantity(0.0131512, "m/s"), quantity(-37.18, "N s/m"), quantity(0.25e-3, "s")
    ('13.15 mm/s', '-37.18 N s/m', '0.25 ms')
    >>> quantity(119.4, "N", 2), quantity(2.3031e6, "N/m")
    ('119 N', '2.303e+06 N/m')
    """
    factor, unit = prefixed(value, unit)
    return f"{plain_number(value * factor, digits)} {unit}".rstrip()
