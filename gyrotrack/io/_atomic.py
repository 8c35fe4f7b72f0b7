"""Output that is safe against kills and full disks: atomic writing of files, locks, and checkpoints of long runs.

The module `fitting._files`, which both packages use, describes how files are written and locked.

Auxiliary files next to an output are opened without following links and have a header. A file without this header was
not made by this package and is not changed.

A checkpoint is an append-only log from which a killed run resumes::

    line            "gyrotrack journal 1" and a line feed
    record          length (8 bytes), CRC-32 (4 bytes), content       little endian
    content         length of the manifest (4 bytes), manifest, arrays

The manifest is JSON: the metadata of the record ("facts"), and name, type and shape of each array. The bytes of the
arrays follow in the same order. The first record identifies the run. A truncated record has a wrong checksum; it is
dropped with all later records. HDF5 is not used because a kill can make an HDF5 file unreadable.
"""

from __future__ import annotations

import json
import math
import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
import numpy.typing as npt

from fitting._files import LOCK_LINE, LOCK_SIZE, LOCK_TIMEOUT, Files, flush, lock_file, new_part, publish
from gyrotrack._errors import DatasetError, GyrotrackError, OutputError
from gyrotrack.io._command_end import marks

_FILES = Files(OutputError)
open_side_file, foreign, refusal, busy = _FILES.open_side_file, _FILES.foreign, _FILES.refusal, _FILES.busy


@contextmanager
def locked(path: Path, timeout: float | None = None) -> Iterator[Path]:
    """Hold the lock of `path`; see `fitting._files.Files.locked`."""
    with _FILES.locked(path, LOCK_TIMEOUT if timeout is None else timeout) as own:
        yield own


def remove_remains(folder: Path) -> None:
    """Remove the unfinished files that a killed program has left in a folder."""
    for own in folder.glob(".*.lock"):
        with suppress(OSError, OutputError):
            with open_side_file(own) as stream:
                content = stream.read(LOCK_SIZE)
            if not content or content.startswith(LOCK_LINE):
                with locked(own.with_name(own.name.removeprefix(".").removesuffix(".lock")), 0.0):
                    pass


def refuse_special(path: Path, error: type[GyrotrackError] = DatasetError) -> None:
    """Raise `error` if `path` is a pipe, socket, device or folder; opening it could block for ever."""
    Files(error).refuse_special(Path(path))


def refuse_existing(path: Path, *, force: bool, reads: Iterable[Path | None] = ()) -> None:
    """Raise `OutputError` if `path` is not a regular file, has no folder, or exists and `force` is not set.

    The output of a command that was killed before its end may be replaced. Files that the command `reads` are never
    replaced, even with `force` or under another name.
    """
    refuse_special(path, OutputError)
    if not path.parent.is_dir():
        raise OutputError(f"The folder {path.parent} does not exist.", "Create it, or choose another folder.")
    for source in reads:
        with suppress(OSError):
            if source is not None and path.samefile(source):
                raise OutputError(f"{path} is an input of this command.", "Give another name to the output.")
    if not force and (path.exists() or path.is_symlink()) and not is_left(path):
        raise OutputError(f"{path} already exists.", "Use --force to replace it, or -o for another name.")


