"""A real wheel: one green tape, 300 fps in a 30 fps container, beside points marked by hand."""

from pathlib import Path

import numpy as np
import pytest

from gyrotrack.io._schema import STATUS
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._profile import load

ROOT = Path(__file__).parents[3]
FILM = ROOT.parent / "shared" / "real" / "bicycle_wheel_300fps.mp4"
OMEGA, ALPHA = 22.957, -0.396  # quadratic fit of the 67 points of the original project

pytestmark = pytest.mark.skipif(not FILM.exists(), reason="the film of the wheel is not here")


@pytest.fixture(scope="module")
def recording():
    return extract(FILM, load(ROOT / "docs" / "bicycle.toml"))


@pytest.mark.slow
def test_speed_and_deceleration_agree_with_the_points_marked_by_hand(recording):
    track = recording.bodies["rotor"]
    fit = np.polyfit(track.time, track.angle, 2)
    assert fit[1] == pytest.approx(OMEGA, rel=1e-3)
    assert 2 * fit[0] == pytest.approx(ALPHA, rel=0.02)
    assert np.degrees(np.std(track.angle - np.polyval(fit, track.time))) < 1.0


def test_the_tape_is_followed_through_the_film(recording):
    status = recording.markers["tape"].status
    assert np.isin(status[1:], [STATUS["ok"], STATUS["blurred"]]).mean() > 0.98
    assert len(recording.bodies["rotor"].time) > 410
    assert recording.sense == 1


def test_the_still_before_the_film_is_not_used(recording):
    assert recording.markers["tape"].status[0] == STATUS["lost"]
    assert recording.bodies["rotor"].time[0] > 0
    assert any("Frame 0" in text for text in recording.warnings)


def test_times_are_the_cameras_not_the_containers(recording):
    assert recording.capture_fps == 300
    assert recording.container_fps == pytest.approx(30)
    assert any("30 fps" in text for text in recording.warnings)
