"""Locks of files: retries, time limits, errors, and files that a killed writer left behind."""

import errno
import os
import socket
import stat

import filelock
import pytest

from fitting import _files
from fitting._files import Files

FILES = Files(lambda what, hint: ValueError(what, hint), elsewhere="Use a local disk.")
NO_PERMISSION = PermissionError(errno.EACCES, "Permission denied")


def lock_that_raises(monkeypatch, errors):
    """Let the attempts to acquire a lock raise these errors in turn; the attempts after them are successful."""
    left, made = list(errors), []

    class Lock:
        def __init__(self, path, **more):
            made.append(more)

        def acquire(self, **more):
            made.append(more)
            if left:
                raise left.pop(0)

        def release(self):
            made.append("released")

    monkeypatch.setattr(filelock, "FileLock", Lock)
    return made


def clock(monkeypatch, step):
    """Let the time increase by `step` [s] per reading, and by the length of each pause."""
    now, pauses = [0.0], []

    def read():
        now[0] += step
        return now[0]

    def pause(seconds):
        pauses.append(seconds)
        now[0] += seconds

    monkeypatch.setattr(_files, "monotonic", read)
    monkeypatch.setattr(_files, "sleep", pause)
    return pauses


class TestLocked:
    def test_the_lock_file_exists_only_while_the_lock_is_held(self, tmp_path):
        with FILES.locked(tmp_path / "a.h5") as own:
            assert own == tmp_path / ".a.h5.lock"
            assert own.is_file()
        assert list(tmp_path.iterdir()) == []

    def test_an_error_inside_releases_the_lock(self, tmp_path):
        with pytest.raises(KeyError), FILES.locked(tmp_path / "a.h5"):
            raise KeyError
        with FILES.locked(tmp_path / "a.h5", timeout=0.0):
            pass

    def test_a_missing_folder_is_not_created(self, tmp_path):
        with pytest.raises(ValueError, match="No such file"), FILES.locked(tmp_path / "b" / "a.h5"):
            pass
        assert list(tmp_path.iterdir()) == []

    def test_other_users_may_open_the_lock_and_threads_share_it(self, tmp_path, monkeypatch):
        made = lock_that_raises(monkeypatch, [])
        with FILES.locked(tmp_path / "a.h5", timeout=3.0):
            pass
        assert made == [
            {"mode": 0o666, "thread_local": False},
            {"timeout": 3.0, "poll_interval": _files._POLL},
            "released",
        ]

    def test_a_lock_without_permissions_for_a_moment_is_tried_again(self, tmp_path, monkeypatch):
        lock_that_raises(monkeypatch, [NO_PERMISSION, NO_PERMISSION])
        pauses = clock(monkeypatch, 0.0)
        with FILES.locked(tmp_path / "a.h5", timeout=1.0):
            pass
        assert pauses == [_files._POLL] * 2

    @pytest.mark.parametrize(("timeout", "attempts"), [(2.0, 2), (5.0, 5)])
    def test_permissions_that_stay_denied_are_refused_after_the_time(
        self, tmp_path, monkeypatch, timeout, attempts
    ):
        made = lock_that_raises(monkeypatch, [NO_PERMISSION] * 50)
        monkeypatch.setattr(_files, "_POLL", 0.0)
        clock(monkeypatch, 1.0)  # the first reading, 1 s, is the begin
        with (
            pytest.raises(ValueError, match="Permission denied"),
            FILES.locked(tmp_path / "a.h5", timeout=timeout),
        ):
            pass
        assert len(made) - 1 == attempts + 1

    def test_a_folder_without_permission_to_write_is_refused_at_once(self, tmp_path, monkeypatch):
        lock_that_raises(monkeypatch, [NO_PERMISSION])
        pauses = clock(monkeypatch, 0.0)
        monkeypatch.setattr(_files.os, "access", lambda path, mode: (path, mode) != (tmp_path, os.W_OK))
        with pytest.raises(ValueError, match="Permission denied"), FILES.locked(tmp_path / "a.h5"):
            pass
        assert pauses == []

    @pytest.mark.parametrize("error", [filelock.Timeout("a"), RuntimeError("deadlock")])
    def test_a_lock_that_is_not_released_is_busy(self, tmp_path, monkeypatch, error):
        lock_that_raises(monkeypatch, [error])
        with (
            pytest.raises(ValueError, match=r"locked by another program; waited 0\.5 s\."),
            FILES.locked(tmp_path / "a.h5", timeout=0.5),
        ):
            pass

    @pytest.mark.parametrize(
        "error",
        [
            NotImplementedError(),
            *(OSError(n, "x") for n in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)),
        ],
    )
    def test_a_disk_without_locks_has_its_own_hint(self, tmp_path, monkeypatch, error):
        lock_that_raises(monkeypatch, [error])
        with pytest.raises(ValueError, match="has no locks") as seen, FILES.locked(tmp_path / "a.h5"):
            pass
        assert seen.value.args[1] == "Use a local disk."

    @pytest.mark.parametrize(
        ("number", "words", "hint"),
        [
            (errno.ENOSPC, "the disk is full", "space"),
            (errno.EDQUOT, "the disk is full", "space"),
            (errno.EFBIG, "the file size limit is reached", "ulimit"),
            (errno.EIO, "broken", "permissions"),
        ],
    )
    def test_other_errors_are_refusals_with_their_reason(self, tmp_path, monkeypatch, number, words, hint):
        lock_that_raises(monkeypatch, [OSError(number, "broken")])
        with pytest.raises(ValueError, match=words) as seen, FILES.locked(tmp_path / "a.h5"):
            pass
        assert hint in seen.value.args[1]

    @pytest.mark.parametrize(
        ("name", "removed"),
        [
            ("a.h5.0123abcd.part", True),
            ("a.h5.0123abc.part", False),  # seven digits
            ("a.h5.0123abcg.part", False),  # no hexadecimal digit
            ("b.h5.0123abcd.part", False),  # of another output
            ("a_h5.0123abcd.part", False),  # the dot is no placeholder
        ],
    )
    def test_the_part_of_a_killed_writer_is_removed(self, tmp_path, name, removed):
        (tmp_path / name).write_bytes(b"half")
        (tmp_path / ".a.h5.lock").write_bytes(_files.LOCK_LINE + name.encode())
        with FILES.locked(tmp_path / "a.h5") as own:
            assert (tmp_path / name).exists() == (not removed)
            FILES.name_in_lock(tmp_path / "a.h5.00000000.part", own)
            assert own.read_bytes() == b"gyrotrack lock\na.h5.00000000.part"

    def test_a_foreign_lock_is_left_alone(self, tmp_path):
        (tmp_path / ".a.h5.lock").write_bytes(b"of another program")
        with pytest.raises(ValueError, match="not made by gyrotrack"), FILES.locked(tmp_path / "a.h5"):
            pass
        assert (tmp_path / ".a.h5.lock").read_bytes() == b"of another program"

    def test_an_empty_lock_is_ours(self, tmp_path):
        (tmp_path / ".a.h5.lock").touch()
        with FILES.locked(tmp_path / "a.h5"):
            pass


