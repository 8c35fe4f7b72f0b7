"""Laws outside the library: formula, parameters and variable; none in data of the model."""

import math
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
import twobody
from cases import case, fitted
from linearised import gyroscope

from fitting import (
    LINEAR,
    REDUCED,
    EffectError,
    Fit,
    Model,
    diagnose,
    improve,
    laws,
    make_record,
    read_effects,
)
from fitting._criteria import DEFAULT
from fitting._workers import WorkerPool
from fitting.discovery import _dependence
from fitting.discovery._dependence import context_without, dependence
from fitting.discovery._difference import different_parameter
from fitting.discovery._lack_of_fit import UNKNOWN_LAWS
from fitting.discovery._score import CaseColumns, ScoreContext
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR
from fitting.effects._library import find
from fitting.effects._user import resolve
from fitting.inference._fit import fit
from fitting.inference._noise import WHITE
from fitting.law_search import _laws
from fitting.law_search._documents import check_name, laws_document, save_law
from fitting.law_search._laws import Law, Laws, library_answer, ranges_of, with_classes
from fitting.study._serialisation import history_verdict, restored_diagnosis, stored_diagnosis

K, W = 3e-6, 40.0
SATURATING = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -K * math.tanh(wc / W))


@lru_cache(maxsize=1)
def saturating():
    base = fit(Model.of(REDUCED), [case({}, 0, "a", hidden=SATURATING)])
    return base, laws(base)


@pytest.mark.parametrize(
    ("remainder", "others", "level", "stops"),
    [
        (None, (), 1e-9, True),
        (None, ("a.b",), 1e-9, True),
        (None, (), 6e-9, True),
        (None, (), 3e-8, False),
        (None, (UNKNOWN_LAWS["omega_c"],), 1e-9, False),
        ("a significant remainder", (), 1e-9, False),
    ],
)
def test_the_library_is_the_answer_only_without_an_equivalent_unknown_law(remainder, others, level, stops):
    """The library is no answer if an unknown law, or process noise above that of the recording, explains the data."""
    noise = (SimpleNamespace(level=level, pure=2e-9, pure_u=2e-9),)
    known_fit = SimpleNamespace(noise=noise)
    known_fit.has_excess_noise = lambda criteria: Fit.has_excess_noise(known_fit, criteria)
    artefact = SimpleNamespace(indistinguishable_from=(), fit=None, physical=False, significant=True)
    candidate = SimpleNamespace(indistinguishable_from=others, fit=known_fit, physical=True, significant=True)
    known = SimpleNamespace(verdict="missing_effect", remainder=remainder, candidates=(artefact, candidate))
    assert (library_answer(known) is candidate) is stops


def test_a_search_without_a_law_says_whether_added_effects_may_hide_it():
    depends = SimpleNamespace(p_value=1e-9, words="the speed of the casing (torque on the casing)")
    plain, improved = Model.of(REDUCED), Model.of([*REDUCED, "casing.brake.eddy"])
    said = _laws._nothing_sentence(improved, [depends], DEFAULT)
    assert "depends on the speed of the casing" in said
    assert "casing.brake.eddy" in said
    assert "--from" in said
    assert "--from" not in _laws._nothing_sentence(plain, [depends], DEFAULT)
    depends.p_value = 0.5
    assert "nothing beyond noise" in _laws._nothing_sentence(improved, [depends], DEFAULT)


def predicting(*rows, bic=0.0):
    """Return the attributes of a fit that the grouping of laws uses: predicted rows, and one nuisance column."""
    nuisance = np.eye(4)[:, :1]
    return SimpleNamespace(
        problem=SimpleNamespace(data=[SimpleNamespace(nuisance=nuisance) for _ in rows]),
        noise=[SimpleNamespace(whitener=WHITE) for _ in rows],
        predictions=[SimpleNamespace(rows=np.array(r)) for r in rows],
        bic=bic,
    )


def test_the_separation_of_two_fits_is_their_distance_in_sigma_squared_without_nuisance_parameters():
    one = predicting([0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 2.0])
    other = predicting([500.0, 3.0, 0.0, 0.0], [0.0, 0.0, 4.0, 2.0])
    assert _laws._separation(one, one) == 0
    assert _laws._separation(one, other) == pytest.approx(3.0**2 + 4.0**2)


