"""Every method on both measured records of the EMPS: what it finds, how well, at what cost.

    python benchmarks/methods_on_emps.py

writes benchmarks/results/methods_on_emps.csv and methods_on_emps.md. Each method is fitted on one
record and tested on the other; the closed loop is simulated with its parameters. What was run is
kept in build/ and not run again.
"""

import json
import warnings
from pathlib import Path

import pandas as pd

import ivtools as iv
from ivtools.errors import ConvergenceWarning, IVToolsError
from ivtools.estimators import FUNCTIONS, METHODS, function_cases
from ivtools.estimators.base import estimator_class
from ivtools.leaderboard import free_run
from ivtools.problem import Problem
from ivtools.reproduce.toolboxes import NOTES, fit_cases
from ivtools.transfer_table import orders, shown_poles

RESULTS = Path(__file__).parent / "results"
RUNS = Path(__file__).parents[1] / "build" / "methods_on_emps.jsonl"
MODELS = {
    "symmetric": ("inertia", "viscous", "coulomb", "offset"),
    "asymmetric": ("inertia", "asymmetric-friction"),
}


def row(key, model, train, test):
    """One method and model, fitted on one record and tested on the other."""
    loop = iv.axes.emps().with_terms(*MODELS[model])
    base = {"method": key, "model": model, "record": train.name}
    try:
        fit = estimator_class(key)().fit(Problem(train, loop))
    except IVToolsError as error:
        return {**base, "remark": str(error)}
    simulated = {r.name: loop.simulate(r, fit.params).relative_error(r) for r in (train, test)}
    return {
        **base,
        **fit.params.to_dict(),
        "relative_error": fit.relative_error,
        "cross_test": fit.cross_test(Problem(test, loop)).relative,
        "simulated_force": simulated[train.name]["force"],
        "simulated_force_other": simulated[test.name]["force"],
        "simulated_position": simulated[train.name]["position"],
        "free_run_other_mm": free_run(fit, test),
        "simulations": fit.n_simulations,
        "seconds": fit.runtime,
        "converged": fit.converged,
        "remark": "; ".join(fit.notes),
    }


def rows(pairs):
    """Every method, model and record; what the file of runs lacks is appended to it."""
    RUNS.parent.mkdir(exist_ok=True)
    done = [json.loads(line) for line in RUNS.read_text().splitlines()] if RUNS.exists() else []
    have = {(r["method"], r["model"], r["record"]): r for r in done}
    for train, test in pairs:
        for model in MODELS:
            for key in METHODS:
                if (key, model, train.name) not in have:
                    made = row(key, model, train, test)
                    with RUNS.open("a") as file:
                        file.write(json.dumps(made, default=float) + "\n")
                    have[key, model, train.name] = made
                yield have[key, model, train.name]


def figures(fit, case, other):
    """The figures of one transfer function."""
    return {
        "case": case,
        "record": fit.problem.record.name,
        "method": fit.method,
        "poles/zeros/integrators": "/".join(map(str, orders(fit))),
        "relative_error": fit.relative_error,
        "other_record": fit.cross_test(other),
        "r2": fit.r2,
        "yic": fit.yic,
        "pole_values": shown_poles(fit.poles),
        "converged": fit.converged,
    }


def transfer_functions(record, other):
    """The report's three cases on one record, then every method with its plain structures."""
    for name, fit in fit_cases(record).items():
        yield figures(fit, f"report: {name}", other)
    problem = Problem(record, iv.axes.emps())
    for key in FUNCTIONS:
        for case in function_cases(key):
            yield figures(case.fit(problem), f"{case.input}, {case.output}", other)


def relative_scale(records, mass=20.0):
    """What two records without payload say of the scale that a drive gain would need."""
    loop = iv.axes.emps().with_terms(*MODELS["asymmetric"])
    for key in ("idim-ls", "idim-iv", "idim-bciv", "idim-piv"):
        fits = [estimator_class(key)().fit(Problem(record, loop)) for record in records]
        first, second = (float(fit.params["inertia"]) for fit in fits)
        spread = sum(float(fit.std_errors["inertia"]) ** 2 for fit in fits) ** 0.5
        yield {
            "method": key,
            **{f"inertia per gain, {r.name} (kg V/N)": float(f.params["inertia"]) / loop.gain
               for r, f in zip(records, fits, strict=True)},
            "difference_percent": 100.0 * (second / first - 1.0),
            "its_deviation_percent": 100.0 * spread / first,
            "gain_error_with_20_kg_percent": 100.0 * (mass / (mass + second - first) - 1.0),
        }  # fmt: skip


def markdown(frame):
    """A table for people."""
    cells = frame.map(lambda v: "-" if pd.isna(v) else f"{v:.4g}" if isinstance(v, float) else v)
    lines = [f"| {' | '.join(map(str, line))} |" for line in cells.to_numpy().tolist()]
    header = [f"| {' | '.join(frame.columns)} |", "|" + "---|" * len(frame.columns)]
    return "\n".join([*header, *lines])


def main():
    """Fit everything, write the tables."""
    warnings.simplefilter("ignore", ConvergenceWarning)
    records = [iv.datasets.emps(), iv.datasets.emps_pulses()]
    pairs = [records, records[::-1]]
    frame = pd.DataFrame(rows(pairs))
    functions = pd.DataFrame([line for pair in pairs for line in transfer_functions(*pair)])
    scale = pd.DataFrame(relative_scale(records))
    frame.to_csv(RESULTS / "methods_on_emps.csv", index=False, float_format="%.7g")
    functions.to_csv(RESULTS / "transfer_functions_on_emps.csv", index=False, float_format="%.7g")
    scale.to_csv(RESULTS / "relative_scale_on_emps.csv", index=False, float_format="%.7g")
    shown = ["method", "model", "record", "inertia", "relative_error", "cross_test",
             "simulated_force", "simulated_force_other", "free_run_other_mm", "seconds",
             "converged"]  # fmt: skip
    text = [
        "# Every method on both EMPS records",
        "Made by `python benchmarks/methods_on_emps.py`. Errors in %, free run in mm, elapsed time "
        "in s, which a busy machine inflates; "
        "'other' is the record that the method has not seen. relative_error is that of the signal "
        "each method fits (force, simulated force or position): compare methods by the columns "
        "after it. All parameters and remarks are in methods_on_emps.csv.",
        markdown(frame[shown]),
        "# Transfer functions",
        "The report's three cases, then every method with the plainest structure of a rigid axis: "
        "command to position, command to velocity, reference to position. Errors in % of the "
        "free run, on the record and on the other one; poles in rad/s.",
        markdown(functions),
        "\n".join(f"- {note}" for note in NOTES),
        "- A noise model (rivc, rivbj) takes dry friction for coloured noise, weighs the fast "
        "parts of the record and pays in the free run; the simple methods are better here.",
        "# Drive gain",
        "Neither record carries a known payload, so **the drive gain of the EMPS has no figure "
        "here**, and nothing checks the 35.15 N/V of its file. On simulated records with a payload "
        "see [other_methods.md](other_methods.md). What the two records can tell is how well two "
        "experiments without payload agree on the inertia per unit of gain, which should be one "
        "number: the error that their difference would put on a gain from a payload of 20 kg is in "
        "the last column. It is several times what the standard errors promise: on this axis a "
        "payload has to be heavy.",
        markdown(scale),
    ]
    (RESULTS / "methods_on_emps.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
