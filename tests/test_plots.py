"""Figures: what is on them, and that a column of 80 mm can print them."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import ivtools as iv
from ivtools import plots
from ivtools.plots import style
from ivtools.plots.study import heatmap

TRUTH = {"inertia": 95.0, "viscous_pos": 165.0}


@pytest.fixture(scope="module")
def problem(twin):
    return iv.Problem(twin, iv.axes.emps())


@pytest.fixture(scope="module")
def fit(problem):
    return iv.IDIMLS().fit(problem)


@pytest.fixture(scope="module")
def asymmetric(problem):
    loop = problem.loop.with_terms("inertia", "asymmetric-friction")
    return iv.IDIMLS().fit(replace(problem, loop=loop))


@pytest.fixture(scope="module")
def revolute():
    """A record of a small revolute axis, as its own loop simulates it."""
    from ivtools.loop.controllers import Controller

    loop = iv.ClosedLoop(
        Controller("pd", {"kp": 4.0, "kd": 0.02}), 0.05, ("inertia", "viscous", "coulomb"),
        joint="revolute", start={"inertia": 2e-4, "viscous": 1e-4, "coulomb": 2e-3},
    )  # fmt: skip
    t = np.arange(4000) * 1e-3
    q_ref = np.sin(2 * np.pi * t) * np.minimum(t, 1.0)
    driven = iv.Record(t, q=q_ref, q_ref=q_ref, nu=q_ref)
    record = loop.simulate(driven, initial="rest").to_record(q_ref=q_ref)
    return loop, record


FIGURES = {
    "force": lambda p, f, a: plots.force(f),
    "cross-test": lambda p, f, a: plots.force(f, p),
    "simulation": lambda p, f, a: plots.simulation(p.simulate(f.params), p.record),
    "simulation, wide": lambda p, f, a: plots.simulation(
        p.simulate(f.params), p.record, width_mm=160.0
    ),
    "parameters": lambda p, f, a: plots.parameters([f, a], truth=TRUTH),
    "one parameter set": lambda p, f, a: plots.parameters([f]),
    "residuals": lambda p, f, a: plots.residuals([f, a]),
}


@pytest.fixture(params=FIGURES, scope="module")
def figure(request, problem, fit, asymmetric):
    return FIGURES[request.param](problem, fit, asymmetric)


def shown(figure):
    return [axes for axes in figure.axes if axes.get_visible()]


def labels(axis) -> list[str]:
    """The tick labels that are drawn: those inside the axes' limits."""
    low, high = sorted(axis.get_view_interval())
    return [
        tick.label1 for tick in axis.get_major_ticks()
        if low <= tick.get_loc() <= high and tick.label1.get_text() and tick.label1.get_visible()
    ]  # fmt: skip


def test_every_axis_has_a_unit(figure):
    for axes in shown(figure):
        below = axes.get_subplotspec()
        y, x = axes.get_ylabel(), axes.get_xlabel()
        assert ", " in y.replace(",\n", ", ") or ", " in x, f"{axes} at {below} has no unit"
    assert any(", " in axes.get_xlabel() for axes in shown(figure))


def test_letters_can_be_read_at_80_mm(figure):
    scale = min(1.0, 80.0 / 25.4 / figure.get_figwidth()) if figure.get_figwidth() < 4 else 1.0
    figure.draw_without_rendering()
    for text in figure.findobj(mpl.text.Text):
        if text.get_text().strip():
            assert text.get_fontsize() * scale >= 6.0


