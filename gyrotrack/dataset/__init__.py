"""The files that tracking writes and fitting reads; this package is the only one here that knows HDF5."""

from __future__ import annotations

from gyrotrack.dataset.case import write_case
from gyrotrack.dataset.reading import read_case, read_kind, read_recording, read_settings
from gyrotrack.dataset.recording import write_recording
from gyrotrack.dataset.records import (
    STATUS,
    BodyTrack,
    Case,
    GeneratedCurve,
    MarkerTrack,
    Placement,
    Recording,
    Series,
)

__all__ = [
    "STATUS",
    "BodyTrack",
    "Case",
    "GeneratedCurve",
    "MarkerTrack",
    "Placement",
    "Recording",
    "Series",
    "read_case",
    "read_kind",
    "read_recording",
    "read_settings",
    "write_case",
    "write_recording",
]
