"""Arms of 2, 3 and 6 joints with one to three hidden effects: which joint, which effect.

    python -m benchmarks.withheld.robots [--cases 28] [--effects backlash ...] [--table]

appends to benchmarks/results/robots/arms.csv one row per joint of every case that it does not
hold yet. A case draws an arm, its frictions, noise of the encoders, motion, and the effects, from
its seed alone; every fourth has none, and of the others the first effect goes through all kinds.
Diagnosed with a hold-out of another motion. A flexible joint and one with backlash have a mass of
their own on the drive: the truth is an arm of one joint more, with a spring or a gap in it, and
not the library's model of either.

An effect *shows* by `energy`: how much more energy the whitened force error of its joint has in a
simulation of the true arm without this one effect, all base parameters fitted to first order on the
forces of all joints, over that of the truth. From `SHOWS` on, a joint is judged under that heading.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import signal

import ivtools as iv
from ivtools.gap.floor import autoregression
from ivtools.gap.rules import ADEQUATE
from ivtools.loop import Controller
from ivtools.physics import Parameter, Term

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from robots import SIX_GAINS, axis, plan, reference, six_loop, two_axes, two_joints

RESULTS = Path(__file__).parents[1] / "results" / "robots" / "arms.csv"
FIRST = 8100  # seed; cases from 5000, 7000 and 8000 on have shown what was wrong
ARMS = (2, 3, 6)
SECONDS = 15.0
EFFECTS = (
    "stribeck", "cogging", "drive-timing", "load-friction", "asymmetric-viscous", "flexibility",
    "backlash",
)  # fmt: skip
SHOWS = ADEQUATE - 1.0  # of the energy: below, a diagnosis calls a model adequate
TWO_MASSES = ("flexibility", "backlash")
EARLY = 200  # samples that are not judged
FALSE = "a joint without effects"


def arm(n: int, rng: np.random.Generator) -> iv.RobotLoop:
    """An arm of n joints with frictions of its own."""
    if n == 2:
        loop = iv.RobotLoop(two_joints(), two_axes())
    elif n == 6:
        loop = six_loop()
    else:
        robot = iv.Robot.six_axis()
        robot = iv.Robot.from_urdf(
            Path(iv.robot.__file__).parent / "six_axis.urdf", robot.names[:n]
        )
        start = {"inertia": 0.8, "viscous": 8.0, "coulomb": 6.0, "offset": 0.2}
        terms = tuple(start)
        axes = [axis(kp, kd, terms, **start) for kp, kd in list(zip(*SIX_GAINS, strict=True))[:n]]
        loop = iv.RobotLoop(robot, axes)
    axes = []
    for a in loop.axes:
        start = {k: v * rng.uniform(0.6, 1.5) if k != "inertia" else v for k, v in a.start.items()}
        start.setdefault("inertia", 0.02)
        axes.append(axis(*a.controller.settings.values(), tuple(start), **start))
    return iv.RobotLoop(loop.robot, axes)


def drawn(effect: str, friction: float, rng: np.random.Generator) -> dict[str, float]:
    """Parameters of an effect on a joint with this Coulomb friction, N m."""
    if effect == "stribeck":
        force = friction * rng.uniform(0.5, 1.0)
        return {"force": force, "speed": rng.uniform(0.03, 0.12), "exponent": 2.0}
    if effect == "cogging":
        size, phase = friction * rng.uniform(0.3, 0.9), rng.uniform(0.0, 2.0 * np.pi)
        period = 2.0 * np.pi / rng.integers(12, 60)
        return {"cosine": size * np.cos(phase), "sine": size * np.sin(phase), "period": period}
    if effect == "drive-timing":
        return {"delay": 0.0, "lag": rng.uniform(0.0015, 0.004)}
    if effect == "load-friction":
        return {"ratio": rng.uniform(0.04, 0.1)}
    if effect == "flexibility":
        return {"hz": rng.uniform(6.0, 20.0), "damping": rng.uniform(0.02, 0.05), "gap": 0.0}
    if effect == "backlash":
        return {"hz": 40.0, "damping": 0.2, "gap": rng.uniform(1e-3, 4e-3)}
    return {"delta": -friction * rng.uniform(0.5, 1.0)}


# --- two masses in a joint -----------------------------------------------------------------------


def _contact(q, dq, ddq, sign, tau, t, k, c, gap):
    beyond = np.abs(q) - 0.5 * gap
    return (k * beyond * np.sign(q) + c * dq) * (beyond > 0.0)


CONTACT = Term(
    "contact",
    "mechanics",
    (
        Parameter("k", "{F}/{L}"),
        Parameter("c", "{F}/({L}/s)"),
        Parameter("gap", "{L}", lower=0.0, scan=(1e-3,)),  # the force is not linear in it
    ),
    "k (q - gap / 2) + c dq",
    "a spring, with a gap in it",
    law=_contact,
)


def split(loop: iv.RobotLoop, joint: str, hz: float, damping: float, gap: float) -> iv.RobotLoop:
    """The arm with the drive of a joint on one side of a spring, and its link on the other."""
    robot, j = loop.robot, loop.robot.joint(joint)
    felt = float(loop.mass_matrix(np.zeros(len(loop.joints)))[0, j, j])
    inertia = felt - loop.axes[j].start["inertia"]
    k = inertia * (2.0 * np.pi * hz) ** 2
    c = 2.0 * damping * np.sqrt(k * inertia)
    old = robot.joints[j]
    link = replace(old, name=f"{joint}-link", parent=j, rotation=np.eye(3), position=np.zeros(3))
    after = [
        replace(one, parent=one.parent + (one.parent >= j)) for one in robot.joints[j + 1 :]
    ]  # what hung on the joint hangs on its link
    phi = np.insert(robot.inertias, j, 0.0, axis=0)
    parts = (*robot.joints[: j + 1], link, *after)
    free = iv.ClosedLoop(
        Controller("none", {}), 1.0, (CONTACT,), joint="revolute",
        start={"contact.k": k, "contact.c": c, "contact.gap": gap},
    )  # fmt: skip
    axes = [*loop.axes[: j + 1], free, *loop.axes[j + 1 :]]
    return iv.RobotLoop(replace(robot, joints=parts, inertias=phi), axes)


def with_effects(loop: iv.RobotLoop, hidden: dict[str, tuple[str, dict]]) -> iv.RobotLoop:
    """The arm with effects, by joint."""
    for joint, (effect, values) in hidden.items():
        if effect not in TWO_MASSES:
            loop = loop.with_effect(joint, effect, **values)
    for joint, (effect, values) in hidden.items():
        loop = split(loop, joint, **values) if effect in TWO_MASSES else loop
    return loop


def held(true: iv.RobotLoop, q0: np.ndarray) -> np.ndarray:
    """Where gravity holds the free joints of an arm whose others are at q0, rad."""
    pull = true.robot.torques(q0[None], 0.0 * q0[None], 0.0 * q0[None])[0]
    free = [j for j, axis in enumerate(true.axes) if axis.controller.kind == "none"]
    for j in free:
        values = true.axes[j].start
        gap, k = values["contact.gap"], values["contact.k"]
        q0[j] = -0.5 * gap * np.sign(pull[j]) - pull[j] / k
    return q0


def simulated(
    true: iv.RobotLoop,
    record: iv.Record,
    noise: np.ndarray | None = None,
    values: dict[str, float] | None = None,
) -> iv.Record:
    """What the controllers of an arm see and say, its free joints left out."""
    driven = [j for j, axis in enumerate(true.axes) if axis.controller.kind != "none"]
    rng = np.random.default_rng(0)

    def wide(x: np.ndarray, rest: float) -> np.ndarray:
        out = rest * rng.standard_normal((len(x), len(true.axes)))
        out[:, driven] = x
        return out

    wanted = wide(record.q_ref, 1e-12)
    wanted[0] = held(true, wanted[0])
    whole = iv.Record(record.t, q=wanted, q_ref=wanted, nu=wide(record.nu, 1e-12))
    shaken = None if noise is None else wide(noise, 0.0)
    steps = None if len(driven) == len(true.axes) else 4
    sim = true.simulate(whole, values, initial="rest", position_noise=shaken, substeps=steps)
    return iv.Record(record.t, q=sim.q[:, driven], q_ref=record.q_ref, nu=sim.nu[:, driven])


def measured(true: iv.RobotLoop, n: int, seed: int, noise: float) -> tuple[iv.Record, iv.Record]:
    """A record of a motion of this seed, and what it would be without noise."""
    rng = np.random.default_rng(seed)
    t, q_ref = reference(SECONDS, n=n, seed=seed, size=0.5 if n == 2 else 0.25)
    asked = plan(t, q_ref)
    shaken = noise * rng.standard_normal(q_ref.shape)
    return simulated(true, asked, shaken), simulated(true, asked)


def energy(record: iv.Record, clean: iv.Record, without: iv.RobotLoop, joint: int) -> float:
    """What an effect adds to the energy of its joint's whitened force error; see above."""
    whiteners = [autoregression(x, np.ones(len(x), bool)) for x in (record.nu - clean.nu)[EARLY:].T]
    values = without.values()

    def white(nu: np.ndarray) -> np.ndarray:
        return np.array(
            [signal.lfilter(w, [1.0], x)[EARLY:] for w, x in zip(whiteners, nu.T, strict=True)]
        )

    def command(values: dict[str, float]) -> np.ndarray:
        return simulated(without, record, values=values).nu

    now, columns = command(values), []
    for name in without.base.names:
        step = 1e-3 * max(abs(values[name]), 1e-2)
        columns.append(white((command({**values, name: values[name] + step}) - now) / step).ravel())
    change, J = white(clean.nu - now), np.column_stack(columns)
    Q = np.linalg.qr(J / np.maximum(np.linalg.norm(J, axis=0), 1e-300))[0]
    left = (change.ravel() - Q @ (Q.T @ change.ravel())).reshape(change.shape)
    floor = np.mean(white(record.nu - clean.nu)[joint] ** 2)
    return float(np.mean(left[joint] ** 2) / floor)


