"""Errors of the starts of rotor windows and slipped turns, as alternatives to a missing effect."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import twobody
from cases import data, fitted

from fitting import LIBRARY, REDUCED, Candidate, Model, diagnose, fit, make_record
from fitting._criteria import DEFAULT
from fitting.discovery import _measurement, _select
from fitting.discovery._measurement import StartErrors, starts_are_unknown, with_start_u
from fitting.discovery._score import Score
from fitting.discovery._select import ordered
from fitting.effects._library import START
from fitting.inference._case_data import CaseData
from fitting.inference._record import Samples

UNKNOWN = (np.nan,) * 3
# errors of the starts [s]; a common one would be camera.offset
SHIFTS = (4e-3, -7e-3, 5e-3)


def started_late(record, shifts, start_sigma=UNKNOWN):
    """Return a recording whose windows are stated to start later than they do."""
    windows = tuple(
        Samples(w.time + dt, w.value, w.sigma) for w, dt in zip(record.rotor, shifts, strict=True)
    )
    return replace(record, rotor=windows, start_sigma=start_sigma, digest="")


@cache
def record():
    """Return a recording with few frames: two minutes at 15 per second, and three windows."""
    cameras = twobody.Cameras(span=120.0, windows=(5.0, 58.0, 114.0), casing_rate=15.0, rotor_rate=100.0)
    return make_record(**twobody.film(twobody.simulate(span=120.0), cameras=cameras))


def test_the_fall_is_that_of_two_gaussian_densities():
    """-2 log of N(r; 0, 1 + s^2 C C') against N(r; 0, 1), with the determinant lemma undone."""
    rng = np.random.default_rng(0)
    c, r, s = rng.standard_normal((7, 3)), rng.standard_normal(7), 0.7
    v = np.eye(7) + s**2 * c @ c.T
    white = r @ r
    expected = white - (r @ np.linalg.solve(v, r) + np.linalg.slogdet(v)[1])
    assert _measurement._fall(c.T @ c, c.T @ r, s) == pytest.approx(expected, rel=1e-10)


def test_starts_are_unknown_only_if_nothing_is_stated_about_them():
    for start_sigma, unknown in [(UNKNOWN, True), ((0.0,) * 3, False), ((), False), ((1e-3,) * 3, False)]:
        assert starts_are_unknown([CaseData.of(replace(record(), start_sigma=start_sigma))]) == unknown


@pytest.mark.slow
def test_a_stated_uncertainty_replaces_an_unknown_one_and_keeps_the_noise():
    found = CaseData.of(replace(record(), start_sigma=(np.nan, 2e-3, np.nan)))
    noise = found.process_noise
    stated = found.with_start_u(5e-3)
    assert stated.record.start_sigma == (5e-3, 2e-3, 5e-3)
    assert stated.process_noise is noise
    assert len(stated.start_time_noise.parts) == 3
    assert [i for i, _ in found.start_columns()] == [0, 2]


@pytest.mark.slow
def test_errors_of_starts_are_found_where_nothing_is_stated():
    """The misfit of windows off by 4 to 7 ms: no effect is named, and the errors are those that were made."""
    found = diagnose(fit(fitted().model, [CaseData.of(started_late(data(seed=0, few=True).record, SHIFTS))]))
    first = found.candidates[0]
    assert first.effect is START
    assert found.verdict == "missing_effect"
    assert "--start-u" in found.sentence
    errors = np.array([e.value for e in first.estimates.values()])
    u = np.array([e.stderr for e in first.estimates.values()])
    truth = -np.array(SHIFTS)
    # three errors of which the friction of the bodies absorbs a part, to which the u belongs
    assert (np.abs(errors - truth) < 4 * u).all()
    assert with_start_u(found.fit, 5e-3).verdict == "no_lack_of_fit"


@pytest.mark.parametrize("size", [10.0, 0.01])
def test_the_evidence_for_errors_of_starts_is_that_of_their_refit(size):
    """A base that large errors have bent has too much noise, and the linear fall about it is too small."""
    shifts = tuple(size * s for s in SHIFTS)
    base = fit(Model.of(REDUCED), [CaseData.of(started_late(record(), shifts))])
    starts = StartErrors(base, DEFAULT)
    refitted, about = starts.refit()
    # -2 log of the densities of the rows, whose whitening has the determinant 1 / sqrt(1 + s^2 c'c) for each window
    whitened = [part[2] for part in refitted.problem.data[0].start_time_noise.parts]
    fall = base.deviance - refitted.deviance - sum(np.log1p(x**2) for x in whitened)
    occam = starts.evidence - starts.fall
    assert occam < 0
    assert starts.evidence_of(refitted) == pytest.approx(max(starts.evidence, fall + occam), rel=1e-9)
    truth = -np.array(shifts)
    assert (np.abs(about.errors - truth) < 3 * about.stderrs).all()
    if size == 10.0:
        assert starts.evidence_of(refitted) > 1.2 * starts.evidence
        # the linear estimate about the bent base
        assert (np.abs(starts.errors - truth) > 4 * starts.stderrs).all()
    else:
        assert starts.evidence_of(refitted) < starts.evidence + 3


@pytest.mark.slow
def test_starts_that_are_right_are_not_candidate_of_weight():
    record = replace(data(seed=0).record, start_sigma=UNKNOWN)
    starts = StartErrors(fit(fitted().model, [CaseData.of(record)]), DEFAULT)
    assert starts.p_value > 0.05
    assert starts.evidence < 2


def candidate(effect, delta_bic, **changes):
    none = np.zeros(0)
    screened = Score(effect, -delta_bic, none, ({},), 1, 1, absorbed=False, direction=none, null=none)
    made = Candidate(effect, -delta_bic, delta_bic, 1e-8, np.nan, (), {}, True, screened, object())
    return replace(made, **changes)


WIDTH = DEFAULT.equivalence_width


@pytest.mark.parametrize(
    ("starts", "law", "first"),
    [
        (candidate(START, -30 + 0.9 * WIDTH), -30.0, "camera.start"),
        (candidate(START, -30 + 1.1 * WIDTH), -30.0, "bearing.drift"),
        (candidate(START, -31, significant=False), -30.0, "bearing.drift"),
        (candidate(START, -31, fit=None), -30.0, "bearing.drift"),
    ],
)
def test_unstated_starts_come_first_unless_an_effect_is_better_by_the_width_of_a_class(starts, law, first):
    found = ordered([candidate(LIBRARY["bearing.drift"], law), starts], DEFAULT)
    assert found[0].effect.name == first


@pytest.mark.parametrize(("significant", "refitted"), [(True, True), (False, False)])
def test_measurement_effects_are_refitted_wherever_something_is_significant(significant, refitted):
    """However small their scores: about a base that the fault has bent, a linear score misses it."""
    physical = [e for e in LIBRARY.values() if e.kind == "physical"][: DEFAULT.refit_least + 1]
    laws = [candidate(e, -30.0, p_value=1e-8, significant=significant) for e in physical]
    inertia = candidate(LIBRARY["setup.inertia"], -0.1, p_value=0.9, significant=False)
    assert _select._to_refit([*laws, inertia], DEFAULT)[-1] == refitted


def slipped_case():
    """Return a recording in whose second window a whole turn slipped."""
    record = data(seed=0, few=True).record
    windows = list(record.rotor)
    value = windows[1].value.copy()
    value[700:] += 2 * np.pi
    windows[1] = Samples(windows[1].time, value, windows[1].sigma)
    return replace(record, rotor=tuple(windows), digest="")


@pytest.mark.slow
def test_a_slip_is_named_and_its_fit_is_that_of_the_corrected_angles():
    found = diagnose(fit(fitted().model, [CaseData.of(slipped_case())]))
    assert found.fit.verdict == "no_lack_of_fit"
    assert found.verdict == "missing_effect"
    assert found.candidates[0].effect.name == "camera.slip"
    assert found.sentence.startswith("A whole turn slipped in rotor window 2")
    assert "the model is adequate" not in found.sentence
