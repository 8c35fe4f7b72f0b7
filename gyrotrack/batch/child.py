"""A process of our own that runs commands: what goes wrong in it, goes wrong in it alone.

It reads one JSON array of words a line and answers with one JSON object a line. When its input ends, as it does
when we are killed, it ends too, in the middle of its work.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import Any

from gyrotrack import __version__

WORKER = "gyrotrack.cli.worker"


class Child:
    """A worker process; it is started when it is first needed, and again after it died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    @property
    def pid(self) -> int | None:
        """The process's number, while there is one."""
        return self._process.pid if self._process is not None else None

    def run(self, words: Sequence[str], timeout: float | None = None) -> dict[str, Any]:
        """Run one command.

        Returns
        -------
        dict
            ``code``, the exit code, and ``document``, its JSON; a process that died or was too slow answers with
            an error document, its code "crash" or "timeout".
        """
        process = self._process
        if process is None or process.poll() is not None:
            process = self._process = _start()
        late = threading.Event()

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(timeout if timeout is not None else threading.TIMEOUT_MAX, stop)
        timer.daemon = True
        timer.start()
        try:
            line = _asked(process, words)
        finally:
            timer.cancel()
        if not line.endswith("\n"):
            self.close()
            if late.is_set():
                return _died(
                    "timeout", f"It was stopped after {timeout:g} s.", "Allow it more with --timeout."
                )
            return _crashed(process.returncode)
        answer: dict[str, Any] = json.loads(line)
        if answer.get("version") != __version__:
            return _died(
                "version",
                f"The worker runs gyrotrack {answer.get('version')}, not {__version__}.",
                "Install the same version everywhere.",
            )
        return answer

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    try:
                        stream.close()
                    except OSError:
                        continue
            process.wait()


def run_once(words: Sequence[str], timeout: float | None = None) -> dict[str, Any]:
    """Run one command in a process of its own; this is what a worker of a cluster is sent."""
    child = Child()
    try:
        return child.run(words, timeout)
    finally:
        child.close()


def _start() -> subprocess.Popen[str]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"}
    environment["GYROTRACK_CONFIG"] = "none"  # settings are among the words, wherever the process runs
    return subprocess.Popen(  # noqa: S603 - our own program, no shell
        [sys.executable, "-m", WORKER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        encoding="utf-8",
        env=environment,
        start_new_session=True,  # Ctrl-C is ours to handle
    )


def _asked(process: subprocess.Popen[str], words: Sequence[str]) -> str:
    """Return the line that the process answers, or nothing if it is gone."""
    assert process.stdin is not None  # noqa: S101
    assert process.stdout is not None  # noqa: S101
    try:
        process.stdin.write(json.dumps(list(words)) + "\n")
        process.stdin.flush()
        return process.stdout.readline()
    except (OSError, ValueError):  # ValueError: its pipes were closed by another thread just now
        return ""


def _crashed(code: int | None) -> dict[str, Any]:
    how = f"by signal {-code}" if code and code < 0 else f"with exit code {code}"
    return _died("crash", f"Its process ended {how}, without an answer.", "Is there enough memory?")


def _died(code: str, message: str, hint: str) -> dict[str, Any]:
    return {"code": 1, "document": {"error": {"code": code, "message": message, "hint": hint}}}
