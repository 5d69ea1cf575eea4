"""The app in a real browser: upload, correct, identify, diagnose, take away, reload."""

import random
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import app, at_rest, axe, complaints, driver, faults, requests, sized

pytest.importorskip("starlette", reason='the app needs pip install "ivtools[app]"')
By = pytest.importorskip("selenium.webdriver.common.by", reason="needs selenium").By
exceptions = pytest.importorskip("selenium.common.exceptions", reason="needs selenium")


@pytest.fixture(scope="module")
def downloads(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="module")
def chrome(downloads):
    made = driver(downloads)
    yield made
    made.quit()


@pytest.fixture(scope="module")
def served(tmp_path_factory, chrome):
    with app(tmp_path_factory.mktemp("app")) as made:
        yield made
        assert "Traceback" not in made.log and "internal error" not in made.log, made.log


@pytest.fixture(scope="module")
def logs(tmp_path_factory, twin) -> dict[str, str]:
    """Files that a user might drop."""
    folder = tmp_path_factory.mktemp("logs")
    frame = twin.to_frame()[["t", "q", "q_ref", "nu"]].iloc[:12_000]
    millimetres = frame.assign(q=1000 * frame.q, q_ref=1000 * frame.q_ref)
    millimetres.columns = ["time", "position", "setpoint", "voltage"]
    millimetres.to_csv(folder / "a <b>log.csv", index=False)
    twin.to_frame().iloc[12_000:].to_csv(folder / "other.csv", index=False)
    (folder / "broken.csv").write_bytes(b"t;q;nu\n1;2\n\xff\xfe\x00" * 99)
    return {f.name: str(f) for f in folder.iterdir()}


def find(chrome, selector: str):
    return chrome.find_element(By.CSS_SELECTOR, selector)


def press(chrome, selector: str) -> None:
    chrome.execute_script("arguments[0].click()", find(chrome, selector))
    time.sleep(0.3)
    at_rest(chrome)


def drop(chrome, file: str, what: str = "log") -> None:
    find(chrome, f"[data-upload={what}]").send_keys(file)
    time.sleep(0.3)
    at_rest(chrome)


def typed(chrome, name: str, text: str) -> None:
    chrome.execute_script(
        "arguments[0].closest('details').open = true; arguments[0].value = arguments[1]",
        find(chrome, f"[name='{name}']"), text,
    )  # fmt: skip


def fault(chrome, step: str) -> str:
    return str(
        chrome.execute_script(f"return document.querySelector('#{step} .fault').textContent")
    )


def taken(downloads: Path, name: str) -> str:
    """What was downloaded as `name`: the browser keeps the name with an empty file, and moves the
    whole one there in the end."""
    file = downloads / name
    end = time.monotonic() + 60
    while not (file.exists() and file.stat().st_size):
        assert time.monotonic() < end, f"{name} was not downloaded"
        time.sleep(0.1)
    return file.read_text()