@contextmanager
def new_path(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield the path of an empty temporary file, and move it to `path` when the context ends without an error."""
    path = Path(path)
    refuse_existing(path, force=force)
    part = new_part(path)
    try:
        with locked(path, 0.0) as lock:
            _FILES.name_in_lock(part, lock)
            part.open("xb").close()
            own = part.stat().st_ino
            try:
                yield part
                _publish(part, path, own, force=force)
            except BaseException:
                with suppress(OSError):
                    if part.stat().st_ino == own:
                        part.unlink()
                raise
    except OSError as error:
        raise refusal(path, error) from error


def _publish(part: Path, path: Path, own: int, *, force: bool) -> None:
    try:
        if part.stat().st_ino != own:
            raise busy(path)
    except FileNotFoundError:
        what = f"{path} cannot be written: its folder or drive was removed."
        raise OutputError(what, "Reconnect the drive and run the command again.") from None
    flush(part)
    refuse_existing(path, force=force)
    mark_new(path, part)
    publish(part, path)


_MARKED = {"command": "outputs"}


def mark_new(path: Path, content: Path) -> None:
    """Mark `path`, which does not exist yet, as an output of the running command.

    `content` is the file that is, or becomes, `path`.
    """
    held = marks()
    if held is None:
        return
    if path.absolute() not in held:
        if path.exists() and path != content and not _mark_path(path).exists():
            return
        held[path.absolute()] = CheckpointFile(_marked(path), _MARKED, resume=True, wait=0.0)
    mark = held[path.absolute()]
    if isinstance(mark, CheckpointFile):
        mark.append(_identity(path, content.stat()), {})


def is_left(path: Path) -> bool:
    """Return whether `path` is an unchanged output of a command that was killed before its end."""
    held = marks()
    if held is not None and path.absolute() in held:
        return False
    if not _mark_path(path).exists():
        # the command may have been killed between its last two steps
        if lock_file(_mark_path(path)).exists():
            with suppress(OutputError, OSError), locked(_mark_path(path), 0.0):
                pass
        return False
    with (
        suppress(OutputError, OSError),
        CheckpointFile(_marked(path), _MARKED, resume=True, wait=0.0) as mark,
    ):
        if _identity(path, path.stat()) in [record.facts for record in mark.records()]:
            return True
        mark.discard()
    return False


def _marked(path: Path) -> Path:
    return path.with_name(f"{path.name}.outputs")


def _mark_path(path: Path) -> Path:
    return checkpoint_path(_marked(path))


def _identity(path: Path, status: os.stat_result) -> dict[str, Any]:
    """Return the properties that distinguish a file from a later file of the same name."""
    return {"name": path.name, "ino": status.st_ino, "size": status.st_size, "mtime_ns": status.st_mtime_ns}


@contextmanager
def new_file(path: Path, *, force: bool = False) -> Iterator[BinaryIO]:
    """Yield a binary stream, and move its content to `path` when the context ends without an error (see `new_path`)."""
    with new_path(path, force=force) as part, part.open("r+b") as stream:
        yield stream


Arrays = dict[str, npt.NDArray[Any]]

SUFFIX = ".unfinished"
_LINE = b"gyrotrack journal 1\n"
_HEAD = struct.Struct("<QI")
_SIZE = struct.Struct("<I")
_TYPES = frozenset({"<f8", "<f4", "<i8", "<i4", "<i2", "<u2", "|u1", "|i1", "|b1"})
_MAX_RECORD = 1 << 31


@dataclass(frozen=True)
class Record:
    """One record: metadata of JSON types, and arrays by name."""

    facts: dict[str, Any]
    arrays: Arrays


def checkpoint_path(output: Path) -> Path:
    """Return the path of the checkpoint of an output."""
    return output.with_name(output.name + SUFFIX)


def written_records(path: Path) -> list[Record]:
    """Return the complete records of a checkpoint that another process may be writing; none if it cannot be read."""
    found: list[Record] = []
    with suppress(OSError, *_CORRUPT), open_side_file(path, os.O_RDONLY) as stream:
        if stream.read(len(_LINE)) != _LINE:
            return []
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            length, check = _HEAD.unpack(head)
            content = stream.read(length) if _SIZE.size <= length <= _MAX_RECORD else b""
            if len(content) != length or zlib.crc32(content) != check:
                break
            found.append(_unpacked(content))
    return found[1:]  # the first record identifies the run


class CheckpointFile:
    """The checkpoint of one run, in the folder of its output, locked against a second writer while it is open.

    `facts` identify the run: film, settings, version. With `resume`, an existing checkpoint with equal facts is
    continued. Otherwise a new checkpoint is started, and `other` states whether the checkpoint of another run was
    replaced. An OutputError is raised if another program writes the same output for longer than `wait` [s], or the
    write fails.
    """

    def __init__(
        self, output: Path, facts: Mapping[str, Any], *, resume: bool = False, wait: float | None = None
    ) -> None:
        self.path = checkpoint_path(Path(output))
        self.facts: dict[str, Any] = json.loads(json.dumps(dict(facts)))
        self.other = False
        self._ends: list[int] = []
        with ExitStack() as stack:
            stack.enter_context(locked(self.path, wait))
            try:
                self._stream = stack.enter_context(open_side_file(self.path, os.O_RDWR | os.O_CREAT))
                head = self._stream.read(len(_LINE))
                if not _LINE.startswith(head):  # a killed run may have written a part of the line
                    raise foreign(self.path)
                if not (resume and self._restore()):
                    self._start()
            except OSError as error:
                raise refusal(self.path, error) from error
            self._open = stack.pop_all()

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file; remove it if it has no records, or after an error of the input."""
        unusable = isinstance(value, GyrotrackError) and not isinstance(value, OutputError)
        if not len(self) or unusable:
            self.discard()
        self.close()

    def append(self, facts: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add a record and flush it."""
        try:
            self._stream.seek(self._ends[-1])
            self._stream.write(_packed(facts, arrays))
            self._stream.flush()
        except OSError as error:
            raise refusal(self.path, error) from error
        self._ends.append(self._stream.tell())

    def records(self) -> Iterator[Record]:
        """Yield the records in order."""
        for index in range(len(self)):
            yield self.record(index)

    def record(self, index: int) -> Record:
        """Read one of the records."""
        start, end = self._ends[index : index + 2]
        self._stream.seek(start + _HEAD.size)
        return _unpacked(self._stream.read(end - start - _HEAD.size))

    def restart(self) -> None:
        """Drop all records."""
        self._start()

    def close(self) -> None:
        """Close the file and release its lock."""
        self._open.close()

    def discard(self) -> None:
        """Remove the checkpoint of a finished run."""
        with suppress(OSError):
            if self.path.stat().st_ino == os.fstat(self._stream.fileno()).st_ino:
                self.path.unlink()

    def _start(self) -> None:
        self._stream.seek(0)
        self._stream.truncate()
        self._stream.write(_LINE + _packed(self.facts, {}))
        self._stream.flush()
        self._ends = [self._stream.tell()]

    def _restore(self) -> bool:
        """Find the complete records of an earlier run; False if there are none, or if they belong to another run."""
        ends: list[int] = []
        first: Record | None = None
        self._stream.seek(len(_LINE))
        with suppress(*_CORRUPT):
            while (content := self._next()) is not None:
                record = _unpacked(content)
                first = first or record
                ends.append(self._stream.tell())
        if first is None or first.facts != self.facts:
            self.other = os.fstat(self._stream.fileno()).st_size > 0
            return False
        self._stream.seek(ends[-1])
        self._stream.truncate()
        self._ends = ends
        return True

    def _next(self) -> bytes | None:
        head = self._stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return None
        length, check = _HEAD.unpack(head)
        if not _SIZE.size <= length <= _MAX_RECORD:
            return None
        content = self._stream.read(length)
        return content if len(content) == length and zlib.crc32(content) == check else None


def _packed(facts: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    plain = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    table = [[name, array.dtype.str, list(array.shape)] for name, array in plain.items()]
    manifest = json.dumps({"facts": dict(facts), "arrays": table}).encode()
    parts = [_SIZE.pack(len(manifest)), manifest, *(array.tobytes() for array in plain.values())]
    content = b"".join(parts)
    return _HEAD.pack(len(content), zlib.crc32(content)) + content


# a record with a valid checksum that was not written by this program
_CORRUPT = (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError, struct.error)


def _unpacked(content: bytes) -> Record:
    """Return the record in a content; raise one of `_CORRUPT` if the content is malformed."""
    (size,) = _SIZE.unpack_from(content)
    manifest = json.loads(content[_SIZE.size : _SIZE.size + size])
    if not isinstance(manifest["facts"], dict):
        raise TypeError
    place, arrays = _SIZE.size + size, {}
    for name, kind, shape in manifest["arrays"]:
        if kind not in _TYPES or any(n < 0 for n in shape):
            raise ValueError(name)
        count = math.prod(shape)
        arrays[name] = np.frombuffer(content, kind, count, place).reshape(shape)
        place += arrays[name].nbytes
    return Record(manifest["facts"], arrays)