class TestSideFiles:
    @pytest.mark.parametrize("names", [1, 2])
    def test_a_file_with_several_names_is_refused(self, tmp_path, names):
        (tmp_path / "a").write_bytes(b"x")
        if names > 1:
            (tmp_path / "b").hardlink_to(tmp_path / "a")
            with pytest.raises(ValueError, match="not made by gyrotrack"):
                FILES.open_side_file(tmp_path / "a")
            return
        with FILES.open_side_file(tmp_path / "a") as stream:
            assert stream.read() == b"x"
            assert not stream.writable()
        with FILES.open_side_file(tmp_path / "a", os.O_RDWR) as stream:
            assert stream.writable()
        assert (tmp_path / "a").read_bytes() == b"x"

    def test_a_link_is_refused_and_a_missing_file_is_missing(self, tmp_path):
        (tmp_path / "a").symlink_to(tmp_path / "b")
        with pytest.raises(ValueError, match="not made by gyrotrack"):
            FILES.open_side_file(tmp_path / "a")
        with pytest.raises(FileNotFoundError):
            FILES.open_side_file(tmp_path / "c")

    def test_pipes_sockets_devices_and_folders_are_named(self, tmp_path):
        os.mkfifo(tmp_path / "pipe")
        (tmp_path / "file").touch()
        place = os.path.relpath(tmp_path / "s")  # names of sockets are short
        with socket.socket(socket.AF_UNIX) as s:
            s.bind(place if len(place) < 100 else str(tmp_path / "s"))
            for path, words in [
                (tmp_path / "pipe", "a named pipe"),
                (tmp_path / "s", "a socket"),
                (tmp_path, "a folder"),
                (_files.Path(os.devnull), "a device"),
            ]:
                with pytest.raises(ValueError, match=words):
                    FILES.refuse_special(path)
        FILES.refuse_special(tmp_path / "file")
        FILES.refuse_special(tmp_path / "missing")


def test_a_part_replaces_its_target(tmp_path):
    target = tmp_path / "a.h5"
    target.write_bytes(b"old")
    part = _files.new_part(target)
    assert part.parent == tmp_path
    assert part != _files.new_part(target)
    part.write_bytes(b"new")
    _files.flush(part)
    _files.publish(part, target)
    assert target.read_bytes() == b"new"
    assert not part.exists()
    assert stat.S_ISREG(target.stat().st_mode)
