"""The server of the workbench, on this machine only.

The server listens on the loopback interface and rejects requests from other sites. The Host header reveals requests to
other host names (DNS rebinding). The Origin or Sec-Fetch-Site header reveals requests from forms and scripts of other
sites. Each request also needs the token, which is new at each start. The first visit has the token in the address, and
exchanges the token for a cookie.
"""

from __future__ import annotations

import hmac
import json
import math
import secrets
import shlex
import socket
from base64 import b64encode
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module, resources
from pathlib import Path
from threading import Lock, Thread
from types import FrameType
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from gyrotrack._errors import GyrotrackError, UsageError
from gyrotrack.apps._study import open_study, read_cases
from gyrotrack.apps.report._page import is_report
from gyrotrack.apps.workbench import _films as films
from gyrotrack.apps.workbench._address import Address
from gyrotrack.apps.workbench._motion_charts import motion_board
from gyrotrack.apps.workbench._processes import Job, Jobs, Ranker
from gyrotrack.apps.workbench._project import Project
from gyrotrack.apps.workbench._session import Session, library_document
from gyrotrack.apps.workbench._uploads import Sent
from gyrotrack.io._hdf5 import read_case
from gyrotrack.io._tables import valid
from gyrotrack.plotting import _charts as charts
from gyrotrack.plotting._tracking import jpeg

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

    from fitting.inference._case_data import CaseData
    from gyrotrack.io._records import Case


