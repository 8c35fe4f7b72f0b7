"""Files in TOML that a user writes: read with a limit, checked, and every fault named by line and key."""

from __future__ import annotations

from gyrotrack.configuration.document import read_document

__all__ = ["read_document"]
