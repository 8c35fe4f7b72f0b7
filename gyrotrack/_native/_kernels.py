"""The compiled kernels, or None where they were not compiled."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from types import ModuleType

EDITION = 5
"""What this source needs; an older build that was left in place is not used."""

loops: ModuleType | None = None
with suppress(ImportError):
    loops = import_module("gyrotrack._native._compiled")
if getattr(loops, "EDITION", None) != EDITION:
    loops = None
