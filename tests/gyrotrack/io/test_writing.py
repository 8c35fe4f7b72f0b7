"""A file is there whole or not at all, whatever interrupts its writing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gyrotrack._errors import DatasetError, OutputError
from gyrotrack.io._atomic import new_file, new_hdf5
from gyrotrack.io._hdf5 import read_recording, write_recording


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def fail(path, error):
    with new_hdf5(path, force=True) as file:
        file["x"] = 1
        raise error


def overtake(path):
    with new_file(path) as stream:
        stream.write(b"mine")
        path.write_bytes(b"theirs")


def write(path, content=b"new", **options):
    with new_file(path, **options) as stream:
        stream.write(content)


def test_existing_file_needs_force(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"old")
    with pytest.raises(OutputError, match="exists already") as caught:
        write(path)
    assert "--force" in caught.value.hint
    assert path.read_bytes() == b"old"
    write(path, force=True)
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "a.h5"
    path.write_bytes(b"old")
    with pytest.raises(error):
        fail(path, error)
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.h5"]


def test_missing_folder_and_folder_as_target_are_refused(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        write(tmp_path / "no" / "a")
    with pytest.raises(OutputError, match="is a folder"):
        write(tmp_path, force=True)


def test_a_temporary_file_left_by_a_killed_process_is_no_obstacle(tmp_path):
    (tmp_path / "a.part").write_bytes(b"half")
    write(tmp_path / "a")
    assert names(tmp_path) == ["a"]


def test_two_writers_of_one_file_do_not_mix(tmp_path):
    path = tmp_path / "a"
    with new_file(path) as stream:
        stream.write(b"first")
        with pytest.raises(OutputError, match="another process"):
            write(path)
    assert path.read_bytes() == b"first"
    assert names(tmp_path) == ["a"]


def test_a_file_made_meanwhile_is_not_overwritten(tmp_path):
    path = tmp_path / "a"
    with pytest.raises(OutputError, match="exists already"):
        overtake(path)
    assert path.read_bytes() == b"theirs"
    assert names(tmp_path) == ["a"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk_is_one_sentence(tmp_path, monkeypatch):
    with Path("/dev/full").open("wb", buffering=0) as full:
        monkeypatch.setattr("gyrotrack.io._atomic._open_part", lambda part: full)
        with pytest.raises(OutputError, match="disk is full"):
            write(tmp_path / "a", b"x" * 100_000)


@pytest.mark.skipif(
    os.name == "nt" or (hasattr(os, "geteuid") and os.geteuid() == 0), reason="needs permissions"
)
def test_unwritable_folder_is_one_sentence(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="cannot be written"):
            write(tmp_path / "a")
    finally:
        tmp_path.chmod(0o700)


_WRITER = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from conftest import make_recording
from gyrotrack.io._hdf5 import write_recording
one = make_recording(20000)
print("ready", flush=True)
while True:
    write_recording(Path(sys.argv[1]), one, command="", settings={{}}, force=True)
"""


@pytest.mark.slow
def test_killed_at_any_moment_the_file_is_sound_or_absent(tmp_path):
    path = tmp_path / "r.h5"
    script = _WRITER.format(tests=str(Path(__file__).parent))
    sound = 0
    once = _time_of_one_write(
        script, path
    )  # a busy machine writes slowly: kill through two writes, whatever they take
    for k in range(40):
        path.unlink(missing_ok=True)
        with subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            time.sleep(2 * once * k / 40)
            process.send_signal(signal.SIGKILL)
        if path.exists():
            read_recording(path)
            sound += 1
    assert sound > 5


def _time_of_one_write(script, path):
    with subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        start = time.monotonic()
        while not path.exists() and time.monotonic() - start < 60:
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    return time.monotonic() - start


def test_bytes_changed_on_the_disk_are_noticed(tmp_path, recording):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={})
    good = path.read_bytes()
    wrong = 0
    for position in range(100, len(good), len(good) // 60):
        path.write_bytes(good[:position] + bytes([good[position] ^ 0xFF]) + good[position + 1 :])
        try:
            read = read_recording(path)
        except DatasetError:
            continue
        wrong += not (read.bodies["casing"].angle == recording.bodies["casing"].angle).all()
    assert wrong == 0