def test_no_labels_overlap_or_leave_the_figure(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    page = figure.bbox
    for axes in shown(figure):
        for axis in (axes.xaxis, axes.yaxis):
            boxes = [label.get_window_extent(renderer) for label in labels(axis)]
            for one, other in zip(boxes, boxes[1:], strict=False):
                assert not one.overlaps(other), f"tick labels of {axis} overlap"
    texts = [t for t in figure.findobj(mpl.text.Text) if t.get_text().strip() and t.get_visible()]
    titles = [t for t in texts if t in [axes.title for axes in figure.axes]]
    for text in [*titles, *(a.xaxis.label for a in shown(figure)), *(
        a.yaxis.label for a in shown(figure)
    )]:  # fmt: skip
        box = text.get_window_extent(renderer)
        if box.width and text.get_text():
            assert box.x0 >= page.x0 - 1 and box.x1 <= page.x1 + 1
            assert box.y0 >= page.y0 - 1 and box.y1 <= page.y1 + 1


def test_panels_do_not_overlap(figure):
    figure.draw_without_rendering()
    boxes = [axes.get_window_extent() for axes in shown(figure)]
    for k, one in enumerate(boxes):
        assert not any(one.overlaps(other) for other in boxes[k + 1 :])
        assert one.width > 60 and one.height > 25


def test_files_are_small(figure):
    assert 1_000 < len(style.encode(figure, "svg")) < 700_000


def test_the_same_figure_is_the_same_file_of_every_kind(fit, tmp_path):
    for kind in ("svg", "png", "pdf"):
        files = [plots.save(plots.force(fit), tmp_path / n / f"f.{kind}") for n in "ab"]
        assert files[0].read_bytes() == files[1].read_bytes()


def test_the_figure_shows_itself_in_a_notebook(fit):
    assert fit.plot()._repr_png_().startswith(b"\x89PNG")


def test_the_lines_are_the_data(fit):
    top, bottom = plots.force(fit).axes
    measured, model = (line.get_ydata() for line in top.lines)
    np.testing.assert_array_equal(measured, fit.y)
    np.testing.assert_allclose(measured - model, bottom.lines[0].get_ydata())
    assert f"{fit.relative_error:.2f} %" in bottom.figure.get_suptitle()


def test_a_long_line_keeps_its_extremes_and_the_colours_of_its_page():
    t, x = np.arange(100_000) / 1e3, np.zeros(100_000)
    x[54_321], x[77_777], x[10_000:20_000] = 3.0, -2.0, np.nan
    with style.look():
        figure = style.sheet(80.0, 50.0)
        style.line(figure.subplots(), t, x, color=style.COLOURS["model"])
    drawn = figure.axes[0].lines[0].get_ydata()
    assert len(drawn) < 4_000 and (np.nanmin(drawn), np.nanmax(drawn)) == (-2.0, 3.0)
    assert np.isnan(drawn).any()
    inline = style.inline(figure, "f", "a line")
    assert "<image" not in inline and "var(--model)" in inline  # not pixels, which stay as they are


def test_numbers_on_a_heat_map_keep_the_colour_that_suits_their_cell(twin):
    loop = iv.axes.emps()
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    cases = [
        iv.Case(name, loop, theta, iv.study.Trapezoids(3.0), force_noise=noise)
        for name, noise in (("low", 1.0), ("high", 30.0))
    ]
    study = iv.Study(cases, [iv.IDIMLS()], seeds=2)
    study.run()
    colours = {text.get_color() for text in heatmap(study.score()).axes[0].texts}
    assert colours == {"#111111", "#fdfdfd"} and not colours & set(style._THEMED)


def test_rows_that_are_left_out_leave_a_gap(problem):
    rows = replace(problem, pipeline=replace(problem.pipeline, min_speed=0.02, guard=20))
    fit = iv.IDIMLS().fit(rows)
    chart = plots.force_chart(fit, name="force", caption="A force.")
    measured = chart.panels[0].series[0].values
    np.testing.assert_array_equal(measured[np.isfinite(measured)], fit.y)
    steps = np.diff(fit.t)
    assert 0 < np.isnan(measured).sum() == np.sum(steps > 5.0 * np.median(steps))


def test_the_panels_of_a_simulation_name_its_errors(problem, fit):
    simulated = problem.simulate(fit.params)
    errors = simulated.relative_error(problem.record)
    figure = plots.simulation(simulated, problem.record)
    assert [a.get_title(loc="right") for a in figure.axes[::2]] == [
        f"{error:.3g} %" for error in errors.values()
    ]


def test_intervals_are_those_of_the_result(fit):
    axes = plots.parameters([fit]).axes[0]
    ends = axes.containers[0].lines[2][0].get_segments()[0][:, 0]
    np.testing.assert_allclose(ends, fit.conf_int().loc["inertia"])
    assert axes.get_xlabel() == "inertia, kg"


def test_a_revolute_axis_has_its_own_units(revolute):
    loop, record = revolute
    figure = plots.simulation(loop.simulate(record), record)
    text = " ".join(axes.get_ylabel() for axes in figure.axes)
    assert "rad/s²" in text and "torque" in text and "N m" in text
    problem = iv.Problem(record, loop)
    assert "N m" in plots.force(iv.IDIMLS().fit(problem)).axes[0].get_ylabel()
    figure = plots.parameters([iv.IDIMLS().fit(problem)])
    assert figure.axes[0].get_xlabel() == "inertia, kg m²"


def test_global_state_is_left_alone(fit):
    before = dict(mpl.rcParams)
    style.encode(plots.force(fit), "png")
    assert dict(mpl.rcParams) == before
    code = "import sys, ivtools.plots; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_colours_differ_for_the_colour_blind():
    """Luminances differ, so that even a grey print tells the two lines apart."""

    def luminance(colour: str) -> float:
        r, g, b = mpl.colors.to_rgb(colour)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    measured, model = (luminance(style.COLOURS[name]) for name in ("measured", "model"))
    assert measured - model > 0.25


def test_figures_drawn_in_threads_are_those_drawn_alone(twin):
    """Matplotlib's settings are those of the process: one thread draws at a time."""
    fits = [iv.IDIMLS().fit(iv.Problem(twin.slice(0, 4000 + k), iv.axes.emps())) for k in range(4)]

    def drawn(fit) -> bytes:
        return style.encode(plots.residuals([fit]))

    alone = [drawn(fit) for fit in fits]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(drawn, fits * 4)) == alone * 4
