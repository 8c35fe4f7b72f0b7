"""Errors that mean a shortage of the machine: memory, processes, threads, open files.

Libraries report these in many ways: MemoryError, OSError with an errno, RuntimeError("can't start new thread"),
cv2.error, an ImportError from a shared library that could not be mapped, a process pool whose process died.
"""

from __future__ import annotations

import errno

_MEMORY = (
    "There is not enough memory.",
    "Close other programs, raise the memory limit, or process a shorter film.",
)
_PROCESSES = (
    "No further process or thread can be started.",
    "Raise the limit (`ulimit -u`), or close other programs.",
)
_FILES = ("No further file can be opened.", "Raise the limit (`ulimit -n`), or close other programs.")
_DISK = ("The disk is full or the quota is reached.", "Free some space and run the command again.")

_BY_NUMBER = {
    errno.ENOMEM: ("memory", *_MEMORY),
    errno.EAGAIN: ("processes", *_PROCESSES),
    errno.EMFILE: ("files", *_FILES),
    errno.ENFILE: ("files", *_FILES),
    errno.ENOSPC: ("disk", *_DISK),
    errno.EDQUOT: ("disk", *_DISK),
    errno.EFBIG: ("disk", *_DISK),
}
_BY_TEXT = (
    (
        ("can't start new thread", "can't create new thread", "pthread_create failed"),
        ("processes", *_PROCESSES),
    ),
    (("too many open files",), ("files", *_FILES)),
    (
        (
            "cannot allocate memory",
            "failed to map segment",
            "out of memory",
            "insufficient memory",
            "unable to allocate",
            "bad_alloc",
            "bad allocation",
            "memory allocation",
        ),
        ("memory", *_MEMORY),
    ),
    (
        ("process pool", "resource temporarily unavailable"),
        (
            "processes",
            "A second process could not be started or was ended by the system.",
            "Raise the limits of memory and processes (`ulimit -v`, `ulimit -u`).",
        ),
    ),
)


def scarce(error: BaseException | None) -> tuple[str, str, str] | None:
    """Return code, message and hint if an error, or one that caused it, means a shortage of the machine."""
    for _ in range(10):
        if error is None:
            return None
        if isinstance(error, MemoryError):
            return ("memory", *_MEMORY)
        if isinstance(error, OSError) and error.errno in _BY_NUMBER:
            return _BY_NUMBER[error.errno]
        text = f"{type(error).__name__} {error}".lower()
        for words, answer in _BY_TEXT:
            if any(word in text for word in words):
                return answer
        error = error.__cause__ or error.__context__
    return None
