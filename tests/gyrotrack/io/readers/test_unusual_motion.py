"""What would be unusual in s and rad is asked for, and what no motion does is refused; the usual is read."""

import numpy as np
import pytest

from gyrotrack import DatasetError, import_body
from gyrotrack.io.readers._motion_table import ReadOptions, read_names
from gyrotrack.io.readers._registry import read_motion, read_passages


@pytest.fixture
def write(tmp_path):
    def made(head, *columns, name="a.csv"):
        path = tmp_path / name
        path.write_text(
            head + "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in zip(*columns, strict=True))
        )
        return path

    return made


TIME = np.arange(600) / 60
SWING = np.cos(5 * TIME) * np.exp(-TIME / 20)


def named(*names):
    return ReadOptions(read_names(names))


@pytest.mark.parametrize(
    ("head", "size", "asked"),
    [
        ("t,angle\n", 3.0, False),
        ("t,angle\n", 3.6, True),  # more than half a turn to either side
        ("t,angle [rad]\n", 30.0, False),
        ("t,angle [deg]\n", 30.0, False),
    ],
)
def test_the_unit_of_a_wide_oscillation_must_be_stated(write, head, size, asked):
    path = write(head, TIME, size * SWING)
    if not asked:
        assert len(read_motion(path).time) == len(TIME)
        return
    with pytest.raises(DatasetError, match="turns to either side") as caught:
        read_motion(path)
    assert "--column 'angle=angle [deg]'" in caught.value.hint
    assert np.ptp(read_motion(path, named("t=t", "angle=angle [deg]")).value) < 0.2


@pytest.mark.parametrize(("step", "asked"), [(3.0, False), (3.3, True)])
def test_the_unit_of_a_fast_rotation_must_be_stated(write, step, asked):
    path = write("t,angle\n", TIME, step * (60 * TIME - 0.1 * TIME**2))
    if asked:
        with pytest.raises(DatasetError, match="turns between two samples"):
            read_motion(path)
    else:
        assert read_motion(path).quantity == "angle"


@pytest.mark.parametrize(
    ("head", "step", "asked"),
    [("t,angle\n", 0.39, False), ("t,angle\n", 0.41, True), ("t [s],angle\n", 5.0, False)],
)
def test_the_unit_of_slow_times_must_be_stated(write, head, step, asked):
    time = step * np.arange(200)
    path = write(head, time, 0.1 * time - 1e-5 * time**2)
    if asked:
        with pytest.raises(DatasetError, match=r"its steps of 0\.41 would be long"):
            read_motion(path)
        assert read_motion(path, named("t=t [ms]", "angle=angle")).time[-1] < 1
    else:
        assert read_motion(path).time[-1] == pytest.approx(time[-1])


def test_points_have_times_with_a_unit_too(write):
    turn = np.arange(200) * 0.05
    columns = 100 * np.cos(turn), 100 * np.sin(turn)
    with pytest.raises(DatasetError, match="would be long in seconds"):
        read_motion(write("t,x,y\n", 33.3 * np.arange(200), *columns), ReadOptions(centre="0,0"))
    read = read_motion(write("t,x,y\n", 0.0333 * np.arange(200), *columns), ReadOptions(centre="0,0"))
    assert len(read.time) == 200


@pytest.mark.parametrize(("size", "refused"), [(1.35, True), (2 * np.pi, False)])
def test_an_angle_that_overflows_at_no_whole_turn_is_refused(write, size, refused):
    path = write("t [s],angle [rad]\n", TIME, (1.5 * SWING + 0.001 * TIME) % size)
    if refused:
        with pytest.raises(DatasetError, match="jumps repeatedly by its whole range"):
            import_body(path, 1.0)
    else:
        assert np.ptp(import_body(path, 1.0).casing.angle) == pytest.approx(np.ptp(1.5 * SWING), rel=0.02)


@pytest.mark.parametrize(("jump", "refused"), [(0.15, False), (0.35, True)])
def test_an_angle_that_begins_again_is_refused_also_where_it_oscillates(write, jump, refused):
    """The largest usual change is 0.083 rad: a step of 0.15 may be motion, one of 0.35 is none."""
    angle = SWING + np.random.default_rng(0).normal(0, 1e-3, len(TIME))
    path = write("t [s],angle [rad]\n", TIME, np.where(TIME > 5.03, angle + jump, angle))
    if refused:
        with pytest.raises(DatasetError, match="too far for a motion"):
            import_body(path, 1.0)
    else:
        assert len(import_body(path, 1.0).casing.time) == len(TIME)


