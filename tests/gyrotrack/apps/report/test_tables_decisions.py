"""Rows of the tables of a report, and sentences of its head, from fits and clips of known values."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import LIBRARY, Estimate
from gyrotrack.apps.report import _page as page
from gyrotrack.apps.report import _tables as module
from gyrotrack.io._schema import STATUS


def estimate(value, stderr=0.1, *, at_bound=False, unit="N m"):
    return Estimate(value, stderr, unit, at_bound=at_bound)


def view(**more):
    parts = {
        "cases": (SimpleNamespace(label="a"),), "body": "platter", "verdict": "missing_effect", "sentence": "So.",
        "candidates": (), "differs": None, "added": (),
        "name": lambda e: SimpleNamespace(words=f"<{getattr(e, 'name', e)}>", key=getattr(e, "name", e)),
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


class TestParameters:
    @pytest.mark.parametrize(
        ("value", "stderr", "text"),
        [
            (-4.0, 0.1, "2.5 %"),
            (4.0, 0.0, "0 %"),
            (0.0, 0.1, "–"),
            (4.0, math.inf, "–"),
            (4.0, math.nan, "–"),
        ],
    )
    def test_uncertainties_are_relative_to_the_size(self, value, stderr, text):
        assert module._relative(estimate(value, stderr)) == text

    @pytest.mark.parametrize(
        ("e", "before", "flags", "note"),
        [
            (estimate(1.0), None, {}, ""),
            (estimate(1.0), estimate(9.0), {"fixed": True}, "not fitted"),
            (estimate(1.0, at_bound=True), estimate(9.0), {"undetermined": True}, "at a bound"),
            (estimate(1.0), estimate(9.0), {"undetermined": True}, "not determined by these data"),
            (estimate(1.0, 0.3), estimate(2.6, 0.4), {}, "changed by 3 σ"),
            (estimate(1.0, 0.3), estimate(-0.6, 0.4), {}, "changed by 3 σ"),
            (estimate(1.0, 0.3), estimate(2.4, 0.4), {}, ""),
            (estimate(1.0, math.inf), estimate(2.6, 0.4), {}, "changed by 4 σ"),
            (estimate(1.0, 0.3), estimate(9.0, math.inf), {}, ""),
            (estimate(1.0, 0.3), estimate(9.0, 0.0), {}, ""),
        ],
    )
    def test_notes_state_what_is_unusual(self, e, before, flags, note):
        assert module._note(e, before, **({"undetermined": False, "fixed": False} | flags)) == note

    def rows(self, monkeypatch, improved=True, cases=1):
        monkeypatch.setattr(module, "_response_rows", lambda view: [])
        names = {
            "drag.k@a": estimate(2.0),
            "initial.omega_c@a": estimate(3.0),
            "bearing.linear.d": estimate(4.0),
        }
        final = SimpleNamespace(estimates=names, model=SimpleNamespace(constants={"bearing.linear.d": 4.0}))
        base = SimpleNamespace(estimates={"initial.omega_c@a": estimate(9.0)})
        return module.parameter_rows(
            view(
                final=final, base=base, improved=improved, added=("drag",),
                cases=tuple(SimpleNamespace(label=x) for x in "ab"[:cases]),
            )
        )  # fmt: skip

    def test_rows_have_the_values_of_both_models(self, monkeypatch):
        drag, start, bearing = self.rows(monkeypatch)
        assert (drag["effect"], drag["is_new"], drag["before"], drag["case"]) == ("<drag>", True, "", "")
        assert (start["effect"], start["index"], start["symbol"]) == ("initial value", "c0", "ω")
        assert (start["before"] != "", start["note"], start["is_new"]) == (True, "changed by 42 σ", False)
        assert (bearing["note"], bearing["index"]) == ("not fitted", "")
        assert [r["case"] for r in self.rows(monkeypatch, cases=2)] == ["a", "a", ""]
        assert [r["before"] for r in self.rows(monkeypatch, improved=False)] == [""] * 3

    def test_a_parameter_of_a_case_is_named_with_it(self):
        assert module.with_symbol("drag.k@b", estimate(2.0)).startswith("k (b) = ")
        assert module.with_symbol("drag.k", estimate(2.0, at_bound=True)).endswith(" (at a bound)")
        assert not module.with_symbol("drag.k", estimate(2.0)).endswith(" (at a bound)")


class TestClips:
    def clip(self, **more):
        status = np.array([*[STATUS["ok"]] * 3, max(STATUS.values())])
        parts = {
            "source": "a.mp4", "body": "casing", "frames_declared": 100, "frames_decoded": 98, "capture_fps": 260.0,
            "markers": {"m": SimpleNamespace(name="M1", status=status)}, "warnings": ("w",),
            "bodies": {"casing": SimpleNamespace(sigma=np.array([1e-3, np.nan, 3e-3])),
                       "rotor": SimpleNamespace(sigma=np.zeros(0))},
        }  # fmt: skip
        return SimpleNamespace(**(parts | more))

    def test_a_clip_has_its_lost_frames_and_its_median(self):
        row = module.clip_row(self.clip(), None)
        other = next(k for k, v in STATUS.items() if v == max(STATUS.values())).replace("_", " ")
        assert row["frames"] == "98 (2 of 100 not decoded)"
        assert row["sigma"] == "casing: 2.0 mrad"
        assert row["markers"] == [f"M1: 75 % ok, 25 % {other}"]
        assert (row["offset"], row["ambiguous"], row["fps"]) == ("–", "–", "260.0")
        assert module.clip_row(self.clip(frames_decoded=100), None)["frames"] == "100"
        assert module.clip_row(self.clip(bodies={}), None)["sigma"] == "–"

    def test_marks_that_were_never_seen_are_stated(self):
        assert module._statuses(np.zeros(0, np.int8)) == "0 % ok"
        lost = next(v for k, v in STATUS.items() if k != "ok")
        assert module._statuses(np.full(2, lost)).startswith("0 % ok, 100 % ")
        assert module._milliradians(np.full(2, np.nan)) == "unknown"

    @pytest.mark.parametrize(
        ("rate", "u", "stated"),
        [
            (1.0, 0.0, False),
            (1.0, math.nan, False),
            (1.0, math.inf, False),
            (1.001, 0.0, True),
            (1.0, 1e-5, True),
        ],
    )
    def test_a_rate_of_one_is_not_stated(self, rate, u, stated):
        placement = SimpleNamespace(
            clock_offset=2.0, clock_offset_sigma=0.1, clock_rate=rate, clock_rate_sigma=u, ambiguous=True
        )
        row = module.clip_row(self.clip(), placement)
        assert ("rate" in row["offset"]) is stated
        assert row["ambiguous"] == "yes: the start is not unique"
        placement.ambiguous = False
        assert module.clip_row(self.clip(), placement)["ambiguous"] == "no"


class TestPlausibility:
    @pytest.mark.parametrize(
        ("energy", "sigma", "may_supply", "words"),
        [
            (0.9e-3, 0.0, False, "negligible"),
            (-0.9e-3, 0.0, False, "negligible"),
            (1.1e-3, 1e-4, False, "dissipates"),
            (0.19, 0.1, False, "not distinguished from zero"),
            (-0.19, 0.1, False, "not distinguished from zero"),
            (0.21, 0.1, False, "dissipates"),
            (-0.21, 0.1, False, module.UNPHYSICAL),
            (-0.21, 0.1, True, "supplies energy"),
        ],
    )
    def test_energy_is_compared_with_the_whole_and_its_error(self, energy, sigma, may_supply, words):
        assert module._judgement(energy, sigma, 1.0, may_supply=may_supply) == words
        assert module._judgement(5 * energy, 5 * sigma, 5.0, may_supply=may_supply) == words

    @pytest.mark.parametrize(
        ("name", "may_supply"),
        [
            ("casing.air.quadratic", False),
            ("touchpoint.drift", True),  # depends on the time
            ("casing.unbalance", True),  # on the angle
            ("bearing.drift", True),  # multiplies another torque
        ],
    )
    def test_laws_of_time_and_angle_may_supply_energy(self, name, may_supply):
        assert module._may_supply(LIBRARY[name]) is may_supply


class TestExperiment:
    def data(self, label="a", inertia_u=1e-6, note="", per=1):
        def body(name, role, value, samples):
            return SimpleNamespace(
                name=name, role=role, inertia=value, inertia_u=inertia_u, series=[range(samples)] * per
            )

        bodies = [body("platter", "casing", 2e-5, 100), body("wheel", "rotor", 5e-5, 30)]
        record = SimpleNamespace(
            label=label, bodies=bodies, quantity="angle", span=(1.0, 9.5), source="", digest="abc",
            units=SimpleNamespace(note=note),
        )  # fmt: skip
        return SimpleNamespace(record=record, n_effective=41.6)

    def rows(self, *data, cases=1):
        base = SimpleNamespace(problem=SimpleNamespace(data=data))
        return module.experiment_rows(view(base=base, cases=(SimpleNamespace(),) * cases))

    def test_measured_quantities_have_their_uncertainty(self):
        rows = dict(self.rows(self.data()))
        assert rows["Moment of inertia of the platter"] == "(2.00 ± 0.10) × 10⁻⁵ kg m²"
        assert (
            rows["Samples of the angle"]
            == "platter 100, wheel 30 in 1 windows; 42 equivalent independent samples"
        )
        assert rows["Time"] == "1.00 s to 9.50 s"
        rows = dict(self.rows(self.data(inertia_u=math.nan)))
        assert rows["Moment of inertia of the platter"].endswith("kg m², no uncertainty given")
        assert dict(self.rows(self.data(note="per inertia")))["Moment of inertia of the wheel"] == (
            "not given: per inertia"
        )

    def test_several_cases_are_named(self):
        names = [k for k, _ in self.rows(self.data("a"), self.data("b", per=2), cases=2)]
        assert names.count("Time of a") == names.count("Time of b") == 1
        assert dict(self.rows(self.data("b", per=2), cases=2))["Samples of the angle of b"].startswith(
            "platter 200, wheel 60 in 2 windows"
        )

    def test_the_origin_has_data_and_versions(self):
        fit = SimpleNamespace(problem=SimpleNamespace(data=[self.data(), self.data(note="per inertia")]))
        rows = module.origin_rows(fit, {"command": "fit"})
        assert rows[0] == ("command", "fit")
        assert rows[1] == ("case a", "in memory; SHA-256 of the data abc")
        assert "I_wheel 5" in rows[2][1]
        assert "kg m²; measured: angle" in rows[2][1]
        assert "; per inertia; measured: angle" in rows[4][1]
        assert "numpy" in dict(rows)["libraries"]


class TestBudget:
    def test_three_contributions_above_half_a_percent_are_shown(self, monkeypatch):
        def part(share):
            return SimpleNamespace(source=f"s{share}", type="B", share=share)

        b = SimpleNamespace(
            value=2.0,
            u=0.1,
            unit="s",
            contributions=[part(0.6), part(0.3), part(0.0051), part(0.0049), part(0.1)],
        )
        monkeypatch.setattr(
            "fitting.inference._budget.budget", lambda fit: {"drag.k@a": b, "initial.omega_c@a": b}
        )
        found = module.budget_rows(view(final=None))
        assert found[0]["parts"] == ["s0.6 (type B) 60 %", "s0.3 (type B) 30 %", "s0.0051 (type B) 0.51 %"]
        assert [r["effect"] for r in found] == ["<drag>", "<initial.omega_c>"]
        assert [r["index"] for r in found] == ["", "c0"]
        b.contributions = b.contributions[1:]
        assert len(module.budget_rows(view(final=None))[0]["parts"]) == 2
        found = module.budget_rows(view(final=None, cases=(1, 2)))
        assert [r["effect"] for r in found] == ["<drag> (a)", "<initial.omega_c> (a)"]


def candidate(name="drag", *, significant=True, physical=True, alike=(), bic=-40.0, p=1e-3):
    return SimpleNamespace(
        effect=SimpleNamespace(name=name), significant=significant, physical=physical, p_value=p, delta_bic=bic,
        indistinguishable_from=tuple(alike), score=50.0,
    )  # fmt: skip


class TestHead:
    @pytest.mark.parametrize(
        ("more", "words"),
        [
            ({"candidates": (candidate(),)}, "Missing: <drag>"),
            ({"candidates": (candidate("a", significant=False), candidate())}, "Missing: <drag>"),
            ({"candidates": (candidate(alike=["seal"]),)}, "Missing: one of <drag>; <seal>"),
            ({"candidates": (candidate(physical=False),)}, "Fault of the measurement: <drag>"),
            (
                {"candidates": (candidate(physical=False),), "added": ("drag", "seal")},
                "Missing: <drag> and <seal>",
            ),
            ({}, "Missing"),
            ({"verdict": "adequate", "candidates": (candidate(),)}, "Consistent with noise"),
            ({"verdict": "unexplained", "added": ("a", "b")}, "Unexplained torque; closest law: <a> and <b>"),
            ({"verdict": "unexplained"}, "Unexplained torque"),
        ],
    )
    def test_the_headline_names_what_is_missing(self, more, words):
        assert page._headline(view(**more))[2] == words

    def facts(self, monkeypatch, **more):
        monkeypatch.setattr(page, "_where", lambda view: [])
        return page._facts(view(**more))

    @pytest.mark.parametrize(
        ("more", "rows"),
        [
            ({}, []),
            (
                {"candidates": (candidate(significant=False),)},
                [("Significance", "1 candidate effects tested, none significant")],
            ),
            (
                {"candidates": (candidate(alike=["seal"]),)},
                [
                    (
                        "Significance",
                        "ΔBIC −40.0, false-alarm probability = 0.0010; indistinguishable from <seal>",
                    )
                ],
            ),
            (
                {"candidates": (candidate(bic=math.nan),)},
                [("Significance", "false-alarm probability = 0.0010; no indistinguishable candidate")],
            ),
            (
                {"candidates": (candidate(),), "verdict": "adequate"},
                [
                    (
                        "Significance",
                        (
                            "1 candidate effects tested, none accepted; most significant: <drag>, false-alarm "
                            "probability = 0.0010"
                        ),
                    )
                ],
            ),
            (
                {"differs": SimpleNamespace(p_value=1e-9, delta_bic=-90.0), "candidates": (candidate(),)},
                [("Significance", "ΔBIC −90.0, false-alarm probability = 1 × 10⁻⁹")],
            ),
        ],
    )
    def test_the_significance_is_that_of_the_answer(self, monkeypatch, more, rows):
        assert self.facts(monkeypatch, **more) == rows

    def failure(self, torque=2e-6, kind="torque"):
        return SimpleNamespace(
            residual_torque_Nm=torque, kind=kind, unit="N m", label="a", times=("1", "2"), size_sigma=7.6,
            called="platter",
        )  # fmt: skip

    @pytest.mark.parametrize(
        ("torque", "kind", "named", "words"),
        [
            (2e-6, "torque", False, "+2.0 µN m on the platter, 1–2 s"),
            (-2e-6, "torque", True, "−2.0 µN m on the platter of a, 1–2 s"),
            (-2e-6, "ripple", False, "2.0 µN m on the platter, 1–2 s"),
        ],
    )
    def test_a_torque_has_a_sign_unless_it_alternates(self, torque, kind, named, words):
        found = page._interval(self.failure(torque, kind), named=named)
        assert found.startswith(words)
        assert "up to 8 σ" in found.replace("\u00a0", " ")

    @pytest.mark.parametrize(
        ("p", "verdict", "explained"),
        [((1e-9,), "no_lack_of_fit", True), ((1e-9,), "lack_of_fit", False), ((0.5,), "no_lack_of_fit", False),
         ((0.5, 1e-9), "no_lack_of_fit", True)],
    )  # fmt: skip
    def test_a_small_probability_of_a_good_fit_is_explained(self, monkeypatch, p, verdict, explained):
        monkeypatch.setattr(page, "angle_noise_lines", lambda fit: ["the angles have noise"])
        labelled = tuple((f"c{i}", x) for i, x in enumerate(p))
        text = page._whiteness(view(whiteness=labelled, final=SimpleNamespace(verdict=verdict)))
        assert ("correlated residuals" in text) is explained
        assert text.endswith(". The angles have noise")
        assert text.startswith("c0 p " if len(p) > 1 else "p ")


class TestSection:
    def section(
        self, monkeypatch, *, case=True, films=True, static=False, bodies=("casing", "rotor"), angle=False
    ):
        def named(name):
            return SimpleNamespace(name=name)

        drawn = []
        monkeypatch.setattr(page.charts, "speed_chart", lambda v, body: named("speed"))
        monkeypatch.setattr(page.charts, "normalised_chart", lambda v: named("normalised"))
        monkeypatch.setattr(
            page.charts, "torque_law_chart", lambda v, *, alternatives: named(f"law {alternatives}")
        )
        monkeypatch.setattr(page.charts, "windows_picture", lambda v, name: name)
        monkeypatch.setattr(
            page.charts, "case_dashboard",
            lambda v, tracks, steps: page.Dashboard("d", tuple("abcde"), tuple(steps)),
        )  # fmt: skip
        monkeypatch.setattr(page, "_torque_of_the_angle", lambda view, v: [named("angle")] if angle else [])
        monkeypatch.setattr(page, "_details", lambda *_: ("details",))
        monkeypatch.setattr(page, "tracks_of", lambda case: "tracks")
        monkeypatch.setattr(page, "sync_picture", lambda tracks, name: name)
        monkeypatch.setattr(page, "contact_sheets", lambda case, films, spans: spans)
        monkeypatch.setattr(page, "ghost_stretches", lambda *_: [1, 2, 3])
        monkeypatch.setattr(page, "animated", lambda s: None if s == 2 else s)
        monkeypatch.setattr(
            page,
            "chart_picture",
            lambda c, intervals, *, name, size: drawn.append((c.name, name, len(intervals))),
        )
        v = SimpleNamespace(
            label="run", main="casing", surface="PVC", bodies=dict.fromkeys(bodies), intervals=[
                SimpleNamespace(body="casing"), SimpleNamespace(body="rotor"), SimpleNamespace(body="casing"),
            ], failures=[SimpleNamespace(t_start=1.0, t_stop=2.0)],
        )  # fmt: skip
        shown = view(cases=(v,), steps=[SimpleNamespace(words="start")], improved=False)
        found = page._section(shown, 0, "case" if case else None, ["folder"] if films else [], static=static)
        return found, drawn

    def test_intervals_of_the_main_body_are_shaded_but_not_on_speeds(self, monkeypatch):
        found, drawn = self.section(monkeypatch)
        assert drawn == [
            ("speed", "speed0", 0),
            ("normalised", "normalised0", 2),
            ("law True", "law True0", 2),
        ]
        assert (found.heading, found.surface, found.windows, found.sync) == ("", "PVC", "windows0", "sync0")
        assert (found.sheets, found.ghosts, found.details) == (((1.0, 2.0),), (1, 3), ())
        assert found.dashboard.charts == tuple("abcde")

    def test_without_a_case_or_films_there_are_no_frames(self, monkeypatch):
        found, _ = self.section(monkeypatch, case=False)
        assert (found.sheets, found.ghosts, found.sync) == ((), (), None)
        found, _ = self.section(monkeypatch, films=False, bodies=("casing",), static=True)
        assert (found.sheets, found.ghosts, found.windows, found.details) == ((), (1, 3), None, ("details",))

    def test_a_chart_against_the_angle_replaces_that_of_the_law(self, monkeypatch):
        found, drawn = self.section(monkeypatch, angle=True)
        assert drawn[-1] == ("angle", "angle0", 2)
        assert [getattr(c, "name", c) for c in found.dashboard.charts] == ["a", "b", "c", "angle", "d", "e"]


class TestGhosts:
    @pytest.mark.parametrize(
        ("improved", "added", "names"),
        [(False, (), ["base model"]), (True, ("a", "b"), ["base model", "with <a> and <b>"]),
         (True, (), ["base model", "final model"])],
    )  # fmt: skip
    def test_models_and_intervals_are_those_of_the_history(self, monkeypatch, improved, added, names):
        asked = []
        monkeypatch.setattr(page, "stretches", lambda *args: asked.append(args) or list(range(9)))
        failures = [
            SimpleNamespace(kind=k, body="casing", t_start=i, t_stop=i + 1)
            for i, k in enumerate(("torque", "ripple"))
        ]
        shown = view(
            base="base",
            final="final",
            improved=improved,
            added=added,
            cases=(SimpleNamespace(failures=failures),),
        )
        assert page.ghost_stretches(shown, 0, "case", ["f"]) == [0, 1, 2, 3]
        fits = ["base", "final"] if improved else ["base"]
        assert asked == [("case", fits, names, [("casing", 0, 1)], ["f"], 0)]


@pytest.mark.parametrize("tracked", [True, False])
def test_details_are_the_torque_on_each_body_and_the_energy(monkeypatch, tracked):
    drawn = []
    monkeypatch.setattr(page.charts, "torque_chart", lambda v, body: SimpleNamespace(name=f"torque-{body}"))
    monkeypatch.setattr(page.charts, "energy_chart", lambda v, steps: SimpleNamespace(name=f"energy {steps}"))
    monkeypatch.setattr(page.charts, "tracking_charts", lambda tracks: [SimpleNamespace(name=tracks)])
    monkeypatch.setattr(
        page, "chart_picture", lambda c, shaded, *, name, size: drawn.append((c.name, len(shaded))) or name
    )
    intervals = [SimpleNamespace(body="casing"), SimpleNamespace(body="rotor")]
    v = SimpleNamespace(bodies={"casing": "", "rotor": ""}, intervals=intervals, main="casing")
    found = page._details(v, 2, "steps", "sigma" if tracked else None)
    names = ["torque-casing", "torque-rotor", "energy steps", *(["sigma"] if tracked else [])]
    assert drawn == [(n, 1) for n in names]
    assert found == tuple(f"{n}2" for n in names)
