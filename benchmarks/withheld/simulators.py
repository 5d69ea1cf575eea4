"""Withheld: what a user's MuJoCo model lacks against a MuJoCo truth.

    python -m benchmarks.withheld.simulators [--seeds 10] [--first 0] [--out FOLDER]

A run that is cut goes on where it stopped.

Truth and model share physics that the library does not have (a pendulum under the cart or on the
link, MuJoCo's own creeping friction). The truth has one effect more, and other base parameters.
Axes are drawn: slide and hinge, inertias over five decades, bandwidths, rates, noise.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import ivtools as iv
from ivtools.errors import IVToolsError
from ivtools.files import write
from ivtools.loop import Controller
from ivtools.physics import EFFECTS, Term

HIDDEN = (
    "cogging", "polynomial-viscous", "spring", "asymmetric-viscous", "drive-timing", "flexibility",
)  # fmt: skip
NOISE = 0.03  # of the force
SECONDS = 12.0
SHOWS = 1.5  # error of the truth without the effect over the true model's
LENGTH = 9.81 / (2 * np.pi * 1.7) ** 2  # m, of a pendulum that swings at 1.7 Hz


@dataclass(frozen=True)
class Axis:
    """A drawn axis: its model's numbers, SI."""

    slide: bool
    inertia: float
    stroke: float
    hz: float
    rate: float
    viscous: float
    coulomb: float
    pendulum: float  # its mass, kg; 0 is none
    motor: bool

    @property
    def force(self) -> float:
        """Rms force of the motion, roughly."""
        return self.inertia * self.stroke * (2 * np.pi * 0.8) ** 2


def draw(rng: np.random.Generator, motor: bool) -> Axis:
    """Draw an axis."""
    inertia, stroke = 10.0 ** rng.uniform(-3, 2), 10.0 ** rng.uniform(-2, 0.3)
    hz, force = rng.uniform(6.0, 25.0), inertia * stroke * (2 * np.pi * 0.8) ** 2
    slide = bool(rng.random() < 0.5)
    bob = 0.15 * inertia / (1.0 if slide else LENGTH**2)
    return Axis(
        slide=slide,
        inertia=inertia,
        stroke=stroke,
        hz=hz,
        rate=float(rng.choice([500.0, 1000.0, 2000.0])),
        viscous=rng.uniform(0.1, 0.5) * force / (stroke * 2 * np.pi * 0.8),
        coulomb=rng.uniform(0.1, 0.5) * force,
        pendulum=bob if rng.random() < 0.5 else 0.0,
        motor=motor,
    )


def size(axis: Axis, effect: str, rng: np.random.Generator) -> dict[str, float]:
    """Draw an effect that is worth a good part of the force; retuned base parameters hide some."""
    f, x, v = axis.force, axis.stroke, axis.stroke * 2 * np.pi * 0.8
    some = rng.uniform(0.15, 0.4) * rng.choice([-1.0, 1.0])
    phase = rng.uniform(0, 2 * np.pi)
    period = x * rng.uniform(0.03, 0.15)
    return {
        "cogging": {
            "cosine": abs(some) * f * np.cos(phase),
            "sine": abs(some) * f * np.sin(phase),
            "period": period,
        },
        "polynomial-viscous": {"quadratic": 3.0 * abs(some) * f / v**2, "cubic": 0.0},
        "spring": {"stiffness": 2 * abs(some) * f / x, "curvature": 0.0},
        "asymmetric-viscous": {"delta": some * f / v},
        "drive-timing": {"delay": rng.uniform(0.02, 0.05) / axis.hz, "lag": 0.0},
        "flexibility": {
            "frequency_hz": axis.hz * rng.uniform(2.0, 4.0),
            "damping": rng.uniform(0.01, 0.05),
            "load_share": rng.uniform(0.15, 0.4),
            "load_friction": 0.0,
        },
    }[effect]


