"""The profile found by itself tracks as well as the true one, on films of the package's own renderer."""

import dataclasses

import numpy as np
import pytest

from gyrotrack import Profile, propose
from gyrotrack.synthetic._film import render_clip
from gyrotrack.synthetic._scene import BLUE, GREEN, PAPERS, RED, Camera, Light, Motion, Scene, Wobble
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._profile import MarkerProfile

pytestmark = pytest.mark.slow

LIGHT = Light(gradient=(0.2, -0.1), vignette=0.15, flicker=0.06, glint=0.2, shadow=0.4)


def linear(*rgb):
    return tuple((level / 255) ** 2 for level in rgb)


CYAN, ORANGE, MAGENTA, PURPLE, SPRING, YELLOW = (
    linear(*rgb)
    for rgb in (
        (20, 150, 170),
        (215, 110, 20),
        (180, 30, 150),
        (110, 40, 170),
        (150, 200, 40),
        (200, 180, 30),
    )
)
# casing and disc, then the two coloured papers of the rotor, with the names that fit them
SETS = {
    "paper": ((RED, "red"), (BLUE, "blue"), (GREEN, "green")),
    "cyan": ((CYAN, "cyan"), (MAGENTA, "magenta"), (ORANGE, "orange")),
    "spring": ((RED, "red"), (SPRING, "yellow"), (PURPLE, "magenta")),
    "yellow": ((YELLOW, "yellow"), (BLUE, "blue"), (RED, "red")),
}


@pytest.mark.release
@pytest.mark.parametrize(
    ("colours", "table", "white", "fps"),
    [
        ("paper", "white", True, 1000.0),
        ("paper", "wood", True, 260.0),
        ("cyan", "wood", True, 1000.0),
        ("cyan", "white", False, 260.0),
        ("spring", "grey", True, 1000.0),
        ("yellow", "wood", False, 1000.0),
    ],
)
def test_as_good_as_the_true_profile(tmp_path, colours, table, white, fps):
    names = dict(zip(("red", "blue", "green"), SETS[colours], strict=True))
    markers = [
        dataclasses.replace(m, colour=names[m.name][0]) if m.name in names else m
        for m in PAPERS
        if white or m.name != "white"
    ]
    span = np.linspace(-0.1, 2.0, 40)
    motion = Motion.from_speeds(span, 600.0 - 20 * span, 60.0 + 5 * span, 0.3, 0.7)
    scene = Scene(
        markers=tuple(markers),
        circle_colour=names["red"][0],
        table=table,
        wobble=Wobble(0.08, 3.4, phase=1.0),
    )
    camera = Camera(480, 360, fps, exposure=0.6e-3, scale=4.7, tilt=0.08)
    film = tmp_path / "film.mp4"
    truth = render_clip(film, scene, motion, camera, LIGHT, frames=300, seed=3)
    found = propose(film)
    body = {names[m.name][1] if m.name in names else m.name: m.body for m in markers}
    assert {m.profile.name: m.profile.body for m in found.markers} == body
    assert found.profile.circle_colour == names["red"][1]
    true = Profile(
        marker=tuple(MarkerProfile(name=n, colour=n, body=b) for n, b in body.items()),
        circle_colour=names["red"][1],
    )
    errors = [_errors(extract(film, profile), truth) for profile in (found.profile, true)]
    for name in ("casing", "rotor"):
        (mine, frames), (other, count) = (e[name] for e in errors)
        assert mine < 1.1 * other + 3e-5
        assert mine < 2.5e-3
        # the ring or the markers give the angles, whichever err less, and only the ring has an angle in every frame
        assert frames >= 0.98 * count


def _errors(recording, truth):
    found = {}
    for name, track in recording.bodies.items():
        frame = np.rint(track.time * recording.capture_fps).astype(int)
        off = track.angle - truth.angle[name][frame]
        found[name] = (np.std(off - np.median(off)), len(frame))
    return found
