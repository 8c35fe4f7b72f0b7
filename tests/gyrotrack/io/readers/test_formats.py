"""Each format by its content: units, signs and uncertainties; and what `export` writes comes back."""

import io
import json
import math
import time
import tracemalloc
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError, export_file, import_body, import_case, write_case
from gyrotrack.io.readers._columnar import read_json, read_parquet
from gyrotrack.io.readers._motion_table import ReadOptions, checked, only_one, read_names, resolution
from gyrotrack.io.readers._raw_table import TURN, number_of, table_of
from gyrotrack.io.readers._registry import read_motion
from gyrotrack.io.readers._run import Limits, read_cuts
from gyrotrack.io.readers._spreadsheets import read_excel_97

TIME = np.arange(400) / 100
ANGLE = 0.3 + 20 * TIME - 1.5 * TIME**2


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def rows(*columns, sep=","):
    return "".join(sep.join(repr(float(v)) for v in row) + "\n" for row in zip(*columns, strict=True))


def options(*columns, **others):
    return ReadOptions(names=read_names(columns) if columns else None, **others)


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("Zeit (ms);Winkel (deg)\n" + rows(1e3 * TIME, np.degrees(ANGLE), sep=";").replace(".", ","), {}),
        ("logger 7\nserial 12\nt_us,psi_rad\n" + rows(1e6 * TIME, ANGLE), {}),
        ("Time,Angle\ns,deg\n\n" + rows(TIME, np.degrees(ANGLE)), {}),
        ("time [min],rotation angle [turns]\n" + rows(TIME / 60, ANGLE / TURN), {}),
        (rows(TIME, np.degrees(ANGLE)), {"names": ["t=1", "angle=2 [deg]"]}),
        (rows(np.degrees(ANGLE), 1e6 * TIME), {"names": ["t=2 [us]", "angle=1 [deg]"]}),
        ("frame,theta_rad\n" + rows(np.arange(400), ANGLE), {"fps": 100.0}),
        ("ms,turns\n" + rows(1e3 * TIME, ANGLE / TURN), {}),
        ("time_ms,revolutions\n" + rows(1e3 * TIME, ANGLE / TURN), {}),
        ("s,run\n" + rows(TIME, ANGLE / TURN), {"names": ["t=s", "angle=run [turns]"]}),
        ("t,turns\n" + rows(TIME, ANGLE / TURN), {"names": ["angle=turns"]}),
    ],
)
def test_texts_of_any_header_and_unit(tmp_path, text, given):
    names = given.pop("names", ())
    read = read_motion(write(tmp_path / "a", text), options(*names, **given))
    assert read.quantity == "angle"
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    np.testing.assert_allclose(read.value, ANGLE, atol=1e-9)


@pytest.mark.parametrize(("name", "factor"), [("rpm", TURN / 60), ("dps", math.pi / 180), ("rad/s", 1.0)])
def test_a_column_named_by_its_unit_has_this_unit(tmp_path, name, factor):
    read = read_motion(write(tmp_path / "a", f"t,{name}\n" + rows(TIME, ANGLE / factor)))
    assert read.quantity == "omega"
    np.testing.assert_allclose(read.value, ANGLE, rtol=1e-12)


def test_times_with_dates_are_counted_from_the_first_second(tmp_path):
    speed = np.linspace(14, 5, 400)
    stamps = [f"2026-05-04T10:11:{12 + k // 100:02d}.{k % 100:02d}0" for k in range(400)]
    since_1970 = 1777889472.0  # date -u -d 2026-05-04T10:11:12 +%s
    lines = [f"{stamp},{w!r}\n" for stamp, w in zip(stamps, speed.tolist(), strict=True)]
    for head, text in (
        ("timestamp,omega", "".join(lines)),
        ("epoch,omega", rows(since_1970 + TIME, speed)),
        ("timestamp,omega", rows((since_1970 + TIME) * 1e3, speed)),
        ("timestamp,omega", rows((since_1970 + TIME) * 1e9, speed)),
    ):
        case = import_body(write(tmp_path / "a", f"{head}\n{text}"), 1.0)
        np.testing.assert_allclose(case.casing.time, TIME, atol=1e-6)
        assert any("counted from 2026-05-04 10:11:12 (1777889472 s)" in note for note in case.warnings)


def test_an_inertial_unit_is_not_a_table_of_points(tmp_path):
    axis = np.array([0.6, 0.0, 0.8])
    speed = np.linspace(14, 5, 400)
    noise = np.random.default_rng(1).normal(0, 1e-6, (400, 2))
    text = "t,acc_x,acc_y,gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s]\n" + rows(
        TIME, *noise.T, *np.outer(axis, speed)
    )
    read = read_motion(write(tmp_path / "a", text))
    assert read.quantity == "omega"
    np.testing.assert_allclose(read.value, speed, rtol=1e-9)
    with pytest.raises(DatasetError, match="coordinates or axes of a gyroscope"):
        read_motion(write(tmp_path / "b", "t,x,y,z\n" + rows(TIME, *noise.T, speed)))


