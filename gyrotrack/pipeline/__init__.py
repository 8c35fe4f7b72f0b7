"""The whole way of one clip: from the film to its recording."""

from __future__ import annotations

from gyrotrack.pipeline.extraction import extract

__all__ = ["extract"]
