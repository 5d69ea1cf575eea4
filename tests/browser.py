"""A real browser for tests: Debian's Chromium, driven by Selenium; and the app that it visits."""

import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from ivtools.files import write

AXE = "https://registry.npmjs.org/axe-core/-/axe-core-4.14.1.tgz"
AXE_SHA256 = "e6b0ce02b84d892e2e33e403485e7f3d6c29e2be6df65daf44d89ba564139745"
_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
)  # fmt: skip


def driver(downloads: Path) -> Any:
    """Return Chromium, or skip with the reason why there is none."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs pip install selenium")
    places = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if None in places:
        pytest.skip("needs apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = places[0]
    for flag in _FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    settings = {
        "download.default_directory": str(downloads),
        "profile.default_content_setting_values.automatic_downloads": 1,
        "safebrowsing.enabled": True,  # else a script waits for a person to keep it
    }
    options.add_experimental_option("prefs", settings)
    try:
        made = webdriver.Chrome(options, webdriver.ChromeService(places[1]))
    except Exception as error:
        pytest.skip(f"Chromium does not start: {str(error).splitlines()[0]}")
    made.set_page_load_timeout(120)
    made.set_script_timeout(120)
    return made


def sized(chrome: Any, width: int, dark: bool = False) -> None:
    """Make the window this wide, in CSS pixels, and light or dark."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})


def requests(chrome: Any) -> list[str]:
    """Return the addresses that were asked for since this was last called."""
    found = [json.loads(entry["message"])["message"] for entry in chrome.get_log("performance")]
    sent = [m["params"] for m in found if m["method"] == "Network.requestWillBeSent"]
    return [p["request"]["url"] for p in sent]


def complaints(chrome: Any) -> list[str]:
    """Return what the browser's console has heard since this was last called."""
    return [entry["message"] for entry in chrome.get_log("browser") if entry["level"] == "SEVERE"]


def axe() -> str:
    """Return the script of axe-core, fetched once and checked; skip without a network."""
    kept = Path.home() / ".cache" / "ivtools-tests" / AXE.rsplit("/", 1)[-1]
    try:
        content = kept.read_bytes() if kept.exists() else urlopen(AXE, timeout=30).read()
    except OSError as error:
        pytest.skip(f"axe-core cannot be fetched: {error}")
    assert hashlib.sha256(content).hexdigest() == AXE_SHA256
    if not kept.exists():
        write(kept, content)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        file = archive.extractfile("package/axe.min.js")
        assert file is not None
        return file.read().decode()


def faults(chrome: Any, script: str) -> list[str]:
    """Return what axe-core finds serious or critical on the page as it is."""
    chrome.execute_script(script)
    found = chrome.execute_async_script(
        "const done = arguments[0];"
        "const broken = (e) => done([{impact: 'serious', id: `${e}`, nodes: []}]);"
        "axe.run(document, {resultTypes: ['violations']}).then((r) => done(r.violations), broken)"
    )
    return [
        f"{v['id']}: {v.get('help')}: {[n['html'][:150] for n in v['nodes'][:4]]}"
        for v in found
        if v["impact"] in ("serious", "critical")
    ]


class App:
    """The app as its user starts it, and what it writes to its log."""

    def __init__(self, process: Any, log: Path, address: str):
        self.process, self.address, self._log = process, address, log

    @property
    def log(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    def memory(self) -> float:
        """Return what the server and its workers hold, MB, not counting what they share."""
        kept = [self.process.pid]
        for pid in kept:
            children = Path(f"/proc/{pid}/task/{pid}/children")
            kept += [int(p) for p in children.read_text().split()] if children.exists() else []
        return sum(_own_memory(pid) for pid in kept)


def _own_memory(pid: int) -> float:
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    except OSError:
        return 0.0
    return sum(float(x) for x in re.findall(r"^Private_Dirty:\s+(\d+)", text, re.M)) / 1e3


@contextmanager
def app(folder: Path, *arguments: str) -> Iterator[App]:
    """Run the app, as a process of its own, until the block ends."""
    log = folder / "app.log"
    code = "from ivtools.cli import main; main()"
    command = [sys.executable, "-c", code, "app", "--no-window", *arguments]
    root = str(Path(__file__).parent.parent)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONPATH": root}
    with log.open("w") as err:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=err, text=True, env=environment
        )
    try:
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, f"no address but {line!r}; {log.read_text()}"
        yield App(process, log, found[0])
    finally:
        process.terminate()
        process.wait(20)


def at_rest(chrome: Any, seconds: float = 600.0) -> None:
    """Wait until nothing is at work in the app's window."""
    end = time.monotonic() + seconds
    while chrome.execute_script("return document.body.dataset.at") != "rest":
        assert time.monotonic() < end, "the app is still at work"
        time.sleep(0.1)
