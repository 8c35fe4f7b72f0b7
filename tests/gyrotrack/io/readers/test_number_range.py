"""Numbers that arithmetic cannot handle are refused where a table is read and where a case is fitted, by one rule."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import RecordError
from fitting.inference import _record
from gyrotrack import DatasetError
from gyrotrack.io.readers import _number_range as _number_range
from gyrotrack.io.readers._registry import read_motion

N = 60
TIME = np.arange(N) * 0.1
EXTREMES = {
    "time": (TIME + 1.01e20, np.ones(N), np.ones(N)),
    "value": (TIME, np.full(N, 1.01e20), np.ones(N) * 1e10),
    "uncertainty": (TIME, np.ones(N), np.full(N, 1.01e20)),
    "small value": (TIME, np.full(N, 0.99e-20), np.ones(N)),
    "small uncertainty": (TIME, np.ones(N), np.full(N, 0.99e-18)),
}


def shrunk(name):
    time, value, sigma = EXTREMES[name]
    inside = {
        "time": (TIME, value, sigma),
        "value": (time, value / 1.02, sigma),
        "uncertainty": (time, value, sigma / 1.02),
        "small value": (time, value * 1.02, sigma),
        "small uncertainty": (time, value, sigma * 1.02),
    }
    return inside[name]


def test_both_packages_have_the_same_limits():
    names = ("LARGEST", "SMALLEST", "PRECISION")
    assert [getattr(_record, n) for n in names] == [getattr(_number_range, n) for n in names]


@pytest.mark.parametrize("name", EXTREMES)
def test_a_table_is_refused_beyond_a_limit_and_read_within_it(name):
    with pytest.raises(DatasetError):
        _number_range.check_motion("body", "angle", *EXTREMES[name])
    _number_range.check_motion("body", "angle", *shrunk(name))


def record(parts):
    return _record.make_record(
        casing=parts, rotor=[], I_rotor=1.0, I_casing=1.0, label="x", single=True, quantity="angle"
    )


@pytest.mark.parametrize("name", [n for n in EXTREMES if n != "time"])
def test_a_record_is_refused_beyond_a_limit_and_made_within_it(name):
    with pytest.raises(RecordError):
        record(EXTREMES[name])
    assert len(record(shrunk(name)).casing) == N


def test_a_body_at_rest_is_not_a_small_number():
    rest = TIME, np.zeros(N), np.ones(N)
    _number_range.check_motion("body", "angle", *rest)
    assert len(record(rest).casing) == N


def test_an_angle_that_overflows_is_refused_before_it_is_searched(tmp_path):
    rows = "".join(f"{k},{1e30 * k!r}\n" for k in range(61))
    (tmp_path / "t.csv").write_text("t [s],angle [rad]\n" + rows)
    with pytest.raises(DatasetError, match="exceeds 1e\\+20 in SI units"):
        read_motion(tmp_path / "t.csv")


@pytest.mark.parametrize(
    ("value", "sigma", "refused"),
    [
        (0.99e20, None, None),
        (1.01e20, None, "exceeds"),
        (-1.01e20, None, "exceeds"),
        (1.01e-20, None, None),
        (0.99e-20, None, "is at most"),
        (0.0, None, None),
        (1.0, 1.01e-18, None),
        (1.0, 0.99e-18, "is less than"),
        (-1.0, 0.99e-18, "is less than"),
        (1.0, 1.01e20, "exceeds"),
        (1.0, 0.0, None),
    ],
)
def test_values_and_uncertainties_can_be_multiplied(value, sigma, refused):
    time, values = np.arange(4.0), np.array([0.0, np.nan, value, 0.0])
    given = None if sigma is None else np.array([1.0, np.nan, sigma, 1.0])
    if refused is None:
        _number_range.check_motion("casing", "angle", time, values, given)
    else:
        with pytest.raises(DatasetError, match=refused):
            _number_range.check_motion("casing", "angle", time, values, given)


@pytest.mark.parametrize(("step", "refused"), [(1.01e-12, False), (0.99e-12, True), (-1.01e-12, False)])
def test_times_are_a_picosecond_apart(step, refused):
    time = step * np.arange(5.0)
    if refused:
        with pytest.raises(DatasetError, match="s apart"):
            _number_range.check_motion("casing", "angle", time, np.ones(5), None)
    else:
        _number_range.check_motion("casing", "angle", time, np.ones(5), None)
    _number_range.check_motion("casing", "angle", np.zeros(1), np.ones(1), None)


def test_angles_and_speeds_are_checked():
    def case(**change):
        plain = {
            "time": np.arange(3.0),
            "angle": np.ones(3),
            "sigma": np.ones(3),
            "omega": np.ones(3),
            "omega_sigma": np.ones(3),
        }
        return SimpleNamespace(
            motions=[("casing", SimpleNamespace(**plain)), ("rotor", SimpleNamespace(**{**plain, **change}))]
        )

    _number_range.check_numbers(case())
    for name, words in (
        ("angle", "angle of the rotor"),
        ("omega", "speed of the rotor"),
        ("omega_sigma", "uncertainty of speed"),
        ("time", "time of the rotor"),
    ):
        with pytest.raises(DatasetError, match=words):
            _number_range.check_numbers(case(**{name: np.full(3, 1e21)}))


@pytest.mark.parametrize(
    "error",
    [OverflowError("too large."), ZeroDivisionError(), RecursionError("deep")],
    ids=["large", "zero", "deep"],
)
def test_errors_of_arithmetic_name_the_files(error):
    @_number_range.within_number_range
    def read(given):
        raise error

    for given, name in (("a.csv", "a.csv"), ({"wheel": 1, "drum": 2}, "wheel, drum")):
        with pytest.raises(DatasetError, match=f"numbers in {name} cannot be used"):
            read(given)
