"""Check the memory before libraries are imported: with too little memory the import may never end."""

from __future__ import annotations

import atexit
import sys
from collections.abc import Callable

LEAST_MEMORY = 192  # smallest address space (`ulimit -v`) [MiB]


def main() -> None:
    """Run the program with the arguments of the command line, and exit with its exit code."""
    if _address_space() < LEAST_MEMORY * 2**20:
        message = f"There is not enough memory: gyrotrack needs {LEAST_MEMORY} MiB."
        hint = "Raise the memory limit (`ulimit -v`)."
        if "--json" in sys.argv:
            sys.stdout.write(f'{{"error": {{"code": "memory", "message": "{message}", "hint": "{hint}"}}}}\n')
        else:
            sys.stderr.write(f"error: {message}\n hint: {hint}\n")
        sys.exit(1)
    last: list[Callable[[], None]] = []
    # registered before the exit functions of all libraries, so it runs after them
    atexit.register(lambda: [end() for end in last])
    from gyrotrack.apps.cli._app import main as run

    run(last)


def _address_space() -> float:
    """Return the limit of the address space [bytes]."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return float("inf")
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return float("inf") if limit == resource.RLIM_INFINITY else float(limit)
