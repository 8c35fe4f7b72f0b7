import numpy as np
import pytest

from fitting import REDUCED, Model, fit
from fitting.dynamics._collocation import Sampler
from fitting.inference._speed_residuals import speed_residuals


def _mean_difference(path, other, state, misfit):
    """Mean of omega - omega' weighted as a line's slope weighs it, by plain summation."""
    values = []
    for middle, width in zip(misfit.time, misfit.width, strict=True):
        t = np.linspace(middle - width / 2, middle + width / 2, 401)
        one, two = (Sampler(p.mesh, t).value(p.y[..., state]) for p in (path, other))
        difference = one - two
        x = 2 * (t - middle) / width
        weight = np.maximum(1 - x**2, 0)
        values.append(np.sum(weight * difference) / weight.sum())
    return np.array(values)


def test_misfit_of_the_base_is_the_true_speed_minus_the_models(record_of, true_path):
    base = fit(Model.of(REDUCED), [record_of(1)])
    casing, rotor = speed_residuals(base, 0)
    model = base.predictions[0].path
    for state, found in ((1, casing), (0, rotor[0]), (0, rotor[2])):
        expected = _mean_difference(true_path, model, state, found)
        # five standard deviations are never reached by chance; 2 % is the curvature within a part
        assert (np.abs(found.value - expected) < 5 * found.sigma + 0.02 * np.abs(expected).max()).all()
    assert np.abs(casing.value).max() > 30 * casing.sigma.max()


@pytest.mark.slow
def test_band_is_as_wide_as_the_noise(record_of, story):
    model = Model.of([*REDUCED, "casing.air.quadratic"])
    start = {k: e.value for k, e in story.rungs[-1].fit.estimates.items()}
    scores = []
    for seed in (11, 12, 13, 14):
        casing, _ = speed_residuals(fit(model, [record_of(seed)], start=start), 0)
        scores.append(casing.value / casing.sigma)
    # 4 x 120 parts: the spread of z is 1 to about 5 %; 0.85-1.15 is three times that
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.15


@pytest.mark.slow
def test_floor_is_the_rms_error_that_the_true_model_has(story):
    final = story.rungs[-1].fit
    rmse = final.cases[0].casing.rmse
    assert 0.9 * rmse < final.rmse_noise < 1.1 * rmse
    assert story.rungs[0].fit.cases[0].casing.rmse > 1.5 * final.rmse_noise


@pytest.mark.slow
def test_bic_of_an_adequate_fit_is_that_of_noise_and_a_missing_effect_exceeds_it(story):
    base, final = story.rungs[0].fit, story.rungs[-1].fit
    # chi2 over `rows` has a standard deviation of sqrt(2 rows)
    assert abs(final.bic - final.bic_noise) < 4 * np.sqrt(2 * final.rows)
    assert base.bic - base.bic_noise > 100
    assert final.samples == len(story.record.casing) + sum(map(len, story.record.rotor))
