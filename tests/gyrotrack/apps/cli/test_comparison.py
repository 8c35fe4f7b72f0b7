"""The command compare: two simulated spin-downs whose drag differs by 2 %, and a population of fits."""

import json
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Estimate, Model
from gyrotrack import DatasetError
from gyrotrack.apps.cli import _compare as module
from gyrotrack.apps.cli._app import run


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    t = np.arange(0, 10, 0.02)
    for seed, (name, b) in enumerate({"left": 0.1, "right": 0.102}.items()):
        angle = 30 / b * (1 - np.exp(-b * t)) + 1e-3 * np.random.default_rng(seed).standard_normal(len(t))
        table = np.c_[t, angle, np.full(len(t), 1e-3)]
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header="t,angle,sigma", comments="")
        case = str(folder / f"{name}.h5")
        assert run(["import", "--body", str(folder / f"{name}.csv"), "--inertia", "1", "-o", case, "-q"]) == 0
        assert run(["fit", case, "--model", "reduced", "-q"]) == 0
    return folder


@pytest.mark.slow
def test_the_drag_differs(runs, capsys):
    picture = runs / "difference.png"
    cases = [str(runs / "left.h5"), str(runs / "right.fits.json")]
    capsys.readouterr()
    assert run(["compare", *cases, "--picture", str(picture), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    drag = found["parameters"]["casing.air.linear.b2"]
    values = drag["values"]
    expected = (values[1]["value"] - values[0]["value"]) / np.hypot(*(v["stderr"] for v in values))
    assert drag["difference_sigma"] == pytest.approx(expected)
    assert drag["difference_sigma"] > 5
    assert drag["mean"]["value"] == pytest.approx(0.101, rel=0.01)
    assert found["runs"] == ["left", "right"]
    assert picture.stat().st_size > 5000
    assert run(["compare", *cases]) == 0
    assert "differs between the runs" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("names", "code"), [(["left.h5"], 2), (["left.h5", "left.h5"], 2), (["left.h5", "x.h5"], 1)]
)
def test_wrong_input_is_one_sentence(runs, names, code, capsys):
    assert run(["compare", *(str(runs / n) for n in names)]) == code
    assert "Traceback" not in capsys.readouterr().err


class Workers:
    """Answers fits without running them; one case fails."""

    def __init__(self, fails=""):
        self.fails, self.sent = fails, []

    def submit(self, words, timeout):
        self.sent.append([w for w in words if w.endswith(".h5")])
        error = any(w.endswith(self.fails) for w in words) if self.fails else False
        done = Future()
        done.set_result({"document": {"error": {"message": "no samples"}} if error else {}})
        return done

    def close(self):
        pass


def test_cases_of_a_part_that_fails_are_sent_one_by_one():
    cases = [Path(f"/runs/run{i}.h5") for i in range(5)]
    place, seen = Workers(fails="run3.h5"), []
    failed = module._fit(
        cases, ["--model", "linear"], place, 2, lambda done, total: seen.append((done, total))
    )
    assert failed == {"/runs/run3.h5": "no samples"}
    assert [len(x) for x in place.sent] == [2, 2, 1, 1, 1]
    assert seen[-1] == (5, 5)


def test_runs_of_a_folder_are_in_the_order_of_their_numbers(tmp_path):
    for n in (10, 9, 1):
        (tmp_path / f"run{n}.h5").touch()
    assert [p.name for p in module._files([tmp_path, Path("a.h5")])] == [
        "run1.h5",
        "run9.h5",
        "run10.h5",
        "a.h5",
    ]
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="has no case"):
        module._files([tmp_path / "empty"])


def test_times_are_numbers_with_a_unit_or_dates(tmp_path):
    table = tmp_path / "times.csv"
    table.write_text("run,Time [h]\nrun1.h5,0.5\nrun2,2\n")
    times, unit = module._read_times(table)
    assert (times, unit) == ({"run1.h5": 0.5, "run2": 2.0}, "h")
    assert module._times_of({"run1": None, "/x/run2": None}, times) == {"run1": 0.5, "/x/run2": 2.0}
    with pytest.raises(DatasetError, match="has no run run3"):
        module._times_of({"run3": None}, times)
    table.write_text("time,run\n2024-05-17T12:00,run1\n2024-05-18T00:00,run2\n")
    dates, unit = module._read_times(table)
    assert unit == "day"
    assert dates["run2"] - dates["run1"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no columns run and time"),
        ("run,hour\na,1\n", "no columns run and time"),
        ("run,time\na\n", "line 2: a value is missing"),
        ("run,time\na,noon\n", "'noon' is neither a number nor a date"),
        ("run,time\na,nan\n", "the time is not finite"),
    ],
)
def test_a_wrong_table_of_times_is_one_sentence(tmp_path, text, words):
    (tmp_path / "times.csv").write_text(text)
    with pytest.raises(DatasetError, match=words):
        module._read_times(tmp_path / "times.csv")
    with pytest.raises(DatasetError, match="cannot be read"):
        module._read_times(tmp_path / "none.csv")


def many():
    """Return fits of 20 runs with a step and an outlying run."""
    rng, fits = np.random.default_rng(4), {}
    for i in range(20):
        value = 1.0 + 0.01 * rng.standard_normal() + (0.1 if i >= 12 else 0.0) + (5.0 if i == 4 else 0.0)
        e = Estimate(value, 0.01, "N m s", at_bound=False)
        fits[f"run{i}"] = SimpleNamespace(
            model=Model.of(["casing.air.linear"]), estimates={"casing.air.linear.b2": e}
        )
    return fits


def test_many_runs_are_a_population(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(module, "latest_fits", lambda *_: many())
    cases = [str(tmp_path / f"run{i}.h5") for i in range(20)]
    assert run(["compare", *cases, "--picture", str(tmp_path / "population.png")]) == 0
    said = capsys.readouterr().out
    assert "20 runs" in said
    assert "steps by" in said
    assert "between run11 and run12" in said
    assert "Outlying runs, excluded: run4." in said
    assert (tmp_path / "population.png").stat().st_size > 5000
    assert run(["compare", *cases, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["population"]["outlying"][0]["run"] == "run4"
    assert found["population"]["parameters"]["casing.air.linear.b2"]["change"]["first_after"] == "run12"
    assert found["failed"] == {}


def test_only_runs_without_such_a_fit_are_fitted(runs, monkeypatch, capsys):
    place = Workers()
    monkeypatch.setattr("gyrotrack.apps.batch._workers.LocalWorkers", lambda _: place)
    cases = [str(runs / "left.h5"), str(runs / "right.h5")]
    assert run(["compare", *cases, "--model", "reduced", "--json"]) == 0
    assert place.sent == []
    # no worker fits them here, so there is nothing to compare
    assert run(["compare", *cases, "--model", "reduced", "--add", "casing.air.quadratic"]) == 1
    assert sorted(Path(w[0]).name for w in place.sent) == ["left.h5", "right.h5"]
    assert run(["compare", *cases, "--add", "casing.air.quadratic"]) == 2
    assert "--add needs --model" in capsys.readouterr().err
