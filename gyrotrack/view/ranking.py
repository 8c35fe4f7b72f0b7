"""Looking for what is missing takes seconds: a process of its own does it, so that the page stays quick."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from threading import Lock
from typing import Any

from gyrotrack.errors import GyrotrackError


class Ranker:
    """A process that ranks candidates for the latest model asked for.

    Parameters
    ----------
    case : Path
        The case file.
    """

    def __init__(self, case: Path) -> None:
        self._case = case
        self._lock = Lock()
        self._process: subprocess.Popen[str] | None = None
        self._busy = False
        self._closed = False

    def rank(self, model: dict[str, Any]) -> dict[str, Any]:
        """Return the diagnosis of a model; a question that is still being answered is given up.

        Raises
        ------
        GyrotrackError
            If it was given up for a newer one, or the process failed.
        """
        with self._lock:
            if self._busy:
                self._end()
            process = self._started()
            self._busy = True
        try:
            assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018 - asked for as pipes
            process.stdin.write(json.dumps(model) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except (OSError, ValueError):
            line = ""
        with self._lock:
            newest = process is self._process
            if newest:
                self._busy = False
        if not line:
            raise GyrotrackError(
                "The search was given up for a newer one." if not newest else "The search failed."
            )
        return dict(json.loads(line))

    def _started(self) -> subprocess.Popen[str]:
        if self._closed:
            raise GyrotrackError("The workbench is closing.")
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(  # noqa: S603 - our own program, no shell
                [sys.executable, "-m", "gyrotrack.view.search", str(self._case)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process, self._busy = None, False

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._closed = True
            self._end()
