"""One batch at a time in a folder of results."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from gyrotrack.dataset.locking import lock
from gyrotrack.errors import OutputError


@contextmanager
def held(results: Path) -> Iterator[None]:
    """Make the folder if it is not there, and keep other batches out of it while the block runs.

    Raises
    ------
    OutputError
        Another batch is at work there, the folder cannot be made, or it holds something else.
    """
    with _opened(results) as stream:
        lock(stream, results)
        yield


def _opened(results: Path) -> BinaryIO:
    try:
        results.mkdir(parents=True, exist_ok=True)
        if not (results / "batch.lock").exists() and any(results.iterdir()):
            raise OutputError(
                f"{results} holds something that is not of a batch.", "Choose an empty folder with -o."
            )
        return (results / "batch.lock").open("ab")
    except OSError as error:
        raise OutputError(
            f"{results} cannot be written: {error.strerror or error}.", "Choose another folder with -o."
        ) from error
