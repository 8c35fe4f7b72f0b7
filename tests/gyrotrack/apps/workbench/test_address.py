"""One server per folder: the address of a server that answers is used, and no other."""

import json
import socket
import stat
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import pytest

from gyrotrack.apps.workbench._address import Address


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        known = self.path == "/api/pulse" and self.headers["x-gyrotrack-token"] == "secret"
        self.send_response(200 if known else 403)
        self.end_headers()

    def log_message(self, *_):
        pass


@pytest.fixture
def port():
    server = HTTPServer(("127.0.0.1", 0), _Handler)
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    yield server.server_address[1]
    server.shutdown()
    thread.join()
    server.server_close()


def test_the_address_of_a_server_that_answers_is_found_by_its_user_only(tmp_path, port):
    own, url = Address(tmp_path / "workbench"), f"http://127.0.0.1:{port}/?token=secret"
    assert own.running() == ""
    own.publish(url)
    assert Address(tmp_path / "workbench").running() == url
    (file,) = tmp_path.iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    own.clear()
    assert own.running() == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change",
    [
        {"host": "elsewhere"},
        {"url": "http://127.0.0.1:{port}/?token=other"},
        {"url": "http://evil.example:{port}/?token=secret"},
        {"url": "file:///etc/passwd"},
        {"url": 5},
    ],
)
def test_any_other_address_is_not_used(tmp_path, port, change):
    found = {"url": f"http://127.0.0.1:{port}/?token=secret", "host": socket.gethostname(), "pid": 1}
    found |= {k: v.format(port=port) if isinstance(v, str) else v for k, v in change.items()}
    (tmp_path / ".workbench.address").write_text(json.dumps(found))
    assert Address(tmp_path / "workbench").running() == ""


def test_a_server_that_has_ended_and_a_link_are_not_used(tmp_path, port):
    own = Address(tmp_path / "workbench")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        gone = free.getsockname()[1]
    own.publish(f"http://127.0.0.1:{gone}/?token=secret")
    assert own.running() == ""
    own.clear()
    target = tmp_path / "planted"
    target.write_text(
        json.dumps({"url": f"http://127.0.0.1:{port}/?token=secret", "host": socket.gethostname()})
    )
    (tmp_path / ".workbench.address").symlink_to(target)
    assert own.running() == ""
    own.publish("http://127.0.0.1:1/?token=new")  # the link is replaced, and its target is kept
    assert "secret" in target.read_text()
