"""Times from stamps or from counted frames, decided by the stamps alone."""

import numpy as np
import pytest

from gyrotrack import UsageError, VideoError
from gyrotrack.video._time_base import Timing

FPS, TICK = 260.0, 1 / 90000
EVEN = np.arange(600) / FPS
VIEW_ERROR = EVEN + 0.01 * np.sin(2 * np.pi * 1.3 * EVEN)


def _stamps(time, tick=TICK):
    return np.round(time / tick) * tick


@pytest.mark.parametrize("tick", [TICK, 1 / 16000, 1e-3])
@pytest.mark.parametrize("fps", [29.97, 120.0, 260.0, 480.0])
def test_even_stamps_are_counted(fps, tick):
    index = np.delete(np.arange(900), [50, 51, 600])
    times = Timing("auto", fps).of(_stamps(index / fps, tick), tick)
    assert times.place is None
    np.testing.assert_array_equal(times.number, index)
    np.testing.assert_array_equal(times.seconds(fps), index / fps)
    assert len(times.warnings) == 1
    assert "3 missing frames" in times.warnings[0]


@pytest.mark.parametrize(("tick", "limit"), [(TICK, 1e-5), (1e-3, 1.5e-4)])
def test_a_swinging_rate_is_taken_from_the_stamps(tick, limit):
    times = Timing("auto", FPS).of(_stamps(VIEW_ERROR, tick), tick)
    error = times.seconds(FPS) - VIEW_ERROR
    assert np.std(error) < limit  # 0.3 ms of rounding is less by its neighbours
    np.testing.assert_allclose(times.sigma / FPS, np.std(error), rtol=0.35)
    assert "times are from the stamps" in times.warnings[0]


def test_stamps_that_were_copied_from_whole_milliseconds_are_not_finer():
    copied = _stamps(_stamps(VIEW_ERROR, 1e-3))
    assert Timing("auto", FPS).of(copied, TICK).sigma == pytest.approx(
        Timing("auto", FPS).of(_stamps(VIEW_ERROR, 1e-3), 1e-3).sigma, rel=0.05
    )


def test_jitter_beyond_rounding_is_kept_with_the_uncertainty_of_rounding():
    time = EVEN + np.random.default_rng(0).uniform(-1e-3, 1e-3, 600)
    times = Timing("auto", FPS).of(_stamps(time, 1e-3), 1e-3)
    np.testing.assert_allclose(times.place / FPS, _stamps(time, 1e-3) - _stamps(time, 1e-3)[0], atol=1e-12)
    assert times.sigma / FPS == pytest.approx(1e-3 / np.sqrt(12))
    even = times.even()
    assert np.std(even.seconds(FPS) - EVEN) < 1e-4
    assert "The markers move steadily" in even.warnings[-1]


def test_a_player_s_stamps_are_not_believed_unasked():
    stamps = _stamps(8.0 * VIEW_ERROR)
    times = Timing("auto", FPS).of(stamps, TICK)
    assert times.place is None
    assert "the playback rate" in times.warnings[0]
    asked = Timing("stamps", FPS).of(stamps, TICK)
    scale = np.polyfit(VIEW_ERROR, asked.seconds(FPS), 1)[0]
    np.testing.assert_allclose(asked.seconds(FPS), scale * (VIEW_ERROR - VIEW_ERROR[0]), atol=1e-5)
    assert any("scaled to the capture rate of 260" in text for text in asked.warnings)


def test_frames_are_counted_when_that_must_be_stated():
    times = Timing("frames", FPS).of(_stamps(VIEW_ERROR), TICK)
    np.testing.assert_array_equal(times.seconds(FPS), EVEN)
    assert "times are counted from the decoded frames" in times.warnings[0]


def test_even_stamps_that_must_be_confirmed_give_the_stamps_own_rate():
    times = Timing("stamps", FPS).of(_stamps(np.arange(600) / 259.0), TICK)
    np.testing.assert_allclose(times.seconds(FPS), np.arange(600) / 259.0, atol=1e-5)
    assert times.sigma == 0.0


@pytest.mark.parametrize("fault", [np.nan, 0.0], ids=["missing", "backwards"])
def test_stamps_that_are_not_times_are_refused(fault):
    stamps = VIEW_ERROR.copy()
    stamps[300] = fault
    with pytest.raises(VideoError, match="do not increase"):
        Timing("stamps", FPS).of(stamps, TICK)
    assert Timing("auto", FPS).of(stamps, TICK).place is None


def test_few_frames_and_unknown_sources():
    assert Timing("auto", FPS).of(np.zeros(0), TICK).warnings == ()
    assert Timing("auto", FPS).of(np.zeros(2), TICK).place is None
    with pytest.raises(UsageError, match="auto, stamps or frames"):
        Timing("clock", FPS)
