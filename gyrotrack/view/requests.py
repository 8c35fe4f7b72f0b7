"""What the page asks, read with distrust, and what it is answered: a document, or one sentence on what is wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from gyrotrack.errors import GyrotrackError

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

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
    """Return what the work gives as JSON, or its error as one sentence."""
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


def text(wish: dict[str, Any], name: str) -> str:
    """Return a text that is asked for; nothing, if it is none."""
    value = wish.get(name, "")
    return value if isinstance(value, str) else ""


def whole(wish: dict[str, Any], name: str) -> int:
    """Return a whole number that is asked for; -1, if there is none."""
    try:
        return int(wish.get(name, -1))
    except (TypeError, ValueError, OverflowError):
        raise GyrotrackError(f"{name} is not a whole number.") from None


def number(wish: dict[str, Any], name: str) -> float:
    """Return a place on a frame that is asked for, as a share of its width or height."""
    try:
        value = float(wish.get(name, "nan"))
    except (TypeError, ValueError, OverflowError):
        value = float("nan")
    if not 0.0 <= value <= 1.0:
        raise GyrotrackError(f"{name} is not a place on the frame.")
    return value
