import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrotrack import DatasetError, import_body
from gyrotrack.io.readers._import_case import is_wrapped, unwrap
from gyrotrack.io.readers._motion_table import pieces
from gyrotrack.io.readers._raw_table import TURN


def wrapped(angle, low=0.0):
    return np.mod(angle - low, TURN) + low


@pytest.mark.parametrize(
    ("fps", "speed"), [(260, 160.0), (260, -160.0), (1000, 900.0), (1000, 2500.0), (260, 0.3)]
)
def test_turns_are_counted_with_samples_missing(fps, speed):
    rng = np.random.default_rng(1)
    time = np.arange(3000) / fps
    angle = speed * time - 0.05 * speed * time**2
    keep = rng.random(time.size) > 0.3
    keep[1000:1018] = False
    noisy = angle + rng.normal(size=time.size) * 5e-3
    result, doubtful = unwrap(time[keep], wrapped(noisy, -np.pi)[keep])
    error = result - noisy[keep]
    assert np.ptp(error) < 1e-9
    assert not doubtful


@settings(max_examples=40, deadline=None)
@given(st.floats(-500, 500), st.floats(-60, 60), st.integers(0, 2**31))
def test_any_smooth_motion_is_unwrapped(speed, slope, seed):
    rng = np.random.default_rng(seed)
    time = np.arange(600) / 260
    angle = speed * time + slope * time**2 / 2
    keep = rng.random(time.size) > 0.2
    result, _ = unwrap(time[keep], wrapped(angle)[keep])
    assert np.ptp(result - angle[keep]) < 1e-6


def test_a_false_sample_does_not_lose_a_turn():
    time = np.arange(2000) / 260
    angle = 100 * time
    bad = wrapped(angle)
    bad[700] = np.mod(bad[700] + 3.0, TURN)
    result, _ = unwrap(time, bad)
    assert np.abs((result - angle)[-1] - (result - angle)[0]) < 1e-9


def test_a_gap_in_which_the_speed_changes_much_is_doubtful():
    time = np.concatenate([np.arange(500) / 260, 4 + np.arange(500) / 260])
    angle = 100 * time - 8 * time**2
    _, doubtful = unwrap(time, wrapped(angle))
    assert doubtful == [pytest.approx(time[499])]


def test_long_gaps_part_the_pieces():
    time = np.concatenate([np.arange(100) / 1000, 5 + np.arange(50) / 1000])
    assert pieces(time) == [slice(0, 100), slice(100, 150)]
    assert pieces(time[:100]) == [slice(0, 100)]


def test_wrapped_angles_stay_within_a_turn():
    assert is_wrapped(np.angle(np.exp(1j * np.linspace(0, 20, 50))))
    assert not is_wrapped(np.linspace(-3, 3, 50))
    assert not is_wrapped(np.linspace(0, 7, 50))


def test_an_angle_that_jumps_is_refused(tmp_path):
    time = np.arange(2000) / 50
    angle = 80 * time - 0.7 * time**2 + np.random.default_rng(0).normal(0, 5e-3, 2000)
    path = tmp_path / "a.csv"

    def read(values):
        path.write_text("t,angle\n" + "".join(f"{t},{a}\n" for t, a in zip(time, values, strict=True)))
        return import_body(path, 1.0)

    read(angle)
    # a sample that a logger has lost is a gap, not a jump; a body that is at rest most of the time may turn
    read(np.where(np.arange(2000) % 400 == 7, np.nan, angle))
    pushed = np.interp(time, [0, 30, 30.2, 40], [0, 0, 3, 3]) + np.random.default_rng(1).normal(0, 1e-3, 2000)
    read(pushed)
    with pytest.raises(DatasetError, match=r"line 1202: the angle jumps by 1144.7 rad at 24 s.*1 such jump"):
        read(angle + 2**16 * 2 * np.pi / 360 * (time >= 24))


@pytest.mark.parametrize(
    ("turns", "accepted"),
    [
        (1, True),
        (-1, True),
        (2, True),
        (-3, True),
        (0.93, False),
        (-0.93, False),
        (-1.5, False),
        (4, False),
        (-4, False),
    ],
)
@pytest.mark.parametrize("speed", [5.0, 40.0])
def test_a_slip_by_whole_turns_in_either_sense_is_kept_for_the_fit(tmp_path, speed, turns, accepted):
    time = np.arange(2000) / 50
    angle = speed * time - speed / 100 * time**2 + np.random.default_rng(0).normal(0, 5e-3, 2000)
    path = tmp_path / "a.csv"
    rows = zip(time, angle + turns * TURN * (time >= 24), strict=True)
    path.write_text("t [s],angle [rad]\n" + "".join(f"{t},{a}\n" for t, a in rows))
    if accepted:
        case = import_body(path, 1.0)
        moved = np.interp([23.9, 24.1], case.casing.time, case.casing.angle)
        assert np.diff(moved)[0] == pytest.approx(0.2 * 0.52 * speed + turns * TURN, abs=0.5)
    else:
        with pytest.raises(DatasetError, match="the angle jumps by"):
            import_body(path, 1.0)


@pytest.mark.parametrize("row", [1, 2, 1998, 1999])
@pytest.mark.parametrize("turns", [1, -1])
def test_a_slip_at_an_end_of_a_record_is_kept_as_well(tmp_path, row, turns):
    time = np.arange(2000) / 50
    angle = 20 * time + np.random.default_rng(0).normal(0, 5e-3, 2000)
    path = tmp_path / "a.csv"
    rows = zip(time, angle + turns * TURN * (np.arange(2000) >= row), strict=True)
    path.write_text("t [s],angle [rad]\n" + "".join(f"{t},{a}\n" for t, a in rows))
    assert import_body(path, 1.0).casing.angle.size > 1900
