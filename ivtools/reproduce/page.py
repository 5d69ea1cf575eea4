"""The reproduction as a page with the report's figures."""

from __future__ import annotations

from ivtools import plots
from ivtools.report import Page, Picture
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
    out = Page("The EMPS report, reproduced", LEAD)
    tables = dict(zip([*SECTIONS, "clocks"], result.tables(), strict=True))
    pictures = _pictures(result)
    out.add("Verdict", f"{result.verdict()}.")
    for name, title in SECTIONS.items():
        out.add(title, tables=[tables[name]], figures=pictures.get(name, []))
    out.add("Published clock and true clock", tables=[tables["clocks"]])
    return out


def _pictures(result: Reproduction) -> dict[str, list[Picture]]:
    """Return the figures by the section that they belong to."""
    fit, asymmetric = result.fits["identification"], result.fits["asymmetric"]
    problem, holdout = fit.problem, result.holdout
    assert problem is not None  # the estimates were made from a problem
    pictures = {
        "identification": [
            Picture(
                "force",
                plots.force(fit),
                "Force measured and reconstructed (the report's figure 3).",
            )
        ],
        "cross-test": [
            Picture(
                "cross-test",
                plots.force(fit, holdout),
                "Cross-test on the pulses record (the report's figure 4).",
            )
        ],
        "asymmetric": [
            Picture(
                "asymmetric",
                plots.force(asymmetric),
                "Force reconstructed with asymmetric friction.",
            )
        ],
    }
    for section, driven, number in (
        ("simulation", problem, 5),
        ("simulation-pulses", holdout, 6),
    ):
        simulated = CLOCKS[0].simulate(driven.loop, driven.record, published_theta())
        figure = plots.simulation(simulated, driven.record, driven.pipeline, width_mm=160.0)
        caption = f"Simulated and measured signals, published clock (the report's figure {number})."
        pictures[section] = [Picture(section, figure, caption)]
    return pictures