@pytest.mark.parametrize(("bits", "low"), [(16, 0), (16, -(2**15)), (32, 0)])
def test_the_overflows_of_a_binary_counter_are_not_motion(tmp_path, bits, low):
    turns = -6e3 * TIME / TURN if bits == 16 else 2**32 / 360 - 1 + 20 * TIME
    count = (np.floor(360 * turns) - low) % 2**bits + low
    read = read_motion(
        write(tmp_path / "a", "t,count\n" + rows(TIME, count)), ReadOptions(pulses_per_turn=360.0)
    )
    np.testing.assert_allclose(read.value - read.value[0], TURN * (turns - turns[0]), atol=TURN / 360)
    assert any(f"{bits}-bit counter overflows" in note for note in read.notes)


@pytest.mark.parametrize(
    ("unit", "factor"), [("rpm", TURN / 60), ("dps", np.pi / 180), ("Hz", TURN), ("rad/s", 1.0)]
)
def test_speeds_in_their_units(tmp_path, unit, factor):
    read = read_motion(
        write(tmp_path / "a", f"time (s)\tGyroscope z ({unit})\n" + rows(TIME, ANGLE, sep="\t"))
    )
    assert read.quantity == "omega"
    np.testing.assert_allclose(read.value, factor * ANGLE)


@pytest.mark.parametrize("speed", [np.cos(3 * TIME), 5 + 0 * TIME, 20 - 0.4 * TIME])
def test_a_gyroscope_whose_axes_are_inclined_to_the_rotation(tmp_path, speed):
    """The speed is that about the axis of rotation, not its largest component; an error of zero does not turn it."""
    axis, zero = np.array([0.48, -0.8, 0.36]), np.array([0.01, 0.02, -0.01])
    axis = axis / np.linalg.norm(axis)
    parts = speed[:, None] * axis + zero + 1e-4 * np.random.default_rng(3).standard_normal((len(TIME), 3))
    names = ",".join(f'"{n} (rad/s)"' for n in ("Gyroscope x", "Gyroscope y", "Gyroscope z", "Absolute"))
    text = f'"Time (s)",{names}\n' + rows(TIME, *parts.T, np.linalg.norm(parts, axis=1), sep=",")
    read = read_motion(write(tmp_path / "phyphox.csv", text))
    np.testing.assert_allclose(read.value, -(speed + axis @ zero), atol=2e-3)
    assert any("scale factor" in n for n in read.notes)


def test_an_axis_of_a_gyroscope_by_option_and_in_an_archive(tmp_path):
    head = '"Time (s)"\t"Gyroscope x (rad/s)"\t"Gyroscope y (rad/s)"\t"Gyroscope z (rad/s)"\n'
    text = head + rows(TIME, 0.1 * np.sin(TIME), -np.cos(3 * TIME), 0 * TIME, sep="\t")
    read = read_motion(write(tmp_path / "a", text))
    np.testing.assert_allclose(read.value, -np.cos(3 * TIME), atol=2e-3)
    with zipfile.ZipFile(tmp_path / "b", "w") as archive:
        archive.writestr("meta/time.csv", "event,time\nSTART,0\n")
        archive.writestr("Raw Data.csv", text)
    np.testing.assert_array_equal(read_motion(tmp_path / "b").value, read.value)
    chosen = read_motion(tmp_path / "b", options("omega=Gyroscope x (rad/s)"))
    np.testing.assert_allclose(chosen.value, 0.1 * np.sin(TIME))


def test_repairs_are_reported_with_their_lines(tmp_path):
    values = np.stack([TIME, ANGLE], axis=1)
    values[100:102] = values[[101, 100]]
    values = np.insert(values, 50, values[50], axis=0)
    read = read_motion(write(tmp_path / "a", "t,angle\n" + rows(*values.T) + "4.0"))
    np.testing.assert_allclose(read.time, TIME)
    np.testing.assert_allclose(read.value, ANGLE)
    told = " ".join(read.notes)
    for words in (
        "1 repeated times (first: line 53)",
        "not increasing (line 104)",
        "line 403: the last row is truncated",
    ):
        assert words in told


def test_a_clock_that_restarts(tmp_path):
    ticks = (TIME * 1e6 + 2**32 - 1.2e6) % 2**32
    read = read_motion(write(tmp_path / "a", "t [us],angle\n" + rows(ticks, ANGLE)))
    np.testing.assert_allclose(read.time - read.time[0], TIME, atol=1e-9)
    again = np.concatenate([TIME[:200], TIME[:200]])
    with pytest.raises(DatasetError, match=r"not strictly increasing \(line 202\): the clock restarts"):
        read_motion(write(tmp_path / "b", "t,angle\n" + rows(again, ANGLE)))


