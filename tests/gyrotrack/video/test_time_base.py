"""Numbers, places and warnings of frames from their timestamps, and the thresholds of the time base on both sides."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video import _time_base as module
from gyrotrack.video._time_base import (
    CaptureRate,
    FrameTimes,
    Timing,
    capture_rate,
    frame_numbers,
    stamp_warnings,
    uneven,
)

EVEN = np.arange(60) / 25.0
UNEVEN = np.cumsum(np.where(np.arange(60) % 2, 0.05, 0.03))  # 25 frames/s on average


def test_gaps_skip_numbers_unless_a_timestamp_is_missing():
    pts = np.delete(EVEN, [20, 21, 40])
    assert frame_numbers(pts, 1e-6).tolist() == np.delete(np.arange(60), [20, 21, 40]).tolist()
    lost = pts.copy()
    lost[5] = np.nan
    assert frame_numbers(lost, 1e-6).tolist() == list(range(57))
    assert frame_numbers(np.full(5, np.nan)).tolist() == list(range(5))
    assert frame_numbers(np.zeros(5)).tolist() == list(range(5))
    assert frame_numbers(np.array([0.0, 0.4])).tolist() == [0, 1]


@pytest.mark.parametrize(
    ("source", "fps", "pts", "stamped", "proposed"),
    [
        ("auto", 25.0, UNEVEN, True, False),
        ("auto", 240.0, UNEVEN, False, True),
        ("frames", 240.0, UNEVEN, False, False),
        ("frames", 25.0, UNEVEN, False, False),
        ("auto", 25.0, EVEN, False, False),
        ("stamps", 25.0, EVEN, False, False),
        ("stamps", 240.0, UNEVEN, True, False),
    ],
)
def test_uneven_stamps_of_slow_motion_are_proposed(source, fps, pts, stamped, proposed):
    found = Timing(source, fps).of(pts, 1e-6)
    text = " ".join(found.warnings)
    assert ("times are from the stamps" in text) == stamped
    assert ("--times stamps" in text) == proposed
    assert ("counted from the decoded frames" in text) == (pts is UNEVEN and not stamped)
    assert (found.place is not None) == (source == "stamps" or stamped)


def test_a_film_whose_stamps_go_back_once_is_counted_though_it_is_live():
    pts = np.cumsum(np.where(np.arange(300) % 2, 0.05, 0.03))
    pts[150] = pts[149]
    found = Timing("auto", 25.0).of(pts, 1e-6)
    assert found.place is None
    assert "--times stamps" not in found.warnings[0]
    with pytest.raises(VideoError):
        Timing("stamps", 25.0).of(pts, 1e-6)


def test_places_are_times_by_the_capture_rate():
    live = Timing("stamps", 25.0).of(7.0 + UNEVEN, 1e-6)
    assert live.place == pytest.approx((UNEVEN - UNEVEN[0]) * 25.0, abs=1e-3)
    slow = Timing("stamps", 1000.0).of(7.0 + UNEVEN, 1e-6)
    line = np.polyfit(np.arange(60), UNEVEN, 1)[0]
    assert slow.place == pytest.approx((UNEVEN - UNEVEN[0]) / line, abs=1e-3)
    assert any("1000 frames/s" in w for w in slow.warnings)
    even = Timing("stamps", 24.0).of(7.0 + EVEN, 1e-6)  # live: the rate of the stamps counts
    assert even.place == pytest.approx(np.arange(60) * 24.0 / 25.0)
    other = Timing("stamps", 240.0).of(7.0 + EVEN, 1e-6)
    assert other.place == pytest.approx(np.arange(60.0))


def test_frames_are_selected_with_their_places():
    times = FrameTimes(
        np.arange(5), 2.0 * np.arange(5.0), 0.1, 3.0 * np.arange(5.0), ("w",), np.ones(5, dtype=bool)
    )
    some = times.at(np.array([1, 3]))
    assert (some.number.tolist(), some.place.tolist(), some.smooth.tolist()) == (
        [1, 3],
        [2.0, 6.0],
        [3.0, 9.0],
    )
    assert (some.sigma, some.warnings, some.again) == (0.1, ("w",), None)
    assert times.places.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert times.seconds(4.0).tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    even = times.even()
    assert (even.place.tolist(), even.sigma, even.smooth) == ([0.0, 3.0, 6.0, 9.0, 12.0], 0.0, None)
    assert len(even.warnings) == 2
    plain = FrameTimes(np.arange(5))
    assert plain.even() is plain
    assert plain.places.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_inserted_frames_are_halfway_to_the_next_one():
    again = np.array([False, False, True, True, False, True])
    number = np.array([0, 1, 1, 1, 2, 3])
    found = FrameTimes(number, again=again).seconds(2.0)
    # the last repetition replaces a missing frame: it has its own number
    assert found == pytest.approx([0.0, 0.5, 0.75, 0.875, 1.0, 1.5])


@pytest.mark.parametrize(
    ("pts", "told"),
    [
        ([0.0, 1.0, 2.0, 3.0], None),
        ([0.0, np.nan, 2.0, 3.0], "1 frames have no timestamp"),
        ([0.0, 1.0, 1.0, 3.0], "1 timestamps do not increase; times are counted"),
        ([0.0, 1.0, 1.0, *range(2, 103)], "1 timestamps do not increase."),
        ([0.0, 1.0, 1.0, *range(2, 100)], "1 timestamps do not increase."),
        ([0.0, 1.0, 1.0, *range(2, 99)], "1 timestamps do not increase; times are counted"),
        ([0.0, 0.0], None),
    ],
)
def test_timestamps_that_are_missing_or_go_back_are_reported(pts, told):
    found = module.stamp_warnings(np.array(pts))
    assert len(found) == (told is not None)
    assert told is None or found[0].startswith(told)


def test_missing_frames_are_counted_with_their_places():
    assert module.gap_warnings(np.arange(5)) == ()
    (text,) = module.gap_warnings(np.array([0, 1, 4, 5, 7]))
    assert "3 missing frames at 2 places, the first after frame 1;" in text


def test_smooth_places_are_those_of_a_slow_change_or_of_a_line():
    """White jitter of 0.05 about a line, and about a slow bend that is 20 times as large."""
    number = np.arange(400)
    jitter = 0.05 * np.where(number % 2, 1.0, -1.0)
    line = 1.5 * number + jitter
    assert module._without_jitter(number, line) == pytest.approx(1.5 * number, abs=1e-3)
    bend = number + np.sin(number / 60.0)
    found = module._without_jitter(number, bend + jitter)
    assert found[30:-30] == pytest.approx(bend[30:-30], abs=0.02)


def test_rounding_errors_are_smoothed_to_the_root_of_the_leverage():
    number = np.arange(400)
    true = number * 1.0237 + 0.3
    tick = 0.25
    place = np.rint(true / tick) * tick
    found, sigma = module._without_rounding(number, place, tick)
    assert np.std(found - true) < 0.3 * tick / np.sqrt(12.0)
    share = module._smoothed(number, place)[1]
    left = place - found
    rounding = tick**2 / 12.0
    expected = max(np.mean(left**2) - (1.0 - share) * rounding, 0.0) + share * rounding
    assert sigma == pytest.approx(np.sqrt(expected))
    assert 0.0 < share < 0.2
    kept, sigma = module._without_rounding(number, place + 0.5 * np.where(number % 2, 1.0, -1.0), tick)
    assert kept[0] == place[0] - 0.5
    assert sigma == pytest.approx(tick / np.sqrt(12.0))


@pytest.mark.parametrize(("requested", "profile", "tag", "source"), [
    (50.0, 60.0, 70.0, "--capture-fps"),
    (None, 60.0, 70.0, "profile"),
    (None, None, 70.0, "tag of the camera"),
    (None, None, None, "container"),
])  # fmt: skip
def test_the_origin_of_the_rate_is_stated(requested, profile, tag, source):
    info = SimpleNamespace(path="film", container_fps=120.0, tag_fps=tag)
    found = module.capture_rate(info, requested, profile)
    assert found.source == source
    assert found.fps == next(r for r in (requested, profile, tag, 120.0) if r)
    # a warning for each of container and tag that differs
    assert len(found.warnings) == (0 if source == "container" else 1 if source == "tag of the camera" else 2)
    assert isinstance(found, CaptureRate)


FPS = 100.0
EVEN_TIMES = np.arange(400) / FPS


def info(container=100.0, tag=None):
    return SimpleNamespace(container_fps=container, tag_fps=tag, path="film.mp4")


class TestRate:
    @pytest.mark.parametrize(
        ("requested", "profile", "tag", "container", "fps"),
        [
            (240.0, 120.0, 60.0, 30.0, 240.0),
            (None, 120.0, 60.0, 30.0, 120.0),
            (None, None, 60.0, 30.0, 60.0),
            (None, None, None, 101.0, 101.0),
            (None, None, None, 100.0, 100.0),
        ],
    )
    def test_who_states_the_rate(self, requested, profile, tag, container, fps):
        assert capture_rate(info(container, tag), requested, profile).fps == fps

    @pytest.mark.parametrize("container", [99.0, np.nan])
    def test_a_slow_container_may_be_slow_motion(self, container):
        with pytest.raises(VideoError, match="does not state"):
            capture_rate(info(container))

    @pytest.mark.parametrize("fps", [0.0, -1.0, np.inf])
    def test_an_impossible_rate_is_refused(self, fps):
        with pytest.raises(VideoError, match="not possible"):
            capture_rate(info(), fps)

    @pytest.mark.parametrize(("fps", "warned"), [(100.09, 0), (100.11, 2), (99.91, 0), (99.89, 2)])
    def test_a_thousandth_is_a_difference(self, fps, warned):
        assert len(capture_rate(info(100.0, 100.0), fps).warnings) == warned


class TestNumbers:
    @pytest.mark.parametrize(("step", "missing"), [(1.45, 0), (1.55, 1), (2.0, 1), (3.4, 2)])
    def test_a_gap_is_more_than_one_and_a_half_periods(self, step, missing):
        stamps = np.arange(60) / FPS
        stamps[30:] += (step - 1.0) / FPS
        assert frame_numbers(stamps, 1e-6)[-1] == 59 + missing

    @pytest.mark.parametrize(("tick", "missing"), [(1e-3, 0), (1e-4, 1)])
    def test_coarse_ticks_jitter_by_one(self, tick, missing):
        """At 1000 frames/s, a step of two periods is one tick of 1 ms more than one."""
        stamps = np.arange(60) / 1000.0
        stamps[30:] += 1 / 1000.0
        assert frame_numbers(stamps, tick)[-1] == 59 + missing

    @pytest.mark.parametrize(("odd", "gaps"), [(0.08, True), (0.13, False)])
    def test_stamps_of_uneven_rate_have_no_gaps(self, odd, gaps):
        stamps = np.arange(401) / FPS
        moved = np.arange(10, 10 + round(odd * 400 / 2) * 4, 4)
        stamps[moved] += 0.3 / FPS  # each changes two steps
        stamps[350:] += 2.0 / FPS
        assert bool(frame_numbers(stamps, 1e-6)[-1] == 402) is gaps

    @pytest.mark.parametrize(
        ("tick", "off", "gaps"),
        [
            (1e-6, 0.19, True),
            (1e-6, 0.21, False),
            (1e-3, 1.05e-3, True),
            (1e-3, 1.15e-3, False),
            (1e-2, 1.15e-3, False),
        ],
    )
    def test_steps_are_uneven_beyond_a_fifth_of_a_period_and_a_tick(self, tick, off, gaps):
        """A fifth of a step at 1000 frames/s, or 1.1 ms at 250 frames/s; a coarser tick counts as one of 1 ms."""
        rate = 1000.0 if tick == 1e-6 else 250.0
        off = off / rate if tick == 1e-6 else off
        stamps = np.arange(401) / rate
        stamps[10:330:4] += off
        stamps[350:] += 2.0 / rate
        assert bool(frame_numbers(stamps, tick)[-1] == 402) is gaps

    @pytest.mark.parametrize(
        ("stamps", "unit"),
        [
            ([0.0, 1.0, 3.0, 4.0], 1e-3),
            ([0.0, 1.0, 3.0, 4.0052], 1e-5),
            ([0.0, 1.0, 3.0, 4.005], 1e-3),
            ([0.0, 0.7, 1.7, 2.7], 1e-5),  # all below a whole millisecond
            ([0.0, 1.3, 2.3, 3.3], 1e-5),
        ],
    )
    def test_stamps_of_whole_milliseconds_in_a_finer_container_were_copied(self, stamps, unit):
        found = module._real_tick(2.0 + 1e-3 * np.array(stamps), 1e-5)
        assert found == unit

    @pytest.mark.parametrize(("count", "counted"), [(3, False), (6, True)])
    def test_one_stamp_in_a_hundred_may_go_back(self, count, counted):
        stamps = EVEN_TIMES.copy()
        stamps[20 : 20 + 10 * count : 10] -= 1.5 / FPS
        (text,) = stamp_warnings(stamps)
        assert f"{count} timestamps do not increase" in text
        assert ("times are counted" in text) is counted
        assert stamp_warnings(EVEN_TIMES) == ()

    @pytest.mark.parametrize(
        ("off", "count", "found"), [(4e-3, 40, False), (8e-3, 40, True), (0.3, 3, False), (0.3, 6, True)]
    )
    def test_stamps_are_uneven_beyond_half_a_percent_of_a_period_in_one_of_a_hundred(self, off, count, found):
        stamps = EVEN_TIMES.copy()
        stamps[np.linspace(5, 390, count).astype(int)] += off / FPS * np.where(np.arange(count) % 2, 1, -1)
        assert uneven(np.arange(400), stamps, 1e-7) is found

    @pytest.mark.parametrize(("off", "found"), [(0.7, False), (0.85, True)])
    def test_three_quarters_of_a_tick_are_rounding_error(self, off, found):
        stamps = EVEN_TIMES + off * 1e-3 * np.where(np.arange(400) % 2, 1, -1)
        assert uneven(np.arange(400), stamps, 1e-3) is found


class TestSource:
    @pytest.mark.parametrize(("ratio", "stamped"), [(1.04, True), (1.06, False), (0.96, True), (0.94, False)])
    def test_a_film_within_five_percent_of_the_rate_is_live(self, ratio, stamped):
        stamps = (EVEN_TIMES + 2e-3 * np.sin(2 * np.pi * 1.3 * EVEN_TIMES)) / ratio
        times = Timing("auto", FPS).of(stamps, 1e-6)
        assert (times.place is not None) is stamped
        if stamped:
            assert times.place == pytest.approx((stamps - stamps[0]) * FPS, abs=0.02)

    def test_stamps_of_slow_motion_are_scaled_to_the_rate(self):
        stamps = 8.0 * (EVEN_TIMES + 2e-3 * np.sin(2 * np.pi * 1.3 * EVEN_TIMES))
        times = Timing("stamps", FPS).of(stamps, 1e-6)
        assert times.place == pytest.approx((stamps - stamps[0]) / 8.0 * FPS, abs=0.3)
        assert np.polyfit(np.arange(400), times.place, 1)[0] == pytest.approx(1.0, rel=1e-6)

    def test_an_inserted_frame_is_between_its_neighbours(self):
        again = np.array([False, False, True, True, False])
        times = FrameTimes(np.array([0, 1, 1, 1, 2]), again=again)
        assert times.seconds(10.0) == pytest.approx([0.0, 0.1, 0.15, 0.175, 0.2])

    @pytest.mark.parametrize(("jitter", "smoothed"), [(0.2, True), (2.0, False)])
    def test_rounding_is_smoothed_and_jitter_beyond_it_is_not(self, jitter, smoothed):
        """Places in periods, stamps in ticks of a tenth of a period."""
        rng = np.random.default_rng(0)
        number = np.arange(400)
        true = number + 0.3 * np.sin(number / 40.0)
        place = np.round((true + 0.1 * jitter * rng.standard_normal(400)) / 0.1) * 0.1
        found, sigma = module._without_rounding(number, place, 0.1)
        assert (found is not place) is smoothed
        rounding = 0.1 / np.sqrt(12)
        assert sigma == pytest.approx(rounding) if not smoothed else 0.1 * rounding < sigma < rounding
        if smoothed:
            assert np.std(found - true) < 1.5 * sigma

    @pytest.mark.parametrize(("size", "kept"), [(0.1, True), (1e-4, False)])
    def test_a_slow_change_of_the_rate_is_kept_where_it_is_significant(self, size, kept):
        number = np.arange(400)
        slow = size * np.sin(number / 60.0)
        place = number + slow + 0.02 * np.random.default_rng(0).standard_normal(400)
        found = module._without_jitter(number, place)
        straight = np.polyval(np.polyfit(number, place, 1), number)
        assert np.allclose(found, straight) is not kept
        if kept:
            assert np.std(found - number - slow) < 0.01


@pytest.mark.parametrize(
    ("repeated", "text"),
    [
        (0, ()),
        (3, ("3 timestamps do not increase.",)),
        (4, ("4 timestamps do not increase; times are counted from the decoded frames.",)),
    ],
)
def test_equal_timestamps_do_not_increase(repeated, text):
    """Above one step in a hundred, of 399, the frames are counted."""
    stamps = EVEN_TIMES.copy()
    for k in range(repeated):
        stamps[100 * k + 50] = stamps[100 * k + 49]
    assert stamp_warnings(stamps) == text
