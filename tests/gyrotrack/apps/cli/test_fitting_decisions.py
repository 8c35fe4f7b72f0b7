"""Requests, exit codes and documents of the commands for fits, with fits of known verdict."""

from contextlib import contextmanager, nullcontext
from types import SimpleNamespace

import pytest

from gyrotrack import UsageError
from gyrotrack.apps.cli import _fitting as module
from gyrotrack.apps.cli._fitting import (
    budget_command,
    diagnose_command,
    duration,
    effects_command,
    fit_command,
    improve_command,
    scan_command,
)
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED


class Out:
    """What a command prints."""

    def __init__(self):
        self.results, self.shown, self.warned, self.counted = [], [], [], []

    @contextmanager
    def progress(self, what):
        yield lambda *done: self.counted.append((what, *done))

    def result(self, document):
        self.results.append(document)

    def show(self, *lines):
        self.shown += lines

    def warn(self, line):
        self.warned.append(line)

    note = detail = show


class TestFit:
    def run(self, monkeypatch, cases, verdicts=(), **options):
        """Fit stubs with these verdicts in turn; returns the exit code, the output, and the calls."""
        calls = {"open": [], "request": [], "intervals": [], "predicted": []}
        remaining = list(verdicts) or ["adequate"] * len(cases)

        def opened(group, ledger, **more):
            calls["open"].append((list(group), ledger, more))
            return SimpleNamespace(mechanism="mechanism")

        def fitted(request, study, start):
            calls["request"].append((request, start))
            return remaining.pop(0), f"f{len(calls['request'])}"

        def intervals(found, wanted):
            calls["intervals"].append(tuple(wanted))
            return "intervals"

        def predicted(found):
            calls["predicted"].append(found)
            return "predicted"

        monkeypatch.setattr(module, "open_study", opened)
        monkeypatch.setattr(module.FitRequest, "fit", fitted)
        monkeypatch.setattr(module.shared, "own_effects", lambda effects, mechanism: (effects, mechanism))
        monkeypatch.setattr(module, "_intervals", intervals)
        monkeypatch.setattr(module, "_predicted", predicted)
        monkeypatch.setattr(module, "_note_unused_inputs", lambda found, out: None)
        monkeypatch.setattr("fitting.study._preparation.curve_bias", lambda found: "bias")
        monkeypatch.setattr(
            "fitting.study._serialisation.fit_document",
            lambda found, fit_id, i, bias, ahead: {"verdict": found, "id": fit_id, "rest": (i, bias, ahead)},
        )
        for name in ("fit_tables", "bias_tables", "prediction_tables"):
            monkeypatch.setattr(module, name, lambda *args, name=name: [(name, *args)])
        out = Out()
        return fit_command(cases, out=out, **options), out, calls

    @pytest.mark.parametrize(
        ("verdicts", "code"),
        [
            (["adequate", "no_lack_of_fit"], DONE),
            (["not_converged", "adequate"], NOT_TRUSTED),
            (["adequate", "not_converged"], NOT_TRUSTED),
            (["not_converged", "not_converged"], NOT_TRUSTED),
        ],
    )
    def test_one_fit_that_did_not_converge_sets_the_exit_code(self, monkeypatch, verdicts, code):
        found, out, calls = self.run(monkeypatch, ["a", "b"], verdicts)
        assert found == code
        assert [c[0] for c in calls["open"]] == [["a"], ["b"]]
        (document,) = out.results
        assert [(d["id"], d["verdict"]) for d in document["fits"]] == [
            (f"f{i + 1}", v) for i, v in enumerate(verdicts)
        ]

    def test_a_joint_fit_is_one_document(self, monkeypatch):
        code, out, calls = self.run(monkeypatch, ["a", "b"], ["adequate"], joint=True, share=["k"])
        assert code == DONE
        assert [c[0] for c in calls["open"]] == [["a", "b"]]
        assert out.results == [{"verdict": "adequate", "id": "f1", "rest": ("intervals", "bias", None)}]

    def test_options_are_the_request(self, monkeypatch):
        _, _, calls = self.run(
            monkeypatch, ["a"], model="general", add=["x"], drop=["y"], share=["s"], per_case=["p"], joint=True,
            fix=["g=0.5"], loss="huber", effects="file", start="f7", ledger="book", data="angle",
            rotor="generated", prior="old", prior_rotor="other", profile=["weak"],
        )  # fmt: skip
        ((request, start),) = calls["request"]
        assert (request.model, request.add, request.drop, request.share, request.per_case) == (
            "general", ("x",), ("y",), ("s",), ("p",),
        )  # fmt: skip
        assert (request.held, request.loss, request.own, start) == (
            {"g": 0.5}, "huber", ("file", "mechanism"), "f7"
        )  # fmt: skip
        assert calls["open"] == [
            (["a"], "book", {"data": "angle", "rotor": "generated", "prior": "old", "prior_rotor": "other"})
        ]
        assert calls["intervals"] == [("weak",)]

    @pytest.mark.parametrize("held_out", [True, False])
    def test_recordings_are_predicted_on_request(self, monkeypatch, held_out):
        _, out, calls = self.run(monkeypatch, ["a", "b"], ["adequate"], joint=True, hold_out=held_out)
        assert calls["predicted"] == (["adequate"] if held_out else [])
        assert out.results[0]["rest"][2] == ("predicted" if held_out else None)
        assert out.shown[-1] == ("prediction_tables", "predicted" if held_out else ())

    @pytest.mark.parametrize("options", [{"share": ["k"]}, {"per_case": ["k"]}, {"hold_out": True}])
    def test_values_of_several_cases_need_a_joint_fit(self, monkeypatch, options):
        with pytest.raises(UsageError, match="joint fit"):
            self.run(monkeypatch, ["a"], **options)
        self.run(monkeypatch, ["a"], joint=True, **options)

    @pytest.mark.parametrize(
        ("loss", "known"), [("linear", True), ("huber", True), ("cauchy", True), ("l1", False)]
    )
    def test_loss_functions(self, monkeypatch, loss, known):
        if known:
            assert self.run(monkeypatch, ["a"], loss=loss)[2]["request"][0][0].loss == loss
        else:
            with pytest.raises(UsageError, match="Unknown loss"):
                self.run(monkeypatch, ["a"], loss=loss)