def test_a_quantised_encoder(tmp_path):
    step = 360 / 1000
    turned = np.degrees(40 * TIME - 10 * TIME**2)[:200]
    text = "Time,Angle\n" + rows(TIME[:200], np.round(turned / step) * step % 360)
    case = import_body(write(tmp_path / "a", text), 1e-3)
    np.testing.assert_allclose(
        case.casing.angle - case.casing.angle[0], np.radians(turned), atol=np.radians(step)
    )
    assert np.min(case.casing.sigma) == pytest.approx(np.radians(step) / np.sqrt(12), rel=1e-6)
    assert resolution(np.cumsum(np.linspace(1, 1.02, 300))) == 0.0  # nearly even, but not quantised


def spin_down(per_turn, jitter=0.0, *, seed=0, turns=400):
    """Times at which a body with omega = 60 exp(-t / 40) passes its marks."""
    angle = TURN * np.arange(turns * per_turn) / per_turn
    angle = angle[angle < 0.95 * 60 * 40]
    times = -40 * np.log(1 - angle / (60 * 40))
    return times + np.random.default_rng(seed).normal(0, jitter, len(times)), angle


@pytest.mark.slow
def test_many_scattering_pulses_are_counted_in_little_memory(tmp_path):
    """Six of 30,000 pulses are missed; parts of the record are counted one after the other."""
    number = 30_000
    times = -400 * np.log(1 - np.arange(number) / (2 * number))
    times += 0.2 * np.gradient(times) * np.random.default_rng(2).normal(size=number)
    lost = [1500, 3001, 9000, 15_500, 22_000, 28_000]
    text = "".join(f"{t!r}\n" for t in np.sort(np.delete(times, lost)).tolist())
    tracemalloc.start()
    read = read_motion(write(tmp_path / "a", text), ReadOptions(pulses_per_turn=1))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert np.ptp(read.value) == pytest.approx(TURN * (number - 1), abs=1)
    assert peak < 150e6


def test_pulses_missed_and_doubled(tmp_path):
    times, angle = spin_down(1, 1e-5)
    bad = np.sort(np.concatenate([np.delete(times, [40, 41, 120]), [times[200] + 0.004]]))
    read = read_motion(
        write(tmp_path / "a", "".join(f"{t!r}\n" for t in bad.tolist())), ReadOptions(pulses_per_turn=1)
    )
    assert "1 double pulses" in " ".join(read.notes)
    assert "3 missed pulses" in " ".join(read.notes)
    np.testing.assert_allclose(read.value, np.delete(angle, [40, 41, 120]))
    assert np.diff(times).max() > 6 * np.diff(times).min()


@pytest.mark.parametrize("lost", [(), (60, 150)], ids=["all", "two missed"])
def test_pulses_whose_times_scatter_by_a_fifth_of_an_interval(tmp_path, lost):
    """Single intervals of 0.2 to 1.8 are no double and no missed pulse; a count that stays wrong is one."""
    right = 0
    for seed in range(12):
        times, angle = spin_down(1, 0.0)
        scattered = times + 0.2 * np.gradient(times) * np.random.default_rng(seed).normal(size=len(times))
        text = "".join(f"{t!r}\n" for t in np.sort(np.delete(scattered, lost)).tolist())
        read = read_motion(write(tmp_path / "a", text), ReadOptions(pulses_per_turn=1))
        right += abs(np.ptp(read.value) - np.ptp(angle)) < 1
    # 0.5 counts are 3 to 4 standard errors of a step of the counts
    assert right >= 11 - 2 * len(lost)


@pytest.mark.parametrize("seed", range(8))
def test_pulses_until_rest_are_not_missed(tmp_path, seed):
    """The last interval of a body that comes to rest by dry friction may be twice the one before."""
    random = np.random.default_rng(seed)
    rate, per_turn, number = random.uniform(0.2, 1.0), 4, int(random.integers(300, 800))
    pitch = 2 * math.pi / per_turn
    # at rest a fraction of an interval after the last pulse; before it, angle = speed t - rate t^2 / 2
    speed = math.sqrt(2 * rate * (number - 1 + random.uniform(0.01, 0.1)) * pitch)
    times = (speed - np.sqrt(speed**2 - 2 * rate * pitch * np.arange(number))) / rate
    times += random.normal(0, 2e-5, len(times))
    lost = int(random.integers(20, len(times) - 20))
    path = tmp_path / "pulses.txt"
    np.savetxt(path, np.delete(times, lost), fmt="%.6f")
    read = read_motion(path, ReadOptions(pulses_per_turn=per_turn))
    assert read.value[-1] - read.value[0] == pytest.approx((number - 1) * pitch, abs=0.1)
    assert "1 missed pulses" in " ".join(read.notes)


@pytest.mark.parametrize("per_turn", [1, 8])
def test_the_uncertainty_of_pulses_is_that_of_their_times(tmp_path, per_turn):
    times, angle = spin_down(per_turn, 2e-5)
    text = "".join(f"{t!r}\n" for t in times.tolist())
    read = read_motion(write(tmp_path / "a", text), ReadOptions(pulses_per_turn=per_turn))
    error = read.value - 60 * 40 * (1 - np.exp(-read.time / 40))
    z = (error - error.mean()) / read.sigma
    assert 0.8 < np.std(z) < 1.2
    np.testing.assert_allclose(read.value, angle, atol=1e-3)


