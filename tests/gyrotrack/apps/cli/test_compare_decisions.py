"""Orders, times and tables of compared runs; tests of answers on simulated recordings; simulated cases."""

import math
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError, GyrotrackError, UsageError
from gyrotrack.apps.cli import _certify as certify
from gyrotrack.apps.cli import _compare as module
from gyrotrack.apps.cli import _data as data
from gyrotrack.apps.cli import _simulation as simulation


class Place:
    """Workers that answer at once; `answers` makes the document of a command."""

    def __init__(self, answers):
        self.answers, self.words = answers, []

    def submit(self, words, timeout):
        self.words.append(words)
        future = Future()
        future.set_result({"document": self.answers(words)})
        return future

    def close(self):
        pass


class TestFiles:
    @pytest.mark.parametrize(
        ("names", "order"),
        [
            (["run10.h5", "run9.h5", "run.h5"], ["run9.h5", "run10.h5", "run.h5"]),
            (["2b.h5", "10a.h5", "a1.h5"], ["2b.h5", "10a.h5", "a1.h5"]),
            (["1²3.h5", "1²20.h5", "0.h5"], ["0.h5", "1²3.h5", "1²20.h5"]),  # a superscript is no number
        ],
    )
    def test_cases_of_a_folder_are_in_the_order_of_their_numbers(self, tmp_path, names, order):
        for name in [*names, "notes.txt"]:
            (tmp_path / name).touch()
        assert [p.name for p in module._files([Path("first.h5"), tmp_path])] == ["first.h5", *order]

    def test_a_case_without_such_a_fit_is_fitted(self, monkeypatch, tmp_path):
        def latest(files, wanted):
            if files[0].name != "fitted.h5":
                raise DatasetError("no fit", "")

        monkeypatch.setattr(module, "latest_fits", latest)
        (tmp_path / "new.h5").touch()
        assert module._fitted(tmp_path / "fitted.h5", ("a",))
        assert not module._fitted(tmp_path / "new.h5", ("a",))
        with pytest.raises(DatasetError):
            module._fitted(tmp_path / "missing.h5", ("a",))

    def test_a_ledger_cannot_be_fitted(self):
        with pytest.raises(UsageError, match="cannot be fitted"):
            module._model_names(Path("a.fits.json"), None)


class TestFit:
    def fitted(self, bad, count, size):
        """Fit cases; a command fails if it contains a bad one."""

        def answers(words):
            failed = [w for w in words if Path(w).name in bad]
            return {"error": {"message": f"no {Path(failed[0]).name}"}} if failed else {}

        place, told = Place(answers), []
        cases = [Path(f"c{i}.h5") for i in range(count)]
        found = module._fit(cases, ["--model", "m"], place, size, lambda *done: told.append(done))
        parts = [[Path(w).stem for w in words[1 : words.index("--model")]] for words in place.words]
        assert all(w[-4:] == ["--model", "m", "--json", "--quiet"] for w in place.words)
        return found, parts, told

    def test_parts_of_a_size_are_fitted(self):
        found, parts, told = self.fitted([], 5, 2)
        assert found == {}
        assert sorted(parts) == [["c0", "c1"], ["c2", "c3"], ["c4"]]
        assert (told[0], told[-1]) == ((0, 5), (5, 5))

    def test_of_a_part_that_fails_each_case_is_fitted_alone(self):
        found, parts, told = self.fitted(["c1.h5"], 3, 2)
        assert found == {"c1.h5": "no c1.h5"}
        assert sorted(parts) == [["c0"], ["c0", "c1"], ["c1"], ["c2"]]
        assert told[-1] == (3, 3)


