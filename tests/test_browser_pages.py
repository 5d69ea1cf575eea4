"""Pages in a real browser: they ask for nothing, complain of nothing, and all can read them."""

import time
from pathlib import Path

import pytest
from browser import axe, complaints, driver, faults, requests, sized

import ivtools as iv
from ivtools.cli import run
from ivtools.pages import comparison_page, fit_page

By = pytest.importorskip("selenium.webdriver.common.by", reason="needs selenium").By
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
    found = {
        str(file.relative_to(folder)): file
        for file in sorted(folder.rglob("*.html"))
        if file.name != "1.html"
    }
    assert len(found) == 8
    return found


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
