"""The address that is announced answers."""

import socket
from types import SimpleNamespace
from urllib.parse import urlsplit

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
