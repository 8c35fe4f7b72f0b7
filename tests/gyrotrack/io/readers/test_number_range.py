"""Numbers that arithmetic cannot handle are refused where a table is read and where a case is fitted, by one rule."""

import numpy as np
import pytest

from fitting import RecordError
from fitting.inference import _record
from gyrotrack import DatasetError
from gyrotrack.io.readers import _number_range as number_range
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
    assert [getattr(_record, n) for n in names] == [getattr(number_range, n) for n in names]


@pytest.mark.parametrize("name", EXTREMES)
def test_a_table_is_refused_beyond_a_limit_and_read_within_it(name):
    with pytest.raises(DatasetError):
        number_range.check_motion("body", "angle", *EXTREMES[name])
    number_range.check_motion("body", "angle", *shrunk(name))


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
    number_range.check_motion("body", "angle", *rest)
    assert len(record(rest).casing) == N


def test_an_angle_that_overflows_is_refused_before_it_is_searched(tmp_path):
    rows = "".join(f"{k},{1e30 * k!r}\n" for k in range(61))
    (tmp_path / "t.csv").write_text("t [s],angle [rad]\n" + rows)
    with pytest.raises(DatasetError, match="exceeds 1e\\+20 in SI units"):
        read_motion(tmp_path / "t.csv")