def test_from_a_dropped_log_to_its_files(chrome, served, logs, downloads):
    chrome.get(served.address)
    first = chrome.current_url
    drop(chrome, logs["a <b>log.csv"])
    assert find(chrome, "#log strong.file").text == "a <b>log.csv"  # escaped, as text
    assert find(chrome, "#look .verdict").text.startswith("The log suffices")
    typed(chrome, "unit-q", "furlong")
    press(chrome, "form[data-form=correct] button")
    assert "furlong" in fault(chrome, "look")
    for signal in ("q", "q_ref"):
        typed(chrome, f"unit-{signal}", "mm")
    typed(chrome, "gain", "35.15")
    press(chrome, "form[data-form=correct] button")
    assert fault(chrome, "look") == ""
    drop(chrome, logs["other.csv"], "holdout")
    assert "columns" in fault(chrome, "log") or find(chrome, "#log").text.count("other.csv") == 1

    chrome.get(first)  # a reload keeps all
    assert find(chrome, "[name=gain]").get_attribute("value") == "35.15"
    press(chrome, "[data-form=diagnose] button")
    assert "other.csv" in fault(chrome, "diagnose")  # its columns have other names
    drop(chrome, logs["a <b>log.csv"])
    press(chrome, "[data-form=estimate] button")
    assert find(chrome, "#estimate figure.chart .u-over")
    press(chrome, "[data-form=diagnose] button")
    assert find(chrome, "#diagnose .verdict").text
    for name in ("axis.toml", "repeat.py", "diagnosis.json", "estimates.html"):
        chrome.execute_script("arguments[0].click()", find(chrome, f"[href='get/{name}']"))
    assert 'q = "mm"' in taken(downloads, "axis.toml")
    assert "iv.diagnose" in taken(downloads, "repeat.py")
    assert '"verdict"' in taken(downloads, "diagnosis.json")
    assert taken(downloads, "estimates.html").startswith("<!doctype html>")
    assert all(a.startswith(("http://127.0.0.1:", "data:", "blob:")) for a in requests(chrome))
    assert not [c for c in complaints(chrome) if "400 (Bad Request)" not in c]


def test_all_charts_of_a_window_show_the_same_time(chrome, served):
    chrome.get(served.address)
    press(chrome, "[data-do=twin]")
    press(chrome, "[data-form=diagnose] button")
    press(chrome, "#diagnose .chart [data-key='+']")
    views = chrome.execute_script("return ivtoolsCharts.drawn.map((c) => c.view())")
    assert len(views) == 3 and views[0][1] - views[0][0] < 20.0
    assert np.allclose(views, [views[0]] * 3)


def test_two_windows_at_once_and_a_broken_file(chrome, served, logs):
    chrome.get(served.address)
    one = chrome.current_url
    find(chrome, "[data-do=twin]").click()
    chrome.switch_to.new_window("tab")
    chrome.get(served.address)
    drop(chrome, logs["broken.csv"])
    told = fault(chrome, "look")
    assert "not a text file" in told and "/tmp" not in told
    chrome.close()
    chrome.switch_to.window(chrome.window_handles[0])
    at_rest(chrome)
    assert chrome.current_url == one and find(chrome, "#log strong.file").text == "twin"


def test_work_is_cancelled(chrome, served):
    chrome.get(served.address)
    press(chrome, "[data-do=twin]")
    chrome.execute_script("document.querySelector('[data-form=diagnose] button').click()")
    time.sleep(0.5)
    press(chrome, "#diagnose [data-do=cancel]")
    assert fault(chrome, "diagnose") == "Cancelled."


