"""The app without a browser: who may ask, what is taken, and what it gives back."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time

import numpy as np
import pytest

pytest.importorskip("starlette", reason='the app needs pip install "ivtools[app]"')
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")
from starlette.testclient import TestClient

import ivtools as iv
from ivtools.app import charts
from ivtools.app.script import script
from ivtools.app.server import Server, sweep
from ivtools.cli import run
from ivtools.files import LOCK, claimed
from ivtools.plots.chart import Chart, Panel, Series
from ivtools.report import Page

OURS = {"X-Ivtools": "1"}
ROUNDS = 30  # in which workers are killed


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    made = Server(tmp_path_factory.mktemp("app"), largest=20.0)
    yield made
    made.close()


@pytest.fixture
def client(server) -> TestClient:
    return TestClient(server.app, base_url="http://127.0.0.1", headers=OURS)


def opened(client: TestClient, server: Server) -> str:
    answer = client.get(server.base, follow_redirects=False)
    assert answer.status_code == 303
    return answer.headers["location"]


def rest(client: TestClient, place: str, seconds: float = 120.0) -> dict:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        steps = client.get(f"{place}state").json()["steps"]
        if not any(step["status"] == "working" for step in steps.values()):
            return steps
        time.sleep(0.1)
    raise AssertionError(f"still at work: {steps}")


def german(twin) -> bytes:
    """The twin as a servo's logger would write it: mm, semicolons, decimal commas."""
    frame = twin.to_frame()[["t", "q", "q_ref", "nu"]].iloc[:8000]
    frame = frame.assign(q=1000 * frame.q, q_ref=1000 * frame.q_ref)
    frame.columns = ["Zeit [s]", "Lage ist [mm]", "Lage soll [mm]", "Stellgröße [V]"]
    return frame.to_csv(sep=";", decimal=",", index=False, float_format="%.9g").encode()


