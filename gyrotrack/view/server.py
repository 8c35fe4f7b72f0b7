"""The server of the workbench: a page, a few questions that it may ask, all on this machine's own address."""

from __future__ import annotations

import secrets
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from importlib import resources
from types import FrameType
from typing import TYPE_CHECKING, Any

from gyrotrack import charts
from gyrotrack.errors import UsageError
from gyrotrack.view.documents import library_document
from gyrotrack.view.films import Clips, profile_text
from gyrotrack.view.guard import Guard
from gyrotrack.view.ranking import Ranker
from gyrotrack.view.requests import answered, body_of, number, refusal, text, whole
from gyrotrack.view.session import Session

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

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
        """End what runs beside the server."""
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
        wish = await body_of(request)
        return await answered(lambda: self.session.change(add=text(wish, "add"), drop=text(wish, "drop")))

    async def _go(self, request: Request) -> Response:
        wish = await body_of(request)
        return await answered(lambda: self.session.go(whole(wish, "place")))

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
        wish = await body_of(request)
        return await answered(
            lambda: self.clips.colour(
                text(wish, "clip"), whole(wish, "index"), number(wish, "x"), number(wish, "y")
            )
        )

    async def _profile(self, request: Request) -> Response:
        wish = await body_of(request)
        return await answered(lambda: {"toml": profile_text(wish)})

    async def _quit(self, _request: Request) -> Response:
        self.stop()
        return await answered(lambda: {"stopped": True})


def page_text(label: str) -> tuple[str, str]:
    """Return the page and the content security policy under which it is sent."""
    from jinja2 import Environment, StrictUndefined

    folder = resources.files("gyrotrack.view")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    template = environment.from_string(folder.joinpath("page.html.jinja").read_text("utf-8"))
    scripts = (charts.script(), folder.joinpath("view.js").read_text("utf-8"))
    style = folder.joinpath("view.css").read_text("utf-8") + charts.style()
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
