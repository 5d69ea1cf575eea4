"""What the name of a column says, in several languages and in vendors' ways."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

from ..columns import plain_name
from ..errors import IVToolsError
from ..units import parse

#: SI units of a quantity.
KINDS = {
    "time": ("s", "counts", "s-1"),
    "position": ("m", "rad", "counts", "%"),
    "velocity": ("m/s", "rad/s", "counts/s", "%"),
    "force": ("N", "N m", "%"),
    "current": ("A", "%"),
    "voltage": ("V", "%"),
    "command": ("V", "A", "N", "N m", "%", "counts"),
}
#: Parts of words, and whole words behind the bar; the first quantity that is found counts.
_QUANTITIES: tuple[tuple[str, str], ...] = (
    ("other",
     "schlepp fehler error erro deviation ecart abweichung uchyb beschleun accel temperat "
     "statusw controlw followingerr jerk ruck status zwischenkreis dclink dcbus busvolt supply "
     "versorgung | err lag diff acc ddq qdd mode state "
     "temp flag enable a"),
    ("velocity",
     "geschw drehzahl veloc speed vitesse omega vitess velo snelheid predkosc hastighet "
     "rychlost | v vel dq qd n w spd qdot dot thetad xd rpm vact vsoll vist"),
    ("time",
     "zeit time stamp temps tiempo tempo uhr clock millis sekunde | tijd czas tid ido t ts "
     "sec secs elapsed zyklus cycle index sample nr idx k"),
    ("force",
     "moment torque kraft force couple effort trq coppia koppel | par tau mom frc f m tq"),
    ("current",
     "strom current courant corrente corriente ampere intensit | prad stroom strom i iq cur "
     "curr isq"),
    ("voltage",
     "spannung voltage tension pwm duty analogout | u dac volt uq"),
    ("position",
     "posit posiz posic poloh konum pozic pozyc positie lage winkel vinkel angle encoder angolo "
     "stellung deplacement angul istweg sollweg rotor | pos q x y phi theta th enc ang alpha weg s "
     "z p px pfb pv"),
    ("command",
     "stell command ausgang output ctrl control regler commande stuursign beavatkoz | nu "
     "cmd out mv"),
)  # fmt: skip
_REFERENCE = (
    "soll setp consign target desir command demand refer ziel fuehr vorgabe nominal riferim "
    "wunsch planned desead desejad gewenst boerv zadan alapjel ref | set sp des cmd cons dem "
    "goal plan r"
)
_ACTUAL = (
    "actual istw istl istp istg istd istm istz mesur measur medid feedback gemess reel zmierz "
    "| act ist mes meas fb real"
)
#: Words in other scripts, and what they mean.
_SCRIPTS = {
    "角度": "angle", "時刻": "time",
    "时间": "time", "時間": "time", "время": "time", "位置": "position", "положен": "position",
    "позици": "position", "угол": "angle", "速度": "speed", "转速": "speed", "скорост": "speed",
    "оборот": "speed", "转矩": "torque", "力矩": "torque", "扭矩": "torque", "トルク": "torque",
    "момент": "torque", "усили": "force", "сила": "force", "电流": "current", "電流": "current",
    "ток": "current", "电压": "voltage", "電圧": "voltage", "напряж": "voltage",
    "误差": "error", "偏差": "error", "ошибк": "error", "指令": "command", "给定": "set",
    "设定": "set", "目标": "target", "задан": "target", "уставк": "target", "实际": "actual",
    "反馈": "actual", "現在": "actual", "факт": "actual", "измер": "actual",
}  # fmt: skip
_SUFFIX = {
    "deg_s": "deg/s", "rad_s": "rad/s", "mm_s": "mm/s", "m_s": "m/s", "rad_per_s": "rad/s",
    "deg_per_s": "deg/s", "mm_per_s": "mm/s", "m_per_s": "m/s", "rads": "rad/s", "mms": "mm/s",
    "degs": "deg/s", "pct": "%", "percent": "%",
}  # fmt: skip
_VAGUE = ("command", "position", "time")  # of a word that may mean something else
_NO_SUFFIX = ("in", "u", "g", "h", "tr", "i", "t", "r", "inc1")


@dataclass(frozen=True)
class Said:
    """What a name says.

    Attributes
    ----------
    quantity : str
        A key of `KINDS`, ``"other"``, or empty.
    side : str
        ``"reference"``, ``"actual"``, or empty.
    unit : str
        As written; empty if it says none.
    """

    quantity: str
    side: str
    unit: str


def read(name: str) -> Said:
    """Read the name of a column.

    Examples
    --------
    >>> read("Lagesollwert [mm]")
    Said(quantity='position', side='reference', unit='mm')
    >>> read("Axis1.ActVelo_mm_s")
    Said(quantity='velocity', side='actual', unit='mm/s')
    """
    plain, unit = _unit_of(name[:200])
    text, tokens = _tokens(plain)
    quantity = _first(text, {word for word in tokens if len(word) > 1}) or _first("", tokens)
    if unit and not _fits(unit, quantity) and quantity in _VAGUE:
        quantity = _of_unit(unit) or quantity
    unit = unit if _fits(unit, quantity) else ""
    side = "reference" if _holds(_REFERENCE, text, {w for w in tokens if len(w) > 1}) else ""
    if not side:
        actual = _holds(_ACTUAL, text, tokens)
        side = "actual" if actual else "reference" if _holds(_REFERENCE, "", tokens) else ""
    if not quantity and unit:
        quantity = _of_unit(unit)
    if quantity == "command" and side == "reference" and tokens & {"q", "x", "p"}:
        quantity = "position"  # q_cmd
    return Said(quantity, side, unit)


def _first(text: str, tokens: set[str]) -> str:
    """Return the first quantity that a text holds a word of."""
    return next((q for q, words in _QUANTITIES if _holds(words, text, tokens)), "")


def _of_unit(unit: str) -> str:
    """Return the quantity that a unit alone tells."""
    si = parse(unit).si
    quantities = ("time", "position", "velocity", "force", "current", "voltage")
    return next((q for q in quantities if si in KINDS[q][:2] and si != "counts"), "")


def _holds(words: str, text: str, tokens: set[str]) -> bool:
    parts, _, whole = words.partition("|")
    return any(part in text for part in parts.split()) or bool(tokens & set(whole.split()))


def _tokens(name: str) -> tuple[str, set[str]]:
    """Return a name in plain lower-case letters, and its words."""
    for foreign, word in _SCRIPTS.items():
        if foreign in name.lower():
            name = name.lower().replace(foreign, f" {word} ")
    for letter, plain in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss"), ("Ä", "Ae")):
        name = name.replace(letter, plain)
    plain = unicodedata.normalize("NFKD", name.replace("θ", "theta").replace("φ", "phi"))
    plain = "".join(c for c in plain if c.isascii()).replace("τ", "tau")
    words = {w.lower() for w in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", plain)}
    bare = {re.sub(r"(ref|act|ist|soll|cmd|des|set|meas)$", "", word) for word in words}
    return re.sub(r"[^a-z]", "", plain.lower()), words | bare - {""}


def _unit_of(name: str) -> tuple[str, str]:
    """Split a name into itself and the unit that it ends in."""
    plain, unit = plain_name(name)
    if unit:
        return plain, unit if known(unit) else ""
    for mark in (" in ", "/", " "):
        before, found, after = name.strip().rpartition(mark)
        if found and before and known(after) and after not in _NO_SUFFIX:
            return before, after
    lower = name.strip().lower()
    for ending, meant in _SUFFIX.items():
        if lower.endswith("_" + ending) or lower.endswith("." + ending):
            return name.strip()[: -len(ending) - 1], meant
    before, found, after = name.strip().rpartition("_")
    if found and before and known(after) and after.lower() not in _NO_SUFFIX:
        return before, after
    return name, ""


def known(unit: str) -> bool:
    """Whether a text is a unit."""
    try:
        parse(unit)
    except IVToolsError:
        return False
    return True


def _fits(unit: str, quantity: str) -> bool:
    return bool(unit) and (quantity not in KINDS or parse(unit).si in KINDS[quantity])
