"""Criteria that determine what is noise reach the recordings, also through a search with other criteria."""

import ast
import math
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fitting
from fitting import Criteria, Estimate, Fit, Model, diagnose, make_record
from fitting._criteria import NOISE
from fitting.discovery import _verdict
from fitting.inference._case_data import CaseData
from fitting.inference._fit import measured_with
from fitting.inference._slips import as_measured

PACKAGE = Path(fitting.__file__).parent
TURN = 2 * np.pi


@cache
def wheel(*, sine=0.0, wander=0.0, slip=0, step=0.01):
    """A body that slows down by 0.6 rad/s2, white noise of 1 mrad, and one fault."""
    random = np.random.default_rng(5)
    t = np.arange(0.0, 20.0, step)
    angle = 30.0 * t - 0.3 * t**2 + 1e-3 * random.standard_normal(len(t)) + sine * np.cos(4.3 * t)
    if wander:
        steps = np.zeros(len(t))
        for i, kick in enumerate(random.standard_normal(len(t) - 1)):
            steps[i + 1] = 0.9 * steps[i] + kick
        angle += wander * steps * np.sqrt(1 - 0.81)
    angle[len(t) // 2 :] += slip * TURN
    casing = (t, angle, np.full(len(t), 1e-3))
    return make_record(casing=casing, rotor=[], I_rotor=1.0, I_casing=1.0, single=True, label="wheel")


class TestRecording:
    """Each criterion, on both sides of what the recording shows."""

    def test_spectral_line(self):
        record = wheel(sine=4e-3)
        assert len(CaseData.of(record).spectral_lines) == 1
        assert not CaseData.of(record, Criteria(spectral_line=0.0)).spectral_lines

    @pytest.mark.slow
    def test_correlated_noise(self):
        record = wheel(wander=5e-3, step=0.05)
        shown = CaseData.of(record).angle_noise
        assert shown.is_significant
        strict = CaseData.of(record, Criteria(correlated_noise=shown.gain + 1)).angle_noise
        assert strict.is_white
        just = CaseData.of(record, Criteria(correlated_noise=shown.gain - 1)).angle_noise
        assert just.is_significant
        assert just.needed == shown.gain - 1

    def test_angle_noise_ratio(self):
        record = wheel(wander=5e-3, step=0.05)
        assert not CaseData.of(record).findings
        (finding,) = CaseData.of(record, Criteria(angle_noise_ratio=1.0)).findings
        assert "times their white noise" in finding

    @pytest.mark.parametrize("strict", [Criteria(slip_tolerance=0.0), Criteria(slip_sigma=1e4)])
    def test_slips(self, strict):
        record = wheel(slip=1)
        found = CaseData.of(record)
        assert [s.turns for s in found.slips] == [1]
        assert not CaseData.of(record, strict).slips
        again = found.with_criteria(strict)
        assert not again.slips
        assert again.record.casing.value == pytest.approx(record.casing.value, abs=1e-9)
        assert as_measured(found.record, ()) is found.record

    def test_periodic_torque(self):
        t = np.arange(0.0, 20.0, 0.08)
        angle = 6.0 * t - 0.1 * t**2 + 1e-3 * np.random.default_rng(1).standard_normal(len(t))
        casing = (t, angle + 0.05 * np.sin(angle) / 6.0**2, np.full(len(t), 1e-3))
        record = make_record(casing=casing, rotor=[], I_rotor=1.0, I_casing=1.0, single=True)
        assert not CaseData.of(record, Criteria(periodic_torque=0.0)).harmonic_responses.size
        assert CaseData.of(record, Criteria(periodic_torque=1.0)).harmonic_responses.size


def test_other_thresholds_keep_the_projection_of_a_recording():
    data = CaseData.of(wheel())
    other = Criteria(significance=0.01)
    assert data.with_criteria(other).casing is data.casing
    assert data.with_criteria(other).criteria is other
    assert all(not data.has_noise_of(replace(Criteria(), **{n: getattr(Criteria(), n) / 2})) for n in NOISE)


def speeds():
    t = np.arange(0.0, 20.0, 0.1)
    value = 30.0 - 0.6 * t + 0.01 * np.random.default_rng(2).standard_normal(len(t))
    casing = (t, value, np.full(len(t), 0.01))
    return make_record(casing=casing, rotor=[], I_rotor=1.0, I_casing=1.0, single=True, quantity="omega")


@pytest.mark.slow
def test_a_search_with_other_criteria_of_the_noise_repeats_the_fit(monkeypatch):
    record = wheel(slip=1, step=0.08)
    base = fitting.fit(Model.of(["touchpoint.constant"]), record)
    strict = Criteria(slip_tolerance=0.0)
    assert base.findings
    assert measured_with(base, Criteria(significance=0.01)) is base
    again = measured_with(base, strict)
    assert not again.findings
    assert again.criteria == strict
    asked = []

    def searched(fit, extra, criteria, candidates, history, workers, *, brief):
        asked.append((fit.criteria, criteria, candidates, history))
        return diagnosis

    diagnosis = diagnose(fitting.fit(Model.of(["touchpoint.constant"]), speeds()), brief=True)
    monkeypatch.setattr(_verdict, "_diagnosis", searched)
    found = diagnose(base, criteria=strict, candidates=["of other noise"], history=["of other noise"])
    assert asked == [(strict, strict, None, ())]
    assert [r.purpose for r in found.trace] == ["the fit with other criteria of the noise"]
    diagnose(base, candidates=["known"])
    assert asked[1] == (base.criteria, base.criteria, ["known"], ())


def test_the_verdict_of_a_fit_is_by_its_own_criteria():
    record = speeds()
    model = Model.of(["touchpoint.constant", "casing.air.linear"])
    usual = fitting.fit(model, record)
    assert usual.verdict == "no_lack_of_fit"
    assert fitting.fit(model, record, criteria=Criteria(lack_of_fit=1.0)).verdict == "lack_of_fit"
    sure = fitting.fit(model, record, criteria=Criteria(undetermined=1e-9))
    assert sure.verdict == "not_determined"
    assert usual.undetermined_at(sure.criteria) == sure.undetermined


@pytest.mark.slow
def test_no_module_decides_by_a_default_that_a_caller_cannot_change():
    """`DEFAULT` is the default of an argument or a field only; every field of `Criteria` is used."""
    used, ignored = set(), []
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute):
                used.add(node.attr)
                if isinstance(node.value, ast.Name) and node.value.id == "DEFAULT":
                    ignored.append((path.name, node.attr))
    assert ignored == [("_angle_noise.py", "correlated_noise")]  # of an empty `AngleNoise`
    assert {f.name for f in fields(Criteria)} <= used