def test_formulas_with_the_same_torque_along_the_motion_are_grouped(monkeypatch):
    monkeypatch.setattr(_laws, "_difference", lambda one, other: None)

    def law(formula, row, bic):
        fit_ = predicting([0.0, row, 0.0, 0.0], bic=bic)
        return Law(formula, "", (), 0.0, 0.0, 0.0, 0.0, 0.0, {}, (), (), (), fit_)

    # the equivalence width is 10: the last one is outside; two deviances of less than 2 make the same torque
    found = [
        law("a", 0.0, 0.0),
        law("b", 5.0, 1.0),
        law("c", 1.3, 2.0),
        law("d", 1.5, 3.0),
        law("e", 0.0, 11.0),
    ]
    answer = Laws(None, "law", "", with_classes(found, DEFAULT), None, (), "", 0)
    assert [x.formula for x in answer.answer] == ["a", "b", "c", "d"]
    assert [[x.formula for x in group] for group in answer.torques] == [["a", "c"], ["b"], ["d"]]
    assert answer.laws[2].same_torque_as == ("a",)
    assert answer.laws[4].indistinguishable_from == ()


@pytest.mark.slow
@pytest.mark.release
def test_a_saturating_drag_is_found_with_its_parameters():
    _, found = saturating()
    assert found.verdict == "law"
    best = found.laws[0]
    assert best.formula == "casing: -k*tanh(omega_c/w)"
    assert len(found.answer) <= 5
    values = {k.rpartition(".")[2]: e for k, e in best.estimates.items()}
    for symbol, true in (("k", K), ("w", W)):
        assert abs(values[symbol].value - true) < 4 * values[symbol].stderr
        assert values[symbol].stderr < 0.01 * true
    speed = np.linspace(5, 160, 500)
    assert 0.5 * K < best.torque_rms_Nm < K * math.tanh(speed.max() / W)
    assert best.p_value < 1e-6
    assert best.fit.verdict == "no_lack_of_fit"


@pytest.mark.release
@pytest.mark.slow
def test_an_effect_of_the_library_is_the_answer_only_if_no_law_is_clearly_better():
    """A law improves on a wrong effect, and none improves on the right one."""
    base, found = saturating()
    search = _laws._Search(base, DEFAULT, WorkerPool(0), _laws._Steps(None))
    right, wrong = found.laws[0].effects[0], find("casing.air.quadratic")
    for effect, improves in ((right, False), (wrong, True)):
        refit = fit(base.model.with_effect(effect), base.problem.data, noise=found.laws[0].fit.noise)
        known = SimpleNamespace(effect=effect, fit=refit, physical=True)
        assert search.improves_on(known) is improves


@pytest.mark.slow
@pytest.mark.release
def test_a_shared_parameter_that_differs_between_recordings_is_named_with_both_values():
    """The same touch point in both recordings is none; one of 4e-6 N m in the second is found, with both values."""
    shared = ["touchpoint.constant.b1", "casing.air.linear.b2"]
    first = case({}, 2, "a", ou=3e-8)
    same, other = (case({"b1": b1}, 3, "b", (740.0, 12.0), ou=3e-8) for b1 in (twobody.PAPER["b1"], 4e-6))
    assert different_parameter(fit(Model.of(REDUCED), [first, same], share=shared), DEFAULT) is None
    base = fit(Model.of(REDUCED), [first, other], share=shared)
    separate = different_parameter(base, DEFAULT)
    found = separate.parameter
    assert found.name == "touchpoint.constant.b1"
    for label, true in (("a", twobody.PAPER["b1"]), ("b", 4e-6)):
        assert abs(found.estimates[label].value - true) < 4 * found.estimates[label].stderr
        assert found.estimates[label].stderr < 0.1 * true
    # errors of the two values are correlated through the parameters that remain shared
    difference = found.differences["b"]
    assert abs(difference.value - (4e-6 - twobody.PAPER["b1"])) < 4 * difference.stderr
    assert difference.stderr < np.hypot(*(e.stderr for e in found.estimates.values()))
    assert found.p_value < 1e-6
    assert found.delta_bic < -20
    document = laws_document(Laws(base, "parameter", "", (), None, (), "", 0, None, found), "f1")
    assert document["differs"]["parameter"] == found.name
    assert document["differs"]["values"]["b"]["value"] == found.estimates["b"].value
    assert document["differs"]["differences"]["b"]["stderr"] == difference.stderr
    # whatever law might imitate the difference is worse
    search = _laws._Search(base, DEFAULT, WorkerPool(0), _laws._Steps(None))
    assert not search.improves_on_difference(separate, ())
    # the diagnosis says so, and the history goes on from the fit with both values
    diagnosis = diagnose(base)
    assert (diagnosis.verdict, diagnosis.differs.name, diagnosis.form) == ("unexplained", found.name, None)
    assert "--per-case touchpoint.constant.b1" in diagnosis.sentence
    restored = restored_diagnosis(stored_diagnosis(diagnosis), base)
    assert restored.differs == diagnosis.differs
    history = improve(base, first=diagnosis.candidates)
    assert [s.change for s in history] == ["", f"+{found.name} per recording"]
    assert history[-1].fit.verdict == "no_lack_of_fit"
    assert history_verdict(history) == "adequate"