def test_errors_of_the_marks_are_removed(tmp_path):
    marks = np.array([0.0, 0.02, -0.03, 0.01])
    angle = TURN * np.arange(1200) / 4 + np.tile(marks, 300)
    times = -40 * np.log(1 - angle / (60 * 40))
    text = "".join(f"{t!r}\n" for t in times.tolist())
    read = read_motion(write(tmp_path / "a", text), ReadOptions(pulses_per_turn=4))
    error = read.value - angle
    assert np.std(error[8:-8]) < 2e-3


def test_a_counter_that_is_written_one_row_late(tmp_path):
    wheel, _ = spin_down(1)
    drum = np.arange(1, 500) * 0.0611
    events = sorted([(t, 0) for t in wheel.tolist()] + [(t, 1) for t in drum.tolist()])
    counts, lines = [5, 9], []
    late = (5, 9)
    for t, which in events:
        counts[which] += 1
        lines.append(f"{round(t * 1e6)},1.5,{late[0]},2.5,{late[1]}\n")
        late = tuple(counts)
    path = write(tmp_path / "a", "".join(lines))
    with pytest.raises(DatasetError, match="columns 3, 5 count revolutions"):
        read_motion(path)
    read = read_motion(path, options("revolutions=3"))
    assert any("one row late" in n for n in read.notes)
    assert not any("missed" in n for n in read.notes)
    expected = 60 * 40 * (1 - np.exp(-read.time / 40))
    np.testing.assert_allclose(read.value - read.value[0], expected - expected[0], atol=1e-3)


def test_a_counter_that_misses_a_pulse(tmp_path):
    times, angle = spin_down(1)
    seen = np.delete(times, 100)
    text = "".join(f"{round(t * 1e6)},{k + 3}\n" for k, t in enumerate(seen.tolist()))
    read = read_motion(write(tmp_path / "a", text))
    assert any("1 missed pulses" in n for n in read.notes)
    np.testing.assert_allclose(read.value - read.value[0], np.delete(angle, 100)[1:] - angle[1], atol=1e-3)


def driven(brake=False, rest=False):
    """A body held at 50 rad/s for 10 s, then slowed down by 0.5 rad/s2; braked or at rest at the end."""
    time = np.arange(0, 80, 0.02)
    slowing = np.where(time > 10, 0.5, 0.0)
    if brake:
        slowing = np.where(time > 60, 8.0, slowing)
    omega = np.maximum(50 - np.cumsum(slowing) * 0.02 * (1.6 if rest else 1), 0)
    return time, omega


@pytest.mark.parametrize(
    ("brake", "rest", "end"), [(False, False, None), (True, False, 60), (False, True, 72.5)]
)
def test_what_belongs_to_the_run(tmp_path, brake, rest, end):
    time, omega = driven(brake, rest)
    noisy = omega + np.random.default_rng(3).normal(0, 0.02, len(time))
    path = write(tmp_path / "a", "t,omega\n" + rows(time, noisy))
    case = import_body(path, 1e-3)
    assert case.casing.time[0] == pytest.approx(10, abs=1)
    assert case.casing.time[-1] == pytest.approx(end or 80, abs=1)
    assert any("is driven until" in w for w in case.warnings)
    assert any("is braked" in w for w in case.warnings) == brake
    assert len(import_body(path, 1e-3, limits=Limits(keep_all=True)).casing.time) == len(time)
    by_hand = import_body(path, 1e-3, limits=Limits(12, 50, ((20, 30),), keep_all=True)).casing.time
    assert by_hand[0] == pytest.approx(12, abs=0.021)
    assert by_hand[-1] == pytest.approx(50, abs=0.021)
    assert not ((by_hand > 20) & (by_hand < 30)).any()


def test_oscillations_and_plain_coast_downs_are_not_cut(tmp_path):
    time = np.arange(0, 60, 0.02)
    swinging = np.exp(-time / 50) * np.cos(2 * time)
    coasting = 50 * np.exp(-time / 30)
    for k, omega in enumerate((swinging, coasting)):
        noisy = omega + np.random.default_rng(4).normal(0, 0.01, len(time))
        case = import_body(write(tmp_path / str(k), "t,omega\n" + rows(time, noisy)), 1e-3)
        assert len(case.casing.time) == len(time)


@pytest.mark.parametrize("text", ["1", "a:b", "3:2", "1:"])
def test_cuts_that_are_none(text):
    with pytest.raises(UsageError, match="not an interval"):
        read_cuts([text])


