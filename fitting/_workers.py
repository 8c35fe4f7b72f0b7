"""Parallel execution: a pool of worker processes, each with a single thread of linear algebra."""

from __future__ import annotations

import io
import os
import pickle
import signal
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context, parent_process
from threading import RLock, Thread
from typing import Any, Generic, Self, TypeVar

T = TypeVar("T")
Common = TypeVar("Common")
Item = TypeVar("Item")
_MOST_PROCESSES = 4
"""Largest number of worker processes [1]. Chosen: a smaller value makes searches slower, a larger one needs more memory
than the gain in time justifies."""


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread; a context manager that can also be used as a decorator.

    The matrices of a fit have a few hundred rows; several threads would be slower.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _nothing(common: object) -> tuple[object, ...]:  # noqa: ARG001
    return ()


@dataclass
class Task(Generic[T]):
    """A submitted call; it runs in the calling process if no worker completes it."""

    call: Callable[[], T]
    future: Future[T] | None

    def result(self) -> T:
        """Return the result of the call, or raise its exception."""
        try:
            return self.call() if self.future is None else self.future.result()
        except BrokenProcessPool:
            return self.call()


@dataclass
class WorkerPool:
    """A process pool (started with "spawn", entered with ``with``) that can fall back to serial execution.

    All calls run in the calling process if the pool is used without ``with``, if there is only one core, if no process
    can be started, or after a worker was killed. The workers end with the process that started them. By default their
    number is one less than the number of available cores, at most 4. Each worker begins with ``start(*arguments)``, a
    module-level function.
    """

    processes: int = field(default_factory=lambda: min(available_cores() - 1, _MOST_PROCESSES))
    start: Callable[..., object] | None = None
    arguments: tuple[Any, ...] = ()
    _executor: ProcessPoolExecutor | None = field(default=None, init=False)

    def __enter__(self) -> Self:
        if self.processes > 0:
            context, own = get_context("spawn"), (self.start, *self.arguments)
            try:
                self._executor = ProcessPoolExecutor(self.processes, context, _start_worker, own)
            except (OSError, ImportError):  # no semaphores: /dev/shm is missing or read-only
                return self
            self.submit(int)  # started now, so that the first worker imports its modules in the meantime
        return self

    def __exit__(self, fault: type[BaseException] | None, *_: object) -> None:
        executor, self._executor = self._executor, None
        if executor is None:
            return
        if fault is not None:  # an interrupt does not wait for work that is no longer needed
            for process in list((getattr(executor, "_processes", None) or {}).values()):
                process.terminate()
        executor.shutdown(cancel_futures=True)

    def submit(self, work: Callable[..., T], *args: Any) -> Task[T]:
        """Start ``work(*args)``, a module-level function with arguments that can be pickled."""
        return Task(lambda: work(*args), self.begin(work, *args))

    def map(
        self,
        work: Callable[[Common, Item], T],
        common: Common,
        items: Sequence[Item],
        shared: Callable[[Common], Sequence[object]] = _nothing,
    ) -> list[T]:
        """Return ``work(common, item)`` for each item; workers start with the first items, the caller with the last.

        ``shared(common)``, a module-level function, returns parts of `common`. The results that a worker sends back
        refer to these parts instead of containing copies.
        """
        waiting, futures, lock = deque(range(len(items))), dict[int, Future[bytes]](), RLock()

        def submit_next(previous: Future[bytes] | None = None) -> None:
            if previous is not None and (previous.cancelled() or previous.exception() is not None):
                return
            with lock:
                future = self.begin(_run, work, common, items[waiting[0]], shared) if waiting else None
                if future is not None:
                    futures[waiting.popleft()] = future
                    future.add_done_callback(submit_next)

        results: dict[int, T] = {}
        for _ in range(self.processes if self._executor is not None else 0):
            submit_next()
        while True:
            with lock:
                if not waiting:
                    break
                i = waiting.pop()
            results[i] = work(common, items[i])
        for i, future in futures.items():
            try:
                results[i] = _Unpickler(future.result(), shared(common)).load()
            except BrokenProcessPool:
                results[i] = work(common, items[i])
        return [results[i] for i in range(len(items))]

    def begin(self, work: Callable[..., T], *args: Any) -> Future[T] | None:
        """Start a call in a worker. The result is None if there is no worker, or after a worker was killed."""
        if self._executor is not None:
            try:
                return self._executor.submit(_unpacked, _packed(work, *args))
            except (OSError, RuntimeError):  # no process can be started, or the pool is broken or shut down
                self._executor.shutdown(wait=False)
                self._executor = None
        return None


class _Pickler(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, shared: Sequence[object]) -> None:
        super().__init__(stream, protocol=pickle.HIGHEST_PROTOCOL)
        self._index = {id(part): i for i, part in enumerate(shared)}

    def persistent_id(self, part: object) -> int | None:
        return self._index.get(id(part))


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes, shared: Sequence[object]) -> None:
        super().__init__(io.BytesIO(data))
        self._shared = shared

    def persistent_load(self, index: Any) -> object:
        return self._shared[index]


_ATTEMPTS = 20
"""Number of attempts to pickle a call whose arguments change in the meantime [1]. Chosen: a smaller number raises an
error while another thread fills a cache, a larger one delays a permanent error."""


def _packed(work: Callable[..., object], *args: object) -> bytes:
    """Return a pickled call.

    The executor would pickle the call in a separate thread. Meanwhile the calling thread may add a cached property to
    one of the arguments, and pickling ends with a RuntimeError. The same can happen if such a thread submits the next
    call.
    """
    for _ in range(_ATTEMPTS - 1):
        try:
            return pickle.dumps((work, args), protocol=pickle.HIGHEST_PROTOCOL)
        except RuntimeError:
            continue
    return pickle.dumps((work, args), protocol=pickle.HIGHEST_PROTOCOL)


def _unpacked(call: bytes) -> Any:
    work, args = pickle.loads(call)  # noqa: S301 - from the process that started this one
    return work(*args)


def _run(work: Any, common: Any, item: Any, shared: Any) -> bytes:
    stream = io.BytesIO()
    with single_blas_thread():
        _Pickler(stream, shared(common)).dump(work(common, item))
    return stream.getvalue()


def _start_worker(start: Callable[..., object] | None, *arguments: Any) -> None:
    # the filters of the program are set again, because this process does not inherit them
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the calling process, which ends the workers
    Thread(target=_end_with_parent, daemon=True).start()
    if start is not None:
        start(*arguments)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
