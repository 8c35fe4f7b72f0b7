import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gyrotrack.report.beside import Beside


def _where(value):
    return value, os.getpid()


def _wrong(value):
    raise ValueError(value)


def test_it_is_done_in_another_process_which_is_gone_afterwards():
    with Beside(cores=2) as beside:
        value, where = beside.begin(_where, 3)()
    assert value == 3
    assert where != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(where, 0)


def test_what_goes_wrong_there_is_told_here():
    with Beside(cores=2) as beside, pytest.raises(ValueError, match="seven"):
        beside.begin(_wrong, "seven")()


def test_without_a_second_core_it_is_done_here():
    with Beside(cores=1) as beside:
        assert beside.begin(_where, 3)() == (3, os.getpid())


def test_if_the_process_is_killed_it_is_done_here():
    with Beside(cores=2) as beside:
        _, where = beside.begin(_where, 0)()
        os.kill(where, signal.SIGKILL)
        assert beside.begin(_where, 3)() == (3, os.getpid())
        assert beside.begin(_where, 4)() == (4, os.getpid())


def test_it_does_not_outlive_a_command_that_is_killed(tmp_path):
    script = tmp_path / "command.py"
    script.write_text(
        "import os, time\n"
        "from gyrotrack.report.beside import Beside\n"
        "if __name__ == '__main__':\n"
        "    with Beside(cores=2) as beside:\n"
        "        print(beside.begin(os.getpid)(), flush=True)\n"
        "        time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as command:
        where = int(command.stdout.readline())
        command.kill()
    for _ in range(100):
        if not Path(f"/proc/{where}").exists():
            return
        time.sleep(0.1)
    pytest.fail("it is still there")
