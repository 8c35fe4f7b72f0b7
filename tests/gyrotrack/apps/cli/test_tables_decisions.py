"""Rows, marks and sentences of the tables of diagnoses, histories, laws and plans, from results of known values."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Estimate
from gyrotrack import UsageError
from gyrotrack.apps.cli import _discovery as discovery
from gyrotrack.apps.cli import _output as module
from gyrotrack.apps.cli import _parameters as parameters
from gyrotrack.apps.cli._output import Output, bias_tables, diagnosis_tables, ladder_tables, prediction_tables


def name(effect):
    key = getattr(effect, "name", effect)
    return SimpleNamespace(words=f"the {key}", key=key)


def fit(**more):
    record = SimpleNamespace(body="platter", torque_unit="N m")
    parts = {
        "torque_unit": "N m", "name": name, "labels": ("a",), "estimates": {},
        "problem": SimpleNamespace(data=[SimpleNamespace(record=record)]),
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.2, "1 s"),
        (89.4, "89 s"),
        (90.0, "2 min"),
        (5399.0, "90 min"),
        (5400.0, "1.5 h"),
        (36000.0, "10.0 h"),
    ],
)
def test_durations_are_rounded(seconds, text):
    assert module.duration(seconds) == text


class TestProgress:
    def lines(self, monkeypatch, capsys, calls):
        now = iter(t for t, *_ in calls)
        monkeypatch.setattr(module, "monotonic", lambda: next(now))
        update = module._json_lines("fitting")
        for _, *done in calls:
            update(*done)
        return [line.split('"done": ')[1].split(",")[0] for line in capsys.readouterr().err.splitlines()]

    def test_five_lines_a_second_and_the_last_one(self, monkeypatch, capsys):
        calls = [(0.0, 1, 9), (0.19, 2, 9), (0.2, 3, 9), (0.3, 4, 9), (0.41, 5, 9), (0.42, 9, 9)]
        assert self.lines(monkeypatch, capsys, calls) == ["1", "3", "5", "9"]

    @pytest.mark.parametrize(("count", "sizes"), [(64, [64]), (65, [64, 1]), (130, [64, 64, 2]), (0, [])])
    def test_lines_of_angles_are_short(self, capsys, count, sizes):
        import json

        module.write_angles("rotor", 2, np.arange(count), np.arange(count) * 1.0000012)
        found = [json.loads(line)["angles"] for line in capsys.readouterr().err.splitlines()]
        assert [len(f["frame"]) for f in found] == sizes
        assert [x for f in found for x in f["frame"]] == list(range(count))
        assert [x for f in found for x in f["angle"]] == [round(i * 1.0000012, 5) for i in range(count)]
        assert {(f["body"], f["part"]) for f in found} <= {("rotor", 2)}


@pytest.mark.parametrize(
    ("quiet", "verbose", "said"),
    [(False, False, ["note", "warning: w"]), (False, True, ["note", "detail", "warning: w"]),
     (True, False, ["warning: w"]), (True, True, ["warning: w"])],
)  # fmt: skip
def test_warnings_are_printed_always_and_details_on_request(capsys, quiet, verbose, said):
    out = Output(quiet=quiet, verbose=verbose)
    out.note("note")
    out.detail("detail")
    out.warn("w")
    assert capsys.readouterr().err.splitlines() == said


@pytest.mark.parametrize("as_json", [True, False])
def test_a_result_is_either_text_or_a_document(capsys, as_json):
    out = Output(as_json=as_json)
    with module.running(["fit"]):
        out.show("text")
        out.result({"a": math.nan, "b": np.array([1.0, math.inf])})
        assert module.command_line() == "gyrotrack fit"
    shown = capsys.readouterr().out
    assert shown == ('{\n  "a": null,\n  "b": [\n    1.0,\n    null\n  ]\n}\n' if as_json else "text\n")


@pytest.mark.parametrize("as_json", [True, False])
def test_an_error_is_a_document_or_two_lines(capsys, as_json):
    module.report_error("usage", "It fails.", "Repeat.", as_json=as_json)
    out, err = capsys.readouterr()
    assert ('"code": "usage"' in out) is as_json
    assert err == ("" if as_json else "error: It fails.\n hint: Repeat.\n")
    module.report_error("usage", "It fails.", "", as_json=False)
    assert capsys.readouterr().err == "error: It fails.\n"


def test_the_bias_of_a_generated_curve_is_in_standard_errors():
    found = fit(estimates={"d": Estimate(2.0, 0.1, "N m s", at_bound=False)})
    bias = {"d": SimpleNamespace(measured=3.0, stderr=0.1, errors=9.6)}
    (text,) = bias_tables(found, bias)
    assert text.splitlines()[2:] == [
        "  the d", "    3.00 +- 0.10 N m s", "    bias due to the generated curve: 10 standard errors",
    ]  # fmt: skip
    assert bias_tables(found, {}) == []


def test_predictions_are_in_units_of_the_noise():
    case = SimpleNamespace(label="a long label", casing=1.25, rotor=2.5, r2=0.999, rmse=0.125)
    (text,) = prediction_tables([case])
    assert text.splitlines()[-1].split() == ["a", "long", "labe", "1.25", "2.5", "0.999000", "0.125"]
    assert prediction_tables([]) == []


def candidate(key, score=50.0, *, bic=-40.0, significant=True, physical=True, p=1e-3, alike=()):
    return SimpleNamespace(
        effect=SimpleNamespace(name=key), score=score, delta_bic=bic, significant=significant, physical=physical,
        p_value=p, indistinguishable_from=tuple(alike),
    )  # fmt: skip


def failure(start=2.0, stop=4.0, *, label="a", body="casing"):
    return SimpleNamespace(
        label=label, body=body, called="platter" if body == "casing" else body, times=("2", "4"), t_start=start,
        t_stop=stop, residual_torque_Nm=2e-6, residual_rad_s=0.25, size_sigma=7.6,
    )  # fmt: skip


def torque(label="a", body="casing", stop=20.0):
    t = np.linspace(0.0, stop, 65)
    return SimpleNamespace(label=label, body=body, time=t, torque=np.linspace(-1e-6, 2e-6, 65))


def diagnosis(**more):
    parts = {
        "sentence": "It is so.", "verdict": "missing_effect", "failures": (), "torques": (), "candidates": (),
        "next_experiment": "", "differs": None, "fit": fit(),
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


class TestDiagnosis:
    def lines(self, **more):
        (text,) = diagnosis_tables(diagnosis(**more), "f2")
        return text.splitlines()

    def test_an_adequate_model_has_a_sentence_and_a_verdict(self):
        assert self.lines(verdict="adequate") == ["It is so.", "", "fit f2, verdict: adequate"]
        assert self.lines(next_experiment="Film it.")[-1] == "next experiment: Film it."

    @pytest.mark.parametrize(
        ("others", "words"),
        [((), "no missing effect; a.k differs between the recordings"),
         (("b.k",), "no missing effect; 2 parameters differ between the recordings")],
    )  # fmt: skip
    def test_parameters_that_differ_are_the_verdict(self, others, words):
        names = ("a.k", *others)
        differs = SimpleNamespace(names=names, name="a.k", others=others)
        assert self.lines(differs=differs)[2] == f"fit f2, verdict: {words}"

    def test_failures_are_a_table(self):
        lines = self.lines(failures=[failure()])
        assert lines[4] == "significant lack of fit:"
        assert lines[6].split() == ["a", "platter", "2", "-", "4", "2e-06", "0.25", "8"]

    @pytest.mark.parametrize(
        ("score", "verdict", "head"),
        [(0.0, "missing_effect", None), (0.1, "missing_effect", "candidate effects:"),
         (0.1, "adequate", "tested, not established:")],
    )  # fmt: skip
    def test_candidates_with_a_positive_score_are_listed(self, score, verdict, head):
        lines = self.lines(verdict=verdict, candidates=[candidate("drag", score)])
        assert (head in lines) if head else not any("effect" in x and ":" not in x for x in lines[3:])

    def test_eight_candidates_are_listed(self):
        lines = self.lines(candidates=[candidate(f"e{i}", 50.0 - i) for i in range(10)])
        assert [x.strip() for x in lines if x.startswith("    e")] == [f"e{i}" for i in range(8)]

    def test_candidates_have_their_numbers_group_and_marks(self):
        shown = [
            candidate("drag", 123456.0, bic=-99999.4, alike=["seal"]), candidate("seal", 9.96, alike=["drag"]),
            candidate("tilt", 3.0, bic=math.inf, physical=False, p=0.5),
        ]  # fmt: skip
        lines = [x.split() for x in self.lines(candidates=shown)]
        assert ["the", "drag", "1.2e+05", "-99999.4", "0.001", "group", "A"] in lines
        assert ["the", "seal", "10.0", "-40.0", "0.001", "group", "A"] in lines
        assert ["the", "tilt", "*", "3.0", "-", "0.5"] in lines
        assert ["dBIC", "-:", "not", "refitted."] in lines
        assert ["*", "measurement", "effect"] in lines
        lines = [x.split() for x in self.lines(candidates=shown[:2])]
        assert ["dBIC", "-:", "not", "refitted."] not in lines
        assert ["*", "measurement", "effect"] not in lines

    @pytest.mark.parametrize(("x", "text"), [(99999.0, "99999.0"), (-100001.0, "-1.0e+05"), (0.04, "0.0")])
    def test_scores_have_eight_characters_at_most(self, x, text):
        assert module._fitting(x) == text

    def test_the_torque_of_the_main_body_is_drawn_where_it_fails(self):
        failures = [failure(5.0, 10.0), failure(0.0, 20.0, body="rotor"), failure(0.0, 20.0, label="b")]
        torques = [torque(), torque(body="rotor"), torque("c")]
        lines = module._curves(diagnosis(failures=failures, torques=torques))
        assert lines[1] == "unmodelled torque on the platter, a, -1e-06 to 2e-06 N m, from 0 s to 20 s:"
        assert lines[3] == "  " + " " * 16 + "^" * 17 + "  lack of fit"
        assert len(lines) == 4
        lines = module._curves(
            diagnosis(failures=[failure(1.0, 2.0)], torques=[torque(stop=4.0)], verdict="undecided")
        )
        assert lines[1].startswith("unmodelled torque on the platter, -1e-06")
        assert lines[3].endswith("^  largest")


class TestCurves:
    @pytest.mark.parametrize(
        ("intervals", "line"),
        [([(0.0, 4.9)], "^^^^^     "), ([(2.0, 2.0)], "  ^       "), ([(-3.0, 0.5), (9.5, 30.0)], "^        ^"),
         ([(20.0, 30.0)], "          "), ([], "          ")],
    )  # fmt: skip
    def test_marks_are_at_their_times(self, intervals, line):
        assert module.marks(intervals, 0.0, 10.0, width=10) == line

    def test_marks_count_from_the_start(self):
        assert module.marks([(105.0, 106.9)], 100.0, 110.0, width=10) == "     ^^   "

    def test_the_value_farthest_from_zero_is_drawn(self, monkeypatch):
        monkeypatch.setattr(module, "_levels", lambda: "01234567")
        value = np.array([0.0, 0.1, -4.0, 3.0, 4.0, -3.0, np.nan, np.nan])
        assert module.sparkline(value, width=4) == "407 "
        assert module.sparkline(np.full(3, 5.0)) == "000"
        assert module.sparkline(np.full(3, np.nan)) == "   "
        assert module.sparkline(np.zeros(0)) == ""


class TestLadder:
    def step(self, fit_id, rmse, bic, *, parent=None, added="", **more):
        parts = {
            "fit_id": fit_id, "rmse_casing": rmse, "bic": bic, "misfit": 1.5, "held_out": 1.25, "delta_bic": -3.0,
            "added": added, "words": added, "parent": parent, "samples": 1000, "n_eff": 250.4, "rmse_noise": 0.0125,
            "bic_noise": -77.0,
        }  # fmt: skip
        return parts | more

    def lines(self, *steps):
        (text,) = ladder_tables(steps, SimpleNamespace(body="platter", torque_unit="N m"))
        return text.splitlines()

    def test_bars_are_in_proportion_to_the_error(self):
        lines = self.lines(
            self.step("f1", 0.4, -5.0), self.step("f2", 0.1, -9.0, parent="f1", added="+drag"),
            self.step("f3", 0.001, -7.0, parent="f1", added="+seal", torque_left_Nm=2e-6, name="mine", note="best"),
        )  # fmt: skip
        bars = [x.rsplit("  ", 1)[-1] for x in lines if x.startswith("f") and x[1].isdigit()]
        assert bars == ["#" * 20, "#" * 5, "#"]
        assert lines[2].split()[:6] == ["f1", "0.4", "1.5", "1.25", "-5.0", "-3.0"]
        assert "      base" in lines
        assert "      +drag" in lines  # follows its parent
        assert "      +seal  (from f1)  (unmodelled torque 2e-06 N m rms)" in lines
        assert "      mine: best" in lines

    def test_the_noise_is_that_of_the_lowest_bic(self):
        lines = self.lines(
            self.step("f1", 0.4, -5.0, samples=None), self.step("f2", 0.4, math.nan, samples=5, bic_noise=1.0),
            self.step("f3", 0.4, -9.0),
        )  # fmt: skip
        noise = next(x for x in lines if x.startswith("noise"))
        assert noise.split()[:5] == ["noise", "0.0125", "1", "1", "-77.0"]
        assert lines[-1] == "1000 samples, 250 equivalent independent samples"
        assert lines[-2].endswith(";")
        lines = self.lines(self.step("f1", 0.4, None, samples=None, rmse_noise=None, bic_noise=None))
        assert next(x for x in lines if x.startswith("noise")).split()[:5] == ["noise", "-", "1", "1", "-"]
        assert not lines[-1].endswith("ones")


class TestParameters:
    FIT = fit(labels=("a", "b"))

    def test_a_parameter_of_a_joint_fit_has_its_case(self):
        assert parameters.in_words(self.FIT, "k@b") == "the k@b (b)"
        assert parameters.in_words(self.FIT, "k") == "the k"
        assert parameters.in_words(fit(), "k@a") == "the k@a"

    @pytest.mark.parametrize(
        ("lower_open", "upper_open", "text"),
        [(True, True, "no limit on either side"), (True, False, "below 3 s"), (False, True, "above 1 s"),
         (False, False, "1 to 3 s")],
    )  # fmt: skip
    def test_an_open_interval_has_one_limit(self, lower_open, upper_open, text):
        i = SimpleNamespace(lower=1.0, upper=3.0, lower_open=lower_open, upper_open=upper_open)
        assert parameters._interval(i, "s") == text

    def test_a_key_without_room_is_below(self):
        assert parameters._aligned("x" * 70, "y" * 7) == ["x" * 70 + "  " + "y" * 7]
        assert parameters._aligned("x" * 71, "y" * 7) == ["x" * 71, " " * 72 + "y" * 7]

    def test_parameters_are_below_their_effect(self):
        found = fit(
            name=lambda key: SimpleNamespace(words=f"<{key}>", key=key.partition("@")[0]), labels=("a", "b")
        )
        lines = parameters._grouped(found, {"e.k": "1", "e.n": "2", "initial.w@b": "3"})
        assert [x.split() for x in lines] == [
            ["<e>"], ["k", "=", "1", "e.k"], ["n", "=", "2", "e.n"], ["initial", "speed"],
            ["w", "(b)", "=", "3", "initial.w@b"],
        ]  # fmt: skip


class TestBounds:
    @pytest.mark.parametrize(
        ("text", "found"),
        [("omega_casing=-60,60", {"omega_casing": (-60.0, 60.0)}), ("duration=1,1", {"duration": (1.0, 1.0)}),
         ("touchpoint=0.5,2", {"touchpoint": (0.5, 2.0)})],
    )  # fmt: skip
    def test_pairs_are_limits(self, text, found):
        assert discovery._bounds([text]) == found

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("speed=1,2", "unknown quantity"), ("duration=1", "increasing"), ("duration=2,1", "increasing"),
            ("duration=1,inf", "increasing"), ("duration=x,1", "increasing"), ("omega_casing=1,2,3", "increasing"),
            ("duration=0,1", "not positive"), ("inertia_casing=-1,1", "not positive"), ("touchpoint=0,1", "positive"),
        ],
    )  # fmt: skip
    def test_wrong_limits_are_refused(self, text, words):
        with pytest.raises(UsageError, match=words):
            discovery._bounds(["omega_rotor=0,9", text])

    def bounds(self, **more):
        parts = {
            "omega_rotor": (0.0, 900.0), "omega_casing": (-6.0, 60.0), "duration": (10.0, 400.0),
            "inertia_casing": (1.0, 1.0), "touchpoint": (1.0, 1.0), "reversible": False,
        }  # fmt: skip
        return SimpleNamespace(**(parts | more))

    @pytest.mark.parametrize(
        ("more", "body", "words"),
        [
            ({}, "casing", "rotor 0 to 900 rad/s, casing -6 to 60 rad/s, duration 10 to 400 s"),
            ({"omega_rotor": (0.0, 0.0)}, "wheel", "wheel -6 to 60 rad/s, duration 10 to 400 s"),
            ({"reversible": True}, "casing", "rotor 0 to 900 rad/s in both senses of rotation, casing"),
            (
                {"inertia_casing": (1.0, 2.5)},
                "wheel",
                "inertia of the wheel up to 2.5 times the present value",
            ),
            (
                {"touchpoint": (0.5, 1.0)},
                "casing",
                "friction at the touch point 0.5 to 1 times the present value",
            ),
            ({"touchpoint": (1.0, 3.0)}, "wheel", "friction of its support 1 to 3 times the present value"),
        ],
    )
    def test_limits_of_a_run_are_a_sentence(self, more, body, words):
        text = discovery._limits_of_run(self.bounds(**more), body)
        assert words in text
        assert ("friction" in text) is ("touchpoint" in more)
        assert ("inertia" in text) is ("inertia_casing" in more)


class TestPlan:
    def limits(self, **more):
        parts = {
            "effect": SimpleNamespace(name="drag", mechanical=True), "absorbed": False, "strength": "k",
            "detection_limit": 2e-6, "detection_torque": 3e-6, "upper_limit": 1.0, "upper_torque": 4e-6, "power": 0.5,
            "runs_needed": 12.4,
        }  # fmt: skip
        return SimpleNamespace(**(parts | more))

    @pytest.mark.parametrize(
        ("more", "cells"),
        [
            ({}, ["k", "=", "2e-06", "3.0e-06", "4.0e-06", "50", "%", "12"]),
            ({"absorbed": True}, ["-"] * 5),
            ({"upper_limit": math.nan}, ["k", "=", "2e-06", "3.0e-06", "found", "50", "%", "12"]),
            ({"power": math.nan}, ["k", "=", "2e-06", "3.0e-06", "4.0e-06", "-", "12"]),
            ({"runs_needed": math.nan}, ["k", "=", "2e-06", "3.0e-06", "4.0e-06", "50", "%", "-"]),
            ({"runs_needed": math.inf}, ["k", "=", "2e-06", "3.0e-06", "4.0e-06", "50", "%", ">10000"]),
            ({"detection_torque": math.inf}, ["k", "=", "2e-06", "-", "4.0e-06", "50", "%", "12"]),
        ],
    )
    def test_rows_have_limits_power_and_runs(self, more, cells):
        assert discovery._row(self.limits(**more), "drag").split() == ["drag", *cells]

    def test_an_effect_of_measurement_has_no_upper_torque(self):
        e = self.limits(effect=SimpleNamespace(name="tilt", mechanical=False))
        assert discovery._row(e, "tilt").split() == [
            "tilt",
            "*",
            "k",
            "=",
            "2e-06",
            "3.0e-06",
            "-",
            "50",
            "%",
            "12",
        ]

    def plan(self, *effects, **more):
        parts = {
            "fit": fit(), "planned": False, "warning": "", "size": 2e-6, "effects": effects or (self.limits(),),
            "classes": (), "next_run": None,
        }  # fmt: skip
        return discovery._plan_table(SimpleNamespace(**(parts | more)))

    def test_notes_explain_the_marks_that_are_used(self):
        text = self.plan()
        assert "Sensitivity of the recording (a)" in text
        assert "expected" not in text
        assert not any(
            x in text for x in ("measurement effect", "found:", "absorbed", "indistinguishable", "next run")
        )
        tilt = self.limits(effect=SimpleNamespace(name="tilt", mechanical=False))
        assert "* measurement effect, no torque" in self.plan(tilt)
        assert "found: significant in these recordings" in self.plan(self.limits(upper_limit=math.nan))
        assert "absorbed by the model, no limit" in self.plan(self.limits(absorbed=True))
        assert "indistinguishable near these limits" in self.plan(classes=[("a", "b")])
        text = self.plan(planned=True, warning="Few data.", fit=fit(labels=("a", "b")))
        assert text.startswith("warning: Few data.")
        assert "Sensitivity of the planned recordings (a, b)" in " ".join(text.split())
        assert "(95 %, expected)" in " ".join(text.split())
        run = SimpleNamespace(sentence="Turn it.", bounds=TestBounds().bounds())
        assert "next run: Turn it." in self.plan(next_run=run)


class TestLaws:
    def law(self, formula, penalised=0.0, p=1e-3, differences=()):
        return SimpleNamespace(
            formula=formula, form="power", penalised=penalised, delta_bic=-50.0, p_value=p, torque_rms_Nm=2e-6,
            fit=fit(), estimates={"x.k": Estimate(2.0, 0.1, "N m", at_bound=False)}, differences=differences,
        )  # fmt: skip

    def test_a_law_has_its_distance_to_the_best(self):
        best, other = self.law("a", -5.0), self.law("b", -2.0, 0.0)
        assert discovery._law(1, best, best, "a")[1].split() == ["-50.0", "best", "0.001", "2e-06", "N", "m"]
        lines = discovery._law(2, other, best, "b")
        assert lines[0] == "b  2 b  (power)"
        assert lines[1].split()[:3] == ["-50.0", "+3.0", "<1e-300"]
        assert lines[2].strip() == "k = 2.00 +- 0.10 N m"

    def test_laws_of_equal_torque_share_a_letter(self):
        difference = SimpleNamespace(
            formula="c", torque_Nm=3e-7, label="run", t_start=1.0, t_stop=2.0, omega_c=(3.0, 4.0)
        )
        laws = [
            self.law("a", differences=(difference,)),
            self.law("b", 1.0),
            self.law("c", 2.0),
            self.law("d", 9.0),
        ]
        found = SimpleNamespace(
            sentence="It depends.", verdict="v", depends_on=(), torques=[laws[:2], laws[2:3]], laws=laws, trials=9,
            fit=fit(), next_experiment="Film.",
        )  # fmt: skip
        lines = discovery._laws_table(found, "f1").splitlines()
        assert [x[:6] for x in lines if x.endswith("(power)")] == ["a  1 a", "a  2 b", "b  3 c", "   4 d"]
        at = lines.index("where they differ from a:")
        assert lines[at + 1] == "  c"
        assert lines[at + 2].strip() == "at most 3e-07 N m in run, 1 s to 2 s, platter 3 to 4 rad/s"
        assert lines[-1] == "next experiment: Film."

    @pytest.mark.parametrize("suffix", [".png", ".SVG", ".pdf", ".jpg", ""])
    def test_pictures_have_three_formats(self, tmp_path, suffix):
        path = tmp_path / f"a{suffix}"
        if suffix in {".jpg", ""}:
            with pytest.raises(UsageError, match="Unknown picture format"):
                discovery.check_picture(path, force=False, reads=())
        else:
            discovery.check_picture(path, force=False, reads=())
        discovery.check_picture(None, force=False, reads=())
