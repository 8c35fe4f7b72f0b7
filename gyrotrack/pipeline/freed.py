"""Memory that was freed, given back to the system.

The allocator of glibc keeps what is freed for later, and frames of some size that came and went leave it with a heap
full of holes. At the few places where much is done with, it is asked to give back what it can; elsewhere nothing is
done.
"""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress


def give_back() -> None:
    """Give back to the system what was freed."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another libc than glibc
            ctypes.CDLL(None).malloc_trim(0)
