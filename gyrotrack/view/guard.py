"""Who may talk to the workbench: only the page that carries its token, and only under its own name.

The address is that of this machine alone. A page of another site that asks this server under a name of its own
(DNS rebinding) has the wrong Host; a form or script of another site has the wrong Origin; and neither knows
the token, which is new at each start.
"""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, Mapping
from typing import Any
from urllib.parse import parse_qs

Scope = Mapping[str, Any]
Send = Callable[[Any], Awaitable[None]]
Receive = Callable[[], Awaitable[Any]]
App = Callable[[Any, Receive, Send], Awaitable[None]]

TOKEN_HEADER = b"x-gyrotrack-token"
_HEADERS = (
    (b"cache-control", b"no-store"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
)


class Guard:
    """An ASGI application in front of another that refuses what is not from the workbench's own page.

    Parameters
    ----------
    app : callable
        The application behind.
    port : int
        Where the server listens.
    token : str
        What every request must carry: in a header, or for the page itself in the address.
    """

    def __init__(self, app: App, port: int, token: str) -> None:
        self._app = app
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost")}
        self._token = token.encode()

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        """Let a request through, or answer that it is refused."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status = self._judged(scope)
        if status != _WELCOME:
            await _refuse(scope, status, send)
            return

        async def sealed(message: Any) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *_HEADERS]}
            await send(message)

        await self._app(scope, receive, sealed)

    def _judged(self, scope: Scope) -> int:
        if scope["type"] != "http":
            return _FORBIDDEN
        headers = scope["headers"]
        hosts = [v for k, v in headers if k == b"host"]
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return _MISDIRECTED
        origins = [v for k, v in headers if k == b"origin"]
        if any(
            o.removeprefix(b"http://") not in self._hosts or not o.startswith(b"http://") for o in origins
        ):
            return _FORBIDDEN
        given = [v for k, v in headers if k == TOKEN_HEADER]
        if scope["path"] == "/" and scope["method"] in {"GET", "HEAD"}:
            asked = parse_qs(scope["query_string"], max_num_fields=8) if scope["query_string"] else {}
            given += asked.get(b"token", [])
        fits = any(hmac.compare_digest(g, self._token) for g in given)
        return _WELCOME if fits else _FORBIDDEN


_WELCOME, _FORBIDDEN, _MISDIRECTED = 200, 403, 400


async def _refuse(scope: Scope, status: int, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    text = b"Open the address that `gyrotrack view` printed.\n"
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(text)).encode()),
        *_HEADERS,
    ]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": text if scope["method"] != "HEAD" else b""})
