"""Rows, states and lines of the summary of a batch, and the exit code of its command, from outcomes of known state."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from gyrotrack import UsageError
from gyrotrack.apps.batch import _runner as module
from gyrotrack.apps.batch._experiments import Experiment
from gyrotrack.apps.batch._runner import Row, lines, summarise, write_summary
from gyrotrack.apps.batch._steps import Outcome
from gyrotrack.apps.cli import _batch as command
from gyrotrack.apps.cli._output import DONE, FAULT, NOT_TRUSTED

FIT = {"verdict": "lack_of_fit", "misfit": 1.5, "cases": [{"casing": {"rmse": 0.2, "reduced_chi2": 2.5}}]}
FOUND = {
    "verdict": "missing_effect",
    "candidates": [{"effect": "drag", "indistinguishable_from": ["seal"]}, {"effect": "x"}],
}


def outcome(state="done", document=None, *, trusted=True, seconds=1.0):
    return Outcome(state, document or {}, "print" if state in {"done", "kept"} else "", seconds, trusted)


def film(state="done", frames=100, **more):
    return outcome(state, {"frames": frames, "warnings": ["w"], **more})


def row(**outcomes):
    names = {"a": "extract a", "b": "extract b"}
    return module._row(Experiment("case", ()), {names.get(k, k): v for k, v in outcomes.items()})


class TestRow:
    def test_a_whole_case_is_done(self):
        r = row(a=film(), b=film(frames=50), fit=outcome(document=FIT), diagnose=outcome(document=FOUND))
        assert (r.state, r.films, r.tracked, r.frames, r.warnings, r.seconds) == ("done", 2, 2, 150, 2, 4.0)
        assert (r.fit, r.rmse_casing, r.reduced_chi2, r.misfit) == ("lack_of_fit", 0.2, 2.5, 1.5)
        assert (r.diagnosis, r.missing, r.trusted, r.problem) == ("missing_effect", "drag or seal", True, "")

    @pytest.mark.parametrize(
        ("outcomes", "state"),
        [
            ({"a": film(), "b": film("failed")}, "partly"),
            ({"a": film("failed"), "b": film("failed")}, "failed"),
            ({"a": film(), "fit": outcome("failed")}, "failed"),
            ({"a": film(), "fit": outcome("blocked")}, "failed"),
            ({"a": film(), "fit": outcome(document=FIT), "report": outcome("failed")}, "partly"),
            ({"a": film("kept")}, "done"),
            ({}, "done"),
        ],
    )
    def test_states_follow_from_the_steps(self, outcomes, state):
        assert row(**outcomes).state == state

    def test_the_first_failure_is_the_problem(self):
        error = {"error": {"message": "no film"}}
        r = row(a=film(), b=outcome("failed", error), fit=outcome("failed"))
        assert r.problem == "extract b: no film"
        assert row(fit=outcome("failed")).problem == "fit: it failed"
        assert (r.fit, r.rmse_casing, r.tracked, r.films) == ("", None, 1, 2)

    def test_one_step_that_is_not_trusted_counts(self):
        assert not row(a=film(), fit=outcome(document=FIT, trusted=False)).trusted

    @pytest.mark.parametrize(
        ("diagnosis", "improved", "missing"),
        [
            ({"verdict": "undecided"}, outcome(document={"ladder": [{"added": ""}, {"added": "+a"}]}), ""),
            (FOUND, outcome(document={"ladder": [{"added": ""}, {"added": "+a"}, {"added": "+b"}]}), "+a +b"),
            (FOUND, outcome("failed"), "drag or seal"),
            (FOUND, None, "drag or seal"),
            ({"verdict": "unexplained", "candidates": FOUND["candidates"]}, None, ""),
            ({"verdict": "missing_effect"}, None, ""),
            ({}, None, ""),
        ],
    )
    def test_missing_effects_are_those_that_were_found(self, diagnosis, improved, missing):
        assert module._missing(diagnosis, improved) == missing

    def test_each_case_has_its_own_steps(self):
        cases = [Experiment(x, (), folder=x) for x in "ab"]
        steps = [SimpleNamespace(name=n, folder=n[0]) for n in ("a/extract 1", "b/extract 1", "b/fit")]
        ended = {"a/extract 1": film(), "b/extract 1": film("failed")}
        rows = summarise(cases, steps, ended)
        assert [(r.label, r.state, r.films) for r in rows] == [("a", "done", 1), ("b", "failed", 1)]


class TestAnswers:
    @pytest.mark.parametrize(
        ("code", "error", "found"),
        [
            (0, None, None), (3, None, None), (1, None, "bug"), (0, "text", "bug"), (1, {"code": "usage"}, "usage"),
            (0, {"code": "usage"}, "usage"),
        ],
    )  # fmt: skip
    def test_an_invalid_answer_is_an_internal_error(self, code, error, found):
        document = {} if error is None else {"error": error}
        assert module._error({"code": code, "document": document}).get("code") == found

    def test_a_lost_worker_is_a_crash(self):
        def lost():
            raise OSError("gone")

        assert module._answer(SimpleNamespace(result=lost))["document"]["error"]["code"] == "crash"
        assert module._answer(SimpleNamespace(result=lambda: 7)) == 7


class TestSummary:
    def rows(self):
        return [
            row(a=film(), fit=outcome(document=FIT), diagnose=outcome(document=FOUND)), row(a=film("failed")),
            row(a=film()),
        ]  # fmt: skip

    def test_lines_have_the_verdict_or_the_state(self):
        found = lines(self.rows())
        assert found[1].split() == ["case", "1/1", "100", "lack_of_fit", "0.2", "1.5", "drag", "or", "seal"]
        assert found[2].split() == ["case", "0/1", "0", "failed", "-", "-"]
        assert found[3].split() == ["case", "1/1", "100", "-", "-", "-"]
        assert found[4:] == ["", "failures:", "  case: extract a: it failed"]
        assert lines(self.rows()[:1])[-1] == found[1]

    @pytest.mark.parametrize(("count", "shown"), [(19, "x" * 19), (20, "..." + "x" * 16)])
    def test_long_names_are_shortened(self, count, shown):
        r = module._row(Experiment("x" * count, ()), {})
        assert lines([r])[1].split()[0] == shown

    def test_missing_numbers_are_empty_cells(self, tmp_path):
        csv, document = write_summary(tmp_path, self.rows(), {"command": "batch", "seconds": 2.0})
        head, first, second, _ = csv.read_text().splitlines()
        assert head.split(",") == list(Row.__dataclass_fields__)
        assert "0.2,2.5,1.5" in first
        assert ",,," in second
        read = json.loads(document.read_text())
        assert (read["command"], len(read["cases"]), read["cases"][1]["misfit"]) == ("batch", 3, None)


class Out:
    def __init__(self):
        self.results, self.shown, self.noted, self.detailed, self.warned = [], [], [], [], []

    def result(self, document):
        self.results.append(document)

    def show(self, *texts):
        self.shown += texts

    def note(self, text):
        self.noted.append(text)

    def detail(self, text):
        self.detailed.append(text)


class TestCommand:
    @pytest.mark.parametrize(
        ("states", "trusted", "code"),
        [(("done", "done"), (True, True), DONE), (("done", "done"), (True, False), NOT_TRUSTED),
         (("done", "partly"), (True, True), FAULT), (("failed", "done"), (False, True), FAULT)],
    )  # fmt: skip
    def test_one_case_sets_the_exit_code(self, monkeypatch, states, trusted, code):
        monkeypatch.setattr(module, "lines", lambda rows: ["lines"])
        rows = [SimpleNamespace(state=s, trusted=t) for s, t in zip(states, trusted, strict=True)]
        ended = module.BatchResult(
            rows, {"done": 3, "kept": 0, "failed": 1, "blocked": 0}, 2.4, [Path("s.csv")]
        )
        out = Out()
        assert command._show_result(out, ended, Path("results"), "called") == code
        assert out.shown == ["lines\n\n3 done, 1 failed of 4 steps, 2 s", "written: s.csv"]

    def test_failures_are_notes_and_durations_are_details(self):
        out, step = Out(), SimpleNamespace(name="a/fit")
        for o in (
            outcome("failed", {"error": {"message": "No."}}),
            outcome(),
            outcome("kept"),
            outcome("blocked"),
        ):
            command._report_step(out, step, o)
        assert (out.noted, out.detailed) == (["failed: a/fit: No."], ["a/fit: 1.0 s"])

    def test_a_plan_counts_what_is_kept(self, monkeypatch):
        monkeypatch.setattr(module, "preview", lambda steps, output: {"a": "kept", "b": "to do"})
        steps = tuple(SimpleNamespace(name=n, output=Path(n)) for n in "ab")
        out = Out()
        assert command._show_plan(out, (Experiment("x", ()),), steps, Path("o")) == DONE
        assert out.shown == ["kept   a\nto do  b\n\n1 cases, 2 steps, 1 kept; nothing was run"]
        assert out.results[0]["steps"][1] == {"name": "b", "output": Path("b"), "state": "to do"}

    @pytest.mark.parametrize(
        ("value", "text"),
        [(None, '""'), (True, "true"), (1.5, "1.5"), (3, "3"), ("a", '"a"'),
         ('b"\\', '"b\\"\\\\"'), ([1, "a"], '[1, "a"]'),
         (Path("x"), '"x"')],
    )  # fmt: skip
    def test_settings_are_toml(self, value, text):
        assert command._toml(value) == text

    @pytest.mark.parametrize(
        ("tracking", "fitting", "more", "kind"),
        [(True, False, {"name": "fit"}, "--tracking"), (False, True, {"everything": True}, "--fitting"),
         (True, True, {"name": "fit"}, "--tracking")],
    )  # fmt: skip
    def test_numbers_of_the_program_have_no_options(self, tracking, fitting, more, kind):
        with pytest.raises(UsageError, match=f"{kind} shows no options"):
            command.config_command(**({"name": None} | more), tracking=tracking, fitting=fitting, out=Out())

    @pytest.mark.parametrize(("tracking", "fitting"), [(True, False), (False, True), (True, True)])
    def test_numbers_of_the_program_are_shown_on_request(self, monkeypatch, tracking, fitting):
        for name in ("fitting._settings.fitting_settings", "gyrotrack._tracking_settings.tracking_settings"):
            monkeypatch.setattr(name, lambda name=name: SimpleNamespace(to_json=lambda: name))
        out = Out()
        command.config_command(None, tracking=tracking, fitting=fitting, out=out)
        assert list(out.results[0]) == ["tracking"] * tracking + ["fitting"] * fitting

    @pytest.mark.parametrize(
        ("name", "everything", "options"), [(None, False, {}), ("fit", False, {"fit"}), (None, True, None)]
    )
    def test_options_of_one_command_or_all(self, monkeypatch, name, everything, options):
        import gyrotrack.apps.cli._app as app

        settings = SimpleNamespace(
            path=Path("g.toml"), values={"fit": {"joint": True}}, lines={("fit", "joint"): 7}
        )
        monkeypatch.setattr(app, "settings_in_use", lambda: settings)
        out = Out()
        command.config_command(name, everything=everything, out=out)
        found = out.results[0]["settings"]
        assert found["fit"]["joint"] == {"value": True, "from": "file", "line": 7}
        assert f"{'joint = true':<40} # g.toml, line 7" in out.shown[0].splitlines()
        if name is None and not everything:
            assert found == {"fit": {"joint": {"value": True, "from": "file", "line": 7}}}
        else:
            assert found["fit"]["loss"] == {"value": "linear", "from": "default"}
        if options is None:
            assert {"fit", "extract", "batch"} <= set(found)
            assert found["extract"]["times"]["value"] == "auto"
        with pytest.raises(UsageError, match="no command 'x'"):
            command.config_command("x", out=Out())

    @pytest.mark.parametrize(
        ("printed", "document"),
        [('{"a": 1}', {"a": 1}), ("", {}), ("text", None)],
    )
    def test_a_command_that_prints_no_document_is_an_internal_error(self, monkeypatch, printed, document):
        import gyrotrack.apps.cli._app as app

        called = []
        monkeypatch.setattr(app, "run", lambda words: called.append(words) or print(printed, end="") or 3)  # noqa: T201
        answer = command.perform(["fit", "a.h5"])
        assert called == [["fit", "--json", "-q", "a.h5"]]
        assert answer["code"] == 3
        if document is None:
            assert answer["document"]["error"]["code"] == "bug"
        else:
            assert answer["document"] == document
