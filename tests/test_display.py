"""Displayed: every result offers the same faces, and what they hold is what programs can read."""

import importlib
import json
import pkgutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import ivtools as iv
from ivtools.demo import demo
from ivtools.display import Displayed, plain
from ivtools.excitation import Limits, pattern
from ivtools.guess.first import first_axis
from ivtools.hypothesis import TestResult
from ivtools.results import FitResults
from ivtools.suitability import suitability
from ivtools.tables import Text


class Count(Displayed):
    content = ("rows", "share", "parts")
    rows, share, parts = 3, float("nan"), np.array([1.0, np.inf])

    def summary(self):
        return Text("Count\n=====\n3 rows")


def test_one_statement_gives_every_face(tmp_path):
    count = Count()
    assert repr(count) == str(count) == str(count.summary())
    assert "3 rows" in count._repr_html_()
    assert count.to_dict() == {"rows": 3, "share": None, "parts": [1.0, None]}
    page = count.to_html(tmp_path / "new" / "count.html").read_text(encoding="utf-8")
    assert "<title>Count" in page and "3 rows" in page and "<svg" not in page


def test_a_result_with_a_figure_has_it_on_its_page(tmp_path):
    X = np.column_stack([np.sin(np.arange(60.0)), np.ones(60)])
    fit = FitResults.from_solution("idim-ls", [2.0, 1.0], X, X @ [2.0, 1.1], names=["a", "b"],
                                   t=np.arange(60.0))  # fmt: skip
    page = fit.to_html(tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "IDIM-LS estimate" in page and "<svg" in page


@pytest.mark.parametrize(
    "value",
    [
        np.float64("nan"),
        np.int64(3),
        np.array([[1, 2]]),
        pd.Series({"a": np.nan}),
        {"k": (1 + 2j, None, True, "s")},
        Count(),
    ],
)
def test_plain_is_json(value):
    json.dumps(plain(value), allow_nan=False)


def test_complex_numbers_are_pairs_and_tuples_lists():
    assert plain((1 + 2j, (3.0,))) == [[1.0, 2.0], [3.0]]


def looked_at(tmp_path):
    file = tmp_path / "log.csv"
    iv.datasets.twin().to_frame().to_csv(file, index=False)
    return first_axis(file)


THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
LIMITS = Limits.of({"lower": 0.0, "upper": 0.2, "speed": 0.3}, ("axis",))
#: What a call gives back: the call, what its page begins with, and the panels of its figure.
GIVEN = {
    "suitability": (lambda _: suitability(iv.datasets.twin(), iv.axes.emps()), "twin on EMPS", 3),
    "first axis": (looked_at, "First look at log.csv", 3),
    "controller": (
        lambda _: iv.axes.emps().identify_controller(iv.datasets.twin())[1],
        "Controller, identified",
        0,
    ),
    "simulation": (
        lambda _: iv.axes.emps().simulate(iv.datasets.twin(), THETA),
        "Simulation of EMPS: 24841 samples",
        3,
    ),
    "excitation": (lambda _: pattern(iv.axes.emps(), LIMITS, "steps"), "Excitation, steps", 3),
    "test": (lambda _: TestResult("Sargan", "valid", 1.0, float("nan"), (2,), "chi2"), "Sargan", 0),
    "test that does not apply": (
        lambda _: TestResult("Sargan", "valid", reason="no instrument " * 9),
        "Sar",
        0,
    ),
    "demo": (lambda _: demo(), "An axis identified", 6),
}


@pytest.mark.parametrize("given", GIVEN)
def test_what_a_call_gives_back_shows_itself(given, tmp_path):
    make, title, panels = GIVEN[given]
    found = make(tmp_path)
    assert isinstance(found, Displayed)
    assert max(map(len, str(found.summary()).splitlines())) <= 80
    assert " ".join(repr(found).split()) == " ".join(found.summary().split())
    assert found._repr_html_().startswith(("<div", "<pre"))
    assert json.dumps(found.to_dict(), allow_nan=False)
    page = found.to_html(tmp_path / "page.html").read_text(encoding="utf-8")
    assert f"<title>{title}" in page and ("<svg" in page) == (panels > 0)
    assert panels == 0 or len(found.plot().axes) == panels


def test_a_simulation_that_diverged_says_so():
    loop = iv.axes.emps()
    free = replace(loop, controller=replace(loop.controller, limit=np.inf))
    said = free.simulate(iv.datasets.twin(), {**THETA, "inertia": 0.1})
    assert "it is unstable" in said.summary() and said.to_dict()["q"][-1] == [None]


_OTHERS = ("Displayed", "Text", "Page", "Record", "ClosedLoop", "Problem", "Score")


def test_no_room_writes_these_faces_again():
    """What shows itself in a notebook is Displayed, but for inputs, texts, pages and gap's own."""
    for module in pkgutil.walk_packages(iv.__path__, "ivtools."):
        if module.name.startswith(("ivtools.gap", "ivtools.cli")) or "__main__" in module.name:
            continue
        for kind in vars(importlib.import_module(module.name)).values():
            own = isinstance(kind, type) and kind.__module__ == module.name
            if own and kind.__name__ not in _OTHERS:
                assert "_repr_html_" not in vars(kind), kind
                assert "summary" not in vars(kind) or issubclass(kind, Displayed), kind


def test_a_simulation_that_diverged_has_a_page_without_a_figure(tmp_path):
    loop, record = iv.axes.emps(), iv.datasets.twin().slice(0, 2000)
    free = replace(loop, controller=replace(loop.controller, delay=9, limit=np.inf))
    base = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    run = free.simulate(record, base)
    assert not run.finite
    page = run.to_html(tmp_path / "run.html").read_text(encoding="utf-8")
    assert "it is unstable" in page and "<svg" not in page
