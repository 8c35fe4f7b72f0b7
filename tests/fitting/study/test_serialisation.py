"""Documents of fits: what counts as moved, stored diagnoses and differences, and priors, with known numbers."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from fitting import Case, Certificate, Estimate, LedgerError, fit, load_fit
from fitting.discovery._certificate import Outcome
from fitting.discovery._difference import DifferentParameter, ValuesPerRecording
from fitting.inference._profile import Interval
from fitting.study import _serialisation
from fitting.study._history import Entry
from fitting.study._preparation import CurveBias
from fitting.study._serialisation import fit_document, history_verdict, restored_fit, stored_fit


class TestSteps:
    def fits(self, change, stderr, name="a"):
        new = SimpleNamespace(estimates={name: SimpleNamespace(value=5.0 + change, stderr=stderr)})
        return new, SimpleNamespace(estimates={name: SimpleNamespace(value=5.0, stderr=99.0)})

    @pytest.mark.parametrize(
        ("change", "stderr", "moved"),
        [
            (2.9, 1.0, False),
            (3.1, 1.0, True),
            (-2.9, 1.0, False),
            (-3.1, 1.0, True),
            (0.0, 1.0, False),
            (0.1, -1.0, True),
            (9.0, math.nan, False),
        ],
    )
    def test_a_parameter_moves_by_more_than_three_standard_errors(self, change, stderr, moved):
        assert _serialisation._moved(*self.fits(change, stderr)) == (["a"] if moved else [])

    def test_initial_values_and_new_parameters_do_not_move(self):
        assert _serialisation._moved(*self.fits(9.0, 1.0, "initial.omega_c")) == []
        new, old = self.fits(9.0, 1.0)
        assert _serialisation._moved(new, None) == []
        old.estimates = {}
        assert _serialisation._moved(new, old) == []

    def test_a_history_ends_with_its_last_model(self):
        def step(verdict, *names):
            return SimpleNamespace(fit=SimpleNamespace(verdict=verdict, model=SimpleNamespace(names=names)))

        poor, good = "lack_of_fit", "no_lack_of_fit"
        assert history_verdict([step(good, "a")]) == "adequate"
        assert history_verdict([step(poor, "a"), step(good, "a")]) == "adequate"
        assert history_verdict([step(poor, "a"), step(good, "a", "b")]) == "missing_effect"
        assert history_verdict([step(poor, "a"), step(poor, "a", "b")]) == "unexplained"
        assert history_verdict([step(good, "a"), step(poor, "a", "b")]) == "unexplained"

    @pytest.mark.parametrize(("count", "kept"), [(150, 150), (200, 200), (399, 399), (400, 200), (1000, 200)])
    def test_a_stored_curve_has_about_200_points(self, count, kept):
        t = np.arange(count, dtype=float)
        found = SimpleNamespace(
            label="x", body="rotor", time=t, torque=2 * t, sigma=3 * t, omega_r=7 * t, omega_c=4 * t
        )
        curve = _serialisation._torque(found)
        step = count // kept
        assert curve["time"] == t[::step].tolist()
        assert len(curve["time"]) == kept
        assert curve["torque_Nm"] == (2 * t[::step]).tolist()
        assert curve["sigma_Nm"] == (3 * t[::step]).tolist()
        assert curve["delta"] == (3 * t[::step]).tolist()

    def test_the_document_of_a_step_has_the_difference_of_the_bic(self):
        estimates = {}
        data = [SimpleNamespace(record=SimpleNamespace(body="disc"))]
        same = (
            "samples",
            "n_eff",
            "rmse_casing",
            "rmse_noise",
            "reduced_chi2",
            "misfit",
            "held_out",
            "bic_noise",
        )
        found = SimpleNamespace(
            **{k: i + 1 for i, k in enumerate(same)},
            bic=10.0,
            verdict="lack_of_fit",
            problem=SimpleNamespace(data=data),
            model=SimpleNamespace(names=["a"], effects=()),
            cases=[SimpleNamespace(energy_drift=0.1), SimpleNamespace(energy_drift=0.3)],
            torque_noise=0.7,
            estimates=estimates,
        )
        before = SimpleNamespace(bic=25.0, estimates=estimates)
        step = _serialisation.step_document(found, "f2", "", before)
        assert (step["delta_bic"], step["energy_drift"], step["torque_left_Nm"]) == (-15.0, 0.3, 0.7)
        assert (step["samples"], step["held_out"], step["bic"]) == (1, 7, 10.0)
        assert _serialisation.step_document(found, "f1", "", None)["delta_bic"] == 0.0


@pytest.mark.parametrize(("answers", "alarms", "rate"), [("", 0, 0.0), ("auuam", 3, 0.6), ("aaua", 1, 0.25)])
def test_the_rate_of_alarms_is_that_of_the_null_recordings(answers, alarms, rate):
    verdicts = {"a": "adequate", "u": "unexplained", "m": "missing_effect"}
    outcomes = tuple(
        Outcome("null", "", i, verdicts[v], ("x",) if v == "m" else (), float(i), {})
        for i, v in enumerate(answers)
    )
    found = _serialisation.certificate_document(Certificate(20, "adequate", (), 2.0, outcomes), "f1")
    null = found["null"]
    assert (null["n"], null["alarms"], null["rate"]) == (len(answers), alarms, rate)
    assert null["interval"][0] <= rate <= null["interval"][1]
    assert found["truth"] is None
    assert found["p_empirical"] == pytest.approx((1 + max(len(answers) - 2, 0)) / (1 + len(answers)))


@pytest.fixture(scope="module")
def wheel():
    t = np.linspace(0.0, 10.0, 60)
    noise = 0.01 * np.random.default_rng(0).standard_normal(60)
    return fit(
        "air.linear", Case.from_arrays(wheel={"t": t, "omega": 20.0 * np.exp(-0.1 * t) + noise, "u": 0.01})
    )


class TestDocuments:
    KEY = "casing.air.linear.b2"

    def test_a_fit_has_the_results_of_its_options(self, wheel):
        plain = fit_document(wheel, "f1")
        e = wheel.estimates[self.KEY]
        assert (plain["parameters"][self.KEY]["value"], plain["parameters"][self.KEY]["stderr"]) == (
            e.value,
            e.stderr,
        )
        assert plain["parameters"][self.KEY].get("interval") is None
        assert (plain.get("generated_rotor"), plain.get("predicted"), plain["prior"]) == (None, None, None)
        assert plain["cases"][0]["n_eff"] == wheel.problem.data[0].n_effective
        assert plain["cases"][0]["chi2_per_row"] == wheel.cases[0].chi2_per_row
        interval = Interval(0.05, 0.2, lower_open=False, upper_open=True)
        full = fit_document(wheel, "f1", {self.KEY: interval}, {self.KEY: CurveBias(1.0, 0.5, 4.0, 2.0)}, [])
        found = full["parameters"][self.KEY]["interval"]
        assert (found["lower"], found["upper"], found["lower_open"], found["upper_open"]) == (
            0.05,
            0.2,
            False,
            True,
        )
        assert found["level"] == pytest.approx(0.95)
        assert full["generated_rotor"][self.KEY]["errors"] == 6.0
        assert full["predicted"] == []
        assert full["verdict"] == wheel.verdict

    def test_a_search_that_has_not_converged_has_no_uncertainty(self, wheel):
        stopped = replace(wheel, converged=False)
        found = fit_document(stopped, "f1")
        assert found["verdict"] == "not_converged"
        assert math.isnan(found["parameters"][self.KEY]["stderr"])
        assert found["first_order"] == []

    def test_a_stored_fit_is_restored_with_its_code_only(self, wheel):
        stored = stored_fit(wheel)
        again = restored_fit(stored, wheel.model, wheel.problem.data)
        assert again.theta.tolist() == wheel.theta.tolist()
        assert again.deviance == pytest.approx(wheel.deviance)
        assert again.estimates[self.KEY].stderr == pytest.approx(wheel.estimates[self.KEY].stderr)
        other = stored.model_copy(update={"code": "x"})
        assert restored_fit(other, wheel.model, wheel.problem.data) is None

    def test_a_saved_fit_is_read_with_its_numbers(self, wheel, tmp_path):
        wheel.save(tmp_path / "fit.json")
        found = load_fit(tmp_path / "fit.json")
        assert found.values == pytest.approx(wheel.values)
        assert (found.chi2, found.bic, found.rows) == pytest.approx((wheel.chi2, wheel.bic, wheel.rows))
        assert found.covariance == pytest.approx(wheel.covariance)
        assert found.variables == wheel.variables
        document = json.loads((tmp_path / "fit.json").read_text())
        document["names"] = document["names"][1:]
        (tmp_path / "fit.json").write_text(json.dumps(document))
        with pytest.raises(LedgerError, match="size of the covariance"):
            load_fit(tmp_path / "fit.json")


class TestPriors:
    KNOWN: ClassVar = {
        "fit_id": "f1", "model": [], "parameters": {}, "digests": ["d"], "verdict": "x", "variables": ["a", "b"],
        "covariance": [[4.0, 0.5], [0.5, 1.0]], "share": ["s"], "per_case": ["p"],
    }  # fmt: skip

    def test_an_entry_has_the_variables_of_its_covariance(self):
        entry = Entry(self.KNOWN)
        assert (entry.variables, entry.covariance) == (["a", "b"], [[4.0, 0.5], [0.5, 1.0]])
        assert entry.choices == (("s",), ("p",))
        assert entry.digests == ["d"]
        bare = Entry({k: v for k, v in self.KNOWN.items() if k not in ("variables", "covariance")})
        assert (bare.variables, bare.covariance) == ([], [])

    def test_a_stored_prior_is_that_of_the_fit(self):
        prior = {
            "names": ["a", "b"],
            "mean": [1.0, 2.0],
            "covariance": [[4.0, 0.5], [0.5, 1.0]],
            "source": "run (f2)",
        }
        found = Entry(self.KNOWN | {"prior": prior}).prior
        assert (found.names, found.mean, found.source) == (("a", "b"), (1.0, 2.0), "run (f2)")
        assert found.covariance == ((4.0, 0.5), (0.5, 1.0))


def test_a_difference_is_stored_with_bounds_and_shown_without():
    def estimate(value):
        return Estimate(value, 0.5, "N m", at_bound=False, min=0.0, max=9.0)

    values = {"one": estimate(1.0), "two": estimate(3.0)}
    other = ValuesPerRecording("b.c", {"one": estimate(7.0)}, {"two": estimate(8.0)})
    found = DifferentParameter("a.k", values, {"two": estimate(2.0)}, ("z.y",), -12.0, 0.003, (other,))
    assert _serialisation.difference_document(None) is None
    assert _serialisation.shown_difference(None) is None
    stored = _serialisation.difference_document(found)
    assert (stored.parameter, stored.delta_bic, stored.p_value) == ("a.k", -12.0, 0.003)
    assert stored.indistinguishable_from == ["z.y"]
    assert {k: (v.value, v.stderr, v.min, v.max) for k, v in stored.values.items()} == {
        "one": (1.0, 0.5, 0.0, 9.0),
        "two": (3.0, 0.5, 0.0, 9.0),
    }
    assert stored.differences["two"].value == 2.0
    ((more),) = stored.others
    assert (more.parameter, more.values["one"].value, more.differences["two"].value) == ("b.c", 7.0, 8.0)
    shown = _serialisation.shown_difference(found)
    assert shown["values"]["two"]["value"] == 3.0
    assert "max" not in shown["values"]["two"]
    assert (shown["parameter"], shown["others"][0]["parameter"]) == ("a.k", "b.c")


class TestStoredDiagnosis:
    def stored(self, monkeypatch, candidates):
        monkeypatch.setattr(_serialisation, "stored_fit", lambda fit: f"stored {fit.name}")
        monkeypatch.setattr(_serialisation, "own_effects", lambda effects: [e.name for e in effects])
        monkeypatch.setattr(_serialisation, "fingerprint", lambda: "code")
        monkeypatch.setattr(_serialisation, "difference_document", lambda d: f"document of {d}")
        monkeypatch.setattr(
            _serialisation, "StoredDiagnosis", SimpleNamespace(model_validate=lambda known: known)
        )
        found = SimpleNamespace(
            fit=SimpleNamespace(model=SimpleNamespace(names=("a", "b"))), candidates=candidates, differs="difference",
            verdict="missing_effect",
        )  # fmt: skip
        return _serialisation.stored_diagnosis(found, [SimpleNamespace(name="own")])

    def candidate(self, name, *, count=3, fitted=True, physical=True, significant=True):
        fit = SimpleNamespace(name=name, model=SimpleNamespace(names=("x",) * count))
        return SimpleNamespace(
            effect=SimpleNamespace(name=name), fit=fit if fitted else None, physical=physical, significant=significant,
            score=7.0,
        )  # fmt: skip

    def test_the_fits_of_the_first_physical_candidates_are_kept(self, monkeypatch):
        """A fit with free moments of inertia has another model."""
        made = [
            self.candidate("free", count=4), self.candidate("camera", physical=False),
            self.candidate("weak", significant=False),
            self.candidate("none", fitted=False), *(self.candidate(f"c{i}") for i in range(9)),
        ]  # fmt: skip
        found = self.stored(monkeypatch, made)
        fits = {c["effect"]: c["fit"] for c in found["candidates"]}
        kept = [f"c{i}" for i in range(_serialisation._FITS)]
        assert fits == {
            c.effect.name: f"stored {c.effect.name}" if c.effect.name in kept else None for c in made
        }
        first = found["candidates"][0]
        assert (first["own_effects"], first["score"], first["significant"]) == (["free"], 7.0, True)
        assert (found["code"], found["extra"], found["verdict"]) == ("code", ["own"], "missing_effect")
        assert found["differs"] == "document of difference"

    @pytest.mark.parametrize(("code", "extra"), [("other", ["own"]), ("code", []), ("code", ["own", "more"])])
    def test_one_of_other_code_or_effects_is_not_restored(self, monkeypatch, code, extra):
        monkeypatch.setattr(_serialisation, "own_effects", lambda effects: [e.name for e in effects])
        monkeypatch.setattr(_serialisation, "fingerprint", lambda: "code")
        stored = SimpleNamespace(code=code, extra=extra)
        assert _serialisation.restored_diagnosis(stored, None, [SimpleNamespace(name="own")]) is None
