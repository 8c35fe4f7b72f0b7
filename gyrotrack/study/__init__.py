"""A study: cases that are looked at together, their fits so far, and the next one."""

from __future__ import annotations

from gyrotrack.study.cases import Study, open_study, read_cases
from gyrotrack.study.wish import Wish, changed

__all__ = ["Study", "Wish", "changed", "open_study", "read_cases"]
