"""Columns of tables as recorded inputs: the option, its units, files of their own, and what is proposed."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError, import_body
from gyrotrack.io.readers._inputs import UNITS, read_input_options
from gyrotrack.io.readers._motion_table import ReadOptions

TIME = np.arange(0.0, 3.0, 0.01)
SPEED = 5 * (1 - np.exp(-np.maximum(TIME - 1.0, 0.0) / 0.3))
SPEED = SPEED + 0.01 * np.random.default_rng(1).standard_normal(len(TIME))
CURRENT = np.where(TIME < 1.0, 0.0, 1500.0)


def table(path, heads="t [s],omega [rad/s],Motor Current (mA)", columns=(TIME, SPEED, CURRENT)):
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=heads, comments="", fmt="%.9g")
    return path


def imported(path, *options):
    return import_body(path, 1.0, options=ReadOptions(inputs=read_input_options(options)))


@pytest.mark.parametrize("column", ["Motor Current", "motor current (mA)", "3", "3 [mA]"])
def test_a_column_is_named_by_its_header_or_number(tmp_path, column):
    case = imported(table(tmp_path / "a.csv"), f"current={column}")
    (found,) = case.inputs
    assert (found.name, found.unit, found.interpolation, found.delay) == ("current", "A", "hold", 0.0)
    assert found.value == pytest.approx(CURRENT / 1000)
    assert found.time == pytest.approx(TIME)
    assert np.isnan(found.u).all()
    assert any(c["quantity"] == "input current" for c in case.extra["reading"][0]["columns"])


def test_uncertainty_interpolation_and_delay_are_read(tmp_path):
    (found,) = imported(table(tmp_path / "a.csv"), "current=3 [mA] +- 15, linear, delay=0.02").inputs
    assert found.u == pytest.approx(0.015)
    assert (found.interpolation, found.delay) == ("linear", 0.02)


@pytest.mark.parametrize(
    ("values", "kind"),
    [([3.0], "hold"), ([3.0, 4.0], "linear"), ([3.0, 3.0, 4.0], "linear"), ([3.0, 3.0, 3.0, 4.0], "hold")],
)
def test_few_values_hold_if_most_are_repeated(values, kind):
    """Rows without a value or a time, and a second value at one time, are no part of an input."""
    rows = [[0.5 * k, v] for k, v in enumerate(values)]
    rows = np.array([*rows, [rows[0][0], 99.0], [np.nan, 99.0], [9.0, np.nan]])
    raw = SimpleNamespace(
        names=("T (degC)",), units=("",), path="a.csv", numbers=lambda index, name: rows[:, 1]
    )
    (option,) = read_input_options(["T=1 +- 0.5"])
    found = option.made(raw, 0, rows[:, 0])
    assert found.time == pytest.approx(rows[: len(values), 0])
    assert found.value == pytest.approx(np.array(values) + 273.15)
    assert found.u == pytest.approx(np.full(len(values), 0.5))
    assert (found.unit, found.interpolation) == ("K", kind)


@pytest.mark.parametrize(("repeated", "kind"), [(0.4, "linear"), (0.6, "hold")])
def test_a_column_of_mostly_equal_values_holds(tmp_path, repeated, kind):
    steps = np.random.default_rng(2).random(len(TIME) - 1) > repeated
    values = np.concatenate([[0.0], np.cumsum(steps)])
    path = table(tmp_path / "a.csv", "t [s],omega [rad/s],u", (TIME, SPEED, values))
    assert imported(path, "u=u").inputs[0].interpolation == kind


def test_an_input_has_a_separate_table(tmp_path):
    own = tmp_path / "drive.csv"
    np.savetxt(
        own, [[0, 0.0], [1000, 2.0], [2500, 1.0]], delimiter=",", header="t [ms],torque [N m]", comments=""
    )
    case = imported(table(tmp_path / "a.csv"), f"torque=torque, hold, file={own}")
    (found,) = case.inputs
    assert found.time == pytest.approx([0.0, 1.0, 2.5])
    assert (found.value.tolist(), found.unit) == ([0.0, 2.0, 1.0], "N m")
    assert any("one clock" in w for w in case.warnings)
    assert any("of drive.csv" in c["column"] for c in case.extra["reading"][0]["columns"])


def test_several_inputs_keep_their_order(tmp_path):
    heads, columns = "t [s],omega [rad/s],current [A],duty [%]", (TIME, SPEED, CURRENT, CURRENT / 15)
    case = imported(table(tmp_path / "a.csv", heads, columns), "duty=4", "current=3")
    assert [i.name for i in case.inputs] == ["duty", "current"]
    assert case.inputs[0].value.max() == pytest.approx(1.0)  # 100 %


def test_nothing_is_cut_and_no_sign_reversed_with_an_input(tmp_path):
    # spin-up, coast-down, rest; turning in the negative sense
    speed = np.where(TIME < 1.0, -8 * TIME, -8 * np.maximum(1 - (TIME - 1.0), 0.0))
    speed = speed + 1e-3 * np.random.default_rng(3).standard_normal(len(TIME))
    path = table(tmp_path / "a.csv", columns=(TIME, speed, np.where(TIME < 1.0, -1.0, 0.0)))
    alone, driven = imported(path), imported(path, "u=3 [A]")
    assert len(driven.casing.time) == len(TIME) > len(alone.casing.time)
    assert driven.casing.omega.min() == pytest.approx(-8, abs=0.1)
    assert alone.casing.omega.max() == pytest.approx(8, abs=0.6)


def test_a_likely_input_is_named_and_not_recorded(tmp_path):
    case = imported(table(tmp_path / "a.csv"))
    assert case.inputs == ()
    assert any(c["quantity"] == "input" for c in case.extra["reading"][0]["columns"])


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("current", "does not name a column"),
        ("current=", "does not name a column"),
        ("a b=3", "cannot be the name"),
        ("omega_c=3", "cannot be the name"),
        ("sign=3", "cannot be the name"),
        ("current=3, cubic", "'cubic' is unknown"),
        ("current=3, delay=soon", "'delay=soon' is unknown"),
        ("current=3, file=", "'file=' is unknown"),
        ("current=3, file", "'file' is unknown"),
    ],
)
def test_a_wrong_option_is_refused(option, words):
    with pytest.raises(UsageError) as caught:
        read_input_options([option])
    assert words in caught.value.message


def test_the_same_name_twice_is_refused():
    with pytest.raises(UsageError, match="given twice"):
        read_input_options(["u=3", "u=4"])


@pytest.mark.parametrize(
    ("option", "error", "words"),
    [
        ("current=9", DatasetError, "there is no column '9' for the input current"),
        ("current=nothing", DatasetError, "there is no column 'nothing'"),
        ("current=3 [furlong]", UsageError, "unknown unit 'furlong'"),
    ],
)
def test_a_column_that_is_not_there_is_refused(tmp_path, option, error, words):
    with pytest.raises(error) as caught:
        imported(table(tmp_path / "a.csv"), option)
    assert words in caught.value.message


def test_pulses_have_no_column_of_an_input(tmp_path):
    path = tmp_path / "pulses.txt"
    np.savetxt(path, np.cumsum(np.linspace(0.1, 0.2, 60)))
    options = ReadOptions(pulses_per_turn=1, inputs=read_input_options(["u=2"]))
    with pytest.raises(UsageError, match="not a table of angles or speeds"):
        import_body(path, 1.0, options=options)


def test_units_are_converted_to_si():
    assert UNITS["mA"] == ("A", 1e-3, 0.0)
    assert UNITS["kV"].factor == 1e3
    assert UNITS["Ncm"] == ("N m", 0.01, 0.0)
    assert UNITS["%"] == ("1", 0.01, 0.0)
    assert UNITS["degC"] == ("K", 1.0, 273.15)
    assert UNITS["rpm"].factor == pytest.approx(2 * np.pi / 60)


@pytest.mark.parametrize(
    ("word", "seconds"),
    [("0.02", 0.02), ("-.5", -0.5), ("2e-3 s", 2e-3), ("3 [s]", 3.0), ("1e999", None), ("2 ms", None)],
)
def test_a_delay_is_a_finite_number_of_seconds(word, seconds):
    if seconds is None:
        with pytest.raises(UsageError, match="is unknown"):
            read_input_options([f"u=3, delay={word}"])
    else:
        assert read_input_options([f"u=3, delay={word}"])[0].delay == seconds
