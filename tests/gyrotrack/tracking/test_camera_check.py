"""When a film is tested for a moving camera: before and after free bodies, without a hub or a compensated shake."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _any_body
from gyrotrack.tracking._diagnosis import MOSTLY_TRANSLATES


class CameraError(Exception):
    """Raised by the test of the camera."""


class SearchedError(Exception):
    """Raised by the search for a hub."""


def raises(error):
    def given(*_, **__):
        raise error

    return given


@pytest.mark.parametrize(
    ("hub", "margin", "error"),
    [(None, 0, CameraError), (None, 3, SearchedError), ((5.0, 5.0), 0, SearchedError)],
)
def test_the_camera_is_tested_without_hub_or_compensation(hub, margin, error, monkeypatch):
    track(monkeypatch, loose=None)
    with pytest.raises(error):
        _any_body._track(FILM, np.arange(30), [], hub, None, margin=margin)


def test_a_body_without_an_axle_is_found_before_a_picture_that_turns_about_no_hub_is_refused(monkeypatch):
    """Before, a camera is refused only if the picture mostly translates."""
    found, limits = SimpleNamespace(), []
    track(monkeypatch, loose=found)
    monkeypatch.setattr(_any_body, "refuse_moving_camera", lambda *words: limits.append(words[4:]))
    assert _any_body._track(FILM, np.arange(30), [], None, None) is found
    assert limits == [(MOSTLY_TRANSLATES,)]


FILM = SimpleNamespace(some=lambda frames: [], path=SimpleNamespace(name="film"))


def track(monkeypatch, loose):
    motion = SimpleNamespace(moving=np.ones((4, 4)), mean=np.zeros((4, 4)))
    monkeypatch.setattr(_any_body.Motion, "of", lambda *_: motion)
    monkeypatch.setattr(_any_body, "pairs_of", lambda *_: [])
    monkeypatch.setattr(_any_body, "track_by_features", lambda *_: loose)
    monkeypatch.setattr(_any_body, "refuse_moving_camera", raises(CameraError))
    for name in ("propose_hubs", "_trials"):
        monkeypatch.setattr(_any_body, name, raises(SearchedError))