@pytest.mark.slow
def test_the_torque_depends_on_the_speed_of_the_casing():
    _, found = saturating()
    first = found.depends_on[0]
    assert "omega_c" in first.variable
    (own,) = (d for d in found.depends_on if (d.variable, d.body) == ("omega_c", "casing"))
    assert own.explained > 0.99
    # the curve and the true law agree, both without what the base can represent
    true = own.comparable(-K * np.tanh(own.value / W))
    assert np.all(np.abs(own.torque - true) < 4 * own.sigma + 0.03 * np.abs(true).max())
    assert np.median(own.sigma) < 0.2 * np.abs(true).max()
    assert all(d.explained < own.explained + 1e-3 for d in found.depends_on)


@pytest.mark.slow
def test_the_curve_follows_a_narrow_resonance():
    """A peak of a twentieth of the range of speeds, in process noise: the band covers it and is not too wide."""

    def peak(speed):
        return -4e-6 / (1 + ((speed - 90.0) / 6.0) ** 2)

    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: peak(wc))
    data = case({}, 3, "a", hidden=hidden, ou=3e-8)
    law = resolve("casing: -k/(1 + ((omega_c - w)/u)**2)")
    start = {f"{law.name}.k": 4e-6, f"{law.name}.w": 90.0, f"{law.name}.u": 6.0}
    about = fit(Model.of(REDUCED).with_effect(law), [data], start=start)
    (own,) = (
        d for d in dependence(about, without=[law.name]) if (d.variable, d.body) == ("omega_c", "casing")
    )
    error = own.torque - own.comparable(peak(own.value))
    top = np.abs(own.torque).max()
    assert top > 2.5e-6
    assert abs(own.value[np.argmin(own.torque)] - 90.0) < 3.0
    assert np.sqrt(np.mean((error / own.sigma) ** 2)) < 2.0
    assert np.abs(error).max() < 0.15 * top


def test_the_prior_of_the_curve_is_a_covariance_whose_length_is_that_of_the_axis():
    axis = _dependence._Axis(np.array([0.0, 50.0]), 36)
    values = axis(np.linspace(0, 50, 9))
    assert values.shape == (9, 36)
    assert values.sum(axis=1) == pytest.approx(1.0)
    for prior in axis.priors():
        assert np.diag(prior) == pytest.approx(1.0)
        assert np.linalg.eigvalsh(prior)[0] > -1e-9
    # Matern 3/2 between two neighbours in the middle, 50/33 apart
    q = math.sqrt(3) / 33 / _dependence._LENGTHS[0]
    assert axis.priors()[0][17, 18] == pytest.approx((1 + q) * math.exp(-q))


def test_the_angle_of_a_fast_rotor_is_not_tested():
    """At 900 rad/s it turns by 3.5 rad between two frames of 260 Hz."""
    assert _dependence._orders(fitted(), "psi_c") == (1, 2, 3, 4)
    assert _dependence._orders(fitted(), "psi_r") == ()
    slow = SimpleNamespace(
        problem=fitted().problem,
        predictions=[SimpleNamespace(path=SimpleNamespace(y=0.2 * p.path.y)) for p in fitted().predictions],
    )
    assert _dependence._orders(slow, "psi_r") == (1, 2)


