"""Rotor windows with uncertain start times."""

from dataclasses import replace

import numpy as np
import pytest
import twobody
from numpy.polynomial import Polynomial

from fitting import REDUCED, Model, fit, make_record
from fitting.inference._case_data import CaseData, StartTimeNoise, rate_of_change, start_response
from fitting.inference._record import Samples

LATE = 1e-3
TRUTH = {"touchpoint.constant.b1": 3e-6, "casing.air.linear.b2": 3.7e-7, "bearing.linear.d": 3.2e-8}
GYROSCOPE = {"a2": 1.97e-10, "b1": 3e-6, "b2": 3.7e-7, "d": 3.2e-8, "f": 4.86e-7, "g": 0.62}


def filmed(seed, known=False, quantity="angle"):
    """Return a recording whose windows were each put on the casing's clock with an error of LATE."""
    span = 60.0
    motion = twobody.simulate(GYROSCOPE, start=(566.0, 25.0), span=span, seed=seed)
    cameras = twobody.Cameras(span=span, windows=(2.0, 12.0, 25.0, 40.0, 52.0), sigma=1e-3, quantity=quantity)
    film = twobody.film(motion, seed=seed, cameras=cameras)
    late = np.random.default_rng([seed, 5]).normal(0, LATE, len(film["rotor"]))
    film["rotor"] = [(t + dt, y, s) for (t, y, s), dt in zip(film["rotor"], late, strict=True)]
    return make_record(**film, start_sigma=() if known else [LATE] * len(late))


def test_the_rate_of_change_is_that_of_the_motion():
    t = np.linspace(3.0, 5.0, 400)
    sigma = np.full(400, 1e-3)
    angle = 7 + 400 * t - 0.5 * 6.5 * t**2 + 0.3 * t**3 - 0.02 * t**4
    speed = 400 - 6.5 * t + 0.9 * t**2 - 0.08 * t**3
    nodes = np.array([3.1, 4.0, 4.7])
    found = rate_of_change(Samples(t, angle, sigma), nodes, degree=4)
    np.testing.assert_allclose(found, 400 - 6.5 * nodes + 0.9 * nodes**2 - 0.08 * nodes**3, rtol=1e-7)
    found = rate_of_change(Samples(t, speed, sigma), nodes, degree=3)
    np.testing.assert_allclose(found, -6.5 + 1.8 * nodes - 0.24 * nodes**2, rtol=1e-7)


@pytest.mark.parametrize(
    ("count", "degree"), [(1, 0), (2, 0), (3, 1), (4, 1), (5, 2), (8, 3), (9, 4), (12, 4)]
)
def test_the_rate_of_change_of_few_samples_does_not_follow_their_noise(count, degree):
    t = np.arange(count) / 10
    value = 30 * t + np.random.default_rng(0).normal(0, 1e-2, count)
    found = rate_of_change(Samples(t, value, np.full(count, 1e-2)), t, degree=4)
    expected = Polynomial.fit(t, value, degree).deriv()(t) if degree else np.zeros(count)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_determinant_is_that_of_the_covariance_of_the_rows():
    u, size = np.array([0.6, 0.8]), 3.0
    noise = StartTimeNoise(((slice(1, 3), u, size), (slice(3, 4), np.ones(1), 0.5)))
    covariance = np.eye(4)
    covariance[1:3, 1:3] += size**2 * np.outer(u, u)
    covariance[3, 3] += 0.25
    assert noise.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])
    white = noise.whitened(noise.whitened(np.eye(4)).T)
    np.testing.assert_allclose(np.linalg.inv(covariance), white, atol=1e-12)


@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_an_error_of_the_start_changes_rows_by_the_curved_motion(quantity):
    """A window of a light rotor decelerates by different amounts at its ends; a line in time does not describe it."""
    data = CaseData.of(filmed(0, known=True, quantity=quantity))
    window = data.rotor[0]
    response = start_response(window, angle=quantity == "angle")
    t, late = window.samples.time, 1e-4
    curve = Polynomial.fit(t, window.samples.value, 4)
    change, _ = window.at_samples(((curve(t - late) - curve(t)) / late)[:, None])
    change = change[:, 0]
    if quantity == "angle":
        zero = window.at_nodes(np.ones_like(window.node_times))
        change, response = (x - zero * (zero @ x) / (zero @ zero) for x in (change, response))
    assert np.abs(change + response).max() < 0.01 * np.abs(response).max()


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_rows_are_white_with_the_noise_of_the_starts(quantity):
    """The covariance of the rows, by drawing starts and samples, is one."""
    data = CaseData.of(filmed(0, quantity=quantity))
    window, where = data.rotor[0], slice(len(data.casing.z), len(data.casing.z) + len(data.rotor[0].z))
    rng = np.random.default_rng(1)
    shifts = rng.normal(0, LATE, 4000)
    c = start_response(window, angle=quantity == "angle")
    rows = np.zeros((len(data.z), 4000))
    rows[where] = rng.standard_normal((len(window.z), 4000)) + np.outer(c, shifts)
    white = data.start_time_noise.whitened(rows)[where]
    assert np.abs(np.cov(white) - np.eye(len(white))).max() < 0.1
    assert np.abs(np.cov(rows[where])).max() > 10
    again = data.start_time_noise.unwhitened(data.start_time_noise.whitened(rows))
    np.testing.assert_allclose(again, rows, rtol=1e-9, atol=1e-9)


def test_windows_with_known_starts_are_unchanged():
    data = CaseData.of(filmed(0, known=True))
    assert data.start_time_noise == StartTimeNoise(())
    assert len(CaseData.of(replace(data.record, start_sigma=(0.0, 1e-3, 0.0))).start_time_noise.parts) == 1


@pytest.mark.slow
@pytest.mark.release
def test_uncertain_window_starts_are_not_missing_effect():
    """Start times wrong by a millisecond give a lack of fit if they count as exact, and none if uncertain."""
    model = Model.of(REDUCED)
    for seed in range(3):
        exact = fit(model, [CaseData.of(filmed(seed, known=True))])
        found = fit(model, [CaseData.of(filmed(seed))])
        assert exact.lack_of_fit.p_value < 0.1 < found.lack_of_fit.p_value
        assert exact.lack_of_fit.chi2 > 5 * found.lack_of_fit.chi2
        assert found.verdict == "no_lack_of_fit"
        assert found.cases[0].rotor.reduced_chi2 == pytest.approx(1.0, abs=0.2)
        for key, true in TRUTH.items():
            assert abs(found.estimates[key].value - true) < 4 * found.estimates[key].stderr


@pytest.mark.slow
@pytest.mark.release
def test_uncertainties_agree_with_the_scatter_of_many_recordings():
    pulls = []
    for seed in range(10, 22):
        found = fit(Model.of(REDUCED), [CaseData.of(filmed(seed))])
        pulls += [(found.estimates[k].value - v) / found.estimates[k].stderr for k, v in TRUTH.items()]
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.3
