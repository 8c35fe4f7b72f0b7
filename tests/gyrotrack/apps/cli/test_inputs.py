"""Recorded inputs through the command line: import, info, export, fit, diagnose; and recordings of real motors."""

import csv
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

import fitting
from fitting.inference._case_data import CaseData
from fitting.inference._case_file import read_record
from gyrotrack import read_case, write_case
from gyrotrack.apps import _spindown
from gyrotrack.apps.cli import _tracking

CASES = Path(__file__).parents[5] / "shared" / "cases" / "tables"
TIME = np.arange(0.0, 4.0, 0.01)
VOLTAGE = np.select([TIME < 0.5, TIME < 2.5], [0.0, 3.0], 1.0)
TAU, GAIN, NOISE = 0.25, 6.0, 0.02


@pytest.fixture
def motor(tmp_path):
    a, path = np.exp(-0.01 / TAU), tmp_path / "motor.csv"
    speed = np.asarray(lfilter([0.0, 1 - a], [1.0, -a], GAIN * VOLTAGE))
    speed = speed + NOISE * np.random.default_rng(1).standard_normal(len(TIME))
    rows = np.stack([TIME, speed, VOLTAGE], axis=1)
    np.savetxt(path, rows, delimiter=",", header="t [s],omega [rad/s],voltage [V]", comments="", fmt="%.9g")
    return path


def run(gyrotrack, *words):
    said = gyrotrack(*words)
    return said.code, said.out, said.err


def imported(gyrotrack, motor, *more):
    case = motor.with_suffix(".h5")
    code, out, err = run(
        gyrotrack,
        "import",
        "--body",
        motor,
        "--inertia",
        "0.5",
        "--input",
        "voltage=3 +- 0.03",
        *more,
        "-o",
        case,
    )
    assert code == 0, err
    return case, out


@pytest.mark.slow
def test_import_info_and_export_of_an_input(gyrotrack, motor, tmp_path):
    case, out = imported(gyrotrack, motor)
    assert "input voltage from 'voltage [V]' [V] (by --input; the last value holds)" in out
    code, out, _ = run(gyrotrack, "info", case)
    assert code == 0
    assert "0.0000 to 3.0000  V, u 0.03, hold" in out
    _, out, _ = run(gyrotrack, "info", case, "--json")
    assert json.loads(out)["inputs"]["voltage"]["samples"] == len(TIME)
    for name in ("i.csv", "i.json", "i.parquet"):
        assert run(gyrotrack, "export", case, "-o", tmp_path / name, "--table", "inputs")[0] == 0
    with (tmp_path / "i.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(r["value"]) for r in rows] == pytest.approx(VOLTAGE)
    assert {(r["input"], r["unit"], r["interpolation"], r["delay [s]"]) for r in rows} == {
        ("voltage", "V", "hold", "0.0")
    }
    assert run(gyrotrack, "export", case, "-o", tmp_path / "i.nc")[0] == 0
    with h5py.File(tmp_path / "i.nc") as file:
        assert file["input/voltage/value"].attrs["units"] == "V"


def test_a_case_with_inputs_is_written_and_read_back_by_both_readers(gyrotrack, motor, tmp_path):
    case, _ = imported(gyrotrack, motor)
    content = read_case(case)
    write_case(tmp_path / "again.h5", content, command="", settings={})
    for path in (case, tmp_path / "again.h5"):
        (found,) = fitting.load(path).inputs
        (own,) = read_case(path).inputs
        assert found.time == pytest.approx(own.time)
        assert found.value == pytest.approx(own.value)
        assert found.u == pytest.approx(own.u)
        assert (found.name, found.unit, found.interpolation, found.delay) == (
            own.name, own.unit, own.interpolation, own.delay,
        )  # fmt: skip
    assert fitting.load(case).digest == fitting.load(tmp_path / "again.h5").digest


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda g: g.attrs.__setitem__("interpolation", "cubic"), "interpolation"),
        (lambda g: g["value"].__setitem__(5, np.nan), "lacks some values"),
        (lambda g: g["time"].__setitem__(5, -1.0), "not strictly increasing"),
        (lambda g: g.__delitem__("u"), "lacks 'u'"),
    ],
)
def test_info_finds_a_damaged_input(gyrotrack, motor, damage, words):
    case, _ = imported(gyrotrack, motor)
    with h5py.File(case, "r+") as file:
        damage(file["input/voltage"])
    content = case.read_bytes()
    case.write_bytes(
        content[: content.rindex(b"\ngyrotrack sha256") if b"\ngyrotrack sha256" in content else None]
    )
    code, out, err = run(gyrotrack, "info", case)
    assert code in {1, 3}
    assert words in out + err
    code, out, err = run(gyrotrack, "fit", case)
    assert code == 1
    assert "Traceback" not in out + err


