"""Films as the world makes them: a rotor below the casing, flickering lamps, a hand at the start, lost markers."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.apps.cli._app import run
from gyrotrack.tracking import _acquisition
from gyrotrack.tracking._acquisition import (
    Extent,
    Rings,
    SampledMarker,
    acquire,
    extent_of,
    find_coloured,
    find_white,
)
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._polar import Ring
from gyrotrack.tracking._profile import PAPER, chroma_direction
from gyrotrack.tracking._scene import Marker, take_samples

SMALL = {"width": 320, "height": 240, "radius": 105.0, "wobble": 0.3}


def _errors(recording, film, body):
    track = recording.bodies[body]
    frame = np.rint(track.time * recording.capture_fps).astype(int)
    error = track.angle - getattr(film, body)(film.time)[frame]
    return error - np.median(error), track


DEEP = {
    **SMALL,
    "frames": 240,
    "tilt": 0.15,
    "tilt_azimuth": 0.5,
    "depth": 0.35,
    "casing": lambda t: 20.0 * t,
}


@pytest.mark.slow
def test_a_rotor_below_the_casing_is_followed_about_its_own_orbit(draw):
    path, film = draw(**DEEP)
    scene = acquire(take_samples(path), PAPER, "film")
    # A point at depth d in a picture tilted by t about the azimuth a is moved by -d sin t (cos a, sin a), y up.
    shift = 0.35 * 105.0 * np.sin(0.15)
    expected = (-shift * np.cos(0.5), shift * np.sin(0.5))
    assert scene.offsets["rotor"] == pytest.approx(expected, abs=0.7)
    assert "casing" not in scene.offsets

    recording = extract(path)
    for body in ("casing", "rotor"):
        error, track = _errors(recording, film, body)
        assert len(track.time) >= 0.95 * film.frames, body
        assert np.abs(error).max() < 0.05, body
        assert np.std(error) < 4e-3, body
        assert np.std(error / track.sigma) < 1.6, body


@pytest.mark.slow
def test_the_depth_of_the_rotor_is_not_that_of_the_casing_on_an_arc(draw):
    path, film = draw(**{**DEEP, "fps": 1000.0, "casing": lambda t: 0.4 + 12.0 * t})  # 2.9 rad in all
    error, track = _errors(extract(path), film, "casing")
    assert np.std(error) < 4e-3
    assert np.std(error / track.sigma) < 1.6


@pytest.mark.slow
@pytest.mark.parametrize("flicker", [0.12, 0.25])
def test_flicker_makes_no_repeated_frames(draw, flicker):
    path, film = draw(**{**SMALL, "frames": 240, "flicker": flicker, "noise": 2.0})
    recording = extract(path)
    assert recording.extra["repeated_frames"] == 0
    error, track = _errors(recording, film, "rotor")
    assert len(track.time) >= 0.95 * film.frames
    assert np.abs(error).max() < 0.1


@pytest.mark.slow
def test_a_hand_in_the_first_frames_is_not_a_marker(draw):
    def hand(k, picture):
        if k < 50:
            place = (250 - k, 120)
            cv2.ellipse(picture, place, (60, 28), 20.0, 0.0, 360.0, (215.0, 120.0, 95.0), cv2.FILLED)
        return picture

    path, film = draw(**{**SMALL, "frames": 400}, edit=hand)
    recording = extract(path)
    for body in ("casing", "rotor"):
        error, track = _errors(recording, film, body)
        late = track.time > 60 / film.fps
        assert late.sum() >= 0.95 * (film.frames - 60)
        assert np.abs(error[late]).max() < 0.1, body


@pytest.mark.slow
def test_what_is_lost_is_said(draw, tmp_path):
    path, _ = draw(**{**SMALL, "frames": 150, "white": None})
    assert run(["extract", str(path), "-q", "-o", str(tmp_path / "film.h5")]) == 3
    recording = extract(path)
    assert recording.extra["doubts"] == [
        "No white marker is found on the rotor. Check the film and the profile (--profile)."
    ]
    assert recording.extra["doubts"][0] in recording.warnings


@pytest.mark.slow
def test_lost_frames_are_said(draw):
    def dark(k, picture):
        return 0.0 * picture if 60 <= k < 120 else picture

    path, _ = draw(**{**SMALL, "frames": 180}, edit=dark)
    doubts = " ".join(extract(path).extra["doubts"])
    assert "The casing has an angle in 1" in doubts
    assert "of 180 frames" in doubts


@pytest.mark.slow
def test_the_roll_of_a_hand_held_camera_is_subtracted(draw):
    """A roll of 6 mrad is no motion of the bodies: the background shows it."""
    spots = np.random.default_rng(4).uniform(0, [320, 240], (150, 2))
    spots = spots[np.hypot(*(spots - [160, 120]).T) > 115]

    def rolled(k, picture):
        for x, y in spots:
            cv2.circle(picture, (round(x), round(y)), 3, (60.0, 60.0, 60.0), cv2.FILLED)
        t = k / 260
        move = cv2.getRotationMatrix2D((159.5, 119.5), np.degrees(8.5e-3 * np.sin(40.0 * t)), 1.0)
        move[:, 2] += 2.0 * np.sin(50.0 * t), 1.5 * np.sin(33.0 * t + 1.0)
        return cv2.warpAffine(
            picture, move, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )

    path, film = draw(**{**SMALL, "frames": 200}, edit=rolled)
    recording = extract(path)
    assert any("rolls by" in warning for warning in recording.warnings)
    for body in ("casing", "rotor"):
        error, track = _errors(recording, film, body)
        assert len(track.time) >= 0.95 * film.frames, body
        assert np.std(error) < 4e-3, body
        assert np.std(error / track.sigma) < 1.6, body


def test_a_marker_that_turns_with_the_other_body_is_on_that_body():
    """Orange on a rotor is the red of the profile's casing, where the casing has another colour."""
    turn = np.linspace(0.0, 9.0, 30)

    def seen(name, body, angle):
        marker = Marker(name, body, name, 20.0, 40.0, 0.2, (-30.0, 25.0), 0.3)
        return SampledMarker(marker, np.asarray(angle), np.ones(len(angle), dtype=bool))

    right = {"red": seen("red", "casing", 0.1 * turn), "blue": seen("blue", "rotor", turn)}
    assert _acquisition._on_other_body(right, "film") == []
    still = {"red": seen("red", "casing", 0 * turn), "blue": seen("blue", "rotor", 1.0 + 0 * turn)}
    assert _acquisition._on_other_body(still, "film") == []
    wrong = {"red": seen("red", "casing", turn + 1.0), "blue": seen("blue", "rotor", turn)}
    with pytest.raises(TrackingError, match="turn together in film"):
        _acquisition._on_other_body(wrong, "film")
    green = seen("green", "rotor", turn - 2.0)
    assert _acquisition._on_other_body({**wrong, "green": green}, "film") == ["red"]
    assert _acquisition._on_other_body({**right, "green": seen("green", "rotor", 0.1 * turn)}, "film") == [
        "green"
    ]


