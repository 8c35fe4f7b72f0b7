"""What a column is, on both sides of each rule: intervals, exchanged columns, wrapped angles, ratios of units."""

import math

import numpy as np
import pytest

from gyrotrack.io.readers._plausibility import (
    are_exchanged,
    may_be_intervals,
    ratio_of_units,
    rises,
    wrapping_unit,
    wraps_at_no_turn,
)

TURN = 2 * math.pi


def growing(power, noise=0.0, count=25, rate=None):
    """Values whose steps are in proportion to a power of them, times exp(+-noise)."""
    rate = 1 / (40.0 * (power - 1)) if rate is None else rate
    values = [1.0]
    for k in range(count - 1):
        values.append(values[-1] + rate * values[-1] ** power * math.exp(noise * (-1) ** k))
    return np.array(values)


class TestIntervals:
    @pytest.mark.parametrize(
        ("power", "expected"),
        [(1.3, False), (1.7, True), (2.0, True), (3.0, True), (3.3, True), (3.7, False)],
    )
    def test_they_grow_by_a_power_between_viscous_and_dry_friction(self, power, expected):
        """The square and the cube, by half a power more or less."""
        assert may_be_intervals(growing(power)) is expected

    @pytest.mark.parametrize(("noise", "expected"), [(0.05, True), (0.1, False)])
    def test_the_power_explains_98_percent_of_the_variance(self, noise, expected):
        values = growing(2.0, noise)
        x, y = np.log(0.5 * (values[1:] + values[:-1])), np.log(np.diff(values))
        explained = np.corrcoef(x, y)[0, 1] ** 2
        assert (explained > 0.98) == expected
        assert explained > 0.8
        assert may_be_intervals(values) is expected

    @pytest.mark.parametrize(("rate", "expected"), [(0.010, False), (0.014, True)])
    def test_their_logarithm_changes_by_three_tenths(self, rate, expected):
        """1 / v falls by the rate in each of 24 intervals: ln v rises by 0.26 and by 0.38 between the middles."""
        assert may_be_intervals(growing(2.0, rate=rate)) is expected

    @pytest.mark.parametrize(("count", "expected"), [(15, False), (16, True)])
    def test_sixteen_values_are_needed(self, count, expected):
        assert may_be_intervals(growing(2.0, count=count)) is expected


class TestExchanged:
    @pytest.mark.parametrize(
        ("parts", "expected"),
        [(4.0, False), (4.04, False), (4.06, True), (0.49, True), (0.02, True), (1.0, False), (200.5, True)],
    )
    def test_equal_steps_are_those_of_pulses_if_they_are_whole_parts_of_a_turn(self, parts, expected):
        irregular = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 60))
        steps = TURN / parts * np.arange(60.0)
        assert are_exchanged(irregular, steps, TURN) is expected
        assert not are_exchanged(0.01 * np.arange(60.0), steps, TURN)
        assert not are_exchanged(irregular, irregular**1.1, TURN)

    @pytest.mark.parametrize(
        ("odd", "factor", "expected"), [(1, 1.1, True), (3, 1.1, False), (3, 1.009, True), (3, 1.011, False)]
    )
    def test_99_percent_of_equal_steps_differ_by_less_than_1_percent(self, odd, factor, expected):
        """Of 200 steps, one or three are longer."""
        time, step = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 201)), np.full(200, TURN / 4.5)
        step[[20, 90, 150][:odd]] *= factor
        assert are_exchanged(time, np.concatenate([[0.0], np.cumsum(step)]), TURN) is expected

    @pytest.mark.parametrize(("back", "expected"), [(2, True), (4, False)])
    def test_times_do_not_step_back(self, back, expected):
        """In more than a twentieth of 59 steps."""
        time = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 60))
        for k in range(5, 5 + 9 * back, 9):
            time[k] = time[k - 1] - 0.1
        assert are_exchanged(time, TURN / 4.5 * np.arange(60.0), TURN) is expected