def xml(axis: Axis) -> str:
    """Return the user's model of an axis."""
    kind, direction = ("slide", "1 0 0") if axis.slide else ("hinge", "0 1 0")
    body = "1 1 1" if axis.slide else f"{axis.inertia:.10g} {axis.inertia:.10g} {axis.inertia:.10g}"
    kp = axis.inertia * (2 * np.pi * axis.hz) ** 2 / 2.0
    kv = 1.2 * axis.inertia * 2 * np.pi * axis.hz
    drive = "motor" if axis.motor else f'position kp="{kp:.10g}" kv="{kv:.10g}"'
    length, bob = LENGTH, axis.pendulum
    pendulum = (
        f'<body name="bob" pos="0 0 {-0.2 * length:.6g}"><joint name="swing" type="hinge" '
        f'axis="0 1 0" damping="{0.02 * bob * length**2 * 10:.10g}"/><inertial mass="{bob:.10g}" '
        f'pos="0 0 {-length:.10g}" diaginertia="1e-9 1e-9 1e-9"/></body>'
        if axis.pendulum
        else ""
    )
    mass = axis.inertia if axis.slide else 1e-6
    return f"""<mujoco model="axis">
<option timestep="{1 / axis.rate / 2:.10g}" gravity="0 0 -9.81" integrator="implicitfast"/>
<worldbody><body name="carrier">
<inertial pos="0 0 0" mass="{mass:.10g}" diaginertia="{body}"/>
<joint name="x" type="{kind}" axis="{direction}" damping="{axis.viscous:.10g}"
 frictionloss="{axis.coulomb:.10g}" armature="{0.5 * axis.inertia:.10g}"/>
{pendulum}</body></worldbody>
<actuator><{drive} name="drive" joint="x"/></actuator></mujoco>"""


def reference(axis: Axis, rng: np.random.Generator) -> iv.Record:
    """Draw a smooth reference that begins at rest."""
    t = np.arange(int(SECONDS * axis.rate)) / axis.rate
    q = sum(
        rng.uniform(0.5, 1.0) / (1 + 2 * f) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3))
        for f in (0.13, 0.31, 0.7, 1.3, 2.1)
    )
    q = (q - q[0]) * (1.0 - np.exp(-((t / 0.5) ** 3)))
    q *= axis.stroke / np.ptp(q)
    return iv.Record(t=t, q=q, q_ref=q, nu=np.cos(t), name="reference")


def controller(axis: Axis) -> Controller:
    """Return the controller of a motor: that of the position actuator, with differences."""
    kp = axis.inertia * (2 * np.pi * axis.hz) ** 2 / 2.0
    kv = 1.2 * axis.inertia * 2 * np.pi * axis.hz
    return Controller("cascade-pd", {"kp": kp / kv, "kv": kv})


def noise(axis: Axis, rng: np.random.Generator) -> Term:
    """Return a force from outside, new at each sample, as a term of the truth."""
    values = NOISE * axis.force * rng.normal(size=int(SECONDS * axis.rate) + 2)
    return Term(
        "noise", "outside", (), "noise", "drawn",
        law=lambda q, dq, ddq, sign, tau, t: values[min(int(t * axis.rate), len(values) - 1)],
    )  # fmt: skip


def case(seed: int, hidden: str | None) -> dict[str, Any]:
    """Draw one case, diagnose it, export it, and score both."""
    rng = np.random.default_rng([15, seed, 0 if hidden is None else 1 + HIDDEN.index(hidden)])
    axis = draw(rng, motor=hidden == "drive-timing")
    with tempfile.TemporaryDirectory() as folder:
        return {"hidden": hidden or "", "seed": seed, **_run(axis, hidden, rng, Path(folder))}


