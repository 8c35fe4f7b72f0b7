"""Which part of a record is free motion: speeds whose drive, brake, rest or release is known to the sample."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrotrack import UsageError
from gyrotrack.io.readers import _run
from gyrotrack.io.readers._motion_table import MotionTable
from gyrotrack.io.readers._outliers import outliers, without_outliers
from gyrotrack.io.readers._run import (
    Limits,
    end_of_oscillation,
    enough_within,
    limited,
    read_cuts,
    reverses,
    run_of,
    speeds,
    start_of_oscillation,
    upward_crossings,
    within,
)


def table_of(time, value, quantity="angle", **options):
    return MotionTable(
        Path("a.csv"), "", quantity, time, value, None, np.arange(len(time)) + 2, (), **options
    )


def test_times_within_the_limits():
    time = np.arange(10.0)
    assert within(time, Limits(2.0, 7.0)).tolist() == [False] * 2 + [True] * 6 + [False] * 2
    kept = time[within(time, Limits(cuts=((2.0, 3.0), (6.5, 7.5))))]
    assert kept.tolist() == [0, 1, 4, 5, 6, 8, 9]
    long = np.arange(100.0)
    least = _run.MIN_SAMPLES
    assert enough_within(long, Limits(stop=least - 1.0)).sum() == least
    with pytest.raises(UsageError):
        enough_within(long, Limits(stop=least - 1.5))
    assert enough_within(time[:3], Limits()).all()
    cut = limited(table_of(long, long), Limits(start=40.0))
    assert len(cut.time) == 60
    assert "40 samples" in cut.notes[0]
    assert limited(table_of(long, long), Limits()).notes == ()


def test_intervals_to_exclude_are_read():
    assert read_cuts(["1:2", "-3.5:1e1"]) == ((1.0, 2.0), (-3.5, 10.0))
    for text in ("2:1", "1:1", "1", "a:b", ":2"):
        with pytest.raises(UsageError):
            read_cuts([text])


def test_upward_crossings_have_a_hysteresis():
    value = np.array([-1.0, -0.5, 0.5, 1.0, -0.01, 0.01, 1.0, -1.0, 0.0, 1.0])
    assert upward_crossings(value).tolist() == [2, 9]
    assert upward_crossings(value, 0.004).tolist() == [2, 5, 9]
    assert upward_crossings(-value).tolist() == [7]
    assert upward_crossings(np.array([1.0, 2.0, -1.0])).tolist() == []
    assert upward_crossings(value, 0.6).tolist() == []  # nothing exceeds 0.6 of the range


def test_speeds_in_blocks():
    time = 0.01 * np.arange(1700)
    found = speeds(table_of(time, 3 * time), 3 * time)
    np.testing.assert_allclose(found[1], 3.0)
    assert len(found[0]) == 425
    np.testing.assert_allclose(found[0][:2], [0.015, 0.055])
    rng = np.random.default_rng(0)
    value = 3 * time + 1e-3 * rng.normal(size=1700)
    _, speed, error = speeds(table_of(time, value, counted=True), value)
    assert len(speed) == 425
    long = 0.01 * np.arange(8000)
    assert len(speeds(table_of(long, long, counted=True), long)[0]) == 1600
    assert len(speeds(table_of(long, long), long)[0]) == 400
    x = time[:4] - time[:4].mean()
    slope = x @ value[:4] / (x @ x)
    rest = value[:4] - value[:4].mean() - slope * x
    assert speed[0] == pytest.approx(slope)
    assert error[0] == pytest.approx(np.sqrt(rest @ rest / 2 / (x @ x)))
    _, speed, error = speeds(table_of(time, value, "omega"), value)
    assert speed[0] == pytest.approx(np.median(value[:4]))
    assert error[0] == pytest.approx(value[:4].std() / 2)


def test_a_body_oscillates_if_it_reverses_twice():
    time = 0.01 * np.arange(400)
    for value, expected in ((np.sin(time * 4), True), (time, False), (np.abs(time - 2), False)):
        assert reverses(table_of(time, value), value) is expected
    assert not _run._oscillates(np.array([1.0, -0.09, 1.0, -0.09, 1.0]))
    assert _run._oscillates(np.array([1.0, -0.11, 1.0]))


def test_a_body_coasts_if_nine_tenths_of_its_speeds_fall():
    falling = np.linspace(10, 1, 60)  # compared over three blocks
    assert _run._coasts(falling)
    assert not _run._coasts(falling[::-1])
    for count, expected in ((5, True), (6, False)):  # of 57 pairs
        bumped = falling.copy()
        bumped[10 : 10 + 8 * count : 8] += 3.0
        assert _run._coasts(bumped) is expected
    assert not _run._coasts(np.array([2.0, 1.0]))
    assert _run._coasts(np.array([3.0, 2.0, 1.0]))


def test_slope_of_a_line():
    time, speed = np.array([0.0, 1.0, 2.0, 3.0]), np.array([1.0, 3.0, 4.0, 8.0])
    slope, rest, error = _run._slope(time, speed)
    assert slope == pytest.approx(2.2)
    residual = speed - np.polyval(np.polyfit(time, speed, 1), time)
    assert rest == pytest.approx(residual @ residual)
    assert error == pytest.approx(np.sqrt(rest / 2 / 5))


def noisy(speed, size=1e-3):
    return speed + size * np.random.default_rng(1).normal(size=len(speed))


@pytest.mark.parametrize(
    ("before", "driven"),
    [
        (lambda t: 60 + 0.0 * t, True),  # constant speed
        (lambda t: 60 - 0.35 * (t - 10), True),  # a deceleration of less than two fifths
        (lambda t: 60 - 0.5 * (t - 10), False),
        (lambda t: 60 - 1.0 * (t - 10), False),
        (lambda t: 6.0 * t, True),  # increasing
    ],
)
def test_end_of_a_drive(before, driven):
    time = 0.2 * np.arange(150)
    speed = noisy(np.where(time < 10, before(time), 60 - 1.0 * (time - 10)))
    block, found = _run._end_of_drive(time, speed)
    assert found is driven
    if driven:
        assert 10 <= time[block] < 11.5
    else:
        assert block == 0


@pytest.mark.parametrize(("step", "driven"), [(0.0, True), (4.6, True), (4.8, False)])
def test_a_constant_speed_of_less_than_two_steps_shows_no_drive(step, driven):
    """A free body would have slowed by 9.4 rad/s in the part of constant speed that is examined."""
    time = 0.2 * np.arange(150)
    speed = noisy(np.where(time < 10, 60.0, 60 - 1.0 * (time - 10)))
    assert _run._end_of_drive(time, speed, step)[1] is driven


def test_coarse_rounding_of_a_free_motion_shows_no_drive():
    time = 0.01 * np.arange(800)
    speed = 45 * np.exp(-0.04 * time) - 15  # dry and linear friction
    step = np.pi / 6  # 5 rpm
    made = replace(table_of(time, step * np.round(speed / step), "omega"), least_sigma=step / np.sqrt(12))
    assert len(_run.run_of(made, made.value, Limits())[0].time) == 800


def test_first_block_that_continues_the_parabola():
    time = np.arange(40.0)
    speed = noisy(20 - 0.5 * time + 0.004 * time**2, 1e-3)
    assert _run._first_free(time, speed, 5, 30) == 6
    speed[10] += 0.1
    assert _run._first_free(time, speed, 5, 30) == 12
    assert _run._first_free(time, speed, 11, 30) == 12
    speed[10] -= 0.1 - 0.003
    assert _run._first_free(time, speed, 5, 30) == 6
    assert _run._first_free(time[:8], speed[:8], 7, 7) == 7


def free(count=200):
    time = 0.1 * np.arange(count)
    return time, 20 - 0.8 * time, np.full(count, 1e-3)


def test_end_of_motion_at_rest():
    time, speed, error = free()
    assert _run._end_of_motion(time, speed, error, 0) == (199, "")
    speed = np.maximum(speed - 8, 0.0)
    block, what = _run._end_of_motion(time, speed, error, 0)
    assert what == "is at rest"
    assert block == 149
    for level, rest in (
        (0.021, True),
        (0.026, False),
    ):  # 3 errors and a thousandth of the largest speed: 0.023
        found = _run._end_of_motion(time, np.maximum(20 - 2.0 * time, level), error, 0)
        assert (found[1] == "is at rest") == rest
    assert _run._end_of_motion(time[:152], speed[:152], error[:152], 0)[1] == ""  # two blocks


@pytest.mark.parametrize(("ratio", "braked"), [(2.8, False), (3.2, True)])
def test_a_brake_triples_the_deceleration(ratio, braked):
    time, speed, error = free(160)
    late = time > 12
    speed[late] = speed[~late][-1] - 0.8 * ratio * (time[late] - 12.0)
    speed = np.maximum(speed, 0.0)
    block, what = _run._end_of_motion(time, speed, error, 0)
    assert (what == "is braked") is braked
    if braked:
        assert abs(time[block] - 12) < 0.5


@pytest.mark.parametrize(
    ("factor", "low", "disturbed"), [(1.2, 0.1, False), (1.4, 0.1, True), (1.4, 0.3, False)]
)
def test_a_disturbance_raises_a_low_speed_by_a_quarter(factor, low, disturbed):
    time = 0.1 * np.arange(200)
    speed = 20 * np.maximum(1 - (1 - low) * time / 15, low)
    speed[150:] = np.linspace(speed[149], factor * speed[149], 50)
    block, what = _run._end_of_motion(time, speed, np.full(200, 1e-4), 0)
    assert what.startswith("is disturbed") is disturbed
    if disturbed:
        assert 145 <= block <= 151


@pytest.mark.parametrize(
    ("rises", "free", "cut"), [(5, 2.0, False), (4, 2.0, False), (2, 2.0, True), (5, 12.0, True)]
)
def test_a_motor_whose_speed_varies_has_no_free_motion(rises, free, cut):
    """Rises to 60 % of the last one, each with a fall to a fifth of it, and a last fall that looks like coasting."""
    cycle = np.concatenate([np.linspace(4.0, 12.0, 120), np.linspace(12.0, 4.0, 80)])
    steady = np.full(200 * (5 - rises), 4.0)
    last = np.concatenate([np.linspace(4.0, 20.0, 120), np.linspace(20.0, 3.0, int(100 * free))])
    speed = np.concatenate([steady, np.tile(cycle, rises - 1), last])
    speed += np.random.default_rng(0).normal(0.0, 0.01, len(speed))
    table, _ = run_of(table_of(np.arange(len(speed)) / 100, speed, "omega"), speed, Limits())
    assert (len(table.time) < len(speed)) == cut


def test_run_without_drive_and_rest():
    time = 0.01 * np.arange(4000)
    speed = np.where(time < 10, 30.0, np.maximum(30 - 1.5 * (time - 10), 0.0))
    value = np.cumsum(speed) * 0.01 + 1e-5 * np.random.default_rng(0).normal(size=4000)
    table, kept = run_of(table_of(time, value), value, Limits())
    assert 10.0 <= table.time[0] < 10.6
    assert 29.4 < table.time[-1] < 30.2
    assert len(table.notes) == 2
    assert f"{int((time < table.time[0]).sum())} samples" in table.notes[0]
    assert f"{int((time > table.time[-1]).sum())} samples" in table.notes[1]
    np.testing.assert_array_equal(kept, value[np.isin(time, table.time)])
    assert run_of(table_of(time, value), value, Limits(keep_all=True))[0].notes == ()
    assert run_of(table_of(time[:31], value[:31]), value[:31], Limits())[0].notes == ()
    rising = np.cumsum(10 + time) * 0.01
    assert run_of(table_of(time, rising), rising, Limits())[0].notes == ()


def pendulum(count=6000, decay=0.02):
    time = 0.01 * np.arange(count)
    return time, np.exp(-decay * time) * np.sin(2 * np.pi * time / 1.5 - 0.3)


@pytest.mark.parametrize(("late", "cut"), [(0.008, False), (0.03, True)])
def test_an_irregular_period_precedes_the_free_motion(late, cut):
    """A hand lengthens the third period by this share; 1 % is required."""
    time, _ = pendulum()
    begin = 2 * 1.5 + 0.3 / (2 * np.pi) * 1.5
    phase = np.where(
        time < begin,
        time,
        np.where(time < begin + 1.5 * (1 + late), begin + (time - begin) / (1 + late), time - 1.5 * late),
    )
    value = np.exp(-0.02 * time) * np.sin(2 * np.pi * phase / 1.5 - 0.3)
    found = start_of_oscillation(time, value)
    assert bool(found) is cut
    if cut:
        assert abs(time[found] - begin - 1.5 * (1 + late)) < 0.03


@pytest.mark.parametrize(("share", "cut"), [(0.03, False), (0.15, True)])
def test_an_irregular_amplitude_precedes_the_free_motion(share, cut):
    time, value = pendulum()
    value = np.where(time < 3.07, value * (1 + share), value)
    assert bool(start_of_oscillation(time, value)) is cut


@pytest.mark.parametrize(("hold", "cut"), [(0.05, False), (0.5, True), (1.0, True), (4.0, True)])
def test_a_body_that_is_held_at_the_start(hold, cut):
    time = 0.01 * np.arange(6000)
    moved = np.maximum(time - hold, 0.0)
    value = -np.exp(-0.02 * moved) * np.cos(2 * np.pi * moved / 1.5)
    found = start_of_oscillation(time, value)
    assert bool(found) is cut
    if cut:
        assert time[found] == pytest.approx(hold + 0.375 + 1.5, abs=0.05)


@pytest.mark.parametrize(("hold", "cut"), [(0.0, False), (0.3, True), (0.7, True)])
def test_a_hold_at_the_start_exceeds_the_noise(hold, cut):
    noise = 0.02  # below the hysteresis of the zero crossings, 2 % of the range
    time = 0.01 * np.arange(2000)
    moved = np.maximum(time - hold, 0.0)
    value = -np.exp(-0.02 * moved) * np.cos(2 * np.pi * moved / 1.5)
    value += noise * np.random.default_rng(1).normal(size=len(time))
    assert bool(start_of_oscillation(time, value)) is cut


@pytest.mark.parametrize(("periods", "cut"), [(4, False), (6, True), (11, True)])
def test_five_crossings_show_a_hold(periods, cut):
    _, value = pendulum(150 * periods)
    held = np.concatenate([np.full(400, -0.3), value])
    assert bool(start_of_oscillation(0.01 * np.arange(len(held)), held)) is cut


def test_twelve_crossings_show_an_irregular_amplitude():
    time, value = pendulum()
    value = np.where(time < 3.07, value * 1.15, value)
    assert start_of_oscillation(time[:1750], value[:1750]) == 0
    assert start_of_oscillation(time, value) > 0


@pytest.mark.parametrize("share", [1.0, 3.0])
def test_an_oscillation_ends_where_it_is_at_rest(share):
    """At rest the means vary by 0.2 % of the range, or by less than eight errors."""
    time = 0.01 * np.arange(6000)
    value = np.where(time < 30, np.cos(2 * np.pi * time / 1.5) * np.maximum(1 - time / 30, 0), 0.0)
    value += share * 1e-3 * np.sin(2 * np.pi * time / 1.5)
    found = end_of_oscillation(time, value, np.full(6000, 1e-5))
    assert (found < 6000) == (share == 1.0)
    if share == 1.0:
        assert 27 < time[found - 1] < 30.5
    quiet = end_of_oscillation(time, value, np.full(6000, 5e-3))
    assert 24 < time[quiet - 1] < 30.5


def test_rest_of_less_than_a_period_is_motion():
    time = 0.01 * np.arange(3140)
    value = np.where(time < 30, np.cos(2 * np.pi * time / 1.5) * np.maximum(1 - time / 32, 0), 0.0)
    sigma = np.full(3140, 1e-5)
    assert end_of_oscillation(time, value, sigma) == 3140
    longer = 0.01 * np.arange(3400)
    value = np.append(value, np.zeros(260))
    assert 29.5 < longer[end_of_oscillation(longer, value, np.full(3400, 1e-5)) - 1] < 30.3
    assert end_of_oscillation(time, time, sigma) == 3140


def test_deflections_below_two_steps_of_the_resolution_are_excluded():
    time = 0.01 * np.arange(6000)
    exact = np.cos(2 * np.pi * time / 1.5) * np.exp(-time / 10)
    step = 0.02
    value = np.round(exact / step) * step
    table = table_of(time, value, least_sigma=step / np.sqrt(12))
    found = _run._end_of_resolution(table, value)
    last = np.flatnonzero(np.abs(value) > 2 * step + 1e-9)[-1] + 1
    assert found == last
    assert _run._end_of_resolution(table_of(time, value, least_sigma=0.0), value) == 6000
    fine = table_of(time, exact + 0.02 * np.random.default_rng(0).normal(size=6000), least_sigma=1e-4)
    assert _run._end_of_resolution(fine, fine.value) == 6000
    cut, kept = run_of(table, value, Limits())
    assert len(kept) == found
    assert any("2 steps" in note for note in cut.notes)


# ---- outliers


@pytest.mark.parametrize(("size", "found"), [(42.0, False), (48.0, True)])
def test_an_outlier_deviates_by_ten_errors_of_the_prediction(size, found):
    """The prediction of three equidistant samples has the weights 3, -3 and 1: an error of sqrt(20) sigma."""
    time = 0.1 * np.arange(40)
    value = 2 * time**2
    value[20] += size * 1e-3
    assert (outliers(time, value, np.full(40, 1e-3)).tolist() == [20]) is found
    assert outliers(time, -value, np.full(40, 1e-3)).tolist() == ([20] if found else [])


def test_a_kink_is_not_an_outlier():
    time = 0.1 * np.arange(40)
    sigma = np.full(40, 1e-3)
    assert len(outliers(time, np.abs(time - 2.0), sigma)) == 0
    assert len(outliers(time, np.where(time > 2, 1.0, 0.0), sigma)) == 0
    uneven = np.sort(np.random.default_rng(0).uniform(0, 4, 40))
    value = uneven**2
    assert len(outliers(uneven, value, sigma)) == 0
    value[3] += 100
    assert outliers(uneven, value, sigma).tolist() == [3]
    # the two deviations differ by less than half of the smaller one
    for bend, found in ((0.02, [20]), (0.08, [])):
        value = np.where(time > 2.0, bend * 1e-9, 0.0)
        value[20] = 0.1
        value[21:] = bend
        assert outliers(time, value, sigma).tolist() == found


def test_two_percent_of_outliers_are_excluded():
    time = 0.1 * np.arange(200)
    for count, kept in ((4, 196), (5, 200)):
        value = time.copy()
        value[20 : 20 + 30 * count : 30] += 5
        notes = []
        table, values = without_outliers(table_of(time, value, least_sigma=1e-3), value, notes)
        assert len(table.time) == len(values) == kept
        assert len(notes) == (kept < 200)
    value = time.copy()
    value[20] += 5
    notes = []
    assert (
        len(without_outliers(table_of(time, value, least_sigma=1e-3), value, notes, keep_all=True)[1]) == 200
    )
    counted = table_of(time, value, least_sigma=1e-3, counted=True)
    assert len(without_outliers(counted, value, notes)[1]) == 200
    given = replace(table_of(time, value, least_sigma=0.0), sigma=np.full(200, 3.0))
    assert len(without_outliers(given, value, notes)[1]) == 200
    short = replace(given, sigma=np.full(200, 1e-3)).only(np.arange(14) + 10)
    assert len(without_outliers(short, short.value, notes)[1]) == 14
    assert notes == []
    enough = replace(given, sigma=np.full(200, 1e-3)).only(np.arange(15) + 10)
    assert len(without_outliers(enough, enough.value, notes)[1]) == 14


@pytest.mark.parametrize(("period", "coasts"), [(20, True), (40, False)])
def test_speeds_are_compared_over_a_twentieth_of_the_record(period, coasts):
    """A ripple cancels if the twentieth, 20 of 400 blocks, is its period."""
    k = np.arange(400)
    assert _run._coasts(900.0 - k + 12.0 * np.sin(2 * np.pi * k / period)) is coasts


@pytest.mark.parametrize(("fall", "kept"), [(0.0, 10000), (30.0, 1100)])
def test_speeds_that_fall_by_chance_after_a_drive_are_not_a_coast(fall, kept):
    """A motor starts from rest and turns at a constant speed; with this noise, the last speeds fall."""
    time = 0.002 * np.arange(10000)
    block = np.arange(10000) // 25
    noise = np.random.default_rng(101).normal(size=400)[block]
    value = np.where(block < 150, 0.0, 60.0 + noise) - np.maximum(block - 355, 0) * fall / 44
    table = run_of(table_of(time, value, "omega"), value, Limits())[0]
    assert len(table.time) == pytest.approx(kept, abs=150)
    assert bool(table.notes) is (fall > 0)
