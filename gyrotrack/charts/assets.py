"""The script and the style of charts, and data in a page that no browser takes for anything but data."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

# what could end the element, or begin a comment or another element, is written as an escape of JSON
_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


@cache
def script() -> str:
    """Return the script."""
    return _read("charts.js")


@cache
def style() -> str:
    """Return the style sheet."""
    return _read("charts.css")


def as_data(document: Any) -> str:
    """Return a document as JSON that may stand inside a ``script`` element of the type application/json."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).translate(_ESCAPES)


def content_policy(scripts: Sequence[str], *, connect: bool = False) -> str:
    """Return a content security policy under which these scripts run and nothing else.

    Parameters
    ----------
    scripts : sequence of str
        The exact text of each inline script.
    connect : bool
        Whether the page may talk to the server that it came from.
    """
    hashes = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    allowed = " ".join(f"'sha256-{h}'" for h in hashes) or "'none'"
    parts = [
        "default-src 'none'",
        f"script-src {allowed}",
        "style-src 'unsafe-inline'",
        "img-src data: blob:" if connect else "img-src data:",
        "base-uri 'none'",
        "form-action 'none'",
    ]
    return "; ".join([*parts, "connect-src 'self'"] if connect else parts)


def _read(name: str) -> str:
    return resources.files("gyrotrack.charts").joinpath(name).read_text("utf-8")
