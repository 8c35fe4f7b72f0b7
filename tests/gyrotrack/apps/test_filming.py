"""The scene of a case, as its films were tracked, and the films rendered from it."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.apps import _filming
from gyrotrack.apps._filming import Filming
from gyrotrack.synthetic._scene import WHITE, Camera, Motion, Scene

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


@pytest.mark.parametrize("chroma", [(-10.6, 58.6), (44.2, -21.0), (0.0, 5.1), (30.0, -80.0), (-90.0, 90.0)])
def test_a_colour_has_the_luma_of_a_marker(chroma):
    """BT.601 at the luma 110, in linear light, within 2 and 95 % of the range."""
    cb, cr = chroma
    grey = np.array([110.0 + 1.402 * cr, 110.0 - 0.344 * cb - 0.714 * cr, 110.0 + 1.772 * cb])
    expected = np.clip(grey / 255.0, 0.02, 0.95) ** Camera().gamma
    assert _filming._colour(cb, cr) == pytest.approx(tuple(expected))


@pytest.mark.parametrize(("cr", "white"), [(4.9, True), (-4.9, True), (5.1, False), (-5.1, False)])
def test_a_marker_without_red_chroma_is_white(cr, white):
    assert (_filming._colour(60.0, cr) == WHITE) == white


def _smeared(widths, omegas, fps=(250.0, 1000.0)):
    """The casing's film, and rotor films of given speeds; half widths of two markers in slow and fast film."""

    def made(rate, index, omega):
        papers = {n: {"half_width": w[index]} for n, w in widths.items()}
        return SimpleNamespace(
            capture_fps=rate, extra={"papers": papers},
            markers={n: SimpleNamespace(body="casing" if n == "red" else "rotor") for n in widths},
            bodies={} if omega is None else {"rotor": SimpleNamespace(omega=np.array(omega))},
        )  # fmt: skip

    return made(fps[0], 0, [9.0]), [made(fps[1], 1, o) for o in omegas]


def test_the_exposure_is_twice_the_difference_of_the_widths_by_the_slowest_speed():
    widths = {"red": (9.0, 1.0), "blue": (0.25, 0.1), "white": (0.35, 0.1), "green": (0.3, 0.1)}
    casing, rotor = _smeared(widths, [[np.nan, -300.0, 400.0], None, [250.0, 260.0]])
    # the median difference of the markers of the rotor is 0.2 rad; a quarter of the exposure is in both films
    assert _filming._exposure(casing, rotor) == pytest.approx(2.0 * 0.2 / 250.0 / 0.75)
    usual = 0.4 / 250.0
    assert _filming._exposure(casing, [rotor[1]]) == usual  # no speed
    still = _smeared(widths, [[0.0, 300.0]])
    assert _filming._exposure(*still) == usual
    assert _filming._exposure(*_smeared(widths, [[250.0]], (1000.0, 1000.0))) == 0.4 / 1000.0
    assert _filming._exposure(*_smeared({"red": (0.3, 0.1)}, [[250.0]])) == usual


@pytest.mark.parametrize(("share", "known"), [(0.019, False), (0.021, True), (0.949, True), (0.951, False)])
def test_an_exposure_is_between_2_and_95_percent_of_the_period(share, known):
    found = _filming._exposure(*_smeared({"blue": (0.1 + share / 250.0 * 250.0 * 0.75 / 2, 0.1)}, [[250.0]]))
    assert found == pytest.approx((share if known else 0.4) / 250.0)


def test_a_camera_without_a_tilt_looks_along_the_axis():
    one = film(500.0)
    one.extra = {"tilt": {"casing": None}}
    found = _filming._camera(one, 3.0, SCALE, 0.25)
    assert (found.tilt, found.tilt_azimuth) == (0.0, 0.0)
    assert (found.exposure, found.start) == (pytest.approx(5e-4), pytest.approx(3.002))
    one.extra = {"tilt": {"casing": {"p": 0.0, "q": -0.1, "angle": 0.3}}}
    assert _filming._camera(one, 3.0, SCALE, 0.25).tilt_azimuth == pytest.approx(-math.pi / 4)


@pytest.mark.parametrize(("centre", "metal"), [("disc", False), ("orbits", True)])
def test_the_circle_has_a_colour_if_it_was_tracked(centre, metal):
    some = case()
    some.recordings["casing"].extra["centre_from"] = centre
    colour = Filming.of(some).scene.circle_colour
    usual = Scene()
    assert colour == ((usual.metal,) * 3 if metal else usual.circle_colour)


def test_films_are_rendered_with_their_cameras_frames_and_seeds(monkeypatch, tmp_path):
    rendered = []

    def render(path, scene, motion, camera, light, *, frames, seed):
        rendered.append((path.name, camera, frames, seed))
        path.write_bytes(b"")

    monkeypatch.setattr(_filming, "render_clip", render)
    monkeypatch.setattr(_filming, "_extracted", lambda *_: SimpleNamespace(bodies={}))
    found = Filming.of(case())
    found = replace(found, frames=(498, 2000, 1300))
    motion = Motion.constant(300.0, 20.0)
    made = found.with_measured_noise(motion, tmp_path, None, 5)
    assert [(name, frames, seed) for name, _, frames, seed in rendered] == [
        ("trial_0.mp4", 498, 5),
        ("trial_1.mp4", 1200, 5),
    ]
    assert [c.fps for _, c, *_ in rendered] == [260.0, 1000.0]
    assert [c.noise for c in made.cameras] == [2.0] * 3  # unknown bodies: the noise of the trial
    rendered.clear()
    assert found.recorded(motion, tmp_path, lambda _: {}, [], 5) is None  # `sync` failed
    assert [(name, frames, seed) for name, _, frames, seed in rendered] == [
        ("casing.mp4", 498, 5),
        ("rotor_1.mp4", 2000, 6),
        ("rotor_2.mp4", 1300, 7),
    ]
    assert [c for _, c, *_ in rendered] == list(found.cameras)