class TestTimes:
    def read(self, tmp_path, text):
        (tmp_path / "t.csv").write_text(text)
        return module._read_times(tmp_path / "t.csv")

    @pytest.mark.parametrize(
        ("head", "unit"),
        [
            ("run,time", "unit of time"),
            ("run,time [h]", "h"),
            ("run,Time (days)", "days"),
            ("RUN,time[ s ]", "s"),
        ],
    )
    def test_the_unit_is_in_the_header(self, tmp_path, head, unit):
        assert self.read(tmp_path, f"{head}\na, 1.5\nb,-2\n") == ({"a": 1.5, "b": -2.0}, unit)

    def test_columns_may_be_in_any_order(self, tmp_path):
        assert self.read(tmp_path, "note,time,run\nx,1,a\n") == ({"a": 1.0}, "unit of time")

    def test_dates_are_in_days(self, tmp_path):
        found, unit = self.read(tmp_path, "run,time [h]\na,2024-05-17T12:00\nb,2024-05-18T18:00\n")
        assert (found["b"] - found["a"], unit) == (1.25, "day")

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "no columns run and time"), ("run,t\na,1\n", "no columns"), ("name,time\na,1\n", "no columns"),
            ("run,time\na\n", "line 2: a value is missing"), ("run,time\n\n\na,x\n", "line 4: 'x' is neither"),
            ("run,time\na,1\n\nb,inf\n", "line 4: the time is not finite"),
        ],
    )  # fmt: skip
    def test_errors_name_the_line_of_the_file(self, tmp_path, text, words):
        with pytest.raises(DatasetError, match=words):
            self.read(tmp_path, text)

    def test_runs_are_named_with_or_without_folder(self):
        fits = {"a": None, "/x/b": None}
        assert module._times_of(fits, {"folder/a.h5": 1.0, "/x/b": 2.0, "c": 3.0}) == {"a": 1.0, "/x/b": 2.0}
        assert module._times_of(fits, {"a": 0.0, "b.h5": 2.0}) == {"a": 0.0, "/x/b": 2.0}
        with pytest.raises(DatasetError, match="no run /x/b"):
            module._times_of(fits, {"a": 1.0})


class TestTable:
    def parameter(self, runs=2, spread=0.5, sigma=2.25):
        repeats = [SimpleNamespace(run=f"r{i}", value=2.0 + i, stderr=0.1) for i in range(runs)]
        return SimpleNamespace(
            name="k", unit="s", repeats=repeats, spread=spread, spread_interval=(0.2, 0.9), mean=2.5, mean_u=0.2,
            difference_sigma=sigma, p_value=0.03, total=lambda r: 0.51,
        )  # fmt: skip

    def lines(self, p, population=None):
        found = SimpleNamespace(
            parameters=[p], population=population, sentences=["It differs."], called=lambda key: f"the {key}"
        )
        return module.comparison_table(found).splitlines()

    def test_each_run_has_its_value_and_the_mean_its_spread(self):
        assert self.lines(self.parameter()) == [
            "the k: p 0.030, +2.2 sigma",
            "  r0    2.00 +- 0.10 s (with the spread +- 0.51)",
            "  r1    3.00 +- 0.10 s (with the spread +- 0.51)",
            "  mean  2.50 +- 0.20 s, spread 0.5 (0.2 to 0.9) s",
            "",
            "It differs.",
        ]
        lines = self.lines(self.parameter(spread=0.0, sigma=None))
        assert lines[0] == "the k: p 0.030"
        assert not any("with the spread" in x for x in lines)

    @pytest.mark.parametrize(("runs", "listed"), [(12, True), (13, False)])
    def test_more_than_twelve_runs_are_a_population(self, runs, listed):
        p = SimpleNamespace(
            name="k", unit="s", mean=2.0, mean_u=0.1, spread=0.3, spread_u=0.1, runs=runs, p_drift=0.2, p_step=0.001,
            p_adjusted=0.002,
        )  # fmt: skip
        population = SimpleNamespace(runs=range(runs), parameters=[p], called=lambda key: f"the {key}")
        lines = self.lines(self.parameter(runs), population)
        assert (lines[0] != f"{runs} runs") is listed
        if not listed:
            assert lines[1:4] == [
                "  the k", "    mean 2.00 +- 0.10 s, spread 0.30 +- 0.10 s, 13 runs",
                "    p of a drift 0.20, of a step 0.0010; smaller one adjusted 0.0020",
            ]  # fmt: skip


