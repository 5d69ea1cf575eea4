"""Pages in a real browser: they ask for nothing, complain of nothing, and all can read them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from browser import axe, complaints, driver, faults, requests, sized
from robots import plan, reference, two_axes, two_joints

import ivtools as iv
from ivtools.cli import run
from ivtools.pages import comparison_page, fit_page
from ivtools.study import Trapezoids

By = pytest.importorskip("selenium.webdriver.common.by", reason="needs selenium").By
ROOT = Path(__file__).parents[1]
LARGEST = 1_500_000  # bytes of the page of a diagnosis of 25 s


@pytest.fixture(scope="module")
def chrome(tmp_path_factory):
    made = driver(tmp_path_factory.mktemp("downloads"))
    yield made
    made.quit()


@pytest.fixture(scope="module")
def pages(tmp_path_factory, twin) -> dict[str, Path]:
    """One page of each kind."""
    folder, loop = tmp_path_factory.mktemp("pages"), iv.axes.emps()
    problem = iv.Problem(twin, loop)
    fits = [iv.IDIMLS().fit(problem), iv.IDIMIV().fit(problem)]
    truth = loop.with_terms("inertia", "asymmetric-friction")
    fit_page(fits[0]).write(folder / "identify.html")
    comparison_page(iv.compare(fits, twin), twin).write(folder / "compare.html")
    iv.diagnose(twin, loop).to_html(folder / "diagnose.html")
    iv.diagnose(twin, truth).to_html(folder / "nothing named.html")
    assert run(["simulate", "twin", "--out", str(folder / "simulate")]) == 0
    assert run(["demo", "--out", str(folder / "demo")]) == 0
    logs = folder / "logs"
    logs.mkdir()
    for k in range(2):
        twin.to_frame().iloc[3000 * k : 3000 * k + 12_000].to_csv(logs / f"{k}.csv", index=False)
    (logs / "broken.csv").write_text("t,q\n1,2\n")
    fleet = ["diagnose", str(logs), "--axis", "emps", "--out", str(folder / "fleet")]
    assert run([*fleet, "--jobs", "1"]) == 1
    theta = {"inertia": 90.0, "viscous": 210.0, "coulomb": 20.0, "offset": 0.0}
    simulator = loop.simulate(twin, theta)
    theirs = twin.to_frame()[["t", "q_ref"]].assign(q=simulator.q, nu=simulator.nu)
    theirs.to_csv(folder / "simulator.csv", index=False)
    mine = iv.Record.read(folder / "simulator.csv")
    iv.diagnose(twin, loop, simulated=mine).to_html(folder / "simulated.html")
    robot_pages(folder)
    names = ("one_case", "another")
    cases = [iv.Case(name, loop, theta, Trapezoids(3.0), force_noise=2.0) for name in names]
    study = iv.Study(cases, [iv.IDIMLS(), iv.IDIMIV()], seeds=3)
    study.run()
    study.score().to_html(folder / "study.html")
    found = {
        str(file.relative_to(folder)): file
        for file in sorted(folder.rglob("*.html"))
        if file.name != "1.html"
    }
    assert len(found) == 12
    return found


def robot_pages(folder: Path) -> None:
    """A robot of two joints, identified, simulated and diagnosed."""
    loop = iv.RobotLoop(two_joints(), two_axes())
    t, q_ref = reference(8.0, n=2, seed=1)
    noise = 2e-5 * np.random.default_rng(1).standard_normal(q_ref.shape)
    true = loop.with_effect("elbow", "stribeck", force=0.15, speed=0.1, exponent=2.0)
    simulated = true.simulate(plan(t, q_ref), initial="rest", position_noise=noise)
    record = iv.Record(t, q=simulated.q, q_ref=q_ref, nu=simulated.nu, name="robot")
    fit_page(iv.IDIMLS().fit(iv.Problem(record, loop))).write(folder / "robot identified.html")
    iv.diagnose_robot(record, loop).to_html(folder / "robot diagnosed.html")


def test_pages_ask_for_nothing_and_complain_of_nothing(chrome, pages):
    for name, file in pages.items():
        chrome.get(file.as_uri())
        asked = [a for a in requests(chrome) if not a.startswith(("file:", "data:", "about:"))]
        assert not asked, f"{name} asks for {asked}"
        assert not complaints(chrome), name


def test_axe_finds_no_serious_fault(chrome, pages):
    script = axe()
    for name, file in pages.items():
        chrome.get(file.as_uri())
        for width, dark in ((1280, False), (1280, True), (360, False), (360, True)):
            sized(chrome, width, dark)
            chrome.execute_script(
                "document.querySelectorAll('details').forEach((d) => { d.open = true })"
            )
            wide = chrome.execute_script("return document.documentElement.scrollWidth")
            assert wide <= width, f"{name} is {wide} wide on a window of {width}"
            assert not faults(chrome, script), f"{name} at {width}, dark: {dark}"


def test_a_chart_not_yet_drawn_for_a_narrow_window_widens_no_page(chrome, pages):
    for name, file in pages.items():
        chrome.get(file.as_uri())
        sized(chrome, 360)
        wide = chrome.execute_script(
            "document.querySelectorAll('.uplot').forEach((p) => { p.style.width = '972px' });"
            "return document.documentElement.scrollWidth"
        )
        assert wide <= 360, name


def test_pages_are_small(pages):
    sizes = {name: file.stat().st_size for name, file in pages.items()}
    assert max(sizes.values()) <= LARGEST, sizes


def test_nothing_named_is_said(chrome, pages):
    sized(chrome, 1280)
    chrome.get(pages["nothing named.html"].as_uri())
    text = chrome.find_element(By.TAG_NAME, "main").text
    assert "none is named" in text and "Nothing is named" in text
    labels = chrome.execute_script(
        "return [...document.querySelectorAll('.u-legend th')].map((x) => x.textContent)"
    )
    assert "simulated" in " ".join(labels) and "after" not in " ".join(labels)


def test_a_fleet_is_sorted_and_filtered(chrome, pages):
    chrome.get(pages["fleet/index.html"].as_uri())

    def names() -> list[str]:
        rows = chrome.find_elements(By.CSS_SELECTOR, ".sortable tbody tr")
        return [row.find_element(By.TAG_NAME, "td").text for row in rows if row.is_displayed()]

    heads = chrome.find_elements(By.CSS_SELECTOR, ".sortable th button")
    heads[0].click()
    assert names() == ["0", "1", "broken"]
    heads[0].click()
    assert names() == ["broken", "1", "0"]
    heads[3].click()  # before, N: what has no number is last, either way
    first = names()
    heads[3].click()
    assert first[-1] == names()[-1] == "broken" and first[:2] == names()[1::-1]
    chrome.find_element(By.CSS_SELECTOR, "input[type=search]").send_keys("failed")
    assert names() == ["broken"]


def test_a_chart_is_moved_with_the_keyboard(chrome, pages):
    chrome.get(pages["diagnose.html"].as_uri())
    panels = chrome.find_element(By.CSS_SELECTOR, ".panels")
    view = "return ivtoolsCharts.drawn[0].view()"
    whole = chrome.execute_script(view)
    panels.send_keys("+")
    near = chrome.execute_script(view)
    assert near[1] - near[0] < 0.6 * (whole[1] - whole[0])
    panels.send_keys("0")
    time.sleep(0.1)
    assert chrome.execute_script(view) == whole


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The documentation, built as `make docs` does."""
    pytest.importorskip("mkdocs", reason="needs pip install mkdocs-material")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder]
    subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    return folder


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_axe_finds_no_serious_fault_on_the_site(site, dark, tmp_path):
    script, own = axe(), driver(tmp_path)  # a browser of its own: the site remembers its colours
    sized(own, 1280, dark)
    for name in ("index", "methods", "faq", "notebooks/06_the_sim_to_real_gap"):
        own.get((site / f"{name}.html").as_uri())
        scheme = own.execute_script("return document.body.dataset.mdColorScheme")
        assert scheme == ("slate" if dark else "default")
        assert not faults(own, script), name
        asked = [
            a for a in requests(own) if not a.startswith(("file:", "data:", "about:", "blob:"))
        ]
        assert not asked, f"{name} asks for {asked}"
    own.quit()
