"""Films of a camera whose rate varied, and films with repeated frames: each picture's true time is known."""

from fractions import Fraction

import av
import numpy as np
import pytest

from gyrotrack.io._schema import STATUS
from gyrotrack.synthetic._film import to_planes
from gyrotrack.synthetic._render import Renderer
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene
from gyrotrack.tracking import _extract
from gyrotrack.tracking._extract import extract

SIZE = (320, 240)
FPS, N = 260.0, 320
FINE, COARSE = Fraction(1, 90000), Fraction(1, 1000)
SPAN = np.linspace(-0.1, 4.0, 60)
MOTION = Motion.from_speeds(SPAN, 300.0 - 15.0 * SPAN, 60.0 - 4.0 * SPAN, 0.3, 0.7)
TRUTH = {"casing": (MOTION.psi_casing, MOTION.omega_casing), "rotor": (MOTION.psi_rotor, MOTION.omega_rotor)}
EVEN = np.arange(N) / FPS
SLOW = EVEN + 0.1 / (2 * np.pi * 1.3) * (1 - np.cos(2 * np.pi * 1.3 * EVEN))  # the period swings by a tenth


def _jitter(share, seed=2):
    late = np.random.default_rng(seed).uniform(-share, share, len(EVEN)) / FPS
    return EVEN + late - late[0]


def _write(path, pictures, pts, tick, rate, **options):
    with av.open(
        str(path), "w", options={"video_track_timescale": "90000"} if path.suffix == ".mp4" else {}
    ) as out:
        stream = out.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.options = {"crf": "20", "preset": "veryfast", **options}
        stream.codec_context.time_base = tick
        stream.codec_context.thread_count = 1
        for picture, stamp in zip(pictures, pts, strict=True):
            frame = av.VideoFrame(*SIZE, "yuv420p")
            for plane, values in zip(frame.planes, to_planes(picture), strict=True):
                rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
                rows[: values.shape[0], : values.shape[1]] = values
            frame.pts, frame.time_base = int(stamp), tick
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    return path


@pytest.fixture(scope="module")
def shoot(tmp_path_factory):
    """Draw a film of pictures taken at `times`: each stored frame shows the picture `show`, and is stamped `stamps`."""
    folder = tmp_path_factory.mktemp("films")

    def make(name, times, show=None, stamps=None, tick=FINE, rate=FPS, motion=MOTION, **options):
        path = folder / name
        if path.exists():
            return path
        show = np.arange(len(times)) if show is None else show
        stamps = times if stamps is None else stamps
        camera = Camera(*SIZE, FPS, exposure=6e-4, scale=3.2, tilt=0.05, noise=3.0)
        renderer = Renderer(Scene(), motion, camera, Light(gradient=(0.2, -0.1), flicker=0.04), seed=1)

        def pictures():
            last, picture = -1, None
            for k in show:
                if k != last:
                    last, picture = k, renderer.frame(float(times[k]))
                yield picture

        return _write(path, pictures(), np.rint(stamps / float(tick)), tick, rate, **options)

    return make


def _errors(recording, body, start=0.0):
    """Errors of the angle against the truth at the time that is given, and of the speed."""
    track, (psi, omega) = recording.bodies[body], TRUTH[body]
    error = track.angle - psi(track.time + start)
    known = np.isfinite(track.omega)
    return error - np.median(error), (track.omega - omega(track.time + start))[known]


def _check(recording, limits, start=0.0):
    for body, limit in limits.items():
        error, off = _errors(recording, body, start)
        track = recording.bodies[body]
        assert len(error) > 0.95 * recording.frames_decoded
        assert np.std(error) < limit
        assert 0.7 < np.std(error / track.sigma) < 1.35  # one short film: itself uncertain by a tenth or two
        assert (np.abs(error) > 6 * track.sigma).mean() < 0.005
        assert abs(np.mean(off)) < 0.5


def _told(recording, *words):
    return [text for text in recording.warnings if all(word in text for word in words)]