@pytest.mark.parametrize(
    ("wanted", "profiled"),
    [
        (["b1"], ["touchpoint.constant.b1@x", "touchpoint.constant.b1@y"]),
        (["touchpoint.constant.b1"], ["touchpoint.constant.b1@x", "touchpoint.constant.b1@y"]),
        (["touchpoint.constant.b1@y"], ["touchpoint.constant.b1@y"]),
        (["d", "d", "bearing.linear.d"], ["bearing.linear.d"]),
        (["weak", "d"], ["weakest", "bearing.linear.d"]),
        (["unknown"], ["unknown"]),
    ],
)
def test_words_select_all_parameters_that_match(monkeypatch, wanted, profiled):
    names = ["touchpoint.constant.b1@x", "touchpoint.constant.b1@y", "bearing.linear.d"]
    found = SimpleNamespace(problem=SimpleNamespace(layout=SimpleNamespace(names=names)))
    monkeypatch.setattr("fitting.inference._profile.profile", lambda found, name: f"of {name}")
    monkeypatch.setattr("fitting.inference._profile.weakly_determined", lambda found: ["weakest"])
    assert module._intervals(found, wanted) == {k: f"of {k}" for k in profiled}


def test_fixed_values_are_assignments():
    assert module._fixed_values(["a.g=0.7", " b = -2e-6 "]) == {"a.g": 0.7, "b": -2e-6}
    for text in ("a", "a=", "a=x", "=x"):
        with pytest.raises(UsageError, match="not an assignment"):
            module._fixed_values(["b=1", text])


class TestBudget:
    def run(self, monkeypatch, **options):
        calls = []
        monkeypatch.setattr(
            module, "open_study", lambda *_: SimpleNamespace(base=lambda start: ("fit", f"from {start}"))
        )
        monkeypatch.setattr(
            "fitting.inference._budget.budget", lambda fit, **more: calls.append((fit, more)) or "found"
        )
        monkeypatch.setattr(module, "_budget_table", lambda *args: args)
        out = Out()
        budget_command(["a"], out=out, **options)
        assert out.results == [{"fit_id": f"from {options.get('start')}", "parameters": "found"}]
        return calls[0]

    def test_a_quartz_clock_is_assumed(self, monkeypatch):
        assert self.run(monkeypatch) == (
            "fit",
            {"clock_rate_u": pytest.approx(2.9e-5, rel=0.01), "speed_scale_u": 0},
        )
        assert self.run(monkeypatch, clock_rate=0.0, speed_scale=0.01, start="f2") == (
            "fit", {"clock_rate_u": 0.0, "speed_scale_u": 0.01}
        )  # fmt: skip

    @pytest.mark.parametrize("name", ["clock_rate", "speed_scale"])
    @pytest.mark.parametrize(("u", "refused"), [(0.0, False), (0.999, False), (1.0, True), (-1e-9, True)])
    def test_relative_uncertainties_are_between_zero_and_one(self, monkeypatch, name, u, refused):
        if refused:
            with pytest.raises(UsageError, match="not between 0 and 1"):
                self.run(monkeypatch, **{name: u})
        else:
            assert self.run(monkeypatch, **{name: u})[1][f"{name}_u"] == u

    def test_shares_below_a_thousandth_are_not_in_the_table(self):
        def part(source, share, slope=None):
            return SimpleNamespace(source=source, type="B", u=1e-9, sensitivity=slope, share=share)

        found = {
            "d": SimpleNamespace(
                value=2e-7, u=1e-9, unit="N m s",
                contributions=[part("clock", 0.0011, -3.5), part("angle", 0.9), part("scale", 0.0009)],
            )
        }  # fmt: skip
        fit = SimpleNamespace(
            name=lambda key: SimpleNamespace(key=key, words="drag", symbol="d"), estimates={}
        )
        lines = module._budget_table(fit, found, "f3").splitlines()
        assert lines[0] == "uncertainty budget of fit f3 (combined standard uncertainties)"
        rows = [line.split() for line in lines if "B" in line.split()]
        assert rows == [["clock", "B", "1e-09", "-3.5", "0.1", "%"], ["angle", "B", "1e-09", "90.0", "%"]]


