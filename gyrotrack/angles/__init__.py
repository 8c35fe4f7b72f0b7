"""Angles of markers and bodies: measured in each frame, with uncertainties, joined, smoothed."""

from __future__ import annotations

from gyrotrack.angles.velocity import angular_velocity, median_smooth

__all__ = ["angular_velocity", "median_smooth"]