@pytest.mark.parametrize(
    "headers",
    [
        {"host": "evil.example"},
        {"host": "127.0.0.1.evil.example:80"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "https://127.0.0.1"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_requests_from_elsewhere_are_refused(client, server, headers, method):
    place = opened(client, server)
    address = f"{place}state" if method == "GET" else f"{place}do/twin"
    assert client.request(method, address, headers=headers).status_code == 403


def test_a_form_of_another_page_cannot_post(client, server):
    place = opened(client, server)
    plain = TestClient(server.app, base_url="http://127.0.0.1")
    assert plain.post(f"{place}do/twin").status_code == 403  # no page of the app sends that
    assert client.get(f"{place}state").json()["steps"]["look"]["status"] == ""


def test_nothing_is_found_without_the_key(client, server):
    opened(client, server)
    for address in ("/", "/state", "/s/x/", f"{server.base}s/x/", f"{server.base}../etc/passwd"):
        assert client.get(address).status_code in (404, 410)


def test_answers_allow_no_script_but_their_own(client, server):
    answer = client.get(opened(client, server))
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy and answer.headers["cache-control"] == "no-store"
    assert not re.search(r'(src|href)="https?://', answer.text)


def test_an_upload_is_bounded_whether_it_says_its_size_or_not(client, server):
    place = opened(client, server)
    large = b"1" * 21_000_000
    told = client.post(f"{place}upload/log?name=a.csv", content=large)
    streamed = client.post(f"{place}upload/log?name=a.csv", content=iter([large[:11_000_000]] * 2))
    for answer in (told, streamed):
        assert answer.status_code == 400 and "larger than 20 MB" in answer.json()["error"]
    (session,) = [s for s in server.sessions._all.values() if s.address == place]
    assert not [f for f in session.folder.rglob("*") if f.is_file()]


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("../../etc/cron.d/x.csv", "x.csv"),
        ("..\\..\\a b<img src=x>.csv", "a_b_img_src_x.csv"),
        ("C:\\logs\\größe.CSV.GZ", "gr_e.csv.gz"),
        (".csv", "log.csv"),
    ],
)
def test_names_of_files_lead_nowhere(server, name, kept):
    session = server.sessions.new()
    place = session.place(name)
    assert place.name == kept and place.parent.parent == session.folder


def test_an_unknown_kind_of_file_is_refused(client, server):
    place = opened(client, server)
    answer = client.post(f"{place}upload/log?name=a.exe", content=b"MZ")
    assert answer.status_code == 400 and "unknown type" in answer.json()["error"]


@pytest.mark.parametrize("body", [b"[1]", b"{", b"[" * 100_000, b"1" * 2_000_000])
def test_forms_that_are_none_are_refused(client, server, body):
    place = opened(client, server)
    assert client.post(f"{place}do/estimate", content=body).status_code == 400


def test_a_log_from_file_to_script(client, server, twin, tmp_path):
    place = opened(client, server)
    name = "<b>achse</b> 1.csv"
    client.post(f"{place}upload/log?name={name}", content=german(twin))
    assert rest(client, place)["look"]["status"] == "done"
    page = client.get(place).text
    assert "<b>achse" not in page and "&lt;b&gt;achse" in page
    axis = client.get(f"{place}get/axis.toml").text
    assert 'q = "mm"' in axis and 'kind = "cascade-pd"' in axis

    client.post(f"{place}do/estimate", json={"methods": ["idim-ls", "nowhere"]})
    assert rest(client, place)["estimate"]["status"] == "done"
    found = client.get(f"{place}get/estimates.json").json()["idim-ls"]["params"]

    code = client.get(f"{place}get/repeat.py").text
    (tmp_path / "axis.toml").write_text(axis)
    (tmp_path / name.replace("/", "_")).write_bytes(german(twin))
    code = code.replace(name, name.replace("/", "_"))
    code = f"{code}\nimport json; print(json.dumps(dict(comparison.results[0].params)))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == pytest.approx(found, rel=1e-12)


def test_a_unit_is_corrected_and_what_rests_on_it_goes(client, server, twin):
    place = opened(client, server)
    frame = twin.to_frame()[["t", "q", "q_ref", "nu"]].iloc[:8000]
    frame.columns = ["a", "b", "c", "d"]  # no name tells anything
    content = frame.assign(a=1000 * frame.a).to_csv(index=False).encode()
    client.post(f"{place}upload/log?name=log.csv", content=content)
    assert rest(client, place)["look"]["status"] == "done"
    fields = {f"column-{s}": c for s, c in zip(("t", "q", "q_ref", "nu"), "abcd", strict=True)}
    bad = {**fields, "unit-t": "ms", "unit-q": "furlong"}
    client.post(f"{place}do/correct", json=bad)
    told = rest(client, place)["look"]
    assert told["status"] == "failed" and "furlong" in told["text"] and "/" not in told["text"]
    fields |= {"unit-t": "ms", "unit-q": "m", "unit-q_ref": "m", "gain": "35,15"}
    client.post(f"{place}do/correct", json=fields)
    assert rest(client, place)["look"]["status"] == "done"
    axis = client.get(f"{place}get/axis.toml").text
    assert "gain = 35.15" in axis and 't = "ms"' in axis
    client.post(f"{place}do/estimate", json={"methods": ["idim-ls"]})
    rest(client, place)
    inertia = client.get(f"{place}get/estimates.json").json()["idim-ls"]["params"]["inertia"]
    assert inertia == pytest.approx(95.0, rel=0.02)
    stated = axis.replace("35.15", "70.3").replace("kp = ", "kp = 1")
    client.post(f"{place}do/axis", json={"text": stated})
    assert rest(client, place)["look"]["status"] == "done"
    client.post(f"{place}do/correct", json={**fields, "gain": "70"})
    assert rest(client, place)["look"]["status"] == "done"
    kept = client.get(f"{place}get/axis.toml").text
    assert "gain = 70.0" in kept and re.search(r"kp = 1\d\d\d\.", kept)  # a stated law stays
    assert client.get(f"{place}get/estimates.json").status_code == 400  # made with another gain


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00\xff" * 500,
        b"t,q\n1,2\n",
        b"nothing\n" * 300,
        b"t,q,q_ref,nu\n" + b"x,y,z,w\n" * 300,
    ],
)
def test_a_broken_file_is_told_in_a_line(client, server, content):
    place = opened(client, server)
    client.post(f"{place}upload/log?name=broken.csv", content=content)
    step = rest(client, place)["look"]
    text = step["text"] or client.get(f"{place}section/look").text
    assert step["status"] == "failed" or "not recognised" in text
    assert "Traceback" not in text and "internal error" not in text and "ivtools-app" not in text
    assert client.post(f"{place}do/diagnose", json={}).status_code == 400


def test_work_is_cancelled_and_begun_again(client, server):
    place = opened(client, server)
    client.post(f"{place}do/twin")
    rest(client, place)
    client.post(f"{place}do/diagnose", json={})
    assert client.post(f"{place}do/estimate", json={"methods": ["ml"]}).status_code == 400  # busy
    client.post(f"{place}do/cancel")
    assert rest(client, place)["diagnose"]["status"] == "cancelled"
    client.post(f"{place}do/estimate", json={"methods": ["idim-ls"]})
    assert rest(client, place)["estimate"]["status"] == "done"


def test_a_hold_out_that_comes_during_a_correction_takes_nothing_from_it(client, server, twin):
    place = opened(client, server)
    client.post(f"{place}upload/log?name=log.csv", content=german(twin))
    assert rest(client, place)["look"]["status"] == "done"
    columns = ("Zeit [s]", "Lage ist [mm]", "Lage soll [mm]", "Stellgröße [V]")
    signals = ("t", "q", "q_ref", "nu")
    fields = {f"column-{s}": c for s, c in zip(signals, columns, strict=True)}
    fields |= {"unit-q": "mm", "unit-q_ref": "mm", "gain": "35.15"}
    client.post(f"{place}do/correct", json=fields)
    client.post(f"{place}upload/holdout?name=other.csv", content=german(twin))
    told = rest(client, place)["look"]
    assert told["status"] == "done", told["text"]
    assert "gain = 35.15" in client.get(f"{place}get/axis.toml").text
    assert "other.csv" in client.get(place).text


