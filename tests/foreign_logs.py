"""Logs as other people's machines write them, drawn at random, with the truth about each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ivtools.loop import ClosedLoop
from ivtools.loop.controllers import Controller
from ivtools.physics import find
from ivtools.record import Record
from ivtools.units import parse

#: Names by style: t, q, q_ref, dq, dq_ref, nu, and one that is none of them.
STYLES = {
    "german": ("Zeit", "Istlage", "Solllage", "Istgeschwindigkeit", "Sollgeschwindigkeit",
               "Momentensollwert", "Schleppabstand"),
    "german drive": ("Zeitstempel", "Lageistwert", "Lagesollwert", "Drehzahlistwert",
                     "Drehzahlsollwert", "Strom", "Reglerstatus"),
    "french": ("Temps", "Position mesurée", "Consigne de position", "Vitesse mesurée",
               "Consigne de vitesse", "Couple", "Ecart de poursuite"),
    "french short": ("temps", "pos", "pos_consigne", "vitesse", "vitesse_consigne", "tension",
                     "etat"),
    "twincat": ("Time", "Axis1.ActPos", "Axis1.SetPos", "Axis1.ActVelo", "Axis1.SetVelo",
                "Axis1.SetTorque", "Axis1.PosDiff"),
    "twincat2": ("TimeStamp", "MAIN.fActPosition", "MAIN.fSetPosition", "MAIN.fActVelocity",
                 "MAIN.fSetVelocity", "MAIN.fCommandTorque", "MAIN.nState"),
    "siemens": ("Time", "actualPosition", "setpointPosition", "actualSpeed", "setpointSpeed",
                "torqueSetpoint", "followingError"),
    "siemens de": ("Zeit", "r_LageIst", "r_LageSoll", "n_ist", "n_soll", "M_soll", "Temperatur"),
    "elmo": ("Time", "Position", "Position Command", "Velocity", "Velocity Command",
             "Current Command", "Status Word"),
    "elmo2": ("t", "PX", "DV[3]", "VX", "DV[2]", "Active Current", "mode"),
    "ros": ("header.stamp", "joint_states.position", "command.position", "joint_states.velocity",
            "command.velocity", "joint_states.effort", "error.position"),
    "ros2": ("time", "actual.positions", "desired.positions", "actual.velocities",
             "desired.velocities", "output", "error.positions"),
    "matlab": ("t", "q", "qref", "qdot", "qdot_ref", "u", "err"),
    "lab": ("time", "theta", "theta_ref", "omega", "omega_ref", "voltage", "flag"),
    "english": ("Timestamp", "Measured Position", "Target Position", "Measured Velocity",
                "Target Velocity", "Drive Command", "Tracking Error"),
    "cia402": ("Time", "Position actual value", "Position demand value", "Velocity actual value",
               "Velocity demand value", "Target torque", "Following error actual value"),
    "italian": ("Tempo", "Posizione", "Posizione riferimento", "Velocità", "Velocità riferimento",
                "Corrente", "errore"),
    "terse": ("t", "x", "x_ref", "v", "v_ref", "u", "e_err"),
}  # fmt: skip
_PLACES = {"prismatic": ("m", "mm", "um"), "revolute": ("rad", "deg", "rev")}
_SPEEDS = {"prismatic": ("m/s", "mm/s", "mm/min"), "revolute": ("rad/s", "deg/s", "rpm")}
SIGNALS = ("t", "q", "q_ref", "dq", "dq_ref", "nu")


@dataclass(frozen=True)
class Log:
    """A log and what is true of it.

    Attributes
    ----------
    path : Path
    columns : dict of str to str
    units : dict of str to str
        SI factors and kinds are compared, not spellings.
    joint : str
    rate : float
    loop : ClosedLoop
    record : Record
    """

    path: Path
    columns: dict[str, str]
    units: dict[str, str]
    joint: str
    rate: float
    loop: ClosedLoop
    record: Record
    stated: str


def machine(rng: np.random.Generator, joint: str) -> tuple[ClosedLoop, dict[str, float], float]:
    """Return a loop under a P-PI servo, its parameters, and its stroke."""
    if joint == "prismatic":
        inertia, stroke = 10 ** rng.uniform(0, 2), rng.uniform(0.05, 0.5)
    else:
        inertia, stroke = 10 ** rng.uniform(-4, -1), rng.uniform(1.0, 12.0)
    bandwidth = 2 * np.pi * rng.uniform(8, 20)
    kv = inertia * bandwidth
    settings = {"kp": bandwidth / 5, "kv": kv, "ki": bandwidth / 8}
    theta = {
        "inertia": inertia,
        "viscous": 0.3 * inertia,
        "coulomb": 0.8 * inertia * stroke,
        "offset": 0.0,
    }
    terms = find(("inertia", "viscous", "coulomb", "offset"))
    return ClosedLoop(Controller("p-pi", settings), 1.0, terms, joint=joint), theta, stroke


def reference(rng: np.random.Generator, t: np.ndarray, stroke: float) -> np.ndarray:
    """Return a smooth reference: steps of random size, smoothed, m or rad."""
    n = len(t)
    hold = max(n // 12, 2)
    steps = np.repeat(rng.uniform(-1, 1, n // hold + 1), hold)[:n] * stroke
    steps[:hold] = steps[-hold:] = 0.0
    width = max(hold // 3, 2)
    for _ in range(3):
        steps = np.convolve(np.pad(steps, (width, width), "edge"), np.ones(width) / width, "same")
        steps = steps[width:-width]
    return steps


def draw(rng: np.random.Generator, folder: Path, style: str) -> Log:
    """Draw a machine, run it, and write its log."""
    joint = "revolute" if any(w in style for w in ("drive", "ros", "lab", "cia", "siemens")) else (
        str(rng.choice(["prismatic", "revolute"]))
    )  # fmt: skip
    loop, theta, stroke = machine(rng, joint)
    rate = float(rng.choice([250, 500, 1000, 2000]))
    t = np.arange(int(rng.uniform(6, 12) * rate)) / rate
    q_ref = reference(rng, t, stroke)
    blank = Record(t, q=q_ref, q_ref=q_ref, nu=q_ref)
    noise = rng.normal(0, 1e-5 * stroke, len(t))
    sim = loop.simulate(blank, theta, initial="rest", position_noise=noise)
    dq = np.gradient(sim.q[:, 0], t)
    signals = {"t": t, "q": sim.q[:, 0], "q_ref": q_ref, "dq": dq, "dq_ref": np.gradient(q_ref, t),
               "nu": sim.nu[:, 0]}  # fmt: skip
    record = Record(t, sim.q, q_ref=q_ref, nu=sim.nu, name="truth")
    return _written(rng, folder, style, signals, replace(loop, start=theta), record, rate)


def _written(rng, folder: Path, style: str, signals, loop, record, rate) -> Log:
    """Write signals in somebody's units and format."""
    joint, names = loop.joint, STYLES[style]
    place = int(rng.integers(3))
    units = {
        "t": str(rng.choice(["s", "ms", "us"])),
        "q": _PLACES[joint][place],
        "dq": _SPEEDS[joint][int(rng.choice([place, rng.integers(3)]))],
    }
    units |= {"q_ref": units["q"], "dq_ref": units["dq"]}
    force = "N" if joint == "prismatic" else "N m"
    word = names[5].lower()
    if any(w in word for w in ("strom", "current", "corrente")):
        units["nu"] = "A"
    elif "tension" in word or "voltage" in word or word == "u":
        units["nu"] = "V"
    else:
        units["nu"] = str(rng.choice(["%", force]))
    rated = 1.5 * float(np.abs(signals["nu"]).max())
    stated = str(rng.choice(["header", "row", "suffix", "header", "row"]))
    table, columns, header, row = {}, {}, [], []
    keep = [s for s in SIGNALS if s not in ("dq", "dq_ref") or rng.random() < 0.7]
    for signal in keep:
        values = signals[signal]
        if signal == "t":
            values = values + 0.2 / rate * rng.uniform(-1, 1, len(values)) * (rng.random() < 0.6)
            values = values - values[0] + (rng.uniform(0, 100) if rng.random() < 0.5 else 0.0)
        factor = 0.01 * rated if units[signal] == "%" else parse(units[signal]).factor
        table[signal] = values / factor
    for signal in [*keep, "other"]:
        name = names[6] if signal == "other" else names[SIGNALS.index(signal)]
        unit = "" if signal == "other" else units[signal].replace("N m", "Nm")
        shown = {"header": f"{name} [{unit}]", "suffix": f"{name}_{unit}"}.get(stated, name)
        if "/" in unit and stated == "suffix":
            shown = f"{name} ({unit})"
        columns[signal] = shown if unit else name
        header.append(columns[signal])
        row.append(unit)
    table["other"] = np.round(rng.uniform(0, 1, len(signals["t"])) > 0.5).astype(float)
    separator, decimal = [(",", "."), (";", ","), (";", "."), ("\t", "."), ("\t", ",")][
        int(rng.integers(5))
    ]
    lines = []
    if rng.random() < 0.5:
        lines = ["Axis recorder V2.1", "Date: 2024-03-01", f"Rated torque: {rated:.5g} Nm"][
            : int(rng.integers(1, 4))
        ]
    lines.append(separator.join(header))
    if stated == "row":
        lines.append(separator.join(row))
    body = np.column_stack([table[s] for s in [*keep, "other"]])
    for values in body:
        cells = separator.join(f"{v:.9g}" for v in values)
        lines.append(cells.replace(".", ",") if decimal == "," else cells)
    path = folder / f"{style.replace(' ', '_')}.csv"
    path.write_text("\n".join(lines) + "\n", encoding=str(rng.choice(["utf-8", "utf-8-sig"])))
    del columns["other"]
    return Log(path, columns, {s: units[s] for s in keep}, joint, rate, loop, record, stated)
