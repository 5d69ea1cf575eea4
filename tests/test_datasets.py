"""Finding, downloading and checking data sets, against a web server of our own."""

import contextlib
import hashlib
import http.server
import io
import socket
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from ivtools import axes, datasets, download
from ivtools.errors import DataError


def zipped(**members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("__", "/") + ".mat", content)
    return file.getvalue()


@pytest.fixture(scope="module")
def content() -> bytes:
    """A small file with the variables of the EMPS."""
    t = np.arange(300) * 1e-3
    file = io.BytesIO()
    savemat(file, {"t": t, "qm": np.sin(t), "qg": np.sin(t), "vir": np.cos(t)})
    return file.getvalue()


@pytest.fixture
def cache(tmp_path, monkeypatch, content) -> Path:
    """An empty cache, nothing in the environment, and a registered data set of our own."""
    monkeypatch.setattr(datasets, "_cache", lambda: tmp_path / "cache")
    monkeypatch.delenv(datasets.FOLDER_VARIABLE, raising=False)
    monkeypatch.delenv(datasets.MIRROR_VARIABLE, raising=False)
    known = datasets.REGISTRY["emps"].__dict__ | {
        "name": "small",
        "filename": "SMALL.mat",
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    monkeypatch.setitem(datasets.REGISTRY, "small", datasets.DataSet(**known))
    return tmp_path / "cache"


@pytest.fixture
def serve(monkeypatch):
    """A function that serves one answer to every request and names itself the mirror."""
    servers = []

    def start(body: bytes, status: int = 200, length: int | None = None) -> list[str]:
        asked: list[str] = []

        class Answer(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                asked.append(self.path)
                self.send_response(status)
                self.send_header("Content-Length", str(len(body) if length is None else length))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *args):
                """Keep the test output clean."""

        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer)
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        servers.append(server)
        address = f"http://127.0.0.1:{server.server_port}/EMPS.zip"
        monkeypatch.setenv(datasets.MIRROR_VARIABLE, address)
        monkeypatch.setenv("NO_PROXY", "127.0.0.1")
        return asked

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def left_in(cache: Path) -> list[str]:
    return [file.name for file in cache.rglob("*")] if cache.exists() else []


def test_a_download_is_checked_kept_and_used_again(cache, serve, content):
    asked = serve(zipped(README=b"", data__SMALL=content))
    record = datasets.load("small")
    assert (record.name, record.n_samples) == ("small", 300)
    assert left_in(cache) == ["SMALL.mat"]
    assert datasets.path("small") == datasets.fetch("small") == cache / "SMALL.mat"
    assert len(asked) == 1


def test_the_address_may_be_given(cache, serve, content, monkeypatch):
    serve(zipped(SMALL=content))
    address = datasets.os.environ[datasets.MIRROR_VARIABLE]
    monkeypatch.delenv(datasets.MIRROR_VARIABLE)
    assert datasets.fetch("small", url=address) == cache / "SMALL.mat"


GOOD = zipped(SMALL=bytes(range(256)) * 99)
BROKEN = {
    "wrong file": ({"body": GOOD}, "SMALL.mat from http://.* is not the file .* expected"),
    "truncated on the way": ({"body": GOOD[:300], "length": len(GOOD)}, "cannot be downloaded"),
    "truncated at the source": ({"body": GOOD[:300]}, "not a zip file"),
    "damaged": ({"body": GOOD[:60] + b"\x00" * 40 + GOOD[100:]}, "cannot be downloaded"),
    "another archive": ({"body": zipped(OTHER=b"")}, "the archive holds no SMALL.mat"),
    "a page of apology": ({"body": b"<html>quota exceeded</html>"}, "not a zip file"),
    "nothing": ({"body": b""}, "not a zip file"),
    "not found": ({"body": b"", "status": 404}, "404"),
}


@pytest.mark.parametrize(("answer", "message"), BROKEN.values(), ids=BROKEN)
def test_a_failed_download_leaves_nothing_behind(cache, serve, answer, message):
    serve(**answer)
    with pytest.raises(DataError, match=message) as caught:
        datasets.load("small")
    assert "\n" not in str(caught.value)
    assert left_in(cache) == []