class TestWrapped:
    @pytest.mark.parametrize(
        ("rate", "unit"), [(0.05, "rad"), (0.3, "rad"), (0.36, ""), (-0.3, "rad"), (-0.36, "")]
    )
    def test_an_angle_jumps_in_a_third_of_the_steps_at_most(self, rate, unit):
        """Turns from row to row."""
        assert wrapping_unit(TURN * (rate * np.arange(300.0) % 1.0)) == unit

    @pytest.mark.parametrize(("more", "unit"), [(0.0, "rad"), (0.04, "rad"), (0.4, "")])
    def test_its_range_is_one_period(self, more, unit):
        """Jumps of a turn, between which the angle grows by a turn and more."""
        k = np.arange(160)
        angle = (TURN + more) * k / 40 - TURN * (k // 40)
        assert wrapping_unit(angle) == unit

    def test_it_grows_against_the_jumps(self):
        """A sawtooth that falls between jumps upwards wraps; one that jumps and goes on does not."""
        k = np.arange(160)
        assert wrapping_unit(TURN - TURN * (k / 40 % 1.0)) == "rad"
        assert wrapping_unit(TURN * (k >= 80) + 0.01 * k) == ""

    @pytest.mark.parametrize(("jumps", "found"), [(2, False), (3, True)])
    def test_three_jumps_by_the_whole_range_repeat(self, jumps, found):
        k = np.arange(40 * (jumps + 1))
        assert wraps_at_no_turn(4096.0 * (k / 40 % 1.0)) is found
        assert not wraps_at_no_turn(np.sin(k / 5.0))


class TestUnits:
    T = 0.01 * np.arange(400.0)

    @pytest.mark.parametrize(
        ("factor", "words"),
        [
            (1.0, ""),
            (1.029, ""),
            (math.pi / 180, "in degrees"),
            (1 / TURN, "in turns, the other"),
            (60 / TURN, "the speed is in turns per minute"),
            (1e3, "the time is in ms"),
            (3.0, ""),
        ],
    )
    def test_the_ratio_of_slope_and_speed_names_the_units(self, factor, words):
        omega = 20.0 - 2.0 * self.T
        ratio, text = ratio_of_units(self.T, 20.0 * self.T - self.T**2, factor * omega)
        assert ratio == pytest.approx(1 / factor, rel=1e-3)
        assert words in text
        assert bool(text) == bool(words)
        backwards, same = ratio_of_units(self.T, -20.0 * self.T + self.T**2, factor * omega)
        assert (backwards, same) == (pytest.approx(-ratio), text)

    @pytest.mark.parametrize(("scatter", "known"), [(0.35, True), (0.5, False)])
    def test_a_speed_explains_nine_tenths_of_the_slopes(self, scatter, known):
        """Stretches of eight rows at 1 +- scatter: 7 / 9 of it is left in means of nine; its square is below 1 / 9."""
        seen = 20.0 * (1 + scatter * np.where(np.arange(400) // 8 % 2, 1.0, -1.0))
        ratio, _ = ratio_of_units(self.T, 20.0 * self.T, seen)
        assert math.isfinite(ratio) is known


@pytest.mark.parametrize(
    ("values", "count"),
    [
        ([0.0, 1.0, 0.4, 0.8], 1),  # it rises by 0.4 above its second lowest value
        ([0.0, 1.0, 0.4, 0.95], 2),
        ([0.0, 1.0, 0.6, 1.2], 1),  # it has fallen by 0.4 only
        ([1.0, 0.0, 0.49], 0),
        ([1.0, 0.0, 0.51], 1),
    ],
)
def test_a_rise_begins_at_the_lowest_value_since_the_last_one(values, count):
    assert rises(np.array(values), 0.5) == count
    limits = np.full(len(values), 0.5)
    assert rises(np.array(values), limits) == count