@pytest.mark.slow
def test_a_saved_law_fits_as_an_effect(tmp_path):
    base, found = saturating()
    file = tmp_path / "lab.toml"
    save_law(found.laws[0], "lab.saturation", file, "a test")
    save_law(found.laws[1], "lab.other", file, "a test")
    effects = read_effects(file)
    assert [e.name for e in effects] == ["lab.saturation", "lab.other"]
    with pytest.raises(EffectError, match="already"):
        check_name("lab.saturation", file)
    again = fit(base.model.with_effect(effects[0]), base.problem.data)
    assert again.verdict == "no_lack_of_fit"
    assert again.estimates["lab.saturation.w"].value == pytest.approx(W, rel=0.01)
    document = laws_document(found, "f1")
    assert document["laws"][0]["terms"] == [{"body": "casing", "law": "-k*tanh(omega_c/w)", "rate": ""}]
    assert {"formula", "body", "score", "delta_bic", "p_value", "parameters", "torque_rms_Nm"} <= set(
        document["laws"][0]
    )


@pytest.mark.slow
@pytest.mark.release
def test_no_law_is_found_in_data_of_the_model():
    found = laws(fitted())
    assert found.verdict == "none"
    assert found.laws == ()
    assert min(d.p_value for d in found.depends_on) > 0.01


def test_invalid_names_of_laws_are_refused(tmp_path):
    for name in ("9lives", "casing.windage", "a b"):
        with pytest.raises(EffectError):
            check_name(name, tmp_path / "lab.toml")


def test_a_removed_law_gives_the_residual_of_a_fit_without_it():
    """To first order: the torque rows that are added back are the derivative by the strength times the strength."""
    base = fitted()
    law = resolve("casing: -k*omega_c**3")
    cases = [CaseColumns(base, 0)]
    unit = cases[0].trials(law, [{}])[0].columns
    found = fit(base.model.with_effect(law), base.problem.data, noise=base.noise)
    out = context_without(found, [law], [CaseColumns(found, 0)])
    k = found.estimates[f"{law.name}.k"].value
    plain = ScoreContext(found, 1)
    expected = plain.rotated(unit[:, 0] * k)
    added = out._residual - plain._residual
    assert np.linalg.norm(added - expected) < 0.01 * np.linalg.norm(expected)
    assert ranges_of(base)["omega_c"][1] == pytest.approx(160, rel=0.3)


@pytest.mark.slow
def test_no_dependence_is_significant_in_null_data():
    for seed in (1, 2):
        assert min(d.p_value for d in dependence(fitted(seed, few=True))) > 0.005