class TestVaryingRate:
    @pytest.mark.slow
    def test_a_rate_that_oscillates(self, shoot):
        film = shoot("swing.mp4", SLOW)
        recording = extract(film, capture_fps=FPS)
        _check(recording, {"casing": 2e-3, "rotor": 2.5e-3})
        assert recording.extra["times_from"] == "stamps"
        assert _told(recording, "spaced unevenly", "times are from the stamps")
        counted = extract(film, capture_fps=FPS, times="frames")
        assert np.std(_errors(counted, "casing")[0]) > 0.1
        assert counted.extra["times_from"] == "frames"
        assert _told(counted, "times are counted from the decoded frames")

    @pytest.mark.slow
    def test_a_rate_that_oscillates_in_whole_milliseconds_is_smoothed(self, shoot):
        recording = extract(shoot("swing.mkv", SLOW, tick=COARSE), capture_fps=FPS)
        speed = {"casing": 60.0, "rotor": 300.0}
        for body, track in recording.bodies.items():
            error, _ = _errors(recording, body)
            assert np.std(error) < 0.4 * speed[body] * 1e-3 / np.sqrt(12)  # rounding alone would make it more
            assert 0.6 < np.std(error / track.sigma) < 1.5

    @pytest.mark.slow
    def test_jitter_with_missing_frames(self, shoot):
        keep = np.ones(len(EVEN), dtype=bool)
        keep[np.random.default_rng(3).choice(np.arange(5, 310), 8, replace=False)] = False
        keep[200:215] = False
        recording = extract(shoot("jitter.mp4", _jitter(0.25)[keep]), capture_fps=FPS)
        _check(recording, {"casing": 2e-3, "rotor": 2.5e-3})
        for body in recording.bodies:
            assert np.sqrt(np.mean(_errors(recording, body)[1] ** 2)) < 0.3

    @pytest.mark.slow
    def test_jitter_in_whole_milliseconds_is_uncertain_by_them(self, shoot):
        recording = extract(shoot("jitter.mkv", _jitter(0.25), tick=COARSE), capture_fps=FPS)
        for body, track in recording.bodies.items():
            error, _ = _errors(recording, body)
            tick = TRUTH[body][1](track.time) * 1e-3 / np.sqrt(12)
            np.testing.assert_allclose(np.median(track.sigma / tick), 1.0, atol=0.15)
            assert 0.85 < np.std(error / track.sigma) < 1.15

    @pytest.mark.slow
    def test_stamps_that_jitter_by_themselves_are_smoothed(self, shoot):
        recording = extract(shoot("stamps.mp4", EVEN, stamps=_jitter(0.1, 5) + 0.1), capture_fps=FPS)
        assert _told(recording, "The markers move steadily while the stamps jitter")
        assert np.std(_errors(recording, "casing")[0]) < 3e-3

    @pytest.mark.slow
    def test_slow_motion_is_counted_unless_stamps_must_be_confirmed(self, shoot):
        film = shoot("slow.mp4", SLOW, stamps=8.0 * SLOW, rate=FPS / 8.0)
        counted = extract(film, capture_fps=FPS)
        assert counted.extra["times_from"] == "frames"
        assert _told(counted, "the playback rate", "--times stamps")
        np.testing.assert_allclose(counted.time, np.arange(N) / FPS)
        stamped = extract(film, capture_fps=FPS, times="stamps")
        assert _told(stamped, "scaled to the capture rate of 260")
        scale = np.polyfit(SLOW, stamped.time, 1)[0]
        np.testing.assert_allclose(stamped.time, scale * SLOW, atol=2e-5)
        assert abs(scale - 1.0) < 0.03

    @pytest.mark.slow
    def test_even_stamps_change_nothing(self, casing_clip):
        plain, counted = extract(casing_clip[0]), extract(casing_clip[0], times="frames")
        for name, body in plain.bodies.items():
            for column in ("time", "angle", "sigma", "omega"):
                np.testing.assert_array_equal(getattr(counted.bodies[name], column), getattr(body, column))
        assert plain.warnings == counted.warnings == ()


FILLED = np.arange(N)
for _k in (37, 128, 129, 130, 256, 311):  # 128 and 256 begin a batch of the resumed run
    FILLED[_k] = FILLED[_k - 1]
CONVERTED = np.floor(np.arange(N) * 12 / 13 + 0.3).astype(int)


