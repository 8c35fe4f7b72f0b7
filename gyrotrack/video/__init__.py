"""Films: opening them safely, decoding them in order, and knowing when each frame was captured.

Three parts: `container` opens a file and says what it declares, `planes` turns decoded frames into numpy
views of their luma and chroma, `clock` decides the capture rate and finds what the time stamps give away.
A film is read from its first frame to its last; frames are counted here, never taken from a header.
"""

from __future__ import annotations

from gyrotrack.video.clock import CaptureRate, capture_rate, frame_numbers, stamp_warnings
from gyrotrack.video.container import ClipInfo, file_sha256, probe
from gyrotrack.video.packets import keyframes, read_packets, read_raw_stamps
from gyrotrack.video.picking import frames_at
from gyrotrack.video.planes import Frame
from gyrotrack.video.reader import Mark, Reader
from gyrotrack.video.repeats import Repeats

__all__ = [
    "CaptureRate",
    "ClipInfo",
    "Frame",
    "Mark",
    "Reader",
    "Repeats",
    "capture_rate",
    "file_sha256",
    "frame_numbers",
    "frames_at",
    "keyframes",
    "probe",
    "read_packets",
    "read_raw_stamps",
    "stamp_warnings",
]
