"""The whole way of one clip: from the film to its recording."""

from __future__ import annotations

from gyrotrack.pipeline.extraction import extract, run_facts
from gyrotrack.pipeline.notes import frames_kept

__all__ = ["extract", "frames_kept", "run_facts"]
