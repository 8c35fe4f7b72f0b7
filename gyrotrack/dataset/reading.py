"""Opening a file that somebody else may have made: every refusal is one clear sentence.

No link is followed out of the file, no number is taken from another file, and no array is allocated that the
stored bytes could not fill.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from gyrotrack.dataset import layout
from gyrotrack.dataset.case import load_case
from gyrotrack.dataset.guard import guarded
from gyrotrack.dataset.heap import has_endless_heap
from gyrotrack.dataset.recording import load_json, load_recording
from gyrotrack.dataset.records import Case, Recording
from gyrotrack.dataset.seal import is_broken
from gyrotrack.dataset.tables import attribute
from gyrotrack.errors import DatasetError

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MAKE_AGAIN = "Make it again with `gyrotrack extract`, `sync` or `import`."


def read_kind(path: Path) -> str:
    """Return "recording" or "case".

    Raises
    ------
    DatasetError
        The file is missing, not HDF5, damaged, of another format, or newer than this program.
    """
    with open_dataset(path) as file:
        return attribute(file, "kind", str)  # type: ignore[no-any-return]


def read_settings(path: Path) -> dict[str, Any]:
    """Return what shaped the content of a file, as it was asked for.

    Raises
    ------
    DatasetError
        As for `read_kind`.
    """
    with open_dataset(path) as file:
        return dict(load_json(file, "settings", {}))


def read_recording(path: Path) -> Recording:
    """Read what `extract` wrote.

    Raises
    ------
    DatasetError
        As for `read_kind`, or the file is a case.
    """
    with open_dataset(path, layout.RECORDING) as file:
        return load_recording(file)


def read_case(path: Path) -> Case:
    """Read what `sync` or `import` wrote.

    Raises
    ------
    DatasetError
        As for `read_kind`, or the file is a recording.
    """
    with open_dataset(path, layout.CASE) as file:
        return load_case(file)


@contextmanager
def open_dataset(path: Path, kind: str | None = None) -> Iterator[Any]:
    """Open a file of this format for reading, after checking what it is.

    Whatever HDF5 finds wrong inside the block becomes a `DatasetError`.
    """
    path = Path(path)
    _check_signature(path)
    if is_broken(path):
        raise DatasetError(f"{path} is damaged: its checksum is not that of its contents.", _MAKE_AGAIN)
    if has_endless_heap(path):
        raise DatasetError(f"{path} is damaged: its texts run in circles.", _MAKE_AGAIN)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if "unable to lock" in str(error):
            message, hint = f"{path} is being written by another process.", "Wait until it is done."
        else:
            message, hint = f"{path} is damaged or cut short.", _MAKE_AGAIN
        raise DatasetError(message, hint) from error
    try:
        with file:
            _check_root(file, path, kind)
            guarded(file)
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, UnicodeError, MemoryError) as error:
        raise DatasetError(f"{path} is damaged: {_first_line(error)}.", _MAKE_AGAIN) from error


def _check_signature(path: Path) -> None:
    try:
        with path.open("rb") as stream:
            head = stream.read(len(_SIGNATURE))
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}.", "Give the name of a file.") from error
    if not head:
        raise DatasetError(f"{path} is empty.", _MAKE_AGAIN)
    if head != _SIGNATURE:
        raise DatasetError(
            f"{path} is not an HDF5 file.",
            "Tables go through `gyrotrack import`, films through `gyrotrack extract`.",
        )


def _check_root(file: Any, path: Path, kind: str | None) -> None:
    if attribute(file, "format", str, "?") != layout.FORMAT:
        raise DatasetError(
            f"{path} is an HDF5 file, but not one of gyrotrack.", "Its attribute 'format' is missing."
        )
    version = attribute(file, "format_version", str)
    major = version.partition(".")[0]
    if not major.isdecimal():
        raise DatasetError(f"{path} has no valid format version ({version!r}).", _MAKE_AGAIN)
    if int(major) < 1:
        raise DatasetError(
            f"{path} has the layout {version}, from before the first that is read (1.0).", _MAKE_AGAIN
        )
    if int(major) > int(layout.FORMAT_VERSION.partition(".")[0]):
        raise DatasetError(
            f"{path} has the layout {version}, newer than {layout.FORMAT_VERSION} that this program knows.",
            "Update gyrotrack.",
        )
    found = attribute(file, "kind", str)
    if found not in {layout.RECORDING, layout.CASE} or (kind is not None and found != kind):
        wanted = kind or "recording or case"
        hint = {layout.CASE: "Make a case with `gyrotrack sync` or `gyrotrack import`."}.get(
            wanted, "Make a recording with `gyrotrack extract`."
        )
        raise DatasetError(f"{path} is a {found}, not a {wanted}.", hint)


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or ["it cannot be read"])[0].rstrip(".")[:120]