def test_sessions_know_nothing_of_each_other_and_are_bounded(client, server):
    one, two = opened(client, server), opened(client, server)
    client.post(f"{one}do/twin")
    rest(client, one)
    assert "<strong" in client.get(one).text and "<strong" not in client.get(two).text
    assert client.get(f"{two}get/axis.toml").status_code == 400
    for _ in range(20):
        opened(client, server)
    assert client.get(one).status_code == 410 and len(server.sessions._all) == 16


def test_a_window_of_a_chart_is_what_was_measured(tmp_path):
    rng = np.random.default_rng(0)
    t, x = np.arange(200_000) / 1000.0, rng.normal(size=200_000).astype(np.float32)
    panels = (Panel("force", "N", (Series("measured", x, "measured"),)),)
    page = Page("A", "b.")
    page.add("c", figures=[Chart("force", t, panels, "A force.")])
    charts.keep(page, tmp_path)
    made = charts.kept(tmp_path, "force")
    near = made.window(50.0, 52.0)
    assert near.content()["complete"]
    assert np.array_equal(near.panels[0].series[0].values, x[49_999:52_001])
    half = made.window(0.0, 100.0)
    shown = half.thinned(half.panels[0].series[0].values)
    assert shown.max() == x[:100_001].max() and shown.min() == x[:100_001].min()
    for start, stop in ((-5.0, -1.0), (500.0, 600.0), (3.0, 1.0)):  # beside the record
        assert len(made.window(start, stop).t) == 2
    with pytest.raises(iv.errors.DataError):
        charts.kept(tmp_path, "../charts/force")


def test_the_script_names_files_as_text():
    name = "'; import os; os.abort() #.csv"
    made = script(name, holdout='b".csv', methods=["didim"], tolerance=1.0)
    compile(made, "script", "exec")
    assert repr(name) in made and "iv.DIDIM()" in made and "tolerance=1.0" in made


@pytest.mark.slow
def test_workers_that_are_killed_lose_nothing_but_their_work(client, server, twin):
    """Kill the worker at random times; the window is told, and the same again works."""
    place, content, rng = opened(client, server), german(twin), np.random.default_rng(14)
    (session,) = [s for s in server.sessions._all.values() if s.address == place]
    client.post(f"{place}upload/log?name=a.csv", content=content)
    assert rest(client, place)["look"]["status"] == "done"
    page, kills = client.get(f"{place}get/log.html").text, 0
    for k in range(ROUNDS):
        client.post(f"{place}upload/log?name=a.csv", content=content)
        time.sleep(rng.uniform(0.0, 1.5))
        for job in list(server.hands._busy):
            if job.process is not None:
                os.kill(job.process.pid, signal.SIGKILL)
                kills += 1
        look = rest(client, place)["look"]
        died = "the worker died" in look["text"]
        assert look["status"] == ("failed" if died else "done")
        assert len(list(session.folder.glob("look-*"))) == (not died)
        assert len(list(session.folder.glob("upload-*"))) == 1
        if died and k % 3 == 0:
            client.post(f"{place}upload/log?name=a.csv", content=content)
            assert rest(client, place)["look"]["status"] == "done"
            assert client.get(f"{place}get/log.html").text == page
    assert kills > ROUNDS // 4
    print(f"{kills} kills")


def test_what_a_killed_server_left_goes_and_what_a_live_one_has_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in ("killed", "live", "other"):
        (tmp_path / f"ivtools-app-{name}" / "session").mkdir(parents=True)
    (tmp_path / "ivtools-app-killed" / LOCK).write_text("process 1")
    with claimed(tmp_path / "ivtools-app-live"):
        sweep()
        assert sorted(f.name[12:] for f in tmp_path.iterdir()) == ["live", "other"]


def test_a_log_that_is_not_there_is_told_before_there_is_a_window(capsys):
    assert run(["app", "--no-window", "nowhere.csv"]) == 2
    assert run(["app", "--no-window", "twin", "--axis", "nowhere.toml"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_without_the_extra_the_command_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "starlette.applications", None)
    monkeypatch.delitem(sys.modules, "ivtools.app.server")
    assert run(["app"]) == 2
    assert 'pip install "ivtools[app]"' in capsys.readouterr().err


def test_a_port_that_is_taken_is_told(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert run(["app", "--no-window", "--port", str(taken.getsockname()[1])]) == 2
    assert "cannot be used" in capsys.readouterr().err


def test_the_address_answers_from_the_moment_that_it_is_told():
    """A browser that comes before the server is ready waits, and is not refused."""
    from ivtools.app.server import serve

    class ToldError(Exception):
        pass

    def began(address: str) -> None:
        port = int(address.split(":")[2].split("/")[0])
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
        raise ToldError

    with pytest.raises(ToldError):
        serve(began=began)
