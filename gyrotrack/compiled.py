"""The compiled inner loops; None where they could not be compiled, and NumPy and OpenCV do the same, more slowly."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from types import ModuleType

EDITION = 5
"""What this source needs; an older build that was left in place is not used."""

loops: ModuleType | None = None
with suppress(ImportError):
    loops = import_module("gyrotrack._compiled")
if getattr(loops, "EDITION", None) != EDITION:
    loops = None
