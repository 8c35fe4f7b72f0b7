"""Bases, splines, covariances and p-values of many tests, compared with other libraries and closed formulas."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag

from fitting.inference._linear_algebra import (
    block_diagonal,
    covariance_of,
    cubic_spline,
    orthogonal_to,
    orthonormal,
    piecewise_linear,
    r_factor,
)
from fitting.inference._multiple_tests import any_of, independent_tests, number_of_trials, over_many_tests

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("n", [4, 5, 9])
def test_a_spline_is_that_of_scipy_within_and_beyond_its_points(n):
    x = np.cumsum(0.2 + RNG.random(n))
    y = RNG.standard_normal(n)
    at = np.sort(np.concatenate([x, np.linspace(x[0] - 0.3, x[-1] + 0.3, 41)]))
    assert cubic_spline(x, y, at) == pytest.approx(CubicSpline(x, y)(at), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("ratio", "rank"), [(1.05, 2), (0.95, 1)])
def test_a_direction_below_the_smallest_singular_value_is_left_out(ratio, rank):
    # unit columns at an angle 2 a have the singular values sqrt(2) cos(a) and sqrt(2) sin(a)
    a = np.arctan(0.01 * ratio)
    columns = np.array([[np.cos(a), np.cos(a)], [np.sin(a), -np.sin(a)], [0.0, 0.0]])
    basis = orthonormal(columns * [5.0, 1e-7], 0.01)
    assert basis.shape == (3, rank)
    assert basis.T @ basis == pytest.approx(np.eye(rank), abs=1e-12)
    assert np.abs(basis[:, 0]) == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)


def test_columns_of_zeros_are_left_out():
    assert orthonormal(np.zeros((3, 2)), 0.1).shape == (3, 0)
    basis = orthonormal(np.array([[0.0, 0.0], [0.0, -3.0]]), 0.1)
    assert np.abs(basis) == pytest.approx(np.array([[0.0], [1.0]]))


def test_the_rest_of_a_projection_is_orthogonal():
    basis = np.array([[1.0], [1.0], [0.0]]) / np.sqrt(2)
    assert orthogonal_to(basis, np.array([3.0, 1.0, 7.0])) == pytest.approx([1.0, -1.0, 7.0])
    assert orthogonal_to(basis, np.array([[3.0], [1.0], [7.0]]))[:, 0] == pytest.approx([1.0, -1.0, 7.0])


def test_blocks_are_placed_along_the_diagonal():
    parts = [RNG.standard_normal(shape) for shape in ((2, 3), (1, 1), (3, 2))]
    assert block_diagonal(parts) == pytest.approx(block_diag(*parts))


def test_hat_functions_are_one_at_their_knot():
    hats = piecewise_linear(np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 9.0]), np.array([0.0, 1.0, 3.0]))
    assert hats == pytest.approx(
        np.array([[1, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5], [0, 0, 1]])
    )


def test_a_factor_has_the_products_of_the_columns():
    j = RNG.standard_normal((6, 3))
    r = r_factor(j)
    assert r.shape == (3, 3)
    assert r.T @ r == pytest.approx(j.T @ j)
    j[2, 1] = np.nan
    assert r_factor(j) is j


class TestCovariance:
    def test_it_is_the_inverse_over_the_free_columns(self):
        j = RNG.standard_normal((8, 3)) * [1.0, 1e4, 1e-3]
        free = np.array([True, False, True])
        expected = np.zeros((3, 3))
        expected[np.ix_(free, free)] = np.linalg.inv(j[:, free].T @ j[:, free])
        assert covariance_of(j, free) == pytest.approx(expected, rel=1e-9)

    def test_a_column_of_zeros_has_an_infinite_variance(self):
        j = np.array([[2.0, 0.0], [0.0, 0.0]])
        found = covariance_of(j, np.array([True, True]))
        assert found[0, 0] == pytest.approx(0.25)
        assert np.isinf(found[1, 1])
        assert found[0, 1] == found[1, 0] == 0.0

    def test_a_direction_without_information_keeps_a_large_variance(self):
        j = np.array([[1.0, 1.0], [1.0, 1.0]])
        found = covariance_of(j, np.array([True, True]))
        # singular values of the scaled columns: sqrt(2), and the floor of 1e-12 of it; the norms are sqrt(2)
        assert found[0, 0] == pytest.approx(0.5 / (2e-24) / 2, rel=1e-6)
        assert found[0, 1] == pytest.approx(-found[0, 0], rel=1e-6)


class TestManyTests:
    @pytest.mark.parametrize("n", [1.0, 2.5, 40.0])
    def test_the_number_of_trials_is_that_of_the_share(self, n):
        assert number_of_trials(0.01, 1 - 0.99**n) == pytest.approx(n)
        assert any_of(n, np.array([0.01]))[0] == pytest.approx(1 - 0.99**n)

    def test_extreme_values_stay_finite(self):
        assert number_of_trials(0.0, 0.1) == pytest.approx(-np.log(0.9) * 1e12, rel=1e-3)
        assert number_of_trials(1.0, 0.1) == pytest.approx(np.log(0.9) / np.log(1e-12), rel=1e-3)
        assert any_of(2.0, np.array([1.0, 0.0])) == pytest.approx([1.0, 0.0])
        assert any_of(3.0, np.array(1e-20)) == pytest.approx(3e-20)

    def test_the_tests_are_counted_at_the_quantile_of_a_tenth(self):
        # the smallest of 20 uniform p-values has the quantile 1 - (1 - q)^(1 / 20)
        q = (np.arange(4001) + 0.0) / 4000
        smallest = 1 - (1 - q) ** (1 / 20)
        assert independent_tests(smallest) == pytest.approx(20.0, rel=1e-3)
        assert over_many_tests(0.003, smallest) == pytest.approx(1 - 0.997**20, rel=1e-3)
        assert independent_tests(np.full(9, 0.5)) == 1.0
        assert over_many_tests(0.2, np.full(9, 0.5)) == pytest.approx(0.2)
