"""A camera that shakes is compensated by the background that stands still; its share of the uncertainty is stated."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pytest

from gyrotrack import read_case
from gyrotrack.tracking import _camera_motion, _extract, _film_tracker
from gyrotrack.tracking._any_body import track_body
from gyrotrack.tracking._camera_motion import Shake, background_roll, camera_shake
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._film import Film
from gyrotrack.tracking._film_tracker import BodyObservations, FilmObservations, FilmTracker
from gyrotrack.tracking._frame_repeats import left_out
from gyrotrack.tracking._hub import FAST, moves_fast
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._texture import TextureObservations, TextureTracker
from gyrotrack.video._container import Frame

REAL = Path(__file__).parents[4] / "shared" / "real"
SIZE = 240, 320


def wall(rng):
    """A background with texture."""
    coarse = cv2.GaussianBlur(rng.normal(0, 1, SIZE), (0, 0), 3)
    return 120 + 40 * coarse / coarse.std()


@cache
def plane():
    """Direction from the middle of the disc, and where the disc covers the background."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] - np.array([120.3, 159.7])[:, None, None]
    edge = 1 / (1 + np.exp(np.hypot(x, y) - 60))
    return np.arctan2(-y, x).astype(np.float32), edge.astype(np.float32)


def disc(theta):
    """A disc with sectors that turns about its middle, and where it covers the background."""
    angle, edge = plane()
    angle = angle - np.float32(theta)
    return 128 + 60 * np.tanh(4 * np.sin(3 * angle)) * np.tanh(4 * np.sin(angle + 0.7)), edge


def moved(picture, dx, dy, roll):
    """The picture displaced by (dx, dy) and rolled clockwise about its middle."""
    cos, sin = np.cos(roll), np.sin(roll)
    x, y = 159.5, 119.5
    matrix = np.array([[cos, -sin, x + dx - cos * x + sin * y], [sin, cos, y + dy - sin * x - cos * y]])
    return cv2.warpAffine(
        picture, matrix, SIZE[::-1], flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE
    )


def film(shift, roll, seed=0, noise=2.0):
    rng = np.random.default_rng(seed)
    back = wall(rng)
    frames = []
    for k, ((dx, dy), turn) in enumerate(zip(shift, roll, strict=True)):
        body, cover = disc(0.21 * k)
        picture = moved(back * (1 - cover) + body * cover, dx, dy, turn) + rng.normal(0, noise, SIZE)
        frames.append(np.clip(picture, 0, 255).astype(np.uint8))
    return frames


def test_displacement_and_roll_are_those_of_the_camera():
    rng = np.random.default_rng(1)
    shift, roll = rng.normal(0, 1.5, (40, 2)), rng.normal(0, 4e-3, 40)
    shift[0], roll[0] = 0, 0
    frames = film(shift, roll)
    found = camera_shake(frames, frames)
    assert found is not None
    off = np.array(found.centre) - (159.5, 119.5)
    expected = shift + roll[:, None] * np.array([-off[1], off[0]])
    error = found.shift - expected
    error -= error.mean(axis=0)
    assert error.std() < 0.05
    assert (found.roll - roll).std() < 4e-4
    assert (found.roll - roll).std() < 3 * found.roll_sigma
    assert np.corrcoef(found.roll, roll)[0, 1] > 0.99  # the sign is right
    still = found.stabilised(frames[7], 7).astype(float)[20:60, 20:-20]
    first = frames[0].astype(float)[20:60, 20:-20]
    before = frames[7].astype(float)[20:60, 20:-20]
    assert np.abs(still - first).mean() < 0.5 * np.abs(before - first).mean()