@pytest.mark.parametrize(("converged", "code"), [(True, DONE), (False, NOT_TRUSTED)])
def test_a_scan_that_did_not_converge_sets_the_exit_code(monkeypatch, tmp_path, converged, code):
    reads = []
    found = SimpleNamespace(converged=converged)
    monkeypatch.setattr(module, "with_ledgers", list)
    monkeypatch.setattr(
        module, "read_cases",
        lambda cases, **more: reads.append(more)
        or [SimpleNamespace(record=SimpleNamespace(quantity="angle"))],
    )  # fmt: skip
    monkeypatch.setattr("fitting.paper._scan.scan", lambda cases, progress: found)
    monkeypatch.setattr("fitting.paper._tables.scan_document", lambda scan: {"tables": 1})
    monkeypatch.setattr("fitting.paper._tables.scan_lines", lambda scan: ["lines"])
    monkeypatch.setattr("fitting.paper._tables.scan_csv", lambda scan: "µ csv")
    monkeypatch.setattr("fitting.paper._tables.scan_latex", lambda scan: "latex")
    out = Out()
    csv, latex = tmp_path / "a.csv", tmp_path / "a.tex"
    assert scan_command([tmp_path / "case.h5"], csv=csv, latex=latex, out=out) == code
    assert (csv.read_bytes(), latex.read_bytes()) == ("µ csv".encode(), b"latex")
    assert out.results == [{"tables": 1, "data": "angle", "rotor": "windows", "outputs": [csv, latex]}]
    assert out.shown == ["lines", f"written: {csv}", f"written: {latex}"]
    out = Out()
    assert scan_command([tmp_path / "case.h5"], data="velocity", latex=tmp_path / "b.tex", out=out) == code
    assert (out.results[0]["data"], out.results[0]["outputs"]) == ("velocity", [tmp_path / "b.tex"])
    assert reads == [{"data": None, "rotor": "windows"}, {"data": "velocity", "rotor": "windows"}]


class TestImprove:
    def run(self, monkeypatch, verdict, steps=1, *, of_history="missing_effect", stopped="", own=()):
        def fit(number):
            per_case = ["a@x", *own] if number else ["a@x"]
            return SimpleNamespace(
                problem=SimpleNamespace(layout=SimpleNamespace(per_case=per_case)), number=number
            )

        class History(list):
            pass

        history = History(SimpleNamespace(fit=fit(i), candidates=f"ranking {i}") for i in range(steps))
        history.stopped = stopped
        entries = [SimpleNamespace(document={"rung": i}, fit_id=f"f{i}") for i in range(steps)]
        kept, asked = [], []
        study = SimpleNamespace(
            base=lambda start: (history[0].fit, "f0"), mechanism="m",
            recorder=lambda *_: SimpleNamespace(entries=entries),
            keep_diagnosis=lambda *args: kept.append(args), data=[SimpleNamespace(record="record")],
        )  # fmt: skip
        found = SimpleNamespace(verdict=verdict)
        monkeypatch.setattr(module, "open_study", lambda *_, **__: study)
        monkeypatch.setattr(module.shared, "own_effects", lambda *_: "own")
        monkeypatch.setattr("fitting.discovery._select.improve", lambda *_, **__: history)
        monkeypatch.setattr(
            "fitting.discovery._verdict.diagnose",
            lambda base, own, *, candidates, workers: asked.append((base.number, own, candidates)) or found,
        )
        monkeypatch.setattr("fitting.study._serialisation.history_verdict", lambda h: of_history)
        monkeypatch.setattr(
            "fitting.study._serialisation.fit_document", lambda fit, fit_id: (fit.number, fit_id)
        )
        monkeypatch.setattr(module, "ladder_tables", lambda steps, record: [(steps, record)])
        monkeypatch.setattr("fitting._workers.WorkerPool", nullcontext)
        out = Out()
        improve_command(["a"], out=out)
        assert asked == [(0, "own", "ranking 0")]
        assert kept == [("f0", found, "own")]
        (document,) = out.results
        assert document["ladder"] == list(range(steps))
        assert document["final"] == (steps - 1, f"f{steps - 1}")
        return document["verdict"], out.shown[-1], out.warned

    @pytest.mark.parametrize(
        ("verdict", "steps", "of_history", "found", "words"),
        [
            ("adequate", 1, "x", "adequate", "adequate; no effect was added"),
            ("missing_effect", 1, "x", "missing_effect", "a fault of the measurement; no effect was added"),
            ("missing_effect", 2, "missing_effect", "missing_effect", "the missing effect was added"),
            ("missing_effect", 2, "unexplained", "unexplained", "an unexplained torque remains"),
            ("undecided", 2, "missing_effect", "undecided", "nothing is established"),
        ],
    )
    def test_the_verdict_is_that_of_the_history(self, monkeypatch, verdict, steps, of_history, found, words):
        got, line, warned = self.run(monkeypatch, verdict, steps, of_history=of_history)
        assert got == found
        assert words in line
        assert warned == []

    def test_values_of_recordings_and_the_stop_are_stated(self, monkeypatch):
        _, line, warned = self.run(monkeypatch, "missing_effect", 2, stopped="no solution", own=["b", "c"])
        assert line.endswith("; b and c has a value for each recording")
        assert warned == ["the search stopped: no solution"]


