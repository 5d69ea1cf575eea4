"""What an axis file leaves out of the controller, with an effect behind it or none.

    python -m benchmarks.left_out build/left_out.csv --first 0 --count 10

Axes, controllers and motions are those of `populations`. The record has a detail that the axis file
does not state, or states otherwise; a row per case says what was named. Cases whose row is there
are not drawn again, and at the end of a run stands what the file holds.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import signal

import ivtools as iv
from ivtools.loop import ClosedLoop, Controller
from ivtools.record import Record

from .populations import axis, controller, filled, reference, scaled

KINDS = ("cascade-pd", "pd", "pid", "p-pi")
EFFECTS = ("stribeck", "cogging", "spring")
RATES = (250.0, 500.0, 1000.0, 2000.0)  # Hz
TRIES = 40
ASTRAY = 0.6  # of the reference, that the motion may be off: else the loop is none
FORWARD = "forward"  # column of a feed-forward that the log does not have

Change = Callable[[np.random.Generator, Controller, dict[str, float], float], Controller]


def _filter(kind: str) -> Change:
    def change(rng, law, theta, width):
        damping = {"damping": 0.3} if kind == "notch" else {}
        hz = width * rng.uniform(4.0, 10.0) / (2.0 * np.pi)
        return replace(law, filter={"kind": kind, "hz": float(hz), **damping})

    return change


def _setting(name: str, value: Callable[..., float]) -> Change:
    def change(rng, law, theta, width):
        return replace(law, settings={**law.settings, name: float(value(rng, law, width))})

    return change


def _forward(name: str, of: str) -> Change:
    def change(rng, law, theta, width):
        return replace(law, feedforward={name: theta[of] * rng.uniform(0.4, 0.9)})

    return change


def _taps(rng, law, theta, width):
    taps = [(0.5, 0.5), (0.6, 0.3, 0.1), (0.25,) * 4]
    return replace(law, velocity_filter=taps[rng.integers(len(taps))])


def _late(rng, law, theta, width):
    return replace(law, delay=law.delay + int(rng.integers(1, 3)))


#: What the true law has, of the one that is stated: by name, and the kinds that it is drawn for.
DETAILS: dict[str, tuple[Change, tuple[str, ...]]] = {
    "nothing": (lambda rng, law, theta, width: law, KINDS),
    "velocity filter": (_taps, KINDS),
    "low-pass": (_filter("lowpass"), KINDS),
    "notch": (_filter("notch"), KINDS),
    "derivative filter": (
        _setting("derivative_filter", lambda rng, law, width: rng.uniform(0.05, 0.2) / width),
        ("pid",),
    ),
    "weight of the velocity": (
        _setting("c", lambda rng, law, width: 1.0 - round(law.full["c"])),
        ("pd", "pid", "p-pi"),
    ),
    "weight of the position": (
        _setting("b", lambda rng, law, width: rng.uniform(0.3, 0.8)),
        ("pid",),
    ),
    "delay": (_late, KINDS),
    "acceleration forward": (_forward("acceleration", "inertia"), KINDS),
    "velocity forward": (_forward("velocity", "viscous"), KINDS),
    "friction forward": (_forward(FORWARD, "coulomb"), KINDS),
    "reference derived backward": (
        lambda rng, law, theta, width: replace(law, reference_derivative="backward"),
        ("pd", "pid", "p-pi"),
    ),
    "reference filter": (lambda rng, law, theta, width: law, KINDS),
}


def draw(seed: int, detail: str, effect: str) -> tuple[ClosedLoop, tuple[Record, Record]] | None:
    """Return the loop as it is stated and two records of what it is; None if none is stable."""
    change, kinds = DETAILS[detail]
    for attempt in range(TRIES):
        rng = np.random.default_rng([seed, attempt, [*DETAILS].index(detail)])
        hz = float(rng.choice(RATES))
        n = int(hz * rng.uniform(12.0, 25.0))
        loop, theta, stroke = axis(rng, ("prismatic", "revolute")[seed % 2])
        law = controller(rng, str(rng.choice(kinds)), theta["inertia"], hz)
        width = law.settings.get("kv", law.settings.get("kd")) / theta["inertia"]
        stated = replace(loop, controller=scaled(law, loop.gain))
        true = replace(loop, controller=scaled(change(rng, law, theta, width), loop.gain))
        if effect:
            force = theta["coulomb"] * float(rng.uniform(0.4, 0.9))
            size = {
                "stribeck": {"force": force, "speed": 0.15 * stroke},
                "cogging": {
                    "cosine": 0.5 * force,
                    "sine": 0.5 * force,
                    "period": stroke / float(rng.uniform(4.0, 12.0)),
                },
                "spring": {"stiffness": 2.0 * force / stroke},
            }[effect]
            true = true.with_effect(effect, **size)
            theta = theta | {f"{effect}.{k}": v for k, v in size.items()}
        seconds = float(rng.uniform(0.02, 0.2))
        found = [_played(rng, true, theta, hz, n, stroke, detail, seconds) for _ in range(2)]
        if all(one is not None for one in found):
            first, second = (
                r.replace(name=k) for r, k in zip(found, ("record", "holdout"), strict=True)
            )
            return stated, (first, second)
    return None


def _played(rng, true, theta, hz, n, stroke, detail, seconds) -> Record | None:
    """Return a record of a loop, as it is logged; None if it does not follow its reference."""
    logged = taken = reference(rng, n, hz, stroke)
    if detail == "reference filter":
        pole = float(np.exp(-1.0 / (hz * seconds)))
        taken = logged.replace(q_ref=signal.lfilter([1.0 - pole], [1.0, -pole], logged.q_ref[:, 0]))
    if detail == "friction forward":
        speed = np.gradient(logged.q_ref[:, 0])
        taken = logged.replace(extra={FORWARD: np.tanh(100.0 * speed / np.abs(speed).max())})
    sim = true.simulate(
        taken,
        theta,
        initial="rest",
        position_noise=1e-6 * stroke * rng.normal(size=n),
        force_noise=0.02 * theta["coulomb"] * rng.normal(size=n),
    )
    if not sim.finite or np.std(sim.q - taken.q_ref) > ASTRAY * np.std(taken.q_ref):
        return None
    return logged.replace(q=sim.q, nu=sim.nu)


def answer(seed: int, detail: str, effect: str) -> dict[str, object] | None:
    """Return the row of a case, or None if no such case can be drawn."""
    drawn = draw(seed, detail, effect)
    if drawn is None:
        return None
    loop, (first, second) = drawn
    gap = iv.diagnose(first, loop, holdout=second)
    named = {*gap.effects} - {"controller-mismatch"}
    own = {n for n in named if effect == n or effect in gap.ambiguous_with.get(n, ())}
    return {
        "seed": seed,
        "detail": detail,
        "effect": effect,
        "kind": loop.controller.kind,
        "verdict": gap.verdict,
        "named": bool(own) == bool(effect),
        "others": " ".join(sorted(named - own)),
        "findings": " | ".join(f.text for f in gap.findings)[:300],
    }


def main() -> None:
    """Run what is missing, a row at a time, and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=10)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    seeds = range(args.first, args.first + args.count)
    cases = [(k, d, e) for k in seeds for d in DETAILS for e in ("", EFFECTS[k % len(EFFECTS)])]
    found = filled(args.file, cases, answer)
    for detail in DETAILS:
        own = [r for r in found if r["detail"] == detail]
        right = sum(r["named"] == "True" and not r["others"] for r in own)
        others = sum(bool(r["others"]) for r in own)
        print(f"{detail}: {right} of {len(own)} right, {others} with another name")


if __name__ == "__main__":
    main()
