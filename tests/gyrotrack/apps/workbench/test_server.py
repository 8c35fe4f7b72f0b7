"""The address that is announced answers."""

import asyncio
import os
import socket
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from types import SimpleNamespace
from urllib.parse import urlsplit
from urllib.request import HTTPCookieProcessor, build_opener

import pytest

from gyrotrack import UsageError
from gyrotrack.apps.workbench._server import Laboratory, Workbench, numbers, serve, text


class _EnoughError(Exception):
    pass


def test_who_comes_as_soon_as_the_address_is_announced_is_not_turned_away():
    seen = []
    bench = SimpleNamespace(
        app=lambda port, token: None, close=lambda: seen.append("closed"), ranker=None, stop=None
    )

    def announce(address):
        where = urlsplit(address)
        socket.create_connection((where.hostname, where.port), timeout=5).close()
        seen.append("connected")
        raise _EnoughError

    with pytest.raises(_EnoughError):
        serve(bench, 0, announce)
    assert seen == ["connected", "closed"]


async def _empty(scope, receive, send):
    if scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"page"})


def test_a_window_shows_the_page_and_closing_it_ends_the_program(monkeypatch):
    closed, seen = Event(), []

    def start(watch):
        seen.append(build_opener(HTTPCookieProcessor()).open(seen[0], timeout=10).read())

    toolkit = SimpleNamespace(
        create_window=lambda title, address, **_: seen.append(address) or SimpleNamespace(destroy=closed.set),
        start=start,
    )
    monkeypatch.setitem(sys.modules, "webview", toolkit)
    bench = SimpleNamespace(
        app=lambda port, token: _empty,
        close=lambda: seen.append("closed"),
        interrupt=lambda: None,
        stop=None,
    )
    announced = []
    serve(bench, 0, announced.append, window=True)
    assert seen == [announced[0], b"page", "closed"]


@pytest.fixture
def laboratory(tmp_path):
    jobs = SimpleNamespace(get=lambda key: None, start=lambda key, words, done: started.append((words, done)))
    started = []
    session, clips = SimpleNamespace(kept=lambda: "f1"), SimpleNamespace(folder=None)
    return Laboratory(session, clips, None, tmp_path / "case.h5", None, jobs), started


REPORT = b'<!DOCTYPE html>\n<head>\n<meta charset="utf-8">\n<meta name="generator" content="gyrotrack">'


def _asked(lab, path):
    async def get():
        sent = []
        scope = {"type": "http", "method": "GET", "path": path, "query_string": b"", "headers": HEADERS}

        async def receive():
            return {"type": "http.request", "body": b""}

        async def send(message):
            sent.append(message)

        await Workbench(lab).app(4711, "secret")(scope | {"raw_path": path.encode()}, receive, send)
        return sent[0]["status"], dict(sent[0]["headers"]), sent[1]["body"]

    return ThreadPoolExecutor(1).submit(lambda: asyncio.run(get())).result()


HEADERS = [(b"host", b"localhost:4711"), (b"x-gyrotrack-token", b"secret")]


def test_only_the_report_that_was_written_here_is_shown(laboratory, tmp_path):
    laboratory, started = laboratory
    report = tmp_path / "case.report.html"
    report.write_bytes(REPORT + b"planted")
    assert _asked(laboratory, "/report")[0] == 400
    laboratory.write_report()
    ((words, done),) = started
    assert words[words.index("-o") + 1] == report.name
    report.write_bytes(REPORT + b"ours")
    done(SimpleNamespace(state="done"))
    report.write_bytes(REPORT + b"planted later")
    status, headers, body = _asked(laboratory, "/report")
    assert (status, body) == (200, REPORT + b"ours")
    policy = headers[b"content-security-policy"].decode().split("; ")
    assert policy[:2] == ["sandbox allow-scripts allow-downloads", "default-src 'none'"]
    done(SimpleNamespace(state="failed"))
    assert _asked(laboratory, "/report")[0] == 400


@pytest.mark.parametrize("kind", ["text", "symbolic link", "hard link", "folder"])
def test_a_file_of_somebody_else_is_not_replaced_by_a_report(laboratory, tmp_path, kind):
    laboratory, started = laboratory
    planted, victim = tmp_path / "case.report.html", tmp_path / "victim"
    victim.write_bytes(REPORT)
    if kind == "text":
        planted.write_text("<!DOCTYPE html>")
    elif kind == "folder":
        planted.mkdir()
    else:
        (os.link if kind == "hard link" else os.symlink)(victim, planted)
    laboratory.write_report()
    words, _ = started[0]
    assert words[words.index("-o") + 1] == "case.report_2.html"


@pytest.mark.parametrize(("value", "found"), [("a b\nc", "a b\nc"), ("", ""), (5, ""), (None, "")])
def test_texts_of_a_request_can_be_stored(value, found):
    assert text({"name": value}, "name") == found
    for wrong in ("\ud800", "caf\udce9", "a\0b"):
        with pytest.raises(UsageError, match="not valid"):
            text({"name": wrong}, "name")


@pytest.mark.parametrize("value", [10**400, float("inf"), float("nan"), "1", None, [], {}])
def test_values_of_a_request_are_numbers(value):
    with pytest.raises(UsageError, match="not a number"):
        numbers({"values": {"a": 1.0, "b": value}}, "values")
    assert numbers({"values": {"a": 1, "b": -2.5}}, "values") == {"a": 1.0, "b": -2.5}
