"""The error of a displaced hub from the halves of a ring, its leverage, and the white noise of a series."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _tracked as tracked

TURN = 2 * np.pi


class TestHubError:
    @pytest.mark.parametrize(("trend", "order", "factor"), [
        (0, 2, 4 / math.sqrt(6)),
        (1, 2, 4 / math.sqrt(6)),
        (2, 3, 8 / math.sqrt(20)),
        (3, 4, 16 / math.sqrt(70)),
        (5, 6, 64 / math.sqrt(924)),
    ])  # fmt: skip
    def test_the_white_noise_of_alternating_values_is_that_of_the_lowest_order_without_the_trend(
        self, trend, order, factor
    ):
        x = np.arange(40.0)
        values = np.where(x % 2, 1e-2, -1e-2)
        assert tracked.white_noise(values + x**trend) == pytest.approx(1.4826e-2 * factor, rel=1e-5)
        places = np.delete(x, 17)
        found = tracked.white_noise(np.delete(values + x**trend, 17), places)
        assert found == pytest.approx(1.4826e-2 * factor, rel=1e-5)

    def test_an_order_needs_three_times_as_many_values(self):
        x = np.arange(30.0)
        values = np.where(x % 2, 1.0, -1.0) + 1e3 * x**5
        known = 1.4826 * 64 / math.sqrt(924)
        assert tracked.white_noise(values[:19]) == pytest.approx(known, rel=1e-3)
        assert tracked.white_noise(values[:18]) > 10 * known
        assert math.isnan(tracked.white_noise(values[:6]))
        assert tracked.white_noise(np.where(x[:7] % 2, 1.0, -1.0)) == pytest.approx(1.4826 * 4 / math.sqrt(6))

    def test_the_halves_show_a_displaced_hub_by_a_harmonic_of_the_angle(self, monkeypatch):
        """Less mean and trend; the leverage multiplies it."""
        parts = []
        monkeypatch.setattr(tracked, "hub_leverage", lambda p: parts.append(p) or 2.5)
        for turns in (0.6, 1.0, 2.9):
            angle = 1.0 + TURN * turns * np.linspace(0.0, 1.0, 300) ** 2
            view = 0.01 * np.cos(angle) + 0.02 * np.sin(angle)
            one = 0.4 * np.sin(7.0 * angle)
            halves = np.stack([one + view + 0.5 + 0.3 * np.linspace(0.0, 1.0, 300), one])
            assert tracked.hub_error(angle, halves, "parts") == pytest.approx(2.5 * np.std(view), rel=1e-6)
        assert parts == ["parts"] * 3
        angle = TURN * 3.1 * np.linspace(0.0, 1.0, 300)
        assert tracked.hub_error(angle, np.stack([np.cos(angle), np.zeros(300)]), "parts") == 0.0

    def test_over_less_than_half_a_turn_the_halves_differ_by_a_multiple_of_the_angle(self, monkeypatch):
        monkeypatch.setattr(tracked, "hub_leverage", lambda _: 2.5)
        angle = 1.0 + 1.5 * np.sin(np.linspace(0.0, 20.0, 300))
        halves = np.stack([0.97 * angle + 0.2, angle - 0.1 * np.linspace(0.0, 1.0, 300)])
        assert tracked.hub_error(angle, halves, None) == pytest.approx(2.5 * 0.03 * np.std(angle), rel=1e-6)

    @pytest.mark.parametrize(("times", "known"), [(2.9, False), (3.1, True)])
    def test_a_difference_below_three_standard_errors_is_none(self, monkeypatch, times, known):
        """Over one turn the variances of cosine and sine are 2 / n each."""
        monkeypatch.setattr(tracked, "hub_leverage", lambda _: 1.0)
        angle = TURN * np.arange(400) / 400
        noise = 0.01 * np.where(np.arange(400) % 2, 1.0, -1.0)
        rows = np.stack([np.cos(angle), np.sin(angle), np.ones(400), np.linspace(-1.0, 1.0, 400)], axis=1)
        error = 0.01 * math.sqrt(np.trace(np.linalg.inv(rows.T @ rows)[:2, :2]))
        apart = times * error * np.cos(angle + 0.7) + noise
        found = tracked.hub_error(angle, np.stack([apart, np.zeros(400)]), None)
        assert (found > 0.0) == known
        assert not known or found == pytest.approx(times * error / math.sqrt(2.0), rel=0.05)

    def test_the_leverage_is_the_inverse_radius_by_its_difference(self):
        """Radii are weighted by the information of the rows."""

        def part(information, whole=None):
            ring = SimpleNamespace(radius=np.array([10.0, 20.0, 40.0]))
            return SimpleNamespace(ring=ring, information=lambda: np.array(information), whole=lambda: whole)

        inner, outer = part([3.0, 1.0, 0.0], part([3.0, 1.0, 4.0])), part([0.0, 0.0, 4.0])
        r1, r2, r = 12.5, 40.0, (30.0 + 20.0 + 160.0) / 8.0
        assert tracked.hub_leverage((inner, outer)) == pytest.approx(1 / r / (1 / r1 - 1 / r2))
        assert tracked.hub_leverage(
            (part([0.0, 0.0, 4.0], part([3.0, 1.0, 4.0])), part([3.0, 1.0, 0.0]))
        ) == (pytest.approx(1 / r / (1 / r1 - 1 / r2)))


@pytest.mark.parametrize("order", [0, 1])
def test_white_noise_is_found_beside_a_polynomial(order):
    rng = np.random.default_rng(0)
    at = np.cumsum(rng.integers(1, 3, 900)) if order else np.arange(900)
    value = 1e-4 * (at - 300.0) ** 2 + rng.normal(0.0, 0.2, 900)
    assert tracked.white_noise(value, at) == pytest.approx(0.2, rel=0.1)
    assert np.isnan(tracked.white_noise(value[:6]))
    assert np.isfinite(tracked.white_noise(value[:7]))


def _parts(r1, r2, r):
    """Two halves of a template with given effective radii, and the whole."""
    ring = SimpleNamespace(radius=np.array([r1, r2, r]))
    one = lambda k: SimpleNamespace(information=lambda: np.eye(3)[k], ring=ring)  # noqa: E731
    first, second, whole = (one(k) for k in range(3))
    first.whole = lambda: whole
    return first, second


def test_the_leverage_of_a_displaced_hub_is_that_of_the_radii():
    assert tracked.hub_leverage(_parts(20.0, 40.0, 30.0)) == pytest.approx((1 / 30) / (1 / 20 - 1 / 40))
    ring = SimpleNamespace(radius=np.array([10.0, 20.0, 40.0]))
    part = SimpleNamespace(information=lambda: np.array([1.0, 1.0, 2.0]), ring=ring)
    assert tracked._radius_of(part) == pytest.approx(27.5)


@pytest.mark.parametrize("turns", [2.9, 3.1, 0.4])
def test_the_error_due_to_a_displaced_hub_is_that_of_the_difference_of_the_halves(turns):
    angle = np.linspace(0.0, turns * TURN, 600)
    wave = 4e-3 * np.cos(angle) if turns > 0.5 else 4e-3 * (angle - angle.mean())
    apart = wave + 0.01 + 2e-3 * np.linspace(-1, 1, 600)
    apart += 1e-4 * np.where(np.arange(600) % 2, 1.0, -1.0)
    halves = np.stack([apart, np.zeros(600)])
    found = tracked.hub_error(angle, halves, _parts(20.0, 40.0, 30.0))
    leverage = (1 / 30) / (1 / 20 - 1 / 40)
    # over less than half a turn, a trend is not distinguished from the angle
    if turns > 3.0:
        assert found == 0.0
    elif turns > 0.5:
        assert found == pytest.approx(4e-3 / math.sqrt(2.0) * leverage, rel=0.1)


def test_an_insignificant_difference_of_the_halves_is_not_an_error():
    angle = np.linspace(0.0, 2.0 * TURN, 400)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, 400)
    # the two amplitudes have the variance 2 s^2 / n each: three standard errors of both are 3 s sqrt(4 / n)
    limit = 3.0 * 1e-3 * math.sqrt(4.0 / 400)
    for size, found in ((0.6, False), (1.5, True)):
        rows = np.stack([np.cos(angle), np.sin(angle), np.ones(400), np.linspace(-1, 1, 400)], axis=1)
        rest = noise - rows @ np.linalg.lstsq(rows, noise, rcond=None)[0]
        halves = np.stack([rest + size * limit * np.cos(angle), np.zeros(400)])
        assert (tracked.hub_error(angle, halves, _parts(20.0, 40.0, 30.0)) > 0) == found


@pytest.mark.parametrize(
    ("turns", "size", "found"), [(4.0, 11e-3, True), (4.0, 9e-3, False), (2.9, 11e-3, False)]
)
def test_halves_that_turn_differently_are_two_bodies(turns, size, found):
    """A sine of amplitude a has the standard deviation a / sqrt(2); the limit is five times 1.414 mrad."""
    angle = np.linspace(0.0, turns * TURN, 900)
    slow = size * np.sin(np.linspace(0.0, 45.0, 900))
    halves = np.stack([slow + 3e-3 * np.cos(angle) + 2e-3 * np.sin(2 * angle), np.zeros(900)])
    error = tracked.apart_beyond_harmonics(angle, halves, np.arange(900), 1e-3 * math.sqrt(2.0))
    assert (error is not None) == found
    if found:
        assert error == pytest.approx(0.5 * size / math.sqrt(2.0), rel=0.05)
