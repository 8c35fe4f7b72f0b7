"""The deviance along the level of a random torque, against generalised least squares."""

import math

import numpy as np
import pytest

from fitting.inference._level_profile import LevelProfile, least_between, scaled_columns
from fitting.inference._noise import Whitener

ROWS = 9
RNG = np.random.default_rng(2)
RESPONSE = RNG.standard_normal((6, 6))
VALUES, VECTORS = np.linalg.eigh(RESPONSE @ RESPONSE.T)
# rows of a kernel, one independent row, and white ones
WHITENER = Whitener(VECTORS, np.append(VALUES, 3.0), 0.0)
FREE, RESIDUAL = RNG.standard_normal((ROWS, 2)), RNG.standard_normal(ROWS)


def covariance(level):
    whole = np.eye(ROWS)
    whole[:6, :6] += level**2 * RESPONSE @ RESPONSE.T
    whole[6, 6] += 3.0 * level**2
    return whole


@pytest.mark.parametrize("level", [0.0, 0.4, 3.0])
def test_the_deviance_is_that_of_generalised_least_squares(level):
    c = covariance(level)
    fitted = np.linalg.solve(FREE.T @ np.linalg.solve(c, FREE), FREE.T @ np.linalg.solve(c, RESIDUAL))
    rest = RESIDUAL - FREE @ fitted
    expected = np.linalg.slogdet(c)[1] + rest @ np.linalg.solve(c, rest)
    profile = LevelProfile(WHITENER, np.column_stack([FREE, RESIDUAL]))
    assert profile(level) == pytest.approx(expected)
    # a call leaves the columns as they are
    assert profile(level) == pytest.approx(expected)


def independent(size):
    """Return the profile of 50 rows of response 1 and of this size, D = 50 (ln(1 + s^2) + size^2 / (1 + s^2))."""
    return LevelProfile(Whitener(np.zeros((0, 0)), np.ones(50)), np.full((50, 1), float(size)))


@pytest.mark.parametrize("size", [1.2, 3.0, 9.0])
def test_the_most_likely_level_is_found_between_those_of_a_grid(size):
    level, deviance = independent(size).least(np.geomspace(0.1, 100.0, 7))
    assert level == pytest.approx(math.sqrt(size**2 - 1), rel=0.05)
    assert deviance == pytest.approx(50 * (math.log(size**2) + 1), abs=0.2)


@pytest.mark.parametrize(("levels", "best"), [([0.1, 0.2, 0.4], 0.4), ([30.0, 60.0, 120.0], 30.0)])
def test_it_is_the_last_one_where_the_grid_ends(levels, best):
    profile = independent(9.0)
    level, deviance = profile.least(np.array(levels))
    assert (level, deviance) == (pytest.approx(best, rel=1e-9), pytest.approx(profile(best)))


def test_a_level_of_the_grid_that_is_exact_is_kept():
    profile = independent(3.0)
    exact = math.sqrt(8.0)
    assert profile.least(np.array([0.1, exact, 50.0])) == (exact, profile(exact))


def test_where_a_function_is_least():
    place, value = least_between(lambda x: 2.0 * (x - 1.3) ** 2 - 7.0, 0.0, 4.0)
    assert place == pytest.approx(1.3, abs=0.05)
    assert value == pytest.approx(-7.0, abs=0.01)


def test_columns_have_unit_norm_and_the_residual_its_own():
    columns = np.column_stack([2.0 * np.ones(4), np.zeros(4), np.array([3.0, 0.0, 4.0, 0.0])])
    found = scaled_columns(columns, np.full(4, 7.0))
    assert found == pytest.approx(
        np.column_stack([np.full(4, 0.5), np.array([0.6, 0.0, 0.8, 0.0]), np.full(4, 7.0)])
    )
