"""Prefixes of torques in sentences."""

import pytest

from fitting._numbers import per_inertia
from fitting.discovery._residuals import format_torque


@pytest.mark.parametrize(
    ("unit", "divided"),
    [
        ("N m", "rad/s2"),
        ("N m s", "s-1"),
        ("N m s2", "1"),
        ("N m s1.5", "s-0.5"),
        ("N m s-1", "rad/s3"),
        ("N m s3", "s"),
        ("N m s^g", "s^(g-2)"),
        ("rad s-1", "rad s-1"),
        ("1", "1"),
    ],
)
def test_units_per_unit_of_inertia(unit, divided):
    assert per_inertia(unit) == divided


def test_torques_per_unit_of_inertia():
    assert format_torque(-0.41, 0.02, "rad/s2") == "-0.41 +- 0.02 rad/s2"
    assert format_torque(4.1e-3, unit="rad/s2") == "4.1 mrad/s2"
    assert format_torque(4.1e-5, unit="rad/s2") == "41 urad/s2"


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
