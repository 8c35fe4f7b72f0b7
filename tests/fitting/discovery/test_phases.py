"""What swings begins at another phase in each recording, and is found all the same."""

import math

import numpy as np
import pytest
import twobody

from fitting.discovery import diagnose, found_starts, rank
from fitting.effects import LIBRARY, REDUCED
from fitting.estimation import fit
from fitting.model import Model
from fitting.record import make_record

STRENGTH, RATE = 4e-6, 530.0
APART, ALIKE = (0.7, 3.3), (0.7, 0.7)
STARTS = ((900.0, 5.0), (740.0, 12.0))


def records(law, phases):
    """Return two recordings in which `law` (omega_c's angle, phase of the precession, phi) swings on the casing."""
    found = []
    for i, (phi, start) in enumerate(zip(phases, STARTS, strict=True)):
        plain = twobody.simulate(start=start, span=120.0, ou=5e-8, seed=i, step=0.01)
        turned = np.concatenate([[0.0], np.cumsum(0.01 * RATE / plain.speed[:-1, 0])])

        def casing(t, wr, wc, pr, pc, phi=phi, turned=turned):
            k = min(int(t / 0.01), len(turned) - 2)
            return STRENGTH * law(pc, turned[k] + (turned[k + 1] - turned[k]) * (t / 0.01 - k), phi)

        motion = twobody.simulate(
            start=start, span=120.0, hidden=twobody.Hidden(casing=casing), ou=5e-8, seed=i, step=0.01
        )
        cameras = twobody.Cameras(span=120.0, windows=(4.0, 50.0, 100.0))
        found.append(make_record(**twobody.film(motion, i, cameras, label=f"case{i + 1}")))
    return found


def unbalance(angle, turned, phi):
    return math.sin(angle - phi)


def precession(angle, turned, phi):
    return math.cos(turned + phi)


def off(estimate, phi):
    return math.remainder(estimate.value - phi, 2 * math.pi) / estimate.stderr


@pytest.mark.parametrize(
    ("name", "law"),
    [("casing.unbalance", unbalance), pytest.param("casing.precession", precession, marks=pytest.mark.slow)],
)
def test_each_recording_has_its_own_phase(name, law):
    answer = diagnose(fit(Model.of(REDUCED), records(law, APART)))
    assert answer.verdict == "missing_effect"
    best = answer.candidates[0]
    assert best.effect.name == name
    assert best.apart
    assert "Each case has a strength and a phase of its own" in answer.sentence
    for i, phi in enumerate(APART, 1):
        k = best.estimates[f"{name}.k@case{i}"]
        assert k.value == pytest.approx(STRENGTH, abs=4 * k.stderr)
        assert abs(off(best.estimates[f"{name}.phi@case{i}"], phi)) < 4
    assert f"{name}.m" in best.estimates or name == "casing.unbalance"


def test_one_phase_is_told_as_one():
    (best, *_) = (c for c in rank(fit(Model.of(REDUCED), records(unbalance, ALIKE))) if c.fit is not None)
    assert best.effect.name == "casing.unbalance"
    assert not best.apart
    k, phi = (best.estimates[f"casing.unbalance.{s}"] for s in ("k", "phi"))
    assert k.value == pytest.approx(STRENGTH, abs=4 * k.stderr)
    assert abs(off(phi, ALIKE[0])) < 4


@pytest.mark.slow
def test_what_is_added_by_hand_may_have_phases_of_its_own():
    data = records(precession, APART)
    base = fit(Model.of(REDUCED), data)
    own = ["casing.precession.k", "casing.precession.phi"]
    start = {name: e.value for name, e in base.estimates.items()}
    start |= found_starts(base, [LIBRARY["casing.precession"]])
    found = fit(Model.of((*REDUCED, "casing.precession")), data, start=start, per_case=own)
    assert found.verdict == "adequate"
    assert found.estimates["casing.precession.m"].value == pytest.approx(RATE, rel=1e-3)