def test_a_likely_input_is_proposed(gyrotrack, motor):
    code, _, err = run(gyrotrack, "import", "--body", motor, "--inertia", "1", "--dry-run")
    assert code == 0
    assert "'voltage' of motor.csv may drive the motion and is not recorded" in err
    assert "--input 'voltage=voltage [V]'" in err


def test_a_fit_names_the_input_that_its_model_does_not_contain(gyrotrack, motor):
    case, _ = imported(gyrotrack, motor)
    missing = "If it is a drive, add it with --add casing.input.voltage."
    assert missing in " ".join(run(gyrotrack, "fit", case)[2].split())
    assert missing not in " ".join(run(gyrotrack, "fit", case, "--add", "casing.input.voltage")[2].split())


@pytest.mark.slow
def test_a_fit_prints_time_constant_and_gain(gyrotrack, motor):
    case, _ = imported(gyrotrack, motor)
    code, out, err = run(
        gyrotrack, "fit", case, "--add", "casing: k*voltage", "--drop", "touchpoint.constant"
    )
    assert code == 0, err
    assert "time constant" in out
    assert "gain of voltage" in out
    code, out, _ = run(
        gyrotrack, "fit", case, "--add", "casing.input.voltage", "--drop", "casing: k*voltage", "--json"
    )
    (found,) = json.loads(out)["first_order"]
    for key, truth, unit in (("time_constant", TAU, "s"), ("gains", GAIN, "rad s-1 V-1")):
        one = found[key] if key == "time_constant" else found[key]["voltage"]
        assert abs(one["value"] - truth) < 3 * one["stderr"] < 0.1 * truth
        assert one["unit"] == unit
    assert json.loads(out)["parameters"]["casing.input.voltage.k"]["unit"] == "N m V-1"
    code, out, _ = run(gyrotrack, "budget", case, "--json")
    parts = {c["source"] for c in json.loads(out)["parameters"]["casing.input.voltage.k"]["contributions"]}
    assert "calibration of voltage" in parts


@pytest.mark.slow
def test_a_report_shows_the_response_of_a_driven_body(gyrotrack, motor, tmp_path):
    case, _ = imported(gyrotrack, motor)
    assert run(gyrotrack, "fit", case, "--add", "casing: k*voltage", "--drop", "touchpoint.constant")[0] == 0
    code, _, err = run(gyrotrack, "report", case, "-o", tmp_path / "a.html", "--from", "f2")
    assert code == 0, err
    page = (tmp_path / "a.html").read_text()
    assert page.count("first-order response") == 2  # time constant and gain
    assert "K<sub>voltage</sub>" in page
    assert "rad s⁻¹ V⁻¹" in page.replace("\xa0", " ")


def test_a_law_of_an_input_that_was_not_recorded_gets_one_sentence(gyrotrack, motor):
    case, _ = imported(gyrotrack, motor)
    code, out, err = run(gyrotrack, "fit", case, "--add", "casing: k*current")
    assert code == 1
    assert "Recorded inputs: voltage." in err
    assert "Traceback" not in out + err


