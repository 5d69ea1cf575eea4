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
import time
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


@dataclass(frozen=True)
class Drawn:
    """A drawn case: models as text, and the logs that a user would have.

    Attributes
    ----------
    axis, other : Axis
        As the user's model has it, and as it is.
    own : ClosedLoop
        The user's axis.
    models : mapping of str to (str, mapping)
        The user's model, that with the true base parameters, and the truth; each with the forces
        beside it.
    real, sim : tuple of Record
        Record and hold-out, of the truth and of the user's model.
    """

    hidden: str | None
    axis: Axis
    other: Axis
    own: iv.ClosedLoop
    models: dict[str, tuple[str, dict[Any, tuple[float, ...]]]]
    real: tuple[iv.Record, iv.Record]
    sim: tuple[iv.Record, iv.Record]

    @property
    def driven(self) -> iv.ClosedLoop | None:
        """The axis whose controller drives the models, if they have none of their own."""
        return self.own if self.axis.motor else None


def drawn(seed: int, hidden: str | None, folder: Path) -> Drawn:
    """Draw one case; its models are written into a folder."""
    rng = np.random.default_rng([15, seed, 0 if hidden is None else 1 + HIDDEN.index(hidden)])
    axis = draw(rng, motor=hidden == "drive-timing")
    user, base, true = (folder / f"{name}.xml" for name in ("user", "base", "true"))
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
    base.write_text(text)
    values = {} if hidden is None else size(axis, hidden, rng)
    beside: dict[Any, tuple[float, ...]] = {}
    if hidden is None:
        true = base
    else:
        from ivtools.simulators.mjcf_export import export

        loop = iv.ClosedLoop.from_mjcf(base, "x").with_effect(hidden, **values)
        made = export(base, "x", loop, loop.values(loop.start))
        beside = made.beside
        made.write(true)
    driven = own if axis.motor else None
    references = [reference(axis, rng) for _ in range(2)]
    truths = (
        iv.MujocoSimulator(true, "x", loop=driven, beside={**beside, noise(axis, rng): ()})
        for _ in references
    )
    real = [model.simulate(r) for model, r in zip(truths, references, strict=True)]
    model = iv.MujocoSimulator(user, "x", loop=driven)
    sim = [model.simulate(r) for r in references]
    models = {"user": (user, {}), "plain": (base, {}), "true": (true, beside)}
    return Drawn(
        hidden, axis, other, own, {n: (p.read_text(), b) for n, (p, b) in models.items()},
        (real[0], real[1]), (sim[0], sim[1]),
    )  # fmt: skip


def case(seed: int, hidden: str | None) -> dict[str, Any]:
    """Draw one case, diagnose it, export it, and score both."""
    with tempfile.TemporaryDirectory() as folder:
        one = drawn(seed, hidden, Path(folder))
        out = {"hidden": hidden or "", "seed": seed}
        out |= {f"error_{n}": _error(one, *m, Path(folder)) for n, m in one.models.items()}
        return {**out, **scored(one, Path(folder))}


def scored(one: Drawn, folder: Path) -> dict[str, Any]:
    """Diagnose a case, export it, and score both."""
    axis, hidden = one.axis, one.hidden
    own = {term.name for term in one.own.terms}
    logs = {"simulated": one.sim[0], "simulated_holdout": one.sim[1]}
    begin = time.process_time()
    try:
        found = iv.diagnose(one.real[0], one.own, one.real[1], **logs)
        between = time.process_time()
        iv.diagnose(one.real[0], one.own, one.real[1])  # for the time that it takes
    except IVToolsError as error:
        return {"slide": axis.slide, "error": str(error)}
    out: dict[str, Any] = {
        "seconds": between - begin, "seconds_alone": time.process_time() - between,
        "slide": axis.slide, "pendulum": axis.pendulum > 0.0, "motor": axis.motor,
        "inertia": axis.inertia, "rate": axis.rate,
        "verdict": found.verdict, "named": " ".join(found.effects),
        "surplus": " ".join(found.surplus), "findings": "; ".join(f.text for f in found.findings),
    }  # fmt: skip
    either = [e for n, others in found.ambiguous_with.items() if n in own for e in others]
    out["either"] = " ".join(either)
    exact = set(found.effects) == ({hidden} if hidden else set()) and not found.surplus
    out["right"] = exact or (not found.effects and either == [hidden])
    out["wrong"] = bool(set(found.effects) - {hidden}) or bool(found.surplus)
    if found.changes:
        out |= _changes(found, one.own, axis, one.other)
        user = folder / "user.xml"
        user.write_text(one.models["user"][0])
        made = found.to_mjcf(user, "x")
        out["error_exported"] = _error(one, made.xml, made.beside, folder)
    return out


def _changes(found: Any, own: iv.ClosedLoop, axis: Axis, other: Axis) -> dict[str, Any]:
    """Return how far each base parameter's change is off, and whether its interval holds it."""
    out: dict[str, Any] = {}
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
            out[f"{name}_held"] = got.interval[0] <= change <= got.interval[1]
    return out


def _error(one: Drawn, text: str, beside: Any, folder: Path) -> float:
    """Return the force error of a model in MuJoCo on the hold-out; NaN if it diverges."""
    path, real = folder / "tried.xml", one.real[1]
    path.write_text(text)
    try:
        done = iv.MujocoSimulator(path, "x", loop=one.driven, beside=beside).simulate(real)
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
    drowns in the noise, or in a pendulum that swings on its own. `either`: not named by itself, for
    a change of what the simulator has would do the same, which is said with the effect's name.
    """
    hidden = table.hidden.fillna("")
    table = table.assign(
        hidden=hidden.replace("", "none"),
        close=table.error_exported <= 1.15 * table.error_true,
        named_any=table.named.fillna("") != "",
        said=table.either.fillna("") == hidden.where(hidden != "", "-"),
        shows=(hidden == "") | (table.error_plain > SHOWS * table.error_true),
    )
    return table.groupby(["shows", "hidden"]).agg(
        cases=("seed", "size"), right=("right", "mean"), wrong=("wrong", "mean"),
        named=("named_any", "mean"), either=("said", "mean"), close=("close", "mean"),
        inertia=("inertia_held", "mean"), viscous=("viscous_held", "mean"),
        coulomb=("coulomb_held", "mean"), seconds=("seconds", "mean"),
        alone=("seconds_alone", "mean"),
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
