"""The reproduction as a page with the report's figures."""

from __future__ import annotations

from dataclasses import replace

from ivtools import plots
from ivtools.plots.chart import Chart
from ivtools.report import Card, Page
from ivtools.reproduce.clocks import CLOCKS
from ivtools.reproduce.figures import published_theta
from ivtools.reproduce.reproduction import Reproduction
from ivtools.reproduce.rows import SECTIONS

LEAD = (
    "Every number that the report on the Electro-Mechanical Positioning System prints, beside the "
    "one that ivtools computes from the measured records."
)


def page(result: Reproduction) -> Page:
    """Return the page of a reproduction: tables by section, figures 3 to 6, the clocks."""
    out = Page("The EMPS report, reproduced", LEAD, _card(result))
    tables = dict(zip([*SECTIONS, "clocks"], result.tables(), strict=True))
    charts = _charts(result)
    for name, title in SECTIONS.items():
        out.add(title, tables=[tables[name]], figures=charts.get(name, []))
    out.add("Published clock and true clock", tables=[tables["clocks"]])
    return out


def _card(result: Reproduction) -> Card:
    """Return how many of the printed numbers come out."""
    wrong = any(row.agrees is False for row in result.rows)
    open_ = sum(row.agrees is None for row in result.rows)
    facts = (("Not judged", f"{open_}: the report does not say how they were made."),)
    return Card(f"{result.verdict()}.", facts[: int(open_ > 0)], (), "bad" if wrong else "good")


def _charts(result: Reproduction) -> dict[str, list[Chart]]:
    """Return the figures by the section that they belong to."""
    fit, asymmetric = result.fits["identification"], result.fits["asymmetric"]
    problem, holdout = fit.problem, result.holdout
    assert problem is not None  # the estimates were made from a problem
    charts: dict[str, list[Chart]] = {}
    for section, estimate, other, caption in (
        ("identification", fit, None, "Force measured and reconstructed (the report's figure 3)."),
        ("cross-test", fit, holdout, "Cross-test on the pulses record (the report's figure 4)."),
        ("asymmetric", asymmetric, None, "Force reconstructed with asymmetric friction."),
    ):
        name = "force" if section == "identification" else section
        charts[section] = [plots.force_chart(estimate, other, name=name, caption=caption)]
    for section, driven, number in (
        ("simulation", problem, 5),
        ("simulation-pulses", holdout, 6),
    ):
        simulated = CLOCKS[0].simulate(driven.loop, driven.record, published_theta())
        caption = f"Simulated and measured signals, published clock (the report's figure {number})."
        chart = plots.simulation_chart(simulated, driven.record, driven.pipeline, caption=caption)
        charts[section] = [replace(chart, name=section)]
    return charts