def _run(axis: Axis, hidden: str | None, rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    user, true = folder / "user.xml", folder / "true.xml"
    user.write_text(xml(axis))
    scale = rng.uniform(0.85, 1.2, 3)
    other = replace(
        axis, inertia=axis.inertia * scale[0], viscous=axis.viscous * scale[1],
        coulomb=axis.coulomb * scale[2],
    )  # fmt: skip
    own = iv.ClosedLoop.from_mjcf(user, "x")
    if axis.motor:
        own = replace(own, controller=controller(axis))
    text = xml(other)  # the controller stays the user's
    if not axis.motor:
        mine, theirs = (t[t.index("<position") :] for t in (xml(axis), text))
        text = text.replace(theirs, mine)
    base = folder / "base.xml"
    base.write_text(text)
    values = {} if hidden is None else size(axis, hidden, rng)
    beside: dict[Any, tuple[float, ...]] = {}
    if hidden is None:
        true = base
    else:
        from ivtools.simulators.mjcf_export import export

        theirs_loop = iv.ClosedLoop.from_mjcf(base, "x").with_effect(hidden, **values)
        made = export(base, "x", theirs_loop, theirs_loop.values(theirs_loop.start))
        beside = made.beside
        made.write(true)
    driven = own if axis.motor else None
    simulate = {
        "user": iv.MujocoSimulator(user, "x", loop=driven),
    }
    references = [reference(axis, rng) for _ in range(2)]
    real = [
        iv.MujocoSimulator(
            true, "x", loop=driven, beside={**beside, noise(axis, rng): ()}
        ).simulate(r)
        for r in references
    ]  # fmt: skip
    sim = [simulate["user"].simulate(r) for r in references]
    try:
        found = iv.diagnose(real[0], own, real[1], simulated=sim[0], simulated_holdout=sim[1])
    except IVToolsError as error:
        return {"joint": axis.slide, "error": str(error)}
    out: dict[str, Any] = {
        "slide": axis.slide, "pendulum": axis.pendulum > 0.0, "motor": axis.motor,
        "inertia": axis.inertia, "rate": axis.rate,
        "verdict": found.verdict, "named": " ".join(found.effects),
        "surplus": " ".join(found.surplus), "findings": "; ".join(f.text for f in found.findings),
    }  # fmt: skip
    out["right"] = set(found.effects) == ({hidden} if hidden else set()) and not found.surplus
    out["wrong"] = bool(set(found.effects) - {hidden}) or bool(found.surplus)
    models = {"user": (user, {}), "plain": (base, {}), "true": (true, beside)}
    out |= {f"error_{n}": _error(*m, driven, real[1]) for n, m in models.items()}
    if found.changes:
        out |= _changes(found, own, axis, other)
        made = found.to_mjcf(user, "x")
        better = made.write(user.with_name("better.xml"))
        out["error_exported"] = _error(better, made.beside, driven, real[1])
    return out


def _changes(found: Any, own: iv.ClosedLoop, axis: Axis, other: Axis) -> dict[str, float]:
    """Return how far each base parameter's change is off, and by how many standard errors."""
    out = {}
    true = {
        "inertia": 1.5 * (other.inertia - axis.inertia),
        "viscous": other.viscous - own.start["viscous"],
        "coulomb": other.coulomb - own.start["coulomb"],
    }
    for name, change in true.items():
        got = found.changes.get(name)
        if got is not None:
            out[f"{name}_off"] = (got.change - change) / abs(own.start[name] + change)
            out[f"{name}_t"] = (got.change - change) / got.std_error
    return out


def _error(path: Path, beside: Any, loop: Any, real: iv.Record) -> float:
    """Return the force error of a model in MuJoCo on the hold-out; NaN if it diverges."""
    try:
        done = iv.MujocoSimulator(path, "x", loop=loop, beside=beside).simulate(real)
    except IVToolsError:
        return float("nan")
    return float(np.sqrt(np.mean((done.nu - real.nu) ** 2)))


def cases(seeds: range) -> Iterator[tuple[int, str | None]]:
    """Yield the cases of the suite: each hidden effect, and twice as many without one."""
    for seed in seeds:
        yield from ((seed, hidden) for hidden in HIDDEN)
        yield seed, None
        yield seed + 10_000, None


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return the score by hidden effect, of those that show.

    An effect shows if the truth without it errs by half more than the truth: what is smaller
    drowns in the noise, or in a pendulum that swings on its own.
    """
    hidden = table.hidden.fillna("")
    table = table.assign(
        hidden=hidden.replace("", "none"),
        close=table.error_exported <= 1.15 * table.error_true,
        named_any=table.named.fillna("") != "",
        shows=(hidden == "") | (table.error_plain > SHOWS * table.error_true),
    )
    return table.groupby(["shows", "hidden"]).agg(
        cases=("seed", "size"), right=("right", "mean"), wrong=("wrong", "mean"),
        named=("named_any", "mean"), close=("close", "mean"),
    )  # fmt: skip


def main() -> None:
    """Run the suite and write its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/simulators"))
    given = parser.parse_args()
    assert all(name in EFFECTS for name in HIDDEN)
    warnings.simplefilter("ignore")
    given.out.mkdir(parents=True, exist_ok=True)
    kept = given.out / "cases.csv"
    done = pd.read_csv(kept, keep_default_na=False) if kept.exists() else pd.DataFrame()
    rows = done.to_dict("records")
    have = {(row["seed"], row["hidden"]) for row in rows}
    for seed, hidden in cases(range(given.first, given.first + given.seeds)):
        if (seed, hidden or "") in have:
            continue
        rows.append(case(seed, hidden))
        print({k: v for k, v in rows[-1].items() if k not in ("findings",)}, flush=True)
        write(kept, pd.DataFrame(rows).to_csv(index=False))
    text = summary(pd.read_csv(kept)).round(3).to_string()
    (given.out / "summary.txt").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
