"""A second process that draws some of the figures, where there is a second core."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from threading import Thread
from types import TracebackType
from typing import ParamSpec, Self, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Beside:
    """One process that comes up while something else is done, and then does what it is given.

    It is started afresh (spawn), so that nothing of this process is shared. What it was to do is done here if there
    is but one core, or if it dies.
    """

    def __init__(self, *, cores: int | None = None) -> None:
        self._pool: ProcessPoolExecutor | None = None
        if (cores or os.cpu_count() or 1) > 1:
            self._pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))

    def __enter__(self) -> Self:
        if self._pool is not None:
            self._pool.submit(_ready)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def begin(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Callable[[], T]:
        """Begin a piece of work, a function of a module with what can be pickled; return what waits for its result."""
        begun: Future[T] | None = None
        if self._pool is not None:
            try:
                begun = self._pool.submit(work, *args, **kwargs)
            except BrokenProcessPool:
                self._pool = None

        def result() -> T:
            if begun is not None:
                try:
                    return begun.result()
                except BrokenProcessPool:
                    pass
            return work(*args, **kwargs)

        return result


def _ready() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who presses Ctrl-C means the command; it ends this process
    Thread(target=_follow, daemon=True).start()
    import matplotlib.backends.backend_svg  # noqa: F401 - so that it is there when it is needed


def _follow() -> None:
    """End this process when the one that started it is gone, killed perhaps."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