Scope = Mapping[str, Any]
Send = Callable[[Any], Awaitable[None]]
Receive = Callable[[], Awaitable[Any]]
App = Callable[[Any, Receive, Send], Awaitable[None]]
Call = Callable[[dict[str, Any]], Any]
Endpoint = Callable[["Request"], Awaitable["Response"]]

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
    """ASGI middleware that rejects requests without the secret `token`, in a header or a cookie.

    A request with the token in its address is redirected to the address without the token, and sets the cookie.
    """

    def __init__(self, app: App, port: int, token: str) -> None:
        self._app = app
        self._cookie = (
            f"gyrotrack-{port}"  # browsers do not separate cookies by port, so the name contains the port
        )
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost")}
        self._token = token.encode()

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        """Handle a request, or reject it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status = self._status(scope)
        if status == _MOVED:
            cookie = f"{self._cookie}={self._token.decode()}; HttpOnly; SameSite=Strict; Path=/"
            await _answer(scope, status, send, (b"location", b"/"), (b"set-cookie", cookie.encode()))
            return
        if status != _ACCEPTED:
            await _answer(scope, status, send)
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
        # the cookie alone is not sufficient, because the browser also sends it with requests from pages on other ports
        if any(k == b"sec-fetch-site" and v not in {b"same-origin", b"none"} for k, v in headers):
            return _FORBIDDEN
        if scope["path"] == "/" and scope["method"] == "GET" and b"token=" in scope["query_string"]:
            query = parse_qs(scope["query_string"][:_MAX_QUERY])
            return _MOVED if self._fits(query.get(b"token", [])) else _FORBIDDEN
        given = [v for k, v in headers if k == TOKEN_HEADER]
        pairs = [c.strip().partition(b"=") for k, v in headers if k == b"cookie" for c in v.split(b";")]
        given += [value for name, _, value in pairs if name == self._cookie.encode()]
        return _ACCEPTED if self._fits(given) else _FORBIDDEN

    def _fits(self, given: Sequence[bytes]) -> bool:
        return any(hmac.compare_digest(g, self._token) for g in given)


_MAX_QUERY = 500
_ACCEPTED, _MOVED, _FORBIDDEN, _MISDIRECTED = 200, 303, 403, 400


async def _answer(scope: Scope, status: int, send: Send, *more: tuple[bytes, bytes]) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    text = b"Open the address that `gyrotrack view` printed.\n"
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(text)).encode()),
        *_HEADERS,
        *more,
    ]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": text if scope["method"] != "HEAD" else b""})


# the sandbox gives the report an opaque origin, so that its requests cannot pass as requests of the page
_SANDBOX = "sandbox allow-scripts allow-downloads"
_MAX_BODY = 64 * 1024


async def body_of(request: Request) -> dict[str, Any]:
    """Return the content of a request; empty if it is too long or not a JSON object."""
    raw = bytearray()
    async for piece in request.stream():
        raw += piece
        if len(raw) > _MAX_BODY:
            return {}
    try:
        found = json.loads(bytes(raw) or b"{}", parse_constant=_no_number)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _no_number(text: str) -> float:
    raise ValueError(text)


async def answered(work: Callable[[], Any]) -> Response:
    """Return the result of a function, or its error, as JSON."""
    from starlette.concurrency import run_in_threadpool
    from starlette.responses import JSONResponse

    try:
        return JSONResponse(await run_in_threadpool(work))
    except Exception as error:
        return refusal(error)


def refusal(error: Exception) -> Response:
    """Return an error as JSON: status 400 for an error with a message, 500 for a bug."""
    from starlette.responses import JSONResponse

    message, hint = getattr(error, "message", ""), getattr(error, "hint", "")
    if not isinstance(message, str) or not message:
        what = f"{type(error).__name__}: {error}".splitlines()[0].rstrip(".")
        return JSONResponse(
            {"error": {"code": "bug", "message": f"Internal error: {what}.", "hint": ""}}, 500
        )
    code = str(getattr(error, "code", "error"))
    return JSONResponse({"error": {"code": code, "message": message, "hint": str(hint)}}, 400)


def text(query: dict[str, Any], name: str) -> str:
    """Return a text of a request; "" if it is missing or not a text. Invalid characters raise a UsageError."""
    value = query.get(name, "")
    if not isinstance(value, str):
        return ""
    if valid(value) != value:
        raise UsageError("The text has characters that are not valid.", "Correct it.")
    return value


def whole(query: dict[str, Any], name: str) -> int:
    """Return an integer of a request; -1 if it is missing."""
    try:
        return int(query.get(name, -1))
    except (TypeError, ValueError, OverflowError):
        raise GyrotrackError(f"{name} is not an integer.") from None


def number(query: dict[str, Any], name: str) -> float:
    """Return a coordinate of a request, as a fraction of the width or height of a frame."""
    try:
        value = float(query.get(name, "nan"))
    except (TypeError, ValueError, OverflowError):
        value = float("nan")
    if not 0.0 <= value <= 1.0:
        raise GyrotrackError(f"{name} is not a coordinate between 0 and 1.")
    return value


def numbers(query: dict[str, Any], name: str) -> dict[str, float]:
    """Return numbers of a request by name; empty if they are missing."""
    found = query.get(name)
    if not isinstance(found, dict):
        return {}
    try:
        values = {str(k): float(v) for k, v in found.items() if isinstance(v, int | float)}
    except OverflowError:
        values = {}
    if len(values) < len(found) or not all(map(math.isfinite, values.values())):
        raise UsageError("A value is not a number.", "Reload the page.")
    return values


_ADDRESS = "127.0.0.1"


@dataclass(frozen=True)
class Opened:
    """A case that was read, and the estimates of its noise that do not need a fit."""

    case: Path
    stamp: int  # modification time of the file
    tracked: Case
    data: CaseData

    @classmethod
    def of(cls, case: Path) -> Opened:
        """Read a case and estimate its noise."""
        stamp, tracked = _modified(case), read_case(case)
        (data,) = read_cases([case])
        for name in ("nuisance", "process_noise"):  # evaluated now, because `data` caches these estimates
            getattr(data, name)
        return cls(case, stamp, tracked, data)

    @property
    def is_current(self) -> bool:
        """Whether the file has not changed since it was read."""
        return self.stamp == _modified(self.case)


# modules that the laboratory needs when it opens; their import takes as long as computing the first charts
_IMPORTED_AHEAD = (
    "fitting.discovery._residuals",
    "fitting.discovery._verdict",
    "fitting.study._history",
    "gyrotrack.plotting._case_charts",
    "gyrotrack.plotting._ghost",
    "gyrotrack.plotting._study_data",
    "scipy.ndimage",
)


def import_for_laboratory() -> None:
    """Import the modules of the laboratory while other processes track or fit the films."""
    for name in _IMPORTED_AHEAD:
        import_module(name)


@dataclass(frozen=True)
class Laboratory:
    """The open case with its fits and films, and the processes that rank candidate effects and write the report."""

    session: Session
    clips: films.Clips
    ranker: Ranker
    case: Path
    ledger: Path | None
    jobs: Jobs
    # file name and content of the report that this process has written
    written: dict[str, bytes] = field(default_factory=dict)
    key: str = field(
        default_factory=lambda: secrets.token_hex(4)
    )  # a number by which the pages recognise that the case was opened again

    @classmethod
    def open(
        cls,
        case: Path,
        folders: Sequence[Path],
        ledger: Path | None = None,
        start: str | None = None,
        *,
        opened: Opened | None = None,
    ) -> Laboratory:
        """Open a case with a fit of its history, by default the latest; without fits, fit the reduced model."""
        tracked = read_case(case) if opened is None else opened.tracked
        if tracked.joints:
            what = f"{case.name}: the workbench does not show several bodies with joints."
            raise UsageError(what, "Use `gyrotrack fit`, `gyrotrack diagnose` and `gyrotrack report`.")
        study = open_study([case], ledger, read=() if opened is None else (opened.data,))
        entry = study.entry(start)
        base, fit_id = study.base(None) if entry is None else (entry.shown(study.data), entry.fit_id)
        session = Session(study.data[0], base, fit_id, study.ledger, tracked)
        # evaluated now, to prepare the answer to the first request of the page
        Thread(target=session.state, kwargs={"whole": True}, daemon=True).start()
        jobs = Jobs(case.resolve().parent, 1)
        clips = films.Clips(tracked, list(folders))
        return cls(session, clips, Ranker(case), case.resolve(), ledger, jobs)

    @property
    def report(self) -> Path:
        """Path of the report, next to the case; another name if a file that is not a report has this name."""
        number, path = 1, self.case.with_suffix(".report.html")
        while not is_report(path):
            number += 1
            path = self.case.with_suffix(f".report_{number}.html")
        return path

    def write_report(self) -> dict[str, Any]:
        """Save the current fit in the ledger and write the report of its history, in a process."""
        path = self.report

        def finished(job: Job) -> None:
            self.written.clear()
            if job.state == "done":
                with suppress(OSError):
                    self.written[path.name] = path.read_bytes()

        self.jobs.start("report", self._report_words(self.session.kept()), finished)
        return self.report_state()

    def report_state(self) -> dict[str, Any]:
        """Return the state of the report, its name, and the command that writes it."""
        job = self.jobs.get("report")
        words = self._report_words() if job is None else job.words
        state = {"state": "none"} if job is None else job.summary()
        return state | {"name": self.report.name, "command": shlex.join(("gyrotrack", *words))}

    def _report_words(self, fit_id: str = "") -> tuple[str, ...]:
        words = ["report", self.case.name, "-o", self.report.name, "--force"]
        words += ["--from", fit_id] if fit_id else []
        words += ["--films", str(self.clips.folder)] if self.clips.folder is not None else []
        words += ["--ledger", str(self.ledger.resolve())] if self.ledger is not None else []
        return tuple(words)

    def certify(self, count: int) -> dict[str, Any]:
        """Save the current fit, and test its answer on `count` simulated recordings, in a process."""
        if not 1 <= count <= _MOST_RECORDINGS:
            raise UsageError(
                f"The number of recordings is not between 1 and {_MOST_RECORDINGS}.", "Change it."
            )
        return self._start("certificate", ["certify", self.case.name, "-n", str(count)])

    def plan(self) -> dict[str, Any]:
        """Save the current fit, and compute the best next run, in a process."""
        return self._start("plan", ["plan", self.case.name])

    def _start(self, key: str, words: list[str]) -> dict[str, Any]:
        words += ["--from", self.session.kept()]
        words += ["--ledger", str(self.ledger.resolve())] if self.ledger is not None else []
        self.jobs.start(key, words, lambda _: None)
        return self.outcome(key)

    def outcome(self, key: str) -> dict[str, Any]:
        """Return state, progress and document of the certificate, or of the plan of the next run."""
        job = self.jobs.get(key)
        # a finished test is stored with its fit, and the shown fit may be a different fit
        if key == "certificate" and (job is None or job.state == "done"):
            return {"state": "none", "document": self.session.certificate()}
        if job is None:
            return {"state": "none", "document": {}}
        document = job.document if job.state == "done" else {}
        if key == "plan" and document:
            document = {k: document.get(k) for k in ("next_run", "warning")}
        return job.summary() | {"document": document, "command": shlex.join(("gyrotrack", *job.words))}

    def close(self) -> None:
        """End all processes and close the films."""
        self.jobs.close()
        self.ranker.close()
        self.clips.close()


_MOST_RECORDINGS = 2000  # largest number of simulated recordings for one certificate


class Workbench:
    """The application: page and requests, for an open case or a work folder with films."""

    def __init__(
        self,
        laboratory: Laboratory | None = None,
        project: Project | None = None,
        address: Address | None = None,
    ) -> None:
        self._address = address
        self._laboratory, self.project = laboratory, project
        self._frames = films.SourceFrames()
        self._opening = Lock()
        self._reading: Future[Opened] | None = None  # data of the case that is being fitted
        self._opened: tuple[str, str, int] | None = None  # file, fit and modification time of the open case
        if project is not None:
            # the case is opened now, so that the laboratory is ready for the first request of the page
            project.when_fitted = lambda: self._open(project)
            project.when_matched = lambda: self._read_ahead(project.folder / project.state.case)
            project.when_started = lambda: Thread(target=import_for_laboratory, daemon=True).start()
        self.stop: Callable[[], None] = lambda: None

    @property
    def laboratory(self) -> Laboratory:
        """The open case."""
        if self._laboratory is None:
            raise UsageError("No case is open.", "Create a case from films or tables.")
        return self._laboratory

    def app(self, port: int, token: str) -> Guard:
        """Return the protected application."""
        from starlette.applications import Starlette
        from starlette.routing import Route

        routes = [
            Route("/", self._page),
            Route("/api/pulse", self._pulse),
            Route("/api/state", self._get(self._state)),
            Route("/api/marks", self._get(self._marks)),
            Route("/api/outcome", self._get(lambda a: self.laboratory.outcome(text(a, "key")))),
            Route("/api/frame", self._frame),
            Route("/api/report", self._get(lambda _: self.laboratory.report_state())),
            Route("/report", self._report),
            *(
                Route(f"/api/{k}", self._post(f), methods=["POST"])
                for k, f in self._laboratory_calls().items()
            ),
            Route("/api/quit", self._post(self._quit), methods=["POST"]),
        ]
        if self.project is not None:
            p = self.project
            calls = self._project_calls(p)
            routes += [
                Route("/api/project", self._get(lambda _: p.document())),
                Route("/api/project/preview", self._get(lambda a: p.previewed(text(a, "key")))),
                Route(
                    "/api/project/tracked", self._get(lambda a: p.tracked(text(a, "key"), whole(a, "index")))
                ),
                Route("/api/project/motion", self._get(lambda _: motion_board(p))),
                Route("/api/project/frame", self._source_frame),
                Route("/api/project/uploaded", self._get(lambda a: p.upload_state(sent(a)[0]))),
                Route("/api/project/upload", self._upload, methods=["POST"]),
                *(Route(f"/api/project/{k}", self._post(f), methods=["POST"]) for k, f in calls.items()),
            ]
        return Guard(Starlette(routes=routes, lifespan=self._life), port, token)

    def _laboratory_calls(self) -> dict[str, Call]:
        def session(work: Callable[[Session, dict[str, Any]], Any]) -> Call:
            return lambda a: work(self.laboratory.session, a)

        def rank(_: dict[str, Any]) -> Any:
            lab = self.laboratory
            return lab.session.remember(lab.ranker.rank(lab.session.model_document()))

        return {
            "change": session(
                lambda s, a: s.change(add=text(a, "add"), drop=text(a, "drop"), values=numbers(a, "values"))
            ),
            "sliders": session(lambda s, _: s.sliders()),
            "moved": session(lambda s, a: s.moved(numbers(a, "values"))),
            "go": session(lambda s, a: s.go(whole(a, "place"))),
            "compare": session(lambda s, a: s.compare(whole(a, "place"))),
            "undo": session(lambda s, _: s.undo()),
            "redo": session(lambda s, _: s.redo()),
            "cancel_fit": session(lambda s, _: s.cancel()),
            "cancel_rank": lambda _: self._cancelled_search(),
            "certify": lambda a: self.laboratory.certify(whole(a, "count")),
            "plan": lambda _: self.laboratory.plan(),
            "cancel": lambda a: self._cancelled(text(a, "key")),
            "delete": session(lambda s, a: s.delete(whole(a, "place"))),
            "note": session(
                lambda s, a: s.annotate(whole(a, "place"), name=text(a, "name"), note=text(a, "note"))
            ),
            "keep": session(lambda s, _: s.keep()),
            "rank": rank,
            "write_report": lambda _: self.laboratory.write_report(),
            "colour": lambda a: self.laboratory.clips.colour(
                text(a, "clip"), whole(a, "index"), number(a, "x"), number(a, "y")
            ),
            "profile": lambda a: {"toml": films.profile_text(a)},
        }

    def _cancelled(self, key: str) -> dict[str, Any]:
        self.laboratory.jobs.cancel(key)
        return self.laboratory.outcome(key)

    def _cancelled_search(self) -> dict[str, Any]:
        self.laboratory.ranker.cancel()
        return {}

    def _project_calls(self, p: Project) -> dict[str, Call]:
        def then(work: Call) -> Call:
            def call(query: dict[str, Any]) -> Any:
                work(query)
                return p.document()

            return call

        return {
            "add": then(lambda a: p.add_named(text(a, "name"))),
            "samples": then(lambda _: p.add_samples()),
            "remove": then(lambda a: p.remove(text(a, "key"))),
            "discard": then(lambda a: p.discard_upload(text(a, "key"))),
            "restore": then(lambda a: p.restore(text(a, "key"))),
            "undo": then(lambda _: p.undo()),
            "redo": then(lambda _: p.redo()),
            "uncorrect": then(lambda a: p.uncorrect(text(a, "key"), text(a, "marker"), whole(a, "index"))),
            "set": then(lambda a: p.set(text(a, "key"), text(a, "name"), a.get("value"))),
            "mark": then(lambda a: p.mark(text(a, "key"), a.get("hub"), a.get("picks"), text(a, "disc"))),
            "follow": then(lambda a: p.preview(text(a, "key"))),
            "find": then(lambda a: p.find_markers(text(a, "key"))),
            "read": then(lambda a: p.read(text(a, "key"))),
            "correct": lambda a: (
                p.correct(
                    text(a, "key"),
                    text(a, "marker"),
                    whole(a, "index"),
                    a.get("place"),
                    confirmed=a.get("confirmed") is True,
                )
                or p.document()
            ),
            "track": then(lambda a: p.track([text(a, "key")] if text(a, "key") else [])),
            "match": then(lambda _: p.match()),
            "analyse": then(lambda _: p.analyse()),
            "fit": then(lambda _: p.fit()),
            "cancel": then(lambda a: p.cancel(text(a, "step"))),
            "colour": lambda a: films.colour_at(
                self._frames.picture(p.path(p.source(text(a, "key"))), whole(a, "index")),
                number(a, "x"),
                number(a, "y"),
            ),
            "open": lambda _: self._open(p),
        }

    def _open(self, p: Project) -> dict[str, Any]:
        """Open the case of the project, and close any other open case."""
        with self._opening:
            stamp = (p.state.case, str(p.state.fit.get("fit_id", "")), _modified(p.folder / p.state.case))
            if self._laboratory is not None and self._opened == stamp:
                return {"opened": p.state.case}  # the open laboratory keeps its fits and its history
            if not p.state.case or not (p.folder / p.state.case).is_file():
                raise UsageError("There is no case yet.", "Track and synchronise the films first.")
            folders = list(dict.fromkeys([p.folder, *(p.path(x).parent for x in p.state.sources)]))
            case = p.folder / p.state.case
            found = Laboratory.open(case, folders, opened=self._read_before(case))
            old, self._laboratory, self._opened = self._laboratory, found, stamp
            if old is not None:
                old.close()
        return {"opened": p.state.case}

    def _read_ahead(self, case: Path) -> None:
        """Read a case while it is fitted, so that its charts appear as soon as the fit has ended."""
        reading: Future[Opened] = Future()
        self._reading = reading

        def work() -> None:
            try:
                reading.set_result(Opened.of(case))
            except (
                Exception
            ) as error:  # the laboratory reads the case again when it opens, and then reports the error
                reading.set_exception(error)

        Thread(target=work, daemon=True).start()

    def _read_before(self, case: Path) -> Opened | None:
        """Return the case if it was read ahead and its file has not changed since, else None."""
        reading, self._reading = self._reading, None
        if reading is None or reading.exception() is not None:
            return None
        found = reading.result()
        return found if found.case == case and found.is_current else None

    @asynccontextmanager
    async def _life(self, _app: Any) -> AsyncIterator[None]:
        try:
            yield
        finally:
            self.close()

    def publish(self, url: str) -> None:
        """Store the address of this server, for a second command on the same folder or case."""
        if self._address is not None:
            self._address.publish(url)

    def interrupt(self) -> None:
        """End the ranking process, so that no request waits for its answer."""
        if self._laboratory is not None:
            self._laboratory.ranker.close()

    def close(self) -> None:
        """End all processes and close the films."""
        if self._address is not None:
            self._address.clear()
        if self._laboratory is not None:
            self._laboratory.close()
        if self.project is not None:
            self.project.close()
        self._frames.close()

    def _get(self, work: Call) -> Endpoint:
        async def endpoint(request: Request) -> Response:
            query = dict(request.query_params)
            return await answered(lambda: work(query))

        return endpoint

    def _post(self, work: Call) -> Endpoint:
        async def endpoint(request: Request) -> Response:
            query = await body_of(request)
            return await answered(lambda: work(query))

        return endpoint

    async def _pulse(self, _request: Request) -> Response:
        """Return the changes and the running jobs at once, even if all threads are busy."""
        from starlette.responses import JSONResponse

        lab, p = self._laboratory, self.project
        found: dict[str, Any] = {"project": None, "laboratory": None}
        if p is not None:
            found["project"] = {"revision": p.revision, "jobs": p.jobs.active()}
        if lab is not None:
            found["laboratory"] = {
                "key": lab.key,
                "revision": lab.session.revision,
                "fit": lab.session.progress(),
                "search": lab.ranker.progress(),
                "jobs": lab.jobs.active(),
            }
        return JSONResponse(found)

    async def _page(self, _request: Request) -> Response:
        from starlette.responses import HTMLResponse

        label = self._laboratory.session.label if self._laboratory is not None else ""
        page, policy = page_text(label, has_case=bool(label), has_project=self.project is not None)
        return HTMLResponse(page, headers={"content-security-policy": policy})

    async def _report(self, _request: Request) -> Response:
        from starlette.responses import HTMLResponse

        lab = self._laboratory
        if lab is None or not lab.written:
            return refusal(UsageError("There is no report yet.", "Write the report in the laboratory."))
        (page,) = lab.written.values()
        return HTMLResponse(page, headers={"content-security-policy": f"{_SANDBOX}; {charts.PAGE_POLICY}"})

    def _state(self, _query: dict[str, Any]) -> dict[str, Any]:
        lab = self.laboratory
        return lab.session.state(whole=True) | {
            "key": lab.key,
            "clips": lab.clips.document(),
            "library": library_document(),
        }

    def _marks(self, query: dict[str, Any]) -> dict[str, Any]:
        lab, clip, index = self.laboratory, text(query, "clip"), whole(query, "index")
        found = lab.clips.marks(clip, index)
        return found | ({"ghost": lab.session.ghost(clip, index)} if query.get("ghost") == "1" else {})

    async def _frame(self, request: Request) -> Response:
        query = dict(request.query_params)
        return await pictured(
            lambda: (
                self.laboratory.clips.frame(
                    query.get("clip", ""), whole(query, "index"), overlay=query.get("overlay") != "0"
                ),
                {},
            )
        )

    async def _source_frame(self, request: Request) -> Response:
        query = dict(request.query_params)

        def work() -> tuple[bytes, dict[str, str]]:
            assert self.project is not None  # noqa: S101 - the route exists only then
            path = self.project.path(self.project.source(query.get("key", "")))
            picture = self._frames.picture(path, whole(query, "index"))
            size = {"x-gyrotrack-size": f"{picture.shape[1]},{picture.shape[0]}"}
            return jpeg(picture, films.SHOWN_WIDTH, films.QUALITY), size

        return await pictured(work)

    async def _upload(self, request: Request) -> Response:
        from starlette.requests import ClientDisconnect
        from starlette.responses import JSONResponse

        assert self.project is not None  # noqa: S101 - the route exists only then
        query = dict(request.query_params)
        try:
            file, offset = sent(query, request.headers.get("content-length", ""))
            complete = await self.project.receive(file, offset, request.stream())
        except ClientDisconnect:  # the bytes that have arrived are kept
            return refusal(UsageError("The upload was interrupted.", "Send the file again to continue it."))
        except Exception as error:
            return refusal(error)
        if not complete:
            return refusal(
                UsageError("A part of the file is missing.", "Send the file again to continue it.")
            )
        return JSONResponse(self.project.document())

    def _quit(self, _query: dict[str, Any]) -> dict[str, Any]:
        self.stop()
        return {"stopped": True}


_MAX_DIGITS = 15  # largest number of digits of a number of bytes


def sent(query: Mapping[str, Any], length: str = "") -> tuple[Sent, int]:
    """Return the file that a page sends, and the position of the first sent byte in the file.

    The default size of the file is `length`.
    """

    def count(text: str) -> int:
        return int(text) if text.isascii() and text.isdigit() and len(text) < _MAX_DIGITS else -1

    offset = count(str(query.get("offset", "0")))
    size = count(str(query.get("size", length)))
    if offset < 0:
        raise UsageError("The upload does not state where it continues.", "Upload the file again.")
    return Sent(text(dict(query), "name"), size, count(str(query.get("modified", "0")))), offset


async def pictured(work: Callable[[], tuple[bytes, dict[str, str]]]) -> Response:
    """Return a JPEG picture with headers, or the error as JSON."""
    from starlette.concurrency import run_in_threadpool
    from starlette.responses import Response

    try:
        image, headers = await run_in_threadpool(work)
    except Exception as error:
        return refusal(error)
    return Response(image, media_type="image/jpeg", headers=headers)


def _modified(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def page_text(label: str, *, has_case: bool, has_project: bool) -> tuple[str, str]:
    """Return the page and its content security policy."""
    from jinja2 import Environment, StrictUndefined

    folder = resources.files("gyrotrack.apps.workbench")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    template = environment.from_string(folder.joinpath("page.html.jinja").read_text("utf-8"))
    own = [
        folder.joinpath(n).read_text("utf-8")
        for n in ("client.js", "filmview.js", "films.js", "view.js", "tour.js")
    ]
    scripts = (*charts.scripts(), *own)
    style = charts.theme() + folder.joinpath("view.css").read_text("utf-8") + charts.style_sheet()
    begins = has_project and not has_case
    page = template.render(
        title=label,
        style=style,
        scripts=scripts,
        has_case=has_case,
        has_project=has_project,
        filming=b64encode(folder.joinpath("filming.jpg").read_bytes()).decode() if begins else "",
    )
    return page, charts.content_policy(scripts, connect=True)


def serve(bench: Workbench, port: int, announce: Callable[[str], None], *, window: bool = False) -> None:
    """Serve on the loopback interface (port 0: any free port) until interrupted, or ended from page or `window`."""
    import uvicorn

    # asyncio sets TCP_NODELAY, which avoids delays, only if the protocol is explicit
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((_ADDRESS, port))
        except (OSError, OverflowError):
            raise UsageError(f"The port {port} is not free.", "Omit --port to use any free port.") from None
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
                bench.interrupt()
                super().handle_exit(sig, frame)

        server = Server(config)

        def stop() -> None:
            bench.interrupt()
            server.should_exit = True

        bench.stop = stop
        listener.listen()  # connections that arrive before the server runs are queued
        address = f"http://{_ADDRESS}:{port}/?token={token}"
        bench.publish(address)
        announce(address)
        if window:
            _run_in_window(server, listener, address)
        else:
            server.run(sockets=[listener])
    finally:
        bench.close()
        listener.close()


def _run_in_window(server: Any, listener: socket.socket, address: str) -> None:
    """Serve in a thread; desktop toolkits require the main thread for the window."""
    import webview

    thread = Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    shown = webview.create_window("gyrotrack", address, width=1400, height=900)

    def watch() -> None:
        thread.join()
        shown.destroy()

    webview.start(watch)
    server.should_exit = True
    thread.join()