@pytest.mark.parametrize("kind", ["endless", "a byte at a time", "endless header", "silent"])
def test_a_download_that_does_not_end_is_given_up(cache, monkeypatch, kind):
    monkeypatch.setattr(download, "PATIENCE", 1.0)
    monkeypatch.setattr(download, "SILENCE", 1.0)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    listener = socket.create_server(("127.0.0.1", 0))
    done = threading.Event()

    def answer() -> None:
        peer, _ = listener.accept()
        head = b"HTTP/1.1 200 OK\r\n"
        sent = {"endless": 100_000 * b"x", "silent": b""}.get(kind, b"x")
        size = b"Content-Length: 1000000\r\n" if kind == "a byte at a time" else b""
        with peer, contextlib.suppress(OSError):
            peer.sendall(head + (b"" if kind == "endless header" else size + b"\r\n"))
            while not done.wait(0.02):
                peer.sendall(sent)

    threading.Thread(target=answer, daemon=True).start()
    monkeypatch.setenv(datasets.MIRROR_VARIABLE, f"http://127.0.0.1:{listener.getsockname()[1]}/a")
    start = time.monotonic()
    with pytest.raises(DataError, match="cannot be downloaded from"):
        datasets.fetch("small")
    assert time.monotonic() - start < 60.0  # given up, however busy the machine; it sends for ever
    done.set()
    listener.close()
    assert left_in(cache) == []


def test_an_archive_that_unpacks_to_too_much_is_given_up(cache, serve, monkeypatch):
    monkeypatch.setattr(download, "LARGEST", 1_000_000)
    serve(zipped(SMALL=bytes(3_000_000)))
    with pytest.raises(DataError, match="unpacks to more than 1 MB"):
        datasets.fetch("small")
    assert left_in(cache) == []


def test_a_folder_that_is_named_and_lacks_the_file_is_not_passed_over(
    cache, content, tmp_path, monkeypatch
):
    for name in ("empty", "variable"):
        (tmp_path / name).mkdir()
    (tmp_path / "variable" / "SMALL.mat").write_bytes(content)
    monkeypatch.setenv(datasets.FOLDER_VARIABLE, str(tmp_path / "variable"))
    with pytest.raises(DataError, match="--data names .*empty, which holds no SMALL.mat") as caught:
        datasets.load("small", tmp_path / "empty")
    assert str(tmp_path / "variable") in str(caught.value)
    assert datasets.load("small", tmp_path / "variable").n_samples == 300


@pytest.mark.parametrize("address", ["http://127.0.0.1:9/EMPS.zip", "http://[", "no-address"])
def test_without_network_the_error_says_what_to_do(cache, monkeypatch, address):
    monkeypatch.setenv(datasets.MIRROR_VARIABLE, address)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    known = datasets.REGISTRY["small"]
    with pytest.raises(DataError, match="SMALL.mat is not on this machine and cannot be") as caught:
        datasets.load("small")
    for told in (known.sha256, known.origin, str(cache), "--data", datasets.FOLDER_VARIABLE):
        assert told in str(caught.value)
    assert left_in(cache) == []


def test_a_cache_that_cannot_be_written(cache, serve, content):
    serve(zipped(SMALL=content))
    cache.write_text("a file where a folder should be")
    with pytest.raises(DataError, match="cannot be downloaded"):
        datasets.fetch("small")


def test_folders_are_looked_in_in_order(cache, content, tmp_path, monkeypatch):
    folders = {name: tmp_path / name for name in ("given", "variable", "cache")}
    for folder in folders.values():
        folder.mkdir()
        (folder / "SMALL.mat").write_bytes(content)
    monkeypatch.setenv(datasets.FOLDER_VARIABLE, str(folders["variable"]))
    for name in folders:
        assert datasets.find("small", folders["given"]) == folders[name] / "SMALL.mat"
        (folders[name] / "SMALL.mat").unlink()
    assert datasets.find("small", folders["given"]) is None


def test_a_folder_holds_a_set_or_a_folder_per_set(cache, content, tmp_path):
    folder = tmp_path / "records" / datasets.REGISTRY["small"].folder
    folder.mkdir(parents=True)
    (folder / "SMALL.mat").write_bytes(content)
    assert datasets.find("small", folder) == datasets.find("small", folder.parent)
    assert datasets.load("small", folder.parent).n_samples == 300


