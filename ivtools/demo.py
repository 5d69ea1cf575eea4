"""The main job on the embedded record: identify, compare with the truth, simulate, report."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ivtools import axes, datasets, plots
from ivtools.comparison import Comparison, compare
from ivtools.display import Displayed
from ivtools.estimators.base import estimator_class
from ivtools.gap import Diagnosis, diagnose
from ivtools.pages import add_simulation, force_chart
from ivtools.plots.chart import inner_limits
from ivtools.problem import Problem
from ivtools.report import Card, Page, Picture
from ivtools.tables import Text, rounded, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ivtools.results import FitResults

#: What the demo does, in order: methods with symmetric and with asymmetric friction.
STEPS = tuple(
    (method, model)
    for model in ("symmetric", "asymmetric")
    for method in ("idim-ls", "idim-bciv", "didim")
)
_TERMS = {
    "symmetric": ("inertia", "viscous", "coulomb", "offset"),
    "asymmetric": ("inertia", "asymmetric-friction"),
}
LEAD = (
    "A simulated axis whose true parameters are known: 24.8 s at 1 kHz in closed loop, an encoder "
    "of 50 nm, 2 N of force noise, and friction that differs by direction. It is identified as if "
    "it were real."
)


@dataclass(frozen=True, repr=False)
class Demo(Displayed):
    """What the demo found.

    Attributes
    ----------
    fits : tuple of FitResults
        In the order of `STEPS`.
    comparison : Comparison
        All of them side by side, simulated.
    diagnosis : Diagnosis
        What the model with symmetric friction lacks.
    """

    fits: tuple[FitResults, ...]
    comparison: Comparison
    diagnosis: Diagnosis

    @property
    def problem(self) -> Problem:
        """The problem with the friction model of the truth."""
        problem = self.fits[-1].problem
        assert problem is not None  # every estimator keeps its problem
        return problem

    @property
    def best(self) -> tuple[FitResults, ...]:
        """The results with the friction model of the truth."""
        return tuple(fit for fit in self.fits if "viscous_pos" in fit.names)

    def truth(self) -> Text:
        """Return estimates of the true model beside the true parameters."""
        true = self.problem.record.theta_true or {}
        header = ["parameter", "unit", "true", *(fit.method for fit in self.best)]
        rows = [
            [name, self.problem.units[name], f"{true[name]:g}"]
            + [_with_error(fit, name) for fit in self.best]
            for name in self.problem.names
        ]
        notes = ["standard errors (HAC) in parentheses"]
        return table("Estimates against the truth", [], header, rows, notes, left=2)

    def tables(self) -> Iterator[Text]:
        """Yield the tables for a terminal."""
        yield self.truth()
        yield self.comparison.summary()
        yield self.diagnosis.summary()

    def summary(self) -> Text:
        """Return these tables one below the other."""
        tables = list(self.tables())
        return Text("\n\n".join(tables), "".join(table.html for table in tables))

    def plot(self, **options: Any) -> Figure:
        """Draw the estimates with their intervals, and the true values."""
        return plots.parameters(self.best, truth=self.problem.record.theta_true, **options)

    def page(self) -> Page:
        """Return the page of the demo."""
        return page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        return {
            "truth": dict(self.problem.record.theta_true or {}),
            "comparison": self.comparison.to_dict(),
            "diagnosis": self.diagnosis.to_dict(),
        }


def demo(progress: Callable[[str], object] = str) -> Demo:
    """Identify the twin by several methods, simulate it, and diagnose what a poor model lacks.

    Parameters
    ----------
    progress : callable, optional
        Called with the name of each step when it is done.

    Examples
    --------
    ::

        page(demo()).write("report.html")
    """
    record, loop = datasets.twin(), axes.emps()
    problems = {name: Problem(record, loop.with_terms(*terms)) for name, terms in _TERMS.items()}
    for problem in problems.values():
        problem.prepare()
    fits = []
    for method, model in STEPS:
        fits.append(estimator_class(method)().fit(problems[model]))
        progress(f"{method}, {model} friction")
    diagnosis = diagnose(record, problems["symmetric"].loop)
    progress("diagnosis")
    return Demo(tuple(fits), compare(fits), diagnosis)


def page(result: Demo) -> Page:
    """Return the page of a demo."""
    from ivtools.plots import gap as figures

    out = Page("An axis identified: the ivtools demo", LEAD, card(result))
    caption = "Estimates with 95 % intervals, true values dashed."
    out.add(
        "Estimates against the truth",
        "The friction model is that of the truth: one viscous and one Coulomb coefficient per "
        "direction. Least squares takes the force of a sample for the force at that instant, and "
        "its interval misses the true inertia; bias-compensated instrumental variables "
        "(IDIM-BCIV) and input error (DIDIM) compare the record with a simulation that makes the "
        "same error.",
        tables=[result.truth()],
        figures=[Picture("parameters", result.plot(), caption)],
    )
    symmetric, asymmetric = result.fits[0], result.best[0]
    limits = inner_limits(symmetric.resids)
    out.add(
        "What the friction model is worth",
        "The same record and method, first with friction that is the same in both directions, "
        "then with friction of its own in each.",
        figures=[
            force_chart(symmetric, "force-symmetric"),
            force_chart(asymmetric, "force-asymmetric", limits=limits),
        ],
    )
    diagnosis = result.diagnosis
    out.add(
        "What the simulation lacks",
        "The poorer model again, with friction that is the same in both directions. Nobody tells "
        "the diagnosis what is wrong with it; it screens every effect that it knows, and names one "
        "only if it replicates on parts of the record that it was not fitted to.",
        tables=[diagnosis.summary()],
        figures=[
            Picture(name, draw(diagnosis), caption)
            for name, draw, caption in (*figures.WHERE[:1], *figures.WHICH, *figures.HOW_FAR)
        ],
    )
    add_simulation(out, result.best[-1])
    out.add("All methods", tables=[result.comparison.summary()])
    return out


def _with_error(fit: FitResults, name: str) -> str:
    """Return an estimate with its standard error, to the digits of that."""
    value, error = rounded(float(fit.params[name]), float(fit.std_errors[name]), digits=2)
    return f"{value} ({error})"


def card(result: Demo) -> Card:
    """Return which methods find the truth, and what the diagnosis names."""
    true = result.problem.record.theta_true or {}
    missed = {
        fit.method: [n for n, (low, high) in _intervals(fit) if not low <= true[n] <= high]
        for fit in result.best
    }
    found = [method for method, names in missed.items() if not names]
    lines = [f"{m} misses {', '.join(names)}" for m, names in missed.items() if names]
    facts = [("True values within 95 % intervals", ", ".join(found) or "of no method")]
    facts += [("Others", "; ".join(lines))] * bool(lines)
    gap = result.diagnosis
    facts.append(("Named, where the model lacks it", ", ".join(gap.effects) or "nothing"))
    if gap.shrink is not None:
        s = gap.shrink
        facts.append(("Force error, rms", f"{s.before:.3g} {s.unit} → {s.after:.3g} {s.unit}"))
    verdict = "The true parameters are found." if found else "No method finds all true parameters."
    advice = ("Your own log: ivtools axis new log.csv, or ivtools app log.csv in the browser.",)
    return Card(verdict, tuple(facts), advice, "good" if found and gap.effects else "doubt")


def _intervals(fit: FitResults) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield each parameter with its 95 % interval."""
    for name, row in fit.conf_int().iterrows():
        low, high = (float(x) for x in row)
        yield str(name), (low, high)
