"""Prefixes of torques and places of a lack of fit in sentences."""

from types import SimpleNamespace

import cases
import numpy as np
import pytest

from fitting._numbers import per_inertia, percentage, plain
from fitting.discovery import _residuals
from fitting.discovery._residuals import Failure, ResidualTorque, find_failures, format_torque


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
    assert format_torque(-0.41, 0.02, "rad/s2") == "-0.410 +- 0.020 rad/s2"
    assert format_torque(4.1e-3, unit="rad/s2") == "4.1 mrad/s2"
    assert format_torque(4.1e-5, unit="rad/s2") == "41 urad/s2"


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (-4.1e-7, 2e-8, "-0.410 +- 0.020 uN m"),
        (3.84e-9, 0.0, "3.84 nN m"),
        (5.36e-4, 0.0, "536 uN m"),
        (-2.5e-3, 3e-4, "-2.5 +- 0.3 mN m"),
        (214.0, 0.0, "214 N m"),
        (float("nan"), float("nan"), "nan nN m"),
    ],
)
def test_the_prefix_follows_the_size(value, sigma, text):
    assert format_torque(value, sigma) == text


@pytest.mark.parametrize(
    ("torque", "sigma", "times", "text"),
    [
        # two digits of the uncertainty from 10 to 29, one above: nothing is quoted beyond it
        (
            -95110.0,
            12278.0,
            (0.1931, 0.2071),
            "-95000 +- 12000 rad/s2, 0.193 s to 0.207 s",
        ),
        (5030.0, 810.0, (0.0, 0.19), "+5000 +- 800 rad/s2, 0.00 s to 0.19 s"),
        (0.5, 0.1, (12.0, 31.26), "+0.50 +- 0.10 rad/s2, 12.0 s to 31.3 s"),
    ],
)
def test_a_lack_of_fit_in_words(torque, sigma, times, text):
    failure = Failure(
        "run",
        "casing",
        *times,
        "gains torque",
        "while slowing down",
        300.0,
        1.0,
        torque,
        (0.0, 1.0),
        "body",
        sigma,
        "rad/s2",
    )
    assert str(failure) == f"unmodelled torque on the body {text}, while slowing down (up to 300 sigma)"


def test_the_torque_of_an_interval_weighs_each_moment_by_its_variance():
    """A moment whose torque is hardly known does not hide the others: mean, uncertainty and distance agree."""
    fit = cases.fitted()
    time = np.linspace(*fit.problem.data[0].record.span, 200)
    inside = (np.arange(200) > 40) & (np.arange(200) < 60)
    torque, sigma = np.where(inside, 4.0, 0.0), np.where(inside, 0.1, 1.0)
    torque[inside.argmax()], sigma[inside.argmax()] = 40.0, 10.0
    curve = ResidualTorque(
        fit.labels[0], "casing", time, torque, sigma, np.zeros(200), np.linspace(10, 1, 200)
    )
    (found,) = find_failures(fit, [curve])
    assert found.residual_torque_Nm == pytest.approx(4.0, rel=0.01)
    assert found.size_sigma == pytest.approx(40.0)
    assert abs(found.residual_torque_Nm) / found.torque_sigma_Nm == pytest.approx(40.0, rel=0.05)


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.9998, "100 %"),
        (0.9968, "99.7 %"),
        (0.9, "90 %"),
        (0.05, "5 %"),
        (9.1e-7, "9.1 x 10^-5 %"),
        (0.0, "0 %"),
    ],
)
def test_shares_have_no_exponent_where_none_is_needed(share, text):
    assert percentage(share) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1928.0, "1930"),
        (95110.0, "95100"),
        (1.2e6, "1.2 x 10^6"),
        (0.0314159, "0.0314"),
        (99970.0, "1 x 10^5"),
    ],
)
def test_numbers_of_sentences(value, text):
    assert plain(value) == text


@pytest.mark.parametrize(
    ("a", "b", "where"), [(0, 10, "at the start"), (20, 40, "in the middle"), (70, 90, "while slowing down")]
)
def test_a_body_that_only_slows_down_has_no_peak(a, b, where):
    curve = SimpleNamespace(time=np.arange(100.0), omega_c=-50 * np.exp(-np.arange(100) / 30))
    assert _residuals._place(curve, a, b) == where


def test_a_speed_that_rises_and_falls_has_a_peak():
    time = np.arange(100.0)
    curve = SimpleNamespace(time=time, omega_c=time * (100 - time))
    assert [_residuals._place(curve, *ab) for ab in ((0, 20), (45, 55), (30, 70), (80, 100))] == [
        "while speeding up",
        "near the peak",
        "around the peak",
        "while slowing down",
    ]
