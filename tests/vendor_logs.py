"""Logs in the manner of particular makes and languages: their headers, stamps and spare columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from ivtools.loop import ClosedLoop
from ivtools.loop.controllers import Controller
from ivtools.physics import find
from ivtools.record import Record
from ivtools.units import parse


@dataclass(frozen=True)
class Make:
    """How a make writes its logs.

    Attributes
    ----------
    joint : str
    names : dict of str to (str, str)
        Signal to the header's name and the unit as the make spells it.
    units : dict of str to str
        The same units as ivtools spells them, where those differ.
    separator, decimal : str
    head : callable
        From header names and units to the lines above the data.
    stamps : str
        ``"time"``, ``"clock"`` (hours, minutes, seconds), ``"date"``, ``"counter"``.
    spare : tuple of str
        Columns that are no signal of the axis; a digit tells apart several.
    law : str
        ``"p-pi"``, ``"pi-velocity"`` (no position reference is logged) or ``"cascade-pd"``.
    rated : bool
        Whether the command is a share of a rated value, stated in the header.
    """

    joint: str
    names: dict[str, tuple[str, str]]
    units: dict[str, str]
    separator: str
    decimal: str
    head: Callable[[list[str], list[str]], list[list[str]]]
    stamps: str = "time"
    spare: tuple[str, ...] = ()
    law: str = "p-pi"


def _names(names: list[str], units: list[str]) -> list[list[str]]:
    return [names]


def _brackets(names: list[str], units: list[str]) -> list[list[str]]:
    return [[f"{n} [{u}]" if u else n for n, u in zip(names, units, strict=True)]]


def _round(names: list[str], units: list[str]) -> list[list[str]]:
    return [[f"{n} ({u})" if u else n for n, u in zip(names, units, strict=True)]]


def _slash(names: list[str], units: list[str]) -> list[list[str]]:
    return [[f"{n} / {u}" if u else n for n, u in zip(names, units, strict=True)]]


def _in(names: list[str], units: list[str]) -> list[list[str]]:
    return [[f"{n} in {u}" if u else n for n, u in zip(names, units, strict=True)]]


def _under(names: list[str], units: list[str]) -> list[list[str]]:
    return [[f"{n}_{u}" if u else n for n, u in zip(names, units, strict=True)]]


def _two(names: list[str], units: list[str]) -> list[list[str]]:
    return [names, units]


def _two_brackets(names: list[str], units: list[str]) -> list[list[str]]:
    return [names, [f"[{u}]" if u else "-" for u in units]]


LINEAR, TURNING = "prismatic", "revolute"
_NM = {"nu": "N m"}

MAKES: dict[str, Make] = {
    "spanish": Make(
        LINEAR,
        {"t": ("Tiempo", "s"), "q": ("Posición real", "mm"), "q_ref": ("Consigna posición", "mm"),
         "dq": ("Velocidad real", "mm/s"), "nu": ("Par", "%")},
        {}, ";", ",", _brackets, spare=("Temperatura motor",),
    ),
    "portuguese": Make(
        TURNING,
        {"t": ("Tempo", "ms"), "q": ("Posição", "graus"), "q_ref": ("Posição desejada", "graus"),
         "nu": ("Corrente", "A")},
        {"q": "deg", "q_ref": "deg"}, ";", ".", _round, spare=("Erro",),
    ),
    "dutch": Make(
        LINEAR,
        {"t": ("tijd", "s"), "q": ("positie", "m"), "q_ref": ("positie gewenst", "m"),
         "dq": ("snelheid", "m/s"), "nu": ("stuursignaal", "V")},
        {}, "\t", ".", _round,
    ),
    "swedish": Make(
        TURNING,
        {"t": ("Tid", "s"), "q": ("Vinkel", "rad"), "q_ref": ("Vinkel börvärde", "rad"),
         "dq": ("Vinkelhastighet", "rad/s"), "nu": ("Moment", "Nm")},
        _NM, ";", ",", _brackets,
    ),
    "polish": Make(
        LINEAR,
        {"t": ("Czas", "ms"), "q": ("Pozycja", "mm"), "q_ref": ("Pozycja zadana", "mm"),
         "dq": ("Prędkość", "mm/s"), "dq_ref": ("Prędkość zadana", "mm/s"), "nu": ("Prąd", "A")},
        {}, ";", ",", _two,
    ),
    "german slash": Make(
        TURNING,
        {"t": ("Zeit", "s"), "q": ("Winkel ist", "°"), "q_ref": ("Winkel soll", "°"),
         "dq": ("Drehzahl", "1/min"), "nu": ("Drehmoment soll", "Nm")},
        {"q": "deg", "q_ref": "deg", "dq": "rpm", **_NM}, ";", ",", _slash, spare=("Temperatur",),
    ),
    "german in": Make(
        LINEAR,
        {"t": ("Zeit", "ms"), "q": ("Position Ist", "mm"), "q_ref": ("Position Soll", "mm"),
         "nu": ("Kraft Sollwert", "N")},
        {}, "\t", ",", _in, spare=("Schleppfehler", "Statuswort"),
    ),
    "heidenhain": Make(
        LINEAR,
        {"t": ("Time", "ms"), "q": ("s actual", "mm"), "q_ref": ("s nominal", "mm"),
         "dq": ("v actual", "mm/min"), "dq_ref": ("v nominal", "mm/min"), "nu": ("I nominal", "A")},
        {}, ",", ".", _brackets, spare=("s diff",),
    ),
    "kollmorgen": Make(
        TURNING,
        {"t": ("Time", "ms"), "q": ("PL.FB", "deg"), "q_ref": ("PL.CMD", "deg"),
         "dq": ("VL.FB", "rpm"), "dq_ref": ("VL.CMD", "rpm"), "nu": ("IL.CMD", "A")},
        {}, ",", ".", _round,
    ),
    "acs": Make(
        LINEAR,
        {"t": ("Time", "ms"), "q": ("FPOS(0)", "mm"), "q_ref": ("RPOS(0)", "mm"),
         "dq": ("FVEL(0)", "mm/s"), "dq_ref": ("RVEL(0)", "mm/s"), "nu": ("DCOM(0)", "%")},
        {}, ",", ".", _two, spare=("PE(0)",),
    ),
    "odrive": Make(
        TURNING,
        {"t": ("timestamp", "s"), "q": ("axis0.encoder.pos_estimate", "turns"),
         "q_ref": ("axis0.controller.pos_setpoint", "turns"),
         "dq": ("axis0.encoder.vel_estimate", "turns/s"),
         "nu": ("axis0.motor.current_control.Iq_setpoint", "A")},
        {"q": "rev", "q_ref": "rev", "dq": "rev/s"}, ",", ".", _brackets, spare=("vbus_voltage",),
    ),
    "rexroth": Make(
        LINEAR,
        {"t": ("Time", "s"), "q": ("S-0-0051 Position feedback value 1", "mm"),
         "q_ref": ("S-0-0047 Position command value", "mm"),
         "dq": ("S-0-0040 Velocity feedback value", "mm/min"),
         "nu": ("S-0-0080 Torque/force command value", "%")},
        {}, ";", ".", _brackets,
    ),
    "beckhoff": Make(
        LINEAR,
        {"t": ("Name", "ms"), "q": ("Axes.Axis 1.ActPos", "mm"),
         "q_ref": ("Axes.Axis 1.SetPos", "mm"), "dq": ("Axes.Axis 1.ActVelo", "mm/s"),
         "dq_ref": ("Axes.Axis 1.SetVelo", "mm/s"), "nu": ("Axes.Axis 1.SetTorque", "%")},
        {}, "\t", ".", _two,
    ),
    "dates": Make(
        LINEAR,
        {"t": ("Timestamp", ""), "q": ("Actual position", "mm"), "q_ref": ("Set position", "mm"),
         "nu": ("Output voltage", "V")},
        {"t": "s"}, ";", ".", _brackets, stamps="date",
    ),
    "clock": Make(
        TURNING,
        {"t": ("Time", ""), "q": ("Position", "deg"), "q_ref": ("Setpoint", "deg"),
         "nu": ("Torque command", "Nm")},
        {"t": "s", **_NM}, ",", ".", _brackets, stamps="clock",
    ),
    "counter": Make(
        LINEAR,
        {"t": ("Sample", ""), "q": ("Position", "mm"), "q_ref": ("Reference", "mm"),
         "nu": ("Force", "N")},
        {"t": "s"}, ",", ".", _brackets, stamps="counter",
    ),
    "speed loop": Make(
        TURNING,
        {"t": ("time", "s"), "q": ("angle", "rad"), "dq": ("speed", "rad/s"),
         "dq_ref": ("speed reference", "rad/s"), "nu": ("current reference", "A")},
        {}, ",", ".", _brackets, law="pi-velocity",
    ),
    "spindle": Make(
        TURNING,
        {"t": ("Zeit", "ms"), "q": ("Lage", "grad"), "dq": ("n_ist", "1/min"),
         "dq_ref": ("n_soll", "1/min"), "nu": ("Iq_soll", "A")},
        {"q": "deg", "dq": "rpm", "dq_ref": "rpm"}, ";", ",", _round, law="pi-velocity",
    ),
    "cascade lab": Make(
        LINEAR,
        {"t": ("t", "s"), "q": ("y", "m"), "q_ref": ("r", "m"), "nu": ("u", "V")},
        {}, " ", ".", _names, law="cascade-pd",
    ),
    "snake": Make(
        TURNING,
        {"t": ("time", "us"), "q": ("motor_position", "rad"),
         "q_ref": ("motor_position_desired", "rad"), "dq": ("motor_velocity", "rad_s"),
         "nu": ("motor_torque_command", "Nm")},
        {"dq": "rad/s", **_NM}, ",", ".", _under, spare=("motor_temperature",),
    ),
    "camel": Make(
        LINEAR,
        {"t": ("timeStamp", "s"), "q": ("posMeas", "m"), "q_ref": ("posDes", "m"),
         "dq": ("velMeas", "m/s"), "dq_ref": ("velDes", "m/s"), "nu": ("ctrlOut", "V")},
        {}, ",", ".", _names,
    ),
    "two axes": Make(
        LINEAR,
        {"t": ("Time", "s"), "q": ("X actual position", "mm"), "q_ref": ("X target position", "mm"),
         "nu": ("X motor current", "A")},
        {}, ",", ".", _brackets, spare=("room temperature",),
    ),
    "japanese": Make(
        TURNING,
        {"t": ("Time", "ms"), "q": ("Feedback position", "pulse"),
         "q_ref": ("Command position", "pulse"), "dq": ("Feedback speed", "r/min"),
         "nu": ("Torque command", "%")},
        {"q": "counts", "q_ref": "counts", "dq": "rpm"}, ",", ".", _brackets,
    ),
    "pmac": Make(
        LINEAR,
        {"t": ("Time", "sec"), "q": ("Mtr1 Act Pos", "um"), "q_ref": ("Mtr1 Cmd Pos", "um"),
         "nu": ("Mtr1 DAC Out", "V")},
        {"t": "s"}, ",", ".", _brackets, spare=("Mtr1 Flw Err",),
    ),
    "epos": Make(
        TURNING,
        {"t": ("Time", "ms"), "q": ("Position actual value", "rad"),
         "q_ref": ("Position demand value", "rad"), "dq": ("Velocity actual value averaged", "rpm"),
         "nu": ("Current demand value", "mA")},
        {}, ";", ".", _brackets, spare=("Statusword",),
    ),
    "labview": Make(
        TURNING,
        {"t": ("X_Value", "s"), "q": ("Angle", "deg"), "q_ref": ("Angle setpoint", "deg"),
         "nu": ("Control voltage", "V")},
        {}, "\t", ",", _round,
    ),
    "hungarian": Make(
        LINEAR,
        {"t": ("idő", "s"), "q": ("mért pozíció", "mm"), "q_ref": ("pozíció alapjel", "mm"),
         "nu": ("beavatkozó jel", "V")},
        {}, ";", ",", _brackets,
    ),
    "russian": Make(
        TURNING,
        {"t": ("Время", "мс"), "q": ("Положение", "рад"), "q_ref": ("Задание положения", "рад"),
         "dq": ("Скорость", "рад/с"), "nu": ("Момент", "Н·м")},
        {"t": "ms", "q": "rad", "q_ref": "rad", "dq": "rad/s", **_NM}, ";", ",", _brackets,
    ),
    "chinese": Make(
        LINEAR,
        {"t": ("时间", "ms"), "q": ("实际位置", "mm"), "q_ref": ("指令位置", "mm"),
         "dq": ("实际速度", "mm/s"), "nu": ("转矩指令", "%")},
        {}, ",", ".", _round,
    ),
    "hydraulic": Make(
        LINEAR,
        {"t": ("time", "s"), "q": ("stroke", "mm"), "q_ref": ("stroke demand", "mm"),
         "nu": ("valve command", "V")},
        {}, ",", ".", _two_brackets, spare=("pressure A", "pressure B"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Written:
    """A log and what is true of it: as `foreign_logs.Log`."""

    path: Path
    columns: dict[str, str]
    units: dict[str, str]
    joint: str
    rate: float
    loop: ClosedLoop


def draw(rng: np.random.Generator, folder: Path, style: str) -> Written:
    """Draw a machine, run it, and write its log as that make does."""
    make = MAKES[style]
    rate = float(rng.choice([200, 250, 400, 500, 1000, 2000]))
    loop, signals = _run(rng, make, rate)
    header, units, columns = [], [], []
    rated = float(1.3 * np.abs(signals["nu"]).max())
    for signal, (name, unit) in make.names.items():
        known = make.units.get(signal, unit)
        factor = {"%": 0.01 * rated, "counts": 2 * np.pi / 4096}.get(known)
        values = signals[signal] / (parse(known).factor if factor is None else factor)
        header, units = [*header, name], [*units, unit]
        columns.append(np.round(values) if known == "counts" else values)
    for name in make.spare:
        header, units = [*header, name], [*units, ""]
        columns.append(25.0 + 3.0 * rng.random() + 0.1 * np.cumsum(rng.normal(size=len(values))))
    head = make.head(header, units)
    cells = [[_cell(x) for x in column] for column in columns]
    cells[0] = _stamps(rng, make, rate, signals["t"], cells[0])
    rows = zip(*cells, strict=True)
    if make.decimal == ",":
        rows = ([c.replace(".", ",") for c in row] for row in rows)
    lines = [make.separator.join(line) for line in (*head, *rows)]
    above = ["Trace export", f"Sampling rate: {rate:g} Hz", f"Rated value: {rated:.4g}"]
    if rng.random() < 0.5 or "%" in units or make.stamps == "counter":
        lines = above[: 3 if "%" in units else 2] + lines
    path = folder / f"{style.replace(' ', '_')}.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    beside = " [{}]" if len(head) == 2 else ""
    named = {s: head[0][i] + beside.format(units[i]) for i, s in enumerate(make.names)}
    if make.stamps == "counter":
        del named["t"]
    true = {s: make.units.get(s, u) for s, (_, u) in make.names.items() if s in named}
    return Written(path, named, true, make.joint, rate, loop)


def _cell(x: float) -> str:
    return f"{x:.8g}"


def _stamps(rng, make: Make, rate: float, t: np.ndarray, plain: list[str]) -> list[str]:
    """Return the cells of the first column."""
    if make.stamps == "counter":
        return [str(k) for k in range(len(t))]
    began = datetime(2024, 3, 1, 14, 59, 57, 250000)
    if make.stamps == "date":
        return [(began + timedelta(seconds=float(x))).isoformat(" ", "microseconds") for x in t]
    if make.stamps == "clock":
        return [(began + timedelta(seconds=float(x))).strftime("%H:%M:%S.%f") for x in t]
    return plain


def _run(rng: np.random.Generator, make: Make, rate: float):
    """Return a loop and what its log holds, in SI."""
    if make.joint == LINEAR:
        inertia, stroke = 10 ** rng.uniform(0, 2), rng.uniform(0.05, 0.8)
    else:
        inertia, stroke = 10 ** rng.uniform(-4, 0), rng.uniform(1.0, 20.0)
    width = 2 * np.pi * min(rng.uniform(6, 20), 0.03 * rate)
    kv = inertia * width
    settings = {
        "p-pi": {"kp": width / 5, "kv": kv, "ki": width / 8},
        "pi-velocity": {"kv": kv, "ki": width / 8},
        "cascade-pd": {"kp": width / 4, "kv": kv},
    }[make.law]
    terms = find(("inertia", "viscous", "coulomb", "offset"))
    loop = ClosedLoop(Controller(make.law, settings), 1.0, terms, joint=make.joint)
    theta = {
        "inertia": inertia,
        "viscous": rng.uniform(0.2, 2.0) * inertia,
        "coulomb": rng.uniform(0.3, 1.5) * inertia * stroke,
        "offset": rng.uniform(-0.3, 0.3) * inertia * stroke,
    }
    t = np.arange(int(rng.uniform(8, 15) * rate)) / rate
    q_ref = _moves(rng, t, stroke)
    dq_ref = np.gradient(q_ref, t)
    asked = Record(t, q=q_ref, q_ref=q_ref, dq_ref=dq_ref, nu=q_ref)
    noise = 2e-6 * stroke * rng.normal(size=len(t))
    made = loop.simulate(asked, theta, initial="rest", position_noise=noise)
    q = made.q[:, 0]
    dq = np.diff(q, prepend=2.0 * q[0] - q[1]) * rate  # as the drive forms it
    late = 0.2 / rate * rng.uniform(-1, 1, len(t)) * (make.stamps == "time" and rng.random() < 0.5)
    stamps = t + late + (rng.uniform(0, 50) if rng.random() < 0.3 else 0.0)
    return loop, {"t": stamps, "q": q, "q_ref": q_ref, "dq": dq, "dq_ref": dq_ref,
                  "nu": made.nu[:, 0]}  # fmt: skip


def _moves(rng: np.random.Generator, t: np.ndarray, stroke: float) -> np.ndarray:
    """Return moves of trapezoidal speed, smoothed, with pauses, there and back."""
    n, q = len(t), np.zeros(len(t))
    at, here = int(0.03 * n), 0.0
    while at < 0.9 * n:
        there, span = rng.uniform(0.0, stroke), int(rng.uniform(0.05, 0.12) * n)
        s = np.clip((np.arange(n) - at) / span, 0.0, 1.0)
        q += (there - here) * s**3 * (10 - 15 * s + 6 * s**2)
        at, here = at + span + int(rng.uniform(0.0, 0.04) * n), there
    return q
