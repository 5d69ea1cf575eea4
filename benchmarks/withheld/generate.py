"""Draw withheld cases: random axes, references, noise and effects; write records and sealed labels.

    python -m benchmarks.withheld.generate --suite single --count 5 --seed 1 --out FOLDER

Each case is a folder with record.csv, holdout.csv and axis.toml; labels.json lies beside them and
is opened by the scorer only.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import linalg, signal

from .plant import INDEX, NAMES, run

DT = 0.001
DETECTABLE = 0.3  # whitened signature over the noise floor


@dataclass
class Axis:
    """A random axis near the EMPS in its ratios; `mass` and `length` scale it to any size."""

    p: np.ndarray
    kp: float
    kv: float
    taps: np.ndarray
    law: int
    delay: int
    gain: float
    mass: float
    length: float
    limit: float = 1e6
    noise: dict = field(default_factory=dict)


@dataclass
class Case:
    axis: Axis
    effects: dict[str, dict[str, float]]
    records: list[dict[str, np.ndarray]]
    label: dict


def draw_axis(rng: np.random.Generator) -> Axis:
    p = np.zeros(len(NAMES))
    p[0] = 95.0 * rng.uniform(0.6, 1.5)
    p[1] = 200.0 * rng.uniform(0.6, 1.5)
    p[2] = 20.0 * rng.uniform(0.5, 1.5)
    p[3] = rng.uniform(-4.0, 4.0)
    gain = 35.0 * rng.uniform(0.5, 2.0)
    law = int(rng.random() < 0.3)
    inner = rng.uniform(60.0, 100.0)  # 1/s
    outer = rng.uniform(0.25, 0.6) * inner * 2.0 if law == 0 else rng.uniform(0.25, 0.45) * inner
    kv = inner * p[0] / gain
    kp = outer if law == 0 else outer * kv
    taps = np.array([0.5, 0.5]) if rng.random() < 0.5 else np.array([1.0])
    mass, length = 10.0 ** rng.uniform(-2.5, 0.3), 10.0 ** rng.uniform(-0.5, 1.0)
    noise = {
        "force": rng.uniform(0.3, 1.2),
        "hz": rng.uniform(15.0, 80.0),
        "position": rng.uniform(0.5e-8, 3e-8),
        "quantum": rng.choice([2e-8, 5e-8, 1e-7]),
    }
    return Axis(p, kp, kv, taps, law, int(rng.random() < 0.5), gain, mass, length, noise=noise)


def reference(rng: np.random.Generator, kind: str, n: int) -> np.ndarray:
    """Position reference, m: bang-bang accelerations, moves, or a multisine."""
    t = np.arange(n) * DT
    if kind == "multisine":
        freqs = np.arange(1, 25) * 0.08 * rng.uniform(0.8, 1.2)
        amps = rng.uniform(0.5, 1.0, len(freqs)) / freqs**1.3
        x = sum(
            a * np.cos(2 * np.pi * f * t + ph)
            for a, f, ph in zip(amps, freqs, rng.uniform(0, 2 * np.pi, len(freqs)), strict=True)
        )
        x = x - x[0]
        return x * min(0.2 / np.ptp(x), 0.16 / np.max(np.abs(np.gradient(x, DT))))
    top = 0.245
    knots, at, q = [(0.0, 0.0)], 0.0, 0.0
    while at < t[-1]:
        speed = rng.uniform(0.02, 0.15) if kind == "moves" else rng.choice([0.03, 0.08, 0.15])
        goal = rng.uniform(0.0, top) if kind == "moves" else (top if q < 0.5 * top else 0.0)
        if kind != "moves" and rng.random() < 0.6:
            goal = q + (goal - q) * rng.uniform(0.2, 0.9)
        at += max(abs(goal - q) / speed, 0.08)
        q = goal
        knots.append((at, q))
    times, points = np.array(knots).T
    x = np.interp(t, times, points)
    ramp = int(rng.uniform(0.06, 0.15) / DT)
    x = signal.lfilter(np.ones(ramp) / ramp, [1.0], x)
    if kind == "moves":
        soft = int(0.03 / DT)
        x = signal.lfilter(np.ones(soft) / soft, [1.0], x)
    return x


def added(rng: np.random.Generator, axis: Axis, n: int) -> np.ndarray:
    size = rng.uniform(40.0, 120.0) / axis.gain
    period = int(rng.uniform(0.7, 1.3) / DT)
    return size * ((np.arange(n) // period) % 2) * (rng.random() < 0.6)


def forces(rng: np.random.Generator, axis: Axis, n: int) -> np.ndarray:
    a = np.exp(-2 * np.pi * axis.noise["hz"] * DT)
    white = rng.normal(size=n)
    return axis.noise["force"] * np.sqrt(1 - a * a) * signal.lfilter([1.0], [1.0, -a], white)


U = "uniform"
EFFECTS = {
    "asymmetric-viscous": lambda r: {"asym": r.uniform(20, 90) * r.choice([-1, 1])},
    "stribeck": lambda r: {"str_f": r.uniform(3, 12), "str_v": r.uniform(0.003, 0.02)},
    "presliding": lambda r: {"pre_s": 10 ** r.uniform(5.18, 6.18)},
    "polynomial-viscous": lambda r: (
        {"quad": r.uniform(250, 1000)} if r.random() < 0.5 else {"cube": r.uniform(2e3, 9e3)}
    ),
    "sqrt-viscous": lambda r: {"root": r.uniform(15, 60) * r.choice([-1, 1])},
    "position-friction": lambda r: {
        "pf_amp": r.uniform(1, 5),
        "pf_len": 0.25,
        "pf_ph": r.uniform(0, 6.28),
    },
    "load-friction": lambda r: {"load": r.uniform(0.015, 0.08)},
    "friction-drift": lambda r: (
        {"fd_c": r.uniform(1.5, 6) * r.choice([-1, 1]), "fd_tau": r.uniform(8, 40)}
        if r.random() < 0.5
        else {"fd_v": r.uniform(15, 60) * r.choice([-1, 1]), "fd_tau": r.uniform(8, 40)}
    ),
    "offset-drift": lambda r: {
        "od_a": r.uniform(1.5, 6) * r.choice([-1, 1]),
        "od_tau": r.uniform(8, 40),
    },
    "spring": lambda r: {"sp_amp": r.uniform(1, 6), "sp_len": 0.35, "sp_ph": r.uniform(-1.2, 1.2)},
    "cogging": lambda r: {
        "cog_a": r.uniform(0.6, 4),
        "cog_p": r.uniform(0.0018, 0.01),
        "cog_ph": r.uniform(0, 6.28),
        "cog_2": r.uniform(0, 0.15),
    },
    "torque-ripple": lambda r: {
        "rip_a": r.uniform(0.015, 0.08),
        "rip_p": r.uniform(0.0018, 0.01),
        "rip_ph": r.uniform(0, 6.28),
    },
    "flexibility": lambda r: {
        "flex_hz": r.uniform(25, 70),
        "flex_z": r.uniform(0.01, 0.05),
        "flex_r": r.uniform(0.08, 0.35),
        "flex_fr": r.uniform(0, 0.5),
    },
    "backlash": lambda r: {
        "gap": r.uniform(1e-5, 8e-5),
        "gap_hz": r.uniform(120, 220),
        "gap_z": 0.2,
        "flex_r": r.uniform(0.12, 0.35),
        "flex_fr": r.uniform(0.3, 0.8),
    },
    "drive-timing": lambda r: (
        {"delay": r.uniform(3e-4, 3e-3)} if r.random() < 0.5 else {"lag": r.uniform(3e-4, 3e-3)}
    ),
    "saturation": lambda r: {"clip": r.uniform(0.45, 0.8)},
    "drive-asymmetry": lambda r: {"drv_asym": r.uniform(0.01, 0.05) * r.choice([-1, 1])},
    "dead-zone": lambda r: {"dead": r.uniform(0.02, 0.1) * 35.0},
    "encoder-eccentricity": lambda r: {
        "enc_a": r.uniform(1e-6, 8e-6),
        "enc_p": r.uniform(0.0018, 0.01),
        "enc_ph": r.uniform(0, 6.28),
    },
    "controller-mismatch": lambda r: {
        r.choice(["kp", "kv", "tap"]): r.uniform(0.01, 0.05) * r.choice([-1, 1])
    },
}


def play(
    axis: Axis,
    effects: dict,
    ref: np.ndarray,
    add: np.ndarray,
    force: np.ndarray,
    noise: np.ndarray,
    quantum: float,
    change: dict | None = None,
    sub: int = 20,
) -> np.ndarray:
    """Run the plant; return (3, n)."""
    p = axis.p.copy()
    kp, kv, taps, limit = axis.kp, axis.kv, axis.taps, axis.limit
    for parameters in [*effects.values(), change or {}]:
        for key, value in parameters.items():
            if key == "kp":
                kp = kp * (1 + value)
            elif key == "kv":
                kv = kv * (1 + value)
            elif key == "tap":
                taps = np.append((1 - value) * taps, value * taps.sum())
            elif key == "clip":
                limit = value * axis.noise["peak"]
            else:
                p[INDEX[key]] = p[INDEX[key]] + value if key in ("m", "fv", "fc", "off") else value
    out = np.full((3, len(ref)), np.nan)
    dq_ref = np.gradient(ref, DT)
    run(
        DT,
        sub,
        ref,
        dq_ref,
        add,
        kp,
        kv,
        np.asarray(taps, float),
        axis.law,
        axis.delay,
        limit,
        axis.gain,
        p,
        force,
        noise,
        quantum,
        ref[0],
        out,
    )
    return out


def signature(
    axis: Axis,
    effects: dict,
    ref: np.ndarray,
    add: np.ndarray,
    force: np.ndarray,
    noise: np.ndarray,
) -> float:
    """Return the whitened size of the effects over the floor, after the base absorbed its part."""
    zero, n = np.zeros(len(ref)), len(ref)
    clean = play(axis, {}, ref, add, zero, zero, 0.0)[1]
    noisy = play(axis, {}, ref, add, force, noise, axis.noise["quantum"])[1]
    there = play(axis, effects, ref, add, zero, zero, 0.0)[1]
    sizes = {"m": 1.0, "fv": 4.0, "fc": 0.4, "off": 0.4}
    base = [play(axis, {}, ref, add, zero, zero, 0.0, {k: v})[1] - clean for k, v in sizes.items()]
    e = (noisy - clean)[300:]
    if not np.isfinite(there).all():
        return np.nan
    r = np.array([e[k:] @ e[: len(e) - k] for k in range(21)])
    r[0] *= 1.0001
    a = np.concatenate([[1.0], -linalg.solve_toeplitz(r[:-1], r[1:])])
    X = signal.lfilter(a, [1.0], np.column_stack([*base, there - clean, noisy - clean]), axis=0)[
        300:n
    ]
    beta = np.linalg.lstsq(X[:, :4], X[:, 4], rcond=None)[0]
    return float(np.std(X[:, 4] - X[:, :4] @ beta) / np.std(X[:, 5]))


def burst(rng: np.random.Generator, n: int) -> tuple[np.ndarray, list]:
    """An outside force: knocks, pushes, hums."""
    force, when = np.zeros(n), []
    for _ in range(rng.integers(1, 4)):
        length = int(rng.uniform(0.05, 1.5) / DT)
        at = int(rng.uniform(0.1, 0.9) * (n - length))
        x = np.linspace(0, 1, length)
        shapes = [
            np.sin(np.pi * x),
            np.ones(length),
            np.exp(-4 * x),
            np.sin(2 * np.pi * rng.uniform(3, 25) * x * length * DT),
        ]
        force[at : at + length] += (
            rng.uniform(5, 25) * rng.choice([-1, 1]) * shapes[rng.integers(4)]
        )
        when.append([at * DT, (at + length) * DT])
    return force, when


def background(file: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Reference of an EMPS record, and the force that an asymmetric friction model leaves, N.

    The residual of the inverse model below 60 Hz, from the raw file: real structure that no one has
    put there, of random sign and size.
    """
    from scipy.io import loadmat

    raw = loadmat(Path(os.environ["IVTOOLS_DATA"]) / file)
    q, nu, ref = (np.ravel(raw[k]).astype(float) for k in ("qm", "vir", "qg"))
    b, a = signal.butter(4, 2 * 60.0 * DT)
    q, tau = signal.filtfilt(b, a, q), signal.filtfilt(b, a, nu) * 35.15065188
    v = np.gradient(q, DT)
    up, down = v > 0, v < 0
    X = np.column_stack([np.gradient(v, DT), v * up, 1.0 * up, v * down, 1.0 * down])
    rest = tau - X @ np.linalg.lstsq(X, tau, rcond=None)[0]
    rest[:100] = rest[-100:] = 0.0
    return ref, rest


