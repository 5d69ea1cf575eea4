"""Charts: what a page's script draws is what was measured."""

import json
import re
from base64 import b64decode

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ivtools as iv
from ivtools.pages import fit_page
from ivtools.plots.chart import STRETCHES, WHOLE, Chart, Panel, Region, Series, worst
from ivtools.report import Card, Page, terms


def chart(values, regions=(), rate=1000.0) -> Chart:
    t = 1e9 + np.arange(len(values)) / rate
    panel = Panel("force", "N", (Series("measured", values, "measured"),))
    return Chart("force", t, (panel,), "A force.", regions)


def decoded(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(b64decode(text), dtype=kind)


@settings(max_examples=30, deadline=None)
@given(n=st.integers(2, 60_000), seed=st.integers(0, 2**32 - 1), gaps=st.booleans())
def test_thinning_keeps_every_extreme_and_its_place(n, seed, gaps):
    rng = np.random.default_rng(seed)
    values = rng.standard_cauchy(n)
    if gaps:
        values[rng.integers(0, n, n // 5)] = np.nan
    made = chart(values)
    shown = made.thinned(values)
    assert len(shown) == len(made.rows) <= max(4 * STRETCHES, WHOLE)
    if not np.isnan(values).all():
        assert np.nanmax(shown) == np.nanmax(values) and np.nanmin(shown) == np.nanmin(values)
        at = made.t[made.rows[np.nanargmax(shown)]]
        width = 2.0 * n / STRETCHES / 1000.0 + 1e-3
        assert abs(at - made.t[np.nanargmax(values)]) <= width


def test_the_samples_of_a_region_are_whole():
    values = np.random.default_rng(1).normal(size=100_000)
    made = chart(values, (Region(1e9 + 30.0, 1e9 + 31.0, "here"),))
    inside = (made.t[made.rows] >= 1e9 + 30.0) & (made.t[made.rows] < 1e9 + 31.0)
    assert np.array_equal(made.thinned(values)[inside], values[30_000:31_000])


def test_packed_numbers_come_back_and_late_times_keep_their_milliseconds():
    values = np.arange(3000.0)
    content = chart(values).content()
    t = decoded(content["t"], "<f8") + content["begin"]
    assert np.allclose(np.diff(t), 1e-3, atol=1e-6)
    packed = content["panels"][0]["series"][0]["values"]
    assert np.array_equal(decoded(packed, "<f4"), values)


@pytest.mark.parametrize("n", [2, 3, 10])
def test_short_signals_have_no_worst_second(n):
    assert worst(np.arange(n) / 1000.0, np.ones(n)) == ()


def test_a_page_holds_its_data_as_json_and_no_markup_of_a_name():
    made = Page("A title", "A lead.", Card("Done.", (("inertia", "1 kg"),)))
    name = "</script><script>alert(1)</script>"
    series = Series(name, np.zeros(10), "measured")
    figure = Chart("force", np.arange(10.0), (Panel("force", "N", (series,)),), name)
    made.add("Force", figures=[figure])
    html = made.html()
    assert "alert(1)</script>" not in html
    (text,) = re.findall(r'<script type="application/json">(.*?)</script>', html, re.DOTALL)
    assert json.loads(text)["panels"][0]["series"][0]["label"] == name


def test_a_shared_script_stands_beside_the_page():
    made = Page("A title", "A lead.")
    made.add("Force", figures=[chart(np.zeros(10))])
    alone, shared = made.html(), made.html(script="charts.js")
    assert '<script src="charts.js"></script>' in shared and "uPlot" not in shared
    assert len(alone) > len(shared) + 50_000


def test_each_word_is_explained_once_and_listed():
    made = Page("A title", "The floor is a floor; a floor-lamp is not.")
    html = made.html()
    assert html.count("<dfn") == 1 and "floor-lamp" in html
    assert f'<dd id="term-1">{terms()["floor"]}</dd>' in html


def test_a_fit_says_its_values_first(twin):
    fit = iv.IDIMIV().fit(iv.Problem(twin, iv.axes.emps()))
    html = fit_page(fit).html()
    assert re.search(r"inertia 95\.\d+ ± 0\.\d+ kg", html)
    assert html.index('class="verdict"') < html.index("<h2>")
    assert len(html) < 1_500_000
