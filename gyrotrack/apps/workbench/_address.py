"""One server per folder: a second `gyrotrack view` opens the page of the first command.

A running server stores its address in ``.NAME.address`` beside the lock of the folder or case. Only its user can read
this file, because the address contains the secret. An address is used only if its server answers.
"""

from __future__ import annotations

import json
import os
import socket
from contextlib import suppress
from pathlib import Path
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import ProxyHandler, Request, build_opener

_WAIT = 2.0  # longest wait for the answer of a server [s]
_MAX_SIZE = 2000  # largest size of an address file [bytes]


class Address:
    """The address of the server that has the lock of `path`."""

    def __init__(self, path: Path) -> None:
        self._file = path.with_name(f".{path.name}.address")

    def publish(self, url: str) -> None:
        """Store the address of this server."""
        self.clear()
        # if the file cannot be written, a second program only reports that the folder is in use
        with suppress(OSError):
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
            with os.fdopen(os.open(self._file, flags, 0o600), "w", encoding="utf-8") as stream:
                json.dump({"url": url, "host": socket.gethostname(), "pid": os.getpid()}, stream)

    def clear(self) -> None:
        """Remove the address."""
        with suppress(OSError):
            self._file.unlink()

    def running(self) -> str:
        """Return the address of a server on this machine that answers, or an empty text."""
        try:
            if self._file.is_symlink() or self._file.stat().st_size > _MAX_SIZE:
                return ""
            found = json.loads(self._file.read_text("utf-8"))
            url, host = str(found["url"]), found["host"]
            parts = urlsplit(url)
            if host != socket.gethostname() or parts.scheme != "http" or parts.hostname != "127.0.0.1":
                return ""
            token = parts.query.partition("token=")[2]
            request = Request(
                f"http://127.0.0.1:{parts.port}/api/pulse", headers={"x-gyrotrack-token": token}
            )
            with build_opener(ProxyHandler({})).open(request, timeout=_WAIT) as answer:
                return url if answer.status == 200 else ""
        except (OSError, ValueError, KeyError, TypeError, URLError):
            return ""
