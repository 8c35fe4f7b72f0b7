"""Disks that are full, read-only, or gone: a sentence, and nothing lost."""

import errno
import os
import subprocess
from pathlib import Path

import pytest

from gyrotrack import OutputError, read_recording, write_recording
from gyrotrack.apps.cli._app import run
from gyrotrack.io._atomic import new_file


@pytest.fixture(scope="module")
def mounted(tmp_path_factory):
    """Mount a small file system in memory: mounted(kilobytes) -> folder."""
    made = []

    def mount(kilobytes):
        folder = tmp_path_factory.mktemp("disk")
        words = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
        except OSError as error:
            pytest.skip(f"no mount here: {error}")
        if done.returncode:
            pytest.skip(f"may not mount a file system here: {done.stderr.strip()}")
        made.append(folder)
        return folder

    yield mount
    for folder in made:
        subprocess.run(["umount", "-l", str(folder)], check=False)


def fill(folder, leave):
    """Fill a disk but for `leave` bytes."""
    free = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
    (folder / "filler").write_bytes(b"x" * max(0, free - leave))


@pytest.mark.parametrize(
    ("share", "old"),
    [
        *((s, True) for s in (0.0, 0.1, 0.5, 0.9)),
        (0.3, False),
        *(pytest.param(s, True, marks=pytest.mark.slow) for s in (0.02, 0.3, 0.7)),
        *(pytest.param(s, False, marks=pytest.mark.slow) for s in (0.0, 0.02, 0.1, 0.5, 0.7, 0.9)),
    ],
)
def test_a_full_disk_is_a_sentence_and_the_old_file_stays(mounted, recording, tmp_path, share, old):
    whole = write_recording(tmp_path / "whole.h5", recording, command="", settings={}).read_bytes()
    folder = mounted(8 * len(whole) // 1024)
    path = folder / "r.h5"
    if old:
        path.write_bytes(whole)
    fill(folder, int(share * len(whole)))
    with pytest.raises(OutputError, match="disk is full"):
        write_recording(path, recording, command="", settings={}, force=True)
    assert sorted(p.name for p in folder.iterdir()) == (["filler", "r.h5"] if old else ["filler"])
    if old:
        assert path.read_bytes() == whole
        read_recording(path)
    (folder / "filler").unlink()
    write_recording(path, recording, command="", settings={}, force=True)
    read_recording(path)


COMMANDS = {
    "simulate": ["simulate", "-o", "{disk}/new.h5", "--duration", "12", "--window-length", "1"],
    "export": ["export", "{case}", "-o", "{disk}/new.csv"],
    "parquet": ["export", "{case}", "-o", "{disk}/new.parquet"],
    "fit": ["fit", "{case}", "--ledger", "{disk}/fits.json"],
    "batch": ["batch", "{manifest}", "-o", "{disk}/out", "--until", "fit"],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("state", ["full", "read-only"])
def test_commands_on_such_a_disk(mounted, tmp_path, capsys, name, state):
    pytest.importorskip("pyarrow")
    case = tmp_path / "case.h5"
    assert run(["simulate", "-o", str(case), "--duration", "12", "--window-length", "1"]) == 0
    (tmp_path / "m.toml").write_text('[[case]]\ndata = "case.h5"\n')
    disk = mounted(200)
    if state == "full":
        fill(disk, 0)
    else:
        words = ["mount", "-o", "remount,ro", str(disk)]
        if subprocess.run(words, capture_output=True, check=False).returncode:
            pytest.skip("may not mount read-only here")
    before = sorted(p.name for p in disk.iterdir())
    capsys.readouterr()
    places = {"disk": disk, "case": case, "manifest": tmp_path / "m.toml"}
    assert run([w.format(**places) for w in COMMANDS[name]]) == 1
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert "A bug" not in said.err + said.out
    assert "written" in said.err + said.out or "disk is full" in said.err + said.out
    left = sorted(p.name for p in disk.rglob("*") if p.is_file() and p.suffix not in {".lock", ".jsonl"})
    assert left == before


def test_a_drive_that_is_gone_before_the_file_is_whole(mounted):
    """The drive is taken away while it is written to; what was there before stands there when it is back."""
    folder = mounted(200)
    (folder / "a").write_bytes(b"old")
    held = os.open(folder, os.O_RDONLY)

    def write_and_take_away(stream):
        stream.write(b"new")
        subprocess.run(["umount", "-l", str(folder)], check=True)

    with pytest.raises(OutputError, match="was removed"), new_file(folder / "a", force=True) as stream:
        write_and_take_away(stream)
    assert not list(folder.iterdir())
    with open(os.open("a", os.O_RDONLY, dir_fd=held), "rb") as old:  # noqa: PTH123 - the drive, wherever it is
        assert old.read() == b"old"
    os.close(held)


@pytest.mark.parametrize("code", [errno.ESTALE, errno.EIO, errno.ENOTCONN, errno.EDQUOT])
def test_a_network_drive_that_goes_away_while_writing(tmp_path, monkeypatch, code):
    (tmp_path / "a").write_bytes(b"old")

    def gone(handle):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", gone)
    with (
        pytest.raises(OutputError, match="cannot be written"),
        new_file(tmp_path / "a", force=True) as stream,
    ):
        stream.write(b"new")
    assert (tmp_path / "a").read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_a_network_drive_that_goes_away_while_reading(tmp_path, monkeypatch, capsys):
    case = tmp_path / "case.h5"
    assert run(["simulate", "-o", str(case), "--duration", "12", "--window-length", "1"]) == 0
    opened = Path.open

    def gone(self, *args, **kwargs):
        if self.name == "case.h5":
            raise OSError(errno.ESTALE, "Stale file handle")
        return opened(self, *args, **kwargs)

    monkeypatch.setattr(Path, "open", gone)
    capsys.readouterr()
    assert run(["info", str(case)]) == 1
    assert "cannot be read: Stale file handle" in capsys.readouterr().err
