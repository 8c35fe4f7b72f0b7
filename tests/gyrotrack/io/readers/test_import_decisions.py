"""Unwrapping, jumps, gaps and senses of imported tables; inputs and limits of numbers: small tables on both sides."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError, ErrorMode, UsageError, import_case
from gyrotrack.io._records import Input, Piece, series_of
from gyrotrack.io.readers import _columnar, _import_case, _registry
from gyrotrack.io.readers._columnar import read_json
from gyrotrack.io.readers._import_case import (
    case_of_body,
    modes_of,
    pieces_of,
    unwrap,
    unwrapped,
    window_warnings,
)
from gyrotrack.io.readers._inputs import UNITS, InputOption, read_input_options
from gyrotrack.io.readers._motion_table import MotionTable, ReadOptions, read_names
from gyrotrack.io.readers._number_range import check_motion, usable_numbers
from gyrotrack.io.readers._raw_table import RawTable, table_of
from gyrotrack.io.readers._registry import read_motion
from gyrotrack.io.readers._run import Limits

PATH = Path("a.csv")


def motion_table(time, value, quantity="angle", sigma=None, **options):
    return MotionTable(PATH, "", quantity, time, value, sigma, np.arange(len(time)) + 2, (), **options)


def wrap(angle):
    return np.angle(np.exp(1j * angle))


# ---- angles


def test_angles_are_unwrapped_across_gaps():
    time = 0.1 * np.arange(300)
    time = np.delete(time, slice(100, 160))
    angle = 8 * time - 0.1 * time**2
    found, uncertain = unwrap(time, wrap(angle))
    np.testing.assert_allclose(found - found[0], angle - angle[0], atol=1e-9)
    assert uncertain == []


def test_the_angle_of_measured_speeds_continues_through_a_gap():
    time = np.delete(0.01 * np.arange(3000), slice(1000, 1060))
    speed = 56.0 - 0.3 * time
    first, second = pieces_of(motion_table(time, speed, "omega", sigma=np.full(len(time), 0.01)), speed, [])
    angle = 56.0 * time - 0.15 * time**2
    np.testing.assert_allclose(np.concatenate([first.angle, second.angle]), angle, atol=1e-6)
    between = math.hypot(first.sigma[-1], 0.61 * 0.3 * 0.61 / math.sqrt(12))
    assert second.sigma[0] == pytest.approx(math.hypot(between, 0.01 * 0.01))
    case, _ = case_of_body(motion_table(time, speed, "omega"))
    assert np.ptp(case.casing.angle) == pytest.approx(angle[-1], rel=1e-6)


@pytest.mark.parametrize(("change", "doubtful"), [(0.93, False), (1.05, True)])
def test_a_gap_is_uncertain_if_the_speed_changes_by_eight_radians_divided_by_its_length(change, doubtful):
    """A gap of 8.1 s: a change of 0.99 rad/s is the limit."""
    time = 0.1 * np.concatenate([np.arange(200), np.arange(280, 480)])
    speed = np.where(np.arange(400) < 200, 3.0, 3.0 + change)
    angle = np.cumsum(speed * 0.1)
    _, uncertain = unwrap(time, wrap(angle))
    assert uncertain == ([pytest.approx(19.9)] if doubtful else [])
    notes = []
    unwrapped(motion_table(time, wrap(angle)), notes)
    assert len(notes) == doubtful


@pytest.mark.parametrize(("share", "refused"), [(0.008, False), (0.02, True)])
@pytest.mark.parametrize("sign", [1, -1])
def test_half_turns_between_samples_have_no_sense(share, refused, sign):
    time = 0.1 * np.arange(1001)
    step = np.full(1000, 1.0)
    count = int(1000 * share)
    step[np.arange(count) * 40 + 3] = 0.85 * np.pi
    step[np.arange(count) * 40 + 17] = -0.85 * np.pi
    value = wrap(sign * np.concatenate([[0], np.cumsum(step)]))
    if refused:
        with pytest.raises(DatasetError, match="half a turn"):
            unwrapped(motion_table(time, value), [])
    else:
        unwrapped(motion_table(time, value), [])
    step[np.arange(count) * 40 + 17] = 0.85 * np.pi  # in one sense only
    unwrapped(motion_table(time, wrap(sign * np.concatenate([[0], np.cumsum(step)]))), [])


def jump(size, at=50, count=101, step=0.1, noise=0.0):
    steps = np.full(count - 1, step) + noise * np.random.default_rng(0).normal(size=count - 1)
    steps[at] += size
    return 0.02 * np.arange(count), 20 + np.concatenate([[0], np.cumsum(steps)])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("size", "noise", "refused"),
    [
        (0.15, 1e-4, False),  # less than three times the other changes
        (0.25, 1e-4, True),
        (0.25, 0.01, False),  # less than 40 times the noise
        (1.0, 0.04, False),
        (14.0, 0.2, True),  # 20 times as large as others
        (2 * np.pi, 1e-4, False),  # a slip of whole turns
        (6 * np.pi, 1e-4, False),
        (8 * np.pi, 1e-4, True),
        (2 * np.pi + 0.5, 1e-4, True),
    ],
)
def test_jumps_of_an_angle_are_refused(size, noise, refused, sign):
    time, value = jump(size, noise=noise)
    table = motion_table(time, sign * value)
    if refused:
        with pytest.raises(DatasetError, match="line 53: the angle jumps"):
            unwrapped(table, [])
    else:
        np.testing.assert_array_equal(unwrapped(table, []), sign * value)
    np.testing.assert_array_equal(unwrapped(replace(table, counted=True), []), sign * value)
    np.testing.assert_array_equal(unwrapped(replace(table, quantity="omega"), []), sign * value)


def test_changes_across_gaps_are_kept():
    time, value = jump(9.0, noise=1e-4)
    time[51:] += 1.0
    np.testing.assert_array_equal(unwrapped(motion_table(time, value), []), value)


# ---- pieces and bodies


def test_tables_are_split_at_gaps():
    time = np.concatenate([0.1 * np.arange(60), 20 + 0.1 * np.arange(2), 40 + 0.1 * np.arange(60)])
    value = 2 * time + 1e-3 * np.random.default_rng(0).normal(size=122)
    notes = []
    parts = pieces_of(motion_table(time, value, least_sigma=1e-5), value, notes)
    assert [len(p.time) for p in parts] == [60, 60]
    assert any("2 isolated" in note for note in notes)
    assert any("1 gaps; the longest, 34.1 s, is after 5.9 s" in note for note in notes)
    assert 5e-4 < np.median(parts[0].sigma) < 2e-3
    assert not any("quantised" in note for note in notes)
    parts = pieces_of(motion_table(time, value, least_sigma=3e-4), value, notes := [])
    assert not any("quantised" in note for note in notes)
    notes = []
    parts = pieces_of(motion_table(time, value, least_sigma=5e-3), value, notes)
    assert (parts[0].sigma == 5e-3).all()
    assert any("quantised" in note for note in notes)
    counted = pieces_of(motion_table(time, value, counted=True, sigma=np.full(122, 0.1)), value, notes := [])
    assert [len(p.time) for p in counted] == [122]
    assert (counted[0].sigma == 0.1).all()
    assert not any("sigma" in note for note in notes)
    speeds = pieces_of(motion_table(time, value, "omega", sigma=np.full(122, 0.1)), value, [])
    np.testing.assert_array_equal(speeds[0].omega, value[:60])
    assert speeds[0].angle[-1] == pytest.approx(np.trapezoid(value[:60], time[:60]))


def test_windows_outside_of_the_record_and_overlaps_are_stated():
    def piece(a, b):
        t = np.array([a, b])
        return Piece(t, t, t, t, t)

    main = [piece(0.0, 10.0), piece(11.0, 20.0)]
    assert window_warnings({"a": main, "b": [piece(0.0, 3.0), piece(3.1, 20.0)]}) == []
    for a, b in ((-0.1, 3.0), (5.0, 20.1)):
        (text,) = window_warnings({"a": main, "b": [piece(a, b)]})
        assert "b window 0" in text
        assert "of the a" in text
    (text,) = window_warnings({"a": main, "b": [piece(0.0, 3.0), piece(3.0, 4.0)]})
    assert "windows 0 and 1 overlap" in text


@pytest.mark.parametrize(
    ("casing", "rotor", "sense", "count"),
    [
        ((1,), (1, 1), 1, 0),
        ((-1,), (-1, -1), -1, 1),
        ((1,), (-1, -1), 1, 1),
        ((-1,), (1, 1), 1, 1),
        ((1,), (2, -1), 1, 1),
    ],
)
def test_sense_of_rotation_is_that_of_both_bodies(casing, rotor, sense, count):
    def pieces(turns):
        return [Piece(*(np.array([0.0, turn]) for turn in (1, turn, 1, 1, 1))) for turn in turns]

    found, warnings = _import_case._sense(pieces(casing), pieces(rotor))
    assert (found, len(warnings)) == (sense, count)


def test_modes_of_several_tables_are_zero_in_the_others():
    def table(time, name):
        basis = np.outer(time + 1, [1.0, 2.0])
        return motion_table(time, time, modes=(ErrorMode(name, basis, np.eye(2)),))

    first, second = table(np.arange(4.0), "start"), table(10 + np.arange(3.0), "start")
    time = np.concatenate([first.time[1:], second.time])
    joined = series_of([Piece(*[time] * 5)])
    a, b = modes_of([first, second], joined)
    assert (a.name, b.name) == ("start", "start 2")
    np.testing.assert_array_equal(a.basis[:, 0], [2, 3, 4, 0, 0, 0])
    np.testing.assert_array_equal(b.basis[:, 1], [0, 0, 0, 22, 24, 26])


def test_dates_become_times_from_the_first_second():
    dated = motion_table(1e9 + 0.25 + np.arange(3.0), np.arange(3.0))
    later = replace(
        motion_table(1e9 + 5.5 + np.arange(3.0), np.arange(3.0)),
        inputs=(Input("u", 1e9 + np.arange(2.0), *[np.ones(2)] * 2),),
    )
    a, b = _import_case._from_origin([later, dated])
    np.testing.assert_allclose(a.time, [5.5, 6.5, 7.5])
    np.testing.assert_allclose(b.time, [0.25, 1.25, 2.25])
    np.testing.assert_allclose(a.inputs[0].time, [0, 1])
    assert "2001-09-09 01:46:40" in b.notes[0]
    for start, same in ((0.9e8, True), (1.1e8, False)):
        table = motion_table(start + np.arange(3.0), np.arange(3.0))
        assert (_import_case._from_origin([table])[0] is table) == same
    small = motion_table(np.arange(3.0), np.arange(3.0))
    assert _import_case._from_origin([dated, small])[0] is dated


def csv(path, name, time, value, head="t [s],angle [rad]"):
    np.savetxt(path / name, np.c_[time, value], delimiter=",", header=head, comments="", fmt="%.7f")
    return path / name


def test_case_of_two_bodies(tmp_path):
    time = 0.01 * np.arange(300)
    casing = csv(tmp_path, "c.csv", time, -(9 * time + 5))
    rotor = csv(tmp_path, "r.csv", time[20:200], -(40 * time[20:200] + 5))
    case = import_case(casing, [rotor], I_rotor=2e-5, I_casing=3e-5, label="a", surface="b")
    assert (case.I_rotor, case.I_casing, case.label, case.surface) == (2e-5, 3e-5, "a", "b")
    assert case.extra["sense"] == -1
    assert case.casing.angle[-1] > case.casing.angle[0]
    assert case.rotor.angle[-1] > case.rotor.angle[0]
    assert case.casing.window is None
    assert set(case.rotor.window) == {0}
    assert len(case.rotor.time) == 180
    assert case.casing.sigma_source == case.rotor.sigma_source == "estimated"
    assert [s["samples"] for s in case.extra["sources"]] == [300, 180]
    cut = import_case(casing, [rotor], I_rotor=1.0, I_casing=1.0, limits=Limits(stop=1.5))
    assert (len(cut.casing.time), len(cut.rotor.time)) == (151, 131)
    stated = tmp_path / "g.csv"
    stated.write_text("t [s],angle [rad],sigma\n" + "".join(f"{t:.3f},{9 * t:.5f},0.01\n" for t in time))
    first = import_case(stated, [rotor], I_rotor=1.0, I_casing=1.0)
    assert (first.casing.sigma_source, first.rotor.sigma_source) == ("given", "estimated")
    last = import_case(casing, [stated, rotor], I_rotor=1.0, I_casing=1.0)
    assert (last.casing.sigma_source, last.rotor.sigma_source) == ("estimated", "mixed")
    for inertia in ((0.0, 1.0), (1.0, 0.0), (-1.0, 1.0)):
        with pytest.raises(UsageError):
            import_case(casing, [rotor], I_rotor=inertia[0], I_casing=inertia[1])
    with pytest.raises(UsageError):
        import_case(casing, [], I_rotor=1.0, I_casing=1.0)
    speeds = csv(tmp_path, "s.csv", time, 9 + time, "t [s],omega [rad/s]")
    with pytest.raises(DatasetError, match="contains omega"):
        import_case(casing, [speeds], I_rotor=1.0, I_casing=1.0)


def test_case_of_one_body():
    time = 0.01 * np.arange(300)
    down = motion_table(time, 20 - 9 * time)
    case, _ = case_of_body(down, 2.0)
    assert case.extra["sense"] == -1
    assert case.casing.angle[-1] > case.casing.angle[0]
    assert (case.per_inertia, case.I_casing, case.bodies) == (0, 2.0, "one")
    assert case_of_body(down)[0].per_inertia == 1
    with pytest.raises(UsageError):
        case_of_body(down, 0.0)
    of_drive = replace(down, inputs=(Input("u", time, time, np.full(300, np.nan), "A"),))
    assert case_of_body(of_drive)[0].extra["sense"] == 1
    warm = replace(down, inputs=(Input("T", time, time + 300, np.full(300, np.nan), "K"),))
    assert case_of_body(warm)[0].extra["sense"] == -1
    back = np.cos(12 * time) - 0.1 * time
    assert case_of_body(motion_table(time, back))[0].extra["sense"] == 1
    cut, used = case_of_body(down, limits=Limits(start=1.0))
    assert len(cut.casing.time) == len(used.time) == 200


def test_drive_is_kept_with_an_input():
    time = 0.04 * np.arange(1000)
    speed = np.where(time < 10, 30.0, np.maximum(30 - 1.5 * (time - 10), 0.0))
    table = motion_table(time, np.cumsum(speed) * 0.04 + 1e-5 * np.random.default_rng(0).normal(size=1000))
    assert len(case_of_body(table)[0].casing.time) < 625
    of_drive = replace(table, inputs=(Input("u", time, time, np.full(1000, np.nan), "A"),))
    assert len(case_of_body(of_drive)[0].casing.time) == 1000
    warm = replace(table, inputs=(Input("T", time, time + 300, np.full(1000, np.nan), "K"),))
    assert len(case_of_body(warm)[0].casing.time) < 625


# ---- inputs


def test_options_of_inputs():
    (found,) = read_input_options(["current = 3 [mA] +- 0.5, hold, delay=0.02 s, file=b.csv"])
    assert found == InputOption("current", "3", "mA", 0.5, "hold", 0.02, Path("b.csv"))
    first, second = read_input_options(["a=Motor torque", "b=2 +/- 1e-3, linear"])
    assert (first.column, first.unit, first.interpolation, first.delay) == ("Motor torque", None, "", 0.0)
    assert math.isnan(first.u)
    assert (second.u, second.interpolation) == (1e-3, "linear")
    for text in (
        "a",
        "=3",
        "a=",
        "1a=3",
        "t=3",
        "omega_c=3",
        "a=3, foo",
        "a=3, delay=x",
        "a=3, delay=inf",
        "a=3, file=",
    ):
        with pytest.raises(UsageError):
            read_input_options([text])
    with pytest.raises(UsageError, match="twice"):
        read_input_options(["a=3", "a=4"])


def test_columns_of_inputs():
    raw = RawTable(PATH, ("t [s]", "I [mA]", ""), ("", "", "V"), (*np.eye(3),), np.arange(3))
    for column, place in (
        ("I [mA]", 1),
        ("i", 1),
        ("2", 1),
        ("3", 2),
        ("0", None),
        ("4", None),
        ("T", 0),
        ("x", None),
    ):
        assert InputOption("a", column).place(raw) == place


@pytest.mark.parametrize(
    ("unit", "si", "value"),
    [
        ("A", "A", 2.0), ("mA", "A", 2e-3), ("kV", "V", 2e3), ("uN m", "N m", 2e-6), ("Ncm", "N m", 0.02),
        ("%", "1", 0.02),
        ("degC", "K", 275.15), ("K", "K", 2.0), ("rpm", "s-1", math.pi / 15), ("rad/s", "s-1", 2.0),
        ("1", "1", 2.0), ("kPa", "kg m-1 s-2", 2e3),
    ],
)  # fmt: skip
def test_units_of_inputs(unit, si, value):
    raw = table_of(PATH, ["t", f"u [{unit}]"], [[0.0, 1.0, 2.0], [2.0, 2.0, 3.0]])
    for option in (InputOption("u", "u", u=0.5), InputOption("u", "u", unit, 0.5)):
        found = option.made(raw, 1, np.arange(3.0))
        assert (found.unit, found.value[0]) == (si, pytest.approx(value))
        assert found.u[0] == pytest.approx(0.5 * UNITS[unit.replace(" ", "")].factor)


def test_values_of_inputs():
    time = np.array([0.0, 1.0, 2.0, 3.0, 3.0])
    raw = table_of(PATH, ["t", "u"], [time, [1.0, np.nan, 1.0, 2.0, 9.0]])
    found = InputOption("u", "u", delay=0.3).made(raw, 1, time)
    assert (found.time.tolist(), found.value.tolist(), found.delay) == ([0, 2, 3], [1, 1, 2], 0.3)
    for values, kind in (([1, 1, 2, 3, 3], "linear"), ([1, 1, 2, 2, 2], "hold"), ([1, 2, 3, 4, 5], "linear")):
        raw = table_of(PATH, ["t", "u"], [np.arange(5), values])
        assert InputOption("u", "u").made(raw, 1, np.arange(5.0)).interpolation == kind
        assert (
            InputOption("u", "u", interpolation="hold").made(raw, 1, np.arange(5.0)).interpolation == "hold"
        )
    with pytest.raises(UsageError, match="unknown unit"):
        InputOption("u", "u", "furlong").made(raw, 1, np.arange(5.0))
    with pytest.raises(DatasetError, match="no value"):
        InputOption("u", "u").made(raw, 1, np.full(5, np.nan))


def test_inputs_of_separate_tables(tmp_path):
    time = 0.01 * np.arange(100)
    table = csv(tmp_path, "m.csv", time, 9 * time)
    other = csv(tmp_path, "u.csv", 1e3 * time, time, "t [ms],u [mV]")
    a = InputOption("a", "u", file=other)
    found = read_motion(table, ReadOptions(inputs=(a,)))
    np.testing.assert_allclose(found.inputs[0].time, time)
    np.testing.assert_allclose(found.inputs[0].value, 1e-3 * time)
    assert any("one clock" in note for note in found.notes)
    for column, match in (("t", "contains the time"), ("z", "no column")):
        with pytest.raises(DatasetError, match=match):
            read_motion(table, ReadOptions(inputs=(InputOption("a", column, file=other),)))
    both = csv(tmp_path, "b.csv", time, 9 * time)
    both.write_text("t [s],angle [rad],w1\n" + "".join(f"{t:.4f},{9 * t:.6f},{t:.3f}\n" for t in time))
    order = ReadOptions(inputs=(a, InputOption("c", "w1")))
    assert [i.name for i in read_motion(both, order).inputs] == ["a", "c"]


# ---- numbers


@pytest.mark.parametrize(
    ("time", "value", "sigma", "refused"),
    [
        (1.0, 0.9e20, 1e10, None), (1.0, 1.1e20, 1e10, "exceeds"), (1e21, 1.0, 1.0, "exceeds"),
        (1.0, 1.0, 1.1e20, "exceeds"),
        (1.0, -1.1e20, 1e10, "exceeds"), (1.0, 1.1e-20, None, None), (1.0, 0.9e-20, None, "at most"),
        (1.0, 0.0, None, None),
        (1.0, 1.0, 1.1e-18, None), (1.0, 1.0, 0.9e-18, "less than"), (1.0, 1.0, 0.0, None),
        (1.1e-12, 1.0, None, None), (0.9e-12, 1.0, None, "apart"),
    ],
)  # fmt: skip
def test_numbers_with_which_arithmetic_fails(time, value, sigma, refused):
    values = np.array([0.0, value, value if sigma is not None else np.nan])
    arguments = "body", "angle", time * np.arange(3.0), values, None if sigma is None else np.full(3, sigma)
    if refused:
        with pytest.raises(DatasetError, match=refused):
            check_motion(*arguments)
    else:
        check_motion(*arguments)


def test_errors_of_arithmetic_are_those_of_the_file():
    for error in (OverflowError("large"), ZeroDivisionError(), RecursionError()):
        with pytest.raises(DatasetError, match=r"b\.csv"), usable_numbers("b.csv"):
            raise error
    with pytest.raises(ValueError, match="z"), usable_numbers("b.csv"):
        raise ValueError("z")


# ---- stored by column


def json_table(document, **options):
    return read_json(PATH, json.dumps(document).encode(), ReadOptions(**options))


def test_tables_of_json():
    raw = json_table(
        {"t": [0, 1, None], "a": [1.5, 2, 3], "note": "x", "words": ["a", None, "c"], "short": [1]}
    )
    assert raw.names == ("t", "a", "words")
    assert raw.numbers(0).tolist()[:2] == [0, 1]
    assert math.isnan(raw.numbers(0)[2])
    assert raw.columns[2] == ["a", "", "c"]
    raw = json_table([{"t": 0, "a": True}, {"t": 1}])
    assert raw.columns[1] == ["True", ""]
    raw = json_table({"columns": {"t": [0, 1], "a": [2, 3]}, "units": {"a": "deg"}})
    assert raw.units == ("", "deg")
    for wrong in ([], {}, {"t": 1}, 3):
        with pytest.raises(DatasetError, match="JSON"):
            json_table(wrong)


def test_large_texts_of_json_are_refused(monkeypatch):
    monkeypatch.setattr(_columnar, "_MAX_JSON", 18)
    assert read_json(PATH, b'{"t": [0, 1, 2.5]}', ReadOptions()).numbers(0)[2] == 2.5
    with pytest.raises(DatasetError, match="larger"):
        read_json(PATH, b'{"t": [0, 1, 2.55]}', ReadOptions())


@pytest.mark.parametrize(
    ("unit", "known"), [("Rotations", "turns"), ("radians", "rad"), ("Degrees", "deg"), ("m", "m")]
)
def test_tests_of_sysid(unit, known):
    rows = [[k, k + 10, k + 20, k + 30] for k in range(3)]
    raw = json_table({"sysid": True, "units": unit, "slow": rows}, marker="slow")
    assert raw.units == ("s", "V", known, f"{known}/s")
    assert [raw.numbers(i)[1] for i in range(4)] == [1, 11, 21, 31]
    wide = [[k + 10 * c for c in range(9)] for k in range(3)]
    for side, places in (("left", (0, 1, 3, 5)), ("right", (0, 2, 4, 6))):
        raw = json_table({"sysid": True, "units": unit, "slow": wide, "fast": wide}, marker=f"slow {side}")
        assert [raw.numbers(i)[0] for i in range(4)] == [10 * c for c in places]
    with pytest.raises(DatasetError, match="4 or 9"):
        json_table({"sysid": True, "slow": [[1, 2, 3]]})


def test_rows_of_one_body_are_selected(tmp_path):
    raw = RawTable(
        PATH,
        ("Body", "t", "a"),
        ("",) * 3,
        (["x", "y", "x"], np.arange(3.0), ["1", "2", "3"]),
        np.array([5, 6, 7]),
    )
    found = _registry._rows_of_body(raw, ReadOptions(body="x"))
    assert (found.line.tolist(), found.columns[1].tolist(), found.columns[2]) == ([5, 7], [0, 2], ["1", "3"])
    for body in ("", "z"):
        with pytest.raises(DatasetError, match="bodies x, y"):
            _registry._rows_of_body(raw, ReadOptions(body=body))
    alone = replace(raw, columns=(["x"] * 3, *raw.columns[1:]))
    assert len(_registry._rows_of_body(alone, ReadOptions(body="z")).line) == 3
    other = replace(raw, names=("Name", "t", "a"))
    assert _registry._rows_of_body(other, ReadOptions()) is other


def test_paths_of_points_in_tables(tmp_path):
    angle = 0.2 * np.arange(80)
    rows = np.c_[0.02 * np.arange(80), 3 + 2 * np.cos(angle), 1 + 2 * np.sin(angle)]
    np.savetxt(tmp_path / "p.csv", rows, delimiter=",", header="t [s],x,y", comments="", fmt="%.9f")
    found = read_motion(tmp_path / "p.csv")
    np.testing.assert_allclose(wrap(found.value - angle), 0, atol=1e-6)
    rows[7, 1:] = np.nan
    np.savetxt(tmp_path / "q.csv", rows, delimiter=",", header="t [s],x,y", comments="", fmt="%.9f")
    found = read_motion(tmp_path / "q.csv", ReadOptions(centre="3,1"))
    assert len(found.time) == 79
    assert any("1 frames without" in note for note in found.notes)


@pytest.mark.parametrize("start", [0.0, 2.5])
def test_points_of_a_table_begin_at_the_stated_time(tmp_path, start):
    angle = 0.2 * np.arange(80)
    rows = np.c_[0.02 * np.arange(80), 3 + 2 * np.cos(angle), 1 + 2 * np.sin(angle)]
    np.savetxt(tmp_path / "p.csv", rows, delimiter=",", header="t [s],x,y", comments="", fmt="%.9f")
    # a table of points, and the same table whose columns are named
    for names in (None, read_names(["x=2", "y=3", "t=1"])):
        found = read_motion(tmp_path / "p.csv", ReadOptions(start=start, names=names))
        assert found.time[[0, -1]] == pytest.approx([start, start + 1.58])
        np.testing.assert_allclose(wrap(found.value - angle), 0, atol=1e-6)
    np.savetxt(
        tmp_path / "a.csv", np.c_[rows[:, 0], angle], delimiter=",", header="t [s],angle [rad]", comments=""
    )
    found = read_motion(tmp_path / "a.csv", ReadOptions(start=start))
    assert found.time[[0, -1]] == pytest.approx([start, start + 1.58])


class TestCases:
    def piece(self, first, last, turned=1.0):
        return SimpleNamespace(time=np.array([first, last]), angle=np.array([0.0, turned]))

    def test_windows_are_within_the_record_of_the_first_body(self):
        record = [self.piece(0.0, 3.0), self.piece(4.0, 9.0)]
        for first, last, count in ((0.0, 9.0, 0), (-0.1, 2.0, 1), (2.0, 9.1, 1)):
            assert len(_import_case.window_warnings({"a": record, "b": [self.piece(first, last)]})) == count
        for first, count in ((3.1, 0), (3.0, 1), (2.0, 1)):
            windows = [self.piece(1.0, 3.0), self.piece(first, 5.0)]
            assert len(_import_case.window_warnings({"a": record, "b": windows})) == count

    def test_a_common_second_is_the_origin_of_dates(self):
        def table(first):
            time = first + np.arange(3.0)
            return MotionTable(PATH, "", "angle", time, time, None, np.arange(3), ("n",))

        one, two = _import_case._from_origin([table(1.6e9 + 5.75), table(1.6e9 + 3.25)])
        assert one.time == pytest.approx([2.75, 3.75, 4.75])
        assert two.time == pytest.approx([0.25, 1.25, 2.25])
        assert "1600000003 s" in one.notes[1]
        kept = [table(50.0), table(1.6e9)]
        assert _import_case._from_origin(kept) is kept

    @pytest.mark.parametrize(
        ("sigmas", "source"), [([1.0, 1.0], "given"), ([None], "estimated"), ([None, 1.0], "mixed")]
    )
    def test_uncertainties_are_given_or_estimated(self, sigmas, source):
        assert _import_case.sigma_source([SimpleNamespace(sigma=s) for s in sigmas]) == source

    def test_modes_of_a_table_act_on_its_own_samples(self):
        def table(time, names):
            time = np.asarray(time)
            modes = tuple(ErrorMode(n, 10.0 * time[:, None], np.eye(1)) for n in names)
            return SimpleNamespace(time=time, modes=modes)

        series = SimpleNamespace(time=np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
        found = _import_case.modes_of([table([1.0, 2.0, 4.5], ["m"]), table([3.0, 4.0], ["m", "n"])], series)
        assert [m.name for m in found] == ["m", "m 2", "n 2"]
        assert found[0].basis[:, 0].tolist() == [10.0, 20.0, 0.0, 0.0, 0.0]
        assert found[1].basis[:, 0].tolist() == [0.0, 0.0, 30.0, 40.0, 0.0]

    @pytest.mark.parametrize(
        ("casing", "rotor", "sense", "count"),
        [
            ([(5.0, 6.0)], [(-9.0, -7.0)], 1, 0),
            ([(6.0, 5.0)], [(9.0, 7.0)], -1, 1),
            ([(-6.0, -5.0)], [(9.0, 7.0)], 1, 1),
            ([(6.0, 5.0)], [(7.0, 9.0)], 1, 1),
            ([(5.0, 5.0)], [(9.0, 7.0)], -1, 1),
            ([(6.0, 5.0)], [(7.0, 7.0)], 1, 0),
            ([(5.0, 6.0), (6.0, 4.0)], [(9.0, 7.0), (1.0, 1.5)], -1, 2),
        ],
    )
    def test_the_sense_is_that_in_which_the_angles_increase(self, casing, rotor, sense, count):
        pieces = [
            [SimpleNamespace(angle=np.array([a, 99.0, b])) for a, b in group] for group in (casing, rotor)
        ]
        found, warnings = _import_case._sense(*pieces)
        assert (found, len(warnings)) == (sense, count)

    def test_only_a_piece_without_any_speed_is_reported(self):
        time = np.concatenate([np.arange(200) / 50, 30.0 + np.arange(5) / 50])
        value = 3.0 * time + 1e-3 * np.where(np.arange(205) % 2, 1.0, -1.0)
        made = MotionTable(PATH, "", "angle", time, value, np.full(205, 1e-3), np.arange(205), ())
        notes = []
        first, second = _import_case.pieces_of(made, value, notes)
        assert (len(first.time), len(second.time)) == (200, 5)
        assert 0 < np.isfinite(first.omega).sum() < 200
        assert not np.isfinite(second.omega).any()
        assert [n for n in notes if "too short" in n] == [
            "a.csv: the piece at 30.000 s is too short for a smoothed speed (5 samples)"
        ]


@pytest.mark.parametrize(
    ("counts", "kept", "lost"),
    [
        ((50, 2, 60, 1), (50, 60), 3),
        ((50, 3, 60), (50, 3, 60), 0),
        ((50, 60), (50, 60), 0),
        ((50,), (50,), 0),
    ],
)
def test_isolated_samples_between_gaps_are_counted_and_left_out(counts, kept, lost):
    """Each run begins 10 s after the end of the run before it; the longest gap is that after 50 samples."""
    runs, begin = [], 0.0
    for n in counts:
        runs.append(begin + 0.01 * np.arange(n))
        begin = runs[-1][-1] + 10.0
    time = np.concatenate(runs)
    value = 20.0 * np.exp(-0.01 * time)
    notes = []
    parts = pieces_of(motion_table(time, value, "omega", sigma=np.full(len(time), 0.01)), value, notes)
    assert tuple(len(p.time) for p in parts) == kept
    assert any(f"{lost} isolated samples" in n for n in notes) is (lost > 0)
    gaps = f"{len(kept) - 1} gaps; the longest"
    assert any(gaps in n and "is after 0.49 s" in n for n in notes) is (len(kept) > 1)
