"""Temporary folders do not outlive their process for long, and no other folder is removed."""

import os
import signal
import subprocess
import sys

import pytest
from filelock import FileLock

from gyrotrack.io._scratch import scratch_folder

_KILLED = """
import os, signal
from gyrotrack.io._scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "window").write_bytes(b"large")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return tmp_path


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
def test_the_folder_of_a_killed_process_is_removed_by_the_next(root):
    done = subprocess.run([sys.executable, "-c", _KILLED], check=False)
    assert done.returncode == -signal.SIGKILL
    (left,) = root.iterdir()
    foreign = [root / name for name in ("gyrotrack-work-mine", "other")]
    for folder in foreign:
        folder.mkdir()
        (folder / "precious").touch()
    (root / "gyrotrack-work-link").symlink_to(root / "other")
    with scratch_folder() as one, scratch_folder() as two:
        assert not left.exists()
        assert one != two
        assert one.is_dir()
    assert sorted(p.name for p in root.iterdir()) == ["gyrotrack-work-link", "gyrotrack-work-mine", "other"]
    assert all((folder / "precious").exists() for folder in foreign)


def test_a_folder_is_removed_if_it_has_a_free_lock(root):
    left, used, new = (root / f"gyrotrack-work-{name}" for name in ("left", "used", "new"))
    for folder in (left, used, new):
        folder.mkdir()
        (folder / "window").touch()
    for folder in (left, used):
        (folder / "lock").touch()
    (root / "gyrotrack-work-file").touch()
    with FileLock(used / "lock", thread_local=False), scratch_folder() as own:
        assert not left.exists()
        assert own.parent == root
        assert own.name.startswith("gyrotrack-work-")
    assert not own.exists()
    assert sorted(p.name for p in root.iterdir()) == [
        "gyrotrack-work-file",
        "gyrotrack-work-new",
        "gyrotrack-work-used",
    ]
    assert (used / "window").exists()


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="users")
def test_the_folder_of_another_user_is_kept(root, monkeypatch):
    left = root / "gyrotrack-work-left"
    left.mkdir()
    (left / "lock").touch()
    uid = os.getuid()
    monkeypatch.setattr("gyrotrack.io._scratch.os.getuid", lambda: uid + 1)
    with scratch_folder():
        assert left.exists()