@pytest.mark.slow
@pytest.mark.release
def test_a_saturating_drag_of_a_single_body_is_found():
    """A law that replaces another changes the friction of the base by as much: the refit starts at these values."""
    from scipy.integrate import solve_ivp

    t = np.arange(0, 120, 0.01)
    motion = solve_ivp(
        lambda _, y: [y[1], -0.02 - 0.012 * y[1] - 0.15 * math.tanh(y[1] / 5)],
        (0, 120), [0.0, 40.0], t_eval=t, rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    angle = motion.y[0] + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    sigma = np.full(len(t), 1e-3)
    record = make_record(casing=(t, angle, sigma), rotor=[], I_rotor=1.0, I_casing=1.0, single=True)
    base = fit(Model.of(REDUCED).of_bodies({"casing"}), [record])
    best = laws(base).laws[0]
    assert best.formula == "casing: -k*tanh(omega_c/w)"
    for name, true in {"touchpoint.constant.b1": 0.02, "casing.air.linear.b2": 0.012}.items():
        assert best.fit.estimates[name].value == pytest.approx(true, rel=0.01)
    assert {k.rpartition(".")[2]: e.value for k, e in best.estimates.items()} == pytest.approx(
        {"k": 0.15, "w": 5.0}, rel=0.01
    )


@pytest.mark.slow
@pytest.mark.release
def test_a_brake_that_is_switched_on_is_found_and_its_torque_is_that_of_the_motion():
    """The brake k omega acts from 30 s on; speed and angle are those of two exponentials."""
    b1, b2, k, moment, first = 0.3, 0.004, 0.15, 30.0, 60.0

    def decaying(since, drag, speed):
        limit = -b1 / drag
        gone = np.exp(-drag * since)
        return limit + (speed - limit) * gone, limit * since + (speed - limit) * (1 - gone) / drag

    t = np.arange(0, 50, 0.02)
    early, late = t[t < moment], t[t >= moment]
    speed, turned = decaying(moment, b2, first)
    angle = np.concatenate(
        [decaying(early, b2, first)[1], turned + decaying(late - moment, b2 + k, speed)[1]]
    )
    angle = angle[: int(np.argmax(angle))]
    noise = 3e-3 * np.random.default_rng(3).standard_normal(len(angle))
    samples = (t[: len(angle)], angle + noise, np.full(len(angle), 3e-3))
    record = make_record(casing=samples, rotor=[], I_rotor=1.0, I_casing=1.0, single=True)
    base = fit(Model.of(REDUCED).of_bodies({"casing"}), [record])
    answer = diagnose(base)
    assert answer.verdict == "unexplained"
    # the true torque is k times a speed below 60 rad/s
    assert 0 < answer.remainder.torque_rms_Nm < k * first
    best = laws(base, diagnosis=answer).laws[0]
    assert best.formula == "casing: -k*heaviside(t - t0)*omega_c"
    for name, true in {"k": k, "t0": moment}.items():
        (estimate,) = (e for n, e in best.estimates.items() if n.endswith(f".{name}") or f".{name}@" in n)
        assert abs(estimate.value - true) < 4 * estimate.stderr
        assert estimate.stderr < 1e-3 * true


def test_the_torque_of_a_law_is_the_rms_over_the_times_of_all_cases():
    """A drag that is three times as large in the second case."""
    drag, cases = "casing.air.quadratic", ("a", "b")
    strengths = {f"{drag}.k@a": 1e-9, f"{drag}.k@b": 3e-9}
    found = gyroscope((*LINEAR, drag), strengths, cases=cases, per_case=[drag])
    squares = []
    for k, data, p in zip(strengths.values(), found.problem.data, found.predictions, strict=True):
        omega = Sampler(p.path.mesh, np.linspace(*data.record.span, 3000)).value(p.path.y)[:, 1]
        squares.append(np.mean(k**2 * omega**4))
    expected = math.sqrt(np.mean(squares))
    assert _laws._torque_rms(found, [find(drag)]) == pytest.approx(expected, rel=1e-3)
    assert abs(np.mean(np.sqrt(squares)) / expected - 1) > 0.05


def test_net_torques_are_along_the_motion_of_another_fit_with_the_own_further_states(monkeypatch):
    """Speeds of the other fit, a temperature of the own one; torques are inertias times accelerations."""

    class Sampler(SimpleNamespace):
        def value(self, y):
            return y

    def made(y):
        dynamics = SimpleNamespace(rates=lambda t, y, numbers: asked.append(y) or 10.0 * y)
        return SimpleNamespace(
            theta=None,
            predictions=[SimpleNamespace(path=SimpleNamespace(mesh=None, y=np.array(y)))],
            problem=SimpleNamespace(
                layout=SimpleNamespace(numbers=lambda theta, case: {INERTIA_ROTOR: 2.0, INERTIA_CASING: 3.0}),
                cases=[SimpleNamespace(dynamics=dynamics)],
            ),
        )

    asked = []
    monkeypatch.setattr(_laws, "Sampler", lambda mesh, times: Sampler())
    found, along = (
        made([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        made([[7.0, 8.0, 9.0, 0.5], [0.1, 0.2, 0.3, 0.4]]),
    )
    torques = _laws.net_torques(found, along, 0, np.arange(2.0))
    assert asked[0].tolist() == [[7.0, 8.0, 3.0], [0.1, 0.2, 6.0]]
    assert torques == pytest.approx(np.array([[140.0, 2.0], [240.0, 6.0]]))