class Case(NamedTuple):
    """An arm, what is hidden in its joints, the noise of its encoders, rad, and two records.

    Each record comes with what it would be without noise.
    """

    loop: iv.RobotLoop
    hidden: dict[str, tuple[str, dict[str, float]]]
    noise: float
    both: list[tuple[iv.Record, iv.Record]]


def draw(number: int, first: int = FIRST, kinds: Sequence[str] = EFFECTS) -> Case:
    """Draw a case; its first effect goes through all kinds in turn, others are drawn."""
    rng = np.random.default_rng(first + number)
    n = ARMS[number % len(ARMS)]
    loop = arm(n, rng)
    count = 0 if number % 4 == 3 else int(rng.integers(1, min(3, n) + 1))
    turn = number - (number + 1) // 4  # of the cases that hide something
    hidden: dict[str, tuple[str, dict[str, float]]] = {}
    for j in rng.permutation(n)[:count]:
        kind = kinds[rng.integers(len(kinds)) if hidden else turn % len(kinds)]
        friction = float(loop.axes[j].start["coulomb"])
        hidden[loop.joints[j]] = (kind, drawn(kind, friction, rng))
    noise, true = float(10.0 ** rng.uniform(-5.5, -4.0)), with_effects(loop, hidden)
    both = [measured(true, n, 2 * (first + number) + k, noise) for k in (0, 1)]
    return Case(loop, hidden, noise, both)


