"""HDF5 comes to its end in peace though the disk fails under it, or the user interrupts."""

import errno
import os
import signal
import subprocess
import sys
from io import FileIO

import numpy as np
import pytest

from gyrotrack.io._hdf5 import WriteBuffer, deferred_interrupts

_RUN = """
import errno, signal, sys
from io import FileIO
import h5py, numpy as np
from gyrotrack.io._hdf5 import WriteBuffer, deferred_interrupts

class Disk(FileIO):
    count, mode_, at = 0, sys.argv[2], int(sys.argv[3])
    def write(self, data):
        self.count += 1
        if self.mode_ == "full" and self.count >= self.at:
            raise OSError(errno.ENOSPC, "no room")
        if self.mode_ == "interrupt" and self.count == self.at:
            signal.raise_signal(signal.SIGINT)
        return super().write(data)

disk = Disk(sys.argv[1], "w+")
spool = WriteBuffer(disk)
values = np.random.default_rng(0).random(20000)
try:
    with deferred_interrupts(), h5py.File(spool, "w", libver=("v110", "v110")) as file:
        for k in range(12):
            data = file.create_group(f"g{k}").create_dataset("x", data=values, chunks=(8192,), compression="gzip")
            data.attrs["units"] = "m"
except KeyboardInterrupt:
    print("interrupted")
print(disk.count, spool.error)
"""


def run(path, mode, at):
    words = [sys.executable, "-c", _RUN, str(path), mode, str(at)]
    return subprocess.run(words, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_no_write_that_fails_ends_the_process(tmp_path):
    whole = run(tmp_path / "a.h5", "", 0)
    count = int(whole.stdout.split()[0])
    assert whole.returncode == 0
    assert count > 30
    for at in (2, count // 2, count):
        done = run(tmp_path / "b.h5", "full", at)
        assert (done.returncode, done.stderr) == (0, "")
        assert "no room" in done.stdout
        done = run(tmp_path / "c.h5", "interrupt", at)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("interrupted")
        assert (tmp_path / "c.h5").stat().st_size == (tmp_path / "a.h5").stat().st_size


def test_what_comes_after_a_failure_can_be_read_back(tmp_path):
    class Small(FileIO):
        def write(self, data):
            if self.tell() + len(data) > 10:
                raise OSError(errno.ENOSPC, "no room")
            return super().write(data)

        def truncate(self, size=None):
            raise OSError(errno.EIO, "no disk")

    with Small(tmp_path / "a", "w+") as file:
        spool = WriteBuffer(file)
        spool.write(b"12345678")
        assert spool.error is None
        spool.write(b"abcd")
        assert spool.error.errno == errno.ENOSPC
        assert spool.tell() == 12
        spool.seek(6)
        assert spool.read() == b"78abcd"
        spool.truncate(7)
        spool.seek(0)
        assert spool.read() == b"1234567"
    with Small(tmp_path / "b", "w+") as file:
        early = WriteBuffer(file)
        early.truncate(100)
        assert early.error.errno == errno.EIO


@pytest.mark.skipif(not hasattr(os, "kill"), reason="signals")
def test_an_interrupt_waits_and_then_comes():
    done = []

    def work():
        with deferred_interrupts():
            os.kill(os.getpid(), signal.SIGINT)
            done.append(np.ones(3).sum())

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        work()
    assert done
    assert signal.getsignal(signal.SIGINT) is before
