"""Reads files by the public readers, each in a process of its own whose memory and time are measured and limited.

Run as a program: for each path on a line of stdin, one JSON line says how the reading ended.
"""

import json
import os
import resource
import signal
import sys
import time
from pathlib import Path

LIMIT_S, LIMIT_MB = 10.0, 1000.0


def _read(path):
    from gyrotrack import import_body
    from gyrotrack.video._container import probe
    from gyrotrack.video._decoder import Reader

    if path.endswith((".avi", ".mp4")):
        probe(Path(path))
        with Reader(Path(path)) as frames:
            for _, _ in zip(range(30), frames, strict=False):
                pass
    else:
        import_body(path, 1e-5)


def _child(path, out):
    from fitting import FittingError
    from gyrotrack import GyrotrackError

    size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()  # noqa: PTH123, SIM115
    most = size + int(3 * LIMIT_MB * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (int(LIMIT_S) + 1, int(LIMIT_S) + 1))
    signal.alarm(60)
    how = {"how": "read"}
    try:
        _read(path)
    except (GyrotrackError, FittingError) as error:
        how = {"how": "refused", "why": error.message}
    except BaseException as error:
        how = {"how": "internal error", "why": f"{type(error).__name__}: {error}"[:200]}
    os.write(out, json.dumps(how).encode())


def reading_of(path):
    """Read one file in a child; return how it ended, its CPU time [s], and its memory beyond the libraries' [MB]."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    out, into = os.pipe()
    begin = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.close(out)
        try:
            _child(path, into)
        finally:
            os._exit(0)
    os.close(into)
    with os.fdopen(out, "rb") as stream:
        said = stream.read()
    _, status, used = os.wait4(pid, 0)
    found = json.loads(said) if said else {"how": "killed", "why": f"status {status}"}
    return {
        **found,
        "seconds": used.ru_utime + used.ru_stime,
        "wall": time.monotonic() - begin,
        "megabytes": used.ru_maxrss / 1e3 - min(before, used.ru_maxrss) / 1e3,
    }


def main():
    import warnings

    import h5netcdf  # noqa: F401
    import openpyxl  # noqa: F401
    import pandas as pd  # noqa: F401
    import pyarrow.parquet  # noqa: F401
    import scipy.io  # noqa: F401
    import xlrd  # noqa: F401

    import gyrotrack.io.readers._import_case
    import gyrotrack.video._decoder  # noqa: F401

    warnings.simplefilter("ignore")
    for line in sys.stdin:
        print(json.dumps(reading_of(line.rstrip("\n"))), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
