"""A torque that is periodic in the angle: recordings of angles, and of angular speeds, whose integral is the angle."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fitting
from fitting import fit, make_record
from fitting.inference._case_data import CaseData

SIGMA = {"omega": np.radians(0.5), "angle": 2e-3}
BASE = ("touchpoint.constant", "casing.air.linear")
FRICTION, DRAG = 0.08, 0.012


def wheel(strength, seed, *, order=1, drag=DRAG, quadratic=0.0, quantity="omega", step=0.01):
    """Return the record of speeds or angles of a wheel with an eccentric mass, and the phase of the torque."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(-np.pi, np.pi)
    time = np.arange(0, 60, step)

    def rates(_, y):
        psi, omega = y
        brake = FRICTION + drag * omega + quadratic * omega**2
        return [omega, strength * np.sin(order * psi - phase) - brake]

    motion = solve_ivp(rates, (0, 60), [0, 14.0], t_eval=time, rtol=1e-10, atol=1e-10, max_step=0.05).y
    sigma = np.full(len(time), SIGMA[quantity])
    values = motion[int(quantity == "omega")] + sigma * rng.standard_normal(len(time))
    record = make_record(
        casing=(time, values, sigma), rotor=[], I_rotor=1.0, I_casing=1.0, single=True, quantity=quantity
    )
    return record, phase


def pulls(found, strength, phase, effect="casing.unbalance"):
    """Return the errors of all parameters in standard errors."""
    true = {
        "touchpoint.constant.b1": FRICTION,
        "casing.air.linear.b2": DRAG,
        f"{effect}.k": strength,
        f"{effect}.phi": phase,
    }
    errors = []
    for name, value in true.items():
        estimate = found.estimates[name]
        error = estimate.value - value
        if name.endswith("phi"):
            error = (error + np.pi) % (2 * np.pi) - np.pi
        errors.append(error / estimate.stderr)
    return np.array(errors)


@pytest.mark.parametrize(("effect", "order"), [("casing.unbalance", 1), ("casing.asymmetry", 2)])
@pytest.mark.slow
def test_strong_periodic_torque_does_not_count_as_noise(effect, order):
    record, phase = wheel(1.1, 0, order=order)
    data = CaseData.of(record)
    base = fit(fitting.Model.of(BASE), [data])
    found = fit(fitting.Model.of([*BASE, effect]), [data])
    # the amplitude k / omega of 0.08 to 0.35 rad/s is known to 0.009 rad/s in each of 6000 samples
    assert found.estimates[f"{effect}.k"].stderr < 3e-3
    assert np.abs(pulls(found, 1.1, phase, effect)).max() < 4
    # the integral of 60 s has an error of sigma sqrt(0.01 s x 60 s) = 0.0068 rad at its end, the slowest part
    assert 0.004 < found.estimates[f"{effect}.phi"].stderr / order < 0.0068
    assert found.noise[0].pure < 0.01
    assert base.reduced_chi2 > 40
    assert found.reduced_chi2 == pytest.approx(1, abs=0.05)


def test_strong_periodic_torque_is_not_correlated_angle_noise():
    record, phase = wheel(1.1, 0, quantity="angle", step=0.05)
    data = CaseData.of(record)
    found = fit(fitting.Model.of([*BASE, "casing.unbalance"]), [data])
    # one amplitude k / omega^2 of 6 to 70 mrad, measured by 1200 angles with 2 mrad each
    assert 0.0015 < found.estimates["casing.unbalance.k"].stderr < 0.01
    assert found.estimates["casing.unbalance.phi"].stderr < 0.01
    assert np.abs(pulls(found, 1.1, phase)).max() < 4
    assert data.angle_noise.is_white
    assert found.reduced_chi2 == pytest.approx(1, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strength", "step", "shown"), [(1.1, 0.03, True), (0.0, 0.01, False), (0.0, 0.03, False)]
)
@pytest.mark.release
def test_harmonics_are_free_only_where_the_angle_shows_a_torque(strength, step, shown):
    # blocks of a second hold less than two turns: most rows of harmonics are polynomials, and empty
    record, _ = wheel(strength, 1, quantity="angle", step=step)
    assert CaseData.of(record).harmonic_responses.any() == shown


@pytest.mark.slow
@pytest.mark.parametrize(("strength", "quantity"), [(1.1, "omega"), (0.03, "omega"), (1.1, "angle")])
@pytest.mark.release
def test_standard_errors_are_those_of_repeats(strength, quantity):
    errors = []
    for seed in range(6):
        record, phase = wheel(
            strength, 100 + seed, quantity=quantity, step=0.01 if quantity == "omega" else 0.05
        )
        found = fit(fitting.Model.of([*BASE, "casing.unbalance"]), [record])
        errors.append(pulls(found, strength, phase))
    # rms of 6 normal deviates
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < 1.8).all()
    assert np.sqrt(np.mean(np.square(errors))) > 0.6


@pytest.mark.slow
@pytest.mark.release
def test_no_periodic_torque_is_named_where_there_is_none():
    named = []
    for seed in range(3):
        record, _ = wheel(0.0, 200 + seed)
        found = fitting.diagnose(fit(fitting.Model.of(BASE), [record]))
        named += [c.effect.name for c in found.candidates[:1]] if found.verdict != "adequate" else []
    # a family-wise threshold of 5 % in 3 recordings: two are named in one of 140 such tests
    assert len(named) <= 1
    assert "casing.unbalance" not in named