TRK = """<?xml version="1.0" encoding="UTF-8"?>
<object class="org.opensourcephysics.cabrillo.tracker.TrackerPanel">
<property name="videoclip" type="object">
<object class="VideoClip">
<property name="startframe" type="int">10</property>
<property name="starttime" type="double">500.0</property>
</object></property>
<property name="clipcontrol" type="object">
<object class="C">
<property name="delta_t" type="double">10.0</property>
</object></property>
<property name="coords" type="object">
<object class="I">
<property name="framedata" type="array">
<property name="[0]" type="object">
<object class="F">
<property name="xorigin" type="double">320.0</property>
<property name="yorigin" type="double">240.0</property>
<property name="angle" type="double">30.0</property>
<property name="xscale" type="double">50.0</property>
<property name="yscale" type="double">50.0</property>
</object></property></property>
</object></property>
<property name="length_unit" type="string">cm</property>
<property name="tracks" type="collection">
<property name="item" type="object">
<object class="org.opensourcephysics.cabrillo.tracker.PointMass">
<property name="name" type="string">m</property>
<property name="framedata" type="array">%s</property>
</object></property></property>
</object>"""


def project(angle):
    cell = (
        '<property name="[%d]" type="object"><object class="P"><property name="x" type="double">%r</property>'
        '<property name="y" type="double">%r</property></object></property>'
    )
    x, y = 320 + 90 * np.cos(angle), 240 - 90 * np.sin(angle)
    return TRK % "".join(cell % (k + 10, float(x[k]), float(y[k])) for k in range(len(angle)) if k != 7)


def test_a_tracker_project(tmp_path):
    read = read_motion(write(tmp_path / "a.xml", project(ANGLE)))
    seen = np.arange(400) != 7
    np.testing.assert_allclose(read.time, 0.5 + TIME[seen])
    error = np.angle(np.exp(1j * (read.value - (ANGLE[seen] - np.pi / 6))))
    assert np.abs(error).max() < 1e-9
    for bad in (project(ANGLE)[:5000], "<!DOCTYPE a [<!ENTITY b 'c'>]>" + project(ANGLE)):
        with pytest.raises(DatasetError):
            read_motion(write(tmp_path / "b.trk", bad))


@pytest.mark.slow
def test_matlab_and_excel(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"t": TIME, "phi_deg": np.degrees(ANGLE), "note": "x"})
    savemat(tmp_path / "s.mat", {"run": {"time": TIME, "angle": ANGLE}})
    found = [read_motion(tmp_path / n) for n in ("a.mat", "s.mat")]
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["made by a logger"])
    book.active.append(["time [s]", "angle [rad]"])
    for row in zip(TIME.tolist(), ANGLE.tolist(), strict=True):
        book.active.append(row)
    stream = io.BytesIO()
    book.save(stream)
    found.append(read_motion(write(tmp_path / "a.csv", stream.getvalue())))
    for read in found:
        np.testing.assert_allclose(read.time, TIME)
        np.testing.assert_allclose(read.value, ANGLE)


def test_rows_of_a_file_without_lines_are_counted_from_one():
    angle, notes = ANGLE.copy(), []
    angle[2] = np.nan
    raw = table_of(Path("a.mat"), ["t", "angle"], [TIME, angle])
    assert checked(raw, "angle", TIME, angle, None, notes).line[:3].tolist() == [1, 2, 4]
    assert notes == ["a.mat: 1 rows without a value were excluded (first: line 3)"]


def sysid(test, units="Rotations", width=4, **options):
    """The table that is read from a file of SysId; column k of row i is 10 i + k."""
    series = (10 * np.arange(12.0)[:, None] + np.arange(width)).tolist()
    document = {"sysid": True, "units": units, "test": "Simple", "empty": [], **dict.fromkeys(test, series)}
    return read_json(Path("a.json"), json.dumps(document).encode(), ReadOptions(**options))


@pytest.mark.parametrize(
    ("units", "unit"), [("Rotations", "turns"), ("Radians", "rad"), ("Degrees", "deg"), ("Feet", "Feet")]
)
def test_a_test_of_sysid_has_time_voltage_position_and_speed(units, unit):
    raw = sysid(["slow-forward"], units)
    assert raw.names == ("t", "voltage", "angle", "omega")
    assert raw.units == ("s", "V", unit, f"{unit}/s")
    assert [raw.numeric(k)[1] for k in range(4)] == [10.0, 11.0, 12.0, 13.0]


@pytest.mark.parametrize(("side", "places"), [("left", [0, 1, 3, 5]), ("right", [0, 2, 4, 6])])
def test_a_drive_train_of_sysid_has_two_sides(side, places):
    raw = sysid(["slow-forward", "fast-forward"], width=9, marker=f"fast-forward {side}")
    assert [raw.numeric(k)[1] for k in range(4)] == [10.0 + k for k in places]
    with pytest.raises(DatasetError, match="contains 2 driven tests: slow-forward left, slow-forward right"):
        sysid(["slow-forward"], width=9)


def test_rows_of_sysid_of_another_width_are_refused():
    with pytest.raises(DatasetError, match=r"have \[5\] numbers"):
        sysid(["slow-forward"], width=5)