def test_a_diagnosis_names_the_recorded_input(gyrotrack, motor):
    case, _ = imported(gyrotrack, motor)
    code, out, err = run(gyrotrack, "diagnose", case, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["verdict"] == "missing_effect"
    assert found["candidates"][0]["effect"] == "casing.input.voltage"


# a first-order fit of the same samples by SciPy: held input, dead time, free initial speed


def plain_fit(time, speed, u, start, *, delay):
    fine = np.linspace(time[0], time[-1], 4 * (len(time) - 1) + 1)
    step = fine[1] - fine[0]
    # the mean of a held input in each cell, from its running integral
    knots = np.concatenate([u.time, [time[-1] + 1.0]])
    running = np.concatenate([[0.0], np.cumsum(u.value * np.diff(knots))])

    def model(x):
        late = x[3] if delay else 0.0
        a = np.exp(-step / x[0])
        held = u.value[0] * np.minimum(fine - late - knots[0], 0.0)  # before the first sample
        drive = x[1] * (1 - a) * np.diff(np.interp(fine - late, knots, running) + held) / step
        y = lfilter([1.0], [1.0, -a], drive, zi=[a * x[2]])[0]
        return np.interp(time, fine, np.concatenate([[x[2]], y]))

    start = np.array(start[: 4 if delay else 3], dtype=float)
    found = least_squares(
        lambda x: model(x) - speed, start, x_scale=np.maximum(np.abs(start), 1e-2), diff_step=1e-3
    )
    rest = found.fun
    # residuals of a real motor are correlated: 1 + 2 sum of the correlations up to the first that is not positive
    spectrum = np.abs(np.fft.rfft(rest, 2 * len(rest))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(rest)] / float(rest @ rest)
    end = int(np.flatnonzero(correlation <= 0)[0])
    inflation = 1 + 2 * correlation[1:end].sum()
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.mean(rest**2) * inflation
    return found.x, np.sqrt(np.diag(covariance))


REAL = {
    "motor": ("motor_step.csv", [], "u=Commanded_PWM", True, (0.025, 0.028, 0.0, 0.0155)),
    "capture": (
        "capture_struct.mat",
        ["t=t", "omega=Switch [rad/s]"],
        "u=Switch2",
        False,
        (0.1, 250.0, -50.0),
    ),
    "sysid": (
        "sysid_drive.json",
        ["t=t", "omega=omega [turns/s]"],
        "u=voltage",
        True,
        (0.055, 2.0, 0.0, 0.07),
    ),
}


@pytest.mark.parametrize("name", REAL)
@pytest.mark.slow
@pytest.mark.release
def test_constants_of_real_motors_are_those_of_a_plain_fit(gyrotrack, tmp_path, name):
    table, columns, given, delay, start = REAL[name]
    if not (CASES / table).is_file():
        pytest.skip("the shared cases are not here")
    case = tmp_path / "a.h5"
    words = ["import", "--body", CASES / table, "--inertia", "1", "--input", given, "-o", case]
    words += [w for c in columns for w in ("--column", c)]
    words += ["--marker", "fast-forward left"] if name == "sysid" else []
    assert run(gyrotrack, *words)[0] == 0
    effects = ["--add", "casing.input.u", *(["--add", "input.u.delay"] if delay else [])]
    code, out, err = run(gyrotrack, "fit", case, *effects, "--drop", "touchpoint.constant", "--json")
    assert code == 0, err
    (found,) = json.loads(out)["first_order"]
    record = fitting.load(case)
    x, u = plain_fit(record.casing.time, record.casing.value, record.inputs[0], start, delay=delay)
    pairs = [(found["time_constant"], 0), (found["gains"]["u"], 1)]
    for one, place in pairs:
        assert abs(one["value"] - x[place]) < 2 * np.hypot(one["stderr"], u[place])


@pytest.mark.slow
@pytest.mark.parametrize("late", [0, 12])
@pytest.mark.release
def test_spindown_measures_the_response_of_a_driven_body(gyrotrack, tmp_path, late):
    a, path = np.exp(-0.01 / TAU), tmp_path / "motor.csv"
    acting = np.concatenate([np.full(late, VOLTAGE[0]), VOLTAGE[: len(VOLTAGE) - late]])
    speed = np.asarray(lfilter([0.0, 1 - a], [1.0, -a], GAIN * acting))
    speed = speed + NOISE * np.random.default_rng(6).standard_normal(len(TIME))
    rows = np.stack([TIME, speed, VOLTAGE], axis=1)
    np.savetxt(path, rows, delimiter=",", header="t [s],omega [rad/s],voltage [V]", comments="", fmt="%.9g")
    words = ["spindown", path, "--input", "voltage=3", "-o", tmp_path / "motor.h5"]
    code, out, err = run(gyrotrack, *words, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["motion"]["kind"] == "driven"
    assert found["diagnosis"]["verdict"] == "adequate"
    (response,) = found["first_order"]
    tau, gain = response["time_constant"], response["gains"]["voltage"]
    assert tau["value"] == pytest.approx(TAU, abs=4 * tau["stderr"])
    assert tau["stderr"] < 0.01 * TAU
    assert gain["value"] == pytest.approx(GAIN, abs=4 * gain["stderr"])
    # a dead time is part of the model only where the record shows one
    assert set(response["delays"]) == ({"voltage"} if late else set())
    if late:
        delay = response["delays"]["voltage"]
        assert delay["value"] == pytest.approx(0.01 * late, abs=4 * delay["stderr"])
    assert (tmp_path / "motor.h5").exists()
    assert (tmp_path / "motor.html").exists()


def test_spindown_prints_the_constants_of_the_first_order(gyrotrack, motor):
    case, _ = imported(gyrotrack, motor)
    found = _spindown._first_order_fit([CaseData.of(read_record(case))], ["voltage"])
    document = {"first_order": [vars(r) for r in fitting.first_order(found)]}
    title, *lines = _tracking._first_order_lines({**document, "diagnosis": {"verdict": "adequate"}})
    assert title == "response   of the first-order fit to the recorded input"
    assert lines[0].startswith("tau        0.2")
    assert lines[1].startswith("gain of voltage")
    assert _tracking._first_order_lines({**document, "diagnosis": None})[0].endswith(
        ", which is not complete"
    )
    assert _tracking._first_order_lines({"first_order": []}) == []


def test_an_input_of_spindown_needs_a_table(gyrotrack, motor, tmp_path):
    case, _ = imported(gyrotrack, motor)
    code, _, err = run(gyrotrack, "spindown", case, "--input", "voltage=3", "-o", tmp_path / "b.h5")
    assert code == 2
    assert "--input names a column of a table" in err


@pytest.mark.slow
def test_a_recorded_temperature_drives_nothing(gyrotrack, tmp_path):
    time = np.arange(0.0, 4.0, 0.1)
    speed = 20 * np.exp(-time / 2) + 0.01 * np.random.default_rng(2).standard_normal(len(time))
    path = tmp_path / "coast.csv"
    np.savetxt(
        path, np.stack([time, speed, 20 + time], axis=1), delimiter=",", comments="", fmt="%.9g",
        header="t [s],omega [rad/s],room [degC]",
    )  # fmt: skip
    code, out, err = run(gyrotrack, "spindown", path, "--input", "room=3", "-o", tmp_path / "m.h5", "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["motion"]["kind"] == "spin-down"
    assert found["first_order"] == []
    assert {law["parameter"].rpartition(".")[0] for law in found["laws"]} == {
        "touchpoint.constant",
        "casing.air.linear",
    }
