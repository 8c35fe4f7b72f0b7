"""Temporary folders. The folder of a killed process is removed by the next process that needs a folder."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

_PREFIX = "gyrotrack-work-"
_LOCK = "lock"


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield an empty folder for the duration of the context; an OSError is raised if no folder can be made."""
    root = Path(tempfile.gettempdir())
    with suppress(OSError):
        for path in root.glob(f"{_PREFIX}*"):
            _remove_if_left(path)
    folder = tempfile.TemporaryDirectory(prefix=_PREFIX, ignore_cleanup_errors=True)
    with folder as name, FileLock(Path(name) / _LOCK, thread_local=False):
        yield Path(name)


def _remove_if_left(path: Path) -> None:
    """Remove a folder of this user that no process uses."""
    found = path.lstat()
    own = not hasattr(os, "getuid") or found.st_uid == os.getuid()
    if not (
        own and stat.S_ISDIR(found.st_mode) and (path / _LOCK).exists()
    ):  # a folder without a lock may have just been made by another process
        return
    with suppress(Timeout, OSError), FileLock(path / _LOCK, timeout=0, thread_local=False):
        shutil.rmtree(path, ignore_errors=True)