def test_points_are_where_the_picture_moves_them():
    rng = np.random.default_rng(2)
    shift, roll = rng.normal(0, 2, (5, 2)), rng.normal(0, 0.02, 5)
    shake = Shake(shift, roll, (159.5, 119.5), 10, 0.0, 0.0)
    place = np.tile([200.0, 80.0], (5, 1))
    spot = np.zeros(SIZE, np.float32)
    cv2.circle(spot, (200, 80), 6, 1.0, -1)
    for at, (dx, dy), turn in zip(shake.seen(place), shift, roll, strict=True):
        sums = cv2.moments(moved(spot, dx, dy, turn))
        assert at == pytest.approx(np.array([sums["m10"], sums["m01"]]) / sums["m00"], abs=0.02)
    assert shake.still(shake.seen(place)) == pytest.approx(place, abs=1e-9)


class TestRigidMotion:
    """Displacement and roll of features that are displaced by known amounts."""

    PLACES = np.random.default_rng(0).uniform(0, 400, (60, 2)).astype(np.float32)

    def moved(self, shift, roll, noise=0.0):
        x, y = (self.PLACES - self.PLACES.mean(axis=0)).T
        turned = roll[:, None, None] * np.stack([-y, x], axis=1)
        error = noise * np.random.default_rng(1).standard_normal((len(roll), *self.PLACES.shape))
        return shift[:, None] + turned + error

    def test_the_displacement_is_that_of_the_centroid_of_all_features(self):
        """In some frames, half of the features are occluded."""
        shift, roll = np.array([[0.0, 0.0], [2.0, -1.0], [-3.0, 0.5]]), np.array([0.0, 0.02, -0.01])
        moved = self.moved(shift, roll)
        moved[1:, self.PLACES[:, 0] > 150.0] = np.nan
        found = _camera_motion._rigid(self.PLACES, moved)
        assert found.shift == pytest.approx(shift, abs=1e-3)
        assert found.roll == pytest.approx(roll, abs=1e-5)

    def test_its_uncertainties_are_those_of_repeated_measurements(self):
        """The median distance from the rigid motion is 1.18 standard deviations per axis."""
        rng = np.random.default_rng(2)
        shift, roll = rng.normal(0, 2.0, (300, 2)), rng.normal(0, 0.02, 300)
        found = _camera_motion._rigid(self.PLACES, self.moved(shift, roll, 0.1))
        assert np.std(found.roll - roll) / found.roll_sigma == pytest.approx(0.85, abs=0.12)
        assert np.std(found.shift - shift) / found.shift_sigma == pytest.approx(0.85, abs=0.12)


def test_a_camera_on_a_tripod_is_left_alone():
    frames = film(np.zeros((30, 2)), np.zeros(30))
    assert camera_shake(frames, frames) is None


def test_a_body_before_a_blank_wall_is_not_a_background():
    frames = []
    for k in range(30):
        picture = np.full(SIZE, 200, np.uint8)
        picture[100:130, 100 + k : 130 + k] = np.random.default_rng(5).integers(0, 99, (30, 30))
        frames.append(picture)
    assert camera_shake(frames, frames) is None


def grain(shift, roll, seed=0):
    """Pictures of a wall with a soft grain along one direction, without corners, and a disc in front."""
    rng = np.random.default_rng(seed)
    wood = cv2.GaussianBlur(rng.normal(0, 1, SIZE), (0, 0), sigmaX=14, sigmaY=2.5)
    back = cv2.GaussianBlur(120 + 12 * wood / wood.std(), (0, 0), 1.5)
    for k, ((dx, dy), turn) in enumerate(zip(shift, roll, strict=True)):
        body, cover = disc(0.21 * k)
        picture = moved(back * (1 - cover) + body * cover, dx, dy, turn) + rng.normal(0, 1.0, SIZE)
        yield np.clip(picture, 0, 255).astype(np.uint8)