class TestRepeatedFrames:
    @pytest.mark.slow
    def test_those_that_fill_gaps(self, shoot):
        recording = extract(shoot("filled.mp4", EVEN, FILLED, EVEN))
        again = np.diff(FILLED, prepend=-1) == 0
        assert _told(
            recording, "6 frames repeat", "the first is frame 37", "The repeats replace missing frames"
        )
        np.testing.assert_allclose(recording.time, EVEN, atol=1e-5)
        for marker in recording.markers.values():
            assert (marker.status[again] == STATUS["lost"]).all()
            assert np.isnan(marker.angle_fine[again]).all()
        assert recording.extra["repeated_frames"] == 6
        assert not np.isin(np.flatnonzero(again), np.rint(recording.bodies["rotor"].time * FPS)).any()
        _check(recording, {"casing": 2e-3, "rotor": 2e-3})

    @pytest.mark.slow
    @pytest.mark.parametrize("options", [{}, {"bf": "3"}], ids=["as cameras write", "with B-frames"])
    def test_those_of_a_conversion(self, shoot, options):
        film = shoot(f"converted{len(options)}.mp4", np.arange(N) / 240.0, CONVERTED, EVEN, **options)
        recording = extract(film)
        assert recording.capture_fps == pytest.approx(240.0, rel=1e-4)
        assert _told(recording, "A film of 240 frames/s was converted to 260")
        again = np.diff(CONVERTED, prepend=-1) == 0
        np.testing.assert_allclose(recording.time[~again], CONVERTED[~again] / 240.0, atol=2e-4)
        assert (np.diff(recording.time) > 0).all()
        for body, limit in (("casing", 2e-3), ("rotor", 3e-3)):
            error, off = _errors(recording, body)
            assert len(error) == (~again).sum()
            assert np.std(error) < limit
            assert abs(np.mean(off)) < 0.1
        asked = extract(film, capture_fps=240.0)
        np.testing.assert_allclose(asked.time[~again], CONVERTED[~again] / 240.0, atol=1e-9)

    @pytest.mark.slow
    def test_the_rate_of_slow_motion_is_that_of_the_frames_that_are_left(self, shoot):
        film = shoot("slowed.mp4", np.arange(N) / 240.0, CONVERTED, EVEN * 10.0, rate=26.0)
        recording = extract(film, capture_fps=240.0)
        again = np.diff(CONVERTED, prepend=-1) == 0
        np.testing.assert_allclose(recording.time[~again], CONVERTED[~again] / 240.0, atol=1e-9)
        assert recording.capture_fps == 240.0
        assert _told(recording, "assumed to be 240 frames/s")

    @pytest.mark.slow
    def test_a_body_that_comes_to_rest_repeats_nothing(self, shoot):
        span = np.linspace(-0.1, 4.0, 400)
        resting = Motion.from_speeds(
            span, np.clip(90.0 - 120.0 * span, 0, None), np.clip(40.0 - 60.0 * span, 0, None)
        )
        recording = extract(shoot("rest.mp4", EVEN, motion=resting))
        assert recording.extra["repeated_frames"] == 0
        assert recording.warnings == ()
        assert (recording.frame_index == np.arange(N)).all()


def test_the_profile_of_an_error_has_the_times_of_its_frames():
    """Of ten frames, the third has no time; it lies between its neighbours."""
    time = 0.1 * np.arange(10)
    time[2] = np.nan
    parts = np.array([[2.0, 3e-4], [7.0, 1e-4]])
    assert np.array(_extract._profile(parts, time)) == pytest.approx(np.array([[0.2, 3e-4], [0.7, 1e-4]]))
    assert _extract._profile(np.zeros((0, 2)), time) == ()
    assert _extract._profile(parts, np.full(10, np.nan)) == ()
    # parts before the first known time have none
    time[:4] = np.nan
    assert np.array(_extract._profile(parts, time)) == pytest.approx(np.array([[0.7, 1e-4]]))


@pytest.mark.parametrize(
    ("parts", "kept"),
    [(_extract._MOST_PARTS, _extract._MOST_PARTS), (_extract._MOST_PARTS + 2, _extract._MOST_PARTS // 2 + 1)],
)
def test_a_profile_of_a_long_film_is_thinned(parts, kept):
    found = _extract._profile(
        np.stack([np.arange(parts) + 0.0, np.ones(parts)], axis=1), np.arange(parts) / 260.0
    )
    assert len(found) == kept
