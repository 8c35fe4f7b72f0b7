"""The verdict of a fit on a torque that repeats with the angle, on either side of its criterion."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Case, fit
from fitting._criteria import DEFAULT
from fitting.inference._angle_harmonics import AngleHarmonics

T, SPEED, AMPLITUDE = np.linspace(0.0, 20.0, 1201), 80.0, 4.0


@lru_cache
def fitted(amplitude):
    """A wheel of 1 kg m2 with a torque once a turn: angles by their analytic response to first order."""
    phase = SPEED * T - 0.5 * T**2
    change = -amplitude * np.sin(phase) / (SPEED - T) ** 2
    angle = phase + change + 5e-5 * np.random.default_rng(1).standard_normal(len(T))
    return fit("support.constant", Case.from_arrays(wheel={"t": T, "angle": angle, "u": 5e-5}))


@pytest.mark.parametrize(("amplitude", "verdict"), [(0.0, "no_lack_of_fit"), (AMPLITUDE, "lack_of_fit")])
def test_a_torque_once_a_turn_is_a_lack_of_fit(amplitude, verdict):
    found = fitted(amplitude)
    assert found.verdict == verdict
    assert found.has_torque_of_the_angle() == (amplitude > 0)
    # slow torques do not contain it
    assert not found.fails()


@pytest.mark.parametrize(
    ("order", "share", "turns", "expected"),
    [
        (1, 0.99, 90.0, False),
        (1, 1.01, 90.0, True),
        (2, 0.99, 90.0, False),
        (2, 1.01, 90.0, True),
        (1, 1.01, 4.9, False),
        (1, 1.01, 5.1, True),
    ],
)
def test_the_amplitude_that_counts(order, share, turns, expected):
    gamma = np.zeros(4)
    gamma[2 * order - 2] = share * DEFAULT.harmonic_sigma * 2e-6
    harmonics = (AngleHarmonics("case", gamma, np.eye(4) * 4e-12, turns),)
    solved = SimpleNamespace(angle_harmonics=harmonics, criteria=DEFAULT)
    from fitting import Fit

    assert Fit.has_torque_of_the_angle(solved) == expected


def test_a_response_that_is_not_determined_has_no_size():
    assert AngleHarmonics("case", np.ones(4), np.zeros((4, 4))).size(1) == (0.0, 0.0)


def test_the_turns_are_those_of_the_record():
    (found,) = fitted(0.0).angle_harmonics
    assert found.turns == pytest.approx((SPEED * 20 - 200.0) / (2 * np.pi), rel=1e-4)


def test_a_torque_in_the_model_is_not_a_lack_of_fit():
    """What the free strength and phase leave of the response is rounding, whose covariance is singular."""
    phase = SPEED * T - 0.5 * T**2
    angle = (
        phase
        - AMPLITUDE * np.sin(phase) / (SPEED - T) ** 2
        + 5e-5 * np.random.default_rng(1).standard_normal(len(T))
    )
    case = Case.from_arrays(wheel={"t": T, "angle": angle, "u": 5e-5})
    found = fit("support.constant + casing.unbalance", case)
    (harmonics,) = found.angle_harmonics
    assert harmonics.size(1) == (0.0, 0.0)
    assert 0.0 < harmonics.size(2)[1] < 4.0
    assert found.verdict == "no_lack_of_fit"


def test_of_a_response_with_one_direction_that_direction_counts():
    covariance = np.diag([4e-12, 0.0, 1.0, 1.0])
    amplitude, sigma = AngleHarmonics("case", np.array([6e-6, 0.0, 0.0, 0.0]), covariance).size(1)
    assert (amplitude, sigma) == pytest.approx((6e-6, 3.0))