@pytest.mark.parametrize("n", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_a_long_record_is_shown_whole_where_one_looks(chrome, tmp_path, n):
    t = np.arange(n) / 1000.0
    rng = np.random.default_rng(0)
    q = 0.1 * np.sin(2.0 * t) + 0.05 * np.sin(0.3 * t)
    frame = pd.DataFrame({"t": t, "q_ref": q, "q": q + rng.normal(0, 1e-5, n)})
    frame["nu"] = 50.0 * (frame.q_ref - frame.q) + rng.normal(0, 0.01, n)
    file = tmp_path / "long.parquet"
    frame.to_parquet(file)
    text = "kp = 50.0\\nkd = 0.0\\n[drive]\\ngain = 1.0\\n"
    axis = tmp_path / "axis.toml"
    axis.write_text(f'[controller]\nkind = "pd"\n{text}'.replace("\\n", "\n"))
    with app(tmp_path, str(file), "--axis", str(axis)) as own:
        chrome.get(own.address)
        at_rest(chrome)
        chrome.execute_script("document.querySelector('#look figure.chart').scrollIntoView()")
        for _ in range(6):
            chrome.execute_script("document.querySelector(\"#look .chart [data-key='+']\").click()")
            time.sleep(0.6)
        figure = find(chrome, "#look figure.chart")
        end = time.monotonic() + 30
        while figure.get_attribute("data-samples") is None and time.monotonic() < end:
            time.sleep(0.1)
        shown = chrome.execute_script(
            "const c = ivtoolsCharts.drawn[0], d = c.plots[0].data; return [c.view(), d[0], d[1]]"
        )
        (start, stop), times, values = shown
        assert stop - start < n / 9000.0 and len(times) > 1000
        inside = (t >= start) & (t <= stop)
        assert max(v for v in values if v is not None) >= frame.q[inside].max() - 1e-6
        assert "Traceback" not in own.log


@pytest.mark.parametrize("width", [1280, 360])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_axe_finds_no_serious_fault_in_the_app(chrome, served, logs, width, dark):
    script = axe()
    sized(chrome, width, dark)
    chrome.get(served.address)
    assert not faults(chrome, script)
    drop(chrome, logs["a <b>log.csv"])
    if width == 1280 and not dark:
        press(chrome, "[data-form=estimate] button")
        press(chrome, "[data-form=diagnose] button")
    chrome.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    assert chrome.execute_script("return document.documentElement.scrollWidth") <= width
    assert not faults(chrome, script)
    sized(chrome, 1280)


TEXTS = ("", "mm", "-1", "1e999", "<script>", "q", "[axis]", "9" * 400)


def act(chrome, action: str, rng: random.Random, logs: dict[str, str]) -> None:
    """Do one thing of a kind somewhere in the window."""

    def one(selector: str):
        return rng.choice(chrome.find_elements(By.CSS_SELECTOR, selector))

    if action == "click":
        chrome.execute_script("arguments[0].click()", one("button, summary, [type=checkbox]"))
    elif action == "type":
        place = one("input:not([type]), textarea, select")
        chrome.execute_script("arguments[0].value = arguments[1]", place, rng.choice(TEXTS))
    elif action == "drop":
        one("[data-upload]").send_keys(rng.choice(list(logs.values())))
    elif action == "key":
        one(".panels").send_keys(rng.choice(["+", "-", "0"]))
    elif action == "reload":
        chrome.refresh()
    else:
        chrome.back()


def walk(chrome, served, logs: dict[str, str], seconds: float, seed: int) -> list[str]:
    """Click, type and drop at random for a while; return what was done."""
    rng, done = random.Random(seed), []
    kinds = [*["click"] * 6, "type", "type", "drop", "drop", "key", "reload", "back", "new"]
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        action = rng.choice(kinds)
        if action == "new" or "127.0.0.1" not in chrome.current_url:
            chrome.get(served.address)
        done.append(action)
        try:
            act(chrome, action, rng, logs)
        except (exceptions.WebDriverException, IndexError):  # gone meanwhile, or nothing there
            done[-1] += " (nothing)"
        time.sleep(rng.choice([0.05, 0.2, 1.0]))
    chrome.get(served.address)
    return done


def walked(chrome, logs, folder: Path, seconds: float) -> None:
    with app(folder) as own:
        chrome.get(own.address)
        press(chrome, "[data-do=twin]")
        press(chrome, "[data-form=diagnose] button")
        before = own.memory()
        done = walk(chrome, own, logs, seconds, seed=1)
        press(chrome, "[data-do=twin]")
        grown = own.memory() - before
        assert "Traceback" not in own.log and "internal error" not in own.log, own.log
        print(f"{before:.0f} MB, {grown:+.0f} MB after {len(done)} actions")
        assert grown < 300.0, f"{grown:.0f} MB more"
        assert sum("nothing" not in action for action in done) > len(done) / 3


def test_half_a_minute_of_random_clicks(chrome, logs, tmp_path):
    walked(chrome, logs, tmp_path, 30.0)


@pytest.mark.slow
def test_half_an_hour_of_random_clicks(chrome, logs, tmp_path):
    walked(chrome, logs, tmp_path, 1800.0)
