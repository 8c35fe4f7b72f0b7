from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.video._container import ClipInfo
from gyrotrack.video._time_base import capture_rate, frame_numbers, gap_warnings, stamp_warnings

INFO = ClipInfo(Path("a.mp4"), 640, 360, 260.0, 100, None, "h264", "yuv420p", Fraction(1, 90000))


def test_a_fast_container_is_believed():
    rate = capture_rate(INFO)
    assert (rate.fps, rate.source, rate.warnings) == (260.0, "container", ())


def test_a_slow_container_says_nothing_about_the_camera():
    with pytest.raises(VideoError, match="does not state at what rate") as caught:
        capture_rate(replace(INFO, container_fps=30.0))
    assert "--capture-fps" in caught.value.hint


def test_the_order_is_flag_profile_tag_container():
    info = replace(INFO, container_fps=25.0, tag_fps=1000.0)
    assert capture_rate(info).fps == 1000.0
    assert capture_rate(info, None, 960.0).fps == 960.0
    assert capture_rate(info, 950.0, 960.0).fps == 950.0


def test_differences_are_reported():
    rate = capture_rate(replace(INFO, container_fps=25.0, tag_fps=1000.0), 960.0)
    assert any("25" in text for text in rate.warnings)
    assert any("1000" in text for text in rate.warnings)


@pytest.mark.parametrize("fps", [0.0, -5.0, float("nan"), float("inf")])
def test_impossible_rates_are_refused(fps):
    with pytest.raises(VideoError, match="not possible"):
        capture_rate(INFO, fps)


def test_even_stamps_are_silent():
    assert stamp_warnings(np.arange(100) / 260.0) == gap_warnings(np.arange(100)) == ()
    np.testing.assert_array_equal(frame_numbers(np.arange(100) / 260.0), np.arange(100))


def test_a_millisecond_clock_is_not_a_gap():
    stamps = np.round(np.arange(2000) / 260.0, 3)  # steps of 3 and 4 ms
    assert gap_warnings(frame_numbers(stamps)) == ()
    np.testing.assert_array_equal(frame_numbers(stamps), np.arange(2000))


def test_missing_frames_are_counted_and_their_numbers_left_out():
    index = np.delete(np.arange(200), [50, 51, 120])
    (text,) = gap_warnings(index)
    assert "3 missing frames at 2 places" in text
    assert "after frame 49" in text
    np.testing.assert_array_equal(frame_numbers(index / 260.0), index)


def test_a_single_missing_frame_of_a_fast_film_is_seen_if_its_clock_is_fine():
    index = np.delete(np.arange(200), [50, 90, 91])
    np.testing.assert_array_equal(frame_numbers(index / 1000.0, 1 / 16000), index)
    every = np.arange(200)
    np.testing.assert_array_equal(
        frame_numbers(np.round(every / 950.0, 3), 1e-3), every
    )  # steps of 1 and 2 ms


def test_stamps_without_a_rhythm_are_not_believed():
    stamps = np.cumsum(np.random.default_rng(0).uniform(1e-3, 9e-3, 300))
    np.testing.assert_array_equal(frame_numbers(stamps), np.arange(300))


def test_a_varying_rate_shows_no_missing_frames():
    time = (np.arange(300) + 0.25 * np.sin(1.7 * np.arange(300))) / 260.0
    np.testing.assert_array_equal(frame_numbers(time), np.arange(300))


def test_frames_without_stamps_are_reported():
    stamps = np.arange(50) / 260.0
    stamps[7] = np.nan
    assert "no timestamp" in stamp_warnings(stamps)[0]
    np.testing.assert_array_equal(frame_numbers(stamps), np.arange(50))
