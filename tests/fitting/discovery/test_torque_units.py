"""Torques in sentences carry the prefix that suits their size."""

import pytest

from fitting.discovery._residuals import format_torque


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (-4.1e-7, 2e-8, "-0.41 +- 0.02 uN m"),
        (3.84e-9, 0.0, "3.84 nN m"),
        (5.36e-4, 0.0, "536 uN m"),
        (-2.5e-3, 3e-4, "-2.5 +- 0.3 mN m"),
        (214.0, 0.0, "214 N m"),
        (float("nan"), float("nan"), "nan nN m"),
    ],
)
def test_the_prefix_follows_the_size(value, sigma, text):
    assert format_torque(value, sigma) == text