def test_a_diagnosis_is_shown_stored_and_priced(monkeypatch):
    """Two seconds of processor time for one diagnosis, of which a certificate makes seven."""
    refit = SimpleNamespace(sentence=lambda names: f"a fit with {names[0]}")
    found = SimpleNamespace(
        trace=[refit], fit=SimpleNamespace(model=SimpleNamespace(names=["touchpoint.constant"]))
    )
    kept, asked = [], []
    study = SimpleNamespace(
        base=lambda start: (f"base of {start}", "f3"), mechanism="bodies",
        keep_diagnosis=lambda *args: kept.append(args),
    )  # fmt: skip
    clock = iter([10.0, 12.0])
    monkeypatch.setattr(module, "process_time", lambda: next(clock))
    monkeypatch.setattr(module, "open_study", lambda *_, **__: study)
    monkeypatch.setattr(module.shared, "own_effects", lambda *args, friction: [(args, friction)])
    monkeypatch.setattr(
        "fitting.discovery._verdict.diagnose",
        lambda base, own, *, workers: asked.append((base, own)) or found,
    )
    monkeypatch.setattr("fitting.discovery._certificate.planned", lambda *_: range(7))
    monkeypatch.setattr("fitting.study._serialisation.diagnosis_document", lambda d, fit_id: {"of": fit_id})
    monkeypatch.setattr(module, "diagnosis_tables", lambda d, fit_id: [f"table of {fit_id}"])
    monkeypatch.setattr("fitting._workers.WorkerPool", nullcontext)
    out = Out()
    diagnose_command(["a.h5", "b.h5"], friction=True, start="f2", out=out)
    own = [((None, "bodies"), True)]
    assert asked == [("base of f2", own)]
    assert kept == [("f3", found, own)]
    assert out.results == [{"of": "f3"}]
    assert out.shown[:2] == ["table of f3", "a fit with touchpoint.constant"]
    assert out.shown[2].startswith("`gyrotrack certify a.h5 b.h5` tests this answer")
    assert f"about {duration(14.0)})" in out.shown[2]


def test_one_effect_is_shown_in_full(monkeypatch):
    monkeypatch.setattr(module.shared, "own_effects", lambda effects: [])
    out = Out()
    effects_command("casing.air.quadratic", effects=None, out=out)
    assert out.results[0]["name"] == "casing.air.quadratic"
    lines = out.shown[0].splitlines()
    assert lines[0] == "casing.air.quadratic (physical)"
    assert any(line.startswith("  similar to: ") for line in lines)
    assert max(map(len, lines)) <= 100
    out = Out()
    effects_command(None, effects=None, out=out)
    names = [e["name"] for e in out.results[0]["effects"]]
    assert "casing.air.quadratic" in names
    assert len(names) == len(set(names)) == out.shown[0].count("\n") // 2 + 1


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        ("factor", "bearing, factor"),
        ("inertia", "casing, factor"),
        ("camera.casing", "casing camera"),
        ("camera.rotor", "rotor camera"),
        ("touchpoint", "touchpoint"),
    ],
)
def test_where_an_effect_acts(joint, words):
    assert module._where(SimpleNamespace(joint=joint)) == words
