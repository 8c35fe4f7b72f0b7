"""Output that survives a kill or a full disk: atomic writing of files, locks, and checkpoints of long runs.

An output is written to ``<name>.part`` in the same folder, flushed to the disk, and moved over the target. After a
kill, an interrupt, or with a full disk, the old file is unchanged. The lock of a file is in the temporary folder of
the system, so that no lock file remains next to the data.

A checkpoint is a file from which a killed run resumes, an append-only log::

    line            "gyrotrack journal 1" and a line feed
    record          length (8 bytes), CRC-32 (4 bytes), content       little endian
    content         length of the manifest (4 bytes), manifest, arrays

The manifest is JSON: the metadata of the record ("facts"), and name, type and shape of its arrays, whose bytes follow
in that order. The first record identifies the run. A truncated record fails its checksum and is dropped with all that
follow. HDF5 is not used because a kill can make an HDF5 file unreadable.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import struct
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
import numpy.typing as npt
from filelock import FileLock, Timeout

from gyrotrack._errors import DatasetError, GyrotrackError, OutputError

LOCK_TIMEOUT = 10.0  # longest time to wait for a lock [s]


@contextmanager
def locked(path: Path, timeout: float | None = None) -> Iterator[None]:
    """Hold the lock of `path`, which need not exist, against other processes; an OutputError after `timeout` [s]."""
    timeout = LOCK_TIMEOUT if timeout is None else timeout
    with ExitStack() as stack:
        try:
            stack.enter_context(_lock_of(path).acquire(timeout=timeout, poll_interval=0.02))
        except (Timeout, RuntimeError) as error:
            raise busy(path, timeout) from error
        except (OSError, NotImplementedError):
            pass
        yield


def _lock_of(path: Path) -> FileLock:
    """Return the lock of a path, in a folder of this user in the temporary folder of the system."""
    user = getattr(os, "getuid", lambda: "")()
    folder = Path(tempfile.gettempdir()) / f"gyrotrack-locks-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or (user != "" and found.st_uid != user):
        raise PermissionError(f"{folder} belongs to another user")
    name = os.fsencode(Path(path).parent.resolve() / Path(path).name)
    return FileLock(folder / f"{hashlib.sha256(name).hexdigest()[:32]}.lock", thread_local=False)


def busy(path: Path, waited: float = 0.0) -> OutputError:
    """Return the error for a file that another program has locked."""
    after = f"; waited {waited:g} s" if waited else ""
    return OutputError(
        f"{path} is locked by another program{after}.",
        "Run the command again when the other program has finished, or write to another name.",
    )


def refusal(path: Path, error: OSError) -> OutputError:
    """Return the error for a failed write, with its reason."""
    reason, hint = error.strerror or str(error), "Check the folder and its permissions."
    if error.errno in {errno.ENOSPC, errno.EDQUOT}:
        reason, hint = "the disk is full", "Free some space, or use another disk."
    elif error.errno == errno.EFBIG:
        reason, hint = "the file size limit is reached", "Raise the limit (ulimit -f)."
    return OutputError(f"{path} cannot be written: {reason}.", hint)


_SPECIAL = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISDIR, "a folder"),
)


def refuse_special(path: Path, error: type[GyrotrackError] = DatasetError) -> None:
    """Raise `error` if `path` is a pipe, socket, device or folder; opening it could block for ever."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return
    what = next((word for test, word in _SPECIAL if test(mode)), None)
    if what is not None:
        raise error(f"{path} is {what}, not a regular file.", "Give the name of a file.")


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise `OutputError` if `path` is not a regular file, has no folder, or exists and `force` is not set."""
    refuse_special(path, OutputError)
    if not path.parent.is_dir():
        raise OutputError(f"The folder {path.parent} does not exist.", "Create it, or choose another folder.")
    if not force and (path.exists() or path.is_symlink()):
        raise OutputError(f"{path} already exists.", "Use --force to replace it, or -o for another name.")


@contextmanager
def new_path(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield the path of an empty temporary file, and move it to `path` when the context ends without an error."""
    path = Path(path)
    refuse_existing(path, force=force)
    part = path.with_name(path.name + ".part")
    try:
        with locked(path, 0.0):
            refuse_special(part, OutputError)
            part.unlink(missing_ok=True)  # remains of a killed process
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
    with part.open("rb+") as stream:
        os.fsync(stream.fileno())
    refuse_existing(path, force=force)
    part.replace(path)
    with suppress(OSError):  # makes the rename durable, if supported
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def new_file(path: Path, *, force: bool = False) -> Iterator[BinaryIO]:
    """Yield a binary stream, and move its content to `path` when the context ends without an error, as `new_path`."""
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


class CheckpointFile:
    """The checkpoint of one run, in the folder of its output, locked against a second writer while it is open.

    `facts` identify the run: film, settings, version. With `resume` an existing checkpoint of equal facts is continued;
    otherwise a new one is started, and `other` says whether one of another run was replaced. An OutputError is raised
    if another program writes the same output, or the write fails.
    """

    def __init__(self, output: Path, facts: Mapping[str, Any], *, resume: bool = False) -> None:
        self.path = checkpoint_path(Path(output))
        self.facts: dict[str, Any] = json.loads(json.dumps(dict(facts)))
        self.other = False
        self._ends: list[int] = []
        refuse_special(self.path, OutputError)
        with ExitStack() as stack:
            stack.enter_context(locked(self.path))
            try:
                handle = os.open(self.path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
                self._stream = stack.enter_context(os.fdopen(handle, "r+b"))
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
        self._open.close()

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
        """Read the records one after the other."""
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
        """Find the complete records of an earlier run; False if there are none, or they are of another run."""
        size = os.fstat(self._stream.fileno()).st_size
        if not size or self._stream.read(len(_LINE)) != _LINE:
            self.other = size > 0
            return False
        ends: list[int] = []
        first: Record | None = None
        while (content := self._next()) is not None:
            first = first or _unpacked(content)
            ends.append(self._stream.tell())
        if first is None or first.facts != self.facts:
            self.other = True
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


def _unpacked(content: bytes) -> Record:
    (size,) = _SIZE.unpack_from(content)
    manifest = json.loads(content[_SIZE.size : _SIZE.size + size])
    place, arrays = _SIZE.size + size, {}
    for name, kind, shape in manifest["arrays"]:
        if kind not in _TYPES:
            raise OutputError(f"The checkpoint has an array of unknown type {kind}.", "Run without --resume.")
        count = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(content, kind, count, place).reshape(shape)
        place += arrays[name].nbytes
    return Record(manifest["facts"], arrays)