@pytest.mark.slow
def test_colours_of_another_profile_give_no_angles_of_a_wrong_body(draw, tmp_path):
    magenta, orange = (160, 20, 165), (230, 120, 20)
    path, film = draw(**{**SMALL, "frames": 150, "red": magenta, "disc": magenta, "white": orange})
    assert run(["extract", str(path), "-q", "-o", str(tmp_path / "film.h5")]) == 3
    recording = extract(path)
    assert set(recording.bodies) == {"rotor"}
    assert (
        "The red marker of the casing turns with the markers of the other body"
        in recording.extra["doubts"][0]
    )
    assert np.abs(_errors(recording, film, "rotor")[0]).max() < 0.1


def test_a_marker_on_a_coloured_background_is_measured_in_its_own_hue():
    """Green paper on brass differs from it by another hue than green: nearly 45 degrees, where the score ends."""
    ring = Ring((160.0, 120.0), 20.0, 100.0, 81, 512)
    rng = np.random.default_rng(2)
    strips = np.full((2, 40, 81, 512), 128.0)
    strips[0], strips[1] = np.linspace(115.0, 108.0, 81)[:, None], 141.0  # brass under a lamp
    for k in range(40):
        columns = (np.arange(-15, 16) + 37 * k) % 512
        strips[0, k, 25:60, columns], strips[1, k, 25:60, columns] = 112.0, 104.0  # green: about (0, -37)
    strips += rng.normal(0.0, 1.5, strips.shape)
    found = find_coloured(Rings(np.clip(strips, 0, 255).astype(np.uint8), ring), PAPER.marker[3])
    assert PAPER.marker[3].colour == "green"
    assert (found.marker.inner, found.marker.outer) == pytest.approx((45.0, 79.0), abs=1.5)
    assert found.marker.half_width == pytest.approx(15.5 * ring.step, abs=0.02)
    assert np.all(found.clear)


