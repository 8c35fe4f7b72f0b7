"""The sample study: four films of one run with their study.toml, in the checkout and in the installed package."""

from __future__ import annotations

from pathlib import Path


def sample_folder() -> Path | None:
    """Return the folder of the sample films (the checkout has priority); None if the films are not installed."""
    here = Path(__file__).resolve()
    places = (here.parents[2] / "sample_clips", here.parents[1] / "sample_clips")
    return next((p for p in places if (p / "study.toml").is_file()), None)
