"""Consistency: bias, coverage and efficiency of the estimators on a simulated axis in closed loop.

The twin's axis follows the twin's reference. White encoder noise passes through the controller
into the force, the encoder has a resolution, a white force acts beside the drive. What each method
makes of 200 such records, against the true parameters and the Cramer-Rao bound:

    python benchmarks/consistency.py --seeds 200

writes benchmarks/results/consistency.csv and consistency.md. A variance of 200 records is known
to 10 % only. So the table also says what an efficient estimate has on the very same records: the
linear one from the one-step predictions of the position, which knows the truth and the noise. It
attains the bound, but for chance, and checks it. A longer run of some methods, under a name of its
own, tells more:

    python benchmarks/consistency.py --seeds 1000 --methods idim-bciv idim-piv --name efficiency

What was run is kept in build/ and not run again.
"""

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

import ivtools as iv
from ivtools.errors import ConvergenceWarning
from ivtools.estimators.bound import Noise, cramer_rao, known_columns, predictor
from ivtools.estimators.compensated import IDIMBCIV
from ivtools.estimators.instrumental import IDIMIV
from ivtools.estimators.least_squares import IDIMLS
from ivtools.estimators.refined import IDIMPIV
from ivtools.linalg import solve_iv
from ivtools.loop import Simulation
from ivtools.record import Record

RESULTS = Path(__file__).parent / "results"
BUILD = Path(__file__).parents[1] / "build"
QUANTUM = 5e-8  # m
FORCE_NOISE = 2.0  # N
POSITION_NOISE = (1e-7, 1e-6, 1e-5)  # m
EFFICIENT = "efficient, linearised"
REALISATIONS = 5  # of the noise, for the bound
ALIGNED = {"force_shift": 0.5, "min_speed": 5e-3, "guard": 25}


@dataclass(frozen=True)
class Method:
    estimator: object
    settings: dict


METHODS = {
    "idim-ls": Method(IDIMLS(), {}),
    "idim-iv": Method(IDIMIV(), {}),
    "idim-iv, aligned and masked": Method(IDIMIV(), ALIGNED),
    "idim-bciv": Method(IDIMBCIV(), {}),
    "idim-piv": Method(IDIMPIV(), {}),
}


class Experiment:
    """The twin's axis and reference; `record` is one noisy experiment with it."""

    def __init__(self) -> None:
        self.twin = iv.datasets.twin()
        self.theta = dict(self.twin.theta_true)
        self.loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
        self.pipeline = self.loop.pipeline(self.twin)  # cut-off 100 Hz, decimation by 10

    def noise(self, noise: float, seed: int) -> dict[str, np.ndarray]:
        level = int(round(1e9 * noise))
        sequence = np.random.SeedSequence(list(b"consistency"), spawn_key=(level, seed))
        rng, n = np.random.default_rng(sequence), self.twin.n_samples
        return {
            "position_noise": rng.normal(0.0, noise, n),
            "force_noise": rng.normal(0.0, FORCE_NOISE, n),
        }

    def simulation(self, noise: float, seed: int) -> Simulation:
        moved = self.noise(noise, seed)
        return self.loop.simulate(self.twin, self.theta, initial="rest", quantum=QUANTUM, **moved)

    def record(self, noise: float, seed: int) -> Record:
        return self._measured(self.simulation(noise, seed))

    def _measured(self, simulation: Simulation) -> Record:
        return Record(self.twin.t, simulation.q, q_ref=self.twin.q_ref, nu=simulation.nu)

    def efficient(self, simulation: Simulation, noise: float, seed: int) -> np.ndarray:
        """Return the error (p,) of the best linear estimate from one-step predictions."""
        columns = known_columns(self.loop, self.theta, simulation)
        steps = predictor(self.loop, self.theta, self.twin.dt, known(noise))
        acting = self.noise(noise, seed)
        errors = steps.errors(acting["position_noise"], -acting["force_noise"])
        return -solve_iv(steps.sensitivities(columns), errors)

    def fits(self, noise: float, seed: int, methods: dict[str, Method]) -> Iterator[dict]:
        simulation = self.simulation(noise, seed)
        record = self._measured(simulation)
        errors, bound = self.efficient(simulation, noise, seed), self.bound(noise)
        for (parameter, true), error in zip(self.theta.items(), errors, strict=True):
            yield {
                "noise": noise,
                "method": EFFICIENT,
                "parameter": parameter,
                "seed": seed,
                "estimate": true + error,
                "std_error": bound[parameter],
                "half_width": 1.96 * bound[parameter],
                "converged": True,
                "runtime": 0.0,
            }
        for name, method in methods.items():
            problem = iv.Problem(record, self.loop, replace(self.pipeline, **method.settings))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ConvergenceWarning)
                fit = method.estimator.fit(problem, check=False)  # who knows the truth
            lower, upper = fit.conf_int().to_numpy().T
            widths = dict(zip(fit.names, 0.5 * (upper - lower), strict=True))
            for parameter, value in fit.params.items():
                yield {
                    "noise": noise,
                    "method": name,
                    "parameter": parameter,
                    "seed": seed,
                    "estimate": value,
                    "std_error": fit.std_errors[parameter],
                    "half_width": widths[parameter],
                    "converged": fit.converged,
                    "runtime": fit.runtime,
                }

    @cache  # noqa: B019  (there is one experiment per process)
    def bound(self, noise: float) -> pd.Series:
        motions = (self.simulation(noise, seed) for seed in range(REALISATIONS))
        covariance = cramer_rao(self.loop, self.theta, motions, known(noise))
        return pd.Series(np.sqrt(np.diag(covariance)), index=covariance.index)


