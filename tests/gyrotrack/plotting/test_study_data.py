"""Data of a report: models, alternatives, added torques and steps of a history of fits, with stubs of known values."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.effects._mechanism import MAIN
from gyrotrack.plotting import _study_data as module
from gyrotrack.plotting._study_data import AddedTorque, CaseModel, CaseView, Curve, StudyView, gather

T = np.linspace(0.0, 10.0, 11)


class TestOutside:
    def found(self, value, covered=(), period=0.0, sigma=0.01, width=0.4):
        residual = SimpleNamespace(
            time=np.arange(float(len(value))), value=np.array(value), width=np.full(len(value), width)
        )
        return module._outside(residual, np.full(len(value), sigma), covered, period)

    def test_an_interval_has_half_a_width_at_both_ends(self):
        z = [0.0, 0.0, 0.03, 0.09, 0.03, 0.0]
        assert self.found(z) == [pytest.approx((1.8, 4.2, 9.0))]
        assert self.found([-x for x in z]) == [pytest.approx((1.8, 4.2, 9.0))]

    def test_of_a_covered_interval_the_rest_remains(self):
        z = [0.0, 0.08, 0.09, 0.07, 0.06, 0.05, 0.0]
        assert self.found(z, [(2.0, 3.0)]) == [pytest.approx((0.8, 1.2, 8.0)), pytest.approx((3.8, 5.2, 6.0))]
        assert self.found(z, [(1.0, 5.0)]) == []

    def test_without_noise_nothing_is_outside(self):
        assert self.found([5.0] * 4, sigma=0.0) == []


def body(part, state, name, count=2):
    return SimpleNamespace(
        part=part, state=state, name=name,
        series=[SimpleNamespace(time=T + 20.0 * i, state=state) for i in range(1 if state == MAIN else count)],
    )  # fmt: skip


class TestCaseModel:
    @pytest.mark.parametrize("chain", [False, True])
    def test_bodies_have_their_speeds_residuals_and_torques(self, monkeypatch, chain):
        bodies = [body("casing", MAIN, "platter"), body("rotor", 0, "wheel")]
        record = SimpleNamespace(label="run", bodies=bodies, rotor=bodies[1].series, is_chain=chain)
        fit = SimpleNamespace(problem=SimpleNamespace(data=[None, SimpleNamespace(record=record)]))
        monkeypatch.setattr(
            module,
            "modelled_speed",
            lambda fit, index, state, time: (time + 100.0 * (state == MAIN), np.full(len(time), index)),
        )
        monkeypatch.setattr(module, "speed_residuals", lambda fit, index: ("main", ["first", "second"]))
        torques = [SimpleNamespace(label=x, body=b) for x in ("other", "run") for b in ("casing", "rotor")]
        found = module._case_model(fit, torques, 1)
        assert found.residuals == {"casing": ("main",), "rotor": ("first", "second")}
        assert found.torques == {"casing": torques[2], "rotor": torques[3]}
        (main,), windows = found.speeds["casing"], found.speeds["rotor"]
        assert (main.time[0], main.time[-1], main.value[-1], main.sigma[0]) == (0.0, 10.0, 110.0, 1)
        assert [w.value[-1] for w in windows] == [10.0, 30.0]
        assert len(main.time) == module._MODEL_POINTS
        assert len(windows[0].time) == (module._MODEL_POINTS if chain else module._WINDOW_POINTS)


class TestAlternatives:
    def found(self, monkeypatch, *candidates, differs=None, diagnosed=True, equal=()):
        monkeypatch.setattr(
            module,
            "added_torque",
            lambda name, base, other, index: None if name in equal else (name, other, index),
        )
        base = SimpleNamespace(name=lambda e: SimpleNamespace(words=e.name))
        final = SimpleNamespace(model=SimpleNamespace(names=("taken",)))
        diagnosis = SimpleNamespace(candidates=candidates, differs=differs) if diagnosed else None
        return [name for name, *_ in module._alternatives(base, final, diagnosis, 0)]

    def candidate(self, name, *, fit="fit", physical=True, significant=True, angle=False):
        return SimpleNamespace(
            effect=SimpleNamespace(name=name, depends_on_angle=angle), fit=fit, physical=physical,
            significant=significant,
        )  # fmt: skip

    def test_the_best_refitted_candidates_are_drawn(self, monkeypatch):
        shown = [
            self.candidate("taken"), self.candidate("a"), self.candidate("b", fit=None),
            self.candidate("c", physical=False), self.candidate("d", significant=False),
            self.candidate("e", angle=True),
            self.candidate("f"), self.candidate("g"), self.candidate("h"), self.candidate("i"), self.candidate("j"),
        ]  # fmt: skip
        names = ["a", "f", "g", "h", "i", "j"]
        assert self.found(monkeypatch, *shown) == names[: module._MAX_ALTERNATIVES]
        assert self.found(monkeypatch, *shown, equal=("a",)) == names[1 : 1 + module._MAX_ALTERNATIVES]
        assert self.found(monkeypatch, *shown, differs="k") == []
        assert self.found(monkeypatch, diagnosed=False) == []


class TestAddedTorque:
    """Rates of rotor and casing are 2 and 1 rad/s2 in the base, 2 - w and 1 + w in the other model."""

    def found(self, monkeypatch, names=("a", "b"), states=("v", "w")):
        import fitting.dynamics._collocation as collocation

        class Sampler:
            def __init__(self, mesh, time):
                self.time = time

            def value(self, y):
                return np.column_stack([0.0 * self.time, self.time])

        monkeypatch.setattr(collocation, "Sampler", Sampler)

        def fit(names, states, rates):
            case = SimpleNamespace(
                dynamics=SimpleNamespace(states=states, rates=rates),
                data=SimpleNamespace(
                    record=SimpleNamespace(
                        inertias=(4.0, 0.5), mechanism=SimpleNamespace(bodies=("rotor", "casing"))
                    )
                ),
            )
            path = SimpleNamespace(
                mesh=SimpleNamespace(edges=np.array([0.0, 4.0])), states=("v", "w"), y=None
            )
            return SimpleNamespace(
                model=SimpleNamespace(smooth=SimpleNamespace(names=names)),
                problem=SimpleNamespace(cases=[case], layout=SimpleNamespace(numbers=lambda theta, index: theta)),
                predictions=[SimpleNamespace(path=path)], theta=None,
            )  # fmt: skip

        base = fit(
            ("a",), states, lambda time, state, _: np.column_stack([2.0 + 0 * time, 1.0 + 0 * time, time])
        )
        other = fit(
            names, ("w", "v"), lambda time, state, _: np.column_stack([2.0 - state[:, 1], 1.0 + state[:, 1]])
        )
        return module.added_torque("law", base, other, 0)

    def test_it_is_the_change_of_the_rate_times_the_inertia(self, monkeypatch):
        found = self.found(monkeypatch)
        assert (found.time[0], found.time[-1]) == (0.0, 4.0)
        assert found.omega_c == pytest.approx(found.time)
        assert found.on("casing") == pytest.approx(0.5 * found.time)
        assert found.on("rotor") == pytest.approx(-4.0 * found.time)

    def test_a_model_without_another_effect_adds_none(self, monkeypatch):
        assert self.found(monkeypatch, names=("a",)) is None
        assert self.found(monkeypatch, names=()) is None
        assert self.found(monkeypatch, states=("v", "unknown")) is None


def fit(names=(), **more):
    parts = {
        "model": SimpleNamespace(names=names), "rmse_noise": 0.1, "problem": SimpleNamespace(data=[1, 2]),
        "noise": [SimpleNamespace(pure=1e-9), SimpleNamespace(pure=3e-9)], "torque_noise": 5e-9, "converged": True,
        "has_lack_of_fit": lambda: False,
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


class TestGather:
    def gathered(self, monkeypatch, *fits, diagnosis=None):
        monkeypatch.setattr(module, "case_view", lambda history, diagnosis, torques, i: (torques, i))
        monkeypatch.setattr(module, "_torques", lambda fit, diagnosis: f"torques {fit.model.names}")
        monkeypatch.setattr(
            module, "_upper_limits", lambda last, diagnosis: (last.fit.model.names, diagnosis)
        )
        monkeypatch.setattr(module, "_steps", lambda history: len(history))
        monkeypatch.setattr(
            "fitting.discovery._residuals.whiteness", lambda fit: [SimpleNamespace(label="a", p_value=0.5)]
        )
        monkeypatch.setattr("fitting.study._serialisation.history_verdict", lambda history: "of the history")
        history = [SimpleNamespace(fit=f, candidates=(candidate(2.0), candidate(0.0))) for f in fits]
        return gather(history, diagnosis)

    def diagnosis(self):
        return SimpleNamespace(
            verdict="undecided", sentence="So.", candidates=(candidate(7.0), candidate(-1.0)), differs="k",
            next_experiment="Film.",
        )  # fmt: skip

    def test_one_fit_has_the_verdict_of_its_diagnosis(self, monkeypatch):
        diagnosis = self.diagnosis()
        found = self.gathered(monkeypatch, fit(("a",)), diagnosis=diagnosis)
        assert (found.verdict, found.sentence, found.differs, found.next_experiment) == (
            "undecided", "So.", "k", "Film.",
        )  # fmt: skip
        assert [c.score for c in found.candidates] == [7.0]
        assert found.added == ()
        assert found.cases == ((("torques ('a',)",), 0), (("torques ('a',)",), 1))
        assert found.upper_limits == (("a",), diagnosis)
        assert not StudyView.improved.fget(SimpleNamespace(steps=[1]))

    def test_several_fits_have_the_verdict_of_the_history(self, monkeypatch):
        found = self.gathered(
            monkeypatch, fit(("a",)), fit(("a", "b")), fit(("a", "b", "c")), diagnosis=self.diagnosis()
        )
        assert (found.verdict, found.added, found.steps) == ("of the history", ("b", "c"), 3)
        assert found.upper_limits == (("a", "b", "c"), None)
        assert found.cases[0][0] == ("torques ('a',)", "torques ('a', 'b', 'c')")
        assert found.whiteness == (("a", 0.5),)

    def test_without_a_diagnosis_the_ranking_of_the_base_is_shown(self, monkeypatch):
        found = self.gathered(monkeypatch, fit(("a",)))
        assert (found.verdict, found.sentence, found.differs) == ("of the history", "", None)
        assert [c.score for c in found.candidates] == [2.0]


def candidate(score):
    return SimpleNamespace(score=score)


@pytest.mark.parametrize(
    ("converged", "fails", "computed"), [(True, False, True), (False, False, False), (True, True, False)]
)
def test_limits_are_computed_for_an_adequate_model(monkeypatch, converged, fails, computed):
    import fitting.discovery._power as power

    monkeypatch.setattr(power, "largest_hidden", lambda *_: SimpleNamespace(limits=("limits",)))
    last = SimpleNamespace(fit=fit(converged=converged, has_lack_of_fit=lambda: fails), candidates=())
    assert module._upper_limits(last, None) == (("limits",) if computed else ())
    assert module._upper_limits(last, SimpleNamespace(upper_limits=("own",))) == ("own",)


def test_steps_are_compared_with_the_step_before(monkeypatch):
    asked = []

    def document(fit, fit_id, change, before):
        asked.append((change, before))
        merits = dict.fromkeys(("misfit", "held_out", "delta_bic", "energy_drift", "verdict"), 1.0)
        return merits | {"rmse_casing": 0.25, "words": "in words" if change else ""}

    monkeypatch.setattr("fitting.study._serialisation.step_document", document)
    history = [SimpleNamespace(fit=fit(), change=""), SimpleNamespace(fit=fit(), change="+a")]
    first, second = module._steps(history)
    assert asked == [("", None), ("+a", history[0].fit)]
    assert (first.change, first.words, second.change, second.words) == (
        "base model",
        "base model",
        "+a",
        "in words",
    )
    assert (first.torque_left, first.torque_pure, first.rmse) == (5e-9, 3e-9, 0.25)


def test_torques_of_the_diagnosed_fit_are_those_of_the_diagnosis(monkeypatch):
    monkeypatch.setattr("fitting.discovery._residuals.residual_torques", lambda fit: ["computed"])
    f = fit()
    assert module._torques(f, SimpleNamespace(fit=f, torques=("known",))) == ("known",)
    assert module._torques(f, SimpleNamespace(fit=fit(), torques=("known",))) == ("computed",)
    assert module._torques(f, None) == ("computed",)


class TestCaseView:
    def view(self, failures=(), residual=0.0):
        def r(value):
            return SimpleNamespace(
                time=T, value=np.full(11, value), sigma=np.full(11, 0.01), width=np.full(11, 1.0)
            )

        models = (
            CaseModel({}, {"main": (r(residual),), "other": (r(0.0),)}, {}),
            CaseModel({}, {"main": (r(0.0),), "other": (r(0.0),)}, {}),
        )
        none = Curve(T, T, T)
        return CaseView(
            "run", "", "angle", {"main": "drum", "other": "belt"}, "N m", {"main": (none,)}, 5, models, None, (), (),
            tuple(failures),
        )  # fmt: skip

    def failure(self):
        return SimpleNamespace(
            times=("2", "4"), called="drum", size_sigma=7.6, t_start=2.0, t_stop=4.0, body="main"
        )

    def test_the_first_body_is_the_main_one(self):
        v = self.view()
        assert (v.main, v.body, v.intervals) == ("main", "drum", ())

    def test_intervals_of_torques_are_before_those_of_speeds(self):
        v = self.view([self.failure()], residual=0.2)
        torque, *speeds = v.intervals
        assert (torque.start, torque.stop, torque.text, torque.body) == (2.0, 4.0, "2–4 s, drum, 8 σ", "main")
        assert [(i.start, i.stop) for i in speeds] == [(-0.5, 1.5), (4.5, 10.5)]
        assert speeds[0].text == "-0.5–1.5 s, speed of the drum, 20 σ"
        assert v.speed_intervals == tuple(speeds)

    def test_a_torque_on_a_body(self):
        added = AddedTorque("a", T, T, {"main": T, "other": 2 * T})
        assert added.on("other")[-1] == 20.0
