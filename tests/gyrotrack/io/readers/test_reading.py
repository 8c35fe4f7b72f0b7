"""What a table is taken for: each doubt about it is mended and told, or asked for, on both sides of its threshold."""

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.io.readers._motion_table import ReadOptions, read_names
from gyrotrack.io.readers._plausibility import (
    are_intervals,
    counts_rows,
    may_be_intervals,
    rises,
    wrapping_unit,
)
from gyrotrack.io.readers._pulses import varies_both_ways
from gyrotrack.io.readers._registry import read_motion

TIME = np.arange(400) / 100
ANGLE = 0.3 + 20 * TIME - 1.5 * TIME**2


def write(path, *columns, head="", decimals=9):
    lines = [",".join(f"{v:.{decimals}g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text((head + "\n" if head else "") + "\n".join(lines) + "\n")
    return path


def options(*columns, **others):
    return ReadOptions(names=read_names(columns) if columns else None, **others)


def test_two_lines_say_what_each_column_is_and_what_is_left_out(tmp_path):
    path = write(tmp_path / "run.csv", TIME, np.degrees(ANGLE), TIME, head="t,phi [deg],mass")
    taken, left_out = read_motion(path).reading.lines()
    assert taken == (
        "run.csv (text, 400 rows): time from 't' [s] (by its name; SI by convention); angle from 'phi [deg]' [deg] "
        "(by its name)."
    )
    assert left_out == "run.csv: unused columns: 'mass'."


def test_an_index_of_the_rows_is_not_a_counter(tmp_path):
    index = np.arange(400)
    path = write(tmp_path / "a.csv", index, index, np.degrees(ANGLE))
    with pytest.raises(DatasetError, match="1 and 2 number the rows"):
        read_motion(path)
    with pytest.raises(DatasetError, match="numbers the rows and contains no times"):
        read_motion(path, options(pulses_per_turn=1.0))
    read = read_motion(path, options("angle=3 [deg]", fps=100.0))
    np.testing.assert_allclose(read.time, TIME)
    np.testing.assert_allclose(read.value, ANGLE, rtol=1e-6)


def test_a_counter_in_which_every_row_counts_has_the_irregular_times_of_pulses(tmp_path):
    """Pulses of a coast-down: the number of the row is the count, because rows exist only at pulses."""
    times = -40 * np.log(1 - 2 * np.pi * np.arange(300) / (60 * 40))
    read = read_motion(write(tmp_path / "a.csv", times, np.arange(300)))
    np.testing.assert_allclose(np.diff(read.value), 2 * np.pi)
    sampled = write(tmp_path / "b.csv", TIME[:300], np.arange(300))
    with pytest.raises(DatasetError, match="2 numbers the rows"):
        read_motion(sampled)


def test_consecutive_numbers():
    assert counts_rows(np.arange(3.0, 11.0))
    assert not counts_rows(np.arange(3.0, 10.0))  # too few
    assert not counts_rows(np.append(np.arange(20.0), 21.0))


def rowing():
    """Intervals of a body that is pulled once a second."""
    return 0.03 * (1 + 0.4 * np.sin(np.arange(600) / 12))


def test_intervals_between_pulses_are_not_times(tmp_path):
    read = read_motion(write(tmp_path / "a.csv", rowing()), options(pulses_per_turn=3.0))
    np.testing.assert_allclose(read.time, np.cumsum(rowing()), rtol=1e-6)
    np.testing.assert_allclose(np.diff(read.value), 2 * np.pi / 3, atol=2e-3)  # the marks are corrected
    assert "not times: 50 % of the values are smaller than the value before" in read.reading.lines()[0]
    falling = write(tmp_path / "b.csv", np.sort(rowing()))
    asked = read_motion(falling, options("interval=1", pulses_per_turn=3.0))
    np.testing.assert_allclose(asked.time, np.cumsum(np.sort(rowing())), rtol=1e-6)


@pytest.mark.parametrize(("back", "intervals"), [(4, False), (8, True)])
def test_the_share_of_steps_back_of_intervals(back, intervals):
    values = np.arange(1.0, 102.0)
    values[1 : 1 + 2 * back : 2] += 1.5
    assert are_intervals(values) is intervals


def test_no_pulse_is_added_where_the_speed_rises_and_falls(tmp_path):
    gap = np.delete(np.cumsum(rowing()), 300)
    read = read_motion(write(tmp_path / "a.csv", gap), options(pulses_per_turn=1.0))
    assert np.ptp(read.value) == pytest.approx(2 * np.pi * (len(gap) - 1))
    assert "missed and double pulses are not looked for" in " ".join(read.notes)


@pytest.mark.parametrize(
    ("noise", "swing", "driven"), [(0.2, 0.0, False), (0.2, 0.7, True), (0.01, 0.3, True)]
)
def test_scatter_of_the_intervals_is_not_a_drive(noise, swing, driven):
    rng = np.random.default_rng(4)
    interval = 0.03 * np.exp(swing * np.sin(np.arange(5000) / 40) + np.arange(5000) / 5000)
    times = np.cumsum(interval) + noise * interval * rng.normal(size=5000)
    assert varies_both_ways(np.unique(times)) is driven


@pytest.mark.parametrize(("least", "count"), [(0.9, 2), (1.1, 1), (2.1, 0)])
def test_rises(least, count):
    assert rises(np.array([5.0, 4, 5, 4, 3, 4, 5, 0]), least) == count


@pytest.mark.parametrize("delay", [-0.04, 0.04])
def test_a_step_of_the_clock_is_found_and_corrected(tmp_path, delay):
    stated = np.where(np.arange(400) < 200, TIME, TIME + delay)
    value = ANGLE + np.random.default_rng(1).normal(0, 1e-3, 400)
    read = read_motion(write(tmp_path / "a.csv", stated, value, head="t,angle"))
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    (note,) = [n for n in read.notes if "the clock steps" in n]
    assert f"line 202: the clock steps by {delay:+.2g} s" in note


def test_lost_rows_are_not_step_of_the_clock(tmp_path):
    keep = np.abs(np.arange(400) - 200) > 4
    value = ANGLE + np.random.default_rng(1).normal(0, 1e-3, 400)
    read = read_motion(write(tmp_path / "a.csv", TIME[keep], value[keep], head="t,angle"))
    np.testing.assert_allclose(read.time, TIME[keep])
    # a clock that is set back while rows are lost contradicts the values
    stated = np.where(np.arange(400) < 200, TIME, TIME - 0.2)[keep]
    with pytest.raises(DatasetError, match=r"line 198: the clock steps by .* rows are missing between"):
        read_motion(write(tmp_path / "b.csv", stated, value[keep], head="t,angle"))


@pytest.mark.parametrize(("count", "refused"), [(3, False), (6, True)])
def test_few_rows_out_of_order_are_sorted_at_irregular_times(tmp_path, count, refused):
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(0.005, 0.015, 400))
    order = np.arange(400)
    for k in range(20, 20 + 40 * count, 40):
        order[k : k + 3] = order[k : k + 3][[2, 0, 1]]
    path = write(tmp_path / "a.csv", time[order], (20 * time)[order], head="t,angle")
    if refused:
        with pytest.raises(DatasetError, match="6 of 400 rows are out of order"):
            read_motion(path)
    else:
        np.testing.assert_allclose(read_motion(path).time, time, rtol=1e-6)


def test_a_record_in_reverse_order(tmp_path):
    read = read_motion(write(tmp_path / "a.csv", TIME[::-1], ANGLE[::-1], head="t,angle"))
    np.testing.assert_allclose(read.value, ANGLE)


@pytest.mark.parametrize(("unit", "period"), [("rad", 2 * np.pi), ("deg", 360), ("turns", 1), ("gon", 400)])
def test_an_angle_that_wraps_states_its_unit(tmp_path, unit, period):
    wrapped = ANGLE / (2 * np.pi) * period % period
    assert wrapping_unit(wrapped) == unit
    path = write(tmp_path / "a.csv", TIME, wrapped, head="t,angle")
    np.testing.assert_allclose(read_motion(path).value, ANGLE % (2 * np.pi), atol=1e-6)
    wrong = write(tmp_path / "b.csv", TIME, wrapped, head=f"t,angle [{'deg' if unit != 'deg' else 'rad'}]")
    with pytest.raises(DatasetError, match=f"wraps at a whole turn in {unit}"):
        read_motion(wrong)


@pytest.mark.parametrize("period", [2 * np.pi * 1.05, 340.0, 4096.0])
def test_an_angle_that_wraps_elsewhere_states_none(period):
    assert not wrapping_unit(ANGLE / (2 * np.pi) * period % period)
    assert not wrapping_unit(np.sin(TIME * 20))


def test_an_angle_and_its_speed_state_each_other_s_unit(tmp_path):
    speed = 20 - 3 * TIME
    good = write(tmp_path / "a.csv", TIME, ANGLE, speed, head="t,angle,omega")
    assert read_motion(good).quantity == "angle"
    bad = write(tmp_path / "b.csv", TIME, np.degrees(ANGLE), speed, head="t,angle,omega")
    with pytest.raises(DatasetError, match=r"is 57\.3 times 'omega': one of them is in degrees") as caught:
        read_motion(bad)
    assert "--column 'angle=angle [deg]'" in str(caught.value)
    np.testing.assert_allclose(read_motion(bad, options("angle=angle [deg]")).value, ANGLE, atol=1e-6)


def test_exchanged_columns(tmp_path):
    with pytest.raises(DatasetError, match="may be exchanged"):
        read_motion(write(tmp_path / "a.csv", ANGLE, TIME, head="t,angle"))
    # the angles of pulses also grow in equal steps, of whole parts of a turn
    pulses = write(
        tmp_path / "b.csv",
        np.cumsum(np.linspace(0.01, 0.02, 400)),
        np.arange(400) * np.pi / 3,
        head="t,angle",
    )
    assert len(read_motion(pulses).time) == 400


@pytest.mark.parametrize(("step", "exchanged"), [(60.0, False), (50.0, True)])
def test_exchanged_columns_of_an_angle_in_degrees(tmp_path, step, exchanged):
    """The angles of pulses are whole parts of 360 degrees."""
    time = np.cumsum(np.linspace(0.01, 0.02, 400))
    path = write(tmp_path / "a.csv", time, step * np.arange(400), head="t,angle [deg]")
    if exchanged:
        with pytest.raises(DatasetError, match="may be exchanged"):
            read_motion(path)
    else:
        np.testing.assert_allclose(np.diff(read_motion(path).value), np.radians(step))


def circle(centre, radius=80.0, arc=4.0):
    phase = arc / 2 * np.sin(2 * np.pi * TIME)
    noise = np.random.default_rng(3).normal(0, 0.5, (400, 2))
    return np.column_stack([np.cos(phase), np.sin(phase)]) * radius + centre + noise


@pytest.mark.parametrize(("offset", "doubt"), [(1.0, False), (20.0, True)])
def test_a_centre_that_is_not_that_of_the_path_is_doubted_with_a_number(tmp_path, offset, doubt):
    x, y = circle([offset, 0.0]).T
    path = write(tmp_path / "a.csv", TIME, x, y, head="t,x,y")
    read = read_motion(path, ReadOptions(centre="0,0"))
    assert bool(read.doubts) is doubt
    if doubt:
        assert "a centre that is 20 +- " in read.doubts[0]
    assert not read_motion(path, ReadOptions(centre="orbit")).doubts


def test_a_signal_in_volts_is_an_angle_only_if_the_user_states_it(tmp_path):
    text = "Voltage, ChA, Run #2\r\nTime ( s )\tVoltage ( V )\r\n" + "".join(
        f"{t:.3f}\t{np.cos(3 * t):.4f}\r\n" for t in TIME
    )
    path = tmp_path / "title.txt"
    path.write_text(text)
    with pytest.raises(DatasetError, match="no column for the angle") as caught:
        read_motion(path)
    assert "--column 'angle=Voltage ( V )'" in str(caught.value)
    read = read_motion(path, options("angle=2"))
    np.testing.assert_allclose(read.value, np.cos(3 * TIME), atol=1e-4)
    assert any("only times and ratios are meaningful" in note for note in read.notes)


def passages(law, count=200):
    """Times at which a body passes its marks, 2 pi / 12 apart, from 60 rad/s on."""
    angle = np.arange(count) * 2 * np.pi / 12
    if law == "viscous":
        return -4 * np.log(1 - angle / 240)
    return (60 - np.sqrt(60**2 - 2 * 15 * angle)) / 15  # dry


@pytest.mark.parametrize("law", ["viscous", "dry"])
def test_increasing_intervals_must_be_confirmed(tmp_path, law):
    times = passages(law)
    path = write(tmp_path / "a.csv", np.diff(times))
    with pytest.raises(DatasetError, match="times of pulses or intervals") as caught:
        read_motion(path, options(pulses_per_turn=12.0))
    assert "--column interval=1" in str(caught.value)
    read = read_motion(path, options("interval=1", pulses_per_turn=12.0))
    np.testing.assert_allclose(read.time, times[1:], rtol=1e-6)
    for start in (0.0, 1.0, 1000.0):
        assert not may_be_intervals(times + start)


@pytest.mark.parametrize(
    ("head", "column"),
    [
        ("__time,/imu/angular_velocity/x,/imu/angular_velocity/z", "omega=/imu/angular_velocity [rad/s]"),
        ("%time,field.angular_velocity.x,field.angular_velocity.z", "omega=field.angular_velocity [rad/s]"),
    ],
)
def test_topics_of_ros(tmp_path, head, column):
    since = 1.7e9 + TIME
    path = write(tmp_path / "a.csv", since, 0 * TIME, 20 - 3 * TIME, head=head, decimals=14)
    with pytest.raises(DatasetError, match="is not stated"):
        read_motion(path)
    np.testing.assert_allclose(read_motion(path, options(column)).value, 20 - 3 * TIME, atol=1e-6)


def test_units_in_brackets_below_the_header(tmp_path):
    path = write(tmp_path / "a.csv", 1e3 * TIME, np.degrees(ANGLE), head="Zeit,Winkel\n[ms],[deg]")
    np.testing.assert_allclose(read_motion(path).value, ANGLE, atol=1e-6)
    np.testing.assert_allclose(read_motion(path).time, TIME, atol=1e-9)


def test_grad_is_degrees_in_german_and_gon_elsewhere(tmp_path):
    path = write(tmp_path / "a.csv", TIME, np.degrees(ANGLE), head="Zeit [s],Winkel [grad]")
    with pytest.raises(DatasetError, match="unknown unit 'grad'"):
        read_motion(path)
    np.testing.assert_allclose(read_motion(path, options("angle=Winkel [deg]")).value, ANGLE, atol=1e-6)


def test_a_column_that_is_there_twice_is_read_once(tmp_path):
    speed = 20 - 3 * TIME
    read = read_motion(write(tmp_path / "a.csv", TIME, speed, speed, head="t,omega,omega"))
    np.testing.assert_allclose(read.value, speed, atol=1e-6)
    with pytest.raises(DatasetError, match="2 columns for 'omega'"):
        read_motion(write(tmp_path / "b.csv", TIME, speed, speed + 1, head="t,omega1,omega2"))


def test_a_sensor_that_is_stuck(tmp_path):
    with pytest.raises(DatasetError, match="all 400 speeds are 7 rad/s"):
        read_motion(write(tmp_path / "a.csv", TIME, 0 * TIME + 7, head="t,omega"))


@pytest.mark.parametrize(("digits", "refused"), [(1, True), (4, False)])
def test_times_of_pulses_with_too_few_digits(tmp_path, digits, refused):
    times = 10 + passages("dry", 100)
    path = tmp_path / "a.csv"
    path.write_text("".join(f"{t:.{digits}f}\n" for t in times))
    if refused:
        with pytest.raises(DatasetError, match="times of pulses are repeated"):
            read_motion(path, options(pulses_per_turn=12.0))
    else:
        assert len(read_motion(path, options(pulses_per_turn=12.0)).time) == 100


def test_sampled_counts_at_times_without_digits(tmp_path):
    whole = write(tmp_path / "a.csv", np.floor(TIME), np.round(300 * TIME))
    with pytest.raises(DatasetError, match="most times in column 1 are repeated"):
        read_motion(whole, options(pulses_per_turn=500.0))
    few = write(tmp_path / "b.csv", np.floor(60 * TIME) / 60, np.round(300 * TIME))
    assert read_motion(few, options(pulses_per_turn=500.0)).quantity == "angle"
