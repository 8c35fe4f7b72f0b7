"""The lack-of-fit test has a chi-square distribution for the right model, and rejects a wrong one."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import twobody

from fitting import REDUCED, Model, fit, make_record
from fitting.inference import _metrics
from fitting.inference._case_data import CaseData
from fitting.inference._noise import tail_probability
from fitting.inference._process_noise import ProcessNoise


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_tail_probability_agrees_with_draws_of_an_uncertain_level(share):
    """Chi-square of 5 normal variables, a share of their variance scaled by a random factor."""
    rng = np.random.default_rng(0)
    ratios, weights = np.array([0.3, 1.0, 2.5]), np.array([0.3, 0.5, 0.2])
    noise = SimpleNamespace(process=ProcessNoise(1.0, 0.5, 1.0, 0.1, ratios, weights))
    scale = 1 - share + share * rng.choice(ratios, 200_000, p=weights)
    drawn = scale * rng.chisquare(5, 200_000)
    for p in (0.5, 1e-1, 1e-2):
        found = float(tail_probability(np.quantile(drawn, 1 - p), 5, [noise], [share]))
        assert found == pytest.approx(p, rel=0.08)


def test_chi_square_of_slow_torques_is_the_fall_beyond_the_parameters_of_the_fit():
    """Two cases with common parameters: the fall from the fit alone to a fit with the slow torques of each case."""
    rng = np.random.default_rng(3)
    free = [rng.normal(size=(12, 2)) for _ in range(2)]
    slow = [np.column_stack([rng.normal(size=12), f[:, 0]]) for f in free]
    slow[1] = slow[1][:, 1:]
    residual = [rng.normal(size=12) for _ in range(2)]
    common, r = np.concatenate(free), np.concatenate(residual)
    tested = np.zeros((24, 3))
    tested[:12, :2], tested[12:, 2:] = slow

    def chi2(columns):
        return float(np.sum((r - columns @ np.linalg.lstsq(columns, r)[0]) ** 2))

    # the sum of the first parameter's columns in both cases is in the fit already
    assert _metrics._together(slow, free, residual) == (
        pytest.approx(chi2(common) - chi2(np.hstack([common, tested]))),
        2,
    )


def found(hidden, seed, model=REDUCED):
    motion = twobody.simulate(hidden=hidden, ou=1e-7, seed=seed)
    return fit(Model.of(model), [CaseData.of(make_record(**twobody.film(motion, seed)))])


@pytest.mark.slow
@pytest.mark.release
def test_lack_of_fit_of_noise_has_the_expected_distribution():
    lacks = [found(twobody.Hidden(), seed).lack_of_fit for seed in range(4)]
    chi2, dof = sum(x.chi2 for x in lacks), sum(x.dof for x in lacks)
    assert abs(chi2 - dof) < 5 * math.sqrt(2 * dof)
    assert min(x.p_value for x in lacks) > 1e-5


@pytest.mark.slow
def test_a_law_of_the_wrong_shape_has_a_lack_of_fit():
    """A drag at one speed only, hidden; a step of the friction is the best that the library has."""
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -2e-6 * np.exp(-(((wc - 110) / 12) ** 2)))
    fitted = found(hidden, 1, (*REDUCED, "touchpoint.step"))
    assert fitted.lack_of_fit.p_value < 1e-3
    assert fitted.verdict == "lack_of_fit"
