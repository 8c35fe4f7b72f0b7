"""A file is there whole or not at all, whatever interrupts its writing."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fitting import Ledger, LedgerError, RecordError
from fitting._schema import locked as ledger_locked
from fitting.inference._case_file import read_record
from gyrotrack import DatasetError, OutputError, import_body, read_recording, write_recording
from gyrotrack.io._atomic import CheckpointFile, locked, new_file, refuse_existing, remove_remains
from gyrotrack.io._hdf5 import new_hdf5


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


_KILLED = """
import os, signal, sys
from pathlib import Path
from gyrotrack.io._atomic import new_file
with new_file(Path(sys.argv[1])) as stream:
    stream.write(b"half")
    stream.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
def test_the_next_writer_removes_what_a_killed_one_has_left_and_nothing_else(tmp_path):
    foreign = ["a.part", "a.0123abcd.part", "a.unfinished"]
    for name in foreign:
        (tmp_path / name).write_bytes(b"precious")
    subprocess.run([sys.executable, "-c", _KILLED, str(tmp_path / "a")], check=False)
    assert len(names(tmp_path)) == len(foreign) + 2  # the temporary file, and its lock
    write(tmp_path / "a")
    assert names(tmp_path) == sorted(["a", *foreign])
    assert {(tmp_path / name).read_bytes() for name in foreign} == {b"precious"}


LINKS = {"symbolic": os.symlink, "hard": os.link}


@pytest.mark.parametrize("kind", LINKS)
@pytest.mark.parametrize("name", ["a.unfinished", ".a.lock", ".a.unfinished.lock"])
def test_a_planted_link_changes_no_file(tmp_path, name, kind):
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    LINKS[kind](victim, tmp_path / name)
    if ".unfinished" in name:
        for resume in (False, True):
            with pytest.raises(OutputError, match=r"was not made by gyrotrack"):
                CheckpointFile(tmp_path / "a", {}, resume=resume)
    else:
        with pytest.raises(OutputError, match=r"was not made by gyrotrack"):
            write(tmp_path / "a")
    assert victim.read_bytes() == b"precious"
    assert names(tmp_path) == sorted([name, "victim"])


@pytest.mark.parametrize("content", [b"precious", b"gyrotrack journal 2\n"])
def test_a_foreign_file_with_the_name_of_ours_is_left_alone(tmp_path, content):
    for name in ("a.unfinished", ".b.lock", ".c.fits.json.lock"):
        (tmp_path / name).write_bytes(content)
    with pytest.raises(OutputError, match=r"a\.unfinished was not made by gyrotrack"):
        CheckpointFile(tmp_path / "a", {})
    with pytest.raises(OutputError, match=r"\.b\.lock was not made by gyrotrack"):
        write(tmp_path / "b")
    with (
        pytest.raises(LedgerError, match=r"\.lock was not made by gyrotrack"),
        ledger_locked(tmp_path / "c.fits.json"),
    ):
        pass
    assert {p.read_bytes() for p in tmp_path.iterdir()} == {content}


def test_a_lock_file_names_no_file_but_a_temporary_one_of_its_output(tmp_path):
    (tmp_path / "b.0123abcd.part").write_bytes(b"precious")
    for name in ("b.0123abcd.part", "../b.0123abcd.part", "a", "", "a.0123abcd.part/"):
        (tmp_path / ".a.lock").write_bytes(b"gyrotrack lock\n" + name.encode())
        write(tmp_path / "a", force=True)
    assert names(tmp_path) == ["a", "b.0123abcd.part"]


@pytest.mark.parametrize("made", [locked, ledger_locked])
@pytest.mark.parametrize(
    ("number", "words"), [(errno.ENOLCK, "has no locks"), (errno.EACCES, "cannot be written")]
)
def test_without_a_lock_nothing_is_written(tmp_path, monkeypatch, made, number, words):
    def refuse(self, *args, **kwargs):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("filelock.FileLock.acquire", refuse)
    with pytest.raises((OutputError, LedgerError), match=words), made(tmp_path / "a", 0.1):
        pytest.fail("not locked")


def test_a_lock_that_is_left_behind_does_not_block(tmp_path):
    for name in (".a.lock", ".b.lock"):
        (tmp_path / name).write_bytes(b"")
    with locked(tmp_path / "a"), ledger_locked(tmp_path / "b"):
        assert names(tmp_path) == [".a.lock", ".b.lock"]
    assert names(tmp_path) == []


def test_no_command_replaces_what_it_reads(tmp_path):
    source, hard, soft = (tmp_path / name for name in ("film.mp4", "hard.mp4", "soft.mp4"))
    source.write_bytes(b"precious")
    os.link(source, hard)
    soft.symlink_to(source)
    (tmp_path / "x").mkdir()
    for target in (source, hard, soft, tmp_path / "x" / ".." / "film.mp4"):
        with pytest.raises(OutputError, match="is an input of this command"):
            refuse_existing(target, force=True, reads=[None, tmp_path / "absent", source])
    refuse_existing(source, force=True, reads=[tmp_path / "absent"])


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
@pytest.mark.parametrize("name", ["a", ".a.lock"])
def test_a_pipe_instead_of_an_output_is_refused(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(OutputError, match="is a named pipe, not a regular file"):
        write(tmp_path / "a", force=True)
    assert names(tmp_path) == [name]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_instead_of_an_input_ledger_or_checkpoint_is_refused(tmp_path, capsys):
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


@pytest.mark.parametrize(
    ("content", "left"),
    [
        (b"", []),
        (b"gyrotrack lock\n", []),
        (b"gyrotrack lock\na.h5.0123abcd.part", []),
        (b"gyrotrack lock\nb.h5.0123abcd.part", ["a.h5.0123abcd.part"]),
        (b"foreign", [".a.h5.lock", "a.h5.0123abcd.part"]),
    ],
)
def test_remains_of_a_killed_program_are_removed_from_a_folder(tmp_path, content, left):
    part = tmp_path / "a.h5.0123abcd.part"
    for path in (tmp_path / "a.h5", tmp_path / "c.lock"):
        path.write_bytes(b"precious")
    if b"a.h5" in content or left:
        part.write_bytes(b"unfinished")
    (tmp_path / ".a.h5.lock").write_bytes(content)
    remove_remains(tmp_path)
    assert names(tmp_path) == sorted([*left, "a.h5", "c.lock"])


def test_the_remains_of_a_program_that_still_runs_are_kept(tmp_path):
    with locked(tmp_path / "a"):
        remove_remains(tmp_path)
        assert names(tmp_path) == [".a.lock"]
