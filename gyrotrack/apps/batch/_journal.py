"""The journal of a batch: completed steps, verified before reuse.

A step counts as done when its key (program version, words, contents of its sources, fingerprints of the steps
before it) is the one in the journal, and its output has still the contents that it had then.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from gyrotrack._errors import OutputError
from gyrotrack._versions import __version__
from gyrotrack.apps.batch._steps import Outcome, Step
from gyrotrack.io._atomic import locked, refuse_special

HEADER = {"format": "gyrotrack batch", "version": 1}


class Journal:
    """The journal of one folder of results.

    Parameters
    ----------
    path : Path
        The file; it need not exist yet.

    Raises
    ------
    OutputError
        Another file is in its place.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._records: dict[str, dict[str, Any]] = {}
        self._torn = False
        refuse_special(path, OutputError)
        if path.exists():
            self._read()

    def _read(self) -> None:
        try:
            text = self.path.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise OutputError(
                f"{self.path} cannot be read: {error.strerror}.", "Choose another folder with -o."
            ) from error
        lines = [_line(line) for line in text.splitlines()]
        self._torn = bool(text) and not text.endswith("\n")
        if (
            self._torn and len(lines) == 1 and json.dumps(HEADER).startswith(text)
        ):  # killed at its very beginning
            self.path.write_bytes(b"")
            self._torn, lines = False, []
        if lines and lines[0] != HEADER:
            raise OutputError(f"{self.path} is not the journal of a batch.", "Choose another folder with -o.")
        for record in lines[1:]:  # a line that was cut by a kill counts as not written
            if isinstance(record, dict) and isinstance(record.get("step"), str):
                self._records[record["step"]] = record

    def kept(self, step: Step, key: str) -> Outcome | None:
        """Return the outcome of an earlier run if neither its sources nor its output have changed."""
        record = self._records.get(step.name)
        if record is None or record.get("key") != key or not record.get("fingerprint"):
            return None
        document = record.get("document", {})
        if fingerprint(step, document) != record["fingerprint"]:
            return None
        return Outcome(
            "kept", document, record["fingerprint"], record.get("seconds", 0.0), record.get("trusted", True)
        )

    def add(self, step: Step, key: str, outcome: Outcome) -> None:
        """Append the outcome of a step and flush it to the disk."""
        record = {
            "step": step.name,
            "key": key,
            "state": outcome.state,
            "fingerprint": outcome.fingerprint,
            "seconds": round(outcome.seconds, 3),
            "trusted": outcome.trusted,
            "version": __version__,
            "document": outcome.document,
        }
        try:
            new = not self.path.exists() or self.path.stat().st_size == 0
            with self.path.open("a", encoding="utf-8") as stream:
                if new:
                    stream.write(json.dumps(HEADER) + "\n")
                if self._torn:
                    stream.write("\n")
                    self._torn = False
                stream.write(json.dumps(record) + "\n")
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise OutputError(
                f"{self.path} cannot be written: {error.strerror}.", "Free space and run the batch again."
            ) from error
        self._records[step.name] = record


def key_of(
    step: Step, words: list[str], results: Path, contents: Mapping[Path, str], before: list[str]
) -> str:
    """Return the key of a step: a hash of what determines its output, wherever the folders are."""
    names = {str(path): digest for path, digest in contents.items()}
    top = str(results.resolve())
    stated = [names.get(word, word.replace(top, "results")) for word in words]
    whole = [__version__, step.verb, stated, [contents[p] for p in step.files], before]
    return hashlib.sha256(json.dumps(whole).encode()).hexdigest()


def fingerprint(step: Step, document: Mapping[str, Any]) -> str:
    """Return a hash of the output of a step, or "" if it does not exist."""
    if step.verb in {"fit", "improve"}:  # later fits are added to the same ledger, and change none of this
        return _fit_digest(
            step.output, str(document.get("fit_id") or document.get("final", {}).get("fit_id"))
        )
    return contents_of(step.output) or ""


def _fit_digest(ledger: Path, fit_id: str) -> str:
    try:
        fits = json.loads(ledger.read_text(encoding="utf-8"))["fits"]
        (own,) = [f for f in fits if f["fit_id"] == fit_id]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def contents_of(path: Path) -> str | None:
    """Return the SHA-256 of a regular file's bytes; None if it cannot be read."""
    try:
        if not path.is_file():
            return None
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return None


def _line(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


@contextmanager
def held(results: Path) -> Iterator[None]:
    """Make the folder if it is not there, and keep other batches out of it while the block runs.

    Raises
    ------
    OutputError
        Another batch is at work there, the folder cannot be made, or it holds something else.
    """
    with _opened(results), locked(results):
        yield


def _opened(results: Path) -> BinaryIO:
    try:
        results.mkdir(parents=True, exist_ok=True)
        if not (results / "batch.lock").exists() and any(results.iterdir()):
            raise OutputError(
                f"{results} holds files that do not belong to a batch.", "Choose an empty folder with -o."
            )
        refuse_special(results / "batch.lock", OutputError)
        return (results / "batch.lock").open("ab")
    except OSError as error:
        raise OutputError(
            f"{results} cannot be written: {error.strerror or error}.", "Choose another folder with -o."
        ) from error
