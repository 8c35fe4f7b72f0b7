"""The scene of a case, as its films were tracked, and the films rendered from it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.apps import _filming
from gyrotrack.apps._filming import Filming
from gyrotrack.synthetic._scene import Camera, Motion

SCALE = 4.7  # px/mm
PERIOD = 1 / 260
SLOWEST = 240.0  # rad/s


def paper(near, length, base, contrast, smear=0.0):
    """Return what `extract` stores of a paper: radii [px], half width at the middle [rad], chroma."""
    middle = near + 0.5 * length
    return {
        "inner": SCALE * near,
        "outer": SCALE * (near + length),
        "half_width": math.atan(0.5 * base / middle) + smear,
        "contrast": list(contrast),
    }


def film(fps, *, smear=0.0, stored=None, missing=()):
    papers = {
        "red": paper(16.5, 9.0, 6.0, (-10.6, 58.6)),
        "blue": paper(12.5, 9.0, 6.5, (44.2, -21.0), smear),
        "white": paper(12.5, 9.0, 6.5, (91.0, 0.0), smear),
    }
    bodies = {"red": "casing", "blue": "rotor", "white": "rotor"}
    mounts = {"red": 0.0, "blue": 0.4, "white": -2.1}
    omega = np.array([np.nan, 600.0, -SLOWEST if fps > 500 else 600.0])
    return SimpleNamespace(
        source="film.mp4", width=641, height=360, capture_fps=fps, container_fps=stored or fps, frames_decoded=500,
        sense=-1, centre=np.array([[320.0, 179.0], [np.nan, np.nan], [322.0, 181.0]]),
        markers={n: SimpleNamespace(body=b, mount_angle=mounts[n]) for n, b in bodies.items()},
        bodies={
            "casing": SimpleNamespace(sigma=np.array([1e-3, 3e-3, 2e-3]), omega=omega),
            "rotor": SimpleNamespace(sigma=np.array([4e-4, 5e-4, 6e-4]), omega=omega),
        },
        extra={
            "papers": {n: p for n, p in papers.items() if n not in missing}, "centre_from": "disc",
            "tilt": {"casing": {"p": 1e-4, "q": 1e-4, "angle": 0.05}},
        },
    )  # fmt: skip


def case(**changes):
    exposure = changes.pop("exposure", 1.5e-3)
    smear = 0.5 * SLOWEST * exposure * (1 - 260 / 1000)
    recordings = {
        "casing": film(260.0, smear=smear),
        "rotor_1": film(1000.0, stored=25.0),
        "rotor_0": film(1000.0),
    }
    placements = {"rotor_0": SimpleNamespace(clock_offset=2.0), "rotor_1": SimpleNamespace(clock_offset=9.0)}
    return SimpleNamespace(
        **({"bodies": "two", "recordings": recordings, "placements": placements} | changes)
    )


def test_the_scene_has_the_markers_that_were_tracked():
    found = Filming.of(case())
    red, blue, white = found.scene.markers
    assert (red.name, red.body, blue.body) == ("red", "casing", "rotor")
    scale = found.cameras[0].scale
    assert scale == pytest.approx(SCALE)
    assert (red.near, red.length, red.base) == pytest.approx((16.5, 9.0, 6.0))
    assert (blue.near, blue.length, blue.base) == pytest.approx((12.5, 9.0, 6.5))
    assert (blue.mount, white.mount) == (0.4, -2.1)
    assert red.colour[0] > 4 * max(red.colour[1:])
    assert blue.colour[2] > 2 * max(blue.colour[:2])
    assert min(white.colour) > 0.8


def test_the_cameras_are_those_of_the_films():
    found = Filming.of(case())
    casing, first, second = found.cameras
    assert (casing.fps, casing.start) == (260.0, pytest.approx(PERIOD))
    assert (first.start, second.start) == pytest.approx((2.001, 9.001))
    assert (first.container_fps, second.container_fps) == (1000.0, 25.0)
    assert (casing.width, casing.height, casing.sense) == (640, 360, -1)
    assert casing.centre == pytest.approx((321.0, 180.0))
    assert (casing.tilt, casing.tilt_azimuth) == pytest.approx((0.05, math.pi / 8))
    assert found.frames == (498, 498, 498)
    assert found.sigma == pytest.approx((2e-3, 5e-4, 5e-4))


@pytest.mark.parametrize(
    ("exposure", "expected"),
    [
        (1.5e-3, 1.5e-3),
        (0.97 * PERIOD, 0.4 * PERIOD),
        (0.01 * PERIOD, 0.4 * PERIOD),
        (0.9 * PERIOD, 0.9 * PERIOD),
    ],
)
def test_the_exposure_follows_from_the_smear_of_the_markers(exposure, expected):
    cameras = Filming.of(case(exposure=exposure)).cameras
    assert cameras[0].exposure == pytest.approx(expected, rel=1e-6)
    assert cameras[1].exposure == pytest.approx(expected * 260 / 1000, rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"recordings": {}}, "was not made from films"),
        ({"recordings": {"casing": film(260.0)}}, "was not made from films"),
        ({"bodies": "one"}, "was not made from films"),
        (
            {"recordings": {"casing": film(260.0, missing=("red",)), "rotor_0": film(1000.0)}},
            "marker of the casing",
        ),
        (
            {"recordings": {"casing": film(260.0), "rotor_0": film(1000.0, missing=("blue", "white"))}},
            "marker of the rotor",
        ),
    ],
)
def test_a_case_without_films_is_refused(changes, message):
    with pytest.raises(DatasetError, match=message):
        Filming.of(case(**changes))


@pytest.mark.parametrize(("scatter", "noise"), [(0.5, 1.0), (2.0, 4.0), (100.0, 12.0), (0.01, 0.3)])
def test_the_noise_is_that_at_which_a_trial_scatters_like_the_recordings(
    monkeypatch, tmp_path, scatter, noise
):
    """Recordings that scatter twice as much as the trial have twice its noise of 2 grey levels, within limits."""
    found = Filming.of(case())
    rendered = []
    monkeypatch.setattr(
        _filming, "render_clip", lambda path, *a, **k: rendered.append((path.name, a[2].noise, k))
    )
    body = {b: SimpleNamespace(sigma=np.array([s / scatter])) for b, s in (("casing", 2e-3), ("rotor", 5e-4))}
    monkeypatch.setattr(_filming, "_extracted", lambda *_: SimpleNamespace(bodies=body))
    motion = Motion.constant(300.0, 20.0)
    made = found.with_measured_noise(motion, tmp_path, lambda _: {}, 5)
    assert [c.noise for c in made.cameras] == pytest.approx([noise] * 3)
    assert [name for name, *_ in rendered] == ["trial_0.mp4", "trial_1.mp4"]
    assert {n for _, n, _ in rendered} == {2.0}
    assert made.scene is found.scene


def test_films_are_tracked_and_synchronised_with_the_options_given(monkeypatch, tmp_path):
    said = []

    def run(words):
        said.append(list(words))
        (tmp_path / words[words.index("-o") + 1]).write_bytes(b"")
        return {}

    monkeypatch.setattr(_filming, "render_clip", lambda path, *_, **__: path.write_bytes(b""))
    monkeypatch.setattr(_filming, "read_recording", lambda path: path)
    found = Filming.of(case())
    made = found.recorded(Motion.constant(300.0, 20.0), tmp_path, run, ["--label", "x"], 1)
    assert made == tmp_path / "case.h5"
    assert [w[0] for w in said] == ["extract"] * 3 + ["sync"]
    assert said[0][said[0].index("--capture-fps") + 1] == "260"
    assert said[2][said[2].index("--capture-fps") + 1] == "1000"
    assert said[3][-2:] == ["--label", "x"]
    assert not list(tmp_path.glob("*.mp4"))


def test_a_film_that_cannot_be_tracked_ends_the_chain(monkeypatch, tmp_path):
    monkeypatch.setattr(_filming, "render_clip", lambda path, *_, **__: path.write_bytes(b""))
    found = Filming.of(case())
    assert found.recorded(Motion.constant(300.0, 20.0), tmp_path, lambda _: {}, [], 1) is None


def test_grey_levels_of_a_colour_return_to_its_chroma():
    red, green, blue = (255 * x ** (1 / Camera().gamma) for x in _filming._colour(-10.6, 58.6))
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    assert (blue - luma) / 1.772 == pytest.approx(-10.6, abs=0.5)
    assert (red - luma) / 1.402 == pytest.approx(58.6, abs=0.5)
