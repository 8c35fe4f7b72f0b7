"""Commands in separate processes, with progress, cancellation and a queue.

A job is one command with ``--json``; it reports progress as JSON lines on stderr (see `gyrotrack.apps.cli._output`) and
its document on stdout. A cancelled or killed `extract` keeps its checkpoint.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any, Literal

from gyrotrack._errors import UsageError
from gyrotrack.apps.batch._workers import end_process

State = Literal["waiting", "running", "done", "failed", "cancelled"]

_GRACE = 5.0  # time for a process to save its checkpoint and remove unfinished outputs [s]
_MAX_ANSWER = 2**26  # bytes


@dataclass
class Job:
    """One command."""

    words: tuple[str, ...]  # the arguments of ``python -m module``, by default of `gyrotrack`
    module: str = "gyrotrack"
    state: State = "waiting"  # state of the job
    # progress of the command
    label: str = ""
    done: int = 0
    total: int | None = None
    document: dict[str, Any] = field(default_factory=dict)  # its JSON document, or ``{"error": ...}``
    began: float = field(default_factory=monotonic)
    process: subprocess.Popen[str] | None = None

    @property
    def is_active(self) -> bool:
        """Whether the job is waiting or running."""
        return self.state in ("waiting", "running")

    def summary(self) -> dict[str, Any]:
        """Return the state for the page."""
        error = self.document.get("error") or {}
        return {
            "state": self.state,
            "label": self.label,
            "done": self.done,
            "total": self.total,
            "seconds": round(monotonic() - self.began, 1) if self.is_active else None,
            "message": " ".join(filter(None, (error.get("message"), error.get("hint")))),
        }


class Jobs:
    """The jobs of one work folder, at most `most` at a time, and one per key."""

    def __init__(self, folder: Path, most: int) -> None:
        self._folder = folder
        self._slots = threading.BoundedSemaphore(max(1, most))
        self._lock = threading.RLock()
        self._jobs: dict[str, Job] = {}
        self._threads: set[threading.Thread] = set()
        self._closed = False

    def get(self, key: str) -> Job | None:
        """Return the latest job of a key."""
        return self._jobs.get(key)

    def start(
        self,
        key: str,
        words: Sequence[str],
        finished: Callable[[Job], None],
        *,
        module: str = "gyrotrack",
        replace: bool = False,
    ) -> Job:
        """Queue a command.

        Parameters
        ----------
        key : str
            Identifies the step; if its job is active, an error is raised or, with `replace`, that job is cancelled.
        words : sequence of str
            Arguments.
        finished : callable
            Called in a separate thread when the job has ended.
        module : str
            Module to run.
        """
        with self._lock:
            old = self._jobs.get(key)
            if old is not None and old.is_active:
                if not replace:
                    raise UsageError(
                        "This step is already running.", "Wait until it has ended, or cancel it."
                    )
                self.cancel(key)
            if self._closed:
                raise UsageError("The workbench is closing.", "Start it again.")
            job = self._jobs[key] = Job(tuple(words), module)
            thread = threading.Thread(target=self._run, args=(job, finished), daemon=True)
            self._threads.add(thread)
            thread.start()
            return job

    def cancel(self, key: str) -> None:
        """Cancel the job of a key if it is active."""
        with self._lock:
            job = self._jobs.get(key)
            if job is None or not job.is_active:
                return
            job.state = "cancelled"
            process = job.process
        if process is not None:
            end_process(process)

    def _run(self, job: Job, finished: Callable[[Job], None]) -> None:
        try:
            with self._slots:
                with self._lock:
                    if job.state != "waiting" or self._closed:
                        job.state = "cancelled"
                    else:
                        job.state, job.began = "running", monotonic()
                        with suppress(OSError):
                            job.process = self._started(job)
                if job.process is not None:
                    self._follow(job, job.process)
                elif job.state == "running":
                    job.state = "failed"
                    job.document = _error("No process could be started.", "End other programs and try again.")
            finished(job)
        finally:
            self._threads.discard(threading.current_thread())

    def _started(self, job: Job) -> subprocess.Popen[str]:
        tail = ["--json"] if job.module == "gyrotrack" else []
        environment = {**os.environ, "GYROTRACK_PROGRESS": "json", "PYTHONUTF8": "1", "PYTHONSAFEPATH": "1"}
        return subprocess.Popen(  # noqa: S603 - gyrotrack itself, without a shell
            [sys.executable, "-P", "-m", job.module, *job.words[:1], *tail, *job.words[1:]],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=self._folder,
            text=True,
            encoding="utf-8",
            errors="replace",
            env=environment,
            start_new_session=True,  # Ctrl-C is handled by the server
        )

    def _follow(self, job: Job, process: subprocess.Popen[str]) -> None:
        """Read the progress and the document of a process until it ends."""
        assert process.stdout is not None and process.stderr is not None  # noqa: S101, PT018 - opened as pipes
        progress = threading.Thread(target=_listen, args=(job, process.stderr), daemon=True)
        progress.start()
        answer = process.stdout.read(_MAX_ANSWER)
        process.wait()
        progress.join(_GRACE)
        process.stdout.close()
        process.stderr.close()
        with self._lock:
            job.process = None
            if job.state == "cancelled":
                return
            try:
                job.document = dict(json.loads(answer))
            except (ValueError, TypeError):
                job.document = _error(f"The process ended with code {process.returncode}.", "Run it again.")
            job.state = "failed" if "error" in job.document else "done"

    def close(self) -> None:
        """End all processes and wait for them."""
        with self._lock:
            self._closed = True
            active = [job for job in self._jobs.values() if job.is_active]
            for job in active:
                job.state = "cancelled"
                if job.process is not None and job.process.poll() is None:
                    with suppress(OSError):
                        job.process.terminate()
        for job in active:
            if job.process is not None:
                end_process(job.process)
        for thread in list(self._threads):
            thread.join(_GRACE)


def _listen(job: Job, stream: Any) -> None:
    with suppress(ValueError, OSError):  # the stream is closed
        for line in stream:
            if line.startswith('{"progress"'):
                with suppress(ValueError, KeyError, TypeError):
                    found = json.loads(line)["progress"]
                    job.label, job.done, job.total = found["label"], found["done"], found["total"]


def _error(message: str, hint: str) -> dict[str, Any]:
    return {"error": {"code": "process", "message": message, "hint": hint}}