def test_lists_of_a_json_table_that_are_shorter_are_not_columns(tmp_path):
    table = {"note": [1.0, 2.0], "t": TIME.tolist(), "angle": ANGLE.tolist(), "omega": [3.0], "empty": []}
    found = read_motion(write(tmp_path / "a.json", json.dumps(table)))
    np.testing.assert_allclose(found.value, ANGLE)
    raw = read_json(tmp_path / "a.json", json.dumps(table).encode(), ReadOptions())
    assert raw.names == ("t", "angle")
    assert len(raw.line) == len(TIME)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1970-01-02T00:00:00", 86400.0),
        ("1970-01-02 02:00:00.5+02:00", 86400.5),
        ("1:02:03.5", 3723.5),
        ("02:03", 123.0),
    ],
)
def test_times_do_not_depend_on_the_time_zone_of_the_computer(monkeypatch, text, seconds):
    try:
        with monkeypatch.context() as context:
            context.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
            if hasattr(time, "tzset"):
                time.tzset()
            assert number_of(text, times=True) == seconds
    finally:
        if hasattr(time, "tzset"):
            time.tzset()
    assert number_of(text) is None


def test_excel_97_with_text_above_and_a_second_sheet(tmp_path):
    pytest.importorskip("xlrd")
    xlwt = pytest.importorskip("xlwt")
    book = xlwt.Workbook()
    book.add_sheet("Metadata").write(0, 0, "phone")
    sheet = book.add_sheet("Raw Data", cell_overwrite_ok=True)
    for column, name in enumerate(("Time (s)", "Angle (deg)")):
        sheet.write(0, column, name)
    for row, pair in enumerate(zip(TIME.tolist(), np.degrees(ANGLE).tolist(), strict=True), 1):
        for column, value in enumerate(pair):
            sheet.write(row, column, value)
    sheet.write(3, 1, "")
    stream = io.BytesIO()
    book.save(stream)
    read = read_motion(write(tmp_path / "a", stream.getvalue()))
    kept = np.delete(np.arange(400), 2)
    np.testing.assert_allclose(read.time, TIME[kept])
    np.testing.assert_allclose(read.value, ANGLE[kept])
    with pytest.raises(DatasetError, match="damaged workbook"):
        read_motion(write(tmp_path / "b", stream.getvalue()[:3000]))


@pytest.mark.parametrize("since_1904", [False, True])
def test_dates_of_excel_97_count_from_the_first_day_of_the_workbook(tmp_path, since_1904):
    pytest.importorskip("xlrd")
    xlwt = pytest.importorskip("xlwt")
    book = xlwt.Workbook()
    book.dates_1904 = since_1904
    sheet = book.add_sheet("Log")
    # days since 1899-12-30 or since 1904-01-01
    days = 44000.25 - (1462 if since_1904 else 0)
    style = xlwt.easyxf(num_format_str="YYYY-MM-DD HH:MM:SS")
    for row, cells in enumerate((("time", "omega"), (days, 5.0), (days, 4.5))):
        for column, value in enumerate(cells):
            sheet.write(row, column, value, style if row and not column else xlwt.Style.default_style)
    sheet.write(3, 0, xlwt.Formula("1=1"))
    sheet.write(3, 1, True)
    stream = io.BytesIO()
    book.save(stream)
    table = read_excel_97(tmp_path / "log.xls", stream.getvalue(), ReadOptions())
    assert table.names == ("time", "omega")
    assert [c[:2] for c in table.columns] == [["2020-06-18 06:00:00"] * 2, ["5.0", "4.5"]]
    assert table.line[:2].tolist() == [2, 3]


