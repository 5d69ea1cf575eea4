"""A population of records of arms: bias, coverage, hold-out error and time of each method.

    python benchmarks/robots.py [--records 100] [--arm six|two] [--noise 2e-4]

appends to benchmarks/results/robots/population.csv what it does not yet hold, one row per record
and method, so that it can be stopped and goes on; `--table` prints the summary. Each record is 20 s
of random sines under the joints' PD laws, which see the noise of the encoders; 1 % noise on the
torques. The hold-out is another motion, also noisy; its floor is what the true parameters leave.
"""

import argparse
import sys
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd

import ivtools as iv

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from robots import plan, reference, six_loop, two_axes, two_joints

RESULTS = Path(__file__).parent / "results" / "robots" / "population.csv"
METHODS = {m.key: m for m in (iv.IDIMLS(), iv.IDIMWLS(), iv.IDIMIV(), iv.DIDIM())}
SECONDS, TORQUE_NOISE, HELD_OUT = 20.0, 0.01, 10_000  # s; share of the rms; seeds from here on
ARMS = {"six": six_loop, "two": lambda: iv.RobotLoop(two_joints(), two_axes())}
ALL = 20  # records that every method sees
KEYS = ["arm", "noise", "seed", "method"]


def measured(loop: iv.RobotLoop, noise: float, seed: int) -> iv.Record:
    """A record of one seed."""
    rng = np.random.default_rng(seed)
    t, q_ref = reference(SECONDS, n=loop.n_joints, seed=seed)
    shaken = noise * rng.standard_normal(q_ref.shape)
    sim = loop.simulate(plan(t, q_ref), initial="rest", position_noise=shaken)
    tau = sim.tau + TORQUE_NOISE * sim.tau.std(axis=0) * rng.standard_normal(q_ref.shape)
    return iv.Record(t, q=sim.q, q_ref=q_ref, nu=sim.nu, tau=tau)


def rms(problem: iv.Problem, theta: np.ndarray) -> np.ndarray:
    """The rms of the force that parameters leave, per joint."""
    left = problem.y - problem.X @ theta
    return np.sqrt(np.bincount(problem.row_joints, left**2) / np.bincount(problem.row_joints))


def row(problem: iv.Problem, other: iv.Problem, method: iv.estimators.base.Estimator) -> dict:
    """What one method makes of one record."""
    loop, start = problem.loop, process_time()
    fit = method.fit(problem)
    used = process_time() - start
    true = loop.values()
    truth, found = np.array([true[n] for n in loop.names]), fit.params.to_numpy()
    at = problem.record.q[::200]
    masses = [
        loop.mass_matrix(at, v).diagonal(axis1=1, axis2=2).mean(axis=0)
        for v in (true | dict(zip(loop.names, found, strict=True)), true)
    ]
    interval = fit.conf_int().to_numpy()
    inside = (interval[:, 0] <= truth) & (truth <= interval[:, 1])
    return {
        "converged": fit.converged,
        "iterations": fit.n_iter,
        "seconds": used,
        "held_out": float((rms(other, found) / rms(other, truth)).max()),
        "covered": int(inside.sum()) if np.isfinite(interval).all() else -1,
        "parameters": len(truth),
        **{f"mass_{j + 1}": 100.0 * x for j, x in enumerate(masses[0] / masses[1] - 1.0)},
    }


def run(arm: str, noise: float, records: int) -> None:
    """Do what the file does not hold yet."""
    old = pd.read_csv(RESULTS) if RESULTS.exists() else pd.DataFrame(columns=KEYS)
    done = {tuple(k) for k in old[KEYS].itertuples(index=False)}
    loop = ARMS[arm]()
    for seed in range(records):
        asked = METHODS if seed < ALL else [m for m in METHODS if m != "didim"]  # has no intervals
        missing = [m for m in asked if (arm, noise, seed, m) not in done]
        if not missing:
            continue
        problem = iv.Problem(measured(loop, noise, seed), loop)
        other = measured(loop, noise, HELD_OUT + seed)
        other = iv.Problem(other, loop, problem.pipeline)
        start = process_time()
        _ = problem.X, problem.start
        rows = process_time() - start
        found = []
        for name in missing:
            keys = dict(zip(KEYS, (arm, noise, seed, name), strict=True))
            found.append({**keys, "rows_seconds": rows, **row(problem, other, METHODS[name])})
        RESULTS.parent.mkdir(parents=True, exist_ok=True)
        new = not RESULTS.exists()
        columns = [*found[0], *(f"mass_{j}" for j in range(len(loop.joints) + 1, 7))]
        frame = pd.DataFrame(found).reindex(columns=columns)
        frame.to_csv(RESULTS, mode="a", header=new, index=False, float_format="%.6g")
        print(arm, noise, seed, flush=True)


def summary() -> pd.DataFrame:
    """Medians, shares and worst cases by arm, noise and method."""
    table = pd.read_csv(RESULTS)
    masses = [c for c in table if c.startswith("mass_")]
    lines = []
    for keys, part in table.groupby(["arm", "noise", "method"], sort=False):
        known = part[part["covered"] >= 0]
        coverage = 100.0 * known["covered"].sum() / max(known["parameters"].sum(), 1)
        lines.append(
            dict(zip(("arm", "noise", "method"), keys, strict=True))
            | {
                "records": len(part),
                "converged": int(part["converged"].sum()),
                "coverage %": coverage if len(known) else np.nan,
                "held out / floor, mean": part["held_out"].mean(),
                "worst": part["held_out"].max(),
                "mass diagonal, worst mean %": part[masses].mean().abs().max(),
                "worst single %": part[masses].abs().max().max(),
                "s": part["seconds"].median(),
                "s per iteration": (part["seconds"] / part["iterations"]).median(),
            }
        )
    return pd.DataFrame(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--arm", choices=ARMS, default="six")
    parser.add_argument("--noise", type=float, default=2e-4)
    parser.add_argument("--table", action="store_true")
    given = parser.parse_args()
    if not given.table:
        run(given.arm, given.noise, given.records)
    print(summary().to_string(index=False, float_format="{:.3g}".format))
