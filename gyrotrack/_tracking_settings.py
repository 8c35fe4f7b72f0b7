"""The settings of tracking: every number of a decision, with unit, meaning and origin (`fitting._settings`)."""

from __future__ import annotations

from fitting._settings import Settings, settings_in

PACKAGES = ("gyrotrack.tracking", "gyrotrack.video", "gyrotrack.synchronisation")


def tracking_settings() -> Settings:
    """Collect the settings of tracking, video and synchronisation."""
    return settings_in(*PACKAGES)