class TestBackgroundRoll:
    """A background without corners determines the roll of the camera."""

    BODY = (159.7, 120.3, 75.0)

    @pytest.mark.slow
    def test_the_roll_is_that_of_the_camera_within_its_uncertainty(self):
        rng = np.random.default_rng(4)
        shift, roll = rng.normal(0, 1.5, (96, 2)), rng.normal(0, 5e-3, 96)
        shift[0], roll[0] = 0, 0
        found = background_roll(grain(shift, roll), self.BODY)
        error = found.roll - roll
        assert error.std() < 5e-4
        assert 0.3 < error.std() / found.roll_sigma < 1.5
        assert not found.shift.any()
        assert found.shift_sigma == 0.0
        assert found.still(np.tile(self.BODY[:2], (96, 1))) == pytest.approx(np.tile(self.BODY[:2], (96, 1)))

    def test_the_uncertainty_follows_from_the_differences_of_two_halves(self, monkeypatch):
        """Two independent halves with errors of sqrt(2) mrad have a mean with an error of 1 mrad."""
        rng = np.random.default_rng(5)
        halves = np.sqrt(2.0) * 1e-3 * rng.standard_normal((2, 150))
        # each sixteenth frame is registered three times
        whole = rng.uniform(-0.03, 0.03, (150, 16))
        rolls = iter(np.concatenate([whole[:, :1], halves.T, whole[:, 1:]], axis=1).ravel().tolist())

        def registered(*_):
            turn = next(rolls)
            return 1.0, np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0]])

        monkeypatch.setattr(cv2, "findTransformECC", registered)
        found = background_roll((np.zeros((24, 32), np.uint8) for _ in range(16 * 150)), (16.0, 12.0, 5.0))
        assert found.roll_sigma == pytest.approx(1e-3, rel=0.25)

    @pytest.mark.slow
    def test_a_camera_that_does_not_roll_is_left_alone(self):
        shift = np.random.default_rng(4).normal(0, 1.5, (96, 2))
        found = background_roll(grain(shift, np.zeros(96)), self.BODY)
        assert not found.roll.any()
        assert found.roll_sigma < 2e-4

    @pytest.mark.parametrize(("sigma", "kept"), [(0.99, True), (1.01, False)])
    def test_a_roll_below_five_standard_uncertainties_becomes_the_uncertainty(self, sigma, kept):
        roll = np.array([-1e-3, 1e-3] * 20)
        u = sigma * 1e-3 / 5.0
        found, left = _camera_motion._significant_roll(roll, u)
        assert found == pytest.approx(roll * kept)
        assert left == pytest.approx(u if kept else np.sqrt(1e-6 - u**2))

    def test_a_body_that_fills_the_picture_leaves_no_background(self):
        roll = np.random.default_rng(4).normal(0, 5e-3, 96)
        assert background_roll(grain(np.zeros((96, 2)), roll), (159.7, 120.3, 200.0)) is None

    @pytest.mark.slow
    def test_too_few_frames_have_no_uncertainty(self):
        roll = np.random.default_rng(4).normal(0, 5e-3, 80)
        assert background_roll(grain(np.zeros((80, 2)), roll), self.BODY) is None