def case(number: int, first: int = FIRST, kinds: Sequence[str] = EFFECTS) -> list[dict]:
    """One row per joint of a case."""
    loop, hidden, noise, both = draw(number, first, kinds)
    n, start = loop.n_joints, process_time()
    found = iv.diagnose_robot(both[0][0], loop, both[1][0])
    used = (process_time() - start) / n
    rows = []
    for j, (name, d) in enumerate(found.joints.items()):
        twins = {t for e in d.effects for t in d.ambiguous_with.get(e, [])}
        others = {k: v for k, v in hidden.items() if k != name}
        shows = energy(*both[0], with_effects(loop, others), j) if name in hidden else 0.0
        rows.append(
            {
                "case": number,
                "joints": n,
                "noise": noise,
                "joint": name,
                "hidden": hidden.get(name, ("", {}))[0],
                "energy": shows,
                "named": " ".join(d.effects),
                "twins": " ".join(sorted(twins)),
                "verdict": d.verdict,
                "before": found.coupled.before[name],
                "after": found.coupled.after[name],
                "seconds": used,
            }
        )
    return rows


def judged(row: pd.Series) -> str:
    """What a joint's answer is worth."""
    named = set(str(row["named"]).split())
    if not row["hidden"]:
        return "false name" if named else "right"
    if not named:
        return "missed"
    if row["hidden"] in named:
        return "right" if len(named) == 1 else "right and more"
    return "twin" if row["hidden"] in str(row["twins"]).split() else "wrong"


def summary(results: Path) -> pd.DataFrame:
    """Answers by effect, of those that show and of the others, and times."""
    table = pd.read_csv(results, keep_default_na=False)
    table["answer"] = table.apply(judged, axis=1)
    seen = np.where(table["energy"] > SHOWS, "shows", "hardly shows")
    table["kind"] = np.where(table["hidden"] == "", "", seen)
    table["hidden"] = table["hidden"].replace("", FALSE)
    for keys in (["kind", "hidden"], ["kind", "joints"]):
        counts = pd.crosstab([table[k] for k in keys], table["answer"], margins=True)
        print(counts.to_string())
    return table.groupby("joints")["seconds"].agg(["median", "max"])


def main() -> None:
    """Run the cases that are missing."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=28)
    parser.add_argument("--first", type=int, default=FIRST, help="seed of case 0")
    parser.add_argument("--effects", nargs="+", choices=EFFECTS, default=EFFECTS)
    parser.add_argument("--file", type=Path, default=RESULTS, help="csv to which rows are added")
    parser.add_argument("--table", action="store_true", help="of the rows that are there")
    given = parser.parse_args()
    results = given.file
    done = set(pd.read_csv(results)["case"]) if results.exists() else set()
    for number in () if given.table else [k for k in range(given.cases) if k not in done]:
        frame = pd.DataFrame(case(number, given.first, given.effects))
        results.parent.mkdir(parents=True, exist_ok=True)
        frame.to_csv(
            results, mode="a", header=not results.exists(), index=False, float_format="%.5g"
        )
        print(frame[["case", "joint", "hidden", "energy", "named", "verdict", "seconds"]])
        sys.stdout.flush()
    print(summary(results))


if __name__ == "__main__":
    main()
