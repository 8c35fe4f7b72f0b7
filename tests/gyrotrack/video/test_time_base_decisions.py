"""Numbers, places and warnings of frames from their timestamps: exact small cases."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video import _time_base as module
from gyrotrack.video._time_base import CaptureRate, FrameTimes, Timing, frame_numbers

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
