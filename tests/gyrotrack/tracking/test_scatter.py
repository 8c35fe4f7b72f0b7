"""Scatter of residuals with known noise: normal, heavy-tailed, and louder where a profile fits less well."""

import numpy as np
import pytest

from gyrotrack._smoothing import core_scatter, excess, share_of_floor, tail_factor
from gyrotrack.tracking._marker_tracker import excess_misfit, variance_inflation


def test_excess_is_the_root_mean_square():
    off = np.random.default_rng(0).normal(0, 1.7, 4000)
    off[::10] = np.nan
    assert excess(off) == pytest.approx(1.7, rel=0.05)
    assert core_scatter(off, 9.0) == pytest.approx(1.7, rel=0.05)


def test_a_few_faults_hardly_count():
    off = np.random.default_rng(1).normal(0, 1.0, 2000)
    off[:4] = 1e3
    assert excess(off) < 1.1


def test_of_too_few_residuals_nothing_is_said():
    assert excess(np.array([3.0, -2.0])) == 1.0
    assert core_scatter(np.array([3.0, np.nan]), 0.5) == 0.5
    np.testing.assert_array_equal(tail_factor(np.full(5, np.nan)), np.ones(5))


def test_normal_residuals_keep_their_uncertainty():
    off = np.random.default_rng(2).normal(size=20000)
    factor = tail_factor(off)
    assert np.abs(factor[np.abs(off) < 3] - 1).max() < 0.1


def test_each_of_heavy_tailed_residuals_gets_the_variance_it_has_on_average():
    """Student's t with 6 degrees of freedom is normal noise whose variance changes: it is known here."""
    rng = np.random.default_rng(3)
    variance = 1.0 / rng.gamma(3.0, 1.0 / 3.0, 200000) / 1.5
    off = rng.normal(size=len(variance)) * np.sqrt(variance)
    factor = tail_factor(off / off.std())
    for low, high in ((0.0, 0.5), (1.5, 2.0), (3.0, 4.0)):
        band = (np.abs(off) > low) & (np.abs(off) < high)
        assert np.mean(factor[band] ** 2) == pytest.approx(np.mean(variance[band]), rel=0.12)
    assert (np.abs(off) > 5).sum() > 10 * (np.abs(off / factor) > 5).sum()


def test_how_much_a_misfit_matters_is_found_again():
    rng = np.random.default_rng(4)
    misfit = 0.01 * np.exp(rng.normal(0, 0.6, 4000))
    misfit_excess = excess_misfit(misfit, 0.01)
    assert misfit_excess.min() == 0.0
    for share in (0.0, 0.1, 0.5):
        off = 3e-3 * rng.normal(size=4000) * np.sqrt(1.0 + share * misfit_excess)
        assert variance_inflation(off, misfit_excess) == pytest.approx(share, abs=0.03 + 0.3 * share)


def test_one_fault_does_not_make_misfits_matter():
    rng = np.random.default_rng(5)
    misfit_excess = excess_misfit(np.full(400, 0.01), 0.01)
    misfit_excess[7] = 10.0
    off = rng.normal(size=400)
    assert variance_inflation(off, misfit_excess) < 0.5
    assert variance_inflation(off[:5], misfit_excess[:5]) == 0.0


@pytest.mark.parametrize("true", [0.3, 1.0, 3.0])
def test_a_borrowed_uncertainty_gives_way_to_what_is_seen_of_many_places(true):
    sigma, floor = np.full(600, 0.5), 1.5
    many, few = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        by_place = np.interp(np.arange(600), np.arange(0, 601, 30), rng.normal(0, true, 21)) * np.sqrt(1.5)
        off = by_place + rng.normal(0, 0.5, 600)
        many.append(floor * share_of_floor(off, sigma, floor, 20.0))
        few.append(floor * share_of_floor(off, sigma, floor, 0.0))
    usual = np.sqrt(np.mean(np.square(many)))
    assert few == [floor] * 40
    assert usual == pytest.approx(min(np.sqrt((4 * floor**2 + 20 * true**2) / 24), floor), rel=0.15)
