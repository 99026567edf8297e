"""Measurements named by a url: who fetches them, from where, and how much."""

from __future__ import annotations

import hashlib
import re
import shutil
import ssl
import subprocess
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event, Thread

import pytest

from calflow.files.problems import InputError
from calflow.measurements.source import MeasurementSource, fetch, is_to_fetch, locate


class Server(ThreadingHTTPServer):
    """A server on this machine, by TLS, that keeps what it was asked for."""

    daemon_threads = True
    content = b""

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), Answers)
        self.asked: list[str] = []
        self.ended = Event()
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
        self.socket = context.wrap_socket(self.socket, server_side=True)

    @property
    def root(self) -> str:
        """Its address."""
        return f"https://127.0.0.1:{self.server_port}"


class Answers(BaseHTTPRequestHandler):
    """What the server answers by the path asked for: a file, one place after another, without end, or byte by byte."""

    server: Server

    def do_GET(self) -> None:
        self.server.asked.append(self.path)
        if self.path.startswith("/to/"):
            self.send_response(302)
            self.send_header("Location", self.path.removeprefix("/to/"))
            self.end_headers()
        elif self.path.startswith("/round"):
            self.send_response(302)
            self.send_header("Location", f"/round?{len(self.server.asked)}")
            self.end_headers()
        elif self.path == "/slow":
            while not self.server.ended.wait(0.05):
                self.wfile.write(b"H")
        else:
            self.send_response(200)
            self.end_headers()
            while self.path == "/endless" and not self.server.ended.is_set():
                self.wfile.write(bytes(100_000))
            self.wfile.write(self.server.content)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def signed(tmp_path_factory) -> Path:
    """A folder with a key, and a certificate of this machine that it signed itself."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate with")
    folder = tmp_path_factory.mktemp("signed")
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "key.pem", "-out", "cert.pem",
                    "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1"],
                   cwd=folder, check=True, capture_output=True)  # fmt: skip
    return folder


@pytest.fixture
def server(signed, tmp_path, monkeypatch) -> Iterator[Server]:
    """The server, whose certificate counts here; what is fetched is kept in a folder of the test's."""
    monkeypatch.setenv("SSL_CERT_FILE", str(signed / "cert.pem"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    server = Server(signed)
    Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.ended.set()
    server.shutdown()
    server.server_close()


def source(server: Server, path: str, content: bytes = b"") -> MeasurementSource:
    """A file that a study names at a path of the server."""
    server.content = content
    return MeasurementSource(file="far.csv", url=f"{server.root}{path}", sha256=hashlib.sha256(content).hexdigest())


def kept(tmp_path: Path) -> list[Path]:
    """All files that were kept."""
    return [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


@pytest.fixture
def far(small, server):
    """A study whose measurements are at the server alone."""
    here = (small / "measurements.csv").read_bytes()
    small.edit("study.toml", ('file = "measurements.csv"', '''file = "far.csv"
url = "{}"
sha256 = "{}"'''.format(f"{server.root}/rows.csv", hashlib.sha256(here).hexdigest())))  # fmt: skip
    (small / "measurements.csv").unlink()
    server.content = here
    return small


def test_only_a_run_fetches_and_it_says_so(far, server):
    """Fails if a look at a study has this machine call another, or a run does without a word, or each time anew."""
    answer = far.calflow("check")
    assert answer.code == 0
    assert answer.out.splitlines()[1:] == [
        f"far.csv is not fetched yet: 'calflow run' fetches it from {server.root}/rows.csv"
    ]
    assert "is not fetched yet" in far.refused("plan")[0]
    assert not server.asked
    answer = far.calflow("run", "--stage", "identify")
    assert answer.code == 0, answer
    assert f"fetching far.csv from {server.root}/rows.csv; expecting SHA-256 " in answer.out
    assert server.asked == ["/rows.csv"]
    assert "reused" in far.calflow("run", "--stage", "identify").out
    assert far.calflow("check").out.strip().endswith("ok")
    assert server.asked == ["/rows.csv"]


def test_a_stage_that_reads_no_measurements_fetches_none(far, server):
    """Fails if poses cannot be selected before the measurements are fetched, or these are fetched for that."""
    answer = far.calflow("run", "--stage", "select")
    assert answer.code == 0, answer
    assert not server.asked


def test_a_file_at_hand_is_not_fetched(small, server):
    """Fails if a file that lies where the study says is asked for elsewhere."""
    at_hand = source(server, "/rows.csv").model_copy(update={"file": "measurements.csv", "sha256": None})
    assert not is_to_fetch(at_hand, small.path)
    assert locate(at_hand, small.path) == small / "measurements.csv"


def test_a_file_is_fetched_by_way_of_another_place(server, tmp_path):
    """Fails if a server that leads on to another place of its own is not followed."""
    asked = source(server, f"/to/{server.root}/rows.csv", b"a,b\n")
    fetch(asked)
    assert locate(asked, tmp_path).read_bytes() == b"a,b\n"
    assert not is_to_fetch(asked, tmp_path)


@pytest.mark.parametrize(
    ("path", "told"),
    [
        (
            "/to/http://127.0.0.1:9/rows.csv",
            "could not be fetched .*leads on to http://127.0.0.1:9/rows.csv, which is not https",
        ),
        ("/to/file:///etc/hostname", "could not be fetched .*not allowed"),
        ("/round", "could not be fetched"),
        ("/endless", "could not be fetched .it is larger than 1 MB"),
        ("/slow", "could not be fetched .it takes longer than"),
    ],
)
def test_a_server_that_leads_astray_is_given_up(server, tmp_path, monkeypatch, path, told):
    """Fails if a server can have another protocol used, be followed for ever, fill the disk, or keep a run waiting."""
    monkeypatch.setattr("calflow.measurements.source.LARGEST", 1_000_000)
    monkeypatch.setattr("calflow.measurements.source.LONGEST", 0.5 if path == "/slow" else 30.0)
    with pytest.raises(InputError, match=told):
        fetch(source(server, path))
    assert len(server.asked) < 10
    assert not kept(tmp_path)


def test_another_file_is_not_kept(server, tmp_path):
    """Fails if what a server gives in the place of the file that the study means is used, or lies about."""
    asked = source(server, "/rows.csv", b"a,b\n")
    server.content = b"c,d\n"
    with pytest.raises(InputError, match="wrong SHA-256"):
        fetch(asked)
    assert not kept(tmp_path)


def test_a_server_that_is_not_there_is_explained(tmp_path, monkeypatch):
    """Fails if a network that is down ends in a traceback, or the user does not learn what to do."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(InputError, match=r"could not be fetched .* CALFLOW_DATA"):
        fetch(MeasurementSource(file="far.csv", url="https://127.0.0.1:9/x", sha256="0" * 64))
    assert not kept(tmp_path)


@pytest.mark.parametrize(
    "url", ["http://a.b/c.csv", "file:///etc/passwd", "ftp://a.b/c", "nonsense", "https://a b", "https://"]
)
def test_a_url_is_one_by_https(small, url):
    """Fails if a study can have another protocol used."""
    small.edit("study.toml", ('file = "measurements.csv"', f'file = "far.csv"\nurl = "{url}"\nsha256 = "{"0" * 64}"'))
    (told,) = small.refused()
    assert re.search("study.toml:9: measurements.url: expected a url that begins with https://", told)
