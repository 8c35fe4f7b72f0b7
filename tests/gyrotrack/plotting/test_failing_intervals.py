"""Intervals in which the residual of a speed is outside of its band: on one side, or on both in turn (oscillations)."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting._criteria import DEFAULT
from gyrotrack.plotting import _study_data

SIZE = 2 * DEFAULT.failure_sigma


def residual(value):
    time = np.arange(len(value), dtype=float)
    return SimpleNamespace(time=time, width=np.ones(len(value)), value=np.asarray(value, dtype=float))


def intervals(value, period):
    return [x[:2] for x in _study_data._outside(residual(value), np.ones(len(value)), (), period)]


def test_a_residual_that_changes_its_side_is_outside_of_the_band_twice():
    assert intervals([0, SIZE, SIZE, -SIZE, 0], 0.0) == [(0.5, 2.5), (2.5, 3.5)]


@pytest.mark.parametrize(
    ("period", "expected"),
    [(6.1, [(0.5, 5.5)]), (5.9, [(0.5, 2.5), (4.5, 5.5)])],
    ids=["within half a period", "later"],
)
def test_the_residual_of_an_oscillation_may_cross_its_band_within_half_a_period(period, expected):
    """From 2 s to 5 s, it is within the band."""
    assert intervals([0, SIZE, SIZE, 0, 0, -SIZE, 0], period) == expected


@pytest.mark.parametrize(("share", "count"), [(1.01, 1), (0.99, 0)])
def test_an_interval_requires_a_significant_residual(share, count):
    assert len(intervals([0, 2.5, share * DEFAULT.failure_sigma, -2.5, 0], 4.0)) == count
