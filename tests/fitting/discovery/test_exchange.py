"""An added law that replaces two others is exchanged for them; nothing is exchanged where the data do not decide."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from cases import shared
from scipy.integrate import solve_ivp

from fitting import LIBRARY, Case, Criteria, Model, SimulationError, fit, improve
from fitting._criteria import DEFAULT
from fitting.discovery import _exchange as exchange
from fitting.discovery import _select as module
from fitting.discovery._exchange import exchanges
from fitting.discovery._refine import with_shape_parameter
from fitting.discovery._score import CaseColumns
from fitting.discovery._select import History, Step
from fitting.effects._words import change_name
from fitting.inference._case_data import CaseData
from fitting.study._serialisation import step_document

INERTIA = 2e-3
# torque of each law at the initial speed of 100 rad/s [N m]; the exponents of the speed are 0, 1 and 2
STRENGTHS = {"touchpoint.constant": 3e-3, "casing.air.linear": 4e-3, "casing.air.quadratic": 5e-3}
CONSTANT, LINEAR, QUADRATIC = STRENGTHS
STRIBECK, COOLING, EDDY = "touchpoint.stribeck", "casing.seal.cooling", "casing.brake.eddy"


def slowed(u=0.1, seed=1, label="case"):
    """Return a body that all laws slow down from 100 rad/s, as measured with the uncertainty `u` [rad/s]."""

    def rate(_, y):
        return [-sum(k * (y[0] / 100.0) ** n for n, k in enumerate(STRENGTHS.values())) / INERTIA]

    t = np.linspace(0.0, 20.0, 1000)
    exact = solve_ivp(rate, (0.0, 20.0), [100.0], t_eval=t, rtol=1e-10, atol=1e-9).y[0]
    noise = u * np.random.default_rng(seed).standard_normal(len(t))
    return Case.from_arrays(wheel={"t": t, "omega": exact + noise, "u": u, "inertia": INERTIA}, label=label)


@cache
def measured(u):
    """Return the data of `slowed` with their noise, which is estimated once."""
    return CaseData.of(slowed(u=u).record)


@shared
def fitted(laws, u=0.1, free=""):
    """Return the fit of some laws; the shape constant of the law `free` is a parameter."""
    known = [LIBRARY[n] for n in laws]
    return fit(Model(tuple(with_shape_parameter(e) if e.name == free else e for e in known)), measured(u))


def history(first, last, **options):
    """Return the first and the last model of a search as its steps."""
    return [Step("", fitted(first, u=options.get("u", 0.1)), ()), Step("+a", fitted(last, **options), ())]


def exchanged(first, last, criteria=DEFAULT, **options):
    """Return the next exchange."""
    return module._exchanged(history(first, last, **options), (), criteria)


def exchanges_of(current, name, criteria=DEFAULT):
    """Return the exchanges of a law of a fit, to first order."""
    effects = [e for e in module.applicable_effects(current, ()) if module._is_friction(e)]
    cases = [CaseColumns(current, i) for i in range(len(current.problem.cases))]
    found = exchanges(current, LIBRARY[name], effects, cases, criteria)
    return sorted(found, key=lambda x: x.delta_bic)


ALL = tuple(STRENGTHS)


@pytest.mark.parametrize("u", [pytest.param(0.1, marks=pytest.mark.slow), 1.0])
def test_a_law_that_replaces_two_is_exchanged_for_them(u):
    found = exchanged((LINEAR,), (LINEAR, STRIBECK), u=u)
    assert found.change == f"+{QUADRATIC} +{CONSTANT} instead of {STRIBECK}"
    assert found.is_exchange
    assert set(found.fit.model.names) == set(ALL)
    assert found.fit.converged
    assert found.fit.bic == pytest.approx(fitted(ALL, u=u).bic, abs=0.05)


@pytest.mark.parametrize(("evidence", "taken"), [(4.0, True), (4.8, False)])
def test_an_exchange_needs_evidence(evidence, taken):
    # BIC falls by 4.4
    found = exchanged((LINEAR, QUADRATIC), (LINEAR, QUADRATIC, COOLING), Criteria(evidence=evidence), u=1.0)
    assert (found is not None) is taken
    if taken:
        assert found.change == f"+{CONSTANT} instead of {COOLING}"


@pytest.mark.parametrize(
    ("first", "last", "u"),
    [
        ((LINEAR,), ALL, 0.1),
        ((LINEAR, QUADRATIC), (LINEAR, QUADRATIC, COOLING), 0.1),  # BIC falls by 1.9
        ((CONSTANT,), (CONSTANT, "casing.air.laminar"), 1.0),  # BIC rises
        ((LINEAR, STRIBECK), (LINEAR, STRIBECK), 0.1),  # a law of the user
    ],
)
def test_a_law_is_kept(first, last, u):
    assert exchanged(first, last, u=u) is None


@pytest.mark.parametrize(("u", "taken"), [(1.0, True), (0.03, False)])
def test_a_law_that_is_not_needed_is_removed(u, taken):
    # at the larger noise the linear drag is at its bound and leaves it when the drift is removed
    last = fitted((*ALL, "touchpoint.drift"), u=u)
    assert last.estimates[f"{LINEAR}.b2"].at_bound is (u == 1.0)
    found = exchanged(ALL, (*ALL, "touchpoint.drift"), u=u)
    assert (found is not None) is taken
    if taken:
        assert found.change == "-touchpoint.drift"
        assert set(found.fit.model.names) == set(ALL)


@pytest.mark.parametrize("equal", [exchange._EQUAL, 1.0])
def test_a_free_exponent_is_fixed_again(monkeypatch, equal):
    # the torque of the same law with its usual exponent is nearly equal
    monkeypatch.setattr(exchange, "_EQUAL", equal)
    found = exchanged((LINEAR, CONSTANT), ALL, u=1.0, free=QUADRATIC)
    assert found.change == f"-{QUADRATIC}.n"
    assert f"{QUADRATIC}.n" not in found.fit.estimates
    assert found.fit.bic == pytest.approx(fitted(ALL, u=1.0).bic, abs=0.05)


def test_the_first_order_is_that_of_the_refits():
    current = fitted((LINEAR, QUADRATIC, COOLING), u=1.0)
    first, *_ = exchanges_of(current, COOLING)
    assert [e.name for e in first.laws] == [CONSTANT]
    assert first.refit(current).bic - current.bic == pytest.approx(first.delta_bic, abs=0.1)
    # the levels of noise are those of restricted likelihoods, and the first order takes the most likely ones
    for x in exchanges_of(current, COOLING, Criteria(evidence=0.0)):
        assert x.refit(current).bic - current.bic > x.delta_bic - 0.1


def test_equal_laws_do_not_replace_each_other():
    # a constant torque on a body that does not reverse is a dry friction
    found = exchanges_of(fitted((LINEAR, CONSTANT)), CONSTANT)
    assert found
    assert "external.constant" not in {e.name for x in found for e in x.laws}


def test_a_law_is_exchanged_for_a_simpler_one_that_it_equals():
    """At a high critical speed the braking torque of eddy currents is proportional to the speed."""
    start = fitted(ALL).values
    start |= {f"{EDDY}.k": start[f"{LINEAR}.b2"], f"{EDDY}.w": 9e4}
    current = fit(Model.of((QUADRATIC, CONSTANT, EDDY)), measured(0.1), start=start)
    assert current.estimates[f"{EDDY}.w"].value > 5e4
    (found,) = (x for x in exchanges_of(current, EDDY) if [e.name for e in x.laws] == [LINEAR])
    assert found.delta_bic == pytest.approx(-np.log(current.rows), abs=0.1)


def test_two_laws_are_better_than_an_added_one():
    # with quadratic drag added, BIC falls by 8.5
    current = fitted((LINEAR, CONSTANT), u=1.0)
    assert fitted(ALL, u=1.0).bic < current.bic - 8
    assert all(len(x.laws) < 2 for x in exchanges_of(current, CONSTANT))
    assert any(len(x.laws) == 2 for x in exchanges_of(fitted((LINEAR, STRIBECK), u=1.0), STRIBECK))


@pytest.mark.parametrize(("excess", "taken"), [(1.9, True), (2.9, False)])
def test_a_fall_that_the_noise_causes_does_not_count(monkeypatch, excess, taken):
    # BIC falls by 4.4
    monkeypatch.setattr(module, "deviance_at_noise_of", lambda old, _: old.deviance - excess)
    found = exchanged((LINEAR, QUADRATIC), (LINEAR, QUADRATIC, COOLING), u=1.0)
    assert (found is not None) is taken


@pytest.mark.parametrize(("u", "asked"), [(1.0, True), (0.03, False)])
def test_a_random_torque_is_an_alternative_without_a_lack_of_fit(monkeypatch, u, asked):
    steps = history((LINEAR,), (LINEAR, STRIBECK), u=u)
    assert steps[-1].fit.fails(DEFAULT) == (not asked)
    fall = steps[-1].fit.bic - fitted(ALL, u=u).bic
    for left, taken in ((2.5, True), (1.5, not asked)):
        # the random torque of the old model lowers the deviance, so that BIC falls by `left`
        less = {STRIBECK: fall - left}
        monkeypatch.setattr(
            module,
            "with_random_torque",
            lambda f, _, less=less: SimpleNamespace(deviance=f.deviance - less.get(f.model.names[-1], 0.0)),
        )
        assert (module._exchanged(steps, (), DEFAULT) is not None) is taken


@pytest.mark.slow
def test_a_law_per_recording_counts_for_each():
    both = [CaseData.of(slowed(u=1.0, seed=s, label=str(s)).record) for s in (1, 2)]
    old, new = (fit(Model.of([QUADRATIC, LINEAR, law]), both) for law in (COOLING, CONSTANT))
    assert f"{CONSTANT}.b1@2" in new.estimates
    single = next(
        x for x in exchanges_of(old, COOLING, Criteria(evidence=0.0)) if x.laws == (LIBRARY[CONSTANT],)
    )
    assert single.delta_bic == pytest.approx(new.bic - old.bic, abs=0.2)


def test_an_oscillation_takes_no_part():
    stub = SimpleNamespace(model=SimpleNamespace(effects=(LIBRARY[LINEAR],), names=(LINEAR,), restoring=True))
    base = SimpleNamespace(model=SimpleNamespace(effects=(), names=()))
    assert module._exchanged([Step("", base, ()), Step("+a", stub, ())], (), DEFAULT) is None


class TestImprove:
    def improved(self, monkeypatch, exchanges, fails=False, **options):
        base, kept = fitted((LINEAR,)), []
        steps = [Step(f"-{i}", base, (), is_exchange=True) for i in range(exchanges)]
        monkeypatch.setattr(module, "_improved", lambda *_: History([Step("", base, ())]))

        def next_one(*_):
            if not steps and fails:
                raise SimulationError("the wheel stops and starts too often to be followed")
            return steps.pop(0) if steps else None

        monkeypatch.setattr(module, "_exchanged", next_one)
        found = improve(base, keep=kept.append, **options)
        assert kept == found[1:]
        return [s.change for s in found]

    def test_exchanges_end_the_history(self, monkeypatch):
        assert self.improved(monkeypatch, 0) == [""]
        assert self.improved(monkeypatch, 2) == ["", "-0", "-1"]
        assert self.improved(monkeypatch, 2, exchange=False) == [""]
        assert self.improved(monkeypatch, 1, fails=True) == ["", "-0"]
        assert len(self.improved(monkeypatch, 99)) == 1 + DEFAULT.max_steps

    @pytest.mark.parametrize(
        ("exchanges", "fails", "kept"), [(0, False, True), (1, False, False), (1, True, True)]
    )
    def test_the_reason_of_an_early_end_does_not_apply_after_an_exchange_without_lack_of_fit(
        self, monkeypatch, exchanges, fails, kept
    ):
        base = fitted((LINEAR,))
        stopped = History([Step("", base, ())])
        stopped.stopped = "a random torque"
        steps = [Step("-0", base, (), is_exchange=True)] * exchanges
        monkeypatch.setattr(module, "_improved", lambda *_: stopped)
        monkeypatch.setattr(module, "_exchanged", lambda *_: steps.pop() if steps else None)
        monkeypatch.setattr(type(base), "fails", lambda *_: fails)
        assert improve(base).stopped == ("a random torque" if kept else "")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            f"+{LINEAR} instead of {QUADRATIC}",
            "+ linear air drag of the wheel instead of quadratic air drag of the wheel",
        ),
        (
            f"+bearing.linear +{LINEAR} instead of casing: -k*omega_c",
            "+ viscous friction of the bearing + linear air drag of the wheel instead of law -k*omega_c on the wheel",
        ),
    ],
)  # fmt: skip
def test_an_exchange_is_stated_in_words(change, words):
    assert change_name(change, "wheel") == words
    document = step_document(fitted((LINEAR,)), "f2", change, None)
    assert (document["added"], document["words"]) == (change, words)