def test_matlab_7_3_as_matlab_writes_it(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, values in (("t", TIME), ("angle", ANGLE)):
            file[name] = values[None, :]  # a column vector of MATLAB: transposed in HDF5
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["note"] = np.frombuffer("made by a rig".encode("utf-16-le"), dtype=np.uint16)[:, None]
        file["run/time"], file["run/psi"] = TIME[:50], ANGLE[:50]
        file.create_group("#refs#")["a"] = np.zeros(1000)
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    read = read_motion(tmp_path / "a.mat")
    np.testing.assert_array_equal(read.time, TIME)
    np.testing.assert_array_equal(read.value, ANGLE)


@pytest.mark.parametrize(
    ("head", "columns", "given"),
    [
        ("t [s]\n", (TIME,), {"pulses_per_turn": 2}),
        ("time (s) angle (deg)\n", (TIME, np.degrees(ANGLE)), {}),
        ("t [s]  omega [rad / s]\n", (TIME, ANGLE), {}),
    ],
)
def test_names_with_blanks_between_columns_that_blanks_separate(tmp_path, head, columns, given):
    read = read_motion(write(tmp_path / "a", head + rows(*columns, sep=" ")), options(**given))
    np.testing.assert_allclose(read.time, TIME)
    np.testing.assert_allclose(read.value, np.pi * np.arange(400) if given else ANGLE, atol=1e-9)


@pytest.mark.slow
def test_a_pose_file_of_movement(tmp_path):
    xr = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    place = np.stack([320 + 90 * np.cos(ANGLE), 240 - 90 * np.sin(ANGLE)], axis=1)
    position = np.stack([place, np.full_like(place, [320, 240])], axis=2)[..., None]
    dims = ("time", "space", "keypoints", "individuals")
    coords = {"time": TIME, "space": ["x", "y"], "keypoints": ["tape", "hub"], "individuals": ["a"]}
    data = xr.Dataset({"position": (dims, position)}, coords=coords, attrs={"time_unit": "seconds"})
    data.to_netcdf(tmp_path / "p.nc", engine="h5netcdf")
    read = read_motion(tmp_path / "p.nc")
    np.testing.assert_allclose(read.time, TIME)
    assert np.abs(np.angle(np.exp(1j * (read.value - ANGLE)))).max() < 1e-9


@pytest.mark.parametrize(
    "suffix", [".csv", ".json", ".parquet", ".txt", pytest.param(".nc", marks=pytest.mark.slow)]
)
def test_what_is_exported_is_imported(tmp_path, suffix):
    if suffix in {".parquet", ".nc"}:
        pytest.importorskip("pyarrow")
        pytest.importorskip("h5netcdf")
    rng = np.random.default_rng(1)
    for name, scale in (("c", 1.0), ("r", -2.0)):
        write(
            tmp_path / name,
            "t,angle,sigma\n" + rows(TIME, scale * ANGLE + rng.normal(0, 1e-3, 400), 0 * TIME + 1e-3),
        )
    case = import_case(tmp_path / "c", [tmp_path / "r"], I_rotor=5.54e-5, I_casing=2.06e-5)
    write_case(tmp_path / "case.h5", case, command="", settings={})
    target = tmp_path / f"out{suffix}"
    export_file(tmp_path / "case.h5", target)
    again = import_case(target, [target], I_rotor=5.54e-5, I_casing=2.06e-5)
    for name in ("casing", "rotor"):
        one, two = getattr(case, name), getattr(again, name)
        np.testing.assert_allclose(two.time, one.time, rtol=1e-12)
        turned = TURN * np.round((two.angle - one.angle) / TURN)[0]
        np.testing.assert_allclose(two.angle - turned, one.angle, rtol=1e-9, atol=1e-9)
        if suffix != ".txt":
            np.testing.assert_allclose(two.sigma, one.sigma)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"PK\x03\x04 broken", "damaged archive"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1", "workbook|Excel 97"),
        (b"MATLAB 5.0 MAT-file broken", "MATLAB file"),
        (b"MATLAB 7.3 MAT-file", "MATLAB file"),
        (b"PAR1 broken", "Parquet"),
        (b"{", "not a JSON table"),
        (json.dumps({"a": 3}).encode(), "not a JSON table"),
        (b"<object cabrillo.tracker", "Tracker project"),
    ],
)
def test_broken_files_are_one_sentence(tmp_path, content, match):
    with pytest.raises((DatasetError, UsageError), match=match) as caught:
        read_motion(write(tmp_path / "a", content))
    assert "\n" not in caught.value.message


@pytest.mark.parametrize("step", [0.01, 1e-5])
def test_rest_of_a_quantised_oscillation_is_left_out(tmp_path, step):
    """Dry friction: amplitude 1 - 0.04 t until it rests at 25 s; the last deflection of two steps is before that."""
    t = np.arange(0, 60, 0.01)
    angle = np.maximum(1 - 0.04 * t, 0) * np.cos(2 * np.pi * 0.8 * t)
    noise = np.random.default_rng(5).normal(0, 1e-3, len(t)) * (step < 1e-3)
    path = tmp_path / "oscillation.csv"
    rounded = np.round((angle + noise) / step) * step
    path.write_text("t,angle\n" + "".join(f"{x:.2f},{y:.6f}\n" for x, y in zip(t, rounded, strict=True)))
    case = import_body(path, 1.0)
    cut = [w for w in case.warnings if "2 steps of the resolution" in w]
    if step == 0.01:
        assert len(cut) == 1
        assert 23.0 < case.casing.time[-1] < 24.6
    else:  # there the noise is larger than the step, and shows when the body stops
        assert not cut
        assert any("at rest within the noise" in w for w in case.warnings)
        assert 24.3 < case.casing.time[-1] < 25.2
    assert len(import_body(path, 1.0, limits=Limits(keep_all=True)).casing.time) == len(t)


def test_tabs_and_blanks_mixed(tmp_path):
    t = np.arange(200) / 50.0
    angle = 3.0 * t - 0.1 * t**2
    lines = ["t\tangle sigma other", *(f"{a:.4f}\t{b:.6f} 0.001 7" for a, b in zip(t, angle, strict=True))]
    path = tmp_path / "mixed.txt"
    path.write_text("\n".join(lines))
    case = import_body(path, 1.0)
    np.testing.assert_allclose(np.ptp(case.casing.angle), np.ptp(angle), atol=1e-5)
    np.testing.assert_allclose(case.casing.sigma, 0.001)


