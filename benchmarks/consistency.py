"""Consistency: bias, coverage and efficiency of the estimators on a simulated axis in closed loop.

The twin's axis follows the twin's reference. White encoder noise passes through the controller
into the force, the encoder has a resolution, a white force acts beside the drive. What each method
makes of 200 such records, against the true parameters and the Cramer-Rao bound:

    python benchmarks/consistency.py --seeds 200

writes benchmarks/results/consistency.csv and consistency.md. A variance of 200 records is known
to 10 % only. So the table also says what an efficient estimate has on the very same noise: that of
the loop linearised along its reference, by generalised least squares with the true spectrum. It
attains the bound, but for chance, and checks it. A longer run of some methods, under a name of its
own, tells more:

    python benchmarks/consistency.py --seeds 1000 --methods idim-bciv idim-piv --name efficiency
"""

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

import ivtools as iv
from ivtools.errors import ConvergenceWarning
from ivtools.estimators.bound import cramer_rao, position_autocovariance, sensitivities
from ivtools.estimators.compensated import IDIMBCIV
from ivtools.estimators.instrumental import IDIMIV
from ivtools.estimators.least_squares import IDIMLS
from ivtools.estimators.refined import IDIMPIV
from ivtools.linalg import influence
from ivtools.linalg.noise import NoiseModel
from ivtools.record import Record

RESULTS = Path(__file__).parent / "results"
QUANTUM = 5e-8  # m
FORCE_NOISE = 2.0  # N
POSITION_NOISE = (1e-7, 1e-6, 1e-5)  # m
EFFICIENT = "efficient, linearised"
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

    def record(self, noise: float, seed: int) -> Record:
        simulation = self.loop.simulate(
            self.twin, self.theta, initial="rest", quantum=QUANTUM, **self.noise(noise, seed)
        )
        return Record(self.twin.t, simulation.q, q_ref=self.twin.q_ref, nu=simulation.nu)

    def efficient(self, noise: float, seed: int) -> np.ndarray:
        """Return the error (p,) of an efficient estimate, the loop linear: no dry friction."""
        linear, theta = self._linear
        q = linear.simulate(self.twin, theta, initial="rest", **self.noise(noise, seed)).q
        still = linear.simulate(self.twin, theta, initial="rest").q
        model, weights = self._weights(noise)
        return weights.T @ model(q - still)[:, 0]

    @cached_property
    def _linear(self) -> tuple[iv.ClosedLoop, dict]:
        viscous = 0.5 * (self.theta["viscous_pos"] + self.theta["viscous_neg"])
        theta = {"inertia": self.theta["inertia"], "viscous": viscous}
        loop = self.loop.with_terms(*theta)
        return replace(loop, controller=replace(loop.controller, limit=np.inf)), theta

    @cache  # noqa: B019  (there is one experiment per process)
    def _weights(self, noise: float) -> tuple[NoiseModel, np.ndarray]:
        sigma = np.hypot(noise, QUANTUM / np.sqrt(12.0))
        model = NoiseModel.from_autocovariance(
            position_autocovariance(self.loop, self.theta, self.twin.dt, sigma, FORCE_NOISE)
        )
        problem = iv.Problem(self.twin, self.loop, simulation={"initial": "rest"})
        return model, influence(model(sensitivities(problem, self.theta)))

    def fits(self, noise: float, seed: int, methods: dict[str, Method]) -> Iterator[dict]:
        record = self.record(noise, seed)
        errors, bound = self.efficient(noise, seed), self.bound(noise)
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
                fit = method.estimator.fit(problem)
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

    @cache  # noqa: B019
    def bound(self, noise: float) -> pd.Series:
        problem = iv.Problem(self.twin, self.loop, simulation={"initial": "rest"})
        covariance = cramer_rao(
            problem,
            self.theta,
            position_noise=noise,
            force_noise=FORCE_NOISE,
            quantum=QUANTUM,
        )
        return pd.Series(np.sqrt(np.diag(covariance)), index=covariance.index)


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
        "Cramer-Rao bound of an estimate that is excited by the reference, and over that of the "
        "efficient estimate of the linearised loop from the same noise, which is free of most of "
        "the chance in it.",
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
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--name", default="consistency")
    arguments = parser.parse_args()
    methods = {name: METHODS[name] for name in arguments.methods}
    table = run(arguments.seeds, methods=methods, jobs=arguments.jobs)
    write(summarise(table), arguments.name)


if __name__ == "__main__":
    main()
