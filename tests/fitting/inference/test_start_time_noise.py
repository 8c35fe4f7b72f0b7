"""Rotor windows with uncertain start times."""

from dataclasses import replace

import numpy as np
import pytest
import twobody

from fitting import REDUCED, Model, fit, make_record
from fitting.inference._case_data import CaseData, StartTimeNoise, acceleration
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


def test_the_acceleration_is_that_of_the_window():
    t = np.linspace(3.0, 5.0, 400)
    angle = Samples(t, 7 + 400 * t - 0.5 * 6.5 * t**2, np.full(400, 1e-3))
    speed = Samples(t, 400 - 6.5 * t, np.full(400, 1e-3))
    assert acceleration(angle, angle=True) == pytest.approx(-6.5, rel=1e-9)
    assert acceleration(speed, angle=False) == pytest.approx(-6.5, rel=1e-9)
    assert acceleration(Samples(t[:1], t[:1], t[:1]), angle=False) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_rows_are_white_with_the_noise_of_the_starts(quantity):
    """The covariance of the rows, by drawing starts and samples, is one."""
    data = CaseData.of(filmed(0, quantity=quantity))
    window, where = data.rotor[0], slice(len(data.casing.z), len(data.casing.z) + len(data.rotor[0].z))
    rng = np.random.default_rng(1)
    shifts = rng.normal(0, LATE, 4000)
    c = window.at_nodes(
        acceleration(window.samples, angle=quantity == "angle")
        * (
            window.node_times - window.node_times.mean()
            if quantity == "angle"
            else np.ones_like(window.node_times)
        )
    )
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
def test_uncertain_window_starts_are_not_missing_effect():
    """Start times wrong by a millisecond give a lack of fit if they count as exact, and none if uncertain."""
    model = Model.of(REDUCED)
    for seed in range(3):
        exact = fit(model, [CaseData.of(filmed(seed, known=True))])
        found = fit(model, [CaseData.of(filmed(seed))])
        assert exact.lack_of_fit.p_value < 0.1 < found.lack_of_fit.p_value
        assert exact.lack_of_fit.chi2 > 10 * found.lack_of_fit.chi2
        assert found.verdict == "no_lack_of_fit"
        assert found.cases[0].rotor.reduced_chi2 == pytest.approx(1.0, abs=0.2)
        for key, true in TRUTH.items():
            assert abs(found.estimates[key].value - true) < 4 * found.estimates[key].stderr


@pytest.mark.slow
def test_uncertainties_agree_with_the_scatter_of_many_recordings():
    pulls = []
    for seed in range(10, 22):
        found = fit(Model.of(REDUCED), [CaseData.of(filmed(seed))])
        pulls += [(found.estimates[k].value - v) / found.estimates[k].stderr for k, v in TRUTH.items()]
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.25