def test_a_table_in_rows_settings_above_it_and_samples_without_times(tmp_path):
    transposed = ",".join(f"{t:.9g}" for t in TIME) + "\n" + ",".join(f"{a:.9g}" for a in ANGLE) + "\n"
    read = read_motion(write(tmp_path / "a", transposed), options("t=1", "angle=2"))
    np.testing.assert_allclose(read.value, ANGLE, atol=1e-6)
    above = "start_deg, rate, seconds\n90, 1000, 5\n" + "\n".join(f"{a:.9g}" for a in ANGLE) + "\n"
    read = read_motion(write(tmp_path / "b", above), options("angle=1", fps=1000.0))
    np.testing.assert_allclose(read.value, ANGLE, atol=1e-6)
    np.testing.assert_allclose(read.time, np.arange(len(ANGLE)) / 1000)


def test_many_recordings_in_one_file_are_not_averaged(tmp_path):
    text = "t,angle\n" + "".join(rows(TIME[:40], ANGLE[:40]) for _ in range(9))
    with pytest.raises(DatasetError, match="restarts") as caught:
        read_motion(write(tmp_path / "a.csv", text))
    assert "9 recordings" in caught.value.hint


@pytest.mark.parametrize("head", ["time,counts\n", ""])
def test_sampled_counts_of_an_encoder_are_angles_of_its_resolution(tmp_path, head):
    """Several counts from row to row, in both senses: no pulses, and no counter of events."""
    angle = 3 * np.sin(4 * TIME)
    counts = np.floor(angle / TURN * 2048)
    time = TIME if head else 1e6 * TIME
    text = head + "".join(f"{t:.9g},{int(c)}\n" for t, c in zip(time, counts, strict=True))
    read = read_motion(write(tmp_path / "a", text), options(pulses_per_turn=2048))
    assert read.quantity == "angle"
    np.testing.assert_allclose(read.time, TIME, atol=1e-6)
    np.testing.assert_allclose(read.value, angle, atol=TURN / 2048)
    assert read.least_sigma == pytest.approx(TURN / 2048 / np.sqrt(12), rel=0.01)


def test_times_of_day_through_midnight_and_comments_after_a_row(tmp_path):
    clock = [f"{(t // 3600) % 24:02d}:{t // 60 % 60:02d}:{t % 60:02d}" for t in range(86395, 86395 + 20)]
    text = "time,angle\n" + "".join(
        f"{c},{k / 7:.6f}{'  # touched' * (k == 3)}\n" for k, c in enumerate(clock)
    )
    read = read_motion(write(tmp_path / "a", text))
    np.testing.assert_allclose(np.diff(read.time), 1.0)
    np.testing.assert_allclose(read.value, np.arange(20) / 7, atol=1e-6)
    assert any("time of day" in note for note in read.notes)


def test_a_log_of_a_microcontroller(tmp_path):
    text = "millis,ax,gx,gy,gz\n" + rows(np.round(1000 * TIME), 9.8 + 0 * TIME, 0 * TIME, 0 * TIME, ANGLE)
    with pytest.raises(DatasetError, match="the unit of 'gz' is not stated"):
        read_motion(write(tmp_path / "a", text))
    read = read_motion(tmp_path / "a", options("omega=g [dps]"))
    assert read.quantity == "omega"
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    np.testing.assert_allclose(read.value, np.radians(ANGLE), atol=1e-6)


@pytest.mark.parametrize(
    ("count", "listed"),
    [(8, ": a0, a1, a2, a3, a4, a5, a6, a7."), (9, ": a0, a1, a2, a3, a4, a5, a6, a7 and 1 more.")],
)
def test_a_message_lists_at_most_eight_names(count, listed):
    names = [f"a{i}" for i in range(count)]
    with pytest.raises(DatasetError, match="contains") as error:
        only_one(Path("drive.json"), names, "driven tests", ReadOptions())
    assert str(error.value.message) == f"drive.json contains {count} driven tests{listed}"
    assert only_one(Path("drive.json"), names, "driven tests", ReadOptions(marker="A3")) == "a3"


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_dates_of_a_parquet_file_are_seconds(tmp_path, unit):
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    per_second = {"ms": 1000, "us": 1_000_000}[unit]
    dates = pa.array([1_700_000_000 * per_second, 1_700_000_002 * per_second], pa.timestamp(unit))
    table = pa.table({"time": dates, "word": ["a", "b"], "angle": [1.5, None]})
    pq.write_table(table, tmp_path / "a.parquet")
    raw = read_parquet(tmp_path / "a.parquet", (tmp_path / "a.parquet").read_bytes(), None)
    assert raw.names == ("time", "word", "angle")
    assert raw.numeric(0).tolist() == [1_700_000_000.0, 1_700_000_002.0]
    np.testing.assert_array_equal(raw.numeric(2), [1.5, np.nan])
