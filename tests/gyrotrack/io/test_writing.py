"""A file is there whole or not at all, whatever interrupts its writing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fitting._errors import LedgerError, RecordError
from fitting.inference._case_file import read_record
from fitting.study._history import Ledger
from gyrotrack._errors import DatasetError, OutputError
from gyrotrack.io._atomic import CheckpointFile, locked, new_file
from gyrotrack.io._hdf5 import new_hdf5, read_recording, write_recording
from gyrotrack.io.readers._import_case import import_body


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
    with pytest.raises(OutputError, match="already exists") as caught:
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
        with pytest.raises(OutputError, match="another program"):
            write(path)
    assert path.read_bytes() == b"first"
    assert names(tmp_path) == ["a"]


def test_a_file_made_meanwhile_is_not_overwritten(tmp_path):
    path = tmp_path / "a"
    with pytest.raises(OutputError, match="already exists"):
        overtake(path)
    assert path.read_bytes() == b"theirs"
    assert names(tmp_path) == ["a"]


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs file size limits and named pipes")
@pytest.mark.parametrize("old", [b"old", None])
def test_a_file_size_limit_leaves_the_old_file_and_nothing_else(tmp_path, old):
    path = tmp_path / "a"
    if old is not None:
        path.write_bytes(old)
    code = f"""
import resource
from pathlib import Path
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
from gyrotrack._errors import OutputError
from fitting._errors import LedgerError, RecordError
from fitting.inference._case_file import read_record
from fitting.study._history import Ledger
from gyrotrack.io._atomic import locked, new_file
from gyrotrack.io._atomic import CheckpointFile
from gyrotrack.io.readers._import_case import import_body
try:
    with new_file(Path({str(path)!r}), force=True) as stream:
        stream.write(bytes(5000))
except OutputError as error:
    print(error.message)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == f"{path} cannot be written: the file size limit is reached.\n"
    assert names(tmp_path) == (["a"] if old is not None else [])
    assert old is None or path.read_bytes() == old


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("name", ["a", "a.part"])
def test_a_pipe_in_place_of_an_output_is_refused(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(OutputError, match="is a named pipe, not a regular file"):
        write(tmp_path / "a", force=True)
    assert names(tmp_path) == [name]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_in_place_of_an_input_ledger_or_checkpoint_is_refused(tmp_path, capsys):
    os.mkfifo(tmp_path / "p")
    os.mkfifo(tmp_path / "p.unfinished")
    with pytest.raises(DatasetError, match="named pipe"):
        read_recording(tmp_path / "p")
    with pytest.raises(DatasetError, match="named pipe"):
        import_body(tmp_path / "p", 1e-3)
    with pytest.raises(OutputError, match="named pipe"):
        CheckpointFile(tmp_path / "p", {})
    with pytest.raises(LedgerError, match="regular file"):
        Ledger(tmp_path / "p")
    with pytest.raises(RecordError, match="regular file"):
        read_record(tmp_path / "p")


def test_a_locked_file_is_one_sentence_after_the_time_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("gyrotrack.io._atomic.LOCK_TIMEOUT", 0.1)
    with locked(tmp_path / "a"):
        with (
            pytest.raises(OutputError, match=r"is locked by another program; waited 0\.1 s"),
            locked(tmp_path / "a"),
        ):
            pass
        with locked(tmp_path / "b"):
            pass
    with locked(tmp_path / "a"):
        pass
    assert names(tmp_path) == []


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
    for k in range(20):
        path.unlink(missing_ok=True)
        with subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            time.sleep(2 * once * k / 20)
            process.send_signal(signal.SIGKILL)
        if path.exists():
            read_recording(path)
            sound += 1
    assert sound > 2


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