class TestCertify:
    def outcome(self, kind="null", effect="", number=0, score=1.0):
        return {"kind": kind, "effect": effect, "number": number, "score": score, "named": ["a"]}

    def test_names_of_recordings_have_three_parts(self):
        assert certify._item("truth:casing.windage:17") == ("truth", "casing.windage", 17)
        assert certify._item("rival:a:b:3") == ("rival", "a:b", 3)
        for text in ("truth:a:x", "truth:a:", "truth:a:-1", "truth"):
            with pytest.raises(UsageError, match="does not name"):
                certify._item(text)

    @pytest.mark.parametrize(("film", "sizes"), [(False, [4, 1]), (True, [1] * 5)])
    def test_missing_recordings_are_simulated_in_parts(self, monkeypatch, film, sizes):
        import fitting.discovery._certificate as of

        @dataclass(frozen=True)
        class Outcome:
            kind: str
            effect: str
            number: int
            score: float
            named: tuple

        @dataclass(frozen=True)
        class Empty:
            n: int
            film: bool
            outcomes: tuple = ()

        monkeypatch.setattr(of, "Outcome", Outcome)
        monkeypatch.setattr(of, "planned", lambda found, n: [("null", "", i) for i in range(n)])

        def answers(words):
            numbers = [int(w.rpartition(":")[2]) for w in words if w.startswith("--part")]
            return {"outcomes": [self.outcome(number=i, score=None if i == 4 else i) for i in numbers]}

        place, kept = Place(answers), []
        known = [Outcome("null", "", 1, 1.0, ("a",))]
        found = certify._by_commands(
            None, Empty(6, film), known, place, ["x"], lambda some, total: kept.append((len(some), total))
        )
        assert [sum(w.startswith("--part=null::") for w in words) for words in place.words] == sizes
        assert [o.number for o in found.outcomes] == list(range(6))
        assert [o.score for o in found.outcomes if o.number != 4] == [0, 1.0, 2, 3, 5]
        assert math.isnan(found.outcomes[4].score)
        assert found.outcomes[0].named == ("a",)
        assert kept[-1] == (6, 6)

    def test_an_error_of_a_command_ends_the_test(self, monkeypatch):
        import fitting.discovery._certificate as of

        monkeypatch.setattr(of, "planned", lambda found, n: [("null", "", 0)])
        place = Place(lambda words: {"error": {"message": "No.", "hint": "Wait."}})
        with pytest.raises(GyrotrackError, match="No"):
            certify._by_commands(None, SimpleNamespace(n=1, film=False), (), place, [], None)

    def test_coverage_is_in_percent(self):
        asked = []
        found = SimpleNamespace(
            sentence="It holds.", verdict="missing_effect", rows=[("drag", 20, "drag 19, none 1")],
            right_first=0.9, coverage=lambda kind: asked.append(kind) or {"k": 0.944}, in_words=lambda n: f"the {n}",
        )  # fmt: skip
        lines = certify._table(found, "f1").splitlines()
        assert "fit f1, verdict: missing effect" in lines
        assert lines[-1].split() == ["the", "k", "94", "%"]
        found.right_first, found.coverage = None, lambda kind: asked.append(kind) or {}
        assert certify._table(found, "f1").splitlines()[-1].strip() == "drag 19, none 1"
        assert asked == ["truth", "null"]


