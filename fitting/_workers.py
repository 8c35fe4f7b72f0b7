"""Worker processes for independent pieces of a computation."""

from __future__ import annotations

import io
import os
import pickle
import signal
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from threading import RLock, Thread
from types import TracebackType
from typing import Any, ParamSpec, Self, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
Common = TypeVar("Common")
Item = TypeVar("Item")
# what of the common part a result may refer to, so that it does not come back as a copy
Kept = Callable[[Common], Sequence[object]]


def _nothing(common: object) -> tuple[object, ...]:  # noqa: ARG001
    return ()


class Beside:
    """One process that comes up while something else is done, and then does what it is given.

    It is started afresh (spawn), so that nothing of this process is shared. What it was to do is done here if there
    is but one core, or if it dies. Without ``with`` nothing is started, and all is done here.
    """

    def __init__(self, *, cores: int | None = None) -> None:
        self._cores = cores or _cores()
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        if self._cores > 1:
            self._pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
            self._pool.submit(_ready)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        # nothing more is handed over while what is begun comes to its end
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(cancel_futures=True)

    def begin(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Callable[[], T]:
        """Begin a piece of work, a function of a module with what can be pickled; return what waits for its result."""
        begun = self._submit(work, *args, **kwargs)

        def result() -> T:
            if begun is not None:
                try:
                    return begun.result()
                except BrokenProcessPool:
                    pass
            return work(*args, **kwargs)

        return result

    def each(
        self,
        work: Callable[[Common, Item], T],
        common: Common,
        items: Sequence[Item],
        kept: Kept[Common] = _nothing,
    ) -> list[T]:
        """Return ``work(common, item)`` of each item.

        The other process begins with the first item and this one with the last, until they meet.

        Parameters
        ----------
        work : callable
            A function of a module.
        common : object
            What it needs every time.
        items : sequence
            What it needs once each.
        kept : callable, optional
            Tells the parts of `common` to which the results shall refer rather than hold copies of them.
        """
        left, begun, lock = deque(range(len(items))), dict[int, Future[bytes]](), RLock()

        def hand_over(before: Future[bytes] | None = None) -> None:
            if before is not None and (before.cancelled() or before.exception() is not None):
                return
            with lock:
                waiting = self._submit(_there, work, common, items[left[0]], kept) if left else None
                if waiting is not None:
                    begun[left.popleft()] = waiting
                    waiting.add_done_callback(hand_over)

        hand_over()
        found: dict[int, T] = {}
        while True:
            with lock:
                if not left:
                    break
                i = left.pop()
            found[i] = work(common, items[i])
        for i, waiting in begun.items():
            try:
                found[i] = _Reader(waiting.result(), kept(common)).load()
            except BrokenProcessPool:
                found[i] = work(common, items[i])
        return [found[i] for i in range(len(items))]

    def _submit(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T] | None:
        pool = self._pool
        if pool is not None:
            try:
                return pool.submit(work, *args, **kwargs)
            except RuntimeError:  # it died, or is being closed
                self._pool = None
        return None


class _Writer(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, kept: Sequence[object]) -> None:
        super().__init__(stream, protocol=pickle.HIGHEST_PROTOCOL)
        self._places = {id(part): i for i, part in enumerate(kept)}

    def persistent_id(self, part: object) -> int | None:
        return self._places.get(id(part))


class _Reader(pickle.Unpickler):
    def __init__(self, data: bytes, kept: Sequence[object]) -> None:
        super().__init__(io.BytesIO(data))
        self._kept = kept

    def persistent_load(self, place: Any) -> object:
        return self._kept[place]


def _there(work: Callable[[Common, Item], object], common: Common, item: Item, kept: Kept[Common]) -> bytes:
    stream = io.BytesIO()
    _Writer(stream, kept(common)).dump(work(common, item))
    return stream.getvalue()


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _ready() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who presses Ctrl-C means the command; it ends this process
    Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    """End this process when the one that started it is gone, killed perhaps."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