def draw(seed: int, suite: str, effects: list[str]) -> Case:
    """Draw one case; draw again until its effects are detectable."""
    for attempt in range(40):
        rng = np.random.default_rng([seed, attempt, *map(ord, suite), *map(ord, "".join(effects))])
        case = _attempt(rng, suite, effects)
        if case is not None:
            return case
    raise RuntimeError(f"no detectable case for {effects}")


def _attempt(rng: np.random.Generator, suite: str, effects: list[str]) -> Case | None:
    axis = draw_axis(rng)
    n = int(rng.uniform(16.0, 25.0) / DT)
    kind = rng.choice(["bang-bang", "moves", "multisine"])
    refs = [reference(rng, kind, n) for _ in range(2)]
    adds = [added(rng, axis, n) for _ in range(2)]
    zero = np.zeros(n)
    peaks = [np.max(np.abs(play(axis, {}, r, zero, zero, zero, 0.0)[1])) for r in refs]
    axis.noise["peak"] = float(min(peaks))
    if suite == "background":
        n = 24841
        zero = np.zeros(n)
        size = rng.uniform(0.5, 1.5) * rng.choice([-1, 1])
        pairs = [background(f, rng) for f in ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat")]
        refs, adds = [r for r, _ in pairs], [zero, zero]
    values = {e: EFFECTS[e](rng) for e in effects}
    fs = [forces(rng, axis, n) for _ in range(2)]
    ns = [axis.noise["position"] * rng.normal(size=n) for _ in range(2)]
    sizes = {}
    for e in effects:
        if e == "saturation":
            continue
        s = min(signature(axis, {e: values[e]}, *x) for x in zip(refs, adds, fs, ns, strict=True))
        sizes[e] = s
        if not s >= DETECTABLE:
            return None
    when: list = []
    if suite == "background":
        fs = [f + size * b for f, (_, b) in zip(fs, pairs, strict=True)]
    if suite == "bursts":
        more, when = burst(rng, n)
        fs[int(rng.integers(2))] += more
    runs = [
        play(axis, values, *x, axis.noise["quantum"]) for x in zip(refs, adds, fs, ns, strict=True)
    ]
    if not all(np.isfinite(x).all() for x in runs):
        return None
    records = [_scaled(axis, r, a, x) for r, a, x in zip(refs, adds, runs, strict=True)]
    kind = "emps" if suite == "background" else kind
    label = {
        "effects": list(effects),
        "suite": suite,
        "reference": str(kind),
        "signature": sizes,
        "events": when,
        "parameters": {e: {k: float(v) for k, v in p.items()} for e, p in values.items()},
        "mass": axis.p[0] * axis.mass,
    }
    return Case(axis, values, records, label)


def _scaled(axis: Axis, ref: np.ndarray, add: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
    """Scale to the case's length; the command keeps its unit, so the gain carries the rest."""
    table = {
        "t": np.arange(len(ref)) * DT,
        "q": x[0] * axis.length,
        "q_ref": ref * axis.length,
        "nu": x[1],
    }
    return {**table, "added": add} if add.any() else table


def axis_file(axis: Axis) -> dict:
    """Return the axis as a user would know it: the tables of an axis file."""
    gain = axis.gain * axis.mass * axis.length
    if axis.law == 0:
        controller = {"kind": "cascade-pd", "kp": axis.kp, "kv": axis.kv / axis.length}
    else:
        controller = {"kind": "pd", "kp": axis.kp / axis.length, "kd": axis.kv / axis.length}
    controller |= {
        "velocity_filter": [float(x) for x in axis.taps],
        "delay": axis.delay,
        "limit": axis.limit,
    }
    joint = "revolute" if axis.mass < 0.05 else "prismatic"
    return {
        "axis": {"name": "withheld", "joint": joint},
        "controller": controller,
        "drive": {"gain": gain},
        "model": {"terms": ["inertia", "viscous", "coulomb", "offset"]},
    }


SUITES = ("single", "none", "bursts", "two", "background", "outside")
PAIRS = [
    ("asymmetric-viscous", "cogging"),
    ("stribeck", "spring"),
    ("drive-timing", "asymmetric-viscous"),
    ("position-friction", "flexibility"),
    ("load-friction", "offset-drift"),
    ("presliding", "spring"),
    ("controller-mismatch", "asymmetric-viscous"),
    ("friction-drift", "cogging"),
    ("polynomial-viscous", "spring"),
    ("drive-timing", "position-friction"),
]


def plan(suite: str, count: int) -> list[tuple[int, list[str]]]:
    """Return (seed, effects) of every case of a suite."""
    if suite == "single":
        return [(k, [e]) for k in range(count) for e in EFFECTS]
    if suite == "two":
        return [(k, list(pair)) for k in range(count) for pair in PAIRS]
    if suite == "background":
        named = [
            [],
            ["asymmetric-viscous"],
            ["cogging"],
            [],
            ["drive-timing"],
            ["spring"],
            [],
            ["flexibility"],
            ["stribeck"],
            [],
            ["load-friction"],
            ["position-friction"],
        ]
        return [(100 * k + i, e) for k in range(count) for i, e in enumerate(named)]
    if suite == "outside":
        return [
            (k, [e])
            for k in range(count)
            for e in EFFECTS
            if e not in ("saturation", "controller-mismatch")
        ]
    return [(k, []) for k in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--suite", choices=SUITES, default="single")
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    labels = {}
    for seed, effects in plan(args.suite, args.count):
        case = draw(seed, args.suite, effects)
        name = f"{args.suite}-{len(labels):03d}"
        write(case, args.out / name)
        labels[name] = case.label
    (args.out / "labels.json").write_text(json.dumps(labels, indent=1))


def write(case: Case, folder: Path) -> None:
    import pandas as pd

    folder.mkdir(parents=True, exist_ok=True)
    for name, record in zip(("record", "holdout"), case.records, strict=True):
        pd.DataFrame(record).to_csv(folder / f"{name}.csv", index=False)
    lines = []
    for table, content in axis_file(case.axis).items():
        lines += [f"[{table}]", *(f"{k} = {json.dumps(v)}" for k, v in content.items())]
    (folder / "axis.toml").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