def test_a_set_of_several_files_is_whole_or_absent(cache, content, tmp_path, serve):
    known = datasets.REGISTRY["small"].__dict__ | {"beside": {"PLAN.mat": sha256(b"plan")}}
    datasets.REGISTRY["small"] = datasets.DataSet(**known)
    (tmp_path / "SMALL.mat").write_bytes(content)
    assert datasets.find("small", tmp_path) is None
    serve(zipped(SMALL=content, renamed=b"plan"))
    assert [file.read_bytes() for file in datasets.paths("small", tmp_path)] == [content, b"plan"]


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def test_a_file_that_is_not_the_registered_one(cache, tmp_path):
    (tmp_path / "SMALL.mat").write_bytes(b"something else")
    known, found = datasets.REGISTRY["small"].sha256, hashlib.sha256(b"something else").hexdigest()
    with pytest.raises(DataError, match=f"SHA-256 {found}, expected {known}; delete it") as caught:
        datasets.load("small", tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_half_written_file_in_the_cache_is_not_used(cache, content):
    cache.mkdir()
    (cache / "SMALL.mat").write_bytes(content[:100])
    for use in (datasets.path, datasets.fetch):
        with pytest.raises(DataError, match="is not the file that is registered"):
            use("small")


@pytest.mark.parametrize("source", ["--data", datasets.FOLDER_VARIABLE])
def test_a_folder_that_is_named_must_exist(cache, tmp_path, monkeypatch, source):
    nowhere = str(tmp_path / "nowhere")
    monkeypatch.setenv(datasets.FOLDER_VARIABLE, nowhere if source != "--data" else "")
    with pytest.raises(DataError, match=f"{source} names .*nowhere, which is no folder"):
        datasets.find("small", nowhere if source == "--data" else None)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: datasets.load("epms"), "epms is neither a file nor a data set; data sets: emps"),
        (lambda: datasets.path("epms"), "'epms' is no registered data set"),
        (lambda: datasets.fetch("twin"), "twin is simulated and has no file"),
        (lambda: datasets.load("run.csv"), "there is no such file"),
    ],
)
def test_names_that_are_none(ask, message):
    with pytest.raises(DataError, match=message):
        ask()


def test_load_reads_files_too(table, tmp_path):
    file = tmp_path / "run.csv"
    np.savetxt(file, np.c_[table()["t"], table()["q"], table()["nu"]], header="t x nu")
    assert datasets.load(file, columns={"q": "x"}).n_samples == 300
    assert datasets.load(str(file), columns={"q": "x"}).name == "run"


def test_every_registered_data_set_is_described():
    assert {"emps", "emps-pulses", "twin", "laas-motor-1"} <= set(datasets.REGISTRY)
    for name, known in datasets.REGISTRY.items():
        assert known.name == name
        assert all((known.title, known.origin, known.licence, known.citation))
        assert known.axis in axes.FILES or known.name.startswith("dfki-double-pendulum")
        assert all(len(sha256) == 64 for sha256 in known.files.values())
        assert bool(known.filename) == bool(known.archive) == (len(known.sha256) == 64)


def test_the_twin_is_the_same_every_time(twin):
    again = datasets.load("twin")
    assert np.array_equal(twin.q, again.q)
    assert np.array_equal(twin.nu, again.nu)


def test_the_twin_looks_like_the_emps(twin):
    assert (twin.n_samples, twin.dt, twin.t[-1]) == (24841, 0.001, 24.84)
    assert 0.23 < np.ptp(twin.q) < 0.25
    assert np.abs(np.diff(twin.q_ref, axis=0)).max() / twin.dt == pytest.approx(0.15, rel=1e-6)
    assert np.abs(twin.q / 5e-8 - np.round(twin.q / 5e-8)).max() < 1e-6
    assert np.abs(twin.nu).max() < 10.0
    assert set(twin.theta_true) == {
        "inertia", "viscous_pos", "coulomb_pos", "viscous_neg", "coulomb_neg"
    }  # fmt: skip


def test_the_reference_is_smooth_and_keeps_to_its_limits():
    t = np.arange(24841) / 1000.0
    q_ref = datasets._moves(t)
    speed = np.diff(q_ref) / 1e-3
    assert np.abs(np.diff(speed) / 1e-3).max() < 1.2 + 1e-6
    assert (q_ref.min(), q_ref.max()) == pytest.approx((0.0, 0.24), abs=1e-9)
