"""The server of the workbench, on this machine only.

The address is that of this machine alone. A page of another site that asks this server under a name of its own
(DNS rebinding) has the wrong Host; a form or script of another site has the wrong Origin; and neither knows
the token, which is new at each start.
"""

from __future__ import annotations

import hmac
import json
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from importlib import resources
from types import FrameType
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from gyrotrack._errors import GyrotrackError, UsageError
from gyrotrack.apps.workbench._films import Clips, profile_text
from gyrotrack.apps.workbench._ranking import Ranker
from gyrotrack.apps.workbench._session import Session, library_document
from gyrotrack.plotting import _charts as charts

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response


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
        status = self._status(scope)
        if status != _ACCEPTED:
            await _refuse(scope, status, send)
            return

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *_HEADERS]}
            await send(message)

        await self._app(scope, receive, with_headers)

    def _status(self, scope: Scope) -> int:
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
        return _ACCEPTED if fits else _FORBIDDEN


_ACCEPTED, _FORBIDDEN, _MISDIRECTED = 200, 403, 400


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


_LONGEST_BODY = 64 * 1024


async def body_of(request: Request) -> dict[str, Any]:
    """Return what a request asks for; what is too long or no JSON object asks for nothing."""
    raw = bytearray()
    async for piece in request.stream():
        raw += piece
        if len(raw) > _LONGEST_BODY:
            return {}
    try:
        found = json.loads(bytes(raw) or b"{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


async def answered(work: Callable[[], Any]) -> Response:
    """Return the result of a function as JSON, or its error as one sentence."""
    from starlette.concurrency import run_in_threadpool
    from starlette.responses import JSONResponse

    try:
        return JSONResponse(await run_in_threadpool(work))
    except Exception as error:
        return refusal(error)


def refusal(error: Exception) -> Response:
    """Return an error as one sentence in JSON: 400 if it was foreseen, 500 if it is a bug."""
    from starlette.responses import JSONResponse

    message, hint = getattr(error, "message", ""), getattr(error, "hint", "")
    if not isinstance(message, str) or not message:
        what = f"{type(error).__name__}: {error}".splitlines()[0].rstrip(".")
        return JSONResponse(
            {"error": {"code": "bug", "message": f"A bug in gyrotrack: {what}.", "hint": ""}}, 500
        )
    code = str(getattr(error, "code", "error"))
    return JSONResponse({"error": {"code": code, "message": message, "hint": str(hint)}}, 400)


def text(asked: dict[str, Any], name: str) -> str:
    """Return a text that is asked for; nothing, if it is none."""
    value = asked.get(name, "")
    return value if isinstance(value, str) else ""


def whole(asked: dict[str, Any], name: str) -> int:
    """Return a whole number that is asked for; -1, if there is none."""
    try:
        return int(asked.get(name, -1))
    except (TypeError, ValueError, OverflowError):
        raise GyrotrackError(f"{name} is not a whole number.") from None


def number(asked: dict[str, Any], name: str) -> float:
    """Return a place on a frame that is asked for, as a share of its width or height."""
    try:
        value = float(asked.get(name, "nan"))
    except (TypeError, ValueError, OverflowError):
        value = float("nan")
    if not 0.0 <= value <= 1.0:
        raise GyrotrackError(f"{name} is not a place on the frame.")
    return value


_ADDRESS = "127.0.0.1"


class Workbench:
    """What the page may ask for.

    Parameters
    ----------
    session : Session
        The fits.
    clips : Clips
        The frames.
    ranker : Ranker
        Looks for what is missing.
    """

    def __init__(self, session: Session, clips: Clips, ranker: Ranker) -> None:
        self.session, self.clips, self.ranker = session, clips, ranker
        self.stop: Callable[[], None] = lambda: None

    def app(self, port: int, token: str) -> Guard:
        """Return the application behind its guard."""
        from starlette.applications import Starlette
        from starlette.routing import Route

        routes = [
            Route("/", self._page),
            Route("/api/state", self._state),
            Route("/api/change", self._change, methods=["POST"]),
            Route("/api/go", self._go, methods=["POST"]),
            Route("/api/compare", self._compare, methods=["POST"]),
            Route("/api/undo", self._undo, methods=["POST"]),
            Route("/api/delete", self._delete, methods=["POST"]),
            Route("/api/note", self._note, methods=["POST"]),
            Route("/api/keep", self._keep, methods=["POST"]),
            Route("/api/rank", self._rank, methods=["POST"]),
            Route("/api/frame", self._frame),
            Route("/api/colour", self._colour, methods=["POST"]),
            Route("/api/profile", self._profile, methods=["POST"]),
            Route("/api/quit", self._quit, methods=["POST"]),
        ]
        return Guard(Starlette(routes=routes, lifespan=self._life), port, token)

    @asynccontextmanager
    async def _life(self, _app: Any) -> AsyncIterator[None]:
        try:
            yield
        finally:
            self.close()

    def close(self) -> None:
        """End the ranking process and close the films."""
        self.ranker.close()
        self.clips.close()

    async def _page(self, _request: Request) -> Response:
        from starlette.responses import HTMLResponse

        page, policy = page_text(self.session.state()["label"])
        return HTMLResponse(page, headers={"content-security-policy": policy})

    async def _state(self, _request: Request) -> Response:
        def work() -> Any:
            return self.session.state(whole=True) | {
                "clips": self.clips.document(),
                "library": library_document(),
            }

        return await answered(work)

    async def _change(self, request: Request) -> Response:
        asked = await body_of(request)
        return await answered(lambda: self.session.change(add=text(asked, "add"), drop=text(asked, "drop")))

    async def _go(self, request: Request) -> Response:
        asked = await body_of(request)
        return await answered(lambda: self.session.go(whole(asked, "place")))

    async def _compare(self, request: Request) -> Response:
        asked = await body_of(request)
        return await answered(lambda: self.session.compare(whole(asked, "place")))

    async def _undo(self, _request: Request) -> Response:
        return await answered(self.session.undo)

    async def _delete(self, request: Request) -> Response:
        asked = await body_of(request)
        return await answered(lambda: self.session.delete(whole(asked, "place")))

    async def _note(self, request: Request) -> Response:
        asked = await body_of(request)
        return await answered(lambda: self.session.annotate(whole(asked, "place"), text(asked, "note")))

    async def _keep(self, _request: Request) -> Response:
        return await answered(self.session.keep)

    async def _rank(self, _request: Request) -> Response:
        return await answered(lambda: self.session.remember(self.ranker.rank(self.session.model_document())))

    async def _frame(self, request: Request) -> Response:
        from starlette.concurrency import run_in_threadpool
        from starlette.responses import Response

        asked = dict(request.query_params)
        try:
            index = whole(asked, "index")
            image = await run_in_threadpool(
                self.clips.frame, asked.get("clip", ""), index, overlay=asked.get("overlay") != "0"
            )
        except Exception as error:
            return refusal(error)
        return Response(image, media_type="image/jpeg")

    async def _colour(self, request: Request) -> Response:
        asked = await body_of(request)
        return await answered(
            lambda: self.clips.colour(
                text(asked, "clip"), whole(asked, "index"), number(asked, "x"), number(asked, "y")
            )
        )

    async def _profile(self, request: Request) -> Response:
        asked = await body_of(request)
        return await answered(lambda: {"toml": profile_text(asked)})

    async def _quit(self, _request: Request) -> Response:
        self.stop()
        return await answered(lambda: {"stopped": True})


def page_text(label: str) -> tuple[str, str]:
    """Return the page and the content security policy under which it is sent."""
    from jinja2 import Environment, StrictUndefined

    folder = resources.files("gyrotrack.apps.workbench")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    template = environment.from_string(folder.joinpath("page.html.jinja").read_text("utf-8"))
    scripts = (*charts.scripts(), folder.joinpath("view.js").read_text("utf-8"))
    style = charts.theme() + folder.joinpath("view.css").read_text("utf-8") + charts.style()
    page = template.render(title=label, style=style, scripts=scripts)
    return page, charts.content_policy(scripts, connect=True)


def serve(bench: Workbench, port: int, announce: Callable[[str], None]) -> None:
    """Serve the workbench until it is interrupted, or the page asks it to end.

    Parameters
    ----------
    bench : Workbench
        What is served; closed at the end.
    port : int
        Where to listen on this machine's own address; 0 takes a free one.
    announce : callable
        Called with the page's address once the port is taken.

    Raises
    ------
    UsageError
        If the port is not free.
    """
    import uvicorn

    # asyncio sends at once, not after the receipt of what it sent before, only where the protocol is named
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((_ADDRESS, port))
        except (OSError, OverflowError):
            raise UsageError(
                f"The port {port} is not free.", "Leave --port out to take any free one."
            ) from None
        port = listener.getsockname()[1]
        token = secrets.token_urlsafe(24)
        config = uvicorn.Config(
            bench.app(port, token),
            log_level="critical",
            access_log=False,
            ws="none",
            server_header=False,
            timeout_graceful_shutdown=2,
        )

        class Server(uvicorn.Server):
            def handle_exit(self, sig: int, frame: FrameType | None) -> None:
                bench.ranker.close()  # else the answer that it owes would be waited for
                super().handle_exit(sig, frame)

        server = Server(config)

        def stop() -> None:
            bench.ranker.close()
            server.should_exit = True

        bench.stop = stop
        listener.listen()  # who comes before the server runs is kept waiting, not turned away
        announce(f"http://{_ADDRESS}:{port}/?token={token}")
        server.run(sockets=[listener])
    finally:
        bench.close()
        listener.close()