def test_the_edges_of_a_coloured_marker_are_not_the_white_marker():
    """A red marker is brighter than the white one, up to 1.5 half widths."""
    ring, half_width = Ring((160.0, 120.0), 20.0, 60.0, 41, 512), 0.2
    turn = np.arange(24) * 100 * ring.step
    apart = np.angle(np.exp(1j * (np.arange(512) * ring.step - turn[:, None])))
    red = np.abs(apart) < 1.5 * half_width
    white = np.abs(np.angle(np.exp(1j * (apart - 2.0)))) < half_width
    luma = np.full((24, 41, 512), 60.0)
    luma[:, 10:31] += (190.0 * red + 30.0 * white)[:, None]
    seen = Marker("red", "rotor", "red", 30.0, 50.0, half_width, (-30.0, 25.0), 0.3)
    others = [SampledMarker(seen, turn, np.ones(24, dtype=bool))]
    samples = SimpleNamespace(luma_strips=lambda ring, frames: luma)
    found = find_white(samples, range(24), ring, PAPER.marker[0], others)
    assert found.mount == pytest.approx(2.0, abs=ring.step)
    assert found.contrast[0] == pytest.approx(30.0, abs=1.0)


@pytest.mark.slow
def test_a_casing_that_is_faster_than_its_rotor_is_reported_with_the_commands_that_exchange_them(draw):
    path, _ = draw(**{**SMALL, "frames": 60, "casing": lambda t: 90.0 * t, "rotor": lambda t: 1.0 + 20.0 * t})
    (told,) = (text for text in extract(path).warnings if "faster than the rotor" in text)
    assert "90.0 and 20.0 rad/s" in told
    assert f"`gyrotrack extract {path.name} --profile P.toml`" in told


STEP = 2 * np.pi / 360
RING = Ring((0.0, 0.0), 40.0, 62.0, 12, 360)