@pytest.mark.parametrize(("speed", "refused"), [(150.0, False), (230.0, True)])
def test_a_wrapped_angle_whose_steps_pass_through_half_a_turn_is_refused(write, speed, refused):
    """At 60 samples/s half a turn is 188 rad/s; from 230 rad/s on the body passes it while it slows down."""
    angle = (speed * TIME - 0.5 * speed / 12 * TIME**2) % (2 * np.pi)
    path = write("t [s],angle [rad]\n", TIME, angle)
    if refused:
        with pytest.raises(DatasetError, match="half a turn between two samples"):
            import_body(path, 1.0)
    else:
        assert import_body(path, 1.0).casing.angle[-1] == pytest.approx(
            speed * TIME[-1] - 0.5 * speed / 12 * TIME[-1] ** 2, rel=1e-3
        )


@pytest.mark.parametrize(("same", "refused"), [(3, False), (5, True)])
def test_a_clock_without_digits_is_refused(write, same, refused):
    """Of rows in groups of one time, two thirds repeat a time with three in each, four fifths with five."""
    time = np.floor(np.arange(600) / same) / 20
    path = write("t [s],angle [rad]\n", time, 0.02 * np.arange(600) - 1e-6 * np.arange(600) ** 2)
    if refused:
        with pytest.raises(DatasetError, match="rows repeat a time"):
            read_motion(path)
    else:
        assert len(read_motion(path).time) == 200


@pytest.mark.parametrize(("factor", "refused"), [(1, False), (1000, True)])
def test_the_unit_of_whole_times_with_large_steps_must_be_stated(write, factor, refused):
    time = np.rint(1e6 * np.cumsum(np.linspace(0.05, 0.2, 300))) * factor
    path = write("", time, np.arange(300), 0 * time + 3)
    if refused:
        with pytest.raises(DatasetError, match="their unit is not stated"):
            read_motion(path, named("revolutions=2"))
        assert len(read_motion(path, named("revolutions=2", "t=1 [ns]")).time) > 290
    else:
        assert len(read_motion(path, named("revolutions=2")).time) > 290


@pytest.mark.parametrize(
    ("pause", "after", "refused"), [(30.0, 1.0, True), (1.0, 1.0, False), (30.0, 2.0, False)]
)
def test_a_pause_of_a_counter_at_the_same_speed_is_refused(write, pause, after, refused):
    """A body that rests in between does not turn at the same speed before and after."""
    step = np.linspace(0.1, 0.2, 300)
    step[151:] *= after
    step[150] *= pause
    path = write("t [s],revolutions\n", np.cumsum(step), np.arange(300))
    if refused:
        with pytest.raises(DatasetError, match="the speed is the same before and after"):
            read_motion(path)
    else:
        assert len(read_motion(path).time) > 290


@pytest.mark.parametrize(("lost", "refused"), [(0.02, False), (0.33, True)])
def test_a_pendulum_with_lost_passages_is_refused(write, lost, refused):
    half, rng = 0.8, np.random.default_rng(3)
    middle = half * np.arange(400)
    width = 0.05 * np.exp(middle / 400)
    keep = rng.random(400) > lost
    begin, end = (middle - width)[keep], (middle + width)[keep]
    time = np.column_stack([begin, end]).ravel()
    path = write("Time [s],State at A\n", time, np.tile([1.0, 0.0], len(begin)))
    if refused:
        with pytest.raises(DatasetError, match="passages are missing"):
            read_passages(path, ReadOptions())
    else:
        assert len(read_passages(path, ReadOptions()).time) >= len(begin) - 1


@pytest.mark.parametrize(
    ("columns", "hint"),
    [
        ((TIME,), "times of pulses or intervals between them"),
        ((TIME, SWING), "--column t=1 --column 'angle=2 [deg]'"),
        ((np.arange(600), np.arange(600), SWING), "--casing-fps N --column 'angle=3 [deg]'"),
    ],
)
def test_the_hint_for_columns_without_header_names_one_that_is_not_an_index(write, columns, hint):
    with pytest.raises(DatasetError, match="no header") as caught:
        read_motion(write("", *columns))
    assert hint in caught.value.hint
