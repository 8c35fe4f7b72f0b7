"""Bodies of exported cases, ranges of numbers, and the limits of the process that reads MATLAB files."""

from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.io.readers import _matlab_process as process
from gyrotrack.io.readers import _number_range as numbers
from gyrotrack.io.readers import _point_files as files

PATH = Path("a.nc")


@pytest.fixture
def exported():
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        for name, factor in (("casing", 1.0), ("rotor", 10.0)):
            group = file.create_group(name)
            columns = ("time", "angle", "sigma", "omega", "omega_sigma")
            for k, column in enumerate(columns):
                group[column] = factor * (k + np.arange(3.0))
        yield file


@pytest.mark.parametrize(("body", "factor"), [("", 1.0), ("casing", 1.0), ("rotor", 10.0)])
@pytest.mark.parametrize(("quantity", "first"), [(None, 1), ("angle", 1), ("omega", 3)])
def test_an_exported_body_has_the_measured_quantity(exported, body, factor, quantity, first):
    if quantity:
        exported.attrs["quantity"] = quantity
    raw = files._exported_body(PATH, exported, body)
    assert raw.names == ("t", quantity or "angle", "sigma")
    for place, k in enumerate((0, first, first + 1)):
        assert raw.numbers(place) == pytest.approx(factor * (k + np.arange(3.0)))


def test_a_body_that_was_not_exported_is_refused(exported):
    exported.create_group("empty")
    for body in ("wheel", "empty"):
        with pytest.raises(DatasetError, match=f"no series '{body}'"):
            files._exported_body(PATH, exported, body)


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
        numbers.check_motion("casing", "angle", time, values, given)
    else:
        with pytest.raises(DatasetError, match=refused):
            numbers.check_motion("casing", "angle", time, values, given)


@pytest.mark.parametrize(("step", "refused"), [(1.01e-12, False), (0.99e-12, True), (-1.01e-12, False)])
def test_times_are_a_picosecond_apart(step, refused):
    time = step * np.arange(5.0)
    if refused:
        with pytest.raises(DatasetError, match="s apart"):
            numbers.check_motion("casing", "angle", time, np.ones(5), None)
    else:
        numbers.check_motion("casing", "angle", time, np.ones(5), None)
    numbers.check_motion("casing", "angle", np.zeros(1), np.ones(1), None)


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

    numbers.check_numbers(case())
    for name, words in (
        ("angle", "angle of the rotor"),
        ("omega", "speed of the rotor"),
        ("omega_sigma", "uncertainty of speed"),
        ("time", "time of the rotor"),
    ):
        with pytest.raises(DatasetError, match=words):
            numbers.check_numbers(case(**{name: np.full(3, 1e21)}))


@pytest.mark.parametrize(
    "error",
    [OverflowError("too large."), ZeroDivisionError(), RecursionError("deep")],
    ids=["large", "zero", "deep"],
)
def test_errors_of_arithmetic_name_the_files(error):
    @numbers.within_number_range
    def read(given):
        raise error

    for given, name in (("a.csv", "a.csv"), ({"wheel": 1, "drum": 2}, "wheel, drum")):
        with pytest.raises(DatasetError, match=f"numbers in {name} cannot be used"):
            read(given)


def test_memory_and_time_of_a_reading_process_are_limited(monkeypatch):
    resource = pytest.importorskip("resource")
    pages = 1000
    limits = {
        resource.RLIMIT_AS: (resource.RLIM_INFINITY, resource.RLIM_INFINITY),
        resource.RLIMIT_CPU: (5, 7),
        resource.RLIMIT_CORE: (3, resource.RLIM_INFINITY),
    }
    found = {}
    monkeypatch.setattr(Path, "read_text", lambda self, encoding: f"{pages} 5 3")
    monkeypatch.setattr(resource, "getpagesize", lambda: 4096)
    monkeypatch.setattr(resource, "getrlimit", limits.get)
    monkeypatch.setattr(resource, "setrlimit", lambda kind, both: found.update({kind: both}))
    monkeypatch.setattr(process.os, "times", lambda: (1.5, 2.6, 100.0, 100.0, 100.0))
    process._limit()
    memory = pages * 4096 + process._MOST_MEMORY
    assert found[resource.RLIMIT_AS] == (memory, memory)
    assert found[resource.RLIMIT_CPU] == (5, 5)
    assert found[resource.RLIMIT_CORE] == (0, 0)
    limits[resource.RLIMIT_CPU] = (resource.RLIM_INFINITY,) * 2
    limits[resource.RLIMIT_AS] = (2**20, 2**30)
    process._limit()
    seconds = 4 + process._MOST_CPU_S
    assert found[resource.RLIMIT_CPU] == (seconds, seconds)
    assert found[resource.RLIMIT_AS] == (2**20, 2**20)

    def absent(self, encoding):
        raise OSError

    found.clear()
    monkeypatch.setattr(Path, "read_text", absent)
    process._limit()
    assert found == {}