class TestWhite:
    """A white marker of 40 grey levels beside one of half width 6 degrees; rows 3 to 8 are at its radii."""

    OTHER = SimpleNamespace(marker=SimpleNamespace(inner=45.0, outer=57.0, half_width=6.0 * STEP, mount=0.0))

    def found(self, *, half=6, ground=0.0, least=6.0, height=40.0):
        turned = np.zeros((12, 360))
        # a ground of slow waves, away from the marker
        turned[:] = ground * np.where(np.arange(360) // 60 % 2, 1.0, -1.0)
        turned[:, 150:250] = 0.0
        turned[3:9, 200 - half : 201 + half] = height
        return _acquisition._brightest_place(turned, RING, PAPER.marker[0], [self.OTHER], least)

    @pytest.mark.parametrize(("half", "width"), [(6, True), (16, True), (19, False)])
    def test_its_width_is_limited_by_that_of_the_others(self, half, width):
        """2.5 times 6 degrees and 0.05 rad are 17.9 degrees."""
        found = self.found(half=half)
        assert (found is not None) == width
        if width:
            assert found.mount == pytest.approx(200 * STEP)
            assert found.half_width == pytest.approx((half + 0.5) * STEP)
            assert found.contrast == pytest.approx((40.0, 0.0))

    @pytest.mark.parametrize(("least", "seen"), [(39.0, True), (41.0, False)])
    def test_its_contrast_has_a_limit(self, least, seen):
        assert (self.found(least=least) is not None) == seen

    @pytest.mark.parametrize(("share", "clear"), [(0.9, True), (1.1, False)])
    def test_it_is_five_times_the_scatter_of_the_ring(self, share, clear):
        """That of the moving average over 13 columns, where the marker is not."""
        assert (self.found(ground=share * 40.0 / 5.0 / 1.4826) is not None) == clear

    @pytest.mark.parametrize(("count", "enough"), [(7, False), (8, True)])
    def test_it_turns_with_the_body(self, monkeypatch, count, enough):
        asked = []
        monkeypatch.setattr(
            _acquisition,
            "_brightest_place",
            lambda turned, *given: asked.append((turned, *given)) or "marker",
        )
        body = np.rint(np.linspace(0.0, 330.0, 10)).astype(int)
        strips = np.full((10, 12, 360), 50, np.uint8)
        for strip, column in zip(strips, body, strict=True):
            strip[3:9, (column + 30 + np.arange(-3, 4)) % 360] = 200
        samples = SimpleNamespace(luma_strips=lambda ring, frames: strips)
        seen = SimpleNamespace(marker=self.OTHER.marker, angle=body * STEP, clear=np.arange(10) < count)
        found = find_white(samples, range(10), RING, "wanted", [seen], 6.0)
        assert found == ("marker" if enough else None)
        if enough:
            ((turned, ring, wanted, others, least),) = asked
            assert (ring, wanted, others, least) == (RING, "wanted", [seen], 6.0)
            expected = np.zeros((12, 360))
            expected[3:9, 27:34] = 150.0
            assert turned == pytest.approx(expected)


@pytest.mark.parametrize(
    ("noise", "peaks", "threshold"),
    [(1.0, (9.0, 9.0, 9.0), 6.0), (2.0, (9.0, 9.0, 9.0), 8.0), (1.0, (20.0, 90.0, 30.0), 12.0)],
)
def test_blobs_exceed_the_noise_and_a_part_of_the_typical_peak(monkeypatch, noise, peaks, threshold):
    monkeypatch.setattr(_acquisition, "find_blobs", lambda score, limit, most: (limit, most))
    scores = []
    for peak in peaks:
        score = np.full((40, 50), noise, np.float32)
        score[:5, :10] = peak
        scores.append(score)
    assert _acquisition._blobs_in(scores, 7) == [(pytest.approx(threshold), 7)] * 3


@pytest.mark.parametrize(("contrast", "seen"), [(5.0, False), (8.0, True)])
def test_a_coloured_marker_has_a_contrast_of_six_grey_levels(contrast, seen):
    strips = np.full((2, 30, 12, 360), 128, np.uint8)
    u, v = chroma_direction("blue")
    wanted = next(m for m in PAPER.marker if m.colour == "blue")
    for k in range(30):
        columns = (np.arange(-6, 7) + 37 * k) % 360
        strips[0, k, 3:9, columns] = np.rint(128 + contrast * u)
        strips[1, k, 3:9, columns] = np.rint(128 + contrast * v)
    found = find_coloured(Rings(strips, RING), wanted)
    assert (found is not None) == seen
    if seen:
        assert np.hypot(*found.marker.contrast) == pytest.approx(contrast, abs=0.8)
        assert found.clear.all()
        assert np.exp(1j * found.angle) == pytest.approx(np.exp(37j * np.arange(30) * STEP), abs=0.1 * STEP)
        # at most two of the thirty angles are within 1.3 half widths, 8.5 degrees, of one; three within twice that
        assert found.marker.dwell == pytest.approx(2 / 30)


class TestExtent:
    """A patch of 12 rows and 81 columns of one degree each, with the marker in rows 3 to 8."""

    @pytest.mark.parametrize("lean", [-4, 0, 4])
    def test_it_is_the_region_above_half_of_the_maximum(self, lean):
        patch = np.zeros((12, 81))
        patch[3:9, 40 + lean - 6 : 40 + lean + 7] = 1.0
        found = extent_of(patch, Ring((0.0, 0.0), 40.0, 62.0, 12, 360))
        assert np.flatnonzero(found.rows).tolist() == [3, 4, 5, 6, 7, 8]
        assert found.lean == lean
        assert found.half_width == pytest.approx(6.5 * STEP)
        assert (found.inner, found.outer) == pytest.approx((45.0, 57.0))  # between two rows of 2 px
        assert found.foot == pytest.approx(6.9 * STEP)
        core = found.core(81, STEP)
        assert np.flatnonzero(core.any(axis=1)).tolist() == [3, 4, 5, 6, 7, 8]
        assert np.flatnonzero(core.any(axis=0)).tolist() == list(range(40 + lean - 3, 40 + lean + 4))

    @pytest.mark.parametrize("lean", [-12, 3, 12])
    def test_the_mean_well_inside_a_marker(self, lean):
        """Beside its expected column; the surroundings are negative."""
        columns = np.array([10, 200, 355])
        strips = np.full((3, 12, 360), -9.0, dtype=np.float32)
        for strip, column in zip(strips, columns, strict=True):
            strip[3:9, (column + lean + np.arange(-5, 6)) % 360] = 2.0
        rows = np.zeros(12, dtype=bool)
        rows[3:9] = True
        extent = Extent(rows, 45.0, 57.0, 9.0 * STEP, lean)
        found = _acquisition._mean_in(
            strips, columns, np.ones(3, dtype=bool), extent, Ring((0.0, 0.0), 40.0, 62.0, 12, 360)
        )
        assert found == pytest.approx(2.0)

    def test_a_patch_without_a_score_has_no_extent(self):
        assert extent_of(np.full((12, 81), -1.0), Ring((0.0, 0.0), 40.0, 62.0, 12, 360)) is None


def test_an_angle_is_refined_by_the_centroid_of_the_score():
    ring = Ring((0.0, 0.0), 40.0, 62.0, 12, 360)
    true = np.array([100.3, 359.6, 2.2])
    apart = (np.arange(360) - true[:, None] + 180) % 360 - 180
    profile = np.clip(6.0 - np.abs(apart), 0.0, 1.0) + 5.0  # above an even ground
    coarse = np.array([101.4, 358.0, 2.4]) * STEP
    assert _acquisition._refined(profile, coarse, 6.0 * STEP, ring) == pytest.approx(
        true * STEP, abs=0.05 * STEP
    )


def test_the_angle_of_a_body_is_that_of_its_clear_markers_without_their_mounts():
    def seen(mount, clear):
        marker = SimpleNamespace(mount=mount)
        return SimpleNamespace(
            marker=marker, angle=mount + np.array([0.3, 3.5, 1.0, 9.0]), clear=np.array(clear)
        )

    both = [seen(0.4, [True, True, False, True]), seen(-2.0, [True, False, False, True])]
    assert _acquisition._body_angles(both, 3)[:2] == pytest.approx([0.3, 3.5 - 2 * np.pi])
    assert np.isnan(_acquisition._body_angles(both, 3)[2])


@pytest.mark.parametrize(("peak", "clear"), [(0.51, True), (0.49, False)])
def test_a_marker_is_clear_with_half_of_its_typical_score(peak, clear):
    profile = np.zeros((5, 60), dtype=np.float32)
    height = np.array([1.0, 1.0, 1.0, peak, 1.0])
    for row, column, h in zip(profile, (5, 59, 30, 17, 0), height, strict=True):
        row[(column + np.arange(-2, 3)) % 60] = h
    column, found = _acquisition._brightest(profile, 2)
    assert column.tolist() == [5, 59, 30, 17, 0]
    assert found.tolist() == [True, True, True, clear, True]


@pytest.mark.parametrize(("reach", "share"), [(0.09, 0.5), (0.11, 0.75)])
def test_a_marker_dwells_where_most_of_its_angles_are(reach, share):
    assert _acquisition._dwell(np.array([3.1, 3.1, 3.2 - 2 * np.pi, 1.0]), reach) == share
