"""The arrays of a MATLAB file, read in a separate process, because a damaged file may crash SciPy's compiled reader.

The process receives the content on stdin. Its answer consists of a line when it is ready, a line of JSON, and the
arrays, each in the format of a file ``.npy``. No part of the answer is executed.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

READY = b"ready\n"
_MOST_CPU_S, _MOST_S = (
    10,
    30,
)  # limits of CPU time and elapsed time [s]; a valid file of the largest size takes 1 s
# limit of the memory in addition to the memory of the libraries [bytes]: four times the largest file
_MOST_MEMORY = 2**30


class Damaged(Exception):  # noqa: N818
    """The reader crashed, or did not end in time."""


class Unreadable(Exception):  # noqa: N818
    """The reader refused the file, or did not start."""


def arrays_in(content: bytes) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
    """Return the numeric arrays of a MATLAB file by name, and a description of each other variable.

    Raises
    ------
    Damaged
        If the reader crashed or took too long.
    Unreadable
        If the reader refused the file or did not start.
    """
    command = [sys.executable, "-P", "-m", "gyrotrack.io.readers._matlab_process"]
    try:
        ended = subprocess.run(  # noqa: S603
            command,
            input=content,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_MOST_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise Damaged(f"its reader does not end within {_MOST_S} s") from error
    answer = io.BytesIO(ended.stdout)
    if answer.readline() != READY:
        raise Unreadable("its reader did not start; there may be too little memory")
    if ended.returncode:
        raise Damaged("its reader crashed or did not end")
    said = json.loads(answer.readline())
    if "error" in said:
        raise Unreadable(said["error"])
    return {name: np.load(answer, allow_pickle=False) for name in said["numbers"]}, said["others"]


def description(array: npt.NDArray[Any]) -> str:
    """Return the shape of an array and the kind of its values as text."""
    kind = "struct" if array.dtype.names else {"O": "cell", "U": "text"}.get(array.dtype.kind, "numbers")
    return f"{' x '.join(map(str, array.shape)) or 'scalar'} {kind}"


def _capture(fields: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Return the signals of a capture of dSPACE: a struct of times, X(i).Data, and signals, Y(i).Data and Y(i).Name."""
    signals: dict[str, npt.NDArray[Any]] = {}
    times, values = fields.get("X"), fields.get("Y")
    if times is None or values is None:
        return signals
    names = values.dtype.names or ()
    if "Data" not in names or "Data" not in (times.dtype.names or ()):
        return signals
    signals["t"] = times["Data"].ravel()[0]
    for k, signal in enumerate(values.ravel(), 1):
        name = "".join(map(str, np.ravel(signal["Name"]))) if "Name" in names else ""
        words = [w for w in name.replace('"', "").split("/") if w]
        base = "/".join(words[-2:]).replace("/Out1", "") or f"Y{k}"
        signals[base if base not in signals else f"{base} {k}"] = signal["Data"]
    return signals


def _read(content: bytes) -> dict[str, npt.NDArray[Any]]:
    """Return the variables of a MATLAB file; the fields of a single struct count as variables."""
    from scipy.io import loadmat

    held = loadmat(io.BytesIO(content))  # type: ignore[arg-type]
    arrays = {k: v for k, v in held.items() if not k.startswith("__") and isinstance(v, np.ndarray)}
    for name, value in list(arrays.items()):
        if value.dtype.names and value.size == 1:
            fields = {n: np.asarray(value[n].ravel()[0]) for n in value.dtype.names}
            arrays |= _capture(fields) or fields
            del arrays[name]
    return arrays


def _limit() -> None:
    """Limit the memory and the CPU time of this process, if the system supports limits."""
    try:
        import resource
        from pathlib import Path

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (ImportError, OSError):
        return
    limits = {
        resource.RLIMIT_AS: pages * resource.getpagesize() + _MOST_MEMORY,
        resource.RLIMIT_CPU: int(sum(os.times()[:2])) + _MOST_CPU_S,
        resource.RLIMIT_CORE: 0,
    }
    for kind, most in limits.items():
        for other in resource.getrlimit(kind):
            most = most if other == resource.RLIM_INFINITY else min(most, other)
        resource.setrlimit(kind, (most, most))


def main() -> None:
    """Read the content on stdin and write the answer to stdout."""
    import scipy.io  # noqa: F401

    content = sys.stdin.buffer.read()
    _limit()
    out = sys.stdout.buffer
    out.write(READY)
    out.flush()
    try:
        arrays = _read(content)
        numbers = {k: v for k, v in arrays.items() if v.dtype.kind in "biufc"}
        others = {k: description(v) for k, v in arrays.items() if k not in numbers}
    except Exception as error:
        out.write(json.dumps({"error": str(error)[:100]}).encode() + b"\n")
        return
    out.write(json.dumps({"numbers": list(numbers), "others": others}).encode() + b"\n")
    for value in numbers.values():
        np.save(out, value, allow_pickle=False)


if __name__ == "__main__":
    main()