class TestSimulation:
    def run(self, monkeypatch, tmp_path, **options):
        calls = {}

        class Run:
            @property
            def numbers(self):
                return {"a.k": 2e-6}

            @classmethod
            def of(cls, model, strength, experiment, inertias, seed, values):
                calls.update(
                    model=model.names, strength=strength, experiment=experiment, inertias=inertias, seed=seed,
                    values=values,
                )  # fmt: skip
                return cls()

            def record(self, label):
                calls["label"] = label
                return Record()

        @dataclass(frozen=True)
        class Record:
            I_rotor_u: float = math.nan
            I_casing_u: float = math.nan

        import gyrotrack.apps._simulation as of

        monkeypatch.setattr(of, "SimulatedRun", Run)
        monkeypatch.setattr(
            of, "write_record", lambda path, record, **more: calls.update(path=path, record=record, **more)
        )
        monkeypatch.setattr(simulation.shared, "own_effects", lambda effects: [])
        shown = []
        out = SimpleNamespace(
            note=lambda text: calls.setdefault("note", text), progress=lambda what: _Progress(),
            result=lambda document: calls.setdefault("document", document), show=lambda *lines: shown.extend(lines),
        )  # fmt: skip
        simulation.simulate_command(output=tmp_path / "case.h5", out=out, **options)
        return calls, shown

    def test_defaults_are_those_of_the_paper(self, monkeypatch, tmp_path):
        calls, shown = self.run(monkeypatch, tmp_path)
        e = calls["experiment"]
        assert (e.omega_rotor, e.omega_casing, e.duration, e.windows) == (
            900.0,
            5.0,
            200.0,
            (5.0, 70.0, 150.0),
        )
        assert (e.casing_fps, e.rotor_fps, e.window_length, e.sigma) == (260.0, 1000.0, 3.0, 1e-3)
        assert calls["inertias"] == (5.54e-5, 2.06e-5)
        assert "those of the paper" in calls["note"]
        assert (calls["label"], calls["strength"], calls["seed"]) == ("case", 0.01, 0)
        assert calls["document"] == {
            "output": tmp_path / "case.h5", "model": list(calls["model"]), "parameters": {"a.k": 2e-6}, "films": [],
        }  # fmt: skip
        assert shown == [f"  {'a.k':<34}2e-06\nwritten: {tmp_path / 'case.h5'}"]

    def test_options_are_those_of_the_simulation(self, monkeypatch, tmp_path):
        calls, _ = self.run(
            monkeypatch, tmp_path, add=["casing.air.quadratic"], drop=["bearing.linear"], duration=100.0,
            window=[1.0, 9.0], label="x", surface="PVC", inertia_rotor="1e-4 +- 1e-6", inertia_casing="2e-5",
            seed=7, strength=0.3, set_values=["a=1"], force=True,
        )  # fmt: skip
        assert "casing.air.quadratic" in calls["model"]
        assert "bearing.linear" not in calls["model"]
        assert (calls["experiment"].windows, calls["label"], calls["surface"]) == ((1.0, 9.0), "x", "PVC")
        assert calls["inertias"] == (1e-4, 2e-5)
        assert (calls["record"].I_rotor_u, math.isnan(calls["record"].I_casing_u)) == (1e-6, True)
        assert (calls["seed"], calls["strength"], calls["values"], calls["force"]) == (7, 0.3, ["a=1"], True)
        assert "note" not in calls

    @pytest.mark.parametrize(
        ("answer", "named"),
        [(None, []), ("none", []), (" a ", ["a"]), ("a, b", ["a", "b"])],
    )
    def test_a_stated_answer_is_a_list(self, answer, named):
        assert simulation._stated(answer) == (named, {})

    @pytest.mark.parametrize(("case", "answer"), [(None, None), (Path("a.h5"), "b")])
    def test_a_seal_is_opened_with_exactly_one_answer(self, case, answer):
        with pytest.raises(UsageError, match="exactly one answer"):
            simulation.reveal_command(Path("x"), case, answer=answer, out=None)

    def test_steps_of_the_demonstration_are_summarised(self):
        document = {
            "frames": 600,
            "fps": 260.4,
            "body": {"casing": {"samples": 590, "median_sigma": 1.26e-3}},
        }
        assert (
            simulation._step_summary("extract", document)
            == "  600 frames at 260/s: casing 590 angles +- 1.3 mrad"
        )
        clips = [
            {"source": "/x/r1.mp4", "offset_s": 12.5, "offset_sigma_s": 0.1, "ambiguous": True},
            {"source": "/x/r2.mp4", "offset_s": 20.0, "offset_sigma_s": 0.1, "ambiguous": False},
        ]
        assert simulation._step_summary("sync", {"clips": clips}).splitlines() == [
            "  r1.mp4 starts at 12.50 +- 0.10 s (ambiguous)", "  r2.mp4 starts at 20.00 +- 0.10 s",
        ]  # fmt: skip
        assert simulation._step_summary("sync", {}) == ""

    def test_clips_are_in_a_folder_with_a_study(self, monkeypatch, tmp_path):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "own").mkdir()
        with pytest.raises(DatasetError, match="no sample clips in own"):
            simulation._find(Path("own"))
        (tmp_path / "own" / "study.toml").touch()
        assert simulation._find(Path("own")) == Path("own")
        monkeypatch.setattr("gyrotrack.apps._sample.sample_folder", lambda: tmp_path / "own")
        assert simulation._find(None) == tmp_path / "own"
        (tmp_path / "sample_clips").mkdir()
        (tmp_path / "sample_clips" / "study.toml").touch()
        assert simulation._find(None) == Path("sample_clips")