class TestHub:
    """A ring is sampled about the hub of each frame if the hub moves fast."""

    @pytest.mark.parametrize(("size", "fast"), [(0.9, False), (1.1, True)])
    def test_a_disc_moves_fast_beyond_half_a_pixel_from_frame_to_frame(self, size, fast):
        # the steps of white noise have twice its variance, in each of two coordinates
        disc = np.random.default_rng(0).normal(0, size * FAST / 2.0, (20_000, 2))
        disc[::7] = np.nan
        steps = disc[np.isfinite(disc).all(axis=1)]
        assert moves_fast(disc) == fast
        assert np.sqrt(np.mean(np.sum(np.diff(steps, axis=0) ** 2, axis=1))) == pytest.approx(
            size * FAST, rel=0.02
        )

    def test_one_known_position_does_not_move(self):
        assert not moves_fast(np.array([[0.0, 0.0], [np.nan, np.nan]]))

    @pytest.mark.parametrize(("size", "followed"), [(0.2, False), (3.0, True)])
    def test_the_displacement_of_the_hub_is_that_of_its_disc(self, size, followed):
        centre = np.array([50.0, 40.0])
        disc = centre + np.random.default_rng(1).normal(0, size, (12, 2))
        disc[5] = np.nan
        window = SimpleNamespace(centres=lambda count, first: disc[first:count])
        tracker = SimpleNamespace(disc=window, centre=tuple(centre), filled=2, held=[None] * 10)
        found = FilmTracker._hub_displacement(tracker)
        if not followed:
            assert found is None
            return
        expected = disc[2:] - centre
        expected[3] = 0.5 * (expected[2] + expected[4])
        assert found == pytest.approx(expected)

    def test_a_film_without_a_disc_has_no_displacement(self):
        assert FilmTracker._hub_displacement(SimpleNamespace(disc=None)) is None

    def test_markers_are_seen_about_the_displaced_hub(self):
        """A marker to the right of a hub that is 3 px too low is seen at a positive angle."""
        hub, radius, true = np.array([[100.0, 80.0], [100.0, 83.0]]), 60.0, 0.3
        place = hub + radius * np.array([np.cos(true), -np.sin(true)])
        x, y = (place - (100.0, 80.0)).T
        one = np.ones(2)
        seen = MarkerObservations(
            np.arctan2(-y, x), np.hypot(x, y), *np.zeros((2, 2, 2)), one, 0 * one, one,
            np.ones(2, dtype=bool), np.tile([100.0, 80.0], (2, 1)),
        )  # fmt: skip
        body = SimpleNamespace(markers={"red": SimpleNamespace(marker=SimpleNamespace(mount=0.1))})
        found = _film_tracker._by_markers(np.full(2, 0.18), {"red": seen}, body, hub)
        assert found == pytest.approx(np.full(2, true - 0.1))

    @pytest.mark.slow
    def test_a_ring_about_the_moving_hub_has_the_angle_of_a_camera_at_rest(self):
        rng = np.random.default_rng(6)
        shift, angle = rng.normal(0, 2.0, (96, 2)), 0.21 * np.arange(96)
        grey = np.zeros((1, 1), np.uint8)
        frames = [Frame(k, k, p, grey, grey) for k, p in enumerate(film(shift, np.zeros(96)))]
        error = {}
        for followed in (True, False):
            ring = TextureTracker((159.7, 120.3), 55.0, SIZE[::-1], 96)
            ring.take(frames, 0, angle + 0.01, shift if followed else None)
            found = ring.measure(96, angle + rng.normal(0, 2e-3, 96))[0]
            known = np.isfinite(found.angle)
            off = (found.angle - angle)[known]
            error[followed] = np.inf if known.mean() < 0.9 else (off - off.mean()).std()
            assert ring.centres(96) == pytest.approx((159.7, 120.3) + shift * followed)
        assert error[True] < 1e-3
        assert error[False] > 3 * error[True]


def test_the_ring_is_kept_if_frames_are_repeated():
    ring = TextureObservations.unknown(np.zeros((4, 2)))
    ring.angle[:] = np.arange(4.0)
    body = BodyObservations(np.arange(4.0), {}, ring, ring)
    again = np.array([False, False, True, False])
    seen = FilmObservations({"casing": body}, None, np.arange(4.0), SimpleNamespace(), (), SIZE[::-1], again)
    found = left_out(seen, SimpleNamespace(again=again)).bodies["casing"]
    for kind in (found.texture, found.aligned):
        assert kind.angle == pytest.approx(np.array([0.0, 1.0, np.nan, 3.0]), nan_ok=True)


