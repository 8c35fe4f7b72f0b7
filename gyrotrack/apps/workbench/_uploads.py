"""Uploads to the work folder that can be resumed after an interruption.

The bytes that have arrived are kept in ``.upload-KEY.part``, and name and size of the file in ``.upload-KEY.json``. KEY
is derived from name, size and date of the file. The part is therefore found when any page sends the same file again,
also after a restart. Before the page resumes, it compares the SHA-256 of the last bytes in the part with the SHA-256 of
the same bytes in its file.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from gyrotrack._errors import OutputError, UsageError
from gyrotrack.io._atomic import new_file, open_side_file

_TAIL = 64 * 1024  # number of bytes whose checksum is compared before an upload is resumed
_KEY_LENGTH = 16
_MAX_ENTRY = 4096  # largest size of a record of an upload [bytes]


class Sent(NamedTuple):
    """A file that a page sends: name without folder, size [bytes], date [ms since 1970]."""

    name: str
    size: int
    modified: int

    @property
    def key(self) -> str:
        """Name under which the bytes of the file are kept."""
        text = f"{self.name}\n{self.size}\n{self.modified}"
        return hashlib.sha256(text.encode()).hexdigest()[:_KEY_LENGTH]


class Uploads:
    """The unfinished uploads of one work folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._active: set[str] = set()

    def _part(self, key: str) -> Path:
        return self._folder / f".upload-{key}.part"

    def _entry(self, key: str) -> Path:
        return self._folder / f".upload-{key}.json"

    def state(self, file: Sent) -> dict[str, Any]:
        """Return the number of bytes of a file that have arrived, and the SHA-256 of the last bytes."""
        part, received, tail = self._part(file.key), 0, b""
        if part.exists():
            with open_side_file(part) as stream:
                received = min(os.fstat(stream.fileno()).st_size, file.size)
                stream.seek(max(0, received - _TAIL))
                tail = stream.read(min(received, _TAIL))
        return {"received": received, "tail": len(tail), "sha256": hashlib.sha256(tail).hexdigest()}

    def unfinished(self) -> list[dict[str, Any]]:
        """Return the files of which only a part has arrived, and which are not being sent now."""
        found = []
        for entry in sorted(self._folder.glob(".upload-*.json")):
            with suppress(OSError, ValueError, KeyError, TypeError, OutputError):
                with open_side_file(entry) as stream:
                    stated = json.loads(stream.read(_MAX_ENTRY))
                file = Sent(str(stated["name"]), int(stated["size"]), int(stated["modified"]))
                if entry == self._entry(file.key) and file.key not in self._active:
                    share = self.state(file)["received"] / file.size
                    found.append({"key": file.key, "name": file.name, "share": share})
        return found

    def discard(self, key: str) -> None:
        """Delete the part of a file that has arrived."""
        if key in self._active:
            raise UsageError("This file is being uploaded.", "Cancel the upload first.")
        if key not in {u["key"] for u in self.unfinished()}:
            raise UsageError("There is no such upload.", "Reload the page.")
        self._forget(key)

    def _forget(self, key: str) -> None:
        for path in (self._part(key), self._entry(key)):
            path.unlink(missing_ok=True)

    async def receive(self, file: Sent, offset: int, pieces: AsyncIterator[bytes]) -> Path | None:
        """Write the bytes of a file from `offset` on; return the path of the complete file, or None before the end.

        Bytes that arrive before an interruption are kept. The caller moves the returned file to its place.
        """
        with self._sending(file.key):
            with new_file(self._entry(file.key), force=True) as stream:
                stream.write(json.dumps(file._asdict()).encode())
            part = self._part(file.key)
            with open_side_file(part, os.O_RDWR | os.O_CREAT) as stream:
                if offset > os.fstat(stream.fileno()).st_size:
                    what = f"{file.name} cannot continue at byte {offset}: fewer bytes have arrived."
                    raise UsageError(what, "Upload it again.")
                stream.truncate(offset)
                stream.seek(offset)
                size = offset
                async for piece in pieces:
                    size += len(piece)
                    if size > file.size:
                        break
                    stream.write(piece)
                    stream.flush()
            if size > file.size:
                self._forget(file.key)
                what = f"The size of {file.name} is not as declared ({file.size} bytes)."
                raise UsageError(what, "Upload it again.")
            return part if size == file.size else None

    def finished(self, file: Sent) -> None:
        """Remove the records of a file that has arrived and was moved or refused."""
        self._forget(file.key)

    @contextmanager
    def _sending(self, key: str) -> Iterator[None]:
        if key in self._active:
            raise UsageError("This file is already being uploaded.", "Wait until it has arrived.")
        self._active.add(key)
        try:
            yield
        finally:
            self._active.discard(key)
