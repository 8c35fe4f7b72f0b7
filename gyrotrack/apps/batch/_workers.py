"""Worker processes and Dask workers.

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
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

from gyrotrack._errors import GyrotrackError, UsageError
from gyrotrack._versions import __version__

WORKER = "gyrotrack.apps.cli._worker_process"


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


Answer = dict[str, Any]


class Workers(Protocol):
    """Runs commands, several at a time."""

    def submit(self, words: Sequence[str], timeout: float | None) -> Future[Answer]:
        """Begin a command; the answer is that of `Child.run`."""

    def close(self) -> None:
        """End at once, with whatever still runs."""


class LocalWorkers:
    """Processes on this machine, each of which runs one command after another.

    Parameters
    ----------
    count : int
        How many.
    """

    def __init__(self, count: int) -> None:
        self._own = threading.local()
        self._children: list[Child] = []
        self._pool = ThreadPoolExecutor(count, thread_name_prefix="batch")

    def submit(self, words: Sequence[str], timeout: float | None) -> Future[Answer]:
        """Begin a command."""
        return self._pool.submit(self._run, list(words), timeout)

    def _run(self, words: list[str], timeout: float | None) -> Answer:
        if not hasattr(self._own, "child"):
            self._own.child = Child()
            self._children.append(self._own.child)
        answer: Answer = self._own.child.run(words, timeout)
        return answer

    def close(self) -> None:
        """Kill the processes; their outputs are whole or not there."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        for child in self._children:
            child.close()
        self._pool.shutdown()


class ClusterWorkers:
    """The workers of a Dask cluster, which must see the same folders as we do.

    Each command runs in a process of its own on a worker, so that a film that breaks it does not break the worker;
    when a worker is lost, the scheduler gives its commands to another.

    Parameters
    ----------
    address : str
        The scheduler's address.

    Raises
    ------
    UsageError
        Dask is not installed.
    GyrotrackError
        The scheduler does not answer.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise UsageError(
                "A cluster needs dask.distributed, which is not installed.",
                'Install it: pip install "gyrotrack[cluster]"',
            ) from None
        try:
            client: Any = Client(address, timeout="20s", set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, ValueError, TimeoutError) as error:
            raise GyrotrackError(
                f"The scheduler at {address[:80]} does not answer.", "Start it, and check the address."
            ) from error
        self._client = client
        self._executor = client.get_executor(pure=False)

    def submit(self, words: Sequence[str], timeout: float | None) -> Future[Answer]:
        """Begin a command."""
        future: Future[Answer] = self._executor.submit(run_once, list(words), timeout)
        return future

    def close(self) -> None:
        """Leave the cluster; what nobody waits for any more is not begun."""
        self._executor.shutdown(wait=False)
        self._client.close()


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1