def shaken(source, target, rms, roll):
    """Write a film again with known displacements and rolls of its frames (a random walk that returns)."""
    rng = np.random.default_rng(3)
    state = np.zeros(3)
    with av.open(str(source)) as film, av.open(str(target), "w") as out:
        old = film.streams.video[0]
        new = out.add_stream("libx264", rate=old.average_rate)
        new.width, new.height, new.pix_fmt = old.width // 2 * 2, old.height // 2 * 2, "yuv420p"
        new.options = {"crf": "12", "preset": "fast"}
        for k, frame in enumerate(film.decode(old)):
            state = 0.8 * state + rng.normal(0, [0.6 * rms, 0.6 * rms, 0.6 * roll])
            picture = frame.to_ndarray(format="bgr24")[: new.height, : new.width]
            matrix = cv2.getRotationMatrix2D((new.width / 2, new.height / 2), np.degrees(state[2]), 1.0)
            matrix[:, 2] += state[:2]
            picture = cv2.warpAffine(
                picture,
                matrix,
                (new.width, new.height),
                flags=cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REPLICATE,
            )
            shown = av.VideoFrame.from_ndarray(picture, format="bgr24").reformat(format="yuv420p")
            shown.pts = k
            out.mux(new.encode(shown))
        out.mux(new.encode())
    return target


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="needs the real films")
@pytest.mark.parametrize(
    ("name", "words", "roll", "most"),
    [
        # one turn in perspective: the hub is found 4 px apart, and the uncertainty contains that
        ("turntable/turntable_33rpm.mp4", [], 0.0, 5.0e-3),
        ("bicycle_wheel_300fps.mp4", ["--capture-fps", "300"], 3e-3, 5.0e-3),
    ],
)
def test_real_films_that_were_shaken_give_the_same_angles(name, words, roll, most, tmp_path, measured_film):
    recording = read_case(measured_film(REAL / name, *words)[3]).recordings["casing"]
    alone = recording.bodies["casing"]
    found = track_body(Film(shaken(REAL / name, tmp_path / "shaken.mp4", 2.0, roll)))
    assert "The camera moves by" in found.warnings[0]
    frames = np.searchsorted(recording.time, alone.time)
    _, i, j = np.intersect1d(frames, found.frame, return_indices=True)
    assert len(i) > 0.95 * len(frames)
    apart = recording.sense * alone.angle[i] - found.angle[j]
    apart -= apart.mean()
    assert apart.std() < most
    assert apart.std() < 1.5 * np.hypot(np.median(alone.sigma), np.median(found.sigma))


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="needs the real films")
def test_a_shaken_film_before_wood_has_the_angles_of_a_camera_at_rest(tmp_path):
    """Without corners in the background: 3.4 mrad about a fixed hub, 0.5 mrad about the hub of each frame."""
    source = REAL / "pathtraced" / "rotor_wood.mp4"
    truth = np.genfromtxt(source.with_suffix(".csv"), delimiter=",", names=True)["psi_casing_rad"]
    found = extract(shaken(source, tmp_path / "shaken.mp4", 2.0, 1e-3), capture_fps=1000.0)
    casing = found.bodies["casing"]
    off = casing.angle - truth[np.rint(1000.0 * casing.time).astype(int)]
    off -= off.mean()
    assert off.std() < 1e-3
    assert 0.4 < np.sqrt(np.mean((off / casing.sigma) ** 2)) < 1.4
    assert "The camera rolls by" in " ".join(found.warnings)


def test_both_angles_of_a_ring_are_those_of_a_camera_at_rest():
    """A clockwise roll of the picture turns a body at rest against its counter-clockwise angle."""
    roll = np.array([0.0, 0.01, -0.02])
    shake = Shake(np.array([[0.0, 0.0], [2.0, -1.0], [1.0, 3.0]]), roll, (160.0, 120.0), 40, 0.02, 1e-4)
    hub = np.tile([170.0, 110.0], (3, 1))
    plain, aligned = (TextureObservations.unknown(shake.seen(hub)) for _ in range(2))
    plain.angle[:], aligned.angle[:] = 0.3 - roll, 0.4 - roll
    body = BodyObservations(0.5 - roll, {}, plain, aligned)
    seen = FilmObservations(
        {"casing": body}, None, np.arange(3.0), SimpleNamespace(), (), SIZE[::-1], np.zeros(3, dtype=bool)
    )
    still = _extract._stabilised(seen, shake).bodies["casing"]
    assert still.coarse == pytest.approx(np.full(3, 0.5))
    for ring, angle in ((still.texture, 0.3), (still.aligned, 0.4)):
        assert ring.angle == pytest.approx(np.full(3, angle))
        assert ring.centre == pytest.approx(hub)
