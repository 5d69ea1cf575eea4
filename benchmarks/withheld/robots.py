"""Arms of 2, 3 and 6 joints with one to three hidden effects: which joint, which effect.

    python -m benchmarks.withheld.robots [--cases 30] [--table]

appends to benchmarks/results/robots/diagnosis.csv one row per joint of every case that it does not
hold yet. A case draws an arm, its frictions, noise of the encoders, motion, and the effects, from
its seed alone; every fourth has none. Diagnosed with a hold-out of another motion. Flexibility and
backlash are not drawn: a `RobotLoop` has one mass per joint.
"""

import argparse
import sys
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd

import ivtools as iv

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from robots import SIX_GAINS, axis, plan, reference, six_loop, two_axes, two_joints

RESULTS = Path(__file__).parents[1] / "results" / "robots" / "diagnosis.csv"
FIRST = 5000  # seed
ARMS = (2, 3, 6)
SECONDS = 15.0
EFFECTS = ("stribeck", "cogging", "drive-timing", "load-friction", "asymmetric-viscous")
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
        axes.append(axis(*a.controller.settings.values(), a.terms, **start))
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
    return {"delta": -friction * rng.uniform(0.5, 1.0)}


def measured(loop: iv.RobotLoop, seed: int, noise: float) -> iv.Record:
    """A record of a motion of this seed."""
    rng = np.random.default_rng(seed)
    size = 0.5 if loop.n_joints == 2 else 0.25
    t, q_ref = reference(SECONDS, n=loop.n_joints, seed=seed, size=size)
    shaken = noise * rng.standard_normal(q_ref.shape)
    sim = loop.simulate(plan(t, q_ref), initial="rest", position_noise=shaken)
    return iv.Record(t, q=sim.q, q_ref=q_ref, nu=sim.nu)


def case(number: int) -> list[dict]:
    """One row per joint of a case."""
    rng = np.random.default_rng(FIRST + number)
    n = ARMS[number % len(ARMS)]
    loop = true = arm(n, rng)
    count = 0 if number % 4 == 3 else int(rng.integers(1, min(3, n) + 1))
    hidden = {}
    for j in rng.permutation(n)[:count]:
        effect = EFFECTS[rng.integers(len(EFFECTS))]
        hidden[loop.joints[j]] = effect
        friction = float(loop.axes[j].start["coulomb"])
        true = true.with_effect(loop.joints[j], effect, **drawn(effect, friction, rng))
    noise = float(10.0 ** rng.uniform(-5.5, -4.0))
    records = [measured(true, 2 * (FIRST + number) + k, noise) for k in (0, 1)]
    start = process_time()
    found = iv.diagnose_robot(records[0], loop, records[1])
    used = (process_time() - start) / n
    rows = []
    for name, d in found.joints.items():
        twins = {t for e in d.effects for t in d.ambiguous_with.get(e, [])}
        rows.append(
            {
                "case": number,
                "joints": n,
                "noise": noise,
                "joint": name,
                "hidden": hidden.get(name, ""),
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


def summary() -> pd.DataFrame:
    """Answers by number of joints and by effect."""
    table = pd.read_csv(RESULTS, keep_default_na=False)
    table["answer"] = table.apply(judged, axis=1)
    table["hidden"] = table["hidden"].replace("", FALSE)
    counts = pd.crosstab([table["joints"], table["hidden"]], table["answer"], margins=True)
    print(counts.to_string())
    return table.groupby("joints")["seconds"].agg(["median", "max"])


def main() -> None:
    """Run the cases that are missing."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--table", action="store_true")
    given = parser.parse_args()
    done = set(pd.read_csv(RESULTS)["case"]) if RESULTS.exists() else set()
    for number in () if given.table else [k for k in range(given.cases) if k not in done]:
        frame = pd.DataFrame(case(number))
        RESULTS.parent.mkdir(parents=True, exist_ok=True)
        frame.to_csv(
            RESULTS, mode="a", header=not RESULTS.exists(), index=False, float_format="%.5g"
        )
        print(frame[["case", "joint", "hidden", "named", "verdict", "seconds"]].to_string())
        sys.stdout.flush()
    print(summary())


if __name__ == "__main__":
    main()
