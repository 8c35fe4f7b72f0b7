"""What is shown from the ledger is what was found: the same words, curves and numbers, and only for the same code."""

import json

import numpy as np
import pytest

from fitting import Ledger
from fitting._schema import StoredFit
from fitting.discovery._select import Step
from fitting.inference._case_data import CaseData
from fitting.study import _serialisation as restoring
from gyrotrack import Study
from gyrotrack.plotting._study_data import gather

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def study(story, tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "run.fits.json"
    kept = Study((CaseData.of(story.record),), Ledger(path))
    first = kept.ledger.add(story.rungs[0].fit).fit_id
    recorder = kept.recorder(first, story.rungs[0].fit)
    for step in story.rungs[1:]:
        recorder(step)
    kept.keep_diagnosis(first, story.diagnosis)
    return Study(kept.data, Ledger(path))


def never(*_args, **_kwargs):
    raise AssertionError("this was found before")


def test_fits_are_not_searched_again(story, study, monkeypatch):
    monkeypatch.setattr("fitting.study._history.robust_fit", never)
    for old, new in zip(story.rungs, study.steps_to(None), strict=True):
        assert new.change == old.change
        np.testing.assert_array_equal(new.fit.theta, old.fit.theta)
        assert new.fit.verdict == old.fit.verdict
        assert new.fit.chi2 == pytest.approx(old.fit.chi2, rel=1e-3)
        assert new.fit.bic - old.fit.bic == pytest.approx(0, abs=0.5)
        for k, e in old.fit.estimates.items():
            assert new.fit.estimates[k].stderr == pytest.approx(e.stderr, rel=0.01, nan_ok=True)


def test_a_diagnosis_is_not_made_again(story, study, monkeypatch):
    monkeypatch.setattr("fitting.discovery._verdict.diagnose", never)
    rungs = study.steps_to(None)
    new, old = study.diagnosis(None, rungs[0].fit), story.diagnosis
    for name in ("verdict", "sentence", "failures", "next_experiment"):
        assert getattr(new, name) == getattr(old, name)
    for a, b in zip(new.candidates, old.candidates, strict=True):
        assert (a.effect, a.indistinguishable_from) == (b.effect, b.indistinguishable_from)
        assert repr(a.estimates) == repr(b.estimates)  # which may hold nan
        np.testing.assert_equal(
            (a.score, a.delta_bic, a.p_value, a.held_out_gain),
            (b.score, b.delta_bic, b.p_value, b.held_out_gain),
        )
    for a, b in zip(new.torques, old.torques, strict=True):
        np.testing.assert_allclose(a.torque, b.torque, atol=0.02 * b.sigma.min())


def test_a_report_shows_the_same_curves(story, study):
    rungs = study.steps_to(None)
    new = gather(rungs, study.diagnosis(None, rungs[0].fit))
    old = gather([Step(r.change, r.fit, ()) for r in story.rungs], story.diagnosis)
    assert [s.name for s in new.cases[0].alternatives] == [s.name for s in old.cases[0].alternatives]
    for a, b in zip(new.cases[0].alternatives, old.cases[0].alternatives, strict=True):
        np.testing.assert_allclose(a.on("casing"), b.on("casing"), rtol=1e-9, atol=1e-15)


def test_other_code_finds_anew(study, monkeypatch):
    monkeypatch.setattr(restoring, "fingerprint", lambda: "another")
    entry = study.entry(None)
    assert (
        restoring.restored_fit(
            StoredFit.model_validate(entry.document["restored_from"]), entry.model, study.data
        )
        is None
    )
    assert entry.diagnosis(entry.refit(study.data)) is None


@pytest.mark.slow
def test_damage_is_not_an_error(study):
    entry = study.entry("f1")
    fit = entry.shown(study.data)
    for harm in ({"theta": "x"}, {"theta": [1.0]}, {"noise": [{}]}):
        entry.document["restored_from"] = {**entry.document["restored_from"], **harm}
        assert entry.shown(study.data).verdict == fit.verdict
    entry.document["diagnosis"] = {**entry.document["diagnosis"], "candidates": [{"effect": "none such"}]}
    assert entry.diagnosis(fit) is None


def test_a_ledger_is_plain_json(study):
    json.loads(study.ledger.path.read_text(), parse_constant=never)


def test_shading_covers_every_point_of_a_run_that_leaves_the_band(study):
    rungs = study.steps_to(None)
    view = gather(rungs, study.diagnosis(None, rungs[0].fit)).cases[0]
    residual, band = view.models[0].residuals["casing"][0], view.models[-1].residuals["casing"][0].sigma
    far = np.abs(residual.value) > 5 * band
    shaded = np.zeros(len(far), dtype=bool)
    for i in view.intervals:
        if i.body == "casing":
            shaded |= (residual.time >= i.start) & (residual.time <= i.stop)
    assert far.sum() > 10
    assert shaded[far].all()
    assert not [i for i in view.failing((), view.models[-1]) if i.body == "casing"]
