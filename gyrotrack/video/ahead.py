"""Decoding ahead: a thread of its own decodes the next frames while the last ones are measured."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from queue import Empty, Full, Queue
from typing import Generic, TypeVar

T = TypeVar("T")

CHUNK = 8
"""Frames that are handed over at a time: waking a thread for each one would cost more than its decoding."""
WAITING = 2
"""Chunks that wait at most."""
_PATIENCE = 0.05


class Ahead(Generic[T]):
    """An iterator that is run in a thread of its own, a few items ahead of who uses it.

    Parameters
    ----------
    source : iterator
        Touched by that thread alone until `close`; an error in it is raised where the item would have come.
    chunk : int
        Items handed over at a time.

    Examples
    --------
    >>> list(Ahead(iter(range(20))))[-1]
    19
    """

    def __init__(self, source: Iterator[T], chunk: int = CHUNK) -> None:
        self._source = source
        self._chunk = chunk
        self._queue: Queue[tuple[list[T], bool, BaseException | None]] = Queue(WAITING)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, name="decoding", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[T]:
        last = False
        while not last:
            try:
                items, last, error = self._queue.get(timeout=_PATIENCE)
            except Empty:
                continue
            yield from items
            if error is not None:
                raise error

    def close(self) -> None:
        """End the thread; what it has done ahead is dropped."""
        self._closed.set()
        while self._thread.is_alive():
            try:
                self._queue.get(timeout=_PATIENCE)
            except Empty:
                continue

    def _work(self) -> None:
        items: list[T] = []
        error: BaseException | None = None
        try:
            for item in self._source:
                items.append(item)
                if len(items) == self._chunk:
                    self._hand_over(items, last=False)
                    items = []
                if self._closed.is_set():
                    return
        except BaseException as raised:
            error = raised
        self._hand_over(items, last=True, error=error)

    def _hand_over(self, items: list[T], *, last: bool, error: BaseException | None = None) -> None:
        while not self._closed.is_set():
            try:
                self._queue.put((items, last, error), timeout=_PATIENCE)
            except Full:
                continue
            return