@pytest.mark.parametrize(
    ("limit", "u", "listed"), [(20, 19, False), (20, 21, True), (0.5, 0.4, False), (0.5, 0.6, True)]
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_parameter_is_undetermined_from_its_criterion_on(limit, u, listed, sign):
    """Of an uncertainty over the value; not a phase, an initial value, or one with a prior."""
    names = ("a.k", "a.phi", "b.k@case2", "known.k", "known.k@case2", "initial.omega_c")
    estimates = {k: Estimate(2.0 * sign, 2.0 * u, "1", at_bound=False) for k in names}
    estimates["c.k"] = Estimate(2.0 * sign, math.nan, "1", at_bound=True)
    estimates["d.k"] = Estimate(2.0 * sign, math.inf, "1", at_bound=False)
    priors = None, SimpleNamespace(names=("known.k",))
    found = SimpleNamespace(
        estimates=estimates,
        problem=SimpleNamespace(
            data=[SimpleNamespace(prior=p) for p in priors],
            layout=SimpleNamespace(
                parameter=lambda k: SimpleNamespace(role="phase" if k == "a.phi" else "amplitude")
            ),
        ),
    )
    assert Fit.undetermined_at(found, Criteria(undetermined=limit)) == ["a.k", "b.k@case2"] * listed