def known(position: float) -> Noise:
    """Return the noise of an experiment."""
    return Noise(position, FORCE_NOISE, QUANTUM)


@cache
def experiment() -> Experiment:
    """Return the experiment of this process."""
    return Experiment()


def fits(noise: float, seed: int, methods: dict[str, Method]) -> list[dict]:
    """Return the rows of one record."""
    return list(experiment().fits(noise, seed, methods))


def run(
    seeds: int, noises=POSITION_NOISE, methods: dict[str, Method] = METHODS, jobs: int = 1
) -> pd.DataFrame:
    """Return one row per fit and parameter."""
    rows = Parallel(n_jobs=jobs)(
        delayed(fits)(noise, seed, methods) for noise in noises for seed in range(seeds)
    )
    return pd.DataFrame([row for record in rows for row in record])


def resumed(path: Path, seeds: int, methods: dict[str, Method]) -> pd.DataFrame:
    """Return the same, from a file that is completed first."""
    path.parent.mkdir(exist_ok=True)
    done = pd.read_csv(path) if path.exists() else pd.DataFrame({"noise": [], "seed": []})
    have = set(zip(done["noise"], done["seed"], strict=True))
    for noise in POSITION_NOISE:
        for seed in range(seeds):
            if (noise, seed) not in have:
                rows = pd.DataFrame(fits(noise, seed, methods))
                rows.to_csv(path, mode="a", header=not path.exists(), index=False)
    return pd.read_csv(path)


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """Return bias, coverage and efficiency per noise, method and parameter."""
    bounds = {noise: experiment().bound(noise) for noise in table["noise"].unique()}
    best = table[table["method"] == EFFICIENT].groupby(["noise", "parameter"])["estimate"].std()
    rows = []
    for (noise, method, parameter), group in table.groupby(
        ["noise", "method", "parameter"], sort=False
    ):
        true, n = experiment().theta[parameter], len(group)
        error, std = group["estimate"] - true, group["estimate"].std()
        rows.append(
            {
                "noise": noise,
                "method": method,
                "parameter": parameter,
                "bias_percent": 100.0 * error.mean() / true,
                "bias_error_percent": 100.0 * std / np.sqrt(n) / true,
                "t": error.mean() / (std / np.sqrt(n)),
                "std": std,
                "mean_std_error": group["std_error"].mean(),
                "coverage_percent": 100.0 * (error.abs() < group["half_width"]).mean(),
                "variance_over_bound": std**2 / bounds[noise][parameter] ** 2,
                "variance_over_efficient": std**2 / best[noise, parameter] ** 2,
                "converged_percent": 100.0 * group["converged"].mean(),
                "milliseconds": 1e3 * group["runtime"].median(),
                "seeds": n,
            }
        )
    return pd.DataFrame(rows)


def write(summary: pd.DataFrame, name: str, folder: Path = RESULTS) -> None:
    folder.mkdir(exist_ok=True)
    summary.to_csv(folder / f"{name}.csv", index=False, float_format="%.5g")
    seeds = summary["seeds"].iloc[0]
    lines = [
        f"# {name.capitalize()}: {seeds} records of the twin's axis per noise level",
        "",
        "Made by `benchmarks/consistency.py`. Encoder noise as given, "
        f"resolution {QUANTUM:g} m, force noise {FORCE_NOISE:g} N, band-pass at 100 Hz. "
        "Bias with its standard error; coverage of the 95 % intervals (HAC); variance over the "
        "Cramer-Rao bound, and over that of the efficient estimate from the same records, which is "
        "free of most of the chance in them.",
    ]
    for noise, table in summary.groupby("noise"):
        lines += ["", f"## Encoder noise {noise:g} m", ""]
        lines += ["| method | parameter | bias, % | coverage, % | / bound | / efficient |"]
        lines += ["|---|---|---|---|---|---|"]
        lines += [
            f"| {r.method} | {r.parameter} | {r.bias_percent:+.3f} ± {r.bias_error_percent:.3f} | "
            f"{r.coverage_percent:.1f} | {r.variance_over_bound:.2f} | "
            f"{r.variance_over_efficient:.2f} |"
            for r in table.itertuples()
        ]
    (folder / f"{name}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--name", default="consistency")
    arguments = parser.parse_args()
    methods = {name: METHODS[name] for name in arguments.methods}
    table = resumed(BUILD / f"{arguments.name}.csv", arguments.seeds, methods)
    write(summarise(table), arguments.name)


if __name__ == "__main__":
    main()
