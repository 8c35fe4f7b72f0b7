"""The first harmonic of the angle error of a film changes with the square of the speed."""

import numpy as np
import pytest
import twobody

from fitting import Model, fit, make_record
from fitting.discovery._remainder import nuisance_parameters
from fitting.inference._case_data import CaseData, camera_columns, largest_speed
from fitting.inference._record import Samples

GYROSCOPE = {"a2": 1.97e-10, "b1": 3e-6, "b2": 3.7e-7, "d": 3.2e-8, "f": 4.86e-7, "g": 0.62}
BASE = ("rotor.air.quadratic", "touchpoint.constant", "casing.air.linear", "bearing.linear", "bearing.power")


def film(blur=0.0, *, tracked=True):
    """Return a recording whose casing errs by `blur` sin(psi) at the largest speed [rad]."""
    motion = twobody.simulate(GYROSCOPE, start=(566.0, 25.0), span=40.0, seed=0)
    found = twobody.film(
        motion,
        seed=0,
        cameras=twobody.Cameras(
            span=40.0, windows=(2.0, 18.0, 34.0), casing_rate=30.0, rotor_rate=100.0, sigma=4e-4
        ),
    )
    t, y, s = found["casing"]
    samples = Samples(t, y, s)
    speed = np.gradient(y, t) / largest_speed(samples)
    found["casing"] = (t, y + blur * np.convolve(speed, np.ones(10) / 10, "same") ** 2 * np.sin(y), s)
    return make_record(**found, tracked=tracked)


def test_columns_are_waves_times_powers_of_the_speed():
    t = np.linspace(0.0, 10.0, 5001)
    samples = Samples(t, 50.0 * t - 2.0 * t**2, np.full(len(t), 1e-3))
    columns = camera_columns(samples, blurred=True)
    relative = (50.0 - 4.0 * t) / largest_speed(samples)
    inside = slice(50, -50)
    for first, power in ((0, 0), (4, 1), (6, 2)):
        for at, wave in ((first, np.cos), (first + 1, np.sin)):
            expected = relative**power * wave(samples.value)
            assert columns[inside, at] == pytest.approx(expected[inside], abs=2e-3)
    assert columns[:, 2] == pytest.approx(np.cos(2 * samples.value))
    still = camera_columns(samples)
    assert np.array_equal(still[:, :6], columns[:, :6])
    assert not still[:, 6:].any()


@pytest.mark.parametrize("tracked", [True, False])
def test_only_films_are_blurred_by_5_mrad_at_the_largest_speed(tracked):
    data = CaseData.of(film(tracked=tracked))
    first = data.slices["nuisance_prior"].start
    inverse = np.diag(data.nuisance[first : first + 8, -8:])
    assert 1 / inverse[-2:] == pytest.approx(5e-3)
    assert data.camera_columns[:, -2:].any() == tracked


@pytest.mark.slow
def test_an_error_by_blur_is_found_as_such():
    speed = largest_speed(CaseData.of(film()).casing.samples)
    blur = {n.effect: n for n in nuisance_parameters(fit(Model.of(BASE), [film(3e-3)]))}["camera.blur"]
    assert blur.value * speed**2 == pytest.approx(3e-3, abs=3 * blur.stderr * speed**2)
    assert blur.value > 4 * blur.stderr
    assert blur.unit == "s2"
