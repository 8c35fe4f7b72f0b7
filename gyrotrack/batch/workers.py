"""Where steps run: processes on this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

from gyrotrack.batch.child import Child, run_once
from gyrotrack.errors import GyrotrackError, UsageError

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
