"""The address that is announced answers."""

import socket
import sys
from threading import Event
from types import SimpleNamespace
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest

from gyrotrack.apps.workbench._server import serve


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
        seen.append(urlopen(seen[0], timeout=10).read())  # noqa: S310 - our own address

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
