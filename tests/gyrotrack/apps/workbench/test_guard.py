"""Every route against every wrong combination of headers: only the page's own requests get through."""

import asyncio
import itertools
from concurrent.futures import ThreadPoolExecutor

import pytest

from gyrotrack.apps.workbench._server import Guard

TOKEN, PORT = "secret-token", 4711
# the driver of the browser tests may keep a loop running in this thread
_ELSEWHERE = ThreadPoolExecutor(max_workers=1)
ROUTES = (
    "/",
    "/api/state",
    "/api/change",
    "/api/undo",
    "/api/delete",
    "/api/note",
    "/api/compare",
    "/api/rank",
    "/api/frame",
    "/api/colour",
    "/api/profile",
    "/api/quit",
    "/api/project",
    "/api/project/upload",
    "/api/project/frame",
    "/api/project/track",
)
HOSTS = {
    "127.0.0.1:4711": True,
    "localhost:4711": True,
    "LOCALHOST:4711": True,
    "evil.example:4711": False,
    "127.0.0.1": False,
    "127.0.0.1:4712": False,
    "localhost:4711.evil.example": False,
    None: False,
}
ORIGINS = {
    None: True,
    "http://127.0.0.1:4711": True,
    "http://localhost:4711": True,
    "https://127.0.0.1:4711": False,
    "http://evil.example": False,
    "null": False,
}
TOKENS = {TOKEN: True, "": False, "wrong": False, None: False, TOKEN + "x": False}


@pytest.fixture(scope="module", autouse=True)
def loop():
    """One event loop for all requests of this file."""
    with asyncio.Runner() as runner:
        _ask.run = lambda request: _ELSEWHERE.submit(runner.run, request).result()
        yield
        _ELSEWHERE.submit(runner.close).result()


async def _behind(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"let in"})


def _ask(path, headers, *, method="GET", query=b"", kind="http"):
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.request", "body": b""}

    scope = {
        "type": kind,
        "method": method,
        "path": path,
        "query_string": query,
        "headers": [(k.encode(), v.encode()) for k, v in headers if v is not None],
    }
    _ask.run(Guard(_behind, PORT, TOKEN)(scope, receive, send))
    return sent


@pytest.mark.parametrize("path", ROUTES)
def test_only_the_right_combination_gets_through(path):
    tried = 0
    for (host, a), (origin, b), (token, c) in itertools.product(
        HOSTS.items(), ORIGINS.items(), TOKENS.items()
    ):
        headers = [("host", host), ("origin", origin), ("x-gyrotrack-token", token)]
        for method in ("GET", "POST"):
            sent = _ask(path, headers, method=method)
            assert (sent[0]["status"] == 200) is (a and b and c), (headers, method)
            assert (sent[-1]["body"] == b"let in") is (a and b and c)
            tried += 1
    assert tried == 480


def test_the_address_lets_the_page_in_once_and_nothing_else():
    host = [("host", f"localhost:{PORT}")]
    sent = _ask("/", host, query=f"token={TOKEN}".encode())
    headers = dict(sent[0]["headers"])
    assert (sent[0]["status"], headers[b"location"]) == (303, b"/")
    cookie, *settings = headers[b"set-cookie"].decode().split("; ")
    assert settings == ["HttpOnly", "SameSite=Strict", "Path=/"]
    assert b"let in" not in sent[-1]["body"]
    for path, method in (("/", "GET"), ("/report", "GET"), ("/api/state", "GET"), ("/api/change", "POST")):
        for others in ("", "a=b; "):
            assert _ask(path, [*host, ("cookie", others + cookie)], method=method)[0]["status"] == 200
        for wrong in (cookie + "x", cookie[1:], cookie.replace(str(PORT), "4712"), f"token={TOKEN}", ""):
            assert _ask(path, [*host, ("cookie", wrong)], method=method)[0]["status"] == 403
    assert _ask("/report", host, query=f"token={TOKEN}".encode())[0]["status"] == 403
    assert _ask("/", host, query=b"token=wrong")[0]["status"] == 403
    assert _ask("/", host, query=b"")[0]["status"] == 403
    assert _ask("/", host, query=f"token={TOKEN}".encode(), method="POST")[0]["status"] == 403
    assert _ask("/api/state", host, query=f"token={TOKEN}".encode())[0]["status"] == 403


@pytest.mark.parametrize(
    ("site", "status"),
    [("same-origin", 200), ("none", 200), ("same-site", 403), ("cross-site", 403), ("x", 403)],
)
def test_a_page_on_another_port_is_refused_though_it_has_the_cookie(site, status):
    for path in ("/", "/api/state", "/report"):
        headers = [
            ("host", f"localhost:{PORT}"),
            ("cookie", f"gyrotrack-{PORT}={TOKEN}"),
            ("sec-fetch-site", site),
        ]
        assert _ask(path, headers)[0]["status"] == status


def test_two_hosts_and_sockets_are_refused():
    twice = [("host", f"localhost:{PORT}"), ("host", "evil.example"), ("x-gyrotrack-token", TOKEN)]
    assert _ask("/api/state", twice)[0]["status"] == 400
    right = [("host", f"localhost:{PORT}"), ("x-gyrotrack-token", TOKEN)]
    assert _ask("/api/state", right, kind="websocket") == [{"type": "websocket.close", "code": 1008}]


def test_answers_may_not_be_framed_kept_or_sniffed():
    sent = _ask("/", [("host", f"localhost:{PORT}"), ("x-gyrotrack-token", TOKEN)])
    headers = dict(sent[0]["headers"])
    assert headers[b"x-frame-options"] == b"DENY"
    assert headers[b"cache-control"] == b"no-store"
    assert headers[b"x-content-type-options"] == b"nosniff"
