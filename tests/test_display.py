"""Displayed: every result offers the same faces, and what they hold is what programs can read."""

import importlib
import json
import pkgutil

import numpy as np
import pandas as pd
import pytest

import ivtools
from ivtools.display import Displayed, plain
from ivtools.results import FitResults
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


_OTHERS = ("Displayed", "Text", "Page", "Record", "ClosedLoop", "Problem", "Score")


def test_no_room_writes_these_faces_again():
    """What shows itself in a notebook is Displayed, but for inputs, texts, pages and gap's own."""
    for module in pkgutil.walk_packages(ivtools.__path__, "ivtools."):
        if module.name.startswith(("ivtools.gap", "ivtools.cli")) or "__main__" in module.name:
            continue
        for kind in vars(importlib.import_module(module.name)).values():
            own = isinstance(kind, type) and kind.__module__ == module.name
            if own and "_repr_html_" in vars(kind):
                assert kind.__name__ in _OTHERS, kind
