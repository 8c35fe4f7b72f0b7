"""Putting two cameras on one clock by the casing, which both of them see: `synchronise`."""

from __future__ import annotations

from gyrotrack.sync.assembly import Synchronised, synchronise
from gyrotrack.sync.decision import Match, Rival, match_clips

__all__ = ["Match", "Rival", "Synchronised", "match_clips", "synchronise"]