class _Progress:
    def __enter__(self):
        return lambda *_: None

    def __exit__(self, *_):
        pass


class TestData:
    def case(self, *speeds):
        return SimpleNamespace(
            motions=[
                (name, SimpleNamespace(time=np.arange(float(len(w))), omega=np.array(w, dtype=float)))
                for name, w in speeds
            ]
        )

    @pytest.mark.parametrize(
        ("column", "name"),
        [
            ("'voltage'", "voltage"),
            ("'Motor command voltage [V]'", "voltage"),
            ("'motor'", "u"),
            ("'12'", "u"),
        ],
    )
    def test_an_input_is_proposed_by_its_column(self, column, name):
        assert data._proposed_name(column) == name

    def test_columns_that_may_drive_the_motion_are_proposed(self):
        from gyrotrack.io.readers._motion_table import BY_NAME

        def column(quantity, why, unit):
            return {"column": "'voltage'", "quantity": quantity, "why": why, "unit": unit}

        columns = [column("input", BY_NAME, "V"), column("input", BY_NAME, ""), column("input", "asked", "V"),
                   column("angle", BY_NAME, "V")]  # fmt: skip
        found = data._proposals([{"file": "a.csv", "columns": columns}])
        assert [f.partition("record it: ")[2] for f in found] == [
            "--input 'voltage=voltage [V]'", "--input 'voltage=voltage'"
        ]  # fmt: skip

    @pytest.mark.parametrize(("count", "step"), [(399, 1), (400, 2), (1000, 5), (5, 1)])
    def test_a_plot_has_about_two_hundred_points(self, count, step):
        (found,) = data._plotted(self.case(("casing", [np.nan, *np.arange(count)])))
        assert found["omega"] == list(range(0, count, step))
        assert found["time"] == [x + 1 for x in found["omega"]]
        assert found["body"] == "casing"

    def test_a_body_without_speeds_is_not_plotted(self):
        case = self.case(("casing", [np.nan] * 3), ("rotor", [1.0, -2.0, np.nan]))
        assert [p["body"] for p in data._plotted(case)] == ["rotor"]
        (line,) = data._plots(case)
        assert line.startswith("speed of the rotor, -2 to 1 rad/s: ")

    def test_windows_are_numbered_where_there_are_several(self):
        def windows(count):
            return {"windows": [{"window": i + 1} for i in range(count)]}

        found = data._windows({"rotor": windows(1), "further": {"drum": windows(1), "belt": windows(2)}})
        assert [name for name, _ in found] == ["rotor 1", "drum", "belt 1", "belt 2"]
